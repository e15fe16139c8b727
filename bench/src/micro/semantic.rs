//! Benchmark of the semantic loss of a view and the correspondence of a region.
//!
//! Losses, and gradients by features and decoder, are checked against the references.

use super::Context;
use crate::harness::{Rig, add_passes, bytes};
use crate::report::Report;
use half::f16;
use sgs_engine::graph::Graph;
use sgs_passes::cost::Counts;
use sgs_passes::loss::{
    Head, ImagePart, SemanticLoss, SemanticTargets, correspondence_bwd, correspondence_train_bwd, decoder_gradient,
    normalize_embeddings, pack_mask, region, regions, sampled_pixels, semantic_loss, semantic_prepare, semantic_sum,
    semantic_targets,
};
use sgs_passes::reference::correspondence as region_reference;
use sgs_passes::reference::rng::Pcg;
use sgs_passes::reference::semantic as reference;
use sgs_passes::scene::{Decoder, EMBEDDING, FEATURES};
use sgs_shaders::structs::{LossStats, SemanticTarget, Step};

/// Number of classes, typical of a furnished room.
const CLASSES: usize = 27;
/// Channels: color and features.
const CHANNELS: usize = 3 + FEATURES;
const FIRST: usize = 3;
/// Maximum size of the prior. The reference computes every channel and would take minutes for larger maps.
const LARGEST_MAP: [u32; 2] = [240, 180];
/// Maximum size of the images of a region, for the same reason.
const LARGEST_IMAGE: [u32; 2] = [640, 480];

fn head() -> reference::Head {
    let mut rng = Pcg::new(3);
    let text: Vec<f32> = (0..CLASSES * EMBEDDING).map(|_| rng.normal() as f32).collect();
    let wide = |v: Vec<f32>| v.into_iter().map(f64::from).collect();
    reference::Head {
        features: FEATURES,
        embedding: EMBEDDING,
        decoder: wide(Decoder::initial(3)),
        text: wide(normalize_embeddings(&text)),
    }
}

fn narrow(v: &[f64]) -> Vec<f32> {
    v.iter().map(|&x| x as f32).collect()
}

/// Returns features interleaved with the other channels of an image.
fn interleaved(features: &[f64]) -> Vec<f32> {
    let pixel = |f: &[f64]| [vec![0.0; FIRST], narrow(f)].concat();
    features.chunks(FEATURES).flat_map(pixel).collect()
}

fn features_of(image: &[f32]) -> Vec<f32> {
    image.chunks(CHANNELS).flat_map(|p| &p[FIRST..]).copied().collect()
}

/// Fails if an element exceeds its tolerance.
///
/// The tolerance is 2e-5 of the largest element plus 1e-4 of the element itself.
fn close(what: &str, expected: &[f64], found: &[f32]) -> anyhow::Result<()> {
    let largest = expected.iter().fold(0.0_f64, |a, e| a.max(e.abs()));
    for (i, (e, f)) in expected.iter().zip(found).enumerate() {
        let right = (e - f64::from(*f)).abs() <= 2e-5 * largest + 1e-4 * e.abs();
        anyhow::ensure!(right, "Element {i} of the gradient by {what} is {f}, but should be {e}.");
    }
    Ok(())
}

fn values(size: [u32; 2]) -> Step {
    let mut s = Step {
        weight_semantic: 1.0,
        weight_semantic_class: 1.0,
        weight_correspondence: 1.0,
        inverse_temperature: 1.0,
        ..Default::default()
    };
    s.camera.size = size;
    s
}

