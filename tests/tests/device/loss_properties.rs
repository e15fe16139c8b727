//! Property tests of losses against their double-precision references.
//!
//! Image values are drawn log-uniformly: colors, normals and depths, materials. Failures are shrunk. Every run draws
//! the same cases; `SGS_TEST_CASES` sets their number.
//!
//! Bounds of single precision are measured: by the sensitivity of the references to perturbations of inputs, or of
//! window means, by a few units in the last place.

use proptest::prelude::*;
use sgs_passes::loss::{octahedral_encode, pack_depth};
use sgs_passes::reference::geometry_loss as surface;
use sgs_passes::reference::geometry_loss::{Scene, Terms};
use sgs_passes::reference::photometric as color;
use sgs_passes::reference::photometric::Shape;
use sgs_passes::reference::rng::Pcg;
use sgs_tests::Gpu;
use sgs_tests::drawn::{Compared, log_uniform, powers, runner, spread};
use sgs_tests::materials::{self, Painted, Requested};
use sgs_tests::photographs::{WEIGHTS, run_photometric};
use sgs_tests::surfaces::{self, narrow};

/// Relative perturbation of inputs.
const MOVE: f64 = 4e-7;
/// Number of perturbed evaluations.
const DRAWS: usize = 4;

/// Rendered image and its photograph.
///
/// `holes` is the share of masked pixels.
#[derive(Clone, Debug)]
struct Colors {
    size: [usize; 2],
    channels: usize,
    /// Exponents of ten that bound the differences from the photograph.
    off: [f64; 2],
    /// Value and relative noise of an image of one color.
    flat: Option<(f64, f64)>,
    holes: f64,
    seed: u32,
}

prop_compose! {
    fn colors()(
        size in [1..48_usize, 1..48_usize],
        channels in prop::sample::select(vec![3_usize, 8]),
        low in -7.0..0.0_f64,
        high in 0.0..6.0_f64,
        flat in prop::option::weighted(0.3, (spread(-5.0, 5.0), spread(-8.0, 0.0))),
        holes in prop_oneof![Just(0.0), 0.0..1.0],
        seed in 0..1_000_000_u32,
    ) -> Colors {
        // Half of the images stay within the range of a camera.
        let high = if seed % 2 == 0 { 0.0 } else { high };
        Colors { size, channels, off: [low, high], flat, holes, seed }
    }
}

impl Colors {
    fn shape(&self) -> Shape {
        Shape { width: self.size[0], height: self.size[1], channels: self.channels }
    }

    fn inputs(&self) -> (Vec<f32>, Vec<u32>) {
        let (shape, mut rng) = (self.shape(), Pcg::new(self.seed));
        let (rough, flat) = (rng.uniform(), rng.next_u32());
        let target = |rng: &mut Pcg| {
            let color = if rng.uniform() < rough { rng.next_u32() } else { flat };
            color & 0x00ff_ffff | if rng.uniform() < self.holes { 0 } else { 0xff00_0000 }
        };
        let targets: Vec<u32> = (0..shape.pixels()).map(|_| target(&mut rng)).collect();
        let value = |i: usize| {
            let (p, c) = (i / shape.channels, i % shape.channels);
            match self.flat {
                Some((value, noise)) => (value * (1.0 + noise * rng.normal())) as f32,
                None => {
                    let off = log_uniform(&mut rng, self.off);
                    (color::unpack(targets[p], c.min(3)) + if rng.uniform() < 0.5 { off } else { -off }) as f32
                }
            }
        };
        ((0..shape.pixels() * shape.channels).map(value).collect(), targets)
    }
}

