//! Executor on a real device: fills, kernels, copies, replay, alternating memory.

use sgs_engine::exec::{ExecOptions, Executor};
use sgs_engine::graph::{Buffer, CompileOptions, Graph};
use sgs_engine::{DeviceBuffer, Location};
use sgs_passes::kernel::{groups, stage};
use sgs_shaders::fill;
use sgs_tests::Gpu;
use std::sync::Arc;

#[test]
fn fill_kernel_writes_only_its_words() {
    let gpu = Gpu::new();
    let mut g = Graph::new("fill");
    let out = g.external("out", 4 * 1000);
    let bindings = fill::Bindings { target: out.into() }.entries();
    let push = fill::Push { count: 777, value: 42 };
    stage(&mut g, "fill", &fill::KERNEL, bindings, fill::Specs::default().entries(), bytemuck::bytes_of(&push))
        .dispatch(groups(777, 256))
        .unwrap();
    let words: Vec<u32> = gpu.run(g, &[]).get(out);
    assert!(words[..777].iter().all(|&w| w == 42));
    assert!(words[777..].iter().all(|&w| w == u32::MAX));
}

/// Returns an executor that copies two words, and the handles of both buffers.
fn copier(gpu: &Gpu, frames_in_flight: usize) -> (Executor, Buffer, Buffer) {
    let mut g = Graph::new("copy");
    let (source, target) = (g.input("source", 8), g.external("target", 8));
    g.copy("copy", source, target).unwrap();
    let plan = Arc::new(g.compile(&CompileOptions::default()).unwrap());
    let options = ExecOptions { frames_in_flight, ..Default::default() };
    (Executor::new(gpu.device(), plan, options).unwrap(), source, target)
}

fn word(gpu: &Gpu, value: u32) -> DeviceBuffer {
    let buffer = gpu.device().buffer("word", 8, Location::Device).unwrap();
    gpu.device().fill(&buffer, value).unwrap();
    buffer
}

/// Each combination of alternating memory is recorded once per slot.
#[test]
fn alternating_memory_is_recorded_once() {
    let gpu = Gpu::new();
    let (mut exec, source, target) = copier(&gpu, 2);
    let sources: Vec<DeviceBuffer> = (0..5).map(|i| word(&gpu, 10 + i)).collect();
    let targets: Vec<DeviceBuffer> = (0..3).map(|_| word(&gpu, 0)).collect();
    let replay = |exec: &mut Executor, i: usize, j: usize| {
        exec.alternate(source, &sources[i]).unwrap();
        exec.alternate(target, &targets[j]).unwrap();
        exec.submit(&[]).unwrap();
    };
    // Each combination in each of the two slots: 5, 3 and 2 have no common factor.
    (0..30).for_each(|n| replay(&mut exec, n % 5, n % 3));
    assert_eq!(exec.host_times().recordings, 30);
    for (n, target) in targets.iter().enumerate() {
        gpu.device().fill(target, 0).unwrap();
        replay(&mut exec, n + 1, n);
    }
    (30..60).for_each(|n| replay(&mut exec, n % 5, n % 3));
    exec.finish().unwrap();
    assert_eq!(exec.host_times().recordings, 30, "memory that was used before was recorded again");
    let read = |j: usize| gpu.device().download_as::<u32>(&targets[j], 1).unwrap()[0];
    assert_eq!([0, 1, 2].map(read), [57, 58, 59].map(|n: u32| 10 + n % 5));
    // Memory that is too small is refused and changes nothing.
    let small = gpu.device().buffer("small", 4, Location::Device).unwrap();
    assert!(exec.alternate(source, &small).is_err());
    exec.submit(&[]).unwrap();
    exec.finish().unwrap();
    assert_eq!(exec.host_times().recordings, 30);
    drop(exec);
}

/// Recordings keep alternating memory alive until other memory is bound.
#[test]
fn recordings_hold_alternating_memory() {
    let gpu = Gpu::new();
    let (mut exec, source, target) = copier(&gpu, 2);
    let out = word(&gpu, 0);
    exec.bind(target, &out).unwrap();
    let before = gpu.device().memory_use().0;
    for value in [7, 8, 9] {
        exec.alternate(source, &word(&gpu, value)).unwrap();
        exec.submit(&[]).unwrap();
    }
    exec.finish().unwrap();
    assert_eq!(gpu.device().download_as::<u32>(&out, 1).unwrap(), [9]);
    let held = gpu.device().memory_use().0;
    assert!(held > before, "memory in use was freed: {held} {before}");
    let last = word(&gpu, 4);
    let one = gpu.device().memory_use().0 - held;
    exec.bind(source, &last).unwrap();
    assert_eq!(gpu.device().memory_use().0, before + one, "only the new memory is in use");
    exec.submit(&[]).unwrap();
    exec.finish().unwrap();
    assert_eq!(gpu.device().download_as::<u32>(&out, 1).unwrap(), [4]);
}

/// Beyond the limit, the least recently used recording makes room.
#[test]
fn recordings_are_limited() {
    let gpu = Gpu::new();
    let (mut exec, source, target) = copier(&gpu, 1);
    let out = word(&gpu, 0);
    exec.bind(target, &out).unwrap();
    let limit = Executor::MOST_RECORDINGS as u32;
    let sources: Vec<DeviceBuffer> = (0..limit + 1).map(|i| word(&gpu, i)).collect();
    let mut replay = |i: usize| {
        exec.alternate(source, &sources[i]).unwrap();
        exec.submit(&[]).unwrap();
        exec.finish().unwrap();
        assert_eq!(gpu.device().download_as::<u32>(&out, 1).unwrap(), [i as u32]);
        exec.host_times().recordings
    };
    (0..limit as usize).for_each(|i| assert_eq!(replay(i), i as u64 + 1));
    let limit = u64::from(limit);
    assert_eq!(replay(0), limit);
    // The new recording replaces number 1, which in turn replaces number 2.
    assert_eq!(replay(limit as usize), limit + 1);
    assert_eq!(replay(0), limit + 1);
    assert_eq!(replay(1), limit + 2);
    assert_eq!(replay(3), limit + 2);
    assert_eq!(replay(2), limit + 3);
}
