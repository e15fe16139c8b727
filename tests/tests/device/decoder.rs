//! Decoder update, label maps, and semantic priors of a scene on a device.

use half::f16;
use sgs_engine::graph::Graph;
use sgs_passes::loss::{Head, NO_LABEL, Relevance, SemanticLabels, semantic_labels, semantic_prepare};
use sgs_passes::optim::decoder_step;
use sgs_passes::reference::adam as reference_adam;
use sgs_passes::reference::rng::Pcg;
use sgs_passes::reference::semantic as reference;
use sgs_passes::scene::{AUGMENTED, Decoder, DecoderHandles, EMBEDDING, FEATURES};
use sgs_shaders::structs::{SemanticTarget, Step, Work};
use sgs_tests::semantics::head;
use sgs_tests::{Gpu, Tolerance, assert_close, worst};

/// Number of pixels past the end of the view.
const SPARE: usize = 7;
const CHANNELS: usize = 38;
const FIRST: usize = 4;

fn bytes<T: bytemuck::NoUninit>(data: &[T]) -> Vec<u8> {
    bytemuck::cast_slice(data).to_vec()
}

#[test]
fn the_decoder_follows_adam_and_a_flag_stops_it() {
    let gpu = Gpu::new();
    let n = EMBEDDING * AUGMENTED;
    let mut rng = Pcg::new(1);
    let start = Decoder::initial(8);
    // Gradients are small enough for Adam's epsilon to matter.
    let slope: Vec<f32> = (0..n).map(|_| (1e-7 * rng.normal()) as f32).collect();
    for flag in [0_u32, 4] {
        let mut g = Graph::new("decoder");
        let step = g.uniform("step", size_of::<Step>() as u64);
        let decoder = DecoderHandles {
            parameters: g.external("decoder", 4 * n as u64),
            moments: Some(g.external("moments", 8 * n as u64)),
            work: g.input("work", size_of::<Work>() as u64),
        };
        let (gradients, flags) = (g.input("gradients", 4 * n as u64), g.input("flags", 4));
        let skipped = g.external("skipped", 4);
        decoder_step(&mut g, gpu.tuning(), step, &decoder, gradients, flags, skipped).unwrap();
        let rates = reference_adam::Rates::at(1e-4, 1);
        let values = Step {
            lr_decoder: rates.lr as f32,
            correction1: rates.correction1 as f32,
            correction2: rates.correction2 as f32,
            lr_means: f32::NAN,
            ..Default::default()
        };
        let inputs = [
            (step, bytes(&[values])),
            (decoder.parameters, bytes(&start)),
            (decoder.moments.unwrap(), vec![0; 8 * n]),
            (decoder.work, bytes(&[Work { x: 2, y: 1, z: 1, count: EMBEDDING as u32 }])),
            (gradients, bytes(&slope)),
            (flags, bytes(&[flag])),
            (skipped, bytes(&[0_u32])),
        ];
        let out = gpu.run(g, &inputs);
        let found = out.get::<f32>(decoder.parameters);
        if flag != 0 {
            assert!(bytes(&found) == bytes(&start));
            assert!(out.get::<u32>(decoder.moments.unwrap()).iter().all(|&x| x == 0));
            continue;
        }
        let moved = |epsilon: f64| -> Vec<f64> {
            let one = |(&p, &g): (&f32, &f32)| {
                let p = f64::from(p);
                reference_adam::adam_with(p, [0.0; 2], f64::from(g), rates, epsilon).0
            };
            start.iter().zip(&slope).map(one).collect()
        };
        let t = Tolerance::new(1e-8, 2e-7);
        assert_close("decoder", &moved(1e-8), &found, t);
        assert!(worst(&moved(1e-15), &found, t).is_some_and(|w| w.3 > 1.0), "epsilon is not seen");
    }
}

#[test]
fn decoder_round_trips_through_checkpoint() {
    let gpu = Gpu::new();
    let device = gpu.device();
    let a = Decoder::new(device, 3, true).unwrap();
    assert_eq!(a.download(device).unwrap(), Decoder::initial(3));
    let moments: Vec<f32> = (0..2 * EMBEDDING * AUGMENTED).map(|i| i as f32).collect();
    let b = Decoder::new(device, 4, true).unwrap();
    b.upload(device, &a.download(device).unwrap()).unwrap();
    assert!(b.download_moments(device).unwrap().iter().all(|&m| m == 0.0));
    b.upload_moments(device, &moments).unwrap();
    assert_eq!(b.download_moments(device).unwrap(), moments);
    assert_eq!(b.download(device).unwrap(), Decoder::initial(3));
    assert!(Decoder::new(device, 3, false).unwrap().download_moments(device).unwrap().is_empty());
}

