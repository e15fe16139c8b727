//! Conditional passes on a real device: words that the device wrote, switches of the host.

use sgs_engine::graph::exec::{ExecOptions, Executor};
use sgs_engine::graph::{Buffer, CompileOptions, Graph, Slice, Switch};
use sgs_engine::{DeviceBuffer, Location};
use sgs_passes::kernel::{gate, shader};
use sgs_shaders::fill;
use sgs_tests::Gpu;
use std::sync::Arc;

/// Declares a pass that fills 256 words with `value` if `word` is not zero.
fn fill_if(g: &mut Graph, name: &str, target: Slice, value: u32, word: impl Into<Slice>, counts: Option<Buffer>) {
    let push = fill::Push { count: 256, value };
    let pass = g.pass(name, &shader(&fill::KERNEL)).bind_discard("target", target).push(bytemuck::bytes_of(&push));
    let specs = fill::Specs::default().entries();
    let pass = specs.into_iter().fold(pass.when(word), |pass, (name, bits)| pass.spec(name, bits));
    match counts {
        Some(counts) => pass.dispatch_indirect(counts, 4),
        None => pass.dispatch([1, 1, 1]),
    }
    .unwrap();
}

struct World {
    exec: Executor,
    out: DeviceBuffer,
    switch: Switch,
}

/// Builds four ranges of 256 words under four conditions.
///
/// A word that is set, a word that is not, the same with counts from a buffer, and a switch.
fn world(gpu: &Gpu) -> World {
    let mut g = Graph::new("conditions");
    g.set_gate(&gate());
    let out = g.external("out", 4 * 256 * 4);
    let words = g.transient("words", 1024);
    let counts = g.input("counts", 16);
    let switch = g.switch("switch");
    g.fill("zero", out, 0).unwrap();
    g.fill("off", words, 0).unwrap();
    g.fill("on", words.slice(260, 4), 3).unwrap();
    let part = |i: u64| out.slice(1024 * i, 1024);
    fill_if(&mut g, "set", part(0), 10, words.slice(260, 4), None);
    fill_if(&mut g, "unset", part(1), 20, words.slice(264, 4), None);
    fill_if(&mut g, "counted", part(2), 30, words.slice(260, 4), Some(counts));
    fill_if(&mut g, "switched", part(3), 40, switch, None);
    fill_if(&mut g, "counted_unset", part(2), 50, words.slice(0, 4), Some(counts));
    let plan = Arc::new(g.compile(&CompileOptions::default()).unwrap());
    let mut exec = Executor::new(gpu.device(), plan, ExecOptions { poison: true, ..Default::default() }).unwrap();
    let memory = gpu.device().buffer("counts", 16, Location::Device).unwrap();
    gpu.device().upload(&memory, 0, bytemuck::cast_slice(&[9u32, 1, 1, 1])).unwrap();
    exec.bind(counts, &memory).unwrap();
    let memory = gpu.device().buffer("out", 4096, Location::Device).unwrap();
    exec.bind(out, &memory).unwrap();
    World { exec, out: memory, switch }
}

fn parts(gpu: &Gpu, out: &DeviceBuffer) -> [u32; 4] {
    let words = gpu.device().download_as::<u32>(out, 1024).unwrap();
    std::array::from_fn(|part| {
        let words = &words[256 * part..256 * part + 256];
        assert!(words.iter().all(|word| *word == words[0]), "part {part} is in two states");
        words[0]
    })
}

#[test]
fn passes_run_if_their_word_is_set() {
    let gpu = Gpu::new();
    let mut w = world(&gpu);
    w.exec.submit(&[]).unwrap();
    w.exec.finish().unwrap();
    assert_eq!(parts(&gpu, &w.out), [10, 0, 30, 40]);
}

#[test]
fn switches_need_no_new_recording() {
    let gpu = Gpu::new();
    let mut w = world(&gpu);
    for on in [true, false, false, true, true, false] {
        w.exec.set_switch(w.switch, on);
        w.exec.submit(&[]).unwrap();
        w.exec.finish().unwrap();
        assert_eq!(parts(&gpu, &w.out), [10, 0, 30, if on { 40 } else { 0 }]);
    }
    assert_eq!(w.exec.host_times().recordings, 2);
}
