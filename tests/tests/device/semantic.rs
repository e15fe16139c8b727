//! Semantic loss on the device against its reference.

use half::f16;
use sgs_passes::loss::NO_LABEL;
use sgs_passes::reference::rng::Pcg;
use sgs_passes::reference::semantic as reference;
use sgs_passes::reference::semantic::{Gradient, Terms, View, Weights};
use sgs_passes::scene::{AUGMENTED, EMBEDDING, FEATURES};
use sgs_tests::semantics::{Found, WEIGHTS, head, run, run_steps, view};
use sgs_tests::surfaces::narrow;
use sgs_tests::{Gpu, Tolerance, assert_close, worst};

fn bytes<T: bytemuck::NoUninit>(data: &[T]) -> Vec<u8> {
    bytemuck::cast_slice(data).to_vec()
}

/// Returns a tolerance with a share of the largest gradient and a relative part.
fn tolerance(expected: &[f64]) -> Tolerance {
    let largest = expected.iter().fold(0.0_f64, |a, b| a.max(b.abs()));
    Tolerance::new(2e-5 * largest, 1e-4)
}

#[track_caller]
fn compare(what: &str, terms: &Terms, gradient: &Gradient, weights: &Weights, found: &Found) {
    let t = Tolerance::new(2e-6, 2e-6);
    assert_close(&format!("cosine of {what}"), &[terms.cosine], &[found.stats.semantic], t);
    assert_close(&format!("cross-entropy of {what}"), &[terms.class], &[found.stats.semantic_class], t);
    let total = weights.cosine * terms.cosine + weights.class * terms.class;
    assert_close(&format!("total of {what}"), &[total], &[found.stats.total], Tolerance::new(4e-6, 4e-6));
    assert_close(&format!("features of {what}"), &gradient.image, &found.image, tolerance(&gradient.image));
    assert_close(&format!("decoder of {what}"), &gradient.decoder, &found.decoder, tolerance(&gradient.decoder));
}

fn check(gpu: &Gpu, what: &str, h: &reference::Head, v: &View, has_labels: bool, largest: [u32; 2]) -> Found {
    let found = run(gpu, h, v, has_labels, largest, &WEIGHTS);
    let (terms, gradient) = reference::semantic_loss(h, v, &WEIGHTS);
    compare(what, &terms, &gradient, &WEIGHTS, &found);
    found
}

#[test]
fn semantic_loss_matches_reference_at_odd_sizes() {
    let gpu = Gpu::new();
    let sizes = [
        ([1, 1], [1, 1], 1),
        ([7, 5], [1, 1], 3),
        ([1, 9], [4, 6], 2),
        ([17, 13], [9, 1], 8),
        ([13, 11], [5, 4], 9),
        ([6, 5], [19, 23], 27),
        ([12, 10], [12, 10], 17),
        ([33, 21], [16, 10], 200),
    ];
    for (i, (size, map, classes)) in sizes.into_iter().enumerate() {
        let h = head(classes, i as u32);
        let v = view(size, map, &h, i as u32);
        let found = check(&gpu, &format!("{size:?} {map:?}"), &h, &v, false, size.map(|n| n as u32));
        let labels: Vec<Option<usize>> = found.targets.iter().map(|t| Some(t.label as usize)).collect();
        assert_eq!(labels, v.labels);
        assert_eq!(found.stats.semantic_excluded, 0);
    }
    let h = head(5, 40);
    let none = View { map: [0, 0], targets: vec![], labels: vec![], ..view([9, 7], [1, 1], &h, 1) };
    let found = check(&gpu, "a view without a map", &h, &none, false, [9, 7]);
    assert!(found.image.iter().chain(&found.decoder).all(|&g| g == 0.0));
    check(&gpu, "a small view of a large buffer", &h, &view([9, 7], [6, 8], &h, 1), false, [31, 20]);
}

/// Tests a map that needs several runs of the product over samples. Several rounds of all workgroups would need 32768
/// samples. Rounds work alike at any number of workgroups; runs do not.
#[test]
fn semantic_loss_of_a_map_of_several_runs_matches_reference() {
    let gpu = Gpu::new();
    let h = head(3, 4);
    let v = view([20, 15], [67, 41], &h, 4);
    assert!(v.labels.len() > 2048);
    check(&gpu, "a large map", &h, &v, false, [20, 15]);
}

