//! Photometric losses on a device against the reference and its differences.

use sgs_engine::graph::Graph;
use sgs_passes::Tuning;
use sgs_passes::loss::{Photometric, photometric, photometric_bwd_in_place};
use sgs_passes::reference::photometric as reference;
use sgs_passes::reference::photometric::Shape;
use sgs_passes::reference::rng::Pcg;
use sgs_shaders::structs::Step;
use sgs_tests::photographs::{OFFSET, SPARE, WEIGHTS, bytes, padded, run_photometric, step};
use sgs_tests::{Gpu, Tolerance, assert_close, finite_difference};

/// Largest number of roundings of a term of a gradient of SSIM: its derivative (4), two windows of eleven taps, its product
/// with the pixel's value, and the sum (2).
const ROUNDINGS: f64 = 4.0 + 22.0 + 1.0 + 2.0;

/// Returns the device's own tuning, and the same with a subgroup size of 64.
///
/// Both must match the reference on every device.
fn tunings(gpu: &Gpu) -> [Tuning; 2] {
    [gpu.tuning(), Tuning { subgroup_size: 64, ..gpu.tuning() }]
}

fn random_case(shape: Shape, seed: u32) -> (Vec<f32>, Vec<u32>) {
    let mut rng = Pcg::new(seed);
    // The photograph has large and small structure. The render is near it in places.
    let targets: Vec<u32> = (0..shape.pixels())
        .map(|p| {
            let (x, y) = ((p % shape.width) as f64, (p / shape.width) as f64);
            let wave = 0.5 + 0.3 * (0.31 * x).sin() + 0.2 * (0.17 * y + 0.1 * x).cos();
            (0..4).map(|c| ((255.0 * (wave + 0.1 * rng.normal()).clamp(0.0, 1.0)) as u32) << (8 * c)).sum()
        })
        .collect();
    let image = (0..shape.pixels() * shape.channels)
        .map(|i| {
            let c = i % shape.channels;
            let near = reference::unpack(targets[i / shape.channels], c.min(3));
            (if rng.uniform() < 0.3 { rng.uniform() } else { near + 0.05 * rng.normal() }) as f32
        })
        .collect();
    (image, targets)
}

fn check_photometric(gpu: &Gpu, shape: Shape, largest: [u32; 2], image: &[f32], targets: &[u32]) {
    let wide: Vec<f64> = image.iter().map(|&x| f64::from(x)).collect();
    let (expected, sizes) = reference::photometric_bwd_off(&wide, targets, shape, WEIGHTS.map(f64::from), &mut |_| 0.0);
    let loss = reference::photometric(&wide, targets, shape);
    let n = 3.0 * shape.pixels() as f64;
    let what = format!("gradient of {shape:?}");
    let rgb = |p: &usize| p % shape.channels < 3;
    let first: Vec<usize> = (0..expected.len()).filter(rgb).collect();
    let expected: Vec<f64> = first.iter().map(|&i| expected[i]).collect();
    // A variance is a difference of squares. Its rounding error relative to C2 grows with the square of the values.
    let square = image.iter().map(|&x| f64::from(x * x)).fold(1.0, f64::max);
    // Far beyond one, a gradient is a small difference of large terms: of -3 and 1, its terms are 10^4 times as large.
    // Each term has at most ROUNDINGS roundings, and compilers may fuse some.
    let rounding = if square > 4.0 { ROUNDINGS * 0.5_f64.powi(24) } else { 0.0 };
    for tuning in tunings(gpu) {
        let (gradient, stats) = run_photometric(gpu, tuning, shape, largest, image, targets);
        let found: Vec<f32> = first.iter().map(|&i| gradient[i]).collect();
        // The absolute tolerance is relative to the gradient of L1, which is WEIGHTS[0] / n.
        for (i, (&expected, &found)) in first.iter().zip(expected.iter().zip(&found)) {
            let tolerance = Tolerance::new(2e-4 / n + rounding * sizes[*i], 2e-4);
            assert_close(&what, &[expected], &[found], tolerance);
        }
        assert_close("L1", &[loss.l1], &[stats.l1], Tolerance::new(1e-7, 2e-6));
        let tolerance = Tolerance::new(3e-6 * square, 1e-5);
        assert_close("SSIM", &[loss.ssim], &[stats.ssim], tolerance);
        let total = f64::from(WEIGHTS[0]) * loss.l1 + f64::from(WEIGHTS[1]) * (1.0 - loss.ssim);
        assert_close("total", &[total], &[stats.total], tolerance);
        for (i, x) in gradient.iter().enumerate() {
            let written = i < shape.pixels() * shape.channels && i % shape.channels < 3;
            assert!(written || x.to_bits() == u32::MAX, "{shape:?}: float {i} was written");
        }
    }
}