#[test]
fn label_maps_match_reference() {
    let gpu = Gpu::new();
    for (classes, query, meaning) in
        [(1, 0, Relevance::Cosine), (9, 4, Relevance::Probability), (200, 199, Relevance::Cosine)]
    {
        let h = head(classes, 21);
        let pixels = 13 * 9;
        let mut rng = Pcg::new(121);
        let features: Vec<f64> = (0..pixels * FEATURES).map(|_| 2.0 * rng.normal()).collect();
        let mut image = vec![f32::NAN; (pixels + SPARE) * CHANNELS];
        for p in 0..pixels {
            for k in 0..FEATURES {
                let scale = if p == 3 { 1e25 } else { f64::from(u8::from(p != 4)) };
                image[p * CHANNELS + FIRST + k] = (scale * features[p * FEATURES + k]) as f32;
            }
        }
        image[7 * CHANNELS + FIRST + 30] = f32::INFINITY;
        let mut g = Graph::new("labels");
        let step = g.uniform("step", size_of::<Step>() as u64);
        let image_buffer = g.input("image", 4 * image.len() as u64);
        let decoder = g.input("decoder", 4 * h.decoder.len() as u64);
        let embeddings = g.input("embeddings", 4 * h.text.len() as u64);
        let labels = g.external("labels", 4 * (pixels + SPARE) as u64);
        let relevance = g.external("relevance", 4 * (pixels + SPARE) as u64);
        let on_gpu = Head { decoder, embeddings, classes: classes as u32 };
        let prepared = semantic_prepare(&mut g, gpu.tuning(), &on_gpu).unwrap();
        let a = SemanticLabels {
            step,
            image: image_buffer,
            channels: CHANNELS as u32,
            first: FIRST as u32,
            largest: [20, 11],
            classes: classes as u32,
            query,
            meaning,
        };
        semantic_labels(&mut g, &a, &prepared, labels, relevance).unwrap();
        let mut values = Step { inverse_temperature: 4.0, ..Default::default() };
        values.camera.size = [13, 9];
        let wide = |x: &[f64]| bytes(&x.iter().map(|&x| x as f32).collect::<Vec<f32>>());
        let inputs = [
            (step, bytes(&[values])),
            (image_buffer, bytes(&image)),
            (decoder, wide(&h.decoder)),
            (embeddings, wide(&h.text)),
        ];
        let out = gpu.run(g, &inputs);
        let (labels, relevance) = (out.get::<u32>(labels), out.get::<f32>(relevance));
        for p in 0..pixels {
            if p == 7 {
                assert_eq!((labels[p], relevance[p]), (NO_LABEL, 0.0));
                continue;
            }
            let f: Vec<f64> = image[p * CHANNELS + FIRST..][..FEATURES].iter().map(|&x| f64::from(x)).collect();
            let (label, logits) = reference::classify(&h, &f, 0.25);
            assert_eq!(labels[p] as usize, label, "pixel {p}");
            let q = query as usize;
            let expected = match meaning {
                Relevance::Cosine => 0.25 * logits[q],
                Relevance::Probability => 1.0 / logits.iter().map(|l| (l - logits[q]).exp()).sum::<f64>(),
            };
            assert_close("relevance", &[expected], &[relevance[p]], Tolerance::new(2e-6, 1e-5));
        }
        assert!(labels[pixels..].iter().all(|&l| l == u32::MAX));
        assert!(relevance[pixels..].iter().all(|r| r.to_bits() == u32::MAX));
    }
}

