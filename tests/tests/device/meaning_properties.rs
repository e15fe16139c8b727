//! Semantic loss and region correspondence against references in double precision. Inputs are drawn log-uniformly, and
//! failures are shrunk. Draws are the same in every run; `SGS_TEST_CASES` sets their number.

use half::f16;
use proptest::prelude::*;
use sgs_passes::reference::correspondence::{self, MaskedImage};
use sgs_passes::reference::rng::Pcg;
use sgs_passes::reference::semantic::{self as reference, Gradient, Head, Terms, View, Weights};
use sgs_passes::scene::{AUGMENTED, EMBEDDING, FEATURES};
use sgs_tests::drawn::{log_uniform, powers, runner, spread};
use sgs_tests::surfaces::narrow;
use sgs_tests::{Gpu, regions, semantics};
use std::cell::Cell;

/// Relative perturbation of inputs.
const MOVE: f64 = 4e-7;
const DRAWS: usize = 3;
/// Relative rounding error of sums, a few units in the last place.
const UNITS: f64 = 3e-7;

/// Decoder and text embeddings. `weights` and `bias` are scales.
#[derive(Clone, Debug)]
struct Decoder {
    classes: usize,
    weights: f64,
    bias: f64,
    /// Ratio of the component that columns share to their own.
    alike: f64,
    seed: u32,
}

prop_compose! {
    fn decoders()(
        classes in prop_oneof![1..12_usize, 12..70_usize],
        weights in spread(-4.0, 3.0),
        bias in prop_oneof![Just(0.0), spread(-4.0, 3.0)],
        alike in prop_oneof![Just(0.0), spread(-2.0, 4.0)],
        seed in 0..1_000_000_u32,
    ) -> Decoder {
        Decoder { classes, weights, bias, alike, seed }
    }
}

impl Decoder {
    fn head(&self) -> Head {
        let mut head = semantics::head(self.classes, self.seed);
        for row in head.decoder.chunks_mut(AUGMENTED) {
            let first = row[0];
            row[..FEATURES].iter_mut().for_each(|w| *w = narrow(self.weights * (*w + self.alike * first)));
            row[FEATURES] = narrow(self.bias * row[FEATURES]);
        }
        head
    }
}

/// Returns the decoder with perturbed weights.
fn moved(head: &Head, rng: &mut Pcg) -> Head {
    let decoder = head.decoder.iter().map(|w| w * (1.0 + MOVE * rng.range(-1.0, 1.0))).collect();
    Head { decoder, ..head.clone() }
}

/// View and its map of targets.
#[derive(Clone, Debug)]
struct Seen {
    decoder: Decoder,
    size: [usize; 2],
    map: [usize; 2],
    /// Powers of ten of the features of pixels.
    features: [f64; 2],
    /// Factor on the mean of a pixel's features. Columns that are alike respond to the mean alone.
    balance: f64,
    /// Powers of ten of the lengths of targets.
    targets: [f64; 2],
    /// Share of targets that are decoded features; others are text embeddings. `noise` is relative to the length.
    learned: f64,
    noise: f64,
    /// Share of targets and labels that are missing.
    holes: f64,
    has_labels: bool,
    weights: [f64; 2],
    temperature: f64,
    seed: u32,
}

prop_compose! {
    fn views()(
        decoder in decoders(),
        size in [1..20_usize, 1..20_usize],
        map in [1..12_usize, 1..12_usize],
        features in powers(-10.0, 10.0),
        balance in prop_oneof![Just(1.0), spread(-6.0, 0.0)],
        targets in powers(-6.0, 4.5),
        [learned, holes] in [prop_oneof![Just(0.0), 0.0..1.0], prop_oneof![Just(0.0), 0.0..1.0]],
        noise in spread(-5.0, 0.0),
        has_labels in any::<bool>(),
        weights in [spread(-4.0, 3.0), spread(-4.0, 3.0)],
        temperature in spread(-2.0, 2.0),
        seed in 0..1_000_000_u32,
    ) -> Seen {
        let weights = weights.map(narrow);
        Seen { decoder, size, map, features, balance, targets, learned, noise, holes, has_labels, weights, temperature, seed }
    }
}

