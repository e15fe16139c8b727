//! Device memory budget.
//!
//! Promises: a configured budget is never exceeded. A budget from the driver (`VK_EXT_memory_budget`) is not exceeded
//! knowingly. The error contains the numbers. Without either, the heap size is reported and the driver rejects
//! allocations. Counts the bytes of buffers and images; shared blocks may hold slightly more.

use super::Memory;
use crate::error::{Error, Result};
use ash::vk;
use std::sync::atomic::{AtomicU64, Ordering};

/// Memory budget of a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
pub struct Budget {
    /// Size of device memory in bytes.
    pub heap: u64,
    /// Budget of this device's buffers and images in bytes.
    pub budget: u64,
    /// Bytes in use.
    pub used: u64,
    /// Source of the budget.
    pub source: BudgetSource,
}

impl Budget {
    /// Returns the unused budget in bytes.
    pub fn left(&self) -> u64 {
        self.budget.saturating_sub(self.used)
    }
}

/// Source of a budget.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum BudgetSource {
    /// Set by the user.
    #[serde(rename = "given")]
    Configured,
    /// `VK_EXT_memory_budget`: memory not used by other processes.
    Driver,
    /// Size of the heap.
    Heap,
}

/// Budget inputs of one device.
pub(super) struct Limits {
    /// Configured budget in bytes; `u64::MAX` if none.
    configured: AtomicU64,
    heap: u64,
    /// Instance, device and largest device-local heap for budget queries, if supported.
    driver_query: Option<(ash::Instance, vk::PhysicalDevice, usize)>,
}

impl Limits {
    pub fn new(instance: &ash::Instance, physical: vk::PhysicalDevice, heap: u64, driver_budget: bool) -> Limits {
        // SAFETY: the physical device belongs to the instance.
        let memory = unsafe { instance.get_physical_device_memory_properties(physical) };
        let heaps = &memory.memory_heaps[..memory.memory_heap_count as usize];
        let local = heaps.iter().enumerate().filter(|(_, h)| h.flags.contains(vk::MemoryHeapFlags::DEVICE_LOCAL));
        let largest = local.max_by_key(|(_, h)| h.size).map_or(0, |(i, _)| i);
        let driver_query = driver_budget.then(|| (instance.clone(), physical, largest));
        Limits { configured: AtomicU64::new(u64::MAX), heap, driver_query }
    }

    fn configured(&self) -> Option<u64> {
        Some(self.configured.load(Ordering::Relaxed)).filter(|&g| g != u64::MAX)
    }

    /// Returns the bytes that the driver still offers, if it reports them.
    fn driver_left(&self) -> Option<u64> {
        let (instance, physical, heap) = self.driver_query.as_ref()?;
        let mut driver_budget = vk::PhysicalDeviceMemoryBudgetPropertiesEXT::default();
        let mut properties = vk::PhysicalDeviceMemoryProperties2::default().push_next(&mut driver_budget);
        // SAFETY: the physical device belongs to the instance and has the extension.
        unsafe { instance.get_physical_device_memory_properties2(*physical, &mut properties) };
        Some(driver_budget.heap_budget[*heap].saturating_sub(driver_budget.heap_usage[*heap]))
    }
}

/// Returns the bytes of device memory that the driver offers; those of the heap if it does not tell.
pub(crate) fn available(instance: &ash::Instance, physical: vk::PhysicalDevice, heap: u64, driver_budget: bool) -> u64 {
    Limits::new(instance, physical, heap, driver_budget).driver_left().map_or(heap, |left| left.min(heap))
}

impl Memory {
    /// Returns the current budget.
    pub fn budget(&self) -> Budget {
        let used = self.usage().0;
        let heap = self.limits.heap;
        let driver = self.limits.driver_left().map(|left| (used + left).min(heap));
        let (most, source) = driver.map_or((heap, BudgetSource::Heap), |b| (b, BudgetSource::Driver));
        match self.limits.configured() {
            Some(configured) if configured <= most => {
                Budget { heap, budget: configured, used, source: BudgetSource::Configured }
            }
            _ => Budget { heap, budget: most, used, source },
        }
    }

    /// Checks an allocation against the budget. `local`: whether it needs device memory.
    pub fn check_budget(&self, what: &str, bytes: u64, local: bool) -> Result<()> {
        if self.limits.configured().is_none() && self.limits.driver_query.is_none() {
            return Ok(());
        }
        let b = self.budget();
        // Host memory counts against a configured budget, but not against the driver's heap.
        if bytes <= b.left() || (b.source == BudgetSource::Driver && !local) {
            return Ok(());
        }
        Err(Error::OverBudget { what: what.to_owned(), bytes, used: b.used, budget: b.budget })
    }

    pub fn set_budget(&self, bytes: Option<u64>) {
        self.limits.configured.store(bytes.unwrap_or(u64::MAX), Ordering::Relaxed);
    }
}
