//! Failure on purpose: every Vulkan call that can fail asks here first.
//!
//! Promises: a [`Faults`] belongs to whoever made it and to the devices opened with it, never to the process; while
//! nothing is planned a call costs one relaxed load. A planned failure stands in place of the call, which is not made, so
//! that nothing it would have made is left behind. Leaves what a failure leads to to the caller, who cannot tell it from
//! a real one. The loss of a device is remembered: from then on every call fails at once.

use super::objects::{ObjectKind, Objects};
use crate::error::{Check, Error, Result};
use ash::vk;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock};

/// Result codes that can be planned.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum FaultKind {
    /// `VK_ERROR_OUT_OF_HOST_MEMORY`.
    OutOfHostMemory,
    /// `VK_ERROR_OUT_OF_DEVICE_MEMORY`.
    OutOfDeviceMemory,
    /// `VK_ERROR_DEVICE_LOST`; the device stays lost.
    DeviceLost,
    /// `VK_TIMEOUT`, as if the time limit of a wait had passed.
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

    /// The codes with which a call may fail (Vulkan 1.3, the section of each call).
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

/// A failure to come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Fault {
    /// The call that fails, or [`Fault::ANY`].
    pub call: &'static str,
    /// So many of these calls succeed before.
    pub skip: u64,
    /// How it fails.
    pub result: FaultKind,
}

impl Fault {
    /// Matches every call.
    pub const ANY: &'static str = "*";
}

/// A call that was counted.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Call {
    /// Its name.
    pub call: &'static str,
    /// The object or pass it was for.
    pub what: String,
}

/// What is to fail, and the record of what was called. Clones are the same plan: keep one, give one to
/// [`super::DeviceOptions::faults`]. Devices opened with clones of one plan share it.
#[derive(Clone, Debug, Default)]
pub struct Faults(Arc<Watched>);

#[derive(Debug, Default)]
struct Watched {
    /// Whether anything is planned or recorded.
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
    /// Plans a failure. Each plan fires once; several may be waiting.
    pub fn inject(&self, fault: Fault) {
        let mut state = self.lock();
        state.planned.push(fault);
        self.0.active.store(true, Ordering::Relaxed);
    }

    /// Forgets the failures that have not come yet.
    pub fn clear(&self) {
        let mut state = self.lock();
        state.planned.clear();
        self.0.active.store(state.record.is_some(), Ordering::Relaxed);
    }

    /// Starts to write down every call.
    pub fn record(&self) {
        let mut state = self.lock();
        state.record = Some(Vec::new());
        self.0.active.store(true, Ordering::Relaxed);
    }

    /// The calls since [`Faults::record`]; ends the recording.
    pub fn take_record(&self) -> Vec<Call> {
        let mut state = self.lock();
        let calls = state.record.take().unwrap_or_default();
        self.0.active.store(!state.planned.is_empty(), Ordering::Relaxed);
        calls
    }

    /// The failures that came, emptied.
    pub fn take_fired(&self) -> Vec<(Call, FaultKind)> {
        std::mem::take(&mut self.lock().fired)
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.0.state.lock().unwrap_or_else(|e| e.into_inner())
    }

    /// The planned failure of this call, if it is its turn.
    #[inline]
    fn planned(&self, call: &'static str, what: &str) -> std::result::Result<(), vk::Result> {
        if self.0.active.load(Ordering::Relaxed) { self.consult(call, what) } else { Ok(()) }
    }

    #[cold]
    fn consult(&self, call: &'static str, what: &str) -> std::result::Result<(), vk::Result> {
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

/// The one way to the driver: a device's plan of failures, its tally of objects, and whether it is lost.
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

    /// Makes a call that can fail, unless the device is lost or the call is to fail on purpose.
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

    /// As [`Gate::call`], for a call that makes one object, which is counted until [`Gate::gone`].
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
    pub fn gone(&self, kind: ObjectKind) {
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
    fn a_planned_failure_comes_in_its_turn_and_once() {
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
    fn calls_are_recorded_and_plans_can_be_dropped() {
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
        gate.gone(ObjectKind::Buffer);
        assert_eq!(gate.objects.total(), 0);
        gate.faults.inject(Fault { call: Fault::ANY, skip: 0, result: FaultKind::Unknown });
        gate.faults.clear();
        assert!(gate.call("vkMapMemory", "b", ok).is_ok());
    }

    #[test]
    fn a_lost_device_stays_lost() {
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
