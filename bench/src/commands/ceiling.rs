//! Peak rates measured on the device: `engine-bench ceiling`.
//!
//! Other commands report fractions of this ceiling.

use crate::ceiling::Ceiling;
use crate::common::Common;
use crate::harness::{Rig, bytes};
use crate::report::Report;
use crate::stats::Summary;
use sgs_engine::Device;
use sgs_engine::graph::{Graph, GraphError};
use sgs_passes::kernel::{groups, stage};
use sgs_shaders::{atomic_probe, copy_probe, fill, fma_probe};

/// Invocations per workgroup of the probes.
const WORKGROUP: u32 = 256;

/// Operations per invocation and round of `fma_probe`.
const PROBE_OPERATIONS: f64 = 128.0;

/// Atomic additions per invocation.
const ATOMIC_ROUNDS: u32 = 64;

/// Words from one round of `atomic_probe` to the next.
///
/// An odd number of workgroups, so that a workgroup meets no word twice.
const ATOMIC_STRIDE: u32 = 10_368_889 * WORKGROUP;

/// Minimum number of repetitions. On a shared machine, some of them run undisturbed.
const REPEATS: u32 = 24;

/// Returns bytes of a copy, invocations of the probes, and rounds of `fma_probe`.
///
/// On a GPU this is some milliseconds of work. On a CPU it is little enough that some repetitions run without an
/// interruption.
fn sizes(device: &Device) -> (u64, u32, u32) {
    // Larger than caches, yet the copied range still fits in one storage binding.
    let (bytes, invocations, rounds) =
        if device.info().kind == "cpu" { (64 << 20, 1 << 14, 64) } else { (256 << 20, 1 << 20, 1024) };
    (u64::min(bytes, device.info().max_storage_range / 256 * 256), invocations, rounds)
}

/// Measures the ceiling of a device: the best of several repetitions.
///
/// Disturbances only make a device slower, so the best repetition is the least disturbed.
///
/// # Errors
/// If the device fails, or a probe's result is wrong.
pub fn measure_ceiling(device: &Device) -> anyhow::Result<Ceiling> {
    let (size, invocations, rounds) = sizes(device);
    let (warmup, repeats) = (1, REPEATS);
    let copy_bytes_per_second = 2.0 * size as f64 / copy(device, size, warmup, repeats)?.least;
    let fill_bytes_per_second = size as f64 / fill_kernel(device, size, warmup, repeats / 4)?.least;
    let copy_kernel_bytes_per_second = 2.0 * size as f64 / copy_kernel(device, size, warmup, repeats / 4)?.least;
    let operations = PROBE_OPERATIONS * f64::from(invocations) * f64::from(rounds);
    let operations_per_second = operations / multiply_adds(device, invocations, rounds, warmup, repeats)?.least;
    let additions = f64::from(invocations) * f64::from(ATOMIC_ROUNDS);
    let atomics_per_second = additions / atomic_adds(device, invocations, warmup, repeats)?.least;
    let (few, many) = (8, 72);
    let [low, high] = [few, many].map(|count| dispatches(device, count, true, warmup, repeats));
    Ok(Ceiling {
        dispatch_seconds: 1e-9 * ((high? - low?) / f64::from(many - few)).max(0.0),
        bytes_per_second: copy_bytes_per_second.max(fill_bytes_per_second).max(copy_kernel_bytes_per_second),
        operations_per_second,
        copy_bytes_per_second,
        fill_bytes_per_second,
        copy_kernel_bytes_per_second,
        atomics_per_second,
    })
}

/// Returns seconds of the only pass of a graph.
///
/// Uses the device's clock, or the host's if the device has no timestamps.
fn seconds(rig: &mut Rig, warmup: u32, repeats: u32) -> anyhow::Result<Summary> {
    let (times, wall) = rig.measure(warmup, repeats)?;
    let samples = times.first().map(|t| t.nanoseconds.clone()).filter(|s| !s.is_empty()).unwrap_or(wall);
    Ok(Summary::of(&samples).scaled(1e-9))
}

fn copy(device: &Device, size: u64, warmup: u32, repeats: u32) -> anyhow::Result<Summary> {
    let mut g = Graph::new("copy");
    let (from, to) = (g.input("from", size), g.external("to", size));
    g.copy("copy", from, to)?;
    let pattern: Vec<u32> = (0..size as u32 / 4).collect();
    let mut rig = Rig::new(device, g, vec![(from, bytes(&pattern))], true)?;
    let time = seconds(&mut rig, warmup, repeats)?;
    anyhow::ensure!(rig.get::<u32>(to)? == pattern, "A copied buffer differs from its source.");
    Ok(time)
}