/// Measures the loss of a training view.
pub fn loss(c: &Context<'_>, report: &mut Report) -> anyhow::Result<()> {
    let size = c.workload.largest;
    // An eighth of the image, as network outputs are.
    let map = [0, 1].map(|k| (size[k] / 8).clamp(1, LARGEST_MAP[k]));
    let touched = sampled_pixels(size, map);
    let [pixels, samples] = [size, map].map(|[w, h]| (w * h) as usize);
    let h = head();
    let mut rng = Pcg::new(9);
    let image: Vec<f64> = (0..pixels * FEATURES).map(|_| f64::from((2.0 * rng.normal()) as f32)).collect();
    let mut halves = Vec::with_capacity(samples * EMBEDDING);
    for _ in 0..samples {
        let text = &h.text[rng.next_u32() as usize % CLASSES * EMBEDDING..][..EMBEDDING];
        halves.extend(text.iter().map(|t| f16::from_f64(3.0 * t + 0.05 * rng.normal())));
    }
    let sides = |s: [u32; 2]| s.map(|n| n as usize);
    let targets: Vec<f64> = halves.iter().map(|t| t.to_f64()).collect();
    let mut view = reference::View { size: sides(size), image, map: sides(map), targets, labels: vec![] };
    view.labels = view.own_labels(&h);

    let mut g = Graph::new("semantic");
    let floats = 4 * (pixels * CHANNELS) as u64;
    let step = g.uniform("step", size_of::<Step>() as u64);
    let image = g.input("image", floats);
    let features = g.input("features", 2 * halves.len() as u64);
    let embeddings = g.input("embeddings", 4 * h.text.len() as u64);
    let decoder = g.input("decoder", 4 * h.decoder.len() as u64);
    let wanted = g.input("wanted", 4 * pack_mask(&touched).len() as u64);
    let targets = g.external("targets", (samples * size_of::<SemanticTarget>()) as u64);
    let grad_image = g.external("grad_image", floats);
    let gradient = g.external("gradient", 4 * h.decoder.len() as u64);
    let stats = g.external("stats", size_of::<LossStats>() as u64);
    let classes = CLASSES as u32;
    semantic_targets(&mut g, c.tuning, features, embeddings, classes, None, samples as u32, targets)?;
    let on_gpu = Head { decoder, embeddings, classes };
    let prepared = semantic_prepare(&mut g, c.tuning, &on_gpu)?;
    let a = SemanticLoss {
        step,
        image,
        channels: CHANNELS as u32,
        first: FIRST as u32,
        largest: size,
        targets: SemanticTargets { features, targets, largest: samples as u32 },
        wanted,
    };
    let sums = semantic_loss(&mut g, c.tuning, &a, &on_gpu, &prepared, grad_image)?;
    decoder_gradient(&mut g, c.tuning, &on_gpu, &prepared, Some(&sums), gradient)?;
    g.fill("out.clear", stats, 0)?;
    semantic_sum(&mut g, c.tuning, step, Some(&sums), None, stats)?;
    let counted = samples as u32;
    let values = Step { semantic_size: map, semantic_valid: counted, semantic_labeled: counted, ..values(size) };
    let inputs = vec![
        (step, bytes(&[values])),
        (image, bytes(&interleaved(&view.image))),
        (features, bytes(&halves)),
        (wanted, bytes(&pack_mask(&touched))),
        (embeddings, bytes(&narrow(&h.text))),
        (decoder, bytes(&narrow(&h.decoder))),
    ];
    let mut rig = Rig::new(c.device, g, inputs, true)?;
    let (times, _) = rig.measure(c.warmup, c.repeats)?;
    let counts = Counts { pixels: pixels as f64, samples: samples as f64, ..Default::default() };
    add_passes(report, rig.plan(), &times, &counts, &c.ceiling);

    let (terms, expected) =
        reference::semantic_loss(&h, &view, &reference::Weights { cosine: 1.0, class: 1.0, temperature: 1.0 });
    let found: LossStats = rig.get(stats)?[0];
    for (name, e, f) in [("cosine", terms.cosine, found.semantic), ("cross-entropy", terms.class, found.semantic_class)]
    {
        anyhow::ensure!((e - f64::from(f)).abs() < 1e-5 * e.abs(), "The {name} is {f}, but should be {e}.");
    }
    close("features", &expected.image, &features_of(&rig.get(grad_image)?))?;
    close("the decoder", &expected.decoder, &rig.get(gradient)?)?;
    report.check(format!("semantic: losses and gradients of {samples} samples are those of the reference"));
    Ok(())
}

