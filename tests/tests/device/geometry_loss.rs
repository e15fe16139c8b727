//! Normal and depth losses on a device against their reference.

use glam::DVec2;
use sgs_passes::Tuning;
use sgs_passes::loss::{octahedral_encode, pack_depth, pack_relative_depth};
use sgs_passes::reference::geometry_loss as reference;
use sgs_passes::reference::geometry_loss::{Gradient, Lens, Scene, Terms};
use sgs_passes::reference::rng::Pcg;
use sgs_shaders::structs::LossStats;
use sgs_tests::photographs::{INVALID, invalidate};
use sgs_tests::surfaces::{Found, WEIGHTS, fit, narrow, run};
use sgs_tests::{Gpu, Tolerance, assert_close, worst};

fn bytes<T: bytemuck::NoUninit>(data: &[T]) -> Vec<u8> {
    bytemuck::cast_slice(data).to_vec()
}

/// Builds a half-trained scene with all opacities and mostly agreeing normals.
fn random_scene(width: usize, height: usize, seed: u32) -> Scene {
    let mut rng = Pcg::new(seed);
    let mut s = Scene {
        width,
        height,
        normals: Some(vec![]),
        depths: Some(vec![]),
        transmittance: vec![],
        priors: Some(vec![]),
        depth_priors: Some(vec![]),
        depth_line: None,
        depth_lens: None,
        photo: vec![],
    };
    for p in 0..width * height {
        let (x, y) = ((p % width) as f64, (p / width) as f64);
        let transmittance = narrow(rng.range(0.02, 0.98));
        let opacity = 1.0 - transmittance;
        let length = opacity * rng.range(0.5, 1.0);
        let direction = [(0.2 * x).sin() + 0.2 * rng.normal(), (0.15 * y).cos(), -0.7 + 0.2 * rng.normal()];
        let norm = direction.iter().map(|d| d * d).sum::<f64>().sqrt();
        let z = 2.0 + 0.5 * (0.1 * x + 0.07 * y).sin() + 0.05 * rng.normal();
        // Rounding can make variances negative. Values stay away from the threshold of the gradient.
        let variance = if rng.uniform() < 0.2 { -1e-3 } else { rng.range(0.05, 0.2).powi(2) };
        if let (Some(normals), Some(depths), Some(priors)) = (&mut s.normals, &mut s.depths, &mut s.priors) {
            normals.push(direction.map(|d| narrow(length * d / norm)));
            depths.push([narrow(opacity * z), narrow(opacity * (z * z + variance))]);
            let prior = direction.map(|d| (d + 0.3 * rng.normal()) as f32);
            priors.push(if rng.uniform() < 0.1 { 0 } else { octahedral_encode(prior) });
        }
        if let Some(priors) = &mut s.depth_priors {
            let known = if rng.uniform() < 0.15 { 0.0 } else { 1.0 };
            // Errors stay away from zero, where the gradient's sign changes.
            let off = rng.range(0.02, 0.4) * if rng.uniform() < 0.5 { 1.0 } else { -1.0 };
            priors.push(pack_depth((known * z * (1.0 + off)) as f32, rng.range(0.1, 1.0) as f32));
        }
        s.transmittance.push(transmittance);
        s.photo.push(rng.next_u32() | 0xff00_0000);
    }
    s
}

fn flat<const N: usize>(v: &[[f64; N]]) -> Vec<f64> {
    v.as_flattened().to_vec()
}

/// Returns the tolerance of gradients.
///
/// The absolute tolerance is a share of the loss gradient of a pixel, or a smaller share of the largest gradient.
fn tolerance(expected: &[f64], absolute: f64, relative: f64) -> Tolerance {
    let largest = expected.iter().fold(0.0_f64, |a, b| a.max(b.abs()));
    Tolerance::new(absolute.max(1e-5 * largest), relative)
}

/// Compares all results at the device's subgroup size and at 64.
///
/// Returns the results at 64.
fn check(gpu: &Gpu, s: &Scene, largest: [u32; 2]) -> Found {
    let wide = Tuning { subgroup_size: 64, ..gpu.tuning() };
    let [own, found] = [gpu.tuning(), wide].map(|tuning| run(gpu, tuning, s, largest, &WEIGHTS));
    let terms = reference::geometry_loss(s);
    let expected = reference::geometry_loss_bwd(s, &WEIGHTS);
    let (normals, depths, by_t) = (flat(&expected.normals), flat(&expected.depths), expected.transmittance);
    let n = (s.width * s.height) as f64;
    let what = |name| format!("{name} at {}x{}", s.width, s.height);
    for found in [&own, &found] {
        assert_close(&what("normals"), &normals, &found.normals, tolerance(&normals, 1e-5 / n, 1e-4));
        // The variance, at least 2.5e-3, is a difference of squares. Its absolute error is about 1e-6.
        assert_close(&what("depths"), &depths, &found.depths, tolerance(&depths, 2e-3 / n, 1e-3));
        assert_close(&what("transmittance"), &by_t, &found.transmittance, tolerance(&by_t, 5e-3 / n, 1e-3));
        check_terms(&terms, &found.stats);
    }
    found
}

