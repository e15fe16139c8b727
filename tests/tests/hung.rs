//! Work that exceeds its time limit.
//!
//! The error arrives in time and names the work. Resources in use are not freed early, and none leak.

use sgs_engine::exec::{ExecOptions, Executor};
use sgs_engine::graph::{Buffer, CompileOptions, Graph};
use sgs_engine::{Device, DeviceBuffer, DeviceOptions, Error, Location};
use sgs_tests::{busy, turn};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Number of workgroups of a pass.
///
/// Lavapipe ends every loop after 65 535 iterations, so long work needs many workgroups.
const GROUPS: u32 = 384;

const BYTES: u64 = 4 * (busy::LANES * GROUPS) as u64;

const LIMIT: Duration = Duration::from_millis(50);

fn open(options: DeviceOptions) -> Device {
    let select = std::env::var("SGS_TEST_DEVICE").ok();
    Device::open(&DeviceOptions { select, validation: true, ..options }).unwrap()
}

/// Builds two passes over one buffer. A uniform holds the number of rounds.
fn two_passes(device: &Device, timestamps: bool) -> (Executor, Buffer, DeviceBuffer) {
    let mut graph = Graph::new("busy work");
    let settings = graph.uniform("settings", 4);
    let data = graph.external("data", BYTES);
    let kernel = busy::kernel();
    for pass in ["first", "second"] {
        graph.pass(pass, &kernel).bind("settings", settings).bind("data", data).dispatch([GROUPS, 1, 1]).unwrap();
    }
    let plan = Arc::new(graph.compile(&CompileOptions::default()).unwrap());
    let options = ExecOptions { timestamps, ..Default::default() };
    let mut exec = Executor::new(device, plan, options).unwrap();
    let memory = device.buffer("data", BYTES, Location::Device).unwrap();
    device.fill(&memory, 7).unwrap();
    exec.bind(data, &memory).unwrap();
    (exec, settings, memory)
}

/// Returns the number of rounds that keep this device busy for about 1 s per pass.
fn a_second(device: &Device) -> u32 {
    if device.info().kind == "cpu" {
        return 65_535;
    }
    let (mut exec, settings, _memory) = two_passes(device, false);
    let mut rounds = 1u32 << 16;
    loop {
        let begin = Instant::now();
        exec.submit(&[(settings, &rounds.to_ne_bytes())]).unwrap();
        exec.finish_within(Duration::from_secs(60)).unwrap();
        let seconds = begin.elapsed().as_secs_f64() / 2.0;
        if seconds > 0.02 || rounds > 1 << 30 {
            return (f64::from(rounds) / seconds).min(3e9) as u32;
        }
        rounds *= 2;
    }
}

/// Closes a device. Fails if validation reported a message or an object leaked.
#[track_caller]
fn close(device: Device) {
    let (messages, objects) = (device.messages().clone(), device.objects().clone());
    drop(device);
    let log = messages.take();
    assert!(log.is_empty(), "{}", log.join("\n"));
    assert_eq!(objects.alive(), []);
}

#[test]
fn wait_times_out_and_resources_in_use_are_retained() {
    let _turn = turn();
    let device = open(DeviceOptions { timeout: LIMIT, ..Default::default() });
    let rounds = a_second(&device);
    let (mut exec, settings, memory) = two_passes(&device, true);
    let mut expected = vec![7u32; 4];
    let before = device.memory_use().0;
    let begin = Instant::now();
    exec.submit(&[(settings, &rounds.to_ne_bytes())]).unwrap();
    expected.iter_mut().for_each(|v| *v = busy::reference(busy::reference(*v, rounds), rounds));
    let error = exec.finish().unwrap_err();
    let took = begin.elapsed();
    assert!(!device.is_done(device.last_ticket()).unwrap(), "the wait of 50 ms took {took:?}");
    let text = error.to_string();
    assert!(text.starts_with("Work submitted as \"busy work\" did not finish within 0.05 s"), "{text}");
    let Error::Timeout { limit: LIMIT, pass, .. } = error else { panic!("{error}") };
    if device.info().kind != "cpu" {
        // Lavapipe cannot report the pass without waiting.
        assert!(pass.is_some_and(|p| p == "first" || p == "second"), "{text}");
    }
    // A wait on the device or on the executor can have its own limit.
    let short = Duration::from_millis(1);
    assert!(matches!(exec.finish_within(short), Err(Error::Timeout { limit, .. }) if limit == short));
    let last = device.last_ticket();
    assert!(matches!(device.wait_within(last, "look", short), Err(Error::Timeout { .. })));

    // The owners are dropped while the work runs. Resources in use are freed when the work is done.
    let copy = memory.clone();
    drop(memory);
    drop(exec);
    assert!(!device.is_done(last).unwrap(), "dropping waited for the work");
    assert!(device.collect() > 0, "work that is going on holds nothing");
    device.wait_within(last, "the end", Duration::from_secs(60)).unwrap();
    assert_eq!(device.collect(), 0);
    assert!(device.memory_use().0 < before, "what was parked is still there");
    // The work itself finished correctly.
    assert_eq!(device.download_as::<u32>(&copy, 4).unwrap(), expected);
    drop(copy);
    assert_eq!(device.memory_use().0, 0);
    close(device);
}

#[test]
fn a_device_closes_when_the_work_ends() {
    let _turn = turn();
    let device = open(DeviceOptions { timeout: LIMIT, ..Default::default() });
    let rounds = a_second(&device);
    let (mut exec, settings, memory) = two_passes(&device, false);
    exec.submit(&[(settings, &rounds.to_ne_bytes())]).unwrap();
    assert!(matches!(exec.finish(), Err(Error::Timeout { pass: None, .. })));
    // A transfer queued after the work times out too, and its staging memory is retained.
    let error = device.upload(&memory, 0, &[1; 64]).unwrap_err();
    assert!(matches!(&error, Error::Timeout { what, .. } if what == "upload"), "{error}");
    drop((exec, memory));
    assert!(device.objects().total() > 9, "{:?}", device.objects().alive());
    close(device);
}

#[test]
fn work_goes_on_after_a_timeout() {
    let _turn = turn();
    let device = open(DeviceOptions { timeout: LIMIT, ..Default::default() });
    let rounds = a_second(&device);
    let (mut exec, settings, memory) = two_passes(&device, true);
    exec.submit(&[(settings, &rounds.to_ne_bytes())]).unwrap();
    exec.submit(&[(settings, &1u32.to_ne_bytes())]).unwrap();
    // Both slots are in flight, so the third replay waits for the first.
    assert!(matches!(exec.submit(&[(settings, &1u32.to_ne_bytes())]), Err(Error::Timeout { .. })));
    exec.finish_within(Duration::from_secs(60)).unwrap();
    exec.submit(&[(settings, &1u32.to_ne_bytes())]).unwrap();
    exec.finish().unwrap();
    let replays = exec.take_times().iter().map(|t| t.nanoseconds.len()).max();
    assert!(device.info().timestamp_period == 0.0 || replays == Some(3));
    let expected = [rounds, rounds, 1, 1, 1, 1].into_iter().fold(7, busy::reference);
    assert_eq!(device.download_as::<u32>(&memory, 2).unwrap(), [expected; 2]);
    drop((exec, memory));
    close(device);
}