/// Measures the correspondence of a region in a training view and a pseudo-view.
pub fn correspondence(c: &Context<'_>, report: &mut Report) -> anyhow::Result<()> {
    let size = [0, 1].map(|k| c.workload.largest[k].min(LARGEST_IMAGE[k]));
    let pixels = (size[0] * size[1]) as usize;
    let h = head();
    let random_image = |seed: u32| {
        let mut rng = Pcg::new(seed);
        let image = (0..pixels * FEATURES).map(|_| f64::from((1.0 + rng.normal()) as f32)).collect();
        // The middle 0.4 of the columns and of the rows.
        let within = |p: usize| {
            let (x, y) = (p as u32 % size[0], p as u32 / size[0]);
            10 * x >= 3 * size[0] && 10 * x < 7 * size[0] && 10 * y >= 3 * size[1] && 10 * y < 7 * size[1]
        };
        region_reference::MaskedImage { image, mask: (0..pixels).map(within).collect() }
    };
    let images = [random_image(1), random_image(2)];
    let mut g = Graph::new("correspondence");
    let floats = 4 * (pixels * CHANNELS) as u64;
    let step = g.uniform("step", size_of::<Step>() as u64);
    let embeddings = g.input("embeddings", 4 * h.text.len() as u64);
    let decoder = g.input("decoder", 4 * h.decoder.len() as u64);
    let gradient = g.external("gradient", 4 * h.decoder.len() as u64);
    let on_gpu = Head { decoder, embeddings, classes: CLASSES as u32 };
    let prepared = semantic_prepare(&mut g, c.tuning, &on_gpu)?;
    let shared = regions(&mut g, 1);
    let mut inputs = vec![
        (step, bytes(&[values(size)])),
        (embeddings, bytes(&narrow(&h.text))),
        (decoder, bytes(&narrow(&h.decoder))),
    ];
    let mut declared = Vec::new();
    for (i, p) in images.iter().enumerate() {
        let mask = pack_mask(&p.mask);
        let device_image = ImagePart {
            step,
            image: g.input(format!("image{i}"), floats),
            channels: CHANNELS as u32,
            first: FIRST as u32,
            largest: size,
            mask: g.input(format!("mask{i}"), 4 * mask.len() as u64),
        };
        inputs.push((device_image.image, bytes(&interleaved(&p.image))));
        inputs.push((device_image.mask, bytes(&mask)));
        region(&mut g, &device_image, &on_gpu, &prepared, &shared, i as u32)?;
        declared.push((device_image, g.external(format!("grad_image{i}"), floats)));
    }
    correspondence_bwd(&mut g, c.tuning, &declared[1..], &on_gpu, &prepared, &shared)?;
    g.fill("out.clear", declared[0].1, 0)?;
    correspondence_train_bwd(&mut g, c.tuning, &declared[0].0, &shared, declared[0].1)?;
    decoder_gradient(&mut g, c.tuning, &on_gpu, &prepared, None, gradient)?;
    let mut rig = Rig::new(c.device, g, inputs, true)?;
    let (times, _) = rig.measure(c.warmup, c.repeats)?;
    let masked = images[0].mask.iter().filter(|&&m| m).count();
    let counts = Counts { pixels: pixels as f64, masked: masked as f64, ..Default::default() };
    add_passes(report, rig.plan(), &times, &counts, &c.ceiling);

    let (_, expected) = region_reference::correspondence(&h, &images[0], &images[1..], 1.0, 1.0);
    close("the training view", &expected.train, &features_of(&rig.get(declared[0].1)?))?;
    close("the pseudo-view", &expected.pseudo[0], &features_of(&rig.get(declared[1].1)?))?;
    close("the decoder", &expected.decoder, &rig.get(gradient)?)?;
    report.check(format!("correspondence: gradients of {masked} pixels of {pixels} are those of the reference"));
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn injected_errors_are_detected() {
        assert!(close("x", &[1.0, 0.1], &[1.0, 0.1]).is_ok());
        assert!(close("x", &[1.0, 0.1], &[1.0, 0.101]).is_err());
        assert!(close("x", &[1.0, 0.1], &[f32::NAN, 0.1]).is_err());
    }
}