/// Uploads semantic targets of a scene on disk.
///
/// Maps have different sizes, one view has none, and some cells are unlabeled or masked. Images of four sizes are labeled.
#[test]
fn semantic_priors_of_a_scene_reach_the_device() {
    use sgs_engine::Location;
    use sgs_passes::pipeline::{FeatureImage, Labeler, Query};
    use sgs_scene::{Image, Scene, SceneOptions, write_png};
    use sgs_tests::{Place, rooms::Room};
    use sgs_train::{SemanticData, SemanticView};
    let gpu = Gpu::new();
    let device = gpu.device();
    let place = Place::new(Room { views: 4, size: [8, 6], ..Default::default() });
    let h = head(3, 31);
    let npy = |descr: &str, shape: &str, data: &[u8]| {
        let mut header = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}");
        header.push_str(&" ".repeat(63 - (header.len() + 10) % 64));
        header.push('\n');
        [b"\x93NUMPY\x01\x00", &(header.len() as u16).to_le_bytes()[..], header.as_bytes(), data].concat()
    };
    let folder = place.path("scene/priors/semantic");
    std::fs::create_dir_all(&folder).unwrap();
    let write = |name: &str, content: Vec<u8>| std::fs::write(folder.join(name), content).unwrap();
    let twice: Vec<f32> = h.text.iter().map(|&t| (2.0 * t) as f32).collect();
    write("text_embeddings.npy", npy("<f4", "(3, 512)", bytemuck::cast_slice(&twice)));
    write("labels.json", br#"{"labels": ["background", "wall", "floor"]}"#.to_vec());
    let class = |c: usize| h.text[c * EMBEDDING..][..EMBEDDING].iter().map(|&t| f16::from_f64(t)).collect::<Vec<f16>>();
    // View 1 is a test view. View 2 has no map.
    let first =
        [class(2), class(0), vec![f16::ZERO; EMBEDDING], class(1), class(1), vec![f16::NAN; EMBEDDING]].concat();
    write("000.npy", npy("<f2", "(2, 3, 512)", bytemuck::cast_slice(&first)));
    write("003.npy", npy("<f2", "(1, 1, 512)", bytemuck::cast_slice(&class(1))));
    let open = || Scene::open(&place.path("scene"), &SceneOptions::default()).unwrap();
    let data = SemanticData::load(device, &open()).unwrap().unwrap();
    let view = |size, offset, valid| SemanticView { size, offset, valid, labeled: valid };
    assert_eq!(data.views, [view([3, 2], 0, 4), view([0, 0], 6, 0), view([1, 1], 6, 1)]);
    assert_eq!((data.largest, data.text.labels.len()), (6, 3));
    let targets: Vec<SemanticTarget> = device.download_as(&data.targets, 7).unwrap();
    let labels: Vec<u32> = targets.iter().map(|t| t.label).collect();
    assert_eq!(labels, [2, 0, NO_LABEL, 1, 1, NO_LABEL, 1]);
    // Cell 1 lies between the pixels 3 and 4 of the first row, the only cell of view 3 at its first pixel.
    std::fs::create_dir_all(place.path("scene/masks")).unwrap();
    for (name, invalid) in [("000", 4), ("003", 0)] {
        let mut mask = Image::new(8, 6, 1);
        mask.data.fill(1.0);
        mask.data[invalid] = 0.0;
        write_png(&place.path(&format!("scene/masks/{name}.png")), &mask).unwrap();
    }
    let masked = SemanticData::load(device, &open()).unwrap().unwrap();
    assert_eq!(masked.views, [view([3, 2], 0, 3), view([0, 0], 6, 0), view([1, 1], 6, 0)]);
    let targets: Vec<SemanticTarget> = device.download_as(&masked.targets, 7).unwrap();
    let labels: Vec<u32> = targets.iter().map(|t| t.label).collect();
    assert_eq!(labels, [2, NO_LABEL, NO_LABEL, 1, 1, NO_LABEL, NO_LABEL]);
    std::fs::remove_dir_all(place.path("scene/masks")).unwrap();
    let unit: Vec<f32> = device.download_as(&data.embeddings, 3 * EMBEDDING).unwrap();
    assert_close("texts", &h.text, &unit, Tolerance::new(1e-8, 2e-7));

    let decoder = Decoder::new(device, 31, false).unwrap();
    let queries = [
        Query { class: 1, meaning: Relevance::Probability },
        Query { class: 2, meaning: Relevance::Cosine },
        Query { class: 0, meaning: Relevance::Probability },
    ];
    for queries in [&queries[..], &[]] {
        let mut labeler = Labeler::new(device, gpu.tuning(), &unit, 0.25, queries).unwrap();
        for (size, spare) in [([5, 3], 0), ([4, 2], 7), ([10, 6], 0), ([1, 1], 59)] {
            let pixels = (size[0] * size[1]) as usize;
            let mut rng = Pcg::new(size[0]);
            let mut image: Vec<f32> = (0..pixels * CHANNELS).map(|_| rng.normal() as f32).collect();
            if pixels > 1 {
                image[CHANNELS + FIRST + 5] = f32::NAN;
            }
            let buffer = device.buffer("image", ((pixels + spare) * CHANNELS * 4) as u64, Location::Device).unwrap();
            device.upload(&buffer, 0, bytemuck::cast_slice(&image)).unwrap();
            let features = FeatureImage { buffer: &buffer, size, channels: CHANNELS as u32, first: FIRST as u32 };
            let map = labeler.label(&decoder, &features).unwrap();
            assert_eq!((map.labels.len(), map.relevance.len()), (pixels, queries.len()));
            for (p, pixel) in image.chunks(CHANNELS).enumerate() {
                let relevance = map.relevance.iter().map(|r| r[p]).collect::<Vec<f32>>();
                if p == 1 {
                    assert!(map.labels[p] == NO_LABEL && relevance.iter().all(|r| *r == 0.0));
                    continue;
                }
                let f: Vec<f64> = pixel[FIRST..FIRST + FEATURES].iter().map(|&x| f64::from(x)).collect();
                let (label, logits) = reference::classify(&h, &f, 0.25);
                assert_eq!(map.labels[p] as usize, label);
                let probability = |q: usize| 1.0 / logits.iter().map(|l| (l - logits[q]).exp()).sum::<f64>();
                let expected = [probability(1), 0.25 * logits[2], probability(0)];
                assert_close("relevance", &expected[..queries.len()], &relevance, Tolerance::new(2e-6, 1e-5));
            }
        }
    }

    write("text_embeddings.npy", npy("<f4", "(3, 2)", &[0; 24]));
    std::fs::remove_file(folder.join("000.npy")).unwrap();
    std::fs::remove_file(folder.join("003.npy")).unwrap();
    let error = SemanticData::load(device, &open()).err().unwrap().to_string();
    assert!(error.starts_with("The text embeddings are 2 wide, but the decoder makes 512"), "{error}");
    std::fs::remove_file(folder.join("text_embeddings.npy")).unwrap();
    assert!(SemanticData::load(device, &open()).unwrap().is_none());
}

