//! How much device memory there is to use.
//!
//! Promises: a budget that was given is never exceeded, and one that the driver tells (`VK_EXT_memory_budget`) is not
//! exceeded knowingly; the refusal carries the figures. Without either the size of the heap is reported, and it is left
//! to the driver to refuse. Counted are the bytes of buffers and images; blocks that small ones share may hold some more.

use super::Memory;
use crate::device::{Device, DeviceInfo, Instance};
use crate::error::{Error, Result};
use ash::vk;
use std::sync::atomic::{AtomicU64, Ordering};

/// What there is, what may be used, and what is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
pub struct Budget {
    /// Bytes of device memory that the device has.
    pub heap: u64,
    /// Bytes that this device's buffers and images may take, all in.
    pub budget: u64,
    /// Bytes that they take now.
    pub used: u64,
    /// Who says so.
    pub source: BudgetSource,
}

impl Budget {
    /// Bytes that are left.
    pub fn left(&self) -> u64 {
        self.budget.saturating_sub(self.used)
    }
}

/// Where a budget comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum BudgetSource {
    /// It was set.
    Given,
    /// `VK_EXT_memory_budget`: what other processes leave.
    Driver,
    /// The size of the heap.
    Heap,
}

/// The limits of one device.
pub(super) struct Limits {
    /// The budget that was set; `u64::MAX` if none.
    given: AtomicU64,
    heap: u64,
    /// For asking the driver, where it can tell: its largest device-local heap.
    ask: Option<(ash::Instance, vk::PhysicalDevice, usize)>,
}

impl Limits {
    pub fn new(instance: &Instance, physical: vk::PhysicalDevice, info: &DeviceInfo) -> Limits {
        // SAFETY: the physical device belongs to the instance.
        let memory = unsafe { instance.raw.get_physical_device_memory_properties(physical) };
        let heaps = &memory.memory_heaps[..memory.memory_heap_count as usize];
        let local = heaps.iter().enumerate().filter(|(_, h)| h.flags.contains(vk::MemoryHeapFlags::DEVICE_LOCAL));
        let largest = local.max_by_key(|(_, h)| h.size).map_or(0, |(i, _)| i);
        let ask = info.optional.memory_budget.then(|| (instance.raw.clone(), physical, largest));
        Limits { given: AtomicU64::new(u64::MAX), heap: info.memory_bytes, ask }
    }

    fn given(&self) -> Option<u64> {
        Some(self.given.load(Ordering::Relaxed)).filter(|&g| g != u64::MAX)
    }

    /// Bytes that the driver would still give, where it tells.
    fn driver_left(&self) -> Option<u64> {
        let (instance, physical, heap) = self.ask.as_ref()?;
        let mut told = vk::PhysicalDeviceMemoryBudgetPropertiesEXT::default();
        let mut properties = vk::PhysicalDeviceMemoryProperties2::default().push_next(&mut told);
        // SAFETY: the physical device belongs to the instance and has the extension.
        unsafe { instance.get_physical_device_memory_properties2(*physical, &mut properties) };
        Some(told.heap_budget[*heap].saturating_sub(told.heap_usage[*heap]))
    }
}

impl Memory {
    /// The budget as it is.
    pub fn budget(&self) -> Budget {
        let used = self.usage().0;
        let heap = self.limits.heap;
        let driver = self.limits.driver_left().map(|left| (used + left).min(heap));
        let (most, source) = driver.map_or((heap, BudgetSource::Heap), |b| (b, BudgetSource::Driver));
        match self.limits.given() {
            Some(given) if given <= most => Budget { heap, budget: given, used, source: BudgetSource::Given },
            _ => Budget { heap, budget: most, used, source },
        }
    }

    /// Refuses what would go beyond the budget. `local`: whether it is to be device memory.
    pub(super) fn check_budget(&self, what: &str, bytes: u64, local: bool) -> Result<()> {
        if self.limits.given().is_none() && self.limits.ask.is_none() {
            return Ok(());
        }
        let b = self.budget();
        // Host memory is counted against a budget that was given, and no business of the driver's heap.
        if bytes <= b.left() || (b.source == BudgetSource::Driver && !local) {
            return Ok(());
        }
        Err(Error::OverBudget { what: what.to_owned(), bytes, used: b.used, budget: b.budget })
    }

    pub fn set_budget(&self, bytes: Option<u64>) {
        self.limits.given.store(bytes.unwrap_or(u64::MAX), Ordering::Relaxed);
    }
}

impl Device {
    /// How much memory there is, may be used, and is used.
    pub fn budget(&self) -> Budget {
        self.0.memory.budget()
    }

    /// Sets how many bytes buffers and images may take, all in; what the device or its driver leaves, if absent. What
    /// exists already stays.
    pub fn set_memory_budget(&self, bytes: Option<u64>) {
        self.0.memory.set_budget(bytes);
    }
}
