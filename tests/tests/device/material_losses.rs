//! Material losses on the device against their references. Gradients are also tested against finite differences of the
//! references.

use sgs_passes::Tuning;
use sgs_passes::reference::rng::Pcg;
use sgs_shaders::structs::MaterialStats;
use sgs_tests::materials::{Expected, Found, Painted, Requested, expected, narrow, run};
use sgs_tests::photographs::{INVALID, invalidate};
use sgs_tests::{Gpu, Tolerance, assert_close, worst};

/// Returns a tolerance relative to the largest gradient. Gradients scale with the inverse of the number of pixels.
fn tolerance(expected: &[f64]) -> Tolerance {
    let largest = expected.iter().fold(0.0_f64, |a, b| a.max(b.abs()));
    Tolerance::new(1e-7_f64.min(1e-3 / expected.len() as f64).max(2e-5 * largest), 2e-4)
}

fn terms(s: &MaterialStats) -> [f32; 7] {
    [s.albedo_msg, s.roughness_msg, s.albedo_edge, s.roughness_edge, s.cross_view, s.relight, s.own_prior]
}

fn compare(e: &Expected, found: &Found, what: &str) {
    for (k, (e, f)) in e.albedo.iter().zip(&found.albedo).enumerate() {
        assert_close(&format!("{what}: albedo of view {k}"), e, f, tolerance(e));
    }
    assert_close(&format!("{what}: roughness"), &e.roughness, &found.roughness, tolerance(&e.roughness));
    assert_close(&format!("{what}: terms"), &e.terms, &terms(&found.stats), Tolerance::new(1e-6, 2e-5));
    assert_close(&format!("{what}: total"), &[e.total], &[found.stats.total], Tolerance::new(1e-6, 2e-5));
}

/// Compares losses at the device's subgroup size and at 64; returns the latter.
fn check(gpu: &Gpu, views: &[Painted], requested: Requested) -> Found {
    let e = expected(views, requested);
    let wide = Tuning { subgroup_size: 64, ..gpu.tuning() };
    let [_, found] = [gpu.tuning(), wide].map(|tuning| {
        let found = run(gpu, tuning, views, requested);
        compare(&e, &found, &format!("{:?} {requested:?}", views[0].size));
        found
    });
    found
}

const SIZES: [[usize; 2]; 9] = [[1, 1], [2, 2], [17, 3], [1, 40], [40, 1], [28, 16], [29, 17], [57, 33], [121, 83]];

#[test]
fn smoothness_loss_matches_reference() {
    let gpu = Gpu::new();
    for (i, size) in SIZES.into_iter().enumerate() {
        for roughness in [true, false] {
            check(&gpu, &[Painted::new(size, i as u32)], Requested { edge: true, roughness, ..Default::default() });
        }
    }
}

/// Tests patterns of invalid pixels of the photograph. Materials there are NaN or huge.
#[test]
fn invalid_pixels_have_no_smoothness_loss_and_no_gradient() {
    let gpu = Gpu::new();
    for (i, size) in [[1, 1], [2, 2], [17, 3], [57, 33]].into_iter().enumerate() {
        for (name, pattern) in INVALID {
            let requested = Requested { edge: true, roughness: true, ..Default::default() };
            let mut v = Painted::new(size, 30 + i as u32);
            let invalid = invalidate(&mut v.photo, size, pattern);
            let plain = check(&gpu, &[v.clone()], requested);
            for &p in &invalid {
                let bad = if p % 2 == 0 { f64::NAN } else { 1e30 };
                v.albedo[3 * p..3 * p + 3].fill(bad);
                v.roughness[p] = bad;
            }
            let found = check(&gpu, &[v], requested);
            let what = format!("{name} at {size:?}");
            assert!(found.albedo == plain.albedo && found.roughness == plain.roughness, "{what}");
            assert_eq!(found.stats, plain.stats, "{what}");
            for p in invalid {
                let of_pixel = found.albedo[0][3 * p..][..3].iter().chain(&found.roughness[3 * p..][..3]);
                assert!(of_pixel.into_iter().all(|g| *g == 0.0), "{what}: pixel {p}");
            }
        }
    }
}

#[test]
fn multiscale_gradient_loss_matches_reference() {
    let gpu = Gpu::new();
    for (i, size) in SIZES.into_iter().enumerate() {
        let v = [Painted::new(size, 20 + i as u32)];
        check(&gpu, &v, Requested { msg: true, roughness: true, ..Default::default() });
        check(&gpu, &v, Requested { msg: true, masked: true, ..Default::default() });
    }
}

