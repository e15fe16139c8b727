//! Benchmark of sub-tiles in blending: `blend` and `blend_bwd` with each shape of slots, trying all or only those touched.
//!
//! All variants must blend the same image, bit for bit. The share of slots left is counted for every subgroup size. Then
//! several subgroups per tile are measured ([`super::tile_parts`]).

use super::Context;
use super::blend::subject;
use super::view::{Subject, overlap_of};
use crate::harness::{Rig, bytes};
use crate::report::Report;
use crate::stats::median;
use anyhow::ensure;
use sgs_engine::graph::Buffer;
use sgs_passes::Tuning;
use sgs_passes::splat::{BackwardKernel, Blended, blend, blend_bwd, blend_debt};

/// Rounds in which the variants take turns.
const ROUNDS: u32 = 5;

/// Measures every variant and counts the slots.
pub fn all(c: &Context<'_>, report: &mut Report) -> anyhow::Result<()> {
    let t = c.tuning;
    // Rows of the tile, and blocks.
    let mut widths = vec![t.tile[0], t.slot_width, 4];
    widths.sort_unstable();
    widths.dedup();
    widths.retain(|w| t.subgroup_size / w <= t.tile[1]);
    let variants: Vec<Tuning> = widths
        .iter()
        .flat_map(|&slot_width| [false, true].map(|sub_tiles| Tuning { slot_width, sub_tiles, ..t }))
        .collect();
    let mut rigs = variants.iter().map(|t| build(c, *t)).collect::<anyhow::Result<Vec<_>>>()?;
    let mut times = vec![[vec![], vec![]]; variants.len()];
    for round in 0..ROUNDS {
        for ((rig, _), times) in rigs.iter_mut().zip(&mut times) {
            let (passes, _) = rig.measure(if round == 0 { c.warmup } else { 1 }, c.repeats.div_ceil(ROUNDS))?;
            for (name, times) in ["blend", "blend_bwd"].into_iter().zip(times) {
                let found = passes.iter().filter(|p| p.name == name);
                times.extend(found.flat_map(|p| p.nanoseconds.iter().copied()));
            }
        }
    }
    for (t, [forward, backward]) in variants.iter().zip(&times) {
        let [columns, rows] = t.slot();
        let tried = if t.sub_tiles { "those touched" } else { "all" };
        report.fact(
            &format!("slots of {columns}x{rows}, {tried} tried: blend, blend_bwd, ms"),
            format!("{:.3}, {:.3}", median(forward) / 1e6, median(backward) / 1e6),
        );
    }
    let images = rigs.iter().map(|(rig, image)| rig.get::<u32>(*image)).collect::<anyhow::Result<Vec<_>>>()?;
    ensure!(images[0].iter().any(|v| *v != 0), "The image is black.");
    ensure!(images.iter().all(|image| *image == images[0]), "Slots change the image.");
    report.check(format!("sub-tiles: {} variants of slots blend the same image bit for bit", variants.len()));
    for lanes in [8, 16, 32, 64] {
        let of = Tuning::for_subgroups(lanes);
        // Nothing is blended, so tiles and slots may be those of other devices.
        let o = overlap_of(&counted(c, Tuning { tile: of.tile, ..t }), of.slot())?;
        let [columns, rows] = of.slot();
        report.fact(
            &format!("{lanes} lanes: slots of {columns}x{rows} left, pixels where an entry shows"),
            format!("{:.1} %, {:.1} %", 100.0 * o.slots, 100.0 * o.showing / f64::from(of.tile[0] * of.tile[1])),
        );
    }
    super::tile_parts::all(c, report)
}

/// Returns the view with another tuning.
fn counted<'s>(c: &'s Context<'_>, tuning: Tuning) -> Subject<'s> {
    Subject { tuning, ..subject(c) }
}

/// Builds the passes of one variant. Returns its image, too.
fn build(c: &Context<'_>, t: Tuning) -> anyhow::Result<(Rig, Buffer)> {
    let s = counted(c, t);
    let channels = u64::from(s.channels.count());
    s.rig(|v| {
        let pixels = v.screen.pixels();
        let into = Blended {
            image: v.graph.external("image", 4 * channels * pixels),
            transmittance: v.graph.external("transmittance", 4 * pixels),
        };
        blend(&mut v.graph, &t, &v.screen, &v.visible, &v.entries, &into)?;
        let gradient = Blended {
            image: v.graph.input("grad_image", 4 * channels * pixels),
            transmittance: v.graph.input("grad_transmittance", 4 * pixels),
        };
        v.inputs.push((gradient.image, bytes(&vec![0.5_f32; (channels * pixels) as usize])));
        let owed = blend_debt(&mut v.graph, &t, &v.screen, s.channels.count(), &into, &gradient)?;
        let which = BackwardKernel::Pixel;
        let sums = blend_bwd(&mut v.graph, &t, &v.screen, &v.visible, &v.entries, &owed, which, false)?;
        v.keep("entry_gradients", sums.gradients, 4 * (6 + channels))?;
        Ok(into.image)
    })
}
