//! Region correspondence loss on a device against its reference.

use sgs_passes::reference::correspondence as reference;
use sgs_passes::reference::correspondence::{Gradient, MaskedImage, Terms};
use sgs_passes::reference::rng::Pcg;
use sgs_passes::reference::semantic::Head as ReferenceHead;
use sgs_passes::scene::FEATURES;
use sgs_tests::regions::{Found, TEMPERATURE, WEIGHT, run};
use sgs_tests::semantics::head;
use sgs_tests::{Gpu, Tolerance, assert_close, worst};

fn bytes<T: bytemuck::NoUninit>(data: &[T]) -> Vec<u8> {
    bytemuck::cast_slice(data).to_vec()
}

/// Returns correlated random features of a view, and a mask.
///
/// The mask covers about `share` of the pixels.
fn random_features(size: [usize; 2], share: f64, seed: u32) -> ([usize; 2], MaskedImage) {
    let mut common = Pcg::new(77);
    let center: Vec<f64> = (0..FEATURES).map(|_| 2.0 * common.normal()).collect();
    let mut rng = Pcg::new(seed);
    let pixels = size[0] * size[1];
    let image = (0..pixels * FEATURES).map(|i| f64::from((center[i % FEATURES] + rng.normal()) as f32)).collect();
    (size, MaskedImage { image, mask: (0..pixels).map(|_| rng.uniform() < share).collect() })
}

fn tolerance(expected: &[f64]) -> Tolerance {
    let largest = expected.iter().fold(0.0_f64, |a, b| a.max(b.abs()));
    Tolerance::new(2e-5 * largest, 1e-4)
}

fn expected(h: &ReferenceHead, views: &[([usize; 2], MaskedImage)]) -> (Terms, Gradient) {
    let all: Vec<MaskedImage> = views.iter().map(|(_, p)| p.clone()).collect();
    reference::correspondence(h, &all[0], &all[1..], WEIGHT, TEMPERATURE)
}

#[track_caller]
fn check(gpu: &Gpu, what: &str, h: &ReferenceHead, views: &[([usize; 2], MaskedImage)]) -> Found {
    let found = run(gpu, h, views);
    let (terms, gradient) = expected(h, views);
    let t = Tolerance::new(2e-6, 5e-6);
    assert_close(&format!("distance of {what}"), &[terms.distance], &[found.stats.correspondence], t);
    assert_close(&format!("cross-entropy of {what}"), &[terms.class], &[found.stats.correspondence_class], t);
    let total = 0.5 + WEIGHT * (terms.distance + terms.class);
    assert_close(&format!("total of {what}"), &[total], &[found.stats.total], t);
    assert_eq!(found.stats.correspondence_pairs as usize, terms.pairs, "{what}");
    // The training view's gradient is added to previous contents, whose rounding counts.
    let coarse = Tolerance::new(tolerance(&gradient.train).absolute + 3e-8, 1e-4);
    assert_close(&format!("training view of {what}"), &gradient.train, &found.train, coarse);
    for (i, (e, f)) in gradient.pseudo.iter().zip(&found.pseudo).enumerate() {
        assert_close(&format!("pseudo-view {i} of {what}"), e, f, tolerance(e));
    }
    assert_close(&format!("decoder of {what}"), &gradient.decoder, &found.decoder, tolerance(&gradient.decoder));
    found
}

#[test]
fn correspondence_matches_reference() {
    let gpu = Gpu::new();
    let cases = [
        (1, vec![random_features([5, 5], 1.0, 1), random_features([4, 7], 1.0, 2)]),
        (
            9,
            vec![
                random_features([31, 17], 0.4, 3),
                random_features([37, 29], 0.5, 4),
                random_features([16, 1], 1.0, 5),
            ],
        ),
        (
            200,
            vec![
                random_features([16, 16], 0.9, 6),
                random_features([1, 33], 0.8, 7),
                random_features([13, 11], 0.5, 8),
            ],
        ),
    ];
    for (classes, views) in cases {
        let h = head(classes, classes as u32);
        let found = check(&gpu, &format!("{classes} classes"), &h, &views);
        assert!(found.train.iter().any(|&g| g != 0.0));
    }
}

