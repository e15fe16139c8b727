//! Benchmark of `environment`: filters of cube maps of several sizes, shading and its backward pass.
//!
//! Surfaces resemble rooms: few normal directions with some noise, so that many pixels share a texel. Sampled texels
//! are checked against the reference. The gradient is checked by its product with the texels, which must equal the
//! product of the light and its gradient.

use super::Context;
use crate::harness::{Rig, add_passes, bytes};
use crate::report::Report;
use sgs_engine::graph::Graph;
use sgs_passes::cost::Counts;
use sgs_passes::reference::environment as reference;
use sgs_passes::reference::environment::{Cube, Filter};
use sgs_passes::reference::rng::Pcg;
use sgs_passes::shade::environment::{
    Environment, EnvironmentOptions, EnvironmentView, environment, environment_bwd, environment_filter,
    environment_filter_bwd, environment_smoothness,
};
use sgs_shaders::structs::Step;

/// Texels per edge of a face.
const SIZES: [u32; 3] = [64, 128, 256];
/// Normals of a room, and one oblique normal.
const NORMALS: [[f64; 3]; 6] =
    [[0.0, 1.0, 0.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.6, 0.64, -0.48]];

/// Measures all sizes.
pub fn all(c: &Context<'_>, report: &mut Report) -> anyhow::Result<()> {
    // Tiny primitives imply tiny cube maps.
    let sizes: &[u32] = if c.elements < 10_000 { &[16] } else { &SIZES };
    sizes.iter().try_for_each(|&size| one(c, report, size))
}

fn one(c: &Context<'_>, report: &mut Report, size: u32) -> anyhow::Result<()> {
    let e = Environment::new(size, &EnvironmentOptions::default())?;
    let [width, height] = c.workload.largest;
    let pixels = u64::from(width) * u64::from(height);
    let count = pixels as usize;
    let mut rng = Pcg::new(size);
    let texels = e.start(size);
    let (mut points, mut normals, mut materials, mut gradient) = (vec![], vec![], vec![], vec![]);
    for i in 0..count {
        let (x, y) = (i as u32 % width * 3 / width, i as u32 / width * 2 / height);
        let n: [f64; 3] = NORMALS[(y * 3 + x) as usize].map(|a| a + 0.02 * rng.normal());
        let length = n.iter().map(|a| a * a).sum::<f64>().sqrt();
        normals.extend(n.map(|a| (a / length) as f32));
        points.extend([0, 1, 2].map(|_| rng.range(-1.0, 1.0) as f32));
        materials.extend([0.5, 0.6, 0.7, 0.1 + 0.8 * rng.uniform()].map(|a| a as f32));
        // Positive, so that products of many terms do not cancel.
        gradient.extend([0, 1, 2].map(|_| rng.range(0.0, 1e-3) as f32));
    }
    let mut g = Graph::new(format!("environment{size}"));
    let tables = e.declare(&mut g);
    let step = g.uniform("step", size_of::<Step>() as u64);
    let texel_buffer = g.input("texels", 4 * texels.len() as u64);
    let [point_buffer, normal_buffer, radiance_gradient] =
        ["points", "normals", "slope"].map(|n| g.input(n, 12 * pixels));
    let (coverage, material_buffer) = (g.input("coverage", 4 * pixels), g.input("materials", 16 * pixels));
    let view = EnvironmentView {
        step,
        points: point_buffer,
        normals: normal_buffer,
        coverage,
        materials: material_buffer,
        metallic: None,
        pixels,
    };
    let (ambient, by_material) = (g.external("ambient", 12 * pixels), g.external("by_material", 16 * pixels));
    let by_texel = g.external("by_texel", 4 * texels.len() as u64);
    let radiance = g.external("radiance", 12 * u64::from(e.filtered_texels()));
    let t = &c.tuning;
    let filtered = environment_filter(&mut g, t, &e, &tables, texel_buffer)?;
    environment(&mut g, t, &e, &tables, &view, &filtered, ambient)?;
    let sums = environment_bwd(&mut g, t, &e, &tables, &view, &filtered, radiance_gradient, by_material, None)?;
    // Timed with zero weight, so that the gradient is that of the light only.
    let smooth = environment_smoothness(&mut g, t, &e, &tables, texel_buffer, 0.0);
    environment_filter_bwd(&mut g, t, &e, &tables, &filtered, &sums, smooth.as_ref(), by_texel)?;
    g.copy("out.radiance", filtered.radiance, radiance)?;
    let mut values = Step::default();
    values.camera.size = [width, height];
    values.camera.position = [0.0, 0.0, -4.0];
    let mut inputs = vec![
        (step, bytes(&[values])),
        (texel_buffer, bytes(&texels)),
        (point_buffer, bytes(&points)),
        (normal_buffer, bytes(&normals)),
        (coverage, bytes(&vec![1.0_f32; count])),
        (material_buffer, bytes(&materials)),
        (radiance_gradient, bytes(&gradient)),
    ];
    inputs.extend(e.contents(&tables));
    let mut rig = Rig::new(c.device, g, inputs, true)?;
    let (times, _) = rig.measure(c.warmup, c.repeats)?;
    let counts = Counts { pixels: count as f64, ..Default::default() };
    add_passes(report, rig.plan(), &times, &counts, &c.ceiling);

    let (radiance, ambient): (Vec<f32>, Vec<f32>) = (rig.get(radiance)?, rig.get(ambient)?);
    let cube = Cube::from_floats(size as usize, &texels);
    for level in e.levels() {
        let (mip, filter) = (reference::mip(&cube, level.size as usize), Filter::new(level));
        for _ in 0..4 {
            let texel = rng.next_u32() % level.texels();
            let expected = reference::prefilter_texel(&mip, &filter, texel as usize)[0];
            let found = f64::from(radiance[3 * (level.first + texel) as usize]);
            let right = (found - expected).abs() < 1e-4 * expected;
            anyhow::ensure!(right, "A filtered texel is {found}, but should be {expected}.");
        }
    }
    let product = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(x, y)| f64::from(*x) * f64::from(*y)).sum::<f64>();
    let (forward, back) = (product(&ambient, &gradient), product(&texels, &rig.get::<f32>(by_texel)?));
    let right = (forward - back).abs() < 1e-5 * forward;
    anyhow::ensure!(right, "Light times its gradient is {forward}, texels times theirs {back}.");
    report.check(format!(
        "environment: {size} texels a side, texels as the reference's, the gradient as light's adjoint"
    ));
    Ok(())
}
