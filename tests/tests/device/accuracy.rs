//! Approximations against the double-precision reference with the same settings.
//!
//! Each approximation is also compared with the exact result.

use glam::{DMat3, DVec2, DVec3};
use sgs_engine::graph::Graph;
use sgs_passes::Accuracy;
use sgs_passes::pipeline::{Renderer, Step};
use sgs_passes::reference::blend::{Blended, render, render_at};
use sgs_passes::reference::project::{Camera, Gaussians, Projected, project_at};
use sgs_passes::scene::{Gaussians as GpuGaussians, Layout, Model, Storage};
use sgs_passes::splat::{Channels, Screen, Visible, project};
use sgs_tests::Gpu;
use sgs_tests::feature_view::gaussian_inputs;
use sgs_tests::scenes::{self, Rng};

const EXACT: Accuracy = Accuracy::EXACT;
const BACKGROUND: [f64; 3] = [0.2, 0.5, 0.8];

fn choices() -> Vec<(&'static str, Accuracy)> {
    vec![
        ("exact", EXACT),
        ("24 bits", Accuracy { depth_bits: 24, ..EXACT }),
        ("16 bits", Accuracy { depth_bits: 16, ..EXACT }),
        ("alpha 1/64", Accuracy { alpha_min: 1.0 / 64.0, ..EXACT }),
        ("alpha 1e-3", Accuracy { alpha_min: 1e-3, ..EXACT }),
        ("transmittance 1e-3", Accuracy { transmittance_min: 1e-3, ..EXACT }),
        ("last kept", Accuracy { keep_last: true, ..EXACT }),
        ("last kept at 1e-2", Accuracy { transmittance_min: 1e-2, keep_last: true, ..EXACT }),
        ("transmittance 1e-6", Accuracy { transmittance_min: 1e-6, ..EXACT }),
        ("colors in 16 bits", Accuracy { color_bits: 16, ..EXACT }),
        ("balanced", Accuracy::BALANCED),
        ("fast", Accuracy::FAST),
    ]
}

fn render_image(gpu: &Gpu, g: &Gaussians, camera: &Camera, a: Accuracy) -> Vec<f32> {
    let degree = (0..4).rev().find(|b| !g.sh[*b].is_empty()).unwrap_or(0) as u32;
    let model = Model { sh_degree: degree, ..Default::default() };
    let device = gpu.device();
    let gaussians = GpuGaussians::new(device, model, g.len() as u32, false).unwrap();
    gaussians.upload(device, &scenes::data(g)).unwrap();
    let tuning = gpu.tuning().with(a);
    let mut renderer = Renderer::new(device, tuning, &gaussians, camera.size, Channels::default()).unwrap();
    let background = BACKGROUND.map(|b| b as f32);
    renderer.render(&gaussians, &scenes::gpu_camera(camera), degree, background).unwrap().image
}

/// Returns the largest difference at pixels that are not doubtful.
///
/// The second number is the share of doubtful pixels.
fn difference(image: &[f32], truth: &Blended) -> (f64, f64) {
    let mut largest = 0.0_f64;
    for (p, pixel) in image.chunks_exact(3).enumerate().filter(|(p, _)| !truth.doubtful[*p]) {
        for (c, found) in pixel.iter().enumerate() {
            largest = largest.max((f64::from(*found) - truth.image[3 * p + c]).abs());
        }
    }
    let doubtful = truth.doubtful.iter().filter(|d| **d).count();
    (largest, doubtful as f64 / truth.doubtful.len() as f64)
}

#[test]
fn every_approximation_matches_reference() {
    let gpu = Gpu::new();
    for (name, a) in choices() {
        for seed in 1..3 {
            for g in [scenes::ordinary(300, 2, false, seed), scenes::hard(seed)] {
                let camera = scenes::camera([80, 60]);
                let truth = render_at(&g, &camera, 3, false, BACKGROUND, &a);
                let (largest, doubtful) = difference(&render_image(&gpu, &g, &camera, a), &truth);
                println!("{name}, seed {seed}: largest {largest:.2e}, doubtful {doubtful:.3}");
                assert!(largest < 5e-6, "{name}, seed {seed}: largest difference {largest}");
                assert!(doubtful < 0.5, "{name}, seed {seed}: {doubtful} of the pixels are doubtful");
            }
        }
    }
}

