//! Correspondence loss of a region between views, on a device.

use crate::Gpu;
use sgs_engine::graph::Graph;
use sgs_passes::loss::{
    Head, ImagePart, correspondence_bwd, correspondence_train_bwd, decoder_gradient, pack_mask, region, regions,
    semantic_prepare, semantic_sum,
};
use sgs_passes::reference::correspondence::MaskedImage;
use sgs_passes::reference::semantic::Head as ReferenceHead;
use sgs_passes::scene::FEATURES;
use sgs_shaders::structs::{LossStats, Step};

const CHANNELS: usize = 40;
const FIRST: usize = 8;
const MASK_OFFSET: usize = 2;
/// Columns and rows of the largest view.
pub const LARGEST: [u32; 2] = [37, 29];
/// Weight of the loss.
pub const WEIGHT: f64 = 0.375;
/// Divisor of the logits.
pub const TEMPERATURE: f64 = 0.5;
/// Initial value of the training view's gradient.
const BEFORE: f32 = 0.25;

fn bytes<T: bytemuck::NoUninit>(data: &[T]) -> Vec<u8> {
    bytemuck::cast_slice(data).to_vec()
}

/// Results of the device.
pub struct Found {
    /// Gradient of the training view's features.
    pub train: Vec<f32>,
    /// Gradient of each pseudo-view's features.
    pub pseudo: Vec<Vec<f32>>,
    /// Gradient of the decoder.
    pub decoder: Vec<f32>,
    /// Loss statistics.
    pub stats: LossStats,
}

/// Runs the loss of a training view and pseudo-views.
pub fn run(gpu: &Gpu, h: &ReferenceHead, images: &[([usize; 2], MaskedImage)]) -> Found {
    run_with(gpu, h, images, [WEIGHT, TEMPERATURE], BEFORE)
}

/// Runs the loss with a weight, a temperature and an initial gradient.
///
/// `before` is the initial value of the training view's gradient.
pub fn run_with(
    gpu: &Gpu,
    h: &ReferenceHead,
    images: &[([usize; 2], MaskedImage)],
    [weight, temperature]: [f64; 2],
    before: f32,
) -> Found {
    let room = (LARGEST[0] * LARGEST[1]) as usize;
    let mut g = Graph::new("correspondence");
    let tuning = gpu.tuning();
    let decoder = g.input("decoder", 4 * h.decoder.len() as u64);
    let embeddings = g.input("embeddings", 4 * h.text.len() as u64);
    let on_gpu = Head { decoder, embeddings, classes: h.classes() as u32 };
    let prepared = semantic_prepare(&mut g, tuning, &on_gpu).unwrap();
    let wide = |x: &[f64]| bytes(&x.iter().map(|&x| x as f32).collect::<Vec<f32>>());
    let stats = g.external("stats", size_of::<LossStats>() as u64);
    let mut inputs = vec![
        (decoder, wide(&h.decoder)),
        (embeddings, wide(&h.text)),
        (stats, bytes(&[LossStats { total: 0.5, ..Default::default() }])),
    ];
    let shared = regions(&mut g, images.len() as u32 - 1);
    let mut declared = Vec::new();
    for (i, (size, p)) in images.iter().enumerate() {
        let mut image = vec![f32::NAN; room * CHANNELS];
        for pixel in 0..size[0] * size[1] {
            for k in 0..FEATURES {
                image[pixel * CHANNELS + FIRST + k] = p.image[pixel * FEATURES + k] as f32;
            }
        }
        let mask = [vec![u32::MAX; MASK_OFFSET], pack_mask(&p.mask)].concat();
        let floats = 4 * image.len() as u64;
        let on_gpu_image = ImagePart {
            step: g.uniform(format!("step{i}"), size_of::<Step>() as u64),
            image: g.input(format!("image{i}"), floats),
            channels: CHANNELS as u32,
            first: FIRST as u32,
            largest: LARGEST,
            mask: g.input(format!("mask{i}"), 4 * mask.len() as u64),
        };
        let gradient = g.external(format!("gradient{i}"), floats);
        let mut values = Step {
            weight_correspondence: weight as f32,
            inverse_temperature: (1.0 / temperature) as f32,
            mask_offset: MASK_OFFSET as u32,
            ..Default::default()
        };
        values.camera.size = size.map(|n| n as u32);
        inputs.push((on_gpu_image.step, bytes(&[values])));
        inputs.push((on_gpu_image.image, bytes(&image)));
        inputs.push((on_gpu_image.mask, bytes(&mask)));
        if i == 0 {
            inputs.push((gradient, bytes(&vec![before; room * CHANNELS])));
        }
        region(&mut g, &on_gpu_image, &on_gpu, &prepared, &shared, i as u32).unwrap();
        declared.push((on_gpu_image, gradient));
    }
    let (train, train_gradient) = declared[0];
    let left = correspondence_bwd(&mut g, tuning, &declared[1..], &on_gpu, &prepared, &shared).unwrap();
    correspondence_train_bwd(&mut g, tuning, &train, &shared, train_gradient).unwrap();
    let gradient = g.external("decoder_gradient", 4 * h.decoder.len() as u64);
    decoder_gradient(&mut g, tuning, &on_gpu, &prepared, None, gradient).unwrap();
    semantic_sum(&mut g, tuning, train.step, None, Some((&left, &shared)), stats).unwrap();
    let out = gpu.run(g, &inputs);
    let mut found: Vec<Vec<f32>> = Vec::new();
    for (i, ((size, rendered), (_, buffer))) in images.iter().zip(&declared).enumerate() {
        let mut features = Vec::new();
        for (p, pixel) in out.get::<f32>(*buffer).chunks(CHANNELS).enumerate() {
            let inside = p < size[0] * size[1];
            let mine = inside && rendered.mask[p];
            for (c, x) in pixel.iter().enumerate() {
                let untouched = if i == 0 { *x == before } else { x.to_bits() == u32::MAX };
                let feature = (FIRST..FIRST + FEATURES).contains(&c);
                assert!(mine && feature || untouched, "channel {c} of pixel {p} of image {i} was written");
            }
            if inside {
                // The kernel skips pixels outside the region; the reference has zero there.
                let gradient = |&x: &f32| {
                    if !mine {
                        0.0
                    } else if i == 0 {
                        x - before
                    } else {
                        x
                    }
                };
                features.extend(pixel[FIRST..FIRST + FEATURES].iter().map(gradient));
            }
        }
        found.push(features);
    }
    let train = found.remove(0);
    Found { train, pseudo: found, decoder: out.get(gradient), stats: out.get::<LossStats>(stats)[0] }
}
