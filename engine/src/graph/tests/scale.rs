//! Compile and verify time of large graphs.

use std::time::{Duration, Instant};

use super::kernels::kernel;
use super::*;
use crate::shader::Access;

/// Builds a step of `passes` kernels with chains, sums and side branches. Each kernel accesses a few of several
/// hundred buffers.
pub(super) fn large(passes: usize) -> Graph {
    let mut graph = Graph::new("large");
    let bytes = |index: u64| 4096 * (1 + index * 7 % 31);
    let externals: Vec<_> = (0..40).map(|index| graph.external(format!("external{index}"), bytes(index))).collect();
    let transients: Vec<_> =
        (0..passes as u64 / 2).map(|index| graph.transient(format!("transient{index}"), bytes(index))).collect();
    let map = kernel("map", &[Access::Read, Access::Read, Access::Read, Access::Write]);
    let sum = kernel("sum", &[Access::Read, Access::Accumulate]);
    let update = kernel("update", &[Access::Read, Access::ReadWrite]);
    let mut ready: Vec<Buffer> = externals[..4].to_vec();
    let mut random = 1u64;
    let mut next = |below: usize| {
        random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (random >> 33) as usize % below
    };
    for index in 0..passes {
        // Mostly uses recent buffers, sometimes an old one.
        let recent = ready.len().saturating_sub(12);
        let mut pick =
            || if next(8) == 0 { ready[next(ready.len())] } else { ready[recent + next(ready.len() - recent)] };
        let [a, b, c] = [pick(), pick(), pick()];
        let external = externals[4 + next(36)];
        let name = format!("pass{index}");
        match index % 4 {
            0 | 1 => {
                let made = transients[(index / 4 * 2 + index % 4) % transients.len()];
                let c = if c == made { a } else { c };
                if [a, b, c].contains(&made) {
                    graph.fill(name, made, 0).unwrap();
                } else {
                    let pass = graph.pass(name, &map).bind("b0", a).bind("b1", b).bind("b2", c).bind("b3", made);
                    pass.dispatch([64, 1, 1]).unwrap();
                }
                ready.push(made);
            }
            2 => graph.pass(name, &sum).bind("b0", a).bind("b1", external).dispatch([64, 1, 1]).unwrap(),
            _ => graph.pass(name, &update).bind("b0", b).bind("b1", external).dispatch([64, 1, 1]).unwrap(),
        }
    }
    graph
}

fn measure(passes: usize, verify_too: bool) -> (Duration, Plan) {
    let graph = large(passes);
    let options = CompileOptions { verify: verify_too, ..Default::default() };
    let start = Instant::now();
    let plan = graph.compile(&options).unwrap();
    (start.elapsed(), plan)
}

#[test]
fn thousand_passes_compile_quickly() {
    let (alone, plan) = measure(1000, false);
    let (verified, _) = measure(1000, true);
    println!(
        "1000 passes: {alone:?}, with proof {verified:?}; {} groups, {} dropped, arena {} of {}",
        plan.groups.len(),
        plan.culled.len(),
        plan.arena_bytes,
        plan.arena_unaliased_bytes
    );
    assert!(plan.culled.len() < 500, "the graph is not trivial");
    assert!(plan.arena_bytes < plan.arena_unaliased_bytes);
    // Milliseconds in an optimized build; the bound allows for a slow, shared machine.
    assert!(alone < Duration::from_millis(500), "compiling took {alone:?}");
    assert!(verified < Duration::from_millis(1000), "compiling and proving took {verified:?}");
}

#[test]
fn five_thousand_passes_compile_in_seconds() {
    let (verified, _) = measure(5000, true);
    println!("5000 passes, with proof: {verified:?}");
    assert!(verified < Duration::from_secs(5), "compiling and proving took {verified:?}");
}