/// Every approximation changes the rendered image.
///
/// An approximation without effect would pass the comparison with the reference.
#[test]
fn every_approximation_changes_the_image() {
    let gpu = Gpu::new();
    let camera = scenes::camera([80, 60]);
    let mut g = scenes::ordinary(3000, 0, false, 5);
    // Nearly equal depths, so that short keys collide.
    g.means.chunks_exact_mut(3).for_each(|m| m[2] = 4.0 + 1e-3 * m[2]);
    let exact = render_image(&gpu, &g, &camera, EXACT);
    for (name, a) in choices().into_iter().skip(1) {
        let found = render_image(&gpu, &g, &camera, a);
        assert!(found != exact, "{name} changes nothing");
    }
}

/// Splats with equal short keys keep their index order, whichever is nearer.
#[test]
fn equal_short_keys_keep_index_order() {
    let gpu = Gpu::new();
    let camera = scenes::camera([16, 16]);
    let mut g = Gaussians::default();
    for (i, z) in [4.0 + 2e-4, 4.0].into_iter().enumerate() {
        g.means.extend([0.0, 0.0, z]);
        g.log_scales.extend([2.0; 3]);
        g.rotations.extend([1.0, 0.0, 0.0, 0.0]);
        g.opacity_logits.push(2.0);
        g.sh[0].extend(if i == 0 { [1.0, -1.0, -1.0] } else { [-1.0, 1.0, -1.0] });
    }
    let middle = 3 * (8 * 16 + 8);
    let exact = render_image(&gpu, &g, &camera, EXACT);
    assert!(exact[middle + 1] > exact[middle], "the second is nearer");
    let short = render_image(&gpu, &g, &camera, Accuracy { depth_bits: 16, ..EXACT });
    assert!(short[middle] > short[middle + 1], "the first comes first");
    let truth = render_at(&g, &camera, 0, false, BACKGROUND, &Accuracy { depth_bits: 16, ..EXACT });
    assert!(truth.image[middle] > truth.image[middle + 1], "the reference agrees");
}

/// Checks the bounds of `Accuracy` for thresholds.
///
/// The bounds scale with the largest color of splats and background.
#[test]
fn thresholds_keep_their_bounds() {
    let gpu = Gpu::new();
    let camera = scenes::camera([80, 60]);
    let g = scenes::ordinary(2000, 0, false, 9);
    let largest_color = g.sh[0].iter().fold(0.0_f64, |m, c| m.max(0.5 + 0.282_094_8 * c)).max(0.8);
    // A threshold of 1e-12 is effectively none.
    let truth = render_at(&g, &camera, 0, false, BACKGROUND, &Accuracy { transmittance_min: 1e-12, ..EXACT });
    for (transmittance_min, keep_last) in [(1e-4, false), (1e-3, false), (1e-4, true), (1e-3, true), (1e-2, true)] {
        let a = Accuracy { transmittance_min, keep_last, ..EXACT };
        let (largest, _) = difference(&render_image(&gpu, &g, &camera, a), &truth);
        let bound = f64::from(transmittance_min) * largest_color * if keep_last { 1.0 } else { 100.0 };
        println!("{transmittance_min}, {keep_last}: {largest:.2e} of {bound:.2e}");
        assert!(largest > 1e-2 * bound && largest <= bound + 1e-5, "{largest:.2e} of {bound:.2e}");
    }
}

