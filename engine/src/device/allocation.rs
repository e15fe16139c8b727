//! Allocation of device memory, and its budget.

use super::{Device, ObjectKind, Shared};
use crate::allocator::{Backing, Budget};
use crate::error::{Error, Result};
use ash::vk;
use gpu_allocator::MemoryLocation;
use gpu_allocator::vulkan::{Allocation, AllocationCreateDesc};

impl Device {
    /// Returns memory size, budget and usage of the device.
    pub fn budget(&self) -> Budget {
        self.0.memory.budget()
    }

    /// Sets the memory budget in bytes; `None` restores the budget of the device or driver.
    ///
    /// Existing allocations are unaffected.
    pub fn set_memory_budget(&self, bytes: Option<u64>) {
        self.0.memory.set_budget(bytes);
    }
}

impl Shared {
    /// Allocates counted memory. All allocations pass here, so that faults can be injected.
    pub fn allocate(&self, desc: &AllocationCreateDesc<'_>) -> Result<Allocation> {
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

    /// Frees memory that nothing uses any more.
    pub fn free(&self, allocation: Allocation) {
        let mut state = self.memory.lock();
        if let Some(allocator) = state.allocator.as_mut()
            && let Err(error) = allocator.free(allocation)
        {
            tracing::error!(%error, "memory could not be freed");
            return;
        }
        self.gate.count_destroyed(ObjectKind::Memory);
    }

    /// Frees memory outside the allocator. Nothing may use it any more.
    pub fn free_backing(&self, backing: Backing) {
        if let Backing::Shared(memory, _) = backing
            && memory != vk::DeviceMemory::null()
        {
            // SAFETY: the caller has destroyed what was bound to it.
            unsafe { self.raw.free_memory(memory, None) };
            self.gate.count_destroyed(ObjectKind::Memory);
        }
    }
}