#[test]
fn pixels_without_labels_are_skipped_and_counted() {
    let gpu = Gpu::new();
    let h = head(6, 2);
    let mut v = view([11, 9], [8, 6], &h, 2);
    v.targets[..EMBEDDING].fill(0.0);
    v.targets[5 * EMBEDDING + 77] = f64::NAN;
    v.targets[9 * EMBEDDING] = f64::INFINITY;
    v.targets[20 * EMBEDDING + 511] = f64::NEG_INFINITY;
    v.labels = v.own_labels(&h);
    let found = check(&gpu, "bad targets", &h, &v, false, [11, 9]);
    assert_eq!(found.stats.semantic_excluded, 4);
    for i in [0, 5, 9, 20] {
        assert_eq!((found.targets[i].inverse_norm, found.targets[i].label), (0.0, NO_LABEL));
    }
    // Of the given labels, some are absent and one is out of range.
    v.labels.iter_mut().step_by(3).for_each(|l| *l = None);
    v.labels[7] = Some(6);
    v.labels[8] = Some(5);
    let found = check(&gpu, "given labels", &h, &v, true, [11, 9]);
    assert_eq!(found.targets[7].label, NO_LABEL);
    assert_eq!(found.targets[8].label, 5);
    // Non-finite features also exclude the samples around them.
    v.image[(4 * 11 + 5) * FEATURES + 3] = f64::NAN;
    v.image[(8 * 11 + 10) * FEATURES + 31] = f64::INFINITY;
    let found = check(&gpu, "bad features", &h, &v, true, [11, 9]);
    assert!(found.stats.semantic_excluded > 4);
    v.targets.fill(0.0);
    let found = check(&gpu, "no target at all", &h, &v, false, [11, 9]);
    assert!(found.image.iter().chain(&found.decoder).all(|&g| g == 0.0) && found.stats.total == 0.0);
    assert_eq!(found.stats.semantic_excluded, 48);
}

#[test]
fn semantic_loss_at_extremes() {
    let gpu = Gpu::new();
    let h = head(4, 3);
    let base = view([6, 5], [5, 5], &h, 3);
    let scaled = |s: f64| View { image: base.image.iter().map(|x| narrow(s * x)).collect(), ..base.clone() };
    for scale in [0.0, 1e-30, 1e-3, 1e3, 1e10, 1e19, 1e30] {
        let found = check(&gpu, &format!("features times {scale}"), &h, &scaled(scale), false, [6, 5]);
        assert!(found.image.iter().chain(&found.decoder).all(|g| g.is_finite()));
    }
    let mut mixed = base.clone();
    mixed.image[..FEATURES].fill(1e25);
    mixed.image[7 * FEATURES] = -1e12;
    check(&gpu, "some huge features", &h, &mixed, false, [6, 5]);
    for scale in [6e-8, 1e-4, 60000.0] {
        let mut v = base.clone();
        v.targets.iter_mut().for_each(|t| *t = f16::from_f64(scale * t.clamp(-1.0, 1.0)).to_f64());
        v.labels = v.own_labels(&h);
        check(&gpu, &format!("targets times {scale}"), &h, &v, false, [6, 5]);
    }
    // A decoder of zeros has no direction and no gradient.
    let mut nothing = h.clone();
    nothing.decoder.fill(0.0);
    let found = check(&gpu, "a decoder of zeros", &nothing, &base, false, [6, 5]);
    assert!(found.image.iter().chain(&found.decoder).all(|&g| g == 0.0));
    let mut no_bias = h.clone();
    no_bias.decoder.iter_mut().skip(FEATURES).step_by(AUGMENTED).for_each(|b| *b = 0.0);
    let found = check(&gpu, "zero features without bias", &no_bias, &scaled(0.0), false, [6, 5]);
    assert!(found.image.iter().chain(&found.decoder).all(|&g| g == 0.0));
    // Columns that are almost alike cancel. Only rounding remains, which has no direction either.
    let mut alike = no_bias.clone();
    let mut rng = Pcg::new(9);
    for row in alike.decoder.chunks_mut(AUGMENTED) {
        let first = row[0];
        row[..FEATURES].iter_mut().for_each(|w| *w = narrow(first * (1.0 + 1e-5 * rng.normal())));
    }
    let mut opposed = base.clone();
    for f in opposed.image.chunks_mut(FEATURES) {
        let mean = f.iter().sum::<f64>() / FEATURES as f64;
        f.iter_mut().for_each(|x| *x = narrow(*x - mean));
    }
    let found = check(&gpu, "features that cancel", &alike, &opposed, false, [6, 5]);
    let largest = found.image.iter().chain(&found.decoder).fold(0.0_f32, |m, g| m.max(g.abs()));
    assert!(largest == 0.0, "what rounding left pulls by {largest}");
    // Temperatures give sharp and flat softmax.
    for temperature in [1e-3, 0.01, 100.0] {
        let weights = Weights { temperature, ..WEIGHTS };
        let (terms, gradient) = reference::semantic_loss(&h, &base, &weights);
        let found = run(&gpu, &h, &base, false, [6, 5], &weights);
        let close = |e: &[f64], f: &[f32], t: f64| {
            let largest = e.iter().fold(0.0_f64, |a, b| a.max(b.abs()));
            assert_close(&format!("temperature {temperature}"), e, f, Tolerance::new(t * largest, 1e-3));
        };
        assert_close("cross-entropy", &[terms.class], &[found.stats.semantic_class], Tolerance::new(1e-5, 1e-4));
        // Logits and probabilities have an error of 1e-7 over the temperature.
        close(&gradient.image, &found.image, 1e-4 + 1e-6 / temperature);
        close(&gradient.decoder, &found.decoder, 1e-4 + 1e-6 / temperature);
    }
}