impl Seen {
    fn weights(&self) -> Weights {
        Weights { cosine: self.weights[0], class: self.weights[1], temperature: 1.0 / narrow(1.0 / self.temperature) }
    }

    fn view(&self, head: &Head) -> View {
        let mut rng = Pcg::new(self.seed);
        let pixels = self.size[0] * self.size[1];
        let mut image = Vec::new();
        for _ in 0..pixels {
            let scale = log_uniform(&mut rng, self.features);
            let f = [(); FEATURES].map(|()| rng.normal());
            let mean = f.iter().sum::<f64>() / FEATURES as f64;
            image.extend(f.map(|x| narrow(scale * (x - mean + self.balance * mean))));
        }
        let samples = self.map[0] * self.map[1];
        let (mut targets, mut labels) = (Vec::new(), Vec::new());
        for i in 0..samples {
            // The target is near the decoded features of a pixel or near the text embedding of a class.
            let f = &image[i % pixels * FEATURES..][..FEATURES];
            let class = rng.next_u32() as usize % head.classes();
            let decoded = head
                .decoder
                .chunks(AUGMENTED)
                .map(|row| row[..FEATURES].iter().zip(f).map(|(w, f)| w * f).sum::<f64>() + row[FEATURES]);
            let vector: Vec<f64> = match rng.uniform() < self.learned {
                true => decoded.collect(),
                false => head.text[class * EMBEDDING..][..EMBEDDING].to_vec(),
            };
            let length = vector.iter().map(|x| x * x).sum::<f64>().sqrt().max(1e-30);
            let scale = log_uniform(&mut rng, self.targets) / length;
            let noise = self.noise * length / (EMBEDDING as f64).sqrt();
            let retained = if rng.uniform() < self.holes { [0.0, f64::NAN][i % 2] } else { 1.0 };
            let most = 60000.0;
            targets.extend(
                vector.iter().map(|x| {
                    f16::from_f64((retained * scale * (x + noise * rng.normal())).clamp(-most, most)).to_f64()
                }),
            );
            labels.push((rng.uniform() >= self.holes).then_some(class));
        }
        let mut view = View { size: self.size, image, map: self.map, targets, labels };
        if !self.has_labels {
            view.labels = view.own_labels(head);
        }
        view
    }
}

/// Compares a row of values with the reference. The tolerance is four times `off` (change of the reference under
/// perturbation) plus [`UNITS`] times `made_of` (sum of magnitudes of terms).
fn check_row(
    what: &str,
    is: &[f32],
    expected: &[f64],
    off: &[f64],
    made_of: &[f64],
    planted: f64,
) -> Result<(), TestCaseError> {
    prop_assert_eq!(is.len(), expected.len());
    for (i, x) in is.iter().enumerate() {
        let x = f64::from(*x) * planted;
        let t = 4.0 * off[i] + UNITS * made_of[i] + 1e-35;
        prop_assert!((x - expected[i]).abs() <= t, "{} {}: {} is not {}, to {}", what, i, x, expected[i], t);
    }
    Ok(())
}

/// Raises `off` to the differences of two rows where these are larger.
fn spread_out(off: &mut [f64], one: &[f64], other: &[f64]) {
    off.iter_mut().zip(one.iter().zip(other)).for_each(|(o, (a, b))| *o = o.max((a - b).abs()));
}

