//! `present` against its reference: every layer, format and encoding. Values include some that a format cannot
//! represent.

use half::f16;
use sgs_engine::graph::Graph;
use sgs_passes::pipeline::{Camera, Step};
use sgs_passes::reference::present as reference;
use sgs_passes::splat::{Blended, Channels, Encoding, Layer, Present, Presented, Screen, TexelFormat, present};
use sgs_tests::Gpu;
use sgs_tests::scenes::Rng;

const SIZE: [u32; 2] = [37, 19];

struct View {
    channels: Channels,
    image: Vec<f32>,
    transmittance: Vec<f32>,
}

/// Creates a view with values around the ranges of formats. Some of them only floats can represent.
fn view(channels: Channels, seed: u64) -> View {
    let mut r = Rng::new(seed);
    let pixels = (SIZE[0] * SIZE[1]) as usize;
    let mut image: Vec<f32> = (0..pixels * channels.count() as usize).map(|_| r.between(-0.3, 1.4) as f32).collect();
    for (i, v) in [0.0, 1.0, -2.0, 3.5, 0.04045, 0.0404, 1e5, -1e5, 0.5].into_iter().enumerate() {
        image[7 * i] = v;
    }
    let transmittance = (0..pixels).map(|i| if i % 5 == 0 { 1.0 } else { r.unit() as f32 }).collect();
    View { channels, image, transmittance }
}

/// Returns the texels' bytes and the report after `replays` submissions.
fn run(gpu: &Gpu, view: &View, as_: &Presented, flag: u32, wanted: u32, replays: usize) -> (Vec<u8>, Vec<u32>) {
    let pixels = view.transmittance.len();
    let mut g = Graph::new("present");
    let step = g.uniform("step", size_of::<Step>() as u64);
    let image = g.input("image", 4 * view.image.len() as u64);
    let transmittance = g.input("transmittance", 4 * pixels as u64);
    let (flags, entries) = (g.input("flags", 4), g.input("wanted", 4));
    let texels = g.external("texels", as_.format.bytes() * pixels as u64);
    let report = g.external("report", 12);
    let what = Present {
        blended: Blended { image, transmittance },
        channels: view.channels,
        flags,
        wanted: entries.into(),
        texels,
        report,
    };
    let tuning = gpu.tuning();
    // The capacity exceeds the pixels of this view.
    let screen = Screen { step, largest: [SIZE[0] + 40, SIZE[1] + 3], tile: tuning.tile };
    let room = u64::from(screen.largest[0] * screen.largest[1]);
    assert!(room > pixels as u64);
    present(&mut g, &tuning, &screen, &what, as_).unwrap();
    let values = Step { camera: Camera { size: SIZE, ..Default::default() }, ..Default::default() };
    let inputs = [
        (step, bytemuck::bytes_of(&values).to_vec()),
        (image, bytemuck::cast_slice(&view.image).to_vec()),
        (transmittance, bytemuck::cast_slice(&view.transmittance).to_vec()),
        (flags, flag.to_ne_bytes().to_vec()),
        (entries, wanted.to_ne_bytes().to_vec()),
        (report, vec![0; 12]),
    ];
    let out = gpu.run_times(g, &inputs, replays);
    (out.get(texels), out.get(report))
}

/// Returns a description of the first wrong texel.
fn wrong(view: &View, as_: &Presented, bytes: &[u8]) -> Option<String> {
    let double = |v: &[f32]| v.iter().map(|x| f64::from(*x)).collect::<Vec<f64>>();
    let expected = reference::present(&double(&view.image), &double(&view.transmittance), view.channels, as_);
    for (i, (texel, expected_value)) in bytes.chunks_exact(as_.format.bytes() as usize).zip(&expected).enumerate() {
        let fine = match as_.format {
            TexelFormat::Rgba32Float => {
                let got: [f32; 4] = bytemuck::pod_read_unaligned(texel);
                got.iter().zip(expected_value).all(|(g, w)| (f64::from(*g) - w).abs() <= 1e-5 * (1.0 + w.abs()))
            }
            TexelFormat::Rgba16Float => {
                let got: [f16; 4] = bytemuck::pod_read_unaligned(texel);
                // Vulkan leaves the direction of rounding open: a unit in the last place, of 11 bits.
                got.iter().zip(expected_value).all(|(g, w)| {
                    let w = w.clamp(-65504.0, 65504.0);
                    (f64::from(g.to_f32()) - w).abs() <= 1e-7 + w.abs() / 1024.0
                })
            }
            format => {
                let expected_value = reference::eight_bit(*expected_value, format);
                texel.iter().zip(expected_value).all(|(g, w)| g.abs_diff(w) <= 1)
            }
        };
        if !fine || texel.len() != as_.format.bytes() as usize {
            return Some(format!("pixel {i}: {texel:?} for {expected_value:?} as {as_:?}"));
        }
    }
    (bytes.len() as u64 != as_.format.bytes() * expected.len() as u64).then(|| "some are missing".into())
}

