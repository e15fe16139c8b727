//! Fault injection for every Vulkan call that can fail.
//!
//! Promises: a [`Faults`] affects only the devices opened with it, never the process. Without planned faults, a call
//! costs one relaxed load. A planned fault replaces the call, so the call creates nothing. The caller handles it like
//! a real failure. After the loss of a device, every later call fails immediately.

use super::objects::{ObjectKind, Objects};
use crate::error::{Check, Error, Result};
use ash::vk;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock};

/// Result codes that can be injected.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum FaultKind {
    /// `VK_ERROR_OUT_OF_HOST_MEMORY`.
    OutOfHostMemory,
    /// `VK_ERROR_OUT_OF_DEVICE_MEMORY`.
    OutOfDeviceMemory,
    /// `VK_ERROR_DEVICE_LOST`; the device stays lost.
    DeviceLost,
    /// `VK_TIMEOUT`, as if a wait had reached its time limit.
    Timeout,
    /// `VK_NOT_READY`.
    NotReady,
    /// `VK_ERROR_INITIALIZATION_FAILED`.
    InitializationFailed,
    /// `VK_ERROR_MEMORY_MAP_FAILED`.
    MemoryMapFailed,
    /// `VK_ERROR_TOO_MANY_OBJECTS`.
    TooManyObjects,
    /// `VK_ERROR_FRAGMENTED_POOL`.
    FragmentedPool,
    /// `VK_ERROR_OUT_OF_POOL_MEMORY`.
    OutOfPoolMemory,
    /// `VK_ERROR_INCOMPATIBLE_DRIVER`.
    IncompatibleDriver,
    /// `VK_ERROR_UNKNOWN`.
    Unknown,
}

impl FaultKind {
    fn result(self) -> vk::Result {
        match self {
            FaultKind::OutOfHostMemory => vk::Result::ERROR_OUT_OF_HOST_MEMORY,
            FaultKind::OutOfDeviceMemory => vk::Result::ERROR_OUT_OF_DEVICE_MEMORY,
            FaultKind::DeviceLost => vk::Result::ERROR_DEVICE_LOST,
            FaultKind::Timeout => vk::Result::TIMEOUT,
            FaultKind::NotReady => vk::Result::NOT_READY,
            FaultKind::InitializationFailed => vk::Result::ERROR_INITIALIZATION_FAILED,
            FaultKind::MemoryMapFailed => vk::Result::ERROR_MEMORY_MAP_FAILED,
            FaultKind::TooManyObjects => vk::Result::ERROR_TOO_MANY_OBJECTS,
            FaultKind::FragmentedPool => vk::Result::ERROR_FRAGMENTED_POOL,
            FaultKind::OutOfPoolMemory => vk::Result::ERROR_OUT_OF_POOL_MEMORY,
            FaultKind::IncompatibleDriver => vk::Result::ERROR_INCOMPATIBLE_DRIVER,
            FaultKind::Unknown => vk::Result::ERROR_UNKNOWN,
        }
    }

    /// Returns the error codes that a call can return. Source: Vulkan 1.3, the section of each call.
    pub fn of(call: &str) -> &'static [FaultKind] {
        use FaultKind::{
            DeviceLost, FragmentedPool, IncompatibleDriver, InitializationFailed, MemoryMapFailed, NotReady,
            OutOfDeviceMemory, OutOfHostMemory, OutOfPoolMemory, Timeout, TooManyObjects,
        };
        match call {
            "vkCreateInstance" => &[OutOfHostMemory, InitializationFailed, IncompatibleDriver],
            "vkCreateDevice" => &[OutOfHostMemory, OutOfDeviceMemory, InitializationFailed, TooManyObjects, DeviceLost],
            "vkEnumeratePhysicalDevices" => &[OutOfHostMemory, OutOfDeviceMemory, InitializationFailed],
            "vkMapMemory" => &[OutOfHostMemory, OutOfDeviceMemory, MemoryMapFailed],
            "vkAllocateMemory" => &[OutOfDeviceMemory, OutOfHostMemory, TooManyObjects],
            "vkAllocateDescriptorSets" => &[OutOfHostMemory, OutOfDeviceMemory, FragmentedPool, OutOfPoolMemory],
            "vkWaitSemaphores" => &[Timeout, OutOfHostMemory, OutOfDeviceMemory, DeviceLost],
            "vkQueueSubmit2" | "vkGetSemaphoreCounterValue" => &[OutOfHostMemory, OutOfDeviceMemory, DeviceLost],
            "vkGetQueryPoolResults" => &[OutOfHostMemory, OutOfDeviceMemory, DeviceLost, NotReady],
            _ => &[OutOfHostMemory, OutOfDeviceMemory],
        }
    }
}

