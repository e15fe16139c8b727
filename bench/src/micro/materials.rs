//! Benchmark of material images, composed light and material losses.
//!
//! All are checked against their references.

use super::Context;
use crate::harness::{Rig, add_passes, bytes};
use crate::report::Report;
use anyhow::Context as _;
use sgs_engine::graph::{Buffer, Graph};
use sgs_passes::cost::Counts;
use sgs_passes::loss::{
    Compose, CrossViewImage, EdgeAware, MaterialLosses, Materials, Msg, compose, compose_bwd, cross_view, edge_aware,
    material_images, material_images_bwd, material_sum, msg, pack_mask, relight,
};
use sgs_passes::reference::msg::Difference;
use sgs_passes::reference::photometric::unpack;
use sgs_passes::reference::rng::Pcg;
use sgs_passes::reference::{compose as light_reference, cross_view as cross_reference, edge_aware as edge_reference};
use sgs_passes::reference::{material_images as materials_reference, msg as msg_reference};
use sgs_shaders::structs::{MaterialStats, MaterialWeights, Step};

const WEIGHTS: MaterialWeights = MaterialWeights {
    albedo_msg: 0.5,
    roughness_msg: 0.25,
    albedo_edge: 1.0,
    roughness_edge: 0.25,
    cross_view: 0.5,
    relight: 0.5,
    own_prior: 0.0,
};

/// Number of estimates under other light, and of pseudo-views, as in the method.
const ESTIMATES: usize = 2;
const PSEUDO: usize = 2;

/// View with single-precision values.
struct Subject {
    size: [usize; 2],
    materials: Vec<[f64; 4]>,
    light: Vec<[f64; 3]>,
    coverage: Vec<f64>,
    photo: Vec<u32>,
    /// Priors of albedo and roughness, then the estimates.
    priors: Vec<Vec<u32>>,
    mask: Vec<bool>,
}

impl Subject {
    fn new(size: [usize; 2], seed: u32) -> Subject {
        let mut rng = Pcg::new(seed);
        let pixels = size[0] * size[1];
        let single = |x: f64| f64::from(x as f32);
        let wave = |p: usize, c: usize| {
            let (x, y) = ((p % size[0]) as f64, (p / size[0]) as f64);
            0.4 + 0.2 * (0.13 * x + c as f64).sin() + 0.15 * (0.07 * y + 0.05 * x).cos()
        };
        let materials = (0..pixels).map(|p| [0, 1, 2, 3].map(|c| single(wave(p, c) + 0.1 * rng.uniform()))).collect();
        let light = (0..pixels).map(|p| [0, 1, 2].map(|c| single(1.5 * wave(p, c) + 0.1 * rng.uniform()))).collect();
        let coverage = (0..pixels).map(|_| single(rng.range(0.7, 1.0))).collect();
        let mut random_image = || -> Vec<u32> {
            let mut byte = |p: usize, c: usize| (255.0 * (wave(p, c) + 0.2 * rng.uniform())) as u32;
            (0..pixels).map(|p| byte(p, 0) | byte(p, 1) << 8 | byte(p, 2) << 16 | 0xff00_0000).collect()
        };
        let photo = random_image();
        let priors = (0..2 + ESTIMATES).map(|_| random_image()).collect();
        let mask = (0..pixels).map(|p| p % size[0] < size[0] / 3).collect();
        Subject { size, materials, light, coverage, photo, priors, mask }
    }

    fn largest(&self) -> [u32; 2] {
        self.size.map(|s| s as u32)
    }

    /// Returns the difference of an image and its prior.
    fn difference(&self, values: &[f64], channels: usize, prior: &[u32], masked: bool) -> Difference {
        let present: Vec<bool> = self.mask.iter().map(|m| *m || !masked).collect();
        let value = |i: usize| match present[i / channels] {
            true => values[i] - unpack(prior[i / channels], i % channels),
            false => 0.0,
        };
        Difference { size: self.size, channels, values: (0..values.len()).map(value).collect(), present }
    }

