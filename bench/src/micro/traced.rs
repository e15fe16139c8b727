//! Benchmark of traced visibility.
//!
//! First `visibility_traced`: rays from a surface across the Gaussians to four points. Some rays are checked against
//! the product of the reference. Then `lights_train_traced` and `lights_bwd_traced`: a room under eight lights with
//! Gaussian occluders.

use super::Context;
use super::lights::{CAMERA, Lit, bind};
use crate::harness::{Rig, add_passes, bytes};
use crate::report::Report;
use sgs_engine::graph::Graph;
use sgs_passes::cost::Counts;
use sgs_passes::reference::lights as lights_reference;
use sgs_passes::reference::rng::Pcg;
use sgs_passes::reference::traced::{self as reference, Splat};
use sgs_passes::scene::{GaussianData, Group};
use sgs_passes::shade::Surfaces;
use sgs_passes::shade::lights::{
    LightModel, LightParameterGradients, Lights, Shape, lights_prepare, lights_prepare_bwd,
};
use sgs_passes::shade::traced::{TracedTree, lights_bwd_traced, lights_train_traced, visibility_traced};
use sgs_passes::splat::Screen;
use sgs_shaders::structs::Step;
use std::time::Instant;

/// Number of target points of the rays.
const PLACES: u32 = 4;
/// Number of lights in the room.
const LIGHTS: u32 = 8;
/// Number of Gaussian occluders in the room.
const HIDING: usize = 4000;
/// Approximate number of rays or pixels that the reference evaluates.
const CHECKED: usize = 64;

/// Measures both.
pub fn one(c: &Context<'_>, report: &mut Report) -> anyhow::Result<()> {
    rays(c, report)?;
    lights(c, report)
}

/// Returns spherical occluders for the kernels and for the reference.
fn hiding() -> (GaussianData, Vec<Splat>) {
    let mut rng = Pcg::new(23);
    let narrow = |x: f64| f64::from(x as f32);
    let (mut data, mut splats) = (GaussianData::default(), Vec::new());
    for _ in 0..HIDING {
        let s = Splat {
            mean: [0; 3].map(|_| narrow(rng.range(-1.4, 1.4))),
            log_scale: [narrow(rng.range(-4.5, -3.0)); 3],
            rotation: [1.0, 0.0, 0.0, 0.0],
            opacity_logit: narrow(rng.range(-2.0, 3.0)),
        };
        data.groups[Group::Means as usize].extend(s.mean.map(|x| x as f32));
        data.groups[Group::LogScales as usize].extend(s.log_scale.map(|x| x as f32));
        data.groups[Group::Rotations as usize].extend(s.rotation.map(|x| x as f32));
        data.groups[Group::OpacityLogits as usize].push(s.opacity_logit as f32);
        splats.push(s);
    }
    (data, splats)
}

/// Measures shading and its gradient with all pairs of a room traced.
fn lights(c: &Context<'_>, report: &mut Report) -> anyhow::Result<()> {
    let (size, model) = (c.workload.largest, LightModel { lights: LIGHTS, ..Default::default() });
    let (lit, (data, splats)) = (Lit::room(size, model), hiding());
    let tree = TracedTree::new(&data)?;
    let mut g = Graph::new("lights_traced");
    let mut b = bind(&mut g, &lit, size, model);
    let n = lit.points.len();
    let traced = tree.declare(&mut g, 0.0);
    b.inputs.extend(tree.contents(&traced));
    let step = b.pixels.screen.step;
    let prepared = lights_prepare(&mut g, c.tuning, "lights_prepare", step, model, &b.parameters, None)?;
    let shape = Shape::for_device(c.tuning);
    let what = Lights { pixels: b.pixels, prepared, normalizer: 1.0 / LIGHTS as f32, shape };
    let direct = g.external("direct", 12 * n as u64);
    let (_, sight) = lights_train_traced(&mut g, &what, &traced, direct)?;
    let gradients = lights_bwd_traced(&mut g, c.tuning, &what, &traced, &sight, b.gradient)?;
    let into = LightParameterGradients {
        positions: g.external("positions_gradient", model.position_bytes()),
        lobes: g.external("lobes_gradient", model.lobe_bytes()),
    };
    lights_prepare_bwd(&mut g, &prepared, &b.parameters, &gradients, None, &into)?;
    let mut rig = Rig::new(c.device, g, b.inputs, true)?;
    let (times, _) = rig.measure(c.warmup, c.repeats)?;
    let counts =
        Counts { pixels: n as f64, lights: f64::from(LIGHTS), gaussians: tree.splats() as f64, ..Default::default() };
    add_passes(report, rig.plan(), &times, &counts, &c.ceiling);

    let found: Vec<f32> = rig.get(direct)?;
    let ready = lights_reference::lights_prepare(&lit.raw(model));
    let (mut off, mut checked) = (0, 0);
    for i in (0..n).step_by((n / CHECKED).max(1)) {
        let pixel = lit.pixel(i);
        let mut expected = [0.0; 3];
        for light in ready.iter().flatten() {
            let seen = reference::transmittance(&splats, pixel.point, light.place);
            let [d, s] = lights_reference::shine(&pixel, light, CAMERA.map(f64::from));
            (0..3).for_each(|k| expected[k] += seen * (d[k] + s[k]) / f64::from(LIGHTS));
        }
        let size = expected.iter().fold(0.0, |m: f64, e| m.max(*e));
        let wrong = |k: usize| (expected[k] - f64::from(found[3 * i + k])).abs() > 5e-3 * size + 1e-9;
        off += usize::from((0..3).any(wrong));
        checked += 1;
    }
    anyhow::ensure!(off <= checked / 10, "{off} of {checked} pixels have other light than the reference's.");
    let moved: Vec<f32> = rig.get(into.positions)?;
    anyhow::ensure!(moved.iter().all(|x| x.is_finite()), "A gradient is not finite.");
    report.check(format!("traced: {} of {checked} pixels have the light that the reference's have", checked - off));
    Ok(())
}

/// Measures all rays of a view.
fn rays(c: &Context<'_>, report: &mut Report) -> anyhow::Result<()> {
    let start = &c.workload.start;
    let begin = Instant::now();
    let tree = TracedTree::new(start)?;
    report.fact("traced: building the tree, ms", begin.elapsed().as_secs_f64() * 1e3);
    report.fact("traced: the tree, bytes a Gaussian", tree.bytes() as f64 / start.len() as f64);
    let mut rng = Pcg::new(17);
    let count = (c.workload.largest[0] * c.workload.largest[1]) as usize;
    let means = start.group(Group::Means);
    // Points lie across the middle of the Gaussians, so that neighbors are coherent like surfaces of a view.
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
        let expected = reference::transmittance(&splats, three(&points, pixel), three(&places, place));
        off += usize::from((expected - f64::from(found[place * count + pixel])).abs() > 2e-3);
    }
    // Rounding may include or exclude a Gaussian whose alpha is near 1/255 or that peaks at an end of the ray.
    anyhow::ensure!(off <= CHECKED / 10, "{off} of {CHECKED} rays see something else than the reference's.");
    report.check(format!("traced: {} of {CHECKED} rays see what the reference's do", CHECKED - off));
    Ok(())
}