#[test]
fn photometric_at_odd_sizes() {
    let gpu = Gpu::new();
    let sizes = [(1, 1), (17, 3), (11, 11), (1, 40), (40, 1), (22, 16), (23, 17), (44, 32), (45, 33), (160, 120)];
    for (i, (width, height)) in sizes.into_iter().enumerate() {
        for channels in [3, 8] {
            let shape = Shape { width, height, channels };
            let (image, targets) = random_case(shape, i as u32);
            check_photometric(&gpu, shape, [width as u32, height as u32], &image, &targets);
        }
    }
}

#[test]
fn photometric_of_a_view_smaller_than_the_largest() {
    let gpu = Gpu::new();
    let shape = Shape { width: 31, height: 9, channels: 5 };
    let (image, targets) = random_case(shape, 3);
    check_photometric(&gpu, shape, [64, 70], &image, &targets);
}

/// Uses more tiles in one row than a grid allows workgroups along x.
#[test]
fn photometric_of_a_folded_grid() {
    let gpu = Gpu::new();
    let shape = Shape { width: 22 * 65_540 + 1, height: 1, channels: 3 };
    let n = shape.pixels();
    let target = |p: usize| if p.is_multiple_of(1000) { u32::MAX } else { 0xff00_0000 };
    let targets: Vec<u32> = (0..n).map(target).collect();
    let largest = [shape.width as u32, 1];
    let (gradient, stats) = run_photometric(&gpu, gpu.tuning(), shape, largest, &vec![0.25; 3 * n], &targets);
    let l1 = (0..n).map(|p| if target(p) == u32::MAX { 0.75 } else { 0.25 }).sum::<f64>() / n as f64;
    assert_close("L1", &[l1], &[stats.l1], Tolerance::new(0.0, 1e-5));
    // The image is periodic, so the gradient is periodic too.
    for p in 1010..n - 1010 {
        let (a, b) = (gradient[3 * p], gradient[3 * (p - 1000)]);
        assert!((a - b).abs() <= 1e-4 * a.abs() && a != 0.0, "{p}: {a} {b}");
    }
}

#[test]
fn photometric_at_extremes() {
    let gpu = Gpu::new();
    let shape = Shape { width: 30, height: 21, channels: 3 };
    let n = shape.pixels();
    let cases: [(f32, u32); 6] =
        [(0.0, 0), (1.0, u32::MAX), (0.0, u32::MAX), (1.0, 0), (10.0, 0x0080_4020), (-3.0, 0x00ff_00ff)];
    for (value, target) in cases {
        check_photometric(&gpu, shape, [30, 21], &vec![value; 3 * n], &vec![target | 0xff00_0000; n]);
    }
    // Image and target are equal, but inexact in 32 bits. The sign of L1 is arbitrary there; the term of SSIM must
    // vanish.
    let target = 0xff80_4020_u32;
    let image: Vec<f32> = (0..3 * n).map(|i| reference::unpack(target, i % 3) as f32).collect();
    let (gradient, stats) = run_photometric(&gpu, gpu.tuning(), shape, [30, 21], &image, &vec![target; n]);
    assert!((stats.ssim - 1.0).abs() < 1e-5 && stats.l1 < 1e-7, "{stats:?}");
    let l1 = WEIGHTS[0] / (3 * n) as f32;
    for g in &gradient[..3 * n] {
        let rest = [g.abs(), (g - l1).abs(), (g + l1).abs()].into_iter().fold(f32::MAX, f32::min);
        assert!(rest < 1e-4 * l1, "{g}");
    }
}