    /// Returns the gradient of all losses by materials, and their total.
    fn expected(&self) -> (Vec<f64>, f64) {
        let (albedo, gray) = materials_reference::material_images(&self.materials, &self.coverage);
        let roughness: Vec<f64> = gray.iter().step_by(3).copied().collect();
        let (mut by_albedo, mut by_gray, mut total) = (vec![0.0; albedo.len()], vec![0.0; gray.len()], 0.0);
        let mut add = |to: &mut [f64], weight: f32, (loss, gradient): (f64, Vec<f64>)| {
            let step = to.len() / gradient.len();
            total += f64::from(weight) * loss;
            to.iter_mut().step_by(step).zip(gradient).for_each(|(t, g)| *t += f64::from(weight) * g);
        };
        let edge = |x: &[f64], channels| {
            let loss = edge_reference::edge_aware(x, channels, &self.photo, self.size);
            (loss, edge_reference::edge_aware_bwd(x, channels, &self.photo, self.size))
        };
        add(&mut by_albedo, WEIGHTS.albedo_edge, edge(&albedo, 3));
        add(&mut by_gray, WEIGHTS.roughness_edge, edge(&roughness, 1));
        let msg = |x: &[f64], channels, prior: usize| {
            msg_reference::msg(&self.difference(x, channels, &self.priors[prior], false))
        };
        add(&mut by_albedo, WEIGHTS.albedo_msg, msg(&albedo, 3, 0));
        add(&mut by_gray, WEIGHTS.roughness_msg, msg(&roughness, 1, 1));
        for estimate in &self.priors[2..] {
            let d = self.difference(&albedo, 3, estimate, true);
            let weight = WEIGHTS.relight / ESTIMATES as f32;
            add(&mut by_albedo, weight, msg_reference::msg(&d));
            add(&mut by_albedo, weight, msg_reference::square(&d));
        }
        // Pseudo-views have linear albedo, which makes them differ.
        let of = |albedo: &[f64]| cross_reference::MaskedAlbedo { albedo: albedo.to_vec(), mask: self.mask.clone() };
        let linear: Vec<f64> = self.materials.iter().flat_map(|m| [m[0], m[1], m[2]]).collect();
        let images: Vec<_> = [of(&albedo)].into_iter().chain((0..PSEUDO).map(|_| of(&linear))).collect();
        let cross = (cross_reference::cross_view(&images).0, cross_reference::cross_view_bwd(&images).swap_remove(0));
        add(&mut by_albedo, WEIGHTS.cross_view, cross);
        let by = materials_reference::material_images_bwd(&self.materials, &self.coverage, &by_albedo, &by_gray);
        (by.as_flattened().to_vec(), total)
    }
}

/// Fails if a value exceeds its tolerance.
///
/// The tolerance is `absolute` times the largest value, plus 3e-4 of the value itself.
fn compare(what: &str, expected: &[f64], found: &[f32], absolute: f64) -> anyhow::Result<()> {
    let largest = expected.iter().fold(0.0_f64, |a, b| a.max(b.abs()));
    for (i, (e, f)) in expected.iter().zip(found).enumerate() {
        let off = (f64::from(*f) - e).abs();
        anyhow::ensure!(off <= absolute * largest + 3e-4 * e.abs(), "{what}: number {i} is {f}, but should be {e}.");
    }
    Ok(())
}

fn flat(data: &[f64]) -> Vec<u8> {
    bytes(&data.iter().map(|&x| x as f32).collect::<Vec<_>>())
}