/// Planned fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Fault {
    /// Vulkan call that fails, or [`Fault::ANY`].
    pub call: &'static str,
    /// Number of matching calls that succeed first.
    pub skip: u64,
    /// Result code of the failure.
    pub result: FaultKind,
}

impl Fault {
    /// Wildcard that matches every call.
    pub const ANY: &'static str = "*";
}

/// Recorded Vulkan call.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Call {
    /// Name of the call.
    pub call: &'static str,
    /// Object or pass of the call.
    pub what: String,
}

/// Fault plan and call record, shared by clones.
///
/// Keep one clone and pass another as [`super::DeviceOptions::faults`]. Devices opened with clones of one plan share
/// it.
#[derive(Clone, Debug, Default)]
pub struct Faults(Arc<FaultsInner>);

#[derive(Debug, Default)]
struct FaultsInner {
    /// Whether any fault is planned or calls are recorded.
    active: AtomicBool,
    state: Mutex<State>,
}

#[derive(Debug, Default)]
struct State {
    planned: Vec<Fault>,
    fired: Vec<(Call, FaultKind)>,
    record: Option<Vec<Call>>,
}

impl Faults {
    /// Plans a fault. Each fires once; several may be pending.
    pub fn inject(&self, fault: Fault) {
        let mut state = self.lock();
        state.planned.push(fault);
        self.0.active.store(true, Ordering::Relaxed);
    }

    /// Removes all pending faults.
    pub fn clear(&self) {
        let mut state = self.lock();
        state.planned.clear();
        self.0.active.store(state.record.is_some(), Ordering::Relaxed);
    }

    /// Starts to record every call.
    pub fn record(&self) {
        let mut state = self.lock();
        state.record = Some(Vec::new());
        self.0.active.store(true, Ordering::Relaxed);
    }

    /// Returns the calls since [`Faults::record`] and ends the recording.
    pub fn take_record(&self) -> Vec<Call> {
        let mut state = self.lock();
        let calls = state.record.take().unwrap_or_default();
        self.0.active.store(!state.planned.is_empty(), Ordering::Relaxed);
        calls
    }

    /// Returns and clears the faults that fired.
    pub fn take_fired(&self) -> Vec<(Call, FaultKind)> {
        std::mem::take(&mut self.lock().fired)
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.0.state.lock().unwrap_or_else(|e| e.into_inner())
    }

    /// Returns the planned failure of this call, if it is due.
    #[inline]
    fn planned(&self, call: &'static str, what: &str) -> std::result::Result<(), vk::Result> {
        if self.0.active.load(Ordering::Relaxed) { self.take_due(call, what) } else { Ok(()) }
    }

    #[cold]
    fn take_due(&self, call: &'static str, what: &str) -> std::result::Result<(), vk::Result> {
        let mut state = self.lock();
        let named = || Call { call, what: what.to_owned() };
        if let Some(record) = &mut state.record {
            record.push(named());
        }
        let mut due = None;
        for (i, fault) in state.planned.iter_mut().enumerate() {
            if fault.call != call && fault.call != Fault::ANY {
                continue;
            }
            match fault.skip.checked_sub(1) {
                Some(left) => fault.skip = left,
                None => due = due.or(Some(i)),
            }
        }
        let Some(i) = due else { return Ok(()) };
        let fault = state.planned.remove(i);
        state.fired.push((named(), fault.result));
        self.0.active.store(!state.planned.is_empty() || state.record.is_some(), Ordering::Relaxed);
        Err(fault.result.result())
    }
}

/// Gateway to the driver: fault plan, object counts, and device-lost state of one device.
#[derive(Debug, Default)]
pub(crate) struct Gate {
    pub faults: Faults,
    pub objects: Objects,
    lost: OnceLock<String>,
}

impl Gate {
    pub fn new(faults: Faults, objects: Objects) -> Gate {
        Gate { faults, objects, lost: OnceLock::new() }
    }

    /// Returns whether calls are recorded or made to fail. Their order then matters.
    pub fn is_watched(&self) -> bool {
        self.faults.0.active.load(Ordering::Relaxed)
    }

