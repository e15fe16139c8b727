//! Images of materials for the tests of their losses, and the losses on a device.

use crate::Gpu;
use sgs_engine::graph::{Buffer, Graph};
use sgs_passes::Tuning;
use sgs_passes::loss::{
    CrossViewImage, EdgeAware, MaterialImages, MaterialLosses, Msg, cross_view, edge_aware, material_sum, msg,
    own_prior, pack_mask, relight,
};
use sgs_passes::reference::cross_view::{MaskedAlbedo, cross_view as cross, cross_view_bwd as cross_bwd};
use sgs_passes::reference::edge_aware::{edge_aware as edge, edge_aware_bwd as edge_bwd};
use sgs_passes::reference::msg::{Difference, msg as msg_reference, square};
use sgs_passes::reference::photometric::unpack;
use sgs_passes::reference::rng::Pcg;
use sgs_shaders::structs::{MaterialStats, MaterialWeights, Step};

/// First pixel of the view in the buffers of all views.
pub const OFFSET: usize = 5;
/// First word of the view's mask.
pub const MASK_OFFSET: usize = 3;
/// Number of pixels in the buffers after the view's pixels.
const SPARE: usize = 41;

/// Distinct weights that are exact in 32-bit floats.
pub const WEIGHTS: MaterialWeights = MaterialWeights {
    albedo_msg: 0.75,
    roughness_msg: 0.5,
    albedo_edge: 1.25,
    roughness_edge: 0.25,
    cross_view: 0.375,
    relight: 0.625,
    own_prior: 0.4375,
};

/// Images of a view and their targets.
///
/// The first view is the training view, others are pseudo-views. `P` is the number of pixels.
#[derive(Clone)]
pub struct Painted {
    /// Columns and rows.
    pub size: [usize; 2],
    /// `[P * 3]` albedo, sRGB.
    pub albedo: Vec<f64>,
    /// `[P]` roughness.
    pub roughness: Vec<f64>,
    /// `[P]` coverage.
    pub coverage: Vec<f64>,
    /// `[P]` photograph, packed RGBA8 like the priors and estimates.
    pub photo: Vec<u32>,
    /// `[P]` prior of albedo.
    pub albedo_prior: Vec<u32>,
    /// `[P]` prior of roughness.
    pub roughness_prior: Vec<u32>,
    /// `[P]` estimates of albedo from the view under other lights.
    pub estimates: [Vec<u32>; 2],
    /// `[P]` region of the view.
    pub mask: Vec<bool>,
}

/// Losses of a graph.
#[derive(Clone, Copy, Debug, Default)]
pub struct Requested {
    /// Edge-aware smoothness loss.
    pub edge: bool,
    /// Multi-scale gradient loss.
    pub msg: bool,
    /// Whether the losses include roughness.
    pub roughness: bool,
    /// Whether `msg` is restricted to the region.
    pub masked: bool,
    /// Number of estimates under other light, restricted to the region.
    pub estimates: usize,
    /// Cross-view loss of the region.
    pub cross: bool,
    /// Loss of the region's albedo against its own prior.
    pub own: bool,
}

/// Results of the device: gradients without their initial values, and statistics.
pub struct Found {
    /// `[P * 3]` gradient of each view's albedo.
    pub albedo: Vec<Vec<f32>>,
    /// `[P * 3]` gradient of the training view's roughness.
    pub roughness: Vec<f32>,
    /// Loss statistics.
    pub stats: MaterialStats,
}

/// Rounds to single precision, so that device and reference use equal numbers.
pub fn narrow(x: f64) -> f64 {
    f64::from(x as f32)
}