/// Compares a view's terms and gradients with the reference. The device's gradients are first multiplied by `planted`.
/// Increments `sure` if the reference is conclusive.
fn check_view(gpu: &Gpu, drawn: &Seen, planted: f64, sure: &Cell<u32>) -> Result<(), TestCaseError> {
    let (head, weights) = (drawn.decoder.head(), drawn.weights());
    let view = drawn.view(&head);
    let (terms, gradient, made_of) = reference::semantic_loss_rounding(&head, &view, &weights);
    if !made_of.sure {
        return Ok(());
    }
    sure.set(sure.get() + 1);
    let found = semantics::run(gpu, &head, &view, drawn.has_labels, drawn.size.map(|n| n as u32), &weights);
    let mut off = Gradient { image: vec![0.0; gradient.image.len()], decoder: vec![0.0; gradient.decoder.len()] };
    let mut off_terms = Terms::default();
    let mut rng = Pcg::new(4);
    for _ in 0..DRAWS {
        let image = view.image.iter().map(|x| x * (1.0 + MOVE * rng.range(-1.0, 1.0))).collect();
        let other = View { image, ..view.clone() };
        let (t, g) = reference::semantic_loss(&moved(&head, &mut rng), &other, &weights);
        spread_out(&mut off.image, &g.image, &gradient.image);
        spread_out(&mut off.decoder, &g.decoder, &gradient.decoder);
        off_terms.cosine = off_terms.cosine.max((t.cosine - terms.cosine).abs());
        off_terms.class = off_terms.class.max((t.class - terms.class).abs());
    }
    check_row("feature", &found.image, &gradient.image, &off.image, &made_of.gradient.image, planted)?;
    check_row("weight", &found.decoder, &gradient.decoder, &off.decoder, &made_of.gradient.decoder, planted)?;
    let (is, by) = (found.stats, &made_of.terms);
    check_row("cosine", &[is.semantic], &[terms.cosine], &[off_terms.cosine], &[by.cosine], 1.0)?;
    check_row("cross-entropy", &[is.semantic_class], &[terms.class], &[off_terms.class], &[by.class + terms.class], 1.0)
}

#[test]
fn semantic_losses_match_reference() {
    let (gpu, sure, all) = (Gpu::new(), Cell::new(0), Cell::new(0));
    let one = |d: Seen| {
        all.set(all.get() + 1);
        check_view(&gpu, &d, 1.0, &sure)
    };
    runner(24).run(&views(), one).unwrap_or_else(|e| panic!("{e}"));
    assert!(10 * sure.get() >= 8 * all.get(), "{} of {} views are sure", sure.get(), all.get());
}

/// Region in a training view and in pseudo-views.
#[derive(Clone, Debug)]
struct Region {
    decoder: Decoder,
    sizes: Vec<[usize; 2]>,
    /// Share of pixels in the region.
    share: f64,
    /// Share of pixels with a NaN among their features.
    holes: f64,
    /// Powers of ten of the features of pixels. `common` is the scale of the component that all pixels share.
    features: [f64; 2],
    common: f64,
    weight: f64,
    temperature: f64,
    seed: u32,
}

prop_compose! {
    fn areas()(
        decoder in decoders(),
        sizes in prop::collection::vec([1..24_usize, 1..24_usize], 2..5),
        share in 0.2..1.0_f64,
        holes in prop_oneof![Just(0.0), 0.0..0.5],
        features in powers(-8.0, 8.0),
        common in prop_oneof![Just(0.0), spread(-3.0, 4.0)],
        weight in spread(-4.0, 3.0),
        temperature in spread(-2.0, 2.0),
        seed in 0..1_000_000_u32,
    ) -> Region {
        let (weight, temperature) = (narrow(weight), 1.0 / narrow(1.0 / temperature));
        Region { decoder, sizes, share, holes, features, common, weight, temperature, seed }
    }
}

impl Region {
    fn images(&self) -> Vec<([usize; 2], MaskedImage)> {
        let mut rng = Pcg::new(self.seed);
        let center = [(); FEATURES].map(|()| self.common * rng.normal());
        let one = |&size: &[usize; 2]| {
            let pixels = size[0] * size[1];
            let mut image = Vec::new();
            for _ in 0..pixels {
                let scale = log_uniform(&mut rng, self.features);
                image.extend(center.map(|c| narrow(scale * (c + rng.normal()))));
                if rng.uniform() < self.holes {
                    let last = image.len() - 1;
                    image[last - rng.next_u32() as usize % FEATURES] = f64::NAN;
                }
            }
            let mask = (0..pixels).map(|_| rng.uniform() < self.share).collect();
            (size, MaskedImage { image, mask })
        };
        self.sizes.iter().map(one).collect()
    }
}

