//! Objects behind Vulkan's handles, and access to what callers pass.
//!
//! Handles are addresses of boxes. The functions here trust their arguments: every handle and pointer comes from a caller
//! of Vulkan, who promises that it is valid and that objects in use are not destroyed.

use crate::counters::{Counter, Counters};
use ash::vk::{self, Handle};

/// First word of dispatchable objects, which the loader replaces.
const LOADER_MAGIC: usize = 0x01CD_C0DE;

/// Dispatchable object: the loader owns its first word.
#[repr(C)]
struct Dispatchable<T> {
    loader: usize,
    object: T,
}

/// Instance with its only physical device.
pub(crate) struct Instance {
    pub physical: vk::PhysicalDevice,
}

/// Physical device.
pub(crate) struct Physical {
    pub counters: Counters,
}

/// Device with one queue of each family.
pub(crate) struct Device {
    pub counters: Counters,
    pub queues: [vk::Queue; 2],
}

/// Queue of a family.
pub(crate) struct Queue {
    pub counters: Counters,
    pub family: u32,
}

/// Command buffer.
pub(crate) struct Commands {
    pub counters: Counters,
    /// Whether it is submitted only once, and executes its transfers.
    pub once: bool,
    pub transfers: Vec<crate::commands::Transfer>,
}

/// Creates a dispatchable object.
pub(crate) fn dispatchable<H: Handle, T>(object: T) -> H {
    H::from_raw(Box::into_raw(Box::new(Dispatchable { loader: LOADER_MAGIC, object })) as u64)
}

/// Returns a dispatchable object. Its accesses do not overlap, because Vulkan's callers synchronize them.
pub(crate) fn object<'a, H: Handle, T>(handle: H) -> &'a mut T {
    // SAFETY: the handle is alive and was made by `dispatchable` for this type, as the caller of Vulkan promises. Objects
    // that several threads use at once have no field that functions change.
    unsafe { &mut (*(handle.as_raw() as *mut Dispatchable<T>)).object }
}

/// Destroys a dispatchable object.
pub(crate) fn destroy<H: Handle + Copy, T>(handle: H) {
    if !handle.is_null() {
        // SAFETY: the handle was made by `dispatchable` for this type and is not used again.
        drop(unsafe { Box::from_raw(handle.as_raw() as *mut Dispatchable<T>) });
    }
}

/// Creates another object.
pub(crate) fn plain<H: Handle, T>(object: T) -> H {
    H::from_raw(Box::into_raw(Box::new(object)) as u64)
}

/// Returns an object of [`plain`].
pub(crate) fn plain_object<'a, H: Handle, T>(handle: H) -> &'a mut T {
    // SAFETY: as in `object`, for handles of `plain`.
    unsafe { &mut *(handle.as_raw() as *mut T) }
}

/// Destroys an object of [`plain`].
pub(crate) fn destroy_plain<H: Handle + Copy, T>(handle: H) {
    if !handle.is_null() {
        // SAFETY: the handle was made by `plain` for this type and is not used again.
        drop(unsafe { Box::from_raw(handle.as_raw() as *mut T) });
    }
}

/// Returns what a pointer of a caller refers to.
pub(crate) fn given<'a, T>(pointer: *const T) -> &'a T {
    // SAFETY: the caller of Vulkan promises that the pointer is valid during the call.
    unsafe { &*pointer }
}

/// Returns the array that a caller passes.
pub(crate) fn array<'a, T>(pointer: *const T, count: u32) -> &'a [T] {
    if count == 0 {
        return &[];
    }
    // SAFETY: the caller of Vulkan promises an array of that length, valid during the call.
    unsafe { std::slice::from_raw_parts(pointer, count as usize) }
}

/// Writes a result where a caller expects it.
pub(crate) fn put<T>(pointer: *mut T, value: T) {
    // SAFETY: the caller of Vulkan promises that the pointer is valid for a write.
    unsafe { pointer.write(value) }
}

/// Writes a list as Vulkan's enumerations do: its length, or as many elements as the caller has memory for.
pub(crate) fn list<T: Clone>(all: &[T], count: *mut u32, into: *mut T) -> vk::Result {
    if into.is_null() {
        put(count, all.len() as u32);
        return vk::Result::SUCCESS;
    }
    let written = all.len().min(*given(count) as usize);
    for (i, value) in all[..written].iter().enumerate() {
        put(into.wrapping_add(i), value.clone());
    }
    put(count, written as u32);
    if written < all.len() { vk::Result::INCOMPLETE } else { vk::Result::SUCCESS }
}

/// Returns the counters of a device.
pub(crate) fn count(device: vk::Device, counter: Counter, by: u64) {
    object::<_, Device>(device).counters.add(counter, by);
}