impl Painted {
    /// Draws waves and noise, with holes of single pixels in coverage and priors.
    pub fn new(size: [usize; 2], seed: u32) -> Painted {
        let mut rng = Pcg::new(seed);
        let pixels = size[0] * size[1];
        let wave = |p: usize, c: usize| {
            let (x, y) = ((p % size[0]) as f64, (p / size[0]) as f64);
            0.5 + 0.25 * (0.31 * x + c as f64).sin() + 0.15 * (0.17 * y + 0.1 * x).cos()
        };
        let albedo = (0..3 * pixels).map(|i| narrow(wave(i / 3, i % 3) + 0.1 * rng.uniform())).collect();
        let roughness = (0..pixels).map(|p| narrow(wave(p, 4) + 0.1 * rng.uniform())).collect();
        let mut coverage: Vec<f64> = (0..pixels).map(|_| narrow(rng.range(0.6, 1.0))).collect();
        // Holes lie in the upper third, so that coarse levels keep valid pixels.
        let third = (pixels / 3).max(1);
        let mut image = |holes: usize| -> Vec<u32> {
            let mut noisy = |p: usize, c: usize| (200.0 * wave(p, c) + 40.0 * rng.uniform()) as u32;
            let mut packed: Vec<u32> =
                (0..pixels).map(|p| noisy(p, 1) | noisy(p, 2) << 8 | noisy(p, 3) << 16 | 0xff00_0000).collect();
            for _ in 0..holes {
                packed[rng.next_u32() as usize % third] &= 0x00ff_ffff;
            }
            packed
        };
        let holes = pixels / 300;
        let (photo, albedo_prior, roughness_prior) = (image(0), image(holes), image(holes));
        let estimates = [image(holes), image(0)];
        for _ in 0..holes {
            coverage[rng.next_u32() as usize % third] = narrow(rng.range(0.0, 0.499));
        }
        // The region is a disk.
        let center = size.map(|s| 0.45 * s as f64);
        let inside = |p: usize| {
            let (x, y) = ((p % size[0]) as f64 - center[0], (p / size[0]) as f64 - center[1]);
            x.hypot(y) < 0.4 * size[0].max(size[1]) as f64
        };
        let mask = (0..pixels).map(inside).collect();
        Painted { size, albedo, roughness, coverage, photo, albedo_prior, roughness_prior, estimates, mask }
    }

    /// Returns the number of pixels.
    pub fn pixels(&self) -> usize {
        self.size[0] * self.size[1]
    }

    /// Returns albedo minus a prior, at pixels where both are valid.
    pub fn albedo_difference(&self, prior: &[u32], masked: bool) -> Difference {
        self.difference(3, prior, masked, |p, c| self.albedo[3 * p + c])
    }

    /// Returns roughness minus its prior, at pixels where both are valid.
    pub fn roughness_difference(&self, masked: bool) -> Difference {
        self.difference(1, &self.roughness_prior, masked, |p, _| self.roughness[p])
    }

    fn difference(&self, channels: usize, prior: &[u32], masked: bool, of: impl Fn(usize, usize) -> f64) -> Difference {
        let there = |p: usize| self.coverage[p] >= 0.5 && prior[p] >> 24 != 0 && (!masked || self.mask[p]);
        let present: Vec<bool> = (0..self.pixels()).map(there).collect();
        let value = |i: usize| {
            let (p, c) = (i / channels, i % channels);
            if present[p] { of(p, c) - unpack(prior[p], c) } else { 0.0 }
        };
        Difference { size: self.size, channels, values: (0..present.len() * channels).map(value).collect(), present }
    }
}

fn bytes<T: bytemuck::NoUninit>(data: &[T]) -> Vec<u8> {
    bytemuck::cast_slice(data).to_vec()
}

/// Converts to 32-bit floats and appends spare pixels of NaN.
fn single(data: impl Iterator<Item = f64>, channels: usize) -> Vec<u8> {
    let all: Vec<f32> = data.map(|x| x as f32).chain(std::iter::repeat_n(f32::NAN, SPARE * channels)).collect();
    bytes(&all)
}

/// Returns the initial value of a gradient.
///
/// The value is small, so that the sum is as accurate as the added gradient.
fn before(i: usize, pixels: usize) -> f32 {
    (i % 7) as f32 * 0.0625 / pixels as f32
}