fn check_terms(t: &Terms, stats: &LossStats) {
    let tolerance = Tolerance::new(2e-6, 2e-5);
    assert_close("normal", &[t.normal], &[stats.normal], tolerance);
    assert_close("normal smoothness", &[t.normal_smooth], &[stats.normal_smooth], tolerance);
    assert_close("depth smoothness", &[t.depth_smooth], &[stats.depth_smooth], tolerance);
    assert_close("depth variance", &[t.depth_variance], &[stats.depth_variance], Tolerance::new(2e-5, 2e-4));
    let total = WEIGHTS.normal * t.normal
        + WEIGHTS.normal_smooth * t.normal_smooth
        + WEIGHTS.depth_smooth * t.depth_smooth
        + WEIGHTS.depth_variance * t.depth_variance
        + WEIGHTS.depth * t.depth;
    assert_close("depth", &[t.depth], &[stats.depth], tolerance);
    assert_close("total", &[total], &[stats.total], Tolerance::new(2e-5, 2e-4));
}

#[test]
fn geometry_loss_at_odd_sizes() {
    let gpu = Gpu::new();
    let sizes = [(1, 1), (17, 3), (11, 11), (1, 40), (40, 1), (2, 2), (28, 16), (29, 17), (57, 33), (160, 120)];
    for (i, (width, height)) in sizes.into_iter().enumerate() {
        let s = random_scene(width, height, i as u32);
        check(&gpu, &s, [width as u32, height as u32]);
    }
    check(&gpu, &random_scene(31, 9, 99), [64, 70]);
}

/// Tests prior depths of a sensor whose lens differs from that of the view.
#[test]
fn prior_depths_follow_the_rays_of_their_lens() {
    let gpu = Gpu::new();
    let s = random_scene(57, 33, 3);
    // Rays of the view that fall between pixels of the sensor, outside of it, and far outside.
    let lens = |[fx, fy, cx, cy]: [f64; 4], radial: f64| Lens {
        focal: DVec2::new(fx, fy),
        center: DVec2::new(cx, cy),
        radial,
    };
    let numbers = [60.0, 59.0, 28.3, 16.9];
    let view = lens(numbers, 0.0);
    for sensor in [numbers, [66.1, 65.3, 28.7, 16.1], [40.0, 45.0, 20.0, 30.0], [60.0, 59.0, 300.0, -90.0]] {
        for radial in [0.0, 0.1, -0.1] {
            let lenses = [lens(numbers, radial), lens(sensor, 0.0)];
            let found = check(&gpu, &Scene { depth_lens: Some(lenses), ..s.clone() }, [57, 33]);
            assert_eq!(found.stats.depth == 0.0, sensor[2] == 300.0);
        }
    }
    let same = check(&gpu, &Scene { depth_lens: Some([view, view]), ..s.clone() }, [57, 33]);
    assert_eq!(same.depths, check(&gpu, &s, [57, 33]).depths);
}

#[test]
fn geometry_loss_of_a_model_that_lacks_something() {
    let gpu = Gpu::new();
    let s = random_scene(33, 19, 5);
    check(&gpu, &Scene { normals: None, priors: None, ..s.clone() }, [33, 19]);
    check(&gpu, &Scene { depth_priors: None, ..s.clone() }, [33, 19]);
    check(&gpu, &Scene { depths: None, ..s.clone() }, [33, 19]);
    let found = check(&gpu, &Scene { depths: None, priors: None, ..s }, [33, 19]);
    assert!(found.transmittance.iter().all(|&t| t == 0.0));
}