/// SSIM stays at most one where rounding of squares exceeds the variances.
///
/// Gradients of SSIM do not exceed those of L1.
#[test]
fn photometric_of_overbright_images() {
    let gpu = Gpu::new();
    let shape = Shape { width: 40, height: 33, channels: 3 };
    let n = 3.0 * shape.pixels() as f32;
    let mut rng = Pcg::new(21);
    for (bright, noise) in [1e2, 3e3, 2.5e4, 1e6].into_iter().flat_map(|b| [0.0, 1e-6, 1e-4].map(|n| (b, n))) {
        let image: Vec<f32> = (0..3 * shape.pixels()).map(|_| (bright * (1.0 + noise * rng.normal())) as f32).collect();
        let targets: Vec<u32> = (0..shape.pixels()).map(|_| rng.next_u32() | 0xff00_0000).collect();
        let (gradient, stats) = run_photometric(&gpu, gpu.tuning(), shape, [40, 33], &image, &targets);
        let largest = gradient[..3 * shape.pixels()].iter().fold(0.0_f32, |m, g| m.max((g * n - WEIGHTS[0]).abs()));
        println!("{bright:e}, noise {noise:e}: SSIM {}, gradient of it {largest} at most", stats.ssim);
        assert!(stats.ssim.abs() <= 1.0 && largest <= 0.5 * WEIGHTS[0], "{bright} {noise}: {} {largest}", stats.ssim);
    }
}

/// Pixels with alpha 0 affect neither the loss nor their neighbors.
#[test]
fn photometric_skips_masked_pixels() {
    let gpu = Gpu::new();
    let shape = Shape { width: 45, height: 33, channels: 3 };
    let (mut image, mut targets) = random_case(shape, 5);
    let out = |p: usize| p % 45 > 30 || p / 45 == 7 || p.is_multiple_of(13);
    for (p, t) in targets.iter_mut().enumerate() {
        *t = (*t & 0x00ff_ffff) | if out(p) { 0 } else { 0xff00_0000 };
    }
    check_photometric(&gpu, shape, [45, 33], &image, &targets);
    let run = |image: &[f32], targets: &[u32]| run_photometric(&gpu, gpu.tuning(), shape, [45, 33], image, targets);
    let (before, stats) = run(&image, &targets);
    for p in (0..shape.pixels()).filter(|&p| out(p)) {
        assert_eq!(before[3 * p..3 * p + 3], [0.0; 3], "pixel {p}");
        image[3 * p..3 * p + 3].copy_from_slice(&[9.0, -4.0, 0.25]);
    }
    let (after, again) = run(&image, &targets);
    assert_eq!(before[..3 * shape.pixels()], after[..3 * shape.pixels()]);
    assert_eq!((stats.l1, stats.ssim), (again.l1, again.ssim));
    // Without the mask the change is visible.
    targets.iter_mut().for_each(|t| *t |= 0xff00_0000);
    assert!(run(&image, &targets).1.l1 > 2.0 * stats.l1);
}

#[test]
fn photometric_gradient_is_the_finite_difference_of_the_reference() {
    let gpu = Gpu::new();
    let shape = Shape { width: 26, height: 19, channels: 3 };
    let (image, targets) = random_case(shape, 11);
    let (gradient, _) = run_photometric(&gpu, gpu.tuning(), shape, [26, 19], &image, &targets);
    let mut wide: Vec<f64> = image.iter().map(|&x| f64::from(x)).collect();
    let loss = |x: &[f64]| {
        let r = reference::photometric(x, &targets, shape);
        f64::from(WEIGHTS[0]) * r.l1 + f64::from(WEIGHTS[1]) * (1.0 - r.ssim)
    };
    let n = 3.0 * shape.pixels() as f64;
    for i in (0..wide.len()).step_by(97) {
        let fd = finite_difference(&mut wide, i, 1e-5, loss);
        assert_close("element", &[fd], &[gradient[i]], Tolerance::new(2e-4 / n, 3e-4));
    }
    let mut rng = Pcg::new(5);
    for _ in 0..5 {
        let direction: Vec<f64> = wide.iter().map(|_| rng.normal()).collect();
        let along = |t: f64| loss(&wide.iter().zip(&direction).map(|(x, d)| x + t * d).collect::<Vec<_>>());
        let fd = (along(1e-6) - along(-1e-6)) / 2e-6;
        let dot: f64 = direction.iter().zip(&gradient).map(|(d, &g)| d * f64::from(g)).sum();
        assert_close("direction", &[fd], &[dot as f32], Tolerance::new(2e-5, 1e-4));
    }
}