/// Checks the bounds of images with a preset, as in docs/how/accuracy.md.
///
/// The double-precision result has no transmittance threshold. Depths differ enough for the shortest keys.
#[test]
fn presets_keep_their_bounds() {
    let gpu = Gpu::new();
    let camera = Camera { rotation: DMat3::IDENTITY, translation: DVec3::ZERO, ..scenes::camera([80, 60]) };
    let count = 2000;
    let mut g = scenes::ordinary(count, 0, false, 9);
    for (i, mean) in g.means.as_chunks_mut::<3>().0.iter_mut().enumerate() {
        // Depths are in shuffled order.
        let z = 6.0_f64.powf((i * 227 % count) as f64 / count as f64);
        *mean = mean.map(|m| f64::from((m * z / mean[2]) as f32));
    }
    let truth = render_at(&g, &camera, 0, false, BACKGROUND, &Accuracy { transmittance_min: 1e-12, ..EXACT });
    let splats = project_at(&g, &camera, 0, false, &EXACT);
    let color = splats.iter().flat_map(|s| &s.features[..3]).chain(&BACKGROUND).fold(0.0_f64, |m, c| m.max(*c));
    for (name, a, least) in
        [("exact", EXACT, 0.06), ("balanced", Accuracy::BALANCED, 0.3), ("fast", Accuracy::FAST, 0.07)]
    {
        let mut keys: Vec<u32> = project_at(&g, &camera, 0, false, &a).iter().map(|s| s.key).collect();
        let seen = keys.len();
        keys.dedup();
        assert_eq!(keys.len(), seen, "{name}: two keys are the same");
        // Terms of the bound that hold for the whole image. Each pixel adds a term for every splat skipped there.
        let behind = if a.keep_last { 1.0 } else { 100.0 } * f64::from(a.transmittance_min);
        let rounded = if a.color_bits == 16 { 2.0_f64.powi(-11) } else { 0.0 };
        let image = render_image(&gpu, &g, &camera, a);
        let (mut share, mut left_out) = (0.0_f64, 0);
        for (p, pixel) in image.chunks_exact(3).enumerate() {
            let at = DVec2::new((p % 80) as f64 + 0.5, (p / 80) as f64 + 0.5);
            // Margins of 1 % cover rounding at both thresholds.
            let faint = |s: &&Projected| (0.99 / 255.0..1.01 * f64::from(a.alpha_min)).contains(&s.alpha(at));
            let faint = splats.iter().filter(faint).count();
            let bound = color * (behind + rounded + faint as f64 * f64::from(a.alpha_min)) + 5e-6;
            for (c, found) in pixel.iter().enumerate() {
                let off = (f64::from(*found) - truth.image[3 * p + c]).abs();
                assert!(off <= bound, "{name}, pixel {p}: {off:.2e} of {bound:.2e}");
                share = share.max(off / bound);
            }
            left_out += faint;
        }
        println!("{name}: up to {share:.3} of the bound, {left_out} splats left out");
        assert!(share > least, "{name}: the bound says nothing, {share}");
    }
}

/// Returns the records of visible splats as words, and the number of splats.
fn records(gpu: &Gpu, g: &Gaussians, color_bits: u32) -> (Vec<u32>, usize) {
    let camera = scenes::camera([80, 60]);
    let t = gpu.tuning().with(Accuracy { color_bits, ..EXACT });
    let model = Model { sh_degree: 0, normals: true, ..Default::default() };
    let layout =
        Layout { model, capacity: g.len() as u32, training: false, statistics: false, storage: Storage::Exact };
    let mut graph = Graph::new("records");
    let handles = layout.declare(&mut graph, false);
    let step = graph.uniform("step", size_of::<Step>() as u64);
    let screen = Screen { step, largest: camera.size, tile: t.tile };
    let channels = Channels { colors: true, normals: true, depth: true };
    let visible = project(&mut graph, &t, &screen, &handles, channels).unwrap();
    let words = Visible::words(channels, color_bits) as usize;
    let records = graph.external("records", 4 * (words * g.len()) as u64);
    let counts = graph.external("counts", 4 * g.len() as u64);
    graph.copy("records", visible.features, records).unwrap();
    graph.copy("counts", visible.tile_counts, counts).unwrap();
    let mut seen = scenes::gpu_camera(&camera);
    seen.tiles = [camera.size[0].div_ceil(t.tile[0]), camera.size[1].div_ceil(t.tile[1])];
    let mut inputs = gaussian_inputs(g, &handles);
    inputs.push((step, bytemuck::bytes_of(&Step { camera: seen, step: 1, ..Default::default() }).to_vec()));
    let out = gpu.run(graph, &inputs);
    let count = out.get::<u32>(counts).iter().filter(|c| **c != u32::MAX).count();
    (out.get::<u32>(records), count)
}