#[test]
fn geometry_loss_at_extremes() {
    let gpu = Gpu::new();
    let (width, height) = (20, 13);
    let mut rng = Pcg::new(8);
    let n = width * height;
    for opacity in [0.0, 1.0 / 65536.0, 1.0 / 2048.0, 0.5, 1.0] {
        let mut s = random_scene(width, height, 2);
        for p in 0..n {
            let z = rng.range(1.0, 3.0);
            s.transmittance[p] = 1.0 - opacity;
            s.normals.as_mut().unwrap()[p] = s.normals.as_ref().unwrap()[p].map(|x| narrow(opacity * x));
            s.depths.as_mut().unwrap()[p] = [narrow(opacity * z), narrow(opacity * (z * z + 0.01))];
        }
        let found = check(&gpu, &s, [width as u32, height as u32]);
        let all = found.normals.iter().chain(&found.depths).chain(&found.transmittance);
        // Gradients are at most 1000 times the loss gradient of a pixel, times the depth and its square.
        let bound = 1e3 * 10.0 * 30.0 / n as f32;
        assert!(all.into_iter().all(|g| g.abs() < bound), "opacity {opacity}");
    }
    // With zero normals and missing priors, the loss is only the floor of the variance, and no gradient remains.
    let s = Scene {
        normals: Some(vec![[0.0; 3]; n]),
        depths: Some(vec![[0.0; 2]; n]),
        transmittance: vec![1.0; n],
        priors: Some(vec![octahedral_encode([f32::NAN, 1.0, 0.0]); n]),
        depth_priors: Some(vec![pack_depth(f32::NAN, 1.0); n]),
        ..random_scene(width, height, 3)
    };
    let found = check(&gpu, &s, [width as u32, height as u32]);
    assert!(found.normals.iter().chain(&found.depths).chain(&found.transmittance).all(|&g| g == 0.0));
    // With priors, the gradient of a zero normal is 1000 times the loss gradient of a pixel.
    let magnitude = |g: &[f32]| g.iter().map(|x| f64::from(*x).powi(2)).sum::<f64>().sqrt() * n as f64 / 1e3;
    let priors = vec![octahedral_encode([0.6, -0.3, -0.7]); n];
    let mut s = Scene { priors: Some(priors), ..s };
    let found = check(&gpu, &s, [width as u32, height as u32]);
    assert!(found.normals.chunks_exact(3).all(|g| (magnitude(g) / WEIGHTS.normal - 1.0).abs() < 1e-3));
    // Neighbors contribute less than two to each coordinate, in both directions.
    let others = random_scene(width, height, 3).normals.unwrap();
    s.normals.as_mut().unwrap().iter_mut().zip(others).step_by(2).for_each(|(zero, other)| *zero = other);
    let found = check(&gpu, &s, [width as u32, height as u32]);
    let zeros = || found.normals.chunks_exact(3).skip(1).step_by(2);
    let bound = WEIGHTS.normal + 4.0 * WEIGHTS.normal_smooth;
    assert!(zeros().all(|g| magnitude(g) < bound) && zeros().any(|g| magnitude(g) > 1.5 * WEIGHTS.normal));
}

/// Tests patterns of invalid pixels. Values at invalid pixels are NaN or huge, and priors there stay.
#[test]
fn invalid_pixels_have_no_geometry_loss_and_no_gradient() {
    let gpu = Gpu::new();
    for (i, (width, height)) in [(1, 1), (2, 2), (17, 3), (57, 33)].into_iter().enumerate() {
        for (name, pattern) in INVALID {
            let mut s = random_scene(width, height, 30 + i as u32);
            let invalid = invalidate(&mut s.photo, [width, height], pattern);
            let size = [width as u32, height as u32];
            let plain = check(&gpu, &s, size);
            for &p in &invalid {
                let bad = if p % 2 == 0 { f64::NAN } else { 1e30 };
                s.normals.as_mut().unwrap()[p] = [bad; 3];
                s.depths.as_mut().unwrap()[p] = [bad; 2];
                s.transmittance[p] = bad;
            }
            let found = check(&gpu, &s, size);
            let what = format!("{name} at {width}x{height}");
            assert!(found.normals == plain.normals && found.depths == plain.depths, "{what}");
            assert!(found.transmittance == plain.transmittance, "{what}");
            assert_eq!(bytes(&[found.stats]), bytes(&[plain.stats]), "{what}");
            for p in invalid {
                let of_pixel = found.normals[3 * p..][..3].iter().chain(&found.depths[2 * p..][..2]);
                assert!(of_pixel.chain(&found.transmittance[p..=p]).all(|g| *g == 0.0), "{what}: pixel {p}");
            }
        }
    }
}

