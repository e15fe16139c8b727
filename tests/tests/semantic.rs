//! The semantic loss on a device against its reference.

use half::f16;
use sgs_engine::graph::Graph;
use sgs_passes::loss::{
    Head, NO_LABEL, SemanticLoss, SemanticTargets, count_targets, decoder_gradient, normalize_embeddings, pack_mask,
    sampled_pixels, semantic_loss, semantic_prepare, semantic_sum, semantic_targets,
};
use sgs_passes::reference::rng::Pcg;
use sgs_passes::reference::semantic as twin;
use sgs_passes::reference::semantic::{Gradient, Terms, View, Weights};
use sgs_passes::scene::{AUGMENTED, Decoder, DecoderHandles, EMBEDDING, FEATURES, decoder_step};
use sgs_shaders::structs::{LossStats, SemanticTarget, Step, Work};
use sgs_tests::{Gpu, Tolerance, assert_close, worst};

/// Other views' samples before this one's.
const OFFSET: usize = 3;
/// Pixels behind this view's.
const SPARE: usize = 7;
const CHANNELS: usize = 38;
const FIRST: usize = 4;
const WEIGHTS: Weights = Weights { cosine: 0.75, class: 1.25, temperature: 0.5 };

fn bytes<T: bytemuck::NoUninit>(data: &[T]) -> Vec<u8> {
    bytemuck::cast_slice(data).to_vec()
}

fn narrow(x: f64) -> f64 {
    f64::from(x as f32)
}

/// A decoder as it starts, and texts.
fn head(classes: usize, seed: u32) -> twin::Head {
    let mut rng = Pcg::new(seed);
    let text: Vec<f32> = (0..classes * EMBEDDING).map(|_| rng.normal() as f32).collect();
    twin::Head {
        features: FEATURES,
        embedding: EMBEDDING,
        decoder: Decoder::initial(seed).into_iter().map(f64::from).collect(),
        text: normalize_embeddings(&text).into_iter().map(f64::from).collect(),
    }
}

/// Features as large as they become, and targets near what some class says; labels are the targets' own.
fn view(size: [usize; 2], map: [usize; 2], head: &twin::Head, seed: u32) -> View {
    let mut rng = Pcg::new(seed + 100);
    let samples = map[0] * map[1];
    let image = (0..size[0] * size[1] * FEATURES).map(|_| narrow(2.0 * rng.normal())).collect();
    let mut targets = Vec::new();
    for _ in 0..samples {
        let class = rng.next_u32() as usize % head.classes();
        let text = &head.text[class * EMBEDDING..][..EMBEDDING];
        targets.extend(text.iter().map(|t| f16::from_f64(3.0 * t + 0.05 * rng.normal()).to_f64()));
    }
    let mut v = View { size, image, map, targets, labels: vec![] };
    v.labels = v.own_labels(head);
    v
}

struct Found {
    image: Vec<f32>,
    decoder: Vec<f32>,
    stats: LossStats,
    targets: Vec<SemanticTarget>,
    /// The decoder after as many steps as were asked for.
    learned: Vec<f32>,
}

/// `given`: whether labels go to the device, or it takes the targets' own.
fn run(gpu: &Gpu, h: &twin::Head, v: &View, given: bool, largest: [u32; 2], weights: &Weights) -> Found {
    run_steps(gpu, h, v, given, largest, weights, 0)
}

