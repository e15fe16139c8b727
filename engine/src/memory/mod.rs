//! Buffers, images and their memory.
//!
//! Promises: a buffer lives until its last handle is dropped and names itself in errors. The plan manages the lifetimes
//! of transients, which it places in one arena buffer.

mod external;
pub(crate) mod image;
mod shared;
mod transfer;
mod upload;

pub use crate::allocator::{Activity, Budget, BudgetSource};
pub use image::DeviceImage;
pub use shared::{Semaphore, SharedHandle};
pub use transfer::STAGING_BYTES;
pub use upload::Piece;

use crate::allocator::Backing;
use crate::device::{Busy, DeferredObject, Device, ObjectKind, Shared};
use crate::error::{Error, Result};
use ash::vk;
use gpu_allocator::MemoryLocation;
use gpu_allocator::vulkan::{Allocation, AllocationCreateDesc, AllocationScheme};
use std::sync::Arc;

/// Memory type of a buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Location {
    /// Device memory, accessed only by kernels and transfers.
    Device,
    /// Host memory, written by the host and read by the device.
    Upload,
    /// Host memory, written by the device and read by the host.
    Readback,
}

/// Buffer handle; clones share the buffer.
#[derive(Clone)]
pub struct DeviceBuffer(pub(crate) Arc<Inner>);

pub(crate) struct Inner {
    pub raw: vk::Buffer,
    pub bytes: u64,
    pub name: String,
    pub location: Location,
    allocation: Option<Allocation>,
    mapped: Option<std::ptr::NonNull<u8>>,
    /// Owner of buffer and memory, if not the allocator.
    backing: Backing,
    pub busy: Busy,
    pub device: Device,
}

// SAFETY: the mapped pointer is plain memory that lives as long as the allocation; every access copies bytes in
// `read` and `write`. The caller uses the timeline to ensure that the device is done with them.
unsafe impl Send for Inner {}
// SAFETY: as above; concurrent host writes to the same bytes are excluded by `write` taking the allocator-wide lock.
unsafe impl Sync for Inner {}

impl std::fmt::Debug for DeviceBuffer {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "DeviceBuffer({:?}, {} bytes)", self.0.name, self.0.bytes)
    }
}

impl Device {
    /// Creates a buffer of at least `bytes` (never of size zero).
    ///
    /// # Errors
    /// [`Error::OutOfMemory`], [`Error::OverBudget`], or [`Error::BufferTooLarge`], with the name and size.
    pub fn buffer(&self, name: &str, bytes: u64, location: Location) -> Result<DeviceBuffer> {
        let shared: &Shared = &self.0;
        shared.collect();
        let bytes = bytes.max(4).next_multiple_of(4);
        shared.info.check_buffer(name, bytes)?;
        let info = buffer_info(bytes);
        // SAFETY: the device is alive.
        let raw = shared
            .gate
            .make(ObjectKind::Buffer, "vkCreateBuffer", name, || unsafe { shared.raw.create_buffer(&info, None) })?;
        // SAFETY: the buffer was just created from this device.
        let requirements = unsafe { shared.raw.get_buffer_memory_requirements(raw) };
        let memory_location = match location {
            Location::Device => MemoryLocation::GpuOnly,
            Location::Upload => MemoryLocation::CpuToGpu,
            Location::Readback => MemoryLocation::GpuToCpu,
        };
        // Buffers of at least 1 MiB get dedicated memory: no waste in blocks, and freeing returns it to the driver.
        let dedicated = bytes >= 1 << 20;
        let desc = AllocationCreateDesc {
            name,
            requirements,
            location: memory_location,
            linear: true,
            allocation_scheme: if dedicated {
                AllocationScheme::DedicatedBuffer(raw)
            } else {
                AllocationScheme::GpuAllocatorManaged
            },
        };
        let destroy = || {
            // SAFETY: nothing uses the buffer yet.
            unsafe { shared.raw.destroy_buffer(raw, None) };
            shared.gate.count_destroyed(ObjectKind::Buffer);
        };
        let allocation = shared.allocate(&desc).inspect_err(|_| destroy())?;
        // SAFETY: the allocation matches this buffer's requirements and is used by nothing else.
        let bound = shared.gate.call("vkBindBufferMemory", name, || unsafe {
            shared.raw.bind_buffer_memory(raw, allocation.memory(), allocation.offset())
        });
        if let Err(error) = bound {
            shared.free(allocation);
            destroy();
            return Err(error);
        }
        let mut state = shared.memory.lock();
        state.add(bytes);
        state.activity.buffers += 1;
        state.activity.made += 1;
        drop(state);
        shared.name(raw, name);
        let mapped = allocation.mapped_ptr().map(|p| p.cast());
        let buffer = DeviceBuffer(Arc::new(Inner {
            raw,
            bytes,
            name: name.to_owned(),
            location,
            allocation: Some(allocation),
            mapped,
            backing: Backing::Allocator,
            busy: Busy::default(),
            device: self.clone(),
        }));
        if shared.is_planning() {
            match location {
                Location::Device => self.fill(&buffer, 0)?,
                Location::Upload | Location::Readback => buffer.write(0, &vec![0; bytes as usize])?,
            }
        }
        Ok(buffer)
    }
}