#[test]
fn relight_loss_matches_reference() {
    let gpu = Gpu::new();
    for (i, size) in [[1, 1], [29, 17], [57, 33], [90, 70]].into_iter().enumerate() {
        for estimates in 1..=2 {
            let v = [Painted::new(size, 40 + i as u32)];
            let found = check(&gpu, &v, Requested { estimates, ..Default::default() });
            assert_eq!(found.stats.relight_count as usize, if i == 0 { 0 } else { estimates }, "{size:?}");
            // The view's own prior has a weight and a term of its own.
            let found = check(&gpu, &v, Requested { estimates, own: true, ..Default::default() });
            assert_eq!(found.stats.own_count, u32::from(i > 0), "{size:?}");
        }
    }
}

#[test]
fn cross_view_region_loss_matches_reference() {
    let gpu = Gpu::new();
    for pseudo in [1, 2, 4] {
        let sizes = [[45, 33], [120, 80], [31, 9], [57, 33], [64, 2]];
        let views: Vec<Painted> = (0..=pseudo).map(|k| Painted::new(sizes[k], 60 + k as u32)).collect();
        let found = check(&gpu, &views, Requested { cross: true, ..Default::default() });
        assert_eq!(found.stats.cross_pairs as usize, pseudo);
    }
}

#[test]
fn small_regions_and_equal_means_have_zero_gradient() {
    let gpu = Gpu::new();
    let requested = Requested { cross: true, ..Default::default() };
    let mut views = vec![Painted::new([24, 18], 1), Painted::new([20, 20], 2), Painted::new([24, 18], 1)];
    views[1].mask = (0..400).map(|p| p < 15).collect();
    let found = check(&gpu, &views, requested);
    // The third view equals the first; the region of the second is too small.
    assert_eq!(found.stats.cross_pairs, 1);
    assert!(found.albedo.iter().flatten().all(|g| *g == 0.0));
    views[1].mask[15] = true;
    let found = check(&gpu, &views, requested);
    assert_eq!(found.stats.cross_pairs, 2);
    views[0].mask.fill(false);
    let found = check(&gpu, &views, requested);
    assert_eq!((found.stats.cross_pairs, found.stats.cross_view), (0, 0.0));
}

#[test]
fn losses_without_valid_pixels_are_zero() {
    let gpu = Gpu::new();
    let requested = Requested { msg: true, roughness: true, masked: true, estimates: 2, ..Default::default() };
    let mut v = Painted::new([33, 21], 5);
    v.mask.fill(false);
    let found = check(&gpu, &[v.clone()], requested);
    let all = || found.albedo[0].iter().chain(&found.roughness);
    assert!(all().all(|g| *g == 0.0) && found.stats.total == 0.0 && found.stats.relight_count == 0);
    // One pixel: squared differences exist, but no gradient at any scale.
    v.mask[200] = true;
    v.albedo_prior[200] |= 0xff00_0000;
    v.estimates[0][200] |= 0xff00_0000;
    v.coverage[200] = 1.0;
    let found = check(&gpu, &[v.clone()], requested);
    assert!(found.stats.albedo_msg == 0.0 && found.stats.relight > 0.0 && found.stats.relight_count == 2);
    // Material values where the prior is missing have no effect.
    let requested = Requested { masked: false, estimates: 0, ..requested };
    let before = run(&gpu, gpu.tuning(), &[v.clone()], requested);
    for p in (0..v.pixels()).filter(|p| v.albedo_prior[*p] >> 24 == 0 || v.coverage[*p] < 0.5) {
        v.albedo[3 * p..3 * p + 3].fill(1e30);
    }
    let after = run(&gpu, gpu.tuning(), &[v], requested);
    assert_eq!(before.albedo, after.albedo);
}

/// Tests that the case of the tests above reaches the coarsest level and has holes.
#[test]
fn material_case_reaches_coarsest_level_and_has_holes() {
    let v = Painted::new([121, 83], 28);
    let d = v.albedo_difference(&v.albedo_prior, false);
    assert!(d.present.iter().any(|p| !p));
    assert!(counted(&v) >= 20);
}

/// Counts the pixels of the coarsest level that depend on no missing pixel.
fn counted(v: &Painted) -> usize {
    let d = v.albedo_difference(&v.albedo_prior, false);
    let [width, height] = v.size.map(|n| n / 8);
    let whole = |x: usize, y: usize| {
        let rows = (8 * y).saturating_sub(16)..(8 * y + 28).min(v.size[1]);
        rows.into_iter()
            .all(|r| ((8 * x).saturating_sub(16)..(8 * x + 28).min(v.size[0])).all(|c| d.present[r * v.size[0] + c]))
    };
    (0..width * height).filter(|i| whole(i % width, i / width)).count()
}