/// Measures all passes in one graph.
pub fn all(c: &Context<'_>, report: &mut Report) -> anyhow::Result<()> {
    let s = Subject::new(c.workload.largest.map(|n| n as usize), 21);
    let (largest, pixels) = (s.largest(), s.photo.len() as u64);
    let mut g = Graph::new("materials");
    let mut inputs: Vec<(Buffer, Vec<u8>)> = Vec::new();
    let step = g.uniform("step", size_of::<Step>() as u64);
    let weights = g.uniform("weights", size_of::<MaterialWeights>() as u64);
    let mut values = Step { background: [0.5; 3], ..Default::default() };
    values.camera.size = largest;
    inputs.extend([(step, bytes(&[values])), (weights, bytes(&[WEIGHTS]))]);
    let mut input = |g: &mut Graph, name: &str, data: Vec<u8>| {
        let buffer = g.input(name, data.len() as u64);
        inputs.push((buffer, data));
        buffer
    };
    let materials = input(&mut g, "materials", flat(s.materials.as_flattened()));
    let coverage = input(&mut g, "coverage", flat(&s.coverage));
    let direct = input(&mut g, "direct", flat(s.light.as_flattened()));
    let ambient = input(&mut g, "ambient", vec![0; 12 * pixels as usize]);
    let targets = input(&mut g, "targets", bytes(&s.photo));
    let mask = input(&mut g, "mask", bytes(&pack_mask(&s.mask)));
    let mut priors = s.priors.iter().enumerate();
    let mut prior = |g: &mut Graph| {
        let (i, p) = priors.next().context("There is a prior too few.")?;
        anyhow::Ok(input(g, &format!("prior{i}"), bytes(p)))
    };
    let (albedo_prior, roughness_prior) = (prior(&mut g)?, prior(&mut g)?);
    let estimates = (0..ESTIMATES).map(|_| prior(&mut g)).collect::<Result<Vec<_>, _>>()?;
    let linear: Vec<f64> = s.materials.iter().flat_map(|m| [m[0], m[1], m[2]]).collect();
    let beside = input(&mut g, "beside", flat(&linear));

    let view = Materials { step, materials, coverage, largest };
    let images = sgs_passes::loss::images(&mut g, "images", largest, true);
    material_images(&mut g, c.tuning, &view, &images)?;
    let [image, radiance_gradient] = ["image", "radiance_gradient"].map(|name| g.external(name, 12 * pixels));
    let composition = Compose { step, direct: Some(direct), ambient: Some(ambient), coverage, largest };
    let saturated = compose(&mut g, c.tuning, &composition, image)?;
    compose_bwd(&mut g, c.tuning, &composition, image, radiance_gradient)?;
    let gradients = sgs_passes::loss::images(&mut g, "gradients", largest, true);
    let gray = gradients.roughness.context("There is roughness.")?;
    g.fill("out.clear_albedo", gradients.albedo, 0)?;
    g.fill("out.clear_gray", gray, 0)?;
    let edge = edge_aware(&mut g, c.tuning, &EdgeAware { step, weights, images, targets, largest }, &gradients)?;
    let compared = Msg {
        step,
        weights,
        images,
        coverage,
        albedo_prior,
        roughness_prior: Some(roughness_prior),
        all_views: true,
        mask: None,
        largest,
    };
    let mut losses = MaterialLosses { saturated: Some(saturated), edge: Some(edge), ..Default::default() };
    losses.msg = Some(msg(&mut g, c.tuning, &compared, &gradients)?);
    for (i, albedo_prior) in estimates.into_iter().enumerate() {
        let a = Msg { albedo_prior, all_views: false, mask: Some(mask), ..compared };
        let share = 1.0 / ESTIMATES as f32;
        losses.relight[i] = Some(relight(&mut g, c.tuning, &a, i as u32, share, gradients.albedo)?);
    }
    let mut views =
        vec![CrossViewImage { step, albedo: images.albedo, mask, albedo_gradient: gradients.albedo, largest }];
    for k in 0..PSEUDO {
        let albedo_gradient = g.transient(format!("beside{k}.gradient"), 12 * pixels);
        g.fill(format!("out.clear{k}"), albedo_gradient, 0)?;
        views.push(CrossViewImage { step, albedo: beside, mask, albedo_gradient, largest });
    }
    losses.cross_view = Some(cross_view(&mut g, c.tuning, weights, &views)?);
    // The graph culls passes whose results nothing reads.
    for (k, v) in views.iter().enumerate().skip(1) {
        let output = g.external(format!("beside{k}"), 12 * pixels);
        g.copy(format!("out.beside{k}"), v.albedo_gradient, output)?;
    }
    let stats = g.external("stats", size_of::<MaterialStats>() as u64);
    material_sum(&mut g, c.tuning, step, weights, &losses, stats)?;
    let materials_gradient = g.external("materials_gradient", 16 * pixels);
    g.fill("out.clear_materials", materials_gradient, 0)?;
    material_images_bwd(&mut g, c.tuning, &view, &gradients, materials_gradient)?;

    let mut rig = Rig::new(c.device, g, inputs, true)?;
    let (times, _) = rig.measure(c.warmup, c.repeats)?;
    let masked = s.mask.iter().filter(|m| **m).count() as f64;
    let counts = Counts { pixels: pixels as f64, masked, ..Default::default() };
    add_passes(report, rig.plan(), &times, &counts, &c.ceiling);

    let (lit, cut) = light_reference::compose(&s.light, &s.coverage, [0.5; 3]);
    compare("The composed image", &lit, &rig.get(image)?, 1e-5)?;
    let by_image: Vec<f64> = rig.get::<f32>(image)?.iter().map(|&x| f64::from(x)).collect();
    let by_light = light_reference::compose_bwd(&s.light, &s.coverage, [0.5; 3], &by_image);
    compare("The gradient of light", &by_light, &rig.get(radiance_gradient)?, 2e-5)?;
    let (by_materials, total) = s.expected();
    compare("The gradient of materials", &by_materials, &rig.get(materials_gradient)?, 2e-4)?;
    let stats: MaterialStats = rig.get(stats)?[0];
    compare("The sum of the losses of materials", &[total], &[stats.total], 1e-4)?;
    compare("Saturated pixels", &[cut as f64 / pixels as f64], &[stats.saturated], 1e-4)?;
    report.check(
        "materials: images, light, the losses' sum and their gradients by materials are those of the references",
    );
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn injected_error_is_detected() {
        let (expected, total) = Subject::new([40, 30], 3).expected();
        let mut found: Vec<f32> = expected.iter().map(|&x| x as f32).collect();
        assert!(compare("all", &expected, &found, 2e-4).is_ok() && total > 0.0);
        let largest = (0..found.len()).max_by(|&a, &b| found[a].abs().total_cmp(&found[b].abs())).unwrap();
        found[largest] *= 1.001;
        assert!(compare("all", &expected, &found, 2e-4).is_err());
    }
}
