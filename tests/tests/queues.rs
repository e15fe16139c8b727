//! Two lanes on a real device, on two queues or on one: bit for bit what one lane does.

use sgs_engine::Location;
use sgs_engine::graph::exec::{ExecOptions, Executor};
use sgs_engine::graph::{Buffer, CompileOptions, Graph, Lane, Plan, Queues};
use sgs_tests::Gpu;
use std::sync::Arc;

const WORDS: u64 = 4096;

/// Chains of copies over slices of scratch, some with fills, that meet in the outputs.
fn build(seed: u64) -> (Graph, Vec<Buffer>) {
    let mut g = Graph::new("lanes");
    let bytes = 4 * WORDS;
    let source = g.input("source", bytes);
    let outs: Vec<Buffer> = (0..3).map(|i| g.external(format!("out{i}"), bytes)).collect();
    let state = g.external("state", bytes);
    let mut random = seed;
    let mut next = |below: u64| {
        random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (random >> 33) % below
    };
    g.copy("begin", source, state).unwrap();
    for chain in 0..3u64 {
        let mut last = state;
        for link in 0..2 + next(5) {
            let made = g.transient(format!("scratch{chain}.{link}"), bytes);
            let name = format!("chain{chain}.{link}");
            g.copy(format!("{name}.move"), last.slice(0, bytes - 4), made.slice(4, bytes - 4)).unwrap();
            g.fill(format!("{name}.front"), made.slice(0, 4), (chain * 100 + link) as u32).unwrap();
            last = made;
        }
        g.copy(format!("chain{chain}.end"), last, outs[chain as usize]).unwrap();
    }
    g.copy("turn", outs[1].slice(0, bytes / 2), state.slice(bytes / 2, bytes / 2)).unwrap();
    let all = outs.into_iter().chain([state]).collect();
    (g, all)
}

fn run(gpu: &Gpu, seed: u64, queues: Queues, timestamps: bool) -> (Arc<Plan>, Vec<Vec<u8>>) {
    let (g, outs) = build(seed);
    let plan = Arc::new(g.compile(&CompileOptions { queues, ..Default::default() }).unwrap());
    let options = ExecOptions { poison: true, timestamps, ..Default::default() };
    let mut exec = Executor::new(gpu.device(), plan.clone(), options).unwrap();
    let source = gpu.device().buffer("source", 4 * WORDS, Location::Device).unwrap();
    let words: Vec<u32> = (0..WORDS as u32).map(|word| word.wrapping_mul(2_654_435_761)).collect();
    gpu.device().upload(&source, 0, bytemuck::cast_slice(&words)).unwrap();
    exec.bind(plan.buffer(0), &source).unwrap();
    let memory: Vec<_> = outs
        .iter()
        .map(|&out| {
            let memory = gpu.device().buffer("out", 4 * WORDS, Location::Device).unwrap();
            exec.bind(out, &memory).unwrap();
            memory
        })
        .collect();
    for _ in 0..5 {
        exec.submit(&[]).unwrap();
    }
    exec.finish().unwrap();
    assert_eq!(exec.host_times().recordings, 2, "each slot is recorded once");
    if timestamps {
        assert!(exec.take_times().iter().all(|pass| pass.nanoseconds.len() == 5));
    }
    (plan, memory.iter().map(|m| gpu.device().download(m, 0, 4 * WORDS).unwrap()).collect())
}

#[test]
fn two_queues_match_one_queue() {
    let gpu = Gpu::new();
    println!("a second queue: {}", gpu.device().has_second_queue());
    for seed in 0..6 {
        let (one, expected) = run(&gpu, seed, Queues::One, false);
        let (two, found) = run(&gpu, seed, Queues::Forced, seed % 2 == 0);
        assert_eq!(one.segments.len(), 1);
        assert!(two.segments.iter().any(|segment| segment.lane == Lane::Side), "nothing to test in\n{two}");
        assert_eq!(found, expected, "{two}");
    }
}