/// The in-place gradient equals the separate one, bit for bit.
///
/// Nothing past the view is written. The debt of a pixel is the dot product of its color and its gradient.
#[test]
fn photometric_in_place_matches_separate_gradient_and_debt() {
    let gpu = Gpu::new();
    for (shape, largest) in [([26, 19], [26, 19]), ([1, 1], [3, 2]), ([67, 35], [70, 40])]
        .map(|([w, h], largest)| (Shape { width: w, height: h, channels: 3 }, largest))
    {
        let (image, targets) = random_case(shape, 17);
        for tuning in tunings(&gpu) {
            let (expected, _) = run_photometric(&gpu, tuning, shape, largest, &image, &targets);
            let mut g = Graph::new("in_place");
            let uniform = g.uniform("step", size_of::<Step>() as u64);
            let pixels = u64::from(largest[0]) * u64::from(largest[1]);
            let image_buffer = g.external("image", 12 * pixels);
            let target_buffer = g.input("targets", 4 * (OFFSET + targets.len() + SPARE) as u64);
            let args = Photometric { step: uniform, image: image_buffer, targets: target_buffer, channels: 3, largest };
            let partials = photometric(&mut g, tuning, &args).unwrap();
            let gradients = photometric_bwd_in_place(&mut g, tuning, &args, &partials).unwrap();
            let debt = g.external("debt_out", 4 * pixels);
            g.copy("debt_out", gradients.debt, debt).unwrap();
            assert_eq!(gradients.image, image_buffer);
            let spare = pixels as usize - shape.pixels();
            let inputs = [
                (uniform, bytes(&[step(shape)])),
                (image_buffer, bytes(&padded(0, &image, 3 * spare, f32::NAN))),
                (target_buffer, bytes(&padded(OFFSET, &targets, SPARE, 0x0012_3456))),
            ];
            let out = gpu.run(g, &inputs);
            let found: Vec<f32> = out.get(image_buffer);
            let n = 3 * shape.pixels();
            for (i, (x, y)) in found[..n].iter().zip(&expected).enumerate() {
                assert_eq!(x.to_bits(), y.to_bits(), "{shape:?}: element {i} is {x}, beside the image {y}");
            }
            assert!(found[n..].iter().all(|x| x.to_bits() == f32::NAN.to_bits()), "the spare pixels were touched");
            let debt: Vec<f32> = out.get(debt);
            let owed: Vec<f64> = (0..shape.pixels())
                .map(|p| (3 * p..3 * p + 3).map(|i| f64::from(image[i]) * f64::from(expected[i])).sum())
                .collect();
            let scale = owed.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
            assert_close("debt", &owed, &debt[..shape.pixels()], Tolerance::new(1e-6 * scale, 1e-6));
        }
    }
}

#[test]
fn photometric_is_deterministic() {
    let gpu = Gpu::new();
    let shape = Shape { width: 97, height: 61, channels: 3 };
    let (image, targets) = random_case(shape, 13);
    let run = || {
        let (gradient, stats) = run_photometric(&gpu, gpu.tuning(), shape, [97, 61], &image, &targets);
        (bytes(&gradient), bytes(&[stats]))
    };
    let first = run();
    assert!((0..3).all(|_| run() == first));
}

/// Checks that a gradient that is 0.1 % off, or wrong in one pixel, fails.
#[test]
fn photometric_checks_can_fail() {
    let shape = Shape { width: 26, height: 19, channels: 3 };
    let (image, targets) = random_case(shape, 11);
    let wide: Vec<f64> = image.iter().map(|&x| f64::from(x)).collect();
    let expected = reference::photometric_bwd(&wide, &targets, shape, 0.8, 0.2);
    let tolerance = Tolerance::new(2e-4 / (3.0 * shape.pixels() as f64), 2e-4);
    let exact: Vec<f32> = expected.iter().map(|&g| g as f32).collect();
    assert!(sgs_tests::worst(&expected, &exact, tolerance).unwrap().3 < 1.0);
    let scaled: Vec<f32> = exact.iter().map(|g| 1.001 * g).collect();
    assert!(sgs_tests::worst(&expected, &scaled, tolerance).unwrap().3 > 1.0);
    let mut one = exact.clone();
    one[100] = one[103];
    assert!(sgs_tests::worst(&expected, &one, tolerance).unwrap().3 > 1.0);
    let reweighted = reference::photometric_bwd(&wide, &targets, shape, 0.8, 0.21);
    let reweighted: Vec<f32> = reweighted.iter().map(|&g| g as f32).collect();
    assert!(sgs_tests::worst(&expected, &reweighted, tolerance).unwrap().3 > 1.0);
}
