//! Devices that the tests of a process use in turns.
//!
//! Each test thread takes one device at a time. Devices are opened and closed only while a thread has the turn
//! ([`crate::turn()`]), and thus while no other thread uses one: all at once before the first test, and again when they
//! have run [`TESTS`] tests each.

use crate::turn::{Share, share, turn};
use sgs_engine::device::ObjectKind;
use sgs_engine::{Device, DeviceOptions, PlannedGpu};
use std::sync::{Condvar, Mutex, MutexGuard, OnceLock};
use std::time::Duration;

/// Largest number of devices. Tests in more threads than this wait for each other.
const MOST: usize = 16;

/// Number of tests after which a device is replaced.
///
/// Synchronization validation retains the accesses of all submissions until a wait for a fence or an idle queue. The
/// engine waits for a timeline instead. After 150 tests on each of two devices, the layer took most of the processor.
const TESTS: u32 = 32;

/// Time limit of the work that a test leaves to its device.
const LIMIT: Duration = Duration::from_secs(30);

static POOL: OnceLock<Pool> = OnceLock::new();

struct Pool {
    /// Number of devices when none is damaged.
    size: usize,
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Default)]
struct State {
    /// Unused devices, each with the number of tests that it has run.
    idle: Vec<(Device, u32)>,
    /// Number of devices, idle or in use.
    open: usize,
}

/// Opens the device that `SGS_TEST_DEVICE` names, or the best one, with validation.
///
/// The caller has the turn. If the emulator runs the graphs, the device plans for a GPU with its lanes.
pub(crate) fn open() -> Device {
    let select = std::env::var("SGS_TEST_DEVICE").ok();
    let plan_for =
        emulated_lanes().map(|subgroup_size| PlannedGpu { subgroup_size, float_atomics: true, matrices: Vec::new() });
    let options = DeviceOptions { select, validation: true, plan_for, ..Default::default() };
    Device::open(&options).unwrap_or_else(|e| panic!("{e}"))
}

/// Returns the lanes of the emulator, if `SGS_TEST_EMULATE` asks for it.
pub(crate) fn emulated_lanes() -> Option<u32> {
    let lanes = std::env::var("SGS_TEST_EMULATE").ok()?;
    Some(lanes.parse().unwrap_or_else(|_| panic!("SGS_TEST_EMULATE is \"{lanes}\"; use 8, 16, 32 or 64")))
}

/// Takes a device from the pool, with the number of tests that it has run. Waits while other tests use all devices.
pub(crate) fn take() -> ((Device, u32), Share) {
    let pool = POOL.get_or_init(|| {
        let size = threads(std::env::args(), std::env::var("RUST_TEST_THREADS").ok()).min(MOST);
        Pool { size, state: Mutex::default(), changed: Condvar::new() }
    });
    loop {
        let share = share();
        let all_in_use = |state: &mut State| state.idle.is_empty() && state.open > 0;
        let mut state = pool.changed.wait_while(pool.state(), all_in_use).unwrap_or_else(|e| e.into_inner());
        let newest = (0..state.idle.len()).min_by_key(|i| state.idle[*i].1).filter(|i| state.idle[*i].1 < TESTS);
        if let Some(i) = newest {
            return (state.idle.swap_remove(i), share);
        }
        drop((state, share));
        pool.renew();
    }
}

/// Returns a device to the pool, with the number of tests that it has run.
///
/// A device that a test has damaged is leaked instead, because closing it would race with tests in other threads.
pub(crate) fn put((device, tests): (Device, u32), damaged: bool) {
    let pool = POOL.get().expect("the device is from the pool");
    device.faults().clear();
    device.set_memory_budget(None);
    let mut state = pool.state();
    if damaged {
        state.open -= 1;
        std::mem::forget(device);
    } else {
        state.idle.push((device, tests));
    }
    pool.changed.notify_all();
}

/// Returns whether the device has finished its work. A lost device has not.
pub(crate) fn finished(device: &Device) -> bool {
    device.wait_within(device.last_ticket(), "the work of a test", LIMIT).is_ok() && device.collect() == 0
}

/// Returns the objects on a device besides its own and its pipelines.
pub(crate) fn leftovers(device: &Device) -> Vec<(ObjectKind, u64)> {
    use ObjectKind::{Device, Instance, Messenger, Pipeline, PipelineCache, PipelineLayout, Semaphore, SetLayout};
    let own = |(kind, count): &(ObjectKind, u64)| match kind {
        Instance | Messenger | Device | PipelineCache => *count == 1,
        // One for each queue.
        Semaphore => *count == 1 + u64::from(device.has_transfer_queue()),
        Pipeline | PipelineLayout | SetLayout => true,
        _ => false,
    };
    device.objects().alive().into_iter().filter(|object| !own(object)).collect()
}

impl Pool {
    /// Opens missing devices. Replaces used ones, unless another thread did so while this one waited for its turn.
    fn renew(&self) {
        let _turn = turn();
        let mut state = self.state();
        // With the turn, no device is in use.
        if state.idle.iter().any(|(_, tests)| *tests >= TESTS) {
            // Those that would soon be next are replaced at once, because each turn waits for all tests.
            state.idle.retain(|(_, tests)| *tests < TESTS / 2);
        }
        state.open = state.idle.len();
        while state.open < self.size {
            state.idle.push((open(), 0));
            state.open += 1;
        }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(|e| e.into_inner())
    }
}

/// Returns the number of threads in which the test harness runs tests.
///
/// The same rules as in libtest: the argument `--test-threads`, the variable `RUST_TEST_THREADS`, the processors.
fn threads(arguments: impl Iterator<Item = String>, variable: Option<String>) -> usize {
    let arguments: Vec<String> = arguments.collect();
    let after = |i: usize| arguments.get(i + 1).map(String::as_str);
    let argument =
        arguments.iter().enumerate().find_map(|(i, argument)| match argument.strip_prefix("--test-threads") {
            Some("") => after(i),
            Some(value) => value.strip_prefix('='),
            None => None,
        });
    let number = |text: &str| text.parse().ok().filter(|n| *n > 0);
    let processors = || std::thread::available_parallelism().map_or(1, usize::from);
    argument.and_then(number).or_else(|| variable.as_deref().and_then(number)).unwrap_or_else(processors)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pool_has_a_device_for_each_test_thread() {
        let of = |line: &str, variable: Option<&str>| {
            threads(line.split_whitespace().map(str::to_owned), variable.map(str::to_owned))
        };
        assert_eq!(of("device --test-threads 3 prim::", Some("5")), 3);
        assert_eq!(of("device --exact --test-threads=4", Some("5")), 4);
        assert_eq!(of("device prim::", Some("5")), 5);
        let processors = std::thread::available_parallelism().unwrap().get();
        assert_eq!([of("device", None), of("device", Some("0")), of("device --test-threads", None)], [processors; 3]);
    }
}
