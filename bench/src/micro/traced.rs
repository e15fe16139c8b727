//! `visibility_traced`: how much of four places a surface across the Gaussians sees, and the twin's product over all of
//! them for some rays.

use super::Context;
use crate::cost::Counts;
use crate::harness::{Rig, add_passes, bytes};
use crate::report::Report;
use sgs_engine::graph::Graph;
use sgs_passes::reference::rng::Pcg;
use sgs_passes::reference::traced::{self as twin, Splat};
use sgs_passes::scene::Group;
use sgs_passes::shade::Surfaces;
use sgs_passes::shade::traced::{TracedTree, visibility_traced};
use sgs_passes::splat::Screen;
use sgs_shaders::structs::Step;
use std::time::Instant;

/// Places that are looked at.
const PLACES: u32 = 4;
/// Rays that the twin follows.
const CHECKED: usize = 64;

/// A view's worth of rays.
pub fn one(c: &Context<'_>, report: &mut Report) -> anyhow::Result<()> {
    let start = &c.workload.start;
    let begin = Instant::now();
    let tree = TracedTree::new(start)?;
    report.fact("traced: building the tree, ms", begin.elapsed().as_secs_f64() * 1e3);
    report.fact("traced: the tree, bytes a Gaussian", tree.bytes() as f64 / start.len() as f64);
    let mut rng = Pcg::new(17);
    let count = (c.workload.largest[0] * c.workload.largest[1]) as usize;
    let means = start.group(Group::Means);
    // Across the middle of what there is, so that neighbors see alike, as the surfaces of a view do.
    let bound =
        |pick: fn(f32, f32) -> f32, k: usize| means.iter().skip(k).step_by(3).copied().reduce(pick).unwrap_or(0.0);
    let [low, high] = [f32::min, f32::max].map(|pick| [0, 1, 2].map(|k| bound(pick, k)));
    let between = |k: usize, t: f32| low[k] + t * (high[k] - low[k]);
    let [width, height] = c.workload.largest;
    let points: Vec<f32> = (0..count as u32)
        .flat_map(|i| {
            let (x, y) = ((i % width) as f32 / width as f32, (i / width) as f32 / height as f32);
            [between(0, 0.1 + 0.8 * x), between(1, 0.1 + 0.8 * y), between(2, 0.5 + 0.2 * (6.0 * x).sin())]
        })
        .collect();
    let places: Vec<f32> =
        (0..PLACES).flat_map(|_| [0, 1, 2].map(|k| between(k, rng.range(0.2, 0.8) as f32))).collect();
    let mut g = Graph::new("traced");
    let n = count as u64;
    let step = g.uniform("step", size_of::<Step>() as u64);
    let [point_buffer, normals] = ["points", "normals"].map(|name| g.input(name, 12 * n));
    let coverage = g.input("coverage", 4 * n);
    let place_buffer = g.input("places", 4 * places.len() as u64);
    let visibility = g.external("visibility", 4 * n * u64::from(PLACES));
    let screen = Screen { step, largest: c.workload.largest, tile: c.tuning.tile };
    let surfaces = Surfaces { points: point_buffer, normals, coverage };
    let traced = tree.declare(&mut g, 0.0);
    visibility_traced(&mut g, &c.tuning, &screen, &surfaces, &traced, (place_buffer, PLACES), visibility)?;
    let mut values = Step::default();
    values.camera.size = c.workload.largest;
    let mut inputs = vec![
        (step, bytes(&[values])),
        (point_buffer, bytes(&points)),
        (coverage, bytes(&vec![1.0_f32; count])),
        (place_buffer, bytes(&places)),
    ];
    inputs.extend(tree.contents(&traced));
    let mut rig = Rig::new(c.device, g, inputs, true)?;
    let (times, _) = rig.measure(c.warmup, c.repeats)?;
    let rays = count as f64 * f64::from(PLACES);
    let counts = Counts { pixels: rays, gaussians: start.len() as f64, ..Default::default() };
    add_passes(report, rig.plan(), &times, &counts, &c.ceiling);

    let three = |v: &[f32], i: usize| [v[3 * i], v[3 * i + 1], v[3 * i + 2]].map(f64::from);
    let splats: Vec<Splat> = (0..start.len())
        .map(|i| Splat {
            mean: three(means, i),
            log_scale: three(start.group(Group::LogScales), i),
            rotation: std::array::from_fn(|k| f64::from(start.group(Group::Rotations)[4 * i + k])),
            opacity_logit: f64::from(start.group(Group::OpacityLogits)[i]),
        })
        .collect();
    let found: Vec<f32> = rig.get(visibility)?;
    let mut off = 0;
    for k in 0..CHECKED {
        let (place, pixel) = (k % PLACES as usize, rng.next_u32() as usize % count);
        let expected = twin::transmittance(&splats, three(&points, pixel), three(&places, place));
        off += usize::from((expected - f64::from(found[place * count + pixel])).abs() > 2e-3);
    }
    // A Gaussian may be in or out by rounding where its alpha is 1/255 or it peaks at an end.
    anyhow::ensure!(off <= CHECKED / 10, "{off} of {CHECKED} rays see something else than the twin's.");
    report.check(format!("traced: {} of {CHECKED} rays see what the twin's do", CHECKED - off));
    Ok(())
}