/// Compares the losses of colors; scales the device's gradients by `planted`.
fn check_colors(gpu: &Gpu, drawn: &Colors, planted: f64, compared: &Compared) -> Result<(), TestCaseError> {
    let (shape, (image, targets)) = (drawn.shape(), drawn.inputs());
    let wide: Vec<f64> = image.iter().map(|&x| f64::from(x)).collect();
    let weights = WEIGHTS.map(f64::from);
    let (expected, size) = color::photometric_bwd_off(&wide, &targets, shape, weights, &mut |_| 0.0);
    let mut rng = Pcg::new(1);
    let mut off = vec![0.0_f64; expected.len()];
    for draw in 0..DRAWS {
        // In an image of one color, every window's mean has the same rounding.
        let up = |rng: &mut Pcg| if draw < 2 { draw == 0 } else { rng.uniform() < 0.5 };
        let mut moved = |size: f64| MOVE * size * if up(&mut rng) { 1.0 } else { -1.0 };
        let (other, _) = color::photometric_bwd_off(&wide, &targets, shape, weights, &mut moved);
        off.iter_mut().zip(other.iter().zip(&expected)).for_each(|(o, (a, b))| *o = o.max((a - b).abs()));
    }
    let (found, stats) = run_photometric(gpu, gpu.tuning(), shape, drawn.size.map(|n| n as u32), &image, &targets);
    let n = 3.0 * shape.pixels() as f64;
    // If squares are so large that variances are mostly rounding, draws estimate only the magnitude of errors.
    let largest = wide.iter().fold(1.0_f64, |m, x| m.max(x.abs()));
    let blind = (MOVE * largest * largest / 9e-4).min(1.0);
    for i in (0..expected.len()).filter(|i| i % shape.channels < 3) {
        let is = f64::from(found[i]) * planted;
        let t = (if blind < 1.0 { 4.0 } else { 20.0 }) * off[i] + 3e-6 * size[i] + 0.1 * blind * weights[0] / n;
        compared.see(expected[i], t);
        prop_assert!((is - expected[i]).abs() <= t, "element {}: {} is not {}, to {}", i, is, expected[i], t);
    }
    let losses = color::photometric(&wide, &targets, shape);
    let l1 = f64::from(stats.l1);
    prop_assert!((l1 - losses.l1).abs() <= 1e-5 * losses.l1 + 1e-7, "L1 is {} and not {}", l1, losses.l1);
    // The error of SSIM is bounded by its derivatives by windowed means, times the errors of these means.
    let ssim = f64::from(stats.ssim);
    let t = 3e-6 * largest * largest + off.iter().sum::<f64>() * n / weights[1];
    prop_assert!(ssim.abs() <= 1.0 + 1e-5, "SSIM is {}", ssim);
    prop_assert!((ssim - losses.ssim).abs() <= t.min(2.0), "SSIM is {} and not {}, to {}", ssim, losses.ssim, t);
    Ok(())
}

#[test]
fn color_losses_match_reference() {
    let gpu = Gpu::new();
    let compared = Compared::default();
    runner(32).run(&colors(), |d| check_colors(&gpu, &d, 1.0, &compared)).unwrap_or_else(|e| panic!("{e}"));
    compared.check(20_000, 0.6);
}

/// Blended values of a view.
///
/// Opacities, depths, spreads and lengths of normals are log-uniform.
#[derive(Clone, Debug)]
struct Surfaces {
    size: [usize; 2],
    normals: bool,
    depths: bool,
    priors: bool,
    weights: [f64; 5],
    /// Exponents of ten that bound the opacities; likewise for the next three fields.
    opacity: [f64; 2],
    depth: [f64; 2],
    spread: [f64; 2],
    length: [f64; 2],
    seed: u32,
}

prop_compose! {
    fn views()(
        size in [1..40_usize, 1..40_usize],
        [normals, depths, priors] in [prop::bool::weighted(0.8), prop::bool::weighted(0.8), prop::bool::weighted(0.8)],
        weights in [spread(-4.0, 3.0), spread(-4.0, 3.0), spread(-4.0, 3.0), spread(-4.0, 3.0), spread(-4.0, 3.0)],
        opacity in powers(-6.0, 0.0),
        depth in powers(-4.0, 4.0),
        spread in powers(-1.5, 1.0),
        length in powers(-5.0, 0.0),
        seed in 0..1_000_000_u32,
    ) -> Surfaces {
        let normals = normals || !depths;
        Surfaces { size, normals, depths, priors, weights, opacity, depth, spread, length, seed }
    }
}