/// Compares a region's terms and gradients with the reference. The device's gradients are first multiplied by
/// `planted`. Increments `sure` if the reference is conclusive.
fn check_region(gpu: &Gpu, drawn: &Region, planted: f64, sure: &Cell<u32>) -> Result<(), TestCaseError> {
    let (head, images) = (drawn.decoder.head(), drawn.images());
    let all: Vec<MaskedImage> = images.iter().map(|(_, p)| p.clone()).collect();
    let by = [drawn.weight, drawn.temperature];
    let (terms, gradient, made_of) = correspondence::correspondence_rounding(&head, &all[0], &all[1..], by[0], by[1]);
    if !made_of.sure {
        return Ok(());
    }
    sure.set(sure.get() + 1);
    let found = regions::run_with(gpu, &head, &images, by, 0.0);
    prop_assert_eq!(found.stats.correspondence_pairs as usize, terms.pairs);
    let row = |g: &correspondence::Gradient| [g.train.clone(), g.pseudo.concat()].concat();
    let (features, sizes) = (row(&gradient), row(&made_of.gradient));
    let (mut off, mut off_decoder) = (vec![0.0; features.len()], vec![0.0; gradient.decoder.len()]);
    let mut off_terms = [0.0_f64; 2];
    let mut rng = Pcg::new(4);
    for _ in 0..DRAWS {
        let mut other = all.clone();
        other.iter_mut().flat_map(|p| &mut p.image).for_each(|x| *x *= 1.0 + MOVE * rng.range(-1.0, 1.0));
        let (t, g) = correspondence::correspondence(&moved(&head, &mut rng), &other[0], &other[1..], by[0], by[1]);
        spread_out(&mut off, &row(&g), &features);
        spread_out(&mut off_decoder, &g.decoder, &gradient.decoder);
        off_terms[0] = off_terms[0].max((t.distance - terms.distance).abs());
        off_terms[1] = off_terms[1].max((t.class - terms.class).abs());
    }
    let is = [found.train, found.pseudo.concat()].concat();
    check_row("feature", &is, &features, &off, &sizes, planted)?;
    check_row("weight", &found.decoder, &gradient.decoder, &off_decoder, &made_of.gradient.decoder, planted)?;
    let (is, by) = ([found.stats.correspondence, found.stats.correspondence_class], made_of.terms);
    let sizes = [by.distance, by.class + terms.class];
    check_row("term", &is, &[terms.distance, terms.class], &off_terms, &sizes, 1.0)
}

#[test]
fn correspondences_match_reference() {
    let (gpu, sure, all) = (Gpu::new(), Cell::new(0), Cell::new(0));
    let one = |d: Region| {
        all.set(all.get() + 1);
        check_region(&gpu, &d, 1.0, &sure)
    };
    runner(16).run(&areas(), one).unwrap_or_else(|e| panic!("{e}"));
    assert!(10 * sure.get() >= 8 * all.get(), "{} of {} regions are sure", sure.get(), all.get());
}

/// Tests that gradients off by 1 % are detected.
#[test]
fn semantic_property_checks_can_fail() {
    let (gpu, sure) = (Gpu::new(), Cell::new(0));
    let decoder = Decoder { classes: 9, weights: 1.0, bias: 1.0, alike: 0.0, seed: 3 };
    let drawn = Seen {
        decoder,
        size: [9, 7],
        map: [5, 6],
        features: [-1.0, 1.0],
        balance: 1.0,
        targets: [0.0, 0.5],
        learned: 0.3,
        noise: 0.1,
        holes: 0.1,
        has_labels: false,
        weights: [0.5, 0.25],
        temperature: 0.5,
        seed: 4,
    };
    assert!(check_view(&gpu, &drawn, 1.0, &sure).is_ok() && check_view(&gpu, &drawn, 1.01, &sure).is_err());
    let drawn = Region {
        decoder: drawn.decoder,
        sizes: vec![[9, 8], [7, 10], [8, 8]],
        share: 0.7,
        holes: 0.1,
        features: [-1.0, 1.0],
        common: 1.0,
        weight: 0.5,
        temperature: 0.5,
        seed: 5,
    };
    assert!(check_region(&gpu, &drawn, 1.0, &sure).is_ok() && check_region(&gpu, &drawn, 1.01, &sure).is_err());
    assert_eq!(sure.get(), 4);
}
