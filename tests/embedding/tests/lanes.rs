//! Plans for two queues on a host's device that lends one queue.

use ash::vk;
use sgs_embedding::Host;
use sgs_engine::graph::exec::{ExecOptions, Executor, SemaphorePoint};
use sgs_engine::graph::{Buffer, CompileOptions, Graph, Lane, Queues};
use sgs_engine::{Device, Error};
use std::sync::Arc;

const WORDS: usize = 256;
const BYTES: u64 = 4 * WORDS as u64;

struct Chains {
    exec: Executor,
    source: Buffer,
    outs: [Buffer; 2],
}

/// Builds two chains of one-word moves, one per lane, from one source.
///
/// The shorter chain leaves by the second output, whose second half gets the end of the longer chain.
fn chains(device: &Device) -> Chains {
    let mut g = Graph::new("chains");
    let (source, state) = (g.external("source", BYTES), g.transient("state", BYTES));
    let outs = [g.external("long", BYTES), g.external("short", BYTES)];
    g.copy("begin", source, state).unwrap();
    for (chain, links) in [5, 3].into_iter().enumerate() {
        let mut last = state;
        for link in 0..links {
            let next = g.transient(format!("{chain}.{link}"), BYTES);
            g.copy(format!("{chain}.{link}.move"), last.slice(0, BYTES - 4), next.slice(4, BYTES - 4)).unwrap();
            g.fill(format!("{chain}.{link}.front"), next.slice(0, 4), 7).unwrap();
            last = next;
        }
        g.copy(format!("{chain}.end"), last, outs[chain]).unwrap();
    }
    let half = BYTES / 2;
    g.copy("meet", outs[0].slice(half, half), outs[1].slice(half, half)).unwrap();
    let plan = Arc::new(g.compile(&CompileOptions { queues: Queues::Forced, ..Default::default() }).unwrap());
    assert!(plan.segments.iter().any(|segment| segment.lane == Lane::Side), "nothing to test in\n{plan}");
    let options = ExecOptions { poison: true, ..Default::default() };
    Chains { exec: Executor::new(device, plan, options).unwrap(), source, outs }
}

fn data() -> Vec<u32> {
    (0..WORDS as u32).map(|word| word.wrapping_mul(2_654_435_761)).collect()
}

/// Returns the expected result of the chains for [`data`].
fn expected() -> [Vec<u32>; 2] {
    let moved = |by: usize| -> Vec<u32> {
        let front = std::iter::repeat_n(7, by);
        front.chain(data()).take(WORDS).collect()
    };
    let (long, mut short) = (moved(5), moved(3));
    short[WORDS / 2..].copy_from_slice(&long[WORDS / 2..]);
    [long, short]
}

#[test]
fn both_lanes_run_between_a_hosts_semaphores() {
    let host = Host::new();
    let device = host.adopt();
    assert!(!device.has_second_queue(), "a host lends one queue");
    let (source, outs) = (host.buffer(BYTES), [host.buffer(BYTES), host.buffer(BYTES)]);
    let timeline = host.semaphore(true);
    let mut chains = chains(&device);
    // SAFETY: the buffers outlive the plan and are of this device.
    unsafe {
        chains.exec.bind(chains.source, &device.wrap_buffer("source", source.raw, BYTES).unwrap()).unwrap();
        for (out, memory) in chains.outs.into_iter().zip(&outs) {
            chains.exec.bind(out, &device.wrap_buffer("out", memory.raw, BYTES).unwrap()).unwrap();
        }
    }
    for replay in 0..4u64 {
        // Work waits for the host's signal, and all of it is done before the host is signaled.
        let stale = vec![0; WORDS];
        for memory in outs.iter().chain([&source]) {
            host.write(memory, bytemuck::cast_slice(&stale));
        }
        let (from, to) = (2 * replay + 1, 2 * replay + 2);
        // SAFETY: the semaphore lives until the end; both values are new.
        let ticket = unsafe {
            let (from, to) = (SemaphorePoint::timeline(timeline, from), SemaphorePoint::timeline(timeline, to));
            chains.exec.submit_with(&[], &[from], &[to]).unwrap()
        };
        assert!(!device.is_done(ticket).unwrap());
        host.write(&source, bytemuck::cast_slice(&data()));
        let (semaphores, values) = ([timeline], [to]);
        let wait = vk::SemaphoreWaitInfo::default().semaphores(&semaphores).values(&values);
        // SAFETY: as above.
        unsafe {
            let signal = vk::SemaphoreSignalInfo::default().semaphore(timeline).value(from);
            host.device.signal_semaphore(&signal).unwrap();
            host.device.wait_semaphores(&wait, u64::MAX).unwrap();
        }
        for (memory, expected) in outs.iter().zip(expected()) {
            assert_eq!(bytemuck::pod_collect_to_vec::<u8, u32>(&host.read(memory, BYTES)), expected);
        }
    }
    drop(chains);
    drop(device);
    for buffer in [source].into_iter().chain(outs) {
        host.destroy_buffer(buffer);
    }
    host.destroy_semaphore(timeline);
}

#[test]
fn both_lanes_are_recorded_into_one_command_buffer() {
    let host = Host::new();
    // The host submits everything itself.
    // SAFETY: all that the host says is so.
    let device = unsafe { Device::adopt(host.offer(false)) }.unwrap();
    let (source, outs) = (host.buffer(BYTES), [host.buffer(BYTES), host.buffer(BYTES)]);
    host.write(&source, bytemuck::cast_slice(&data()));
    let mut chains = chains(&device);
    // SAFETY: the buffers outlive the plan and are of this device.
    unsafe {
        chains.exec.bind(chains.source, &device.wrap_buffer("source", source.raw, BYTES).unwrap()).unwrap();
        for (out, memory) in chains.outs.into_iter().zip(&outs) {
            chains.exec.bind(out, &device.wrap_buffer("out", memory.raw, BYTES).unwrap()).unwrap();
        }
    }
    let error = chains.exec.submit(&[]).unwrap_err();
    assert!(matches!(error, Error::NoQueue(_)), "{error}");
    let commands = host.begin();
    // SAFETY: everything is alive and of one device; the commands are run once, below.
    let recorded = unsafe { chains.exec.record_into(commands, &[]) }.unwrap();
    host.run(commands);
    for (memory, expected) in outs.iter().zip(expected()) {
        assert_eq!(bytemuck::pod_collect_to_vec::<u8, u32>(&host.read(memory, BYTES)), expected);
    }
    // SAFETY: `run` has waited.
    unsafe { recorded.release() };
    drop(chains);
    drop(device);
    for buffer in [source].into_iter().chain(outs) {
        host.destroy_buffer(buffer);
    }
}