/// Returns the create info of engine buffers.
fn buffer_info(bytes: u64) -> vk::BufferCreateInfo<'static> {
    vk::BufferCreateInfo::default().size(bytes).sharing_mode(vk::SharingMode::EXCLUSIVE).usage(
        vk::BufferUsageFlags::STORAGE_BUFFER
            | vk::BufferUsageFlags::UNIFORM_BUFFER
            | vk::BufferUsageFlags::INDIRECT_BUFFER
            | vk::BufferUsageFlags::TRANSFER_SRC
            | vk::BufferUsageFlags::TRANSFER_DST,
    )
}

impl DeviceBuffer {
    /// Returns the size in bytes.
    pub fn bytes(&self) -> u64 {
        self.0.bytes
    }

    /// Returns the name.
    pub fn name(&self) -> &str {
        &self.0.name
    }

    /// Reads from a host-visible buffer. The device must be done with the range.
    ///
    /// # Errors
    /// If the range exceeds the buffer, or the buffer is in device memory.
    pub fn read(&self, offset: u64, into: &mut [u8]) -> Result<()> {
        let pointer = self.range(offset, into.len() as u64)?;
        // SAFETY: the range lies inside the mapping; `into` is a distinct host slice of that length.
        unsafe { std::ptr::copy_nonoverlapping(pointer.as_ptr(), into.as_mut_ptr(), into.len()) };
        Ok(())
    }

    /// Writes to a host-visible buffer. The device must not be using the range.
    ///
    /// # Errors
    /// If the range exceeds the buffer, or the buffer is in device memory.
    pub fn write(&self, offset: u64, data: &[u8]) -> Result<()> {
        let pointer = self.range(offset, data.len() as u64)?;
        let _one_writer = self.0.device.0.memory.lock();
        // SAFETY: as in `read`, the other way round; host writers are serialized by the lock.
        unsafe { std::ptr::copy_nonoverlapping(data.as_ptr(), pointer.as_ptr(), data.len()) };
        Ok(())
    }

    fn range(&self, offset: u64, bytes: u64) -> Result<std::ptr::NonNull<u8>> {
        self.check_range(offset, bytes)?;
        match self.0.mapped {
            // SAFETY: `offset` is within the mapped range, checked above.
            Some(p) if self.0.location != Location::Device => Ok(unsafe { p.add(offset as usize) }),
            _ => Err(Error::NotHostVisible(self.0.name.clone())),
        }
    }

    pub(crate) fn check_range(&self, offset: u64, bytes: u64) -> Result<()> {
        let end = offset.saturating_add(bytes);
        if end > self.0.bytes {
            return Err(Error::OutOfRange { buffer: self.0.name.clone(), offset, end, bytes: self.0.bytes });
        }
        Ok(())
    }
}

impl Drop for Inner {
    fn drop(&mut self) {
        if self.backing == Backing::Host {
            return;
        }
        let allocation = self.allocation.take();
        let object = DeferredObject::Buffer { raw: self.raw, allocation, bytes: self.bytes, backing: self.backing };
        // Executors keep the buffers of pending work alive and wait before they drop them, so that the device is
        // done. After a failed wait, `busy` holds the last possible use.
        self.device.0.dispose(self.busy.ticket(), object);
    }
}