/// Tests that a sensor's depth of a valid pixel does not count at an invalid one.
#[test]
fn invalid_pixels_ignore_prior_depths_of_another_lens() {
    let gpu = Gpu::new();
    let mut s = random_scene(57, 33, 3);
    let lens = |focal: f64, center: [f64; 2]| Lens { focal: DVec2::splat(focal), center: center.into(), radial: 0.0 };
    s.depth_lens = Some([lens(60.0, [28.3, 16.9]), lens(66.1, [28.7, 16.1])]);
    let all = check(&gpu, &s, [57, 33]);
    let invalid = invalidate(&mut s.photo, [57, 33], INVALID[1].1);
    let found = check(&gpu, &s, [57, 33]);
    assert!(found.stats.depth < all.stats.depth && found.stats.depth > 0.0);
    assert!(invalid.iter().all(|p| found.depths[2 * p..][..2] == [0.0; 2]));
}

#[test]
fn geometry_loss_gradient_is_the_finite_difference_of_the_reference() {
    let gpu = Gpu::new();
    let mut s = random_scene(24, 18, 17);
    check_finite_differences(&gpu, &s);
    invalidate(&mut s.photo, [24, 18], INVALID[0].1);
    check_finite_differences(&gpu, &s);
}

/// Compares gradients with finite differences of the reference, at 24 x 18 pixels.
fn check_finite_differences(gpu: &Gpu, s: &Scene) {
    let found = run(gpu, gpu.tuning(), s, [24, 18], &WEIGHTS);
    let loss = |s: &Scene| {
        let t = reference::geometry_loss(s);
        WEIGHTS.normal * t.normal
            + WEIGHTS.normal_smooth * t.normal_smooth
            + WEIGHTS.depth_smooth * t.depth_smooth
            + WEIGHTS.depth_variance * t.depth_variance
            + WEIGHTS.depth * t.depth
    };
    let n = (s.width * s.height) as f64;
    let moved = |p: usize, c: usize, h: f64| {
        let mut s = s.clone();
        match c {
            0..3 => s.normals.as_mut().unwrap()[p][c] += h,
            3..5 => s.depths.as_mut().unwrap()[p][c - 3] += h,
            _ => s.transmittance[p] += h,
        }
        loss(&s)
    };
    for p in (0..432).step_by(17) {
        for c in 0..6 {
            let fd = (moved(p, c, 1e-7) - moved(p, c, -1e-7)) / 2e-7;
            let gradient = match c {
                0..3 => found.normals[3 * p + c],
                3..5 => found.depths[2 * p + c - 3],
                _ => found.transmittance[p],
            };
            assert_close(&format!("{c} of {p}"), &[fd], &[gradient], Tolerance::new(5e-3 / n, 3e-3));
        }
    }
    let mut rng = Pcg::new(5);
    for _ in 0..5 {
        let direction: Vec<f64> = (0..6 * 432).map(|_| rng.normal()).collect();
        let along = |t: f64| {
            let mut s = s.clone();
            for p in 0..432 {
                let d = &direction[6 * p..];
                (0..3).for_each(|c| s.normals.as_mut().unwrap()[p][c] += t * d[c]);
                (0..2).for_each(|c| s.depths.as_mut().unwrap()[p][c] += t * d[3 + c]);
                s.transmittance[p] += t * d[5];
            }
            loss(&s)
        };
        let fd = (along(1e-8) - along(-1e-8)) / 2e-8;
        let dot: f64 = (0..432)
            .flat_map(|p| {
                found.normals[3 * p..][..3].iter().chain(&found.depths[2 * p..][..2]).chain(&found.transmittance[p..=p])
            })
            .zip(&direction)
            .map(|(&g, d)| f64::from(g) * d)
            .sum();
        assert_close("direction", &[fd], &[dot as f32], Tolerance::new(1e-3, 2e-3));
    }
}

/// Returns the scene with prior values on a line through the inverse depths.
///
/// The values have noise, and some are unknown.
fn with_relative_depths(mut s: Scene, seed: u32, [slope, offset]: [f64; 2], shift: bool) -> Scene {
    let mut rng = Pcg::new(seed);
    let opacities: Vec<f64> = s.transmittance.iter().map(|t| 1.0 - t).collect();
    let inverse = s.depths.as_ref().unwrap().iter().zip(opacities).map(|(d, opacity)| opacity / d[0]);
    let values: Vec<f32> = inverse.map(|y| ((y * (1.0 + 0.05 * rng.normal()) - offset) / slope) as f32).collect();
    let confidence: Vec<f32> = values.iter().map(|_| rng.range(-0.2, 1.0) as f32).collect();
    s.depth_priors = Some(pack_relative_depth(&values, &confidence, shift));
    s
}