/// Stored 16-bit colors equal the rounded 32-bit colors bit for bit.
///
/// Colors span all magnitudes, including zero. Other fields of the records are unchanged.
#[test]
fn colors_are_rounded_to_nearest_on_every_device() {
    let gpu = Gpu::new();
    let mut g = scenes::ordinary(700, 0, true, 3);
    let mut r = Rng::new(5);
    for c in &mut g.sh[0] {
        let color = r.between(0.5, 2.0) * 2.0_f64.powf(r.between(-26.0, 19.0));
        *c = f64::from(((color - 0.5) / 0.282_094_791_773_878_14) as f32);
    }
    for (i, c) in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e30, -1.0 / 0.282_094_79, 1e-6].into_iter().enumerate()
    {
        g.sh[0][5 * i] = c;
    }
    let (wide, count) = records(&gpu, &g, 32);
    let (narrow, again) = records(&gpu, &g, 16);
    assert!(count == again && count > 500, "{count} and {again} are seen");
    let color = |x: f32| half::f16::from_f32(x.min(65504.0)).to_bits();
    let (mut ties, mut largest) = (0, 0);
    for (v, (wide, narrow)) in wide.chunks_exact(8).zip(narrow.chunks_exact(7)).take(count).enumerate() {
        let [red, green, blue] = [0, 1, 2].map(|c| color(f32::from_bits(wide[c])));
        let expected = [u32::from(red) | u32::from(green) << 16, u32::from(blue)];
        assert_eq!(narrow[..2], expected, "splat {v}: {:?}", [0, 1, 2].map(|c| f32::from_bits(wide[c])));
        assert_eq!(narrow[2..], wide[3..], "splat {v}");
        ties += u32::from(red < 1024) + u32::from(green < 1024);
        largest += u32::from([red, green, blue].contains(&0x7bff));
    }
    assert!(ties > 20 && largest > 20, "{ties} small ones, {largest} large ones");
    // Nothing is written past the visible splats.
    assert!(narrow[7 * count..].iter().all(|w| *w == u32::MAX));
}

/// Checks the bound of `Accuracy` for colors in 16 bits.
#[test]
fn colors_in_16_bits_keep_their_bound() {
    let gpu = Gpu::new();
    let camera = scenes::camera([80, 60]);
    let g = scenes::ordinary(2000, 0, false, 9);
    let brightest = g.sh[0].iter().fold(0.0_f64, |m, c| m.max(0.5 + 0.282_094_8 * c));
    let [wide, narrow] = [32, 16].map(|color_bits| render_image(&gpu, &g, &camera, Accuracy { color_bits, ..EXACT }));
    let off = wide.iter().zip(&narrow).map(|(a, b)| f64::from((a - b).abs())).fold(0.0, f64::max);
    let bound = brightest * 2.0_f64.powi(-11);
    println!("{off:.2e} of {bound:.2e}");
    assert!(off > 1e-2 * bound && off <= bound + 1e-6, "{off:.2e} of {bound:.2e}");
}

#[test]
#[should_panic(expected = "largest difference")]
fn wrong_reference_is_detected() {
    let gpu = Gpu::new();
    let camera = scenes::camera([80, 60]);
    let g = scenes::ordinary(300, 2, false, 1);
    let truth = render(&g, &camera, 3, false, BACKGROUND);
    let (largest, _) =
        difference(&render_image(&gpu, &g, &camera, Accuracy { alpha_min: 1.0 / 64.0, ..EXACT }), &truth);
    assert!(largest < 2e-3, "largest difference {largest}");
}