/// As [`run`], and the decoder takes so many steps.
fn run_steps(
    gpu: &Gpu,
    h: &twin::Head,
    v: &View,
    given: bool,
    largest: [u32; 2],
    weights: &Weights,
    steps: usize,
) -> Found {
    let (pixels, samples) = (v.size[0] * v.size[1], v.map[0] * v.map[1]);
    let room = (largest[0] * largest[1]) as usize + SPARE;
    let mut image = vec![f32::NAN; room * CHANNELS];
    for p in 0..pixels {
        let features = v.image[p * FEATURES..][..FEATURES].iter().map(|&x| x as f32);
        image[p * CHANNELS + FIRST..][..FEATURES].iter_mut().zip(features).for_each(|(a, b)| *a = b);
    }
    let before = std::iter::repeat_n(f16::NAN, OFFSET * EMBEDDING);
    let features: Vec<f16> = before.chain(v.targets.iter().map(|&t| f16::from_f64(t))).collect();
    let labels: Vec<u32> =
        vec![0; OFFSET].into_iter().chain(v.labels.iter().map(|l| l.map_or(NO_LABEL, |l| l as u32))).collect();

    let mut g = Graph::new("semantic");
    let all = (OFFSET + samples) as u64;
    let step = g.uniform("step", size_of::<Step>() as u64);
    let image_buffer = g.input("image", 4 * image.len() as u64);
    let feature_buffer = g.input("features", 2 * features.len() as u64);
    let label_buffer = g.input("labels", 4 * all);
    let embeddings = g.input("embeddings", 4 * h.text.len() as u64);
    let scalars = 4 * h.decoder.len() as u64;
    let decoder = if steps > 0 { g.external("decoder", scalars) } else { g.input("decoder", scalars) };
    let handles = DecoderHandles {
        parameters: decoder,
        moments: Some(g.external("moments", 2 * scalars)),
        work: g.input("work", size_of::<Work>() as u64),
    };
    let (flags, skipped) = (g.input("flags", 4), g.external("skipped", 4));
    // What samples touch, and some more.
    let touched = sampled_pixels(v.size.map(|n| n as u32), v.map.map(|n| n as u32));
    let wanted: Vec<bool> = touched.iter().enumerate().map(|(p, &t)| t || p % 5 == 2).collect();
    let mut wanted_words = pack_mask(&wanted);
    // Bits past the picture say nothing.
    let spare = wanted.len() % 32;
    if let Some(last) = wanted_words.last_mut().filter(|_| spare > 0) {
        *last |= u32::MAX << spare;
    }
    let wanted_buffer = g.input("wanted", 4 * wanted_words.len() as u64);
    let targets = g.external("targets", all * size_of::<SemanticTarget>() as u64);
    let grad_image = g.external("grad_image", 4 * image.len() as u64);
    let gradient = g.external("gradient", 4 * h.decoder.len() as u64);
    let stats = g.external("stats", size_of::<LossStats>() as u64);
    let classes = h.classes() as u32;
    let given = given.then_some(label_buffer);
    let tuning = gpu.tuning();
    semantic_targets(&mut g, tuning, feature_buffer, embeddings, classes, given, all as u32, targets).unwrap();
    let on_gpu = Head { decoder, embeddings, classes };
    let prepared = semantic_prepare(&mut g, tuning, &on_gpu).unwrap();
    let a = SemanticLoss {
        step,
        image: image_buffer,
        channels: CHANNELS as u32,
        first: FIRST as u32,
        largest,
        // As if another view's map were larger.
        targets: SemanticTargets { features: feature_buffer, targets, largest: samples as u32 + 70 },
        wanted: wanted_buffer,
    };
    let sums = semantic_loss(&mut g, tuning, &a, &on_gpu, &prepared, grad_image).unwrap();
    decoder_gradient(&mut g, tuning, &on_gpu, &prepared, Some(&sums), gradient).unwrap();
    semantic_sum(&mut g, tuning, step, Some(&sums), None, stats).unwrap();
    if steps > 0 {
        decoder_step(&mut g, tuning, step, &handles, gradient, flags, skipped).unwrap();
    }

    let [valid, labeled] = v.counts(h).map(|n| n as u32);
    let mut values = Step {
        weight_semantic: weights.cosine as f32,
        weight_semantic_class: weights.class as f32,
        inverse_temperature: (1.0 / weights.temperature) as f32,
        semantic_size: v.map.map(|n| n as u32),
        semantic_offset: OFFSET as u32,
        semantic_valid: valid,
        semantic_labeled: labeled,
        lr_decoder: 0.01,
        correction1: 1.0,
        correction2: 1.0,
        ..Default::default()
    };
    values.camera.size = v.size.map(|n| n as u32);
    let wide = |x: &[f64]| bytes(&x.iter().map(|&x| x as f32).collect::<Vec<f32>>());
    let inputs = [
        (step, bytes(&[values])),
        (image_buffer, bytes(&image)),
        (feature_buffer, bytes(&features)),
        (label_buffer, bytes(&labels)),
        (wanted_buffer, bytes(&wanted_words)),
        (embeddings, wide(&h.text)),
        (decoder, wide(&h.decoder)),
        (stats, bytes(&[LossStats::default()])),
        (handles.moments.unwrap(), vec![0; 2 * scalars as usize]),
        (handles.work, bytes(&[Work { x: 2, y: 1, z: 1, count: EMBEDDING as u32 }])),
        (flags, bytes(&[0_u32])),
        (skipped, bytes(&[0_u32])),
    ];
    let out = gpu.run_times(g, &inputs, steps.max(1));
    let targets = out.get::<SemanticTarget>(targets).split_off(OFFSET);
    assert_eq!(count_targets(&targets), [valid, labeled]);
    let mut image = Vec::new();
    for (p, pixel) in out.get::<f32>(grad_image).chunks(CHANNELS).enumerate() {
        for (c, x) in pixel.iter().enumerate() {
            let mine = p < pixels && wanted[p] && (FIRST..FIRST + FEATURES).contains(&c);
            assert!(mine || x.to_bits() == u32::MAX, "channel {c} of pixel {p} was written");
        }
        if p < pixels {
            // Nothing is asked of others: the reference says zero.
            image.extend(pixel[FIRST..FIRST + FEATURES].iter().map(|&x| if wanted[p] { x } else { 0.0 }));
        }
    }
    let (stats, learned) = (out.get::<LossStats>(stats)[0], out.get(decoder));
    Found { image, decoder: out.get(gradient), stats, targets, learned }
}

/// A share of the largest gradient, and a relative one.
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