/// Measures a kernel that copies. Each invocation moves 16 bytes, the widest access of a device; the copy engine that
/// `vkCmdCopyBuffer` uses can be slower.
fn copy_kernel(device: &Device, size: u64, warmup: u32, repeats: u32) -> anyhow::Result<Summary> {
    let mut g = Graph::new("copy_kernel");
    let (source, target) = (g.input("source", size), g.external("target", size));
    let count = (size / 16) as u32;
    let bindings = copy_probe::Bindings { source: source.into(), target: target.into() };
    let push = copy_probe::Push { count };
    let specs = copy_probe::Specs { workgroup: WORKGROUP };
    stage(&mut g, "copy_probe", &copy_probe::KERNEL, bindings.entries(), specs.entries(), bytemuck::bytes_of(&push))
        .dispatch(groups(u64::from(count), WORKGROUP))?;
    let pattern: Vec<u32> = (0..size as u32 / 4).collect();
    let mut rig = Rig::new(device, g, vec![(source, bytes(&pattern))], true)?;
    let time = seconds(&mut rig, warmup, repeats)?;
    anyhow::ensure!(rig.get::<u32>(target)? == pattern, "The copy kernel's result differs from its source.");
    Ok(time)
}

fn add_fill(g: &mut Graph, name: &str, target: sgs_engine::graph::Slice, words: u32) -> Result<(), GraphError> {
    let bindings = fill::Bindings { target };
    let push = fill::Push { count: words, value: 7 };
    let specs = fill::Specs { workgroup: WORKGROUP };
    stage(g, name, &fill::KERNEL, bindings.entries(), specs.entries(), bytemuck::bytes_of(&push))
        .dispatch(groups(u64::from(words), WORKGROUP))
}

fn fill_kernel(device: &Device, size: u64, warmup: u32, repeats: u32) -> anyhow::Result<Summary> {
    let mut g = Graph::new("fill");
    let target = g.external("target", size);
    add_fill(&mut g, "fill", target.into(), (size / 4) as u32)?;
    let mut rig = Rig::new(device, g, vec![], true)?;
    let time = seconds(&mut rig, warmup, repeats)?;
    anyhow::ensure!(rig.get::<u32>(target)?.iter().all(|&w| w == 7), "The fill kernel left words out.");
    Ok(time)
}

fn multiply_adds(device: &Device, invocations: u32, rounds: u32, warmup: u32, repeats: u32) -> anyhow::Result<Summary> {
    let mut g = Graph::new("multiply_adds");
    let result = g.external("result", 4 * u64::from(invocations));
    let bindings = fma_probe::Bindings { result: result.into() };
    // The chains converge to summand / (1 - factor) = 4; the sum of eight lanes is 32.
    let push = fma_probe::Push { rounds, factor: 0.75, summand: 1.0 };
    let specs = fma_probe::Specs { workgroup: WORKGROUP };
    stage(&mut g, "fma_probe", &fma_probe::KERNEL, bindings.entries(), specs.entries(), bytemuck::bytes_of(&push))
        .dispatch(groups(u64::from(invocations), WORKGROUP))?;
    let mut rig = Rig::new(device, g, vec![], true)?;
    let time = seconds(&mut rig, warmup, repeats)?;
    let right = rig.get::<f32>(result)?.iter().all(|&v| (v - 32.0).abs() < 1e-3);
    anyhow::ensure!(right, "The arithmetic probe's chains did not converge.");
    Ok(time)
}

