//! Devices without opening them: a list, and the one that a request names.

use super::Environment;
use super::fault::Gate;
use super::info::DeviceInfo;
use super::instance::Instance;
use super::{describe, select};
use crate::allocator::available;
use crate::error::Result;

/// Device that a request names, and its memory.
#[derive(Clone, Debug)]
pub struct FoundDevice {
    /// Description.
    pub info: DeviceInfo,
    /// Bytes of device memory that other processes leave; all of it if the driver does not tell.
    pub available_bytes: u64,
}

/// Lists every device of the loader, with the features that each lacks.
///
/// # Errors
/// If the loader is missing or the instance cannot be created.
pub fn devices() -> Result<Vec<DeviceInfo>> {
    let gate = Gate::default();
    let instance = Instance::new(false, &[], &gate)?;
    Ok(describe::candidates(&instance, &gate)?.into_iter().map(|c| c.info).collect())
}

/// Finds the device that a request names, without opening it.
///
/// It is the one that [`Device::open`](super::Device::open) would open.
///
/// # Errors
/// As for opening: if the loader is missing, no device matches, or the device lacks a required feature.
pub fn find_device(select: Option<&str>) -> Result<FoundDevice> {
    let gate = Gate::default();
    let instance = Instance::new(false, &[], &gate)?;
    let chosen = select::choose(describe::candidates(&instance, &gate)?, select, &Environment::current())?;
    let (info, raw) = (chosen.info, &instance.raw);
    let available_bytes = available(raw, chosen.physical, info.memory_bytes, info.optional.memory_budget);
    Ok(FoundDevice { info, available_bytes })
}
