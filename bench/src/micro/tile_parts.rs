//! Benchmark of several subgroups per tile: `blend` and `blend_buckets` with 1, 2, 4 and 8 parts of a tile.
//!
//! All variants must blend the same image: bit for bit on a CPU, and but for rounding on a GPU, whose compiler may round each
//! kernel differently. Small views (`--size 426x320`, `--size 160x120`) gain most.

use super::Context;
use super::blend::subject;
use super::view::Subject;
use crate::harness::Rig;
use crate::report::Report;
use crate::stats::median;
use anyhow::ensure;
use sgs_engine::graph::Buffer;
use sgs_passes::Tuning;
use sgs_passes::splat::{BackwardKernel, Blended, blend, blend_for};

/// Rounds in which the variants take turns.
const ROUNDS: u32 = 5;

/// Passes that are timed.
const PASSES: [&str; 2] = ["blend", "blend_buckets"];

/// Variant of the forward pass.
struct Variant {
    rig: Rig,
    /// Image and transmittance of both passes.
    outputs: [[Buffer; 2]; 2],
    /// Parts of a tile.
    parts: u32,
    times: [Vec<f64>; 2],
}

/// Measures every number of parts that the slots of a tile allow.
pub(super) fn all(c: &Context<'_>, report: &mut Report) -> anyhow::Result<()> {
    let mut variants: Vec<Variant> = Vec::new();
    for parts in [1, 2, 4, 8] {
        let variant = build(c, Tuning { tile_parts: Some(parts), ..c.tuning })?;
        if variant.parts == parts {
            variants.push(variant);
        }
    }
    for round in 0..ROUNDS {
        for v in &mut variants {
            let (passes, _) = v.rig.measure(if round == 0 { c.warmup } else { 1 }, c.repeats.div_ceil(ROUNDS))?;
            for (name, times) in PASSES.into_iter().zip(&mut v.times) {
                let found = passes.iter().filter(|p| p.name == name);
                times.extend(found.flat_map(|p| p.nanoseconds.iter().copied()));
            }
        }
    }
    let automatic = build(c, c.tuning)?.parts;
    report.fact("subgroups per tile, chosen for the view and the device", automatic);
    for v in &variants {
        report.fact(
            &format!("subgroups per tile: {}: blend, blend_buckets, ms", v.parts),
            format!("{:.3}, {:.3}", median(&v.times[0]) / 1e6, median(&v.times[1]) / 1e6),
        );
    }
    let read = |v: &Variant, pass: usize| -> anyhow::Result<[Vec<u32>; 2]> {
        let [image, transmittance] = v.outputs[pass];
        Ok([v.rig.get(image)?, v.rig.get(transmittance)?])
    };
    let expected = read(&variants[0], 0)?;
    ensure!(expected[0].iter().any(|v| *v != 0), "The image is black.");
    let mut largest = 0.0_f32;
    for v in &variants {
        for pass in 0..PASSES.len() {
            for (found, expected) in read(v, pass)?.iter().zip(&expected) {
                let pairs = found.iter().zip(expected).map(|(a, b)| [*a, *b].map(f32::from_bits));
                largest = pairs.fold(largest, |most, [a, b]| if (a - b).abs() <= most { most } else { (a - b).abs() });
            }
        }
    }
    let bound = if c.tuning.cpu { 0.0 } else { 1e-4 };
    ensure!(largest <= bound, "The number of subgroups per tile changes the image by {largest:e}.");
    let most = variants.last().map_or(1, |v| v.parts);
    report.check(format!("sub-tiles: images of 1 to {most} subgroups per tile differ by {largest:e} at most"));
    Ok(())
}

/// Builds both passes with a tuning.
fn build(c: &Context<'_>, t: Tuning) -> anyhow::Result<Variant> {
    let s = Subject { tuning: t, ..subject(c) };
    let channels = u64::from(s.channels.count());
    let (rig, (outputs, parts)) = s.rig(|v| {
        let pixels = v.screen.pixels();
        let mut into = |name: &str| Blended {
            image: v.graph.external(format!("{name}.image"), 4 * channels * pixels),
            transmittance: v.graph.external(format!("{name}.transmittance"), 4 * pixels),
        };
        let [plain, kept] = PASSES.map(&mut into);
        blend(&mut v.graph, &t, &v.screen, &v.visible, &v.entries, &plain)?;
        let which = BackwardKernel::Bucket;
        let buckets = blend_for(&mut v.graph, &t, &v.screen, &v.visible, &v.entries, &kept, which)?;
        let [width, height] = buckets.map_or(v.screen.tile, |b| b.part);
        let parts = v.screen.tile[0] / width * (v.screen.tile[1] / height);
        Ok(([plain, kept].map(|b| [b.image, b.transmittance]), parts))
    })?;
    Ok(Variant { rig, outputs, parts, times: [vec![], vec![]] })
}