#[test]
fn semantic_loss_gradient_is_the_finite_difference_of_the_reference() {
    let gpu = Gpu::new();
    let h = head(7, 5);
    let v = view([5, 4], [7, 3], &h, 5);
    let found = run(&gpu, &h, &v, false, [5, 4], &WEIGHTS);
    let total = |h: &reference::Head, v: &View| {
        let t = reference::semantic_loss(h, v, &WEIGHTS).0;
        WEIGHTS.cosine * t.cosine + WEIGHTS.class * t.class
    };
    let mut rng = Pcg::new(6);
    for _ in 0..6 {
        let direction: Vec<f64> = v.image.iter().map(|_| rng.normal()).collect();
        let along = |t: f64| {
            let image = v.image.iter().zip(&direction).map(|(x, d)| x + t * d).collect();
            total(&h, &View { image, ..v.clone() })
        };
        let fd = (along(1e-6) - along(-1e-6)) / 2e-6;
        let dot: f64 = found.image.iter().zip(&direction).map(|(&g, d)| f64::from(g) * d).sum();
        assert_close("features", &[fd], &[dot as f32], Tolerance::new(1e-6, 1e-4));
        let direction: Vec<f64> = h.decoder.iter().map(|_| rng.normal()).collect();
        let along = |t: f64| {
            let decoder = h.decoder.iter().zip(&direction).map(|(x, d)| x + t * d).collect();
            total(&reference::Head { decoder, ..h.clone() }, &v)
        };
        let fd = (along(1e-6) - along(-1e-6)) / 2e-6;
        let dot: f64 = found.decoder.iter().zip(&direction).map(|(&g, d)| f64::from(g) * d).sum();
        assert_close("decoder", &[fd], &[dot as f32], Tolerance::new(1e-6, 1e-4));
    }
}

#[test]
fn semantic_loss_is_deterministic() {
    let gpu = Gpu::new();
    let h = head(11, 7);
    let v = view([23, 17], [14, 19], &h, 7);
    let once = || {
        let f = run(&gpu, &h, &v, false, [23, 17], &WEIGHTS);
        [bytes(&f.image), bytes(&f.decoder), bytes(&[f.stats])]
    };
    let first = once();
    assert!((0..3).all(|_| once() == first));
}

/// Tests that the comparisons detect planted errors. Errors are: a lost sample, a wrong label, a missing bias, a weight
/// off by a tenth of a percent.
#[test]
fn semantic_checks_can_fail() {
    let h = head(7, 5);
    let v = view([9, 8], [7, 6], &h, 5);
    let exact = reference::semantic_loss(&h, &v, &WEIGHTS).1;
    let differs = |other: &Gradient| {
        let narrow = |v: &[f64]| v.iter().map(|&x| x as f32).collect::<Vec<f32>>();
        let far = |e: &[f64], f: &[f64]| worst(e, &narrow(f), tolerance(e)).is_some_and(|w| w.3 > 1.0);
        [far(&exact.image, &other.image), far(&exact.decoder, &other.decoder)]
    };
    let of = |h: &reference::Head, v: &View, w: Weights| reference::semantic_loss(h, v, &w).1;
    assert_eq!(differs(&exact), [false; 2]);
    assert_eq!(differs(&of(&h, &v, Weights { cosine: 0.751, ..WEIGHTS })), [true; 2]);
    assert_eq!(differs(&of(&h, &v, Weights { class: 1.252, ..WEIGHTS })), [true; 2]);
    assert_eq!(differs(&of(&h, &v, Weights { temperature: 0.501, ..WEIGHTS })), [true; 2]);
    let mut other = v.clone();
    other.labels[13] = Some(other.labels[13].map_or(0, |l| (l + 1) % 7));
    assert_eq!(differs(&of(&h, &other, WEIGHTS)), [true; 2]);
    let mut other = v.clone();
    other.targets[3 * EMBEDDING..4 * EMBEDDING].fill(0.0);
    assert_eq!(differs(&of(&h, &other, WEIGHTS)), [true; 2]);
    let mut other = h.clone();
    other.decoder[FEATURES] = 0.0;
    assert_eq!(differs(&of(&other, &v, WEIGHTS)), [true; 2]);
    let mut other = exact.clone();
    other.image[100] = 0.0;
    assert_eq!(differs(&other), [true, false]);
}

/// Tests that training fits a decoder to its targets. Gram matrices, loss, gradient and Adam work together.
#[test]
fn decoder_fits_its_targets() {
    let gpu = Gpu::new();
    let h = head(4, 12);
    let v = view([4, 4], [4, 4], &h, 12);
    let weights = Weights { cosine: 1.0, class: 1.0, temperature: 1.0 };
    let before = reference::semantic_loss(&h, &v, &weights).0;
    let found = run_steps(&gpu, &h, &v, false, [4, 4], &weights, 60);
    let learned = reference::Head { decoder: found.learned.iter().map(|&x| f64::from(x)).collect(), ..h };
    let after = reference::semantic_loss(&learned, &v, &weights).0;
    assert!(before.cosine > 0.8 && after.cosine < 0.1 && after.class < before.class - 0.3, "{before:?} {after:?}");
}