fn check(gpu: &Gpu, what: &str, h: &twin::Head, v: &View, given: bool, largest: [u32; 2]) -> Found {
    let found = run(gpu, h, v, given, largest, &WEIGHTS);
    let (terms, gradient) = twin::semantic_loss(h, v, &WEIGHTS);
    compare(what, &terms, &gradient, &WEIGHTS, &found);
    found
}

#[test]
fn semantic_loss_at_odd_sizes() {
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

/// A map of more samples than all workgroups take in one round would need 32768; rounds are the same at any number of
/// workgroups, runs of the product over samples are not.
#[test]
fn semantic_loss_of_a_map_of_several_runs() {
    let gpu = Gpu::new();
    let h = head(3, 4);
    let v = view([20, 15], [67, 41], &h, 4);
    assert!(v.labels.len() > 2048);
    check(&gpu, "a large map", &h, &v, false, [20, 15]);
}

#[test]
fn what_says_nothing_is_left_out_and_counted() {
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
    // Given labels: some are none, one is out of range.
    v.labels.iter_mut().step_by(3).for_each(|l| *l = None);
    v.labels[7] = Some(6);
    v.labels[8] = Some(5);
    let found = check(&gpu, "given labels", &h, &v, true, [11, 9]);
    assert_eq!(found.targets[7].label, NO_LABEL);
    assert_eq!(found.targets[8].label, 5);
    // Features that are no number, which take the samples around them along.
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
    // A decoder that decodes to nothing has no direction, and no gradient.
    let mut nothing = h.clone();
    nothing.decoder.fill(0.0);
    let found = check(&gpu, "a decoder of zeros", &nothing, &base, false, [6, 5]);
    assert!(found.image.iter().chain(&found.decoder).all(|&g| g == 0.0));
    let mut no_bias = h.clone();
    no_bias.decoder.iter_mut().skip(FEATURES).step_by(AUGMENTED).for_each(|b| *b = 0.0);
    let found = check(&gpu, "zero features without bias", &no_bias, &scaled(0.0), false, [6, 5]);
    assert!(found.image.iter().chain(&found.decoder).all(|&g| g == 0.0));
    // Sharp and flat softmax.
    for temperature in [1e-3, 0.01, 100.0] {
        let weights = Weights { temperature, ..WEIGHTS };
        let (terms, gradient) = twin::semantic_loss(&h, &base, &weights);
        let found = run(&gpu, &h, &base, false, [6, 5], &weights);
        let close = |e: &[f64], f: &[f32], t: f64| {
            let largest = e.iter().fold(0.0_f64, |a, b| a.max(b.abs()));
            assert_close(&format!("temperature {temperature}"), e, f, Tolerance::new(t * largest, 1e-3));
        };
        assert_close("cross-entropy", &[terms.class], &[found.stats.semantic_class], Tolerance::new(1e-5, 1e-4));
        // A logit has an error of 1e-7 over the temperature, and so have the probabilities.
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
    let total = |h: &twin::Head, v: &View| {
        let t = twin::semantic_loss(h, v, &WEIGHTS).0;
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
            total(&twin::Head { decoder, ..h.clone() }, &v)
        };
        let fd = (along(1e-6) - along(-1e-6)) / 2e-6;
        let dot: f64 = found.decoder.iter().zip(&direction).map(|(&g, d)| f64::from(g) * d).sum();
        assert_close("decoder", &[fd], &[dot as f32], Tolerance::new(1e-6, 1e-4));
    }
}

#[test]
fn semantic_loss_is_the_same_every_time() {
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

/// The comparisons would notice a lost sample, a wrong label, a forgotten bias, or a weight off by a tenth of a percent.
#[test]
fn semantic_checks_can_fail() {
    let h = head(7, 5);
    let v = view([9, 8], [7, 6], &h, 5);
    let exact = twin::semantic_loss(&h, &v, &WEIGHTS).1;
    let differs = |other: &Gradient| {
        let narrow = |v: &[f64]| v.iter().map(|&x| x as f32).collect::<Vec<f32>>();
        let far = |e: &[f64], f: &[f64]| worst(e, &narrow(f), tolerance(e)).is_some_and(|w| w.3 > 1.0);
        [far(&exact.image, &other.image), far(&exact.decoder, &other.decoder)]
    };
    let of = |h: &twin::Head, v: &View, w: Weights| twin::semantic_loss(h, v, &w).1;
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

/// Gram matrices, loss, gradient and Adam together find a decoder that agrees with its targets.
#[test]
fn a_decoder_learns() {
    let gpu = Gpu::new();
    let h = head(4, 12);
    let v = view([4, 4], [4, 4], &h, 12);
    let weights = Weights { cosine: 1.0, class: 1.0, temperature: 1.0 };
    let before = twin::semantic_loss(&h, &v, &weights).0;
    let found = run_steps(&gpu, &h, &v, false, [4, 4], &weights, 60);
    let learned = twin::Head { decoder: found.learned.iter().map(|&x| f64::from(x)).collect(), ..h };
    let after = twin::semantic_loss(&learned, &v, &weights).0;
    assert!(before.cosine > 0.8 && after.cosine < 0.1 && after.class < before.class - 0.3, "{before:?} {after:?}");
}