#[test]
fn fit_of_relative_depths_matches_reference() {
    let gpu = Gpu::new();
    let sizes = [(1, 1), (2, 1), (17, 3), (40, 1), (57, 33), (160, 120)];
    for (i, (width, height)) in sizes.into_iter().enumerate() {
        for (shift, line) in [(false, [0.02, 0.0]), (true, [350.0, 0.1]), (true, [3e-3, -0.2]), (true, [-1.0, 0.9])] {
            let s = with_relative_depths(random_scene(width, height, i as u32), 7, line, shift);
            let expected = reference::depth_line(&s, shift);
            let found = fit(&gpu, &s, shift);
            let name = format!("{width}x{height} with shift {shift}");
            // Few pixels may have no slope, and a falling line does not count.
            let many = width * height > 30;
            assert!(!many || (expected[0] > 0.0) == (line[0] > 0.0), "{name}");
            if many || !shift {
                assert_close(&name, &expected, &found, Tolerance::new(1e-6, 1e-4));
            }
            assert!(found.iter().all(|x| x.is_finite()), "{name}");
            let s = Scene { depth_line: Some(found.map(f64::from)), ..s };
            check(&gpu, &s, [width as u32, height as u32]);
        }
    }
}

#[test]
fn fit_without_anything_to_fit_is_zero() {
    let gpu = Gpu::new();
    let s = random_scene(20, 13, 4);
    let n = s.transmittance.len();
    let unknown = Scene { depth_priors: Some(vec![0; n]), ..s.clone() };
    let empty = Scene { transmittance: vec![1.0; n], ..s.clone() };
    let nothing = Scene { depths: Some(vec![[0.0; 2]; n]), ..s };
    for s in [unknown, empty, nothing] {
        for shift in [false, true] {
            assert_eq!(fit(&gpu, &s, shift), [0.0; 2]);
        }
    }
}

#[test]
fn geometry_loss_is_deterministic() {
    let gpu = Gpu::new();
    let s = random_scene(97, 61, 13);
    let once = || {
        let f = run(&gpu, gpu.tuning(), &s, [97, 61], &WEIGHTS);
        [bytes(&f.normals), bytes(&f.depths), bytes(&f.transmittance), bytes(&[f.stats])]
    };
    let first = once();
    assert!((0..3).all(|_| once() == first));
}

/// Checks that a lost border, a lost prior, or a weight that is 1 % off fails.
#[test]
fn geometry_loss_checks_can_fail() {
    let s = random_scene(24, 18, 17);
    let n = 432.0;
    let exact = reference::geometry_loss_bwd(&s, &WEIGHTS);
    let differs = |other: &Gradient| {
        let narrow = |v: &[f64]| v.iter().map(|&x| x as f32).collect::<Vec<f32>>();
        let far = |e: &[f64], f: &[f64], t| worst(e, &narrow(f), t).is_some_and(|w| w.3 > 1.0);
        far(&flat(&exact.normals), &flat(&other.normals), tolerance(&flat(&exact.normals), 1e-5 / n, 1e-4))
            || far(&flat(&exact.depths), &flat(&other.depths), tolerance(&flat(&exact.depths), 2e-3 / n, 1e-3))
            || far(&exact.transmittance, &other.transmittance, tolerance(&exact.transmittance, 5e-3 / n, 1e-3))
    };
    assert!(!differs(&exact));
    assert!(differs(&reference::geometry_loss_bwd(&s, &Terms { depth_variance: 0.88, ..WEIGHTS })));
    assert!(differs(&reference::geometry_loss_bwd(&s, &Terms { depth_smooth: 0.51, ..WEIGHTS })));
    assert!(differs(&reference::geometry_loss_bwd(&s, &Terms { normal_smooth: 0.751, ..WEIGHTS })));
    assert!(differs(&reference::geometry_loss_bwd(&s, &Terms { depth: 0.65, ..WEIGHTS })));
    let mut other = s.clone();
    other.depth_priors.as_mut().unwrap()[100] = pack_depth(0.1, 1.0);
    assert!(differs(&reference::geometry_loss_bwd(&other, &WEIGHTS)));
    let mut other = s.clone();
    other.photo[100] &= 0x00ff_ffff;
    assert!(differs(&reference::geometry_loss_bwd(&other, &WEIGHTS)));
    let mut other = s.clone();
    other.priors.as_mut().unwrap()[100] ^= 0x8000_0000;
    assert!(differs(&reference::geometry_loss_bwd(&other, &WEIGHTS)));
    let mut other = exact.clone();
    other.depths[0] = other.depths[1];
    assert!(differs(&other));
    let mut other = exact.clone();
    other.transmittance[431] *= 1.1;
    assert!(differs(&other));
}
