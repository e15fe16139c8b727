//! Buffers, images, and the memory behind them.
//!
//! Promises: a buffer lives as long as its last handle and names itself in errors; usage is counted. Leaves lifetimes of
//! transients to the plan, which places them all in one arena buffer.

mod budget;
mod external;
pub(crate) mod image;
mod shared;
mod transfer;

pub use budget::{Budget, BudgetSource};
pub use image::DeviceImage;
pub use shared::{Semaphore, SharedHandle};
pub use transfer::STAGING_BYTES;

use crate::device::{Busy, Device, DeviceInfo, ObjectKind, Parked, Shared};
use crate::error::{Error, Result};
use ash::vk;
use gpu_allocator::MemoryLocation;
use gpu_allocator::vulkan::{Allocation, AllocationCreateDesc, AllocationScheme, Allocator, AllocatorCreateDesc};
use std::sync::{Arc, Mutex, MutexGuard};

/// Where a buffer lives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Location {
    /// Device memory, reached by kernels and transfers alone.
    Device,
    /// Host memory that the host writes and the device reads.
    Upload,
    /// Host memory that the device writes and the host reads.
    Readback,
}

pub(crate) struct Memory {
    state: Mutex<State>,
    limits: budget::Limits,
}

struct State {
    allocator: Option<Allocator>,
    used: u64,
    peak: u64,
    /// The most since somebody asked for it.
    since: u64,
    activity: Activity,
}

impl State {
    fn add(&mut self, bytes: u64) {
        self.used += bytes;
        self.peak = self.peak.max(self.used);
        self.since = self.since.max(self.used);
    }
}

/// What has been done with a device's memory since it was opened. A steady state changes none of it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Activity {
    /// Buffers that exist.
    pub buffers: u64,
    /// Images that exist.
    pub images: u64,
    /// Buffers and images ever made.
    pub made: u64,
    /// Calls of [`Device::upload`].
    pub uploads: u64,
    /// Calls of [`Device::download`].
    pub downloads: u64,
}

impl Memory {
    pub fn new(
        instance: &crate::device::Instance,
        device: &ash::Device,
        physical: vk::PhysicalDevice,
        info: &DeviceInfo,
    ) -> Result<Memory> {
        let desc = AllocatorCreateDesc {
            instance: instance.raw.clone(),
            device: device.clone(),
            physical_device: physical,
            debug_settings: gpu_allocator::AllocatorDebugSettings::default(),
            buffer_device_address: false,
            // Small blocks that grow: a small scene must not cost a quarter of a gigabyte.
            allocation_sizes: gpu_allocator::AllocationSizes::new(8 << 20, 8 << 20),
        };
        let allocator = Allocator::new(&desc).map_err(|e| Error::OutOfMemory {
            what: format!("the allocator of {}", info.name),
            bytes: 0,
            reason: e.to_string(),
        })?;
        Ok(Memory {
            state: Mutex::new(State {
                allocator: Some(allocator),
                used: 0,
                peak: 0,
                since: 0,
                activity: Activity::default(),
            }),
            limits: budget::Limits::new(instance, physical, info),
        })
    }

    pub fn usage(&self) -> (u64, u64) {
        let state = self.lock();
        (state.used, state.peak)
    }

    pub fn during<T>(&self, work: impl FnOnce() -> T) -> (T, u64) {
        let before = {
            let mut state = self.lock();
            state.since = state.used;
            state.used
        };
        let done = work();
        (done, self.lock().since.saturating_sub(before))
    }

    pub fn activity(&self) -> Activity {
        self.lock().activity
    }

    /// Gives everything back; the device is about to go.
    pub fn shut_down(&self) {
        self.lock().allocator = None;
    }

    /// Gives nothing back: work may go on that uses it.
    pub fn leave(&self) {
        std::mem::forget(self.lock().allocator.take());
    }

    pub(crate) fn buffer_gone(&self, bytes: u64) {
        let mut state = self.lock();
        state.used -= bytes;
        state.activity.buffers -= 1;
    }

    pub(crate) fn image_gone(&self, bytes: u64) {
        let mut state = self.lock();
        state.used -= bytes;
        state.activity.images -= 1;
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(|e| e.into_inner())
    }