/// Features are required at sampled pixels with weight and at region pixels.
#[test]
fn feature_mask_covers_samples_and_regions() {
    use sgs_passes::loss::{pack_mask, wanted_samples};
    use sgs_passes::splat::{Screen, wanted_words};
    let gpu = Gpu::new();
    // Weight of pixel `at` in sample `i` of `n` along an axis of `pixels`. First and last samples align with the ends.
    let weight = |i: usize, n: usize, at: usize, pixels: usize| {
        let place = if n > 1 { i as f64 * (pixels - 1) as f64 / (n - 1) as f64 } else { 0.0 };
        (1.0 - (place - at as f64).abs()).max(0.0)
    };
    for (size, map, region) in [
        ([20, 15], [5, 4], false),
        ([20, 15], [5, 4], true),
        ([33, 7], [33, 7], false),
        ([9, 11], [30, 2], false),
        ([64, 3], [1, 1], false),
        ([1, 40], [3, 5], false),
        ([13, 5], [0, 0], true),
        ([13, 5], [0, 0], false),
    ] {
        let largest = [size[0] as u32 + 3, size[1] as u32];
        let mut g = Graph::new("wanted");
        let step = g.uniform("step", size_of::<Step>() as u64);
        let screen = Screen { step, largest, tile: gpu.tuning().tile };
        let words = wanted_words(screen.pixels()) as usize;
        let (mask, wanted) = (g.input("mask", 4 * (words as u64 + 2)), g.external("wanted", 4 * words as u64));
        wanted_samples(&mut g, gpu.tuning(), &screen, region.then_some(mask), mask, wanted).unwrap();
        let mut values = Step { mask_offset: 2, semantic_size: map.map(|n| n as u32), ..Step::default() };
        values.camera.size = size.map(|n| n as u32);
        let pixels: usize = size[0] * size[1];
        let mut rng = Pcg::new(pixels as u32);
        let inside: Vec<bool> = (0..pixels).map(|_| rng.next_u32().is_multiple_of(5)).collect();
        let bits: Vec<u32> = [vec![u32::MAX; 2], pack_mask(&inside), vec![0; words]].concat()[..words + 2].to_vec();
        let out = gpu.run(g, &[(step, bytes(&[values])), (mask, bytes(&bits))]);
        let found = out.get::<u32>(wanted);
        for p in 0..pixels.next_multiple_of(32) {
            let (x, y) = (p % size[0], p / size[0]);
            let sampled = (0..map[1]).any(|j| weight(j, map[1], y, size[1]) > 1e-9)
                && (0..map[0]).any(|i| weight(i, map[0], x, size[0]) > 1e-9);
            let expected = p < pixels && (sampled || (region && inside[p]));
            let is = found[p / 32] >> (p % 32) & 1 == 1;
            assert_eq!(is, expected, "pixel {x}, {y} of {size:?}, map {map:?}, region {region}");
        }
    }
}
