//! Admission of runs to devices: several runs share a device while their predicted memory fits.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Part of a device's memory that runs may fill. The rest is for drivers and for errors of the prediction.
const USABLE: f64 = 0.9;

/// Memory of a device, as admission counts it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DeviceMemory {
    /// UUID of the device. Jobs on one device share its memory.
    pub uuid: String,
    /// Bytes of device memory that other programs leave.
    pub bytes: u64,
}

/// Memory that a run is admitted with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Demand {
    /// Predicted peak in bytes.
    Bytes(u64),
    /// The whole device: the prediction is missing or was too low.
    Alone,
}

/// Runs on a device.
#[derive(Debug, Default)]
struct Load {
    /// Sum of the predicted bytes.
    bytes: u64,
    /// For each admitted run, whether another run was admitted beside it.
    runs: Vec<(u64, Arc<AtomicBool>)>,
    /// Whether a run has the device alone.
    alone: bool,
    /// Number of runs that wait to have the device alone.
    waiting: usize,
    next: u64,
}

/// Accounts of all devices.
#[derive(Debug, Default)]
pub(crate) struct Admission(Mutex<BTreeMap<String, Load>>);

/// Admission of a run; dropping it frees the memory.
#[derive(Debug)]
pub(crate) struct Permit<'a> {
    admission: &'a Admission,
    uuid: String,
    bytes: u64,
    id: u64,
    alone: bool,
    shared: Arc<AtomicBool>,
}

/// Request for a whole device; while it exists, no other run is admitted.
#[derive(Debug)]
pub(crate) struct Waiting<'a> {
    admission: &'a Admission,
    uuid: String,
}

impl Admission {
    fn loads(&self) -> MutexGuard<'_, BTreeMap<String, Load>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Admits a run to a device. `None` if it has to wait for others.
    ///
    /// A device without runs admits any run: a prediction may be too high, and the training itself refuses what does
    /// not fit.
    pub fn admit(&self, device: &DeviceMemory, demand: Demand) -> Option<Permit<'_>> {
        self.enter(device, demand, 0)
    }

    /// Announces a run that needs the device alone.
    pub fn wait(&self, device: &DeviceMemory) -> Waiting<'_> {
        self.loads().entry(device.uuid.clone()).or_default().waiting += 1;
        Waiting { admission: self, uuid: device.uuid.clone() }
    }

    /// `announced`: number of announced runs that may wait beside this one.
    fn enter(&self, device: &DeviceMemory, demand: Demand, announced: usize) -> Option<Permit<'_>> {
        let mut loads = self.loads();
        let load = loads.entry(device.uuid.clone()).or_default();
        let (bytes, alone) = match demand {
            Demand::Bytes(bytes) => (bytes, false),
            Demand::Alone => (0, true),
        };
        let usable = (device.bytes as f64 * USABLE) as u64;
        let fits = !alone && !load.alone && load.bytes.saturating_add(bytes) <= usable;
        if load.waiting > announced || !load.runs.is_empty() && !fits {
            return None;
        }
        let shared = Arc::new(AtomicBool::new(!load.runs.is_empty()));
        for (_, other) in &load.runs {
            other.store(true, Ordering::SeqCst);
        }
        let id = load.next;
        load.next += 1;
        load.runs.push((id, shared.clone()));
        load.bytes = load.bytes.saturating_add(bytes);
        load.alone = alone;
        Some(Permit { admission: self, uuid: device.uuid.clone(), bytes, id, alone, shared })
    }
}

impl Permit<'_> {
    /// Returns whether another run was on the device at the same time.
    pub fn was_shared(&self) -> bool {
        self.shared.load(Ordering::SeqCst)
    }
}

impl Drop for Permit<'_> {
    fn drop(&mut self) {
        if let Some(load) = self.admission.loads().get_mut(&self.uuid) {
            load.runs.retain(|(id, _)| *id != self.id);
            load.bytes = load.bytes.saturating_sub(self.bytes);
            load.alone &= !self.alone;
        }
    }
}

impl<'a> Waiting<'a> {
    /// Admits the run as soon as the device has no other.
    pub fn admit(&self, device: &DeviceMemory) -> Option<Permit<'a>> {
        let waiting = self.admission.loads().get(&self.uuid).map_or(0, |load| load.waiting);
        self.admission.enter(device, Demand::Alone, waiting)
    }
}

impl Drop for Waiting<'_> {
    fn drop(&mut self) {
        if let Some(load) = self.admission.loads().get_mut(&self.uuid) {
            load.waiting = load.waiting.saturating_sub(1);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn device(uuid: &str, bytes: u64) -> DeviceMemory {
        DeviceMemory { uuid: uuid.into(), bytes }
    }

    #[test]
    fn runs_share_a_device_while_they_fit() {
        let (admission, a, b) = (Admission::default(), device("a", 1000), device("b", 1000));
        let first = admission.admit(&a, Demand::Bytes(500)).unwrap();
        assert!(!first.was_shared());
        assert!(admission.admit(&a, Demand::Bytes(401)).is_none(), "900 of 1000 bytes may be used");
        let second = admission.admit(&a, Demand::Bytes(400)).unwrap();
        assert!(first.was_shared() && second.was_shared());
        let other = admission.admit(&b, Demand::Bytes(800)).unwrap();
        assert!(!other.was_shared());
        drop(first);
        assert!(second.was_shared());
        let third = admission.admit(&a, Demand::Bytes(500)).unwrap();
        drop((second, third, other));
        assert!(admission.loads().values().all(|load| load.bytes == 0 && load.runs.is_empty()));
        // A run that exceeds the device has it alone.
        let large = admission.admit(&a, Demand::Bytes(5000)).unwrap();
        assert!(admission.admit(&a, Demand::Bytes(1)).is_none());
        drop(large);
        assert!(admission.admit(&a, Demand::Bytes(1)).is_some());
    }

    #[test]
    fn run_that_needs_a_device_alone_is_not_passed_over() {
        let (admission, a) = (Admission::default(), device("a", 1000));
        let first = admission.admit(&a, Demand::Bytes(10)).unwrap();
        assert!(admission.admit(&a, Demand::Alone).is_none());
        let (waiting, another) = (admission.wait(&a), admission.wait(&a));
        assert!(waiting.admit(&a).is_none(), "the first run is still there");
        assert!(admission.admit(&a, Demand::Bytes(10)).is_none(), "a run passed one that waits");
        drop(first);
        let alone = waiting.admit(&a).unwrap();
        assert!(another.admit(&a).is_none());
        drop(waiting);
        assert!(admission.admit(&a, Demand::Bytes(1)).is_none() && !alone.was_shared());
        drop(alone);
        let alone = another.admit(&a).unwrap();
        drop((another, alone));
        assert!(admission.admit(&a, Demand::Bytes(1)).is_some());
    }
}