impl Surfaces {
    fn scene(&self) -> Scene {
        let mut rng = Pcg::new(self.seed);
        let (mut normals, mut depths, mut priors, mut depth_priors) = (vec![], vec![], vec![], vec![]);
        let (mut transmittance, mut photo) = (vec![], vec![]);
        for _ in 0..self.size[0] * self.size[1] {
            let t = narrow(1.0 - log_uniform(&mut rng, self.opacity));
            let opacity = 1.0 - t;
            let direction = [(); 3].map(|()| rng.normal());
            let length =
                opacity * log_uniform(&mut rng, self.length) / direction.iter().map(|d| d * d).sum::<f64>().sqrt();
            normals.push(direction.map(|d| narrow(length * d)));
            let z = log_uniform(&mut rng, self.depth);
            // Where a variance is indistinguishable from zero, its gradient is that of the rounding error.
            let deviation = log_uniform(&mut rng, self.spread);
            let sign = if rng.uniform() < 0.2 { -0.1 } else { 1.0 };
            depths.push([narrow(opacity * z), narrow(opacity * z * z * (1.0 + sign * deviation * deviation))]);
            let prior = direction.map(|d| (d + 0.3 * rng.normal()) as f32);
            priors.push(if rng.uniform() < 0.1 { 0 } else { octahedral_encode(prior) });
            // Half floats are normal from 6e-5 on.
            let near = z * (1.0 + 0.3 * rng.normal());
            let confidence = rng.range(-0.1, 1.0);
            depth_priors.push(pack_depth(near as f32, confidence as f32));
            transmittance.push(t);
            photo.push(rng.next_u32());
        }
        Scene {
            width: self.size[0],
            height: self.size[1],
            normals: self.normals.then_some(normals),
            depths: self.depths.then_some(depths),
            transmittance,
            depth_priors: (self.priors && self.depths).then_some(depth_priors),
            depth_line: None,
            depth_lens: None,
            priors: self.priors.then_some(priors),
            photo,
        }
    }

    fn weights(&self) -> Terms {
        let [normal, normal_smooth, depth_smooth, depth_variance, depth] = self.weights.map(narrow);
        Terms { normal, normal_smooth, depth_smooth, depth_variance, depth }
    }
}

/// Concatenates normals, depths and transmittances.
fn row(g: &surface::Gradient) -> Vec<f64> {
    [g.normals.as_flattened(), g.depths.as_flattened(), &g.transmittance].concat()
}

/// Returns the scene with perturbed values.
///
/// Transmittances are perturbed relative to the opacity.
fn moved(s: &Scene, rng: &mut Pcg) -> Scene {
    let mut other = s.clone();
    for x in other.normals.iter_mut().flatten().flatten().chain(other.depths.iter_mut().flatten().flatten()) {
        *x *= 1.0 + MOVE * rng.range(-1.0, 1.0);
    }
    for t in &mut other.transmittance {
        *t = 1.0 - (1.0 - *t) * (1.0 + MOVE * rng.range(-1.0, 1.0));
    }
    other
}