    fn count_image(&self) {
        let activity = &mut self.lock().activity;
        activity.images += 1;
        activity.made += 1;
    }
}

/// A buffer; clones share it.
#[derive(Clone)]
pub struct DeviceBuffer(pub(crate) Arc<Inner>);

pub(crate) struct Inner {
    pub raw: vk::Buffer,
    pub bytes: u64,
    pub name: String,
    pub location: Location,
    allocation: Option<Allocation>,
    mapped: Option<std::ptr::NonNull<u8>>,
    /// Whose the buffer and its memory are, where the allocator does not know them.
    backing: Backing,
    pub busy: Busy,
    pub device: Device,
}

/// Whose the memory behind a buffer or an image is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Backing {
    /// The allocator's.
    Allocator,
    /// A host's; nothing is destroyed here.
    Host,
    /// Ours, beside the allocator, because it is shared with others; as many bytes.
    Shared(vk::DeviceMemory, u64),
}

// SAFETY: the mapped pointer is plain memory that lives as long as the allocation; every access goes through `read` and
// `write`, which copy bytes. Whether the device is done with them is the caller's contract with the timeline.
unsafe impl Send for Inner {}
// SAFETY: as above; concurrent host writes to the same bytes are excluded by `write` taking the allocator-wide lock.
unsafe impl Sync for Inner {}

impl std::fmt::Debug for DeviceBuffer {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "DeviceBuffer({:?}, {} bytes)", self.0.name, self.0.bytes)
    }
}

impl Device {
    /// Makes a buffer of at least `bytes` (never of size zero).
    ///
    /// # Errors
    /// [`Error::OutOfMemory`], [`Error::OverBudget`], or [`Error::BufferTooLarge`], with the name and size.
    pub fn buffer(&self, name: &str, bytes: u64, location: Location) -> Result<DeviceBuffer> {
        let shared: &Shared = &self.0;
        shared.collect();
        let bytes = bytes.max(4).next_multiple_of(4);
        shared.info.check_buffer(name, bytes)?;
        let families = shared.families();
        let info = buffer_info(bytes, &families);
        // SAFETY: the device is alive.
        let raw = shared
            .gate
            .make(ObjectKind::Buffer, "vkCreateBuffer", name, || unsafe { shared.raw.create_buffer(&info, None) })?;
        // SAFETY: the buffer was just made from this device.
        let requirements = unsafe { shared.raw.get_buffer_memory_requirements(raw) };
        let memory_location = match location {
            Location::Device => MemoryLocation::GpuOnly,
            Location::Upload => MemoryLocation::CpuToGpu,
            Location::Readback => MemoryLocation::GpuToCpu,
        };
        // Buffers from a mebibyte on get memory of their own: nothing is wasted in blocks, and growing gives it back.
        let own = bytes >= 1 << 20;
        let desc = AllocationCreateDesc {
            name,
            requirements,
            location: memory_location,
            linear: true,
            allocation_scheme: if own {
                AllocationScheme::DedicatedBuffer(raw)
            } else {
                AllocationScheme::GpuAllocatorManaged
            },
        };
        let give_back = || {
            // SAFETY: nothing uses the buffer yet.
            unsafe { shared.raw.destroy_buffer(raw, None) };
            shared.gate.gone(ObjectKind::Buffer);
        };
        let allocation = shared.allocate(&desc).inspect_err(|_| give_back())?;
        // SAFETY: the allocation was made for this buffer's requirements and is used by nothing else.
        let bound = shared.gate.call("vkBindBufferMemory", name, || unsafe {
            shared.raw.bind_buffer_memory(raw, allocation.memory(), allocation.offset())
        });
        if let Err(error) = bound {
            shared.free(allocation);
            give_back();
            return Err(error);
        }
        let mut state = shared.memory.lock();
        state.add(bytes);
        state.activity.buffers += 1;
        state.activity.made += 1;
        drop(state);
        shared.name(raw, name);
        let mapped = allocation.mapped_ptr().map(|p| p.cast());
        Ok(DeviceBuffer(Arc::new(Inner {
            raw,
            bytes,
            name: name.to_owned(),
            location,
            allocation: Some(allocation),
            mapped,
            backing: Backing::Allocator,
            busy: Busy::default(),
            device: self.clone(),
        })))
    }
}