    /// Makes a call that can fail, unless the device is lost or a fault is due.
    pub fn call<T>(
        &self,
        call: &'static str,
        what: &str,
        run: impl FnOnce() -> std::result::Result<T, vk::Result>,
    ) -> Result<T> {
        if let Some(before) = self.lost.get() {
            return Err(Error::DeviceLost(format!("{before}, before {call} for \"{what}\"")));
        }
        let result = self.faults.planned(call, what).and_then(|()| run());
        if matches!(result, Err(vk::Result::ERROR_DEVICE_LOST)) {
            let _first = self.lost.set(format!("{call} for \"{what}\""));
        }
        result.check(call, what)
    }

    /// Like [`Gate::call`], for a call that creates one object; counts the object until [`Gate::count_destroyed`].
    pub fn make<T>(
        &self,
        kind: ObjectKind,
        call: &'static str,
        what: &str,
        run: impl FnOnce() -> std::result::Result<T, vk::Result>,
    ) -> Result<T> {
        let made = self.call(call, what, run)?;
        self.objects.add(kind);
        Ok(made)
    }

    /// Counts an object as destroyed.
    pub fn count_destroyed(&self, kind: ObjectKind) {
        self.objects.remove(kind);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ok() -> std::result::Result<u32, vk::Result> {
        Ok(7)
    }

    #[test]
    fn planned_fault_fires_once_after_its_skips() {
        let gate = Gate::default();
        gate.faults.inject(Fault { call: "vkCreateBuffer", skip: 1, result: FaultKind::OutOfDeviceMemory });
        gate.faults.inject(Fault { call: Fault::ANY, skip: 3, result: FaultKind::OutOfHostMemory });
        assert!(gate.call("vkCreateBuffer", "a", ok).is_ok());
        assert!(gate.call("vkMapMemory", "a", ok).is_ok());
        let error = gate.call("vkCreateBuffer", "b", || -> std::result::Result<u32, vk::Result> { unreachable!() });
        assert!(matches!(
            error,
            Err(Error::Vulkan { call: "vkCreateBuffer", what, result: vk::Result::ERROR_OUT_OF_DEVICE_MEMORY })
                if what == "b"
        ));
        let other = gate.call("vkMapMemory", "c", ok);
        assert!(matches!(other, Err(Error::Vulkan { result: vk::Result::ERROR_OUT_OF_HOST_MEMORY, .. })));
        assert_eq!(gate.faults.take_fired().len(), 2);
        assert!(gate.call("vkCreateBuffer", "d", ok).is_ok());
        assert!(!gate.faults.0.active.load(Ordering::Relaxed));
    }

    #[test]
    fn calls_are_recorded_and_faults_can_be_cleared() {
        let gate = Gate::default();
        gate.faults.record();
        let made = gate.make(ObjectKind::Buffer, "vkCreateBuffer", "a", ok);
        assert!(made.is_ok() && gate.call("vkMapMemory", "b", ok).is_ok());
        let calls = gate.faults.take_record();
        assert_eq!(
            calls.iter().map(|c| (c.call, c.what.as_str())).collect::<Vec<_>>(),
            [("vkCreateBuffer", "a"), ("vkMapMemory", "b")]
        );
        assert_eq!(gate.objects.count(ObjectKind::Buffer), 1);
        gate.count_destroyed(ObjectKind::Buffer);
        assert_eq!(gate.objects.total(), 0);
        gate.faults.inject(Fault { call: Fault::ANY, skip: 0, result: FaultKind::Unknown });
        gate.faults.clear();
        assert!(gate.call("vkMapMemory", "b", ok).is_ok());
    }

    #[test]
    fn lost_device_stays_lost() {
        let gate = Gate::default();
        gate.faults.inject(Fault { call: "vkQueueSubmit2", skip: 0, result: FaultKind::DeviceLost });
        let first = gate.call("vkQueueSubmit2", "step", ok).unwrap_err().to_string();
        assert_eq!(first, "The device was lost in vkQueueSubmit2 for \"step\".");
        let later = gate.call("vkMapMemory", "x", || -> std::result::Result<u32, vk::Result> { unreachable!() });
        assert_eq!(
            later.unwrap_err().to_string(),
            "The device was lost in vkQueueSubmit2 for \"step\", before vkMapMemory for \"x\"."
        );
    }
}