/// Compares the losses of surfaces.
///
/// Scales the `planted`-th gradient by 1.01, if set.
fn check_surfaces(
    gpu: &Gpu,
    drawn: &Surfaces,
    planted: Option<usize>,
    compared: &Compared,
) -> Result<(), TestCaseError> {
    let (s, weights) = (drawn.scene(), drawn.weights());
    let size = drawn.size.map(|n| n as u32);
    let found = surfaces::run(gpu, gpu.tuning(), &s, size, &weights);
    let is: Vec<f32> = [found.normals.as_slice(), &found.depths, &found.transmittance].concat();
    let (expected, made_of) = surface::geometry_loss_bwd_sized(&s, &weights);
    let (expected, made_of) = (row(&expected), row(&made_of));
    prop_assert_eq!(is.len(), expected.len());
    let mut rng = Pcg::new(2);
    let mut off = vec![0.0_f64; expected.len()];
    for _ in 0..DRAWS {
        let other = row(&surface::geometry_loss_bwd(&moved(&s, &mut rng), &weights));
        off.iter_mut().zip(other.iter().zip(&expected)).for_each(|(o, (a, b))| *o = o.max((a - b).abs()));
    }
    for (i, x) in is.iter().enumerate() {
        let x = f64::from(*x) * if planted == Some(i) { 1.01 } else { 1.0 };
        let t = 4.0 * off[i] + 3e-6 * made_of[i] + 1e-36;
        compared.see(expected[i], t);
        prop_assert!((x - expected[i]).abs() <= t, "number {}: {} is not {}, to {}", i, x, expected[i], t);
    }
    Ok(())
}

#[test]
fn surface_losses_match_reference() {
    let gpu = Gpu::new();
    let compared = Compared::default();
    runner(48).run(&views(), |d| check_surfaces(&gpu, &d, None, &compared)).unwrap_or_else(|e| panic!("{e}"));
    compared.check(60_000, 0.9);
}

/// Views of materials, and the requested losses.
///
/// Distances of albedo and roughness from their priors are log-uniform.
#[derive(Clone, Debug)]
struct Materials {
    sizes: Vec<[usize; 2]>,
    off: [f64; 2],
    /// Share of an image that has one color.
    flat: f64,
    requested: Requested,
    seed: u32,
}

prop_compose! {
    fn materials()(
        sizes in prop::collection::vec([1..50_usize, 1..50_usize], 1..4),
        off in powers(-6.0, 3.0),
        flat in 0.0..1.0_f64,
        [edge, msg, roughness, masked, cross] in [any::<bool>(), any::<bool>(), any::<bool>(), any::<bool>(), any::<bool>()],
        estimates in 0..3_usize,
        own in any::<bool>(),
        seed in 0..1_000_000_u32,
    ) -> Materials {
        let none = !msg && !cross && !own && estimates == 0;
        let requested = Requested { edge: edge || none, msg, roughness, masked, estimates, cross, own };
        Materials { sizes, off, flat, requested, seed }
    }
}

impl Materials {
    fn views(&self) -> Vec<Painted> {
        let mut rng = Pcg::new(self.seed);
        let view = |(k, size): (usize, &[usize; 2])| {
            let mut v = Painted::new(*size, self.seed + k as u32);
            let mut moved = |x: f64| {
                let off = log_uniform(&mut rng, self.off);
                let sign = if rng.uniform() < 0.5 { 1.0 } else { -1.0 };
                if rng.uniform() < self.flat { 0.5 } else { narrow(x + sign * off) }
            };
            v.albedo.iter_mut().chain(&mut v.roughness).for_each(|x| *x = moved(*x));
            v
        };
        self.sizes.iter().enumerate().map(view).collect()
    }
}

