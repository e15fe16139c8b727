//! Memory, buffers and images in host memory.

use crate::counters::Counter;
use crate::handles::{count, destroy_plain, given, plain, plain_object, put};
use ash::vk;
use std::ffi::c_void;

/// Alignment of buffers and of their memory.
pub(crate) const ALIGNMENT: u64 = 64;

/// Memory types that a buffer may have: all.
const TYPES: u32 = 0b111;

/// Allocation: words that the operating system provides as zeros when they are first touched.
struct Memory(Vec<u64>);

/// Buffer, and where it lies once it is bound.
pub(crate) struct Buffer {
    bytes: u64,
    address: *mut u8,
}

/// Image: only its size.
struct Image(u64);

impl Buffer {
    /// Returns the address of a range, if the buffer is bound and contains it.
    pub fn range(&self, offset: u64, bytes: u64) -> Option<*mut u8> {
        let inside = offset.checked_add(bytes).is_some_and(|end| end <= self.bytes);
        (inside && !self.address.is_null()).then(|| self.address.wrapping_add(offset as usize))
    }

    /// Returns the bytes after an offset.
    pub fn rest(&self, offset: u64) -> u64 {
        self.bytes.saturating_sub(offset)
    }
}

type Callbacks<'a> = *const vk::AllocationCallbacks<'a>;

pub(crate) extern "system" fn allocate_memory(
    device: vk::Device,
    info: *const vk::MemoryAllocateInfo<'_>,
    _: Callbacks<'_>,
    memory: *mut vk::DeviceMemory,
) -> vk::Result {
    count(device, Counter::Allocations, 1);
    let words = (given(info).allocation_size.next_multiple_of(ALIGNMENT) + ALIGNMENT) / 8;
    put(memory, plain(Memory(vec![0u64; words as usize])));
    vk::Result::SUCCESS
}

pub(crate) extern "system" fn free_memory(_: vk::Device, memory: vk::DeviceMemory, _: Callbacks<'_>) {
    destroy_plain::<_, Memory>(memory);
}

/// Returns the first aligned address of an allocation.
fn base(memory: vk::DeviceMemory) -> *mut u8 {
    let start: *mut u8 = plain_object::<_, Memory>(memory).0.as_mut_ptr().cast();
    start.wrapping_add(start.align_offset(ALIGNMENT as usize))
}

pub(crate) extern "system" fn map_memory(
    _: vk::Device,
    memory: vk::DeviceMemory,
    offset: u64,
    _bytes: u64,
    _: vk::MemoryMapFlags,
    pointer: *mut *mut c_void,
) -> vk::Result {
    put(pointer, base(memory).wrapping_add(offset as usize).cast());
    vk::Result::SUCCESS
}

pub(crate) extern "system" fn unmap_memory(_: vk::Device, _: vk::DeviceMemory) {}

pub(crate) extern "system" fn flush(_: vk::Device, _: u32, _: *const vk::MappedMemoryRange<'_>) -> vk::Result {
    vk::Result::SUCCESS
}

pub(crate) extern "system" fn create_buffer(
    device: vk::Device,
    info: *const vk::BufferCreateInfo<'_>,
    _: Callbacks<'_>,
    buffer: *mut vk::Buffer,
) -> vk::Result {
    count(device, Counter::Objects, 1);
    put(buffer, plain(Buffer { bytes: given(info).size, address: std::ptr::null_mut() }));
    vk::Result::SUCCESS
}

pub(crate) extern "system" fn destroy_buffer(_: vk::Device, buffer: vk::Buffer, _: Callbacks<'_>) {
    destroy_plain::<_, Buffer>(buffer);
}

fn requirements(bytes: u64) -> vk::MemoryRequirements {
    vk::MemoryRequirements { size: bytes.next_multiple_of(ALIGNMENT), alignment: ALIGNMENT, memory_type_bits: TYPES }
}

pub(crate) extern "system" fn buffer_requirements(
    _: vk::Device,
    buffer: vk::Buffer,
    into: *mut vk::MemoryRequirements,
) {
    put(into, requirements(plain_object::<_, Buffer>(buffer).bytes));
}

pub(crate) extern "system" fn bind_buffer(
    _: vk::Device,
    buffer: vk::Buffer,
    memory: vk::DeviceMemory,
    offset: u64,
) -> vk::Result {
    let buffer = plain_object::<_, Buffer>(buffer);
    buffer.address = base(memory).wrapping_add(offset as usize);
    // Buffers begin as zeros, so that what kernels would have written does not depend on earlier buffers.
    // SAFETY: the range lies inside the allocation, as the caller of Vulkan promises, and no other buffer uses it.
    unsafe { buffer.address.write_bytes(0, buffer.bytes as usize) };
    vk::Result::SUCCESS
}

pub(crate) extern "system" fn create_image(
    device: vk::Device,
    info: *const vk::ImageCreateInfo<'_>,
    _: Callbacks<'_>,
    image: *mut vk::Image,
) -> vk::Result {
    count(device, Counter::Objects, 1);
    let vk::Extent3D { width, height, depth } = given(info).extent;
    // No format of the engine has more than 16 bytes per texel.
    put(image, plain(Image(16 * u64::from(width) * u64::from(height) * u64::from(depth))));
    vk::Result::SUCCESS
}

pub(crate) extern "system" fn destroy_image(_: vk::Device, image: vk::Image, _: Callbacks<'_>) {
    destroy_plain::<_, Image>(image);
}

pub(crate) extern "system" fn image_requirements(_: vk::Device, image: vk::Image, into: *mut vk::MemoryRequirements) {
    put(into, requirements(plain_object::<_, Image>(image).0));
}

pub(crate) extern "system" fn bind_image(_: vk::Device, _: vk::Image, _: vk::DeviceMemory, _offset: u64) -> vk::Result {
    vk::Result::SUCCESS
}