/// Measures atomic additions to as many words as invocations, a power of two.
///
/// Neighboring invocations add to neighboring words, so that no two of a subgroup meet in a word.
fn atomic_adds(device: &Device, words: u32, warmup: u32, repeats: u32) -> anyhow::Result<Summary> {
    let mut g = Graph::new("atomic_adds");
    let sums = g.external("sums", 4 * u64::from(words));
    let bindings = atomic_probe::Bindings { sums: sums.into() };
    let push = atomic_probe::Push { words, rounds: ATOMIC_ROUNDS, stride: ATOMIC_STRIDE };
    let specs = atomic_probe::Specs { workgroup: WORKGROUP };
    stage(
        &mut g,
        "atomic_probe",
        &atomic_probe::KERNEL,
        bindings.entries(),
        specs.entries(),
        bytemuck::bytes_of(&push),
    )
    .dispatch(groups(u64::from(words), WORKGROUP))?;
    let mut rig = Rig::new(device, g, vec![], true)?;
    let time = seconds(&mut rig, warmup, repeats)?;
    // The buffer starts with zeros, and each replay adds to its sums.
    let expected = ATOMIC_ROUNDS * (warmup.max(1) + repeats);
    anyhow::ensure!(rig.get::<u32>(sums)?.iter().all(|&w| w == expected), "The atomic probe's sums are wrong.");
    Ok(time)
}

/// Returns nanoseconds of a replay of `count` tiny dispatches.
///
/// They run one after the other if `ordered`, else concurrently. The minimum is returned, since the overhead is a
/// constant.
fn dispatches(device: &Device, count: u32, ordered: bool, warmup: u32, repeats: u32) -> anyhow::Result<f64> {
    let mut g = Graph::new("dispatches");
    let target = g.external("target", 256 * u64::from(count));
    for i in 0..count {
        let at = if ordered { 0 } else { 256 * u64::from(i) };
        add_fill(&mut g, &format!("fill{i}"), target.slice(at, 256), 64)?;
    }
    let mut rig = Rig::new(device, g, vec![], false)?;
    let barriers = rig.plan().groups.len() as u32;
    anyhow::ensure!(barriers == if ordered { count } else { 1 }, "The plan has {barriers} groups.");
    let (_, wall) = rig.measure(warmup, repeats.max(REPEATS))?;
    Ok(Summary::of(&wall).least)
}

/// Runs the command.
///
/// # Errors
/// If the device fails or a probe's result is wrong.
pub fn run(common: &Common) -> anyhow::Result<()> {
    let device = common.open_device()?;
    let mut report = common.report("ceiling", &device);
    let (size, invocations, rounds) = sizes(&device);
    report.setting("copy bytes", size);
    report.setting("probe invocations", invocations);
    report.setting("probe rounds", rounds);
    let (warmup, repeats) = (common.warmup, common.repeats);
    let ceiling = measure_ceiling(&device)?;
    report.ceiling = Some(ceiling);
    report.time("vkCmdCopyBuffer", "ms", copy(&device, size, warmup, repeats)?.scaled(1e3));
    report.time("copy kernel", "ms", copy_kernel(&device, size, warmup, repeats)?.scaled(1e3));
    report.time("fill kernel", "ms", fill_kernel(&device, size, warmup, repeats)?.scaled(1e3));
    let probe = multiply_adds(&device, invocations, rounds, warmup, repeats)?;
    report.time("multiply-adds", "ms", probe.scaled(1e3));
    report.time("atomic additions", "ms", atomic_adds(&device, invocations, warmup, repeats)?.scaled(1e3));
    report.fact("copy, GB/s read and written", ceiling.copy_bytes_per_second / 1e9);
    report.fact("copy kernel, GB/s read and written", ceiling.copy_kernel_bytes_per_second / 1e9);
    report.fact("fill kernel, GB/s written", ceiling.fill_bytes_per_second / 1e9);
    report.fact("multiply-adds, G operations/s", ceiling.operations_per_second / 1e9);
    report.fact("atomic additions, G/s", ceiling.atomics_per_second / 1e9);
    overheads(&device, &mut report, warmup, repeats)?;
    report.check("copies, fill and probes left what they should");
    common.finish(&report, &device)
}

/// Adds the overhead of a dispatch, a barrier and a submission without work.
fn overheads(device: &Device, report: &mut Report, warmup: u32, repeats: u32) -> anyhow::Result<()> {
    let (few, many) = (32, 512);
    let slope = |ordered: bool| -> anyhow::Result<f64> {
        let low = dispatches(device, few, ordered, warmup, repeats)?;
        let high = dispatches(device, many, ordered, warmup, repeats)?;
        Ok((high - low) / f64::from(many - few))
    };
    let (free, ordered) = (slope(false)?, slope(true)?);
    report.fact("a dispatch, us", free / 1e3);
    report.fact("a barrier, us", (ordered - free) / 1e3);
    let one = dispatches(device, 1, false, warmup, repeats)?;
    report.fact("a submission and the wait for it, us", one / 1e3);
    Ok(())
}