#[test]
fn small_regions_have_no_correspondence() {
    let gpu = Gpu::new();
    let h = head(5, 3);
    let mut views =
        vec![random_features([12, 12], 0.5, 1), random_features([12, 12], 0.5, 2), random_features([12, 12], 0.0, 3)];
    views[2].1.mask[..15].fill(true);
    let found = check(&gpu, "15 pixels in one", &h, &views);
    assert!(found.stats.correspondence_pairs == 1 && found.pseudo[1].iter().all(|&g| g == 0.0));
    views[2].1.mask[15] = true;
    assert_eq!(check(&gpu, "16 pixels in one", &h, &views).stats.correspondence_pairs, 2);
    // A pixel with NaN is not counted.
    views[2].1.image[3 * FEATURES + 8] = f64::NAN;
    assert_eq!(check(&gpu, "15 good pixels in one", &h, &views).stats.correspondence_pairs, 1);
    views[0].1.mask.fill(false);
    let found = check(&gpu, "none in the training view", &h, &views);
    let all = found.train.iter().chain(found.pseudo.iter().flatten()).chain(&found.decoder);
    assert!(all.into_iter().all(|&g| g == 0.0) && found.stats.total == 0.5);
}

#[test]
fn correspondence_at_extremes() {
    let gpu = Gpu::new();
    let h = head(6, 4);
    for scale in [0.0, 1e-20, 1e4, 1e25] {
        let mut views = vec![random_features([11, 9], 0.6, 1), random_features([10, 10], 0.7, 2)];
        for (_, p) in &mut views {
            p.image.iter_mut().for_each(|x| *x = f64::from((scale * *x) as f32));
        }
        let found = check(&gpu, &format!("features times {scale}"), &h, &views);
        let all = found.train.iter().chain(found.pseudo.iter().flatten()).chain(&found.decoder);
        assert!(all.into_iter().all(|g| g.is_finite()));
    }
    // The same view twice has zero distance and no direction.
    let same = random_features([9, 9], 0.8, 5);
    let found = check(&gpu, "the same image", &h, &[same.clone(), same]);
    assert!(found.stats.correspondence == 0.0 && found.train.iter().all(|&g| g == 0.0));
}

#[test]
fn correspondence_is_deterministic() {
    let gpu = Gpu::new();
    let h = head(7, 8);
    let views =
        [random_features([37, 29], 0.7, 1), random_features([30, 29], 0.7, 2), random_features([37, 20], 0.7, 3)];
    let once = || {
        let f = run(&gpu, &h, &views);
        [bytes(&f.train), bytes(&f.pseudo.concat()), bytes(&f.decoder), bytes(&[f.stats])]
    };
    let first = once();
    assert!((0..3).all(|_| once() == first));
}

/// Checks that the comparison fails for three planted errors.
///
/// The errors are a lost pixel, a view left out of the mean, and a lost distance.
#[test]
fn correspondence_checks_can_fail() {
    let h = head(7, 8);
    let views =
        [random_features([20, 10], 0.7, 1), random_features([10, 20], 0.7, 2), random_features([15, 9], 0.7, 3)];
    let exact = expected(&h, &views).1;
    let differs = |other: &Gradient| {
        let narrow = |v: &[f64]| v.iter().map(|&x| x as f32).collect::<Vec<f32>>();
        let far = |e: &[f64], f: &[f64]| worst(e, &narrow(f), tolerance(e)).is_some_and(|w| w.3 > 1.0);
        [far(&exact.train, &other.train), far(&exact.pseudo[0], &other.pseudo[0]), far(&exact.decoder, &other.decoder)]
    };
    assert_eq!(differs(&exact), [false; 3]);
    let mut other = views.clone();
    let lost = other[1].1.mask.iter().position(|&m| m).unwrap();
    other[1].1.mask[lost] = false;
    assert_eq!(differs(&expected(&h, &other).1), [true; 3]);
    let mut other = exact.clone();
    other.train.iter_mut().for_each(|g| *g *= 1.001);
    assert_eq!(differs(&other), [true, false, false]);
    let all: Vec<MaskedImage> = views.iter().map(|(_, p)| p.clone()).collect();
    let summed = reference::correspondence(&h, &all[0], &all[1..], 2.0 * WEIGHT, TEMPERATURE).1;
    assert_eq!(differs(&summed), [true; 3]);
}