/// Tests the sum of all losses together, and that a second run gives the same bits.
#[test]
fn losses_accumulate_and_are_deterministic() {
    let gpu = Gpu::new();
    let views: Vec<Painted> =
        [[97, 61], [60, 40], [33, 80]].iter().enumerate().map(|(k, &s)| Painted::new(s, 80 + k as u32)).collect();
    let requested =
        Requested { edge: true, msg: true, roughness: true, masked: false, estimates: 2, cross: true, own: false };
    let first = check(&gpu, &views, requested);
    let again = run(&gpu, Tuning { subgroup_size: 64, ..gpu.tuning() }, &views, requested);
    let bits = |f: &Found| -> Vec<u32> { f.albedo.iter().flatten().chain(&f.roughness).map(|g| g.to_bits()).collect() };
    assert_eq!((bits(&first), first.stats), (bits(&again), again.stats));
}

#[test]
fn gradients_are_finite_differences_of_the_reference() {
    let gpu = Gpu::new();
    let views: Vec<Painted> =
        [[41, 27], [30, 30], [20, 40]].iter().enumerate().map(|(k, &s)| Painted::new(s, 90 + k as u32)).collect();
    let only = Requested { roughness: true, ..Default::default() };
    let each = [
        Requested { edge: true, ..only },
        Requested { msg: true, ..only },
        Requested { estimates: 2, ..only },
        Requested { cross: true, ..only },
    ];
    let mut rng = Pcg::new(5);
    let mut masked = views.clone();
    invalidate(&mut masked[0].photo, [41, 27], INVALID[0].1);
    let cases = each.map(|requested| (&views, requested)).into_iter().chain([(&masked, each[0])]);
    for (views, requested) in cases {
        let found = run(&gpu, gpu.tuning(), views, requested);
        for _ in 0..4 {
            let along: Vec<Vec<f64>> =
                views.iter().map(|v| (0..4 * v.pixels()).map(|_| rng.normal()).collect()).collect();
            let loss = |t: f64| {
                let mut moved = views.to_vec();
                for (v, along) in moved.iter_mut().zip(&along) {
                    v.albedo.iter_mut().zip(along).for_each(|(x, d)| *x += t * d);
                    v.roughness.iter_mut().zip(&along[3 * v.size[0] * v.size[1]..]).for_each(|(x, d)| *x += t * d);
                }
                expected(&moved, requested).total
            };
            // The step is so small that no filter of the smoothness loss changes its sign.
            let fd = (loss(1e-8) - loss(-1e-8)) / 2e-8;
            let dot = |g: &[f32], d: &[f64]| g.iter().zip(d).map(|(g, d)| f64::from(*g) * d).sum::<f64>();
            let gray: Vec<f32> = found.roughness.iter().step_by(3).copied().collect();
            let sum = found.albedo.iter().zip(&along).map(|(g, d)| dot(g, d)).sum::<f64>()
                + dot(&gray, &along[0][3 * views[0].pixels()..]);
            assert_close(&format!("{requested:?}"), &[fd], &[sum as f32], Tolerance::new(1e-5, 5e-4));
        }
    }
}

/// Tests that the comparisons detect planted errors. Errors are: a hole too many, a pixel of a mask, a changed border,
/// a weight off by a percent.
#[test]
fn checks_can_fail() {
    let views = [Painted::new([41, 27], 7), Painted::new([30, 30], 8)];
    let requested =
        Requested { edge: true, msg: true, roughness: true, masked: true, estimates: 1, cross: true, own: false };
    let exact = expected(&views, requested);
    let differs = |views: &[Painted], factor: f64| {
        let e = expected(views, requested);
        let single = |v: &[f64]| v.iter().map(|x| (factor * x) as f32).collect::<Vec<f32>>();
        let far = |e: &[f64], f: &[f64]| worst(e, &single(f), tolerance(e)).is_some_and(|w| w.3 > 1.0);
        exact.albedo.iter().zip(&e.albedo).any(|(e, f)| far(e, f)) || far(&exact.roughness, &e.roughness)
    };
    assert!(!differs(&views, 1.0));
    assert!(differs(&views, 1.01));
    let changed = |change: &dyn Fn(&mut [Painted; 2])| {
        let mut other = views.clone();
        change(&mut other);
        differs(&other, 1.0)
    };
    assert!(changed(&|v| v[0].albedo_prior[41 * 13 + 20] ^= 0xff00_0000));
    assert!(changed(&|v| v[0].roughness_prior[41 * 13 + 20] ^= 0x10));
    assert!(changed(&|v| v[0].estimates[0][41 * 13 + 20] ^= 0x10));
    assert!(changed(&|v| v[0].coverage[41 * 13 + 20] = 0.49));
    assert!(changed(&|v| v[0].photo[0] ^= 0x80));
    assert!(changed(&|v| v[0].photo[41 * 13 + 20] &= 0x00ff_ffff));
    assert!(changed(&|v| v[1].mask[30 * 15 + 15] = false));
    assert!(changed(&|v| v[0].mask[41 * 13 + 20] = false));
    assert!(changed(&|v| v[0].albedo[0] = narrow(v[0].albedo[0] + 0.3)));
}