/// Runs the losses of views; the graph's largest view has a few more columns and rows.
pub fn run(gpu: &Gpu, tuning: Tuning, views: &[Painted], requested: Requested) -> Found {
    let v = &views[0];
    let most = |a: usize| views.iter().map(|v| v.size[a]).max().unwrap_or(1) as u32;
    let largest = [most(0) + 3, most(1) + 1];
    let mut g = Graph::new("material_losses");
    let mut inputs: Vec<(Buffer, Vec<u8>)> = Vec::new();
    let weights = g.uniform("weights", size_of::<MaterialWeights>() as u64);
    inputs.push((weights, bytes(&[WEIGHTS])));
    let mut provided = |g: &mut Graph, name: &str, data: Vec<u8>| {
        let buffer = g.input(name, data.len() as u64);
        inputs.push((buffer, data));
        buffer
    };
    let padded = |data: &[u32], offset: usize| {
        bytes(&[vec![0x7777_7777; offset], data.to_vec(), vec![0x7777_7777; SPARE]].concat())
    };
    let (mut crosses, mut steps, mut gradients) = (vec![], vec![], vec![]);
    for (k, v) in views.iter().enumerate() {
        let step = g.uniform(format!("step{k}"), size_of::<Step>() as u64);
        let mut values = Step { target_offset: OFFSET as u32, mask_offset: MASK_OFFSET as u32, ..Default::default() };
        values.camera.size = v.size.map(|s| s as u32);
        steps.push((step, bytes(&[values])));
        let albedo = provided(&mut g, &format!("albedo{k}"), single(v.albedo.iter().copied(), 3));
        let mask = provided(&mut g, &format!("mask{k}"), padded(&pack_mask(&v.mask), MASK_OFFSET));
        let albedo_gradient = g.external(format!("by_albedo{k}"), 12 * (v.pixels() + SPARE) as u64);
        gradients.push((albedo_gradient, v.pixels()));
        crosses.push(CrossViewImage { step, albedo, mask, albedo_gradient, largest });
    }
    let gray = provided(&mut g, "gray", single(v.roughness.iter().flat_map(|&r| [r, f64::NAN, f64::NAN]), 3));
    let coverage = provided(&mut g, "coverage", single(v.coverage.iter().copied(), 1));
    let targets = provided(&mut g, "targets", padded(&v.photo, OFFSET));
    let albedo_prior = provided(&mut g, "albedo_prior", padded(&v.albedo_prior, OFFSET));
    let roughness_prior = provided(&mut g, "roughness_prior", padded(&v.roughness_prior, OFFSET));
    let estimates = [0, 1].map(|i| provided(&mut g, &format!("estimate{i}"), padded(&v.estimates[i], 0)));
    let by_gray = g.external("by_gray", 12 * (v.pixels() + SPARE) as u64);
    gradients.push((by_gray, v.pixels()));
    for &(buffer, pixels) in &gradients {
        inputs.push((buffer, bytes(&(0..3 * pixels).map(|i| before(i, pixels)).collect::<Vec<_>>())));
    }
    inputs.extend(steps);
    let stats = g.external("stats", size_of::<MaterialStats>() as u64);

    let CrossViewImage { step, albedo, mask, albedo_gradient, .. } = crosses[0];
    let images = MaterialImages { albedo, roughness: requested.roughness.then_some(gray) };
    let into = MaterialImages { albedo: albedo_gradient, roughness: requested.roughness.then_some(by_gray) };
    let mut losses = MaterialLosses::default();
    if requested.edge {
        let a = EdgeAware { step, weights, images, targets, largest };
        losses.edge = Some(edge_aware(&mut g, tuning, &a, &into).unwrap());
    }
    let a = Msg {
        step,
        weights,
        images,
        coverage,
        albedo_prior,
        roughness_prior: requested.roughness.then_some(roughness_prior),
        all_views: true,
        mask: requested.masked.then_some(mask),
        largest,
    };
    if requested.msg {
        losses.msg = Some(msg(&mut g, tuning, &a, &into).unwrap());
    }
    for i in 0..requested.estimates {
        let a = Msg { albedo_prior: estimates[i], all_views: false, mask: Some(mask), ..a };
        let share = 1.0 / requested.estimates as f32;
        losses.relight[i] = Some(relight(&mut g, tuning, &a, i as u32, share, albedo_gradient).unwrap());
    }
    if requested.own {
        let a = Msg { mask: Some(mask), ..a };
        losses.own_prior = Some(own_prior(&mut g, tuning, &a, albedo_gradient).unwrap());
    }
    if requested.cross {
        losses.cross_view = Some(cross_view(&mut g, tuning, weights, &crosses).unwrap());
    }
    material_sum(&mut g, tuning, step, weights, &losses, stats).unwrap();

    let out = gpu.run(g, &inputs);
    let gradient = |&(buffer, pixels): &(Buffer, usize)| {
        let all: Vec<f32> = out.get(buffer);
        let behind = &all[3 * pixels..];
        assert!(behind.iter().all(|x| x.to_bits() == u32::MAX), "something behind the view was written");
        all[..3 * pixels].iter().enumerate().map(|(i, g)| g - before(i, pixels)).collect::<Vec<f32>>()
    };
    let mut all: Vec<Vec<f32>> = gradients.iter().map(gradient).collect();
    let roughness = all.pop().unwrap();
    Found { albedo: all, roughness, stats: out.get::<MaterialStats>(stats)[0] }
}