/// Compares the losses of materials; scales the device's gradients by `planted`.
fn check_materials(gpu: &Gpu, drawn: &Materials, planted: f64, compared: &Compared) -> Result<(), TestCaseError> {
    let views = drawn.views();
    let found = materials::run(gpu, gpu.tuning(), &views, drawn.requested);
    let row = |e: &materials::Expected| [e.albedo.concat(), e.roughness.clone()].concat();
    let expected = materials::expected(&views, drawn.requested);
    let (all, is) = (row(&expected), [found.albedo.concat(), found.roughness].concat());
    prop_assert_eq!(all.len(), is.len());
    let mut rng = Pcg::new(3);
    let mut off = vec![0.0_f64; all.len()];
    for draw in 0..DRAWS {
        let mut other = views.clone();
        for v in &mut other {
            // Coarse levels average out per-pixel errors, so some draws perturb whole blocks together.
            let width = v.size[0];
            let block = |p: usize| (p % width / (5 << (2 * draw)) + p / width / (5 << (2 * draw))) % 2;
            let mut by = |p: usize| MOVE * if draw < 2 { 2.0 * block(p) as f64 - 1.0 } else { rng.range(-1.0, 1.0) };
            v.albedo.iter_mut().enumerate().for_each(|(i, x)| *x *= 1.0 + by(i / 3));
            v.roughness.iter_mut().enumerate().for_each(|(p, x)| *x *= 1.0 + by(p));
        }
        let other = row(&materials::expected(&other, drawn.requested));
        off.iter_mut().zip(other.iter().zip(&all)).for_each(|(o, (a, b))| *o = o.max((a - b).abs()));
    }
    // Each gradient sums some hundred terms, each up to the largest gradient.
    let largest = all.iter().fold(0.0_f64, |m, x| m.max(x.abs()));
    for (i, x) in is.iter().enumerate() {
        let x = f64::from(*x) * planted;
        let t = 8.0 * off[i] + 1e-5 * all[i].abs() + 5e-6 * largest + 1e-30;
        compared.see(all[i], t);
        prop_assert!((x - all[i]).abs() <= t, "number {}: {} is not {}, to {}", i, x, all[i], t);
    }
    let total = f64::from(found.stats.total);
    let t = 1e-5 * expected.total.abs() + 1e-7;
    prop_assert!((total - expected.total).abs() <= t, "the loss is {} and not {}", total, expected.total);
    Ok(())
}

#[test]
fn material_losses_match_reference() {
    let gpu = Gpu::new();
    let compared = Compared::default();
    runner(32).run(&materials(), |d| check_materials(&gpu, &d, 1.0, &compared)).unwrap_or_else(|e| panic!("{e}"));
    compared.check(50_000, 0.7);
}

/// Checks that an error of 1 % fails.
#[test]
fn checks_of_losses_can_fail() {
    let (gpu, compared) = (Gpu::new(), Compared::default());
    let drawn = Colors { size: [23, 17], channels: 3, off: [-2.0, 0.0], flat: None, holes: 0.1, seed: 5 };
    assert!(check_colors(&gpu, &drawn, 1.0, &compared).is_ok() && check_colors(&gpu, &drawn, 1.01, &compared).is_err());
    let drawn = Surfaces {
        size: [11, 9],
        normals: true,
        depths: true,
        priors: true,
        weights: [0.5; 5],
        opacity: [-1.0, 0.0],
        depth: [-0.5, 0.5],
        spread: [-1.0, 0.0],
        length: [-1.0, 0.0],
        seed: 3,
    };
    let all = Requested { edge: true, msg: true, roughness: true, masked: false, estimates: 2, cross: true, own: true };
    let painted = Materials { sizes: vec![[20, 30], [17, 9]], off: [-2.0, 0.0], flat: 0.2, requested: all, seed: 4 };
    assert!(
        check_materials(&gpu, &painted, 1.0, &compared).is_ok()
            && check_materials(&gpu, &painted, 1.01, &compared).is_err()
    );
    assert!(check_surfaces(&gpu, &drawn, None, &compared).is_ok());
    let expected = row(&surface::geometry_loss_bwd(&drawn.scene(), &drawn.weights()));
    let n = 99;
    for range in [0..3 * n, 3 * n..5 * n, 5 * n..6 * n] {
        let largest = range.max_by(|a, b| expected[*a].abs().total_cmp(&expected[*b].abs()));
        assert!(check_surfaces(&gpu, &drawn, largest, &compared).is_err(), "number {largest:?}");
    }
}