fn all() -> Vec<Presented> {
    let mut all = Vec::new();
    for format in TexelFormat::ALL {
        for layer in [Layer::Color, Layer::Depth, Layer::Normal, Layer::Alpha] {
            for encoding in [Encoding::Display, Encoding::Linear] {
                all.push(Presented { layer, format, encoding, depth_scale: 0.4 });
            }
        }
    }
    all
}

#[test]
fn every_layer_and_format_matches_reference() {
    let gpu = Gpu::new();
    for (k, as_) in all().into_iter().enumerate() {
        let channels = Channels {
            colors: true,
            normals: as_.layer == Layer::Normal || k % 3 == 0,
            depth: as_.layer == Layer::Depth,
        };
        let view = view(channels, k as u64);
        let (bytes, _) = run(&gpu, &view, &as_, 0, 5, 1);
        if let Some(wrong) = wrong(&view, &as_, &bytes) {
            panic!("{wrong}");
        }
    }
}

#[test]
fn a_wrong_texel_is_caught() {
    let gpu = Gpu::new();
    for format in TexelFormat::ALL {
        let as_ = Presented { layer: Layer::Color, format, encoding: Encoding::Display, depth_scale: 1.0 };
        let view = view(Channels { colors: true, normals: false, depth: false }, 3);
        let (bytes, _) = run(&gpu, &view, &as_, 0, 5, 1);
        assert_eq!(wrong(&view, &as_, &bytes), None);
        let other = Presented {
            format: if format.bytes() == 4 { TexelFormat::Bgra8Unorm } else { format },
            layer: if format.bytes() == 4 && format != TexelFormat::Bgra8Unorm && format != TexelFormat::Bgra8Srgb {
                Layer::Color
            } else {
                Layer::Alpha
            },
            ..as_
        };
        assert!(wrong(&view, &other, &bytes).is_some(), "{format:?} passes for {other:?}");
        let mut damaged = bytes.clone();
        let last = damaged.len() - as_.format.bytes() as usize / 4;
        damaged[last..].iter_mut().for_each(|b| *b ^= 0x7c);
        assert!(wrong(&view, &as_, &damaged).is_some(), "{format:?}");
    }
}

#[test]
fn srgb_output_is_encoded_once() {
    let gpu = Gpu::new();
    let view = view(Channels { colors: true, normals: false, depth: false }, 9);
    let bytes = |format, encoding| {
        run(&gpu, &view, &Presented { layer: Layer::Color, format, encoding, depth_scale: 1.0 }, 0, 5, 1).0
    };
    let plain = bytes(TexelFormat::Rgba8Unorm, Encoding::Display);
    for encoding in [Encoding::Display, Encoding::Linear] {
        assert_eq!(bytes(TexelFormat::Rgba8Srgb, encoding), plain);
    }
    assert_ne!(bytes(TexelFormat::Rgba8Unorm, Encoding::Linear), plain);
}

#[test]
fn report_accumulates_over_frames() {
    let gpu = Gpu::new();
    let view = view(Channels { colors: true, normals: false, depth: false }, 1);
    let as_ = Presented {
        layer: Layer::Color,
        format: TexelFormat::Rgba8Unorm,
        encoding: Encoding::Display,
        depth_scale: 1.0,
    };
    assert_eq!(run(&gpu, &view, &as_, 0, 77, 3).1, [3, 0, 77]);
    assert_eq!(run(&gpu, &view, &as_, 1, 99, 2).1, [2, 2, 99]);
}
