//! Allocator of a device's memory: usage, counters and budget.
//!
//! Promises: usage is counted. The allocator knows neither buffers nor images.

mod budget;

pub(crate) use budget::available;
pub use budget::{Budget, BudgetSource};

use crate::error::{Error, Result};
use ash::vk;
use gpu_allocator::vulkan::{Allocator, AllocatorCreateDesc};
use std::sync::{Mutex, MutexGuard};

/// Allocator of one device, with its usage and its budget.
pub(crate) struct Memory {
    state: Mutex<State>,
    limits: budget::Limits,
}

/// Allocator and counters, behind one lock.
pub(crate) struct State {
    /// Absent once the device closes.
    pub allocator: Option<Allocator>,
    used: u64,
    peak: u64,
    /// Peak usage in bytes since the last reset.
    window_peak: u64,
    pub activity: Activity,
}

impl State {
    /// Counts new memory.
    pub fn add(&mut self, bytes: u64) {
        self.used += bytes;
        self.peak = self.peak.max(self.used);
        self.window_peak = self.window_peak.max(self.used);
    }
}

/// Counters of memory operations since the device was opened. A steady state changes none of them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Activity {
    /// Live buffers.
    pub buffers: u64,
    /// Live images.
    pub images: u64,
    /// Buffers and images created in total.
    pub made: u64,
    /// Number of pieces that [`Device::upload_all`](crate::Device::upload_all) wrote.
    pub uploads: u64,
    /// Number of chunks of staging memory that uploads submitted.
    pub upload_chunks: u64,
    /// Number of times that uploads waited for the device, because a copy was not done.
    pub upload_waits: u64,
    /// Most chunks of an upload that were submitted and not known to be done.
    pub most_chunks_in_flight: u64,
    /// Number of calls of [`Device::download`](crate::Device::download).
    pub downloads: u64,
}

impl Memory {
    /// Creates the allocator of a device. `heap`: bytes of device memory. `driver_budget`: whether the driver reports a
    /// budget.
    pub fn new(
        instance: &ash::Instance,
        device: &ash::Device,
        physical: vk::PhysicalDevice,
        name: &str,
        heap: u64,
        driver_budget: bool,
    ) -> Result<Memory> {
        let desc = AllocatorCreateDesc {
            instance: instance.clone(),
            device: device.clone(),
            physical_device: physical,
            debug_settings: gpu_allocator::AllocatorDebugSettings::default(),
            buffer_device_address: false,
            // Small blocks that grow, so that a small scene does not allocate 256 MiB.
            allocation_sizes: gpu_allocator::AllocationSizes::new(8 << 20, 8 << 20),
        };
        let allocator = Allocator::new(&desc).map_err(|e| Error::OutOfMemory {
            what: format!("the allocator of {name}"),
            bytes: 0,
            reason: e.to_string(),
        })?;
        Ok(Memory {
            state: Mutex::new(State {
                allocator: Some(allocator),
                used: 0,
                peak: 0,
                window_peak: 0,
                activity: Activity::default(),
            }),
            limits: budget::Limits::new(instance, physical, heap, driver_budget),
        })
    }

    pub fn usage(&self) -> (u64, u64) {
        let state = self.lock();
        (state.used, state.peak)
    }

    pub fn during<T>(&self, work: impl FnOnce() -> T) -> (T, u64) {
        let before = {
            let mut state = self.lock();
            state.window_peak = state.used;
            state.used
        };
        let done = work();
        (done, self.lock().window_peak.saturating_sub(before))
    }

    pub fn activity(&self) -> Activity {
        self.lock().activity
    }

    /// Frees the allocator before the device is destroyed.
    pub fn shut_down(&self) {
        self.lock().allocator = None;
    }

    /// Leaks the allocator, because running work may use its memory.
    pub fn leak(&self) {
        std::mem::forget(self.lock().allocator.take());
    }

    pub fn count_destroyed_buffer(&self, bytes: u64) {
        let mut state = self.lock();
        state.used -= bytes;
        state.activity.buffers -= 1;
    }

    pub fn count_destroyed_image(&self, bytes: u64) {
        let mut state = self.lock();
        state.used -= bytes;
        state.activity.images -= 1;
    }

    pub fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(|e| e.into_inner())
    }

    pub fn count_image(&self) {
        let activity = &mut self.lock().activity;
        activity.images += 1;
        activity.made += 1;
    }
}

/// Owner of the memory of a buffer or image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Backing {
    /// Allocator of the device.
    Allocator,
    /// Host; nothing is destroyed here.
    Host,
    /// Dedicated memory of the engine, shared with others; size in bytes.
    Shared(vk::DeviceMemory, u64),
}