/// Results of the references.
pub struct Expected {
    /// `[P * 3]` gradient of each view's albedo.
    pub albedo: Vec<Vec<f64>>,
    /// `[P * 3]` gradient of the training view's roughness; only the first channel is nonzero.
    pub roughness: Vec<f64>,
    /// Loss terms of the statistics, before their weights.
    pub terms: [f64; 7],
    /// Weighted sum of the terms.
    pub total: f64,
}

/// Runs the reference losses.
pub fn expected(views: &[Painted], requested: Requested) -> Expected {
    let v = &views[0];
    let n = v.pixels();
    let mut albedo: Vec<Vec<f64>> = views.iter().map(|v| vec![0.0; 3 * v.pixels()]).collect();
    let mut roughness = vec![0.0; n];
    let mut terms = [0.0; 7];
    let add = |to: &mut [f64], gradient: &[f64], weight: f32| {
        to.iter_mut().zip(gradient).for_each(|(t, g)| *t += f64::from(weight) * g);
    };
    if requested.msg {
        let (loss, gradient) = msg_reference(&v.albedo_difference(&v.albedo_prior, requested.masked));
        terms[0] = loss;
        add(&mut albedo[0], &gradient, WEIGHTS.albedo_msg);
        if requested.roughness {
            let (loss, gradient) = msg_reference(&v.roughness_difference(requested.masked));
            terms[1] = loss;
            add(&mut roughness, &gradient, WEIGHTS.roughness_msg);
        }
    }
    if requested.edge {
        terms[2] = edge(&v.albedo, 3, &v.photo, v.size);
        add(&mut albedo[0], &edge_bwd(&v.albedo, 3, &v.photo, v.size), WEIGHTS.albedo_edge);
        if requested.roughness {
            terms[3] = edge(&v.roughness, 1, &v.photo, v.size);
            add(&mut roughness, &edge_bwd(&v.roughness, 1, &v.photo, v.size), WEIGHTS.roughness_edge);
        }
    }
    if requested.cross {
        let images: Vec<MaskedAlbedo> =
            views.iter().map(|v| MaskedAlbedo { albedo: v.albedo.clone(), mask: v.mask.clone() }).collect();
        terms[4] = cross(&images).0;
        for (to, gradient) in albedo.iter_mut().zip(cross_bwd(&images)) {
            add(to, &gradient, WEIGHTS.cross_view);
        }
    }
    for estimate in &v.estimates[..requested.estimates] {
        let share = 1.0 / requested.estimates as f32;
        let d = v.albedo_difference(estimate, true);
        for (loss, gradient) in [msg_reference(&d), square(&d)] {
            terms[5] += f64::from(share) * loss;
            add(&mut albedo[0], &gradient, share * WEIGHTS.relight);
        }
    }
    if requested.own {
        let d = v.albedo_difference(&v.albedo_prior, true);
        for (loss, gradient) in [msg_reference(&d), square(&d)] {
            terms[6] += loss;
            add(&mut albedo[0], &gradient, WEIGHTS.own_prior);
        }
    }
    let w = &WEIGHTS;
    let weights =
        [w.albedo_msg, w.roughness_msg, w.albedo_edge, w.roughness_edge, w.cross_view, w.relight, w.own_prior];
    let total = terms.iter().zip(weights).map(|(t, w)| t * f64::from(w)).sum();
    // Roughness uses only the first channel.
    let roughness = roughness.into_iter().flat_map(|g| [g, 0.0, 0.0]).collect();
    Expected { albedo, roughness, terms, total }
}
