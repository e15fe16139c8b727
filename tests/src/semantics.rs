//! Semantic loss on a device.

use crate::Gpu;
use crate::surfaces::narrow;
use half::f16;
use sgs_engine::graph::Graph;
use sgs_passes::loss::{
    Head, NO_LABEL, SemanticLoss, SemanticTargets, count_targets, decoder_gradient, normalize_embeddings, pack_mask,
    sampled_pixels, semantic_loss, semantic_prepare, semantic_sum, semantic_targets,
};
use sgs_passes::optim::decoder_step;
use sgs_passes::reference::rng::Pcg;
use sgs_passes::reference::semantic as reference;
use sgs_passes::reference::semantic::{View, Weights};
use sgs_passes::scene::{Decoder, DecoderHandles, EMBEDDING, FEATURES};
use sgs_shaders::structs::{LossStats, SemanticTarget, Step, Work};

/// Number of samples of other views before the view's samples.
const OFFSET: usize = 3;
/// Number of pixels in the buffers after the view's pixels.
const SPARE: usize = 7;
const CHANNELS: usize = 38;
const FIRST: usize = 4;
/// Weights that are exact in 32-bit floats.
pub const WEIGHTS: Weights = Weights { cosine: 0.75, class: 1.25, temperature: 0.5 };

fn bytes<T: bytemuck::NoUninit>(data: &[T]) -> Vec<u8> {
    bytemuck::cast_slice(data).to_vec()
}

/// Creates a decoder with initial weights, and random text embeddings.
pub fn head(classes: usize, seed: u32) -> reference::Head {
    let mut rng = Pcg::new(seed);
    let text: Vec<f32> = (0..classes * EMBEDDING).map(|_| rng.normal() as f32).collect();
    reference::Head {
        features: FEATURES,
        embedding: EMBEDDING,
        decoder: Decoder::initial(seed).into_iter().map(f64::from).collect(),
        text: normalize_embeddings(&text).into_iter().map(f64::from).collect(),
    }
}

/// Creates a view with random features and targets near class embeddings.
///
/// The features are as large as trained features. The labels are computed from the targets.
pub fn view(size: [usize; 2], map: [usize; 2], head: &reference::Head, seed: u32) -> View {
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

/// Results of the device.
pub struct Found {
    /// Gradient of the features of every pixel.
    pub image: Vec<f32>,
    /// Gradient of the decoder.
    pub decoder: Vec<f32>,
    /// Loss statistics.
    pub stats: LossStats,
    /// Target of each sample, computed by the device.
    pub targets: Vec<SemanticTarget>,
    /// Parameters of the decoder after the requested steps.
    pub learned: Vec<f32>,
}

/// Runs the loss of a view.
///
/// `has_labels`: whether the device receives the labels; otherwise the device computes them from the targets.
pub fn run(gpu: &Gpu, h: &reference::Head, v: &View, has_labels: bool, largest: [u32; 2], weights: &Weights) -> Found {
    run_steps(gpu, h, v, has_labels, largest, weights, 0)
}

/// Runs the loss as [`run`] does, and updates the decoder for `steps` steps.
pub fn run_steps(
    gpu: &Gpu,
    h: &reference::Head,
    v: &View,
    has_labels: bool,
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
    // All pixels that samples read, and some more.
    let touched = sampled_pixels(v.size.map(|n| n as u32), v.map.map(|n| n as u32));
    let wanted: Vec<bool> = touched.iter().enumerate().map(|(p, &t)| t || p % 5 == 2).collect();
    let mut wanted_words = pack_mask(&wanted);
    // Bits after the last pixel of the image must have no effect.
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
    let label_input = has_labels.then_some(label_buffer);
    let tuning = gpu.tuning();
    semantic_targets(&mut g, tuning, feature_buffer, embeddings, classes, label_input, all as u32, targets).unwrap();
    let on_gpu = Head { decoder, embeddings, classes };
    let prepared = semantic_prepare(&mut g, tuning, &on_gpu).unwrap();
    let a = SemanticLoss {
        step,
        image: image_buffer,
        channels: CHANNELS as u32,
        first: FIRST as u32,
        largest,
        // The maximum exceeds the view's samples, as if another view had a larger map.
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
            // The kernel skips pixels that are not requested; the reference has zero there.
            image.extend(pixel[FIRST..FIRST + FEATURES].iter().map(|&x| if wanted[p] { x } else { 0.0 }));
        }
    }
    let (stats, learned) = (out.get::<LossStats>(stats)[0], out.get(decoder));
    Found { image, decoder: out.get(gradient), stats, targets, learned }
}