/// How our buffers are made, shared between families where there is more than one.
fn buffer_info(bytes: u64, families: &[u32]) -> vk::BufferCreateInfo<'_> {
    // Buffers know no compression that sharing could cost, and a transfer of ownership would be one more barrier on
    // either side of every wait between queues.
    let sharing = if families.len() > 1 { vk::SharingMode::CONCURRENT } else { vk::SharingMode::EXCLUSIVE };
    let families = if families.len() > 1 { families } else { &[] };
    vk::BufferCreateInfo::default().size(bytes).sharing_mode(sharing).queue_family_indices(families).usage(
        vk::BufferUsageFlags::STORAGE_BUFFER
            | vk::BufferUsageFlags::UNIFORM_BUFFER
            | vk::BufferUsageFlags::INDIRECT_BUFFER
            | vk::BufferUsageFlags::TRANSFER_SRC
            | vk::BufferUsageFlags::TRANSFER_DST,
    )
}

impl Shared {
    /// Memory from the allocator, counted. All of it goes through here, so that it can be refused on purpose.
    pub(crate) fn allocate(&self, desc: &AllocationCreateDesc<'_>) -> Result<Allocation> {
        let (what, bytes) = (desc.name, desc.requirements.size);
        let refused = |reason: String| Error::OutOfMemory { what: what.to_owned(), bytes, reason };
        let planned = |call: &'static str| {
            self.gate.call(call, what, || Ok(())).map_err(|e| match e {
                Error::Vulkan { call, result, .. } => refused(format!("{call}: {result}")),
                other => other,
            })
        };
        self.memory.check_budget(what, bytes, desc.location == MemoryLocation::GpuOnly)?;
        planned("vkAllocateMemory")?;
        if desc.location != MemoryLocation::GpuOnly {
            planned("vkMapMemory")?;
        }
        let mut state = self.memory.lock();
        let allocation = match state.allocator.as_mut() {
            Some(a) => a.allocate(desc).map_err(|e| refused(format!("vkAllocateMemory: {e}")))?,
            None => return Err(refused("the device is closing".to_owned())),
        };
        self.gate.objects.add(ObjectKind::Memory);
        Ok(allocation)
    }

    /// Gives memory back. Nothing may use it any more.
    pub(crate) fn free(&self, allocation: Allocation) {
        let mut state = self.memory.lock();
        if let Some(allocator) = state.allocator.as_mut()
            && let Err(error) = allocator.free(allocation)
        {
            tracing::error!(%error, "memory could not be given back");
            return;
        }
        self.gate.gone(ObjectKind::Memory);
    }
}

impl DeviceBuffer {
    /// Its size.
    pub fn bytes(&self) -> u64 {
        self.0.bytes
    }

    /// Its name.
    pub fn name(&self) -> &str {
        &self.0.name
    }

    /// Copies host-visible contents out. The device must be done with them.
    ///
    /// # Errors
    /// If the range is outside, or the buffer is device memory.
    pub fn read(&self, offset: u64, into: &mut [u8]) -> Result<()> {
        let pointer = self.range(offset, into.len() as u64)?;
        // SAFETY: the range lies inside the mapping; `into` is a distinct host slice of that length.
        unsafe { std::ptr::copy_nonoverlapping(pointer.as_ptr(), into.as_mut_ptr(), into.len()) };
        Ok(())
    }

    /// Copies `data` into a host-visible buffer. The device must not be using the range.
    ///
    /// # Errors
    /// If the range is outside, or the buffer is device memory.
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
        let thing = Parked::Buffer { raw: self.raw, allocation, bytes: self.bytes, backing: self.backing };
        // Executors keep the buffers of pending work alive and wait before they let go, so that the device is done, unless
        // a wait failed, which says until when the buffer is busy.
        self.device.0.dispose(self.busy.ticket(), thing);
    }
}
