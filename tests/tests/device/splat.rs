//! Rendering at ordinary and extreme inputs, compared with the reference. The reference is in double precision.

use sgs_passes::pipeline::Renderer;
use sgs_passes::reference::blend::{Blended, render};
use sgs_passes::reference::project::{Camera, Gaussians};
use sgs_passes::scene::{FEATURES, Gaussians as GpuGaussians, Model};
use sgs_passes::splat::Channels;
use sgs_tests::{Gpu, scenes};

/// Compares the device's image with the reference. Returns the largest difference at conclusive pixels, the share of
/// inconclusive pixels, and the PSNR over all pixels.
fn compare(gpu: &Gpu, g: &Gaussians, camera: &Camera, depth: bool) -> (f64, f64, f64) {
    let degree = (0..4).rev().find(|b| !g.sh[*b].is_empty()).unwrap_or(0) as u32;
    let model =
        Model { sh_degree: degree, normals: !g.normals.is_empty(), semantics: !g.semantics.is_empty(), mip: g.mip };
    let channels = Channels { colors: true, normals: model.normals, depth };
    let device = gpu.device();
    let gaussians = GpuGaussians::new(device, model, g.len() as u32, false).unwrap();
    gaussians.upload(device, &scenes::data(g)).unwrap();
    let mut renderer = Renderer::new(device, gpu.tuning(), &gaussians, camera.size, channels).unwrap();
    let background = [0.2, 0.5, 0.8];
    let rendered =
        renderer.render(&gaussians, &scenes::gpu_camera(camera), degree, background.map(|b| b as f32)).unwrap();
    let truth = render(g, camera, degree as usize, depth, background);
    assert!(rendered.image.iter().chain(&rendered.transmittance).all(|v| v.is_finite()), "a value is not finite");
    difference(&rendered.image, &rendered.transmittance, &truth, channels.count() as usize)
}

fn difference(image: &[f32], transmittance: &[f32], truth: &Blended, channels: usize) -> (f64, f64, f64) {
    let (mut largest, mut square) = (0.0_f64, 0.0);
    for (p, doubtful) in truth.doubtful.iter().enumerate() {
        for c in 0..channels {
            let t = truth.image[p * channels + c];
            // Depth has the scene's unit and its square grows with it. Both are compared relatively.
            let scale = if c < 3 { 1.0 } else { t.abs().max(1.0) };
            let d = (f64::from(image[p * channels + c]) - t).abs() / scale;
            if c < 3 {
                square += d * d;
            }
            if !doubtful {
                largest = largest.max(d);
            }
        }
        if !doubtful {
            largest = largest.max((f64::from(transmittance[p]) - truth.transmittance[p]).abs());
        }
    }
    let pixels = truth.doubtful.len() as f64;
    let share = truth.doubtful.iter().filter(|d| **d).count() as f64 / pixels;
    (largest, share, -10.0 * (square / (3.0 * pixels)).log10())
}

#[test]
fn ordinary_splats_match_reference() {
    let gpu = Gpu::new();
    for (size, count, degree, normals, depth) in [
        ([64, 48], 200, 3, true, true),
        ([61, 37], 500, 0, false, false),
        ([17, 3], 40, 2, false, true),
        ([1, 1], 20, 1, false, false),
    ] {
        let g = scenes::ordinary(count, degree, normals, 7);
        let (largest, doubtful, psnr) = compare(&gpu, &g, &scenes::camera(size), depth);
        println!("{size:?}: largest {largest:.2e}, doubtful {doubtful:.3}, psnr {psnr:.1}");
        assert!(largest < 2e-3, "{size:?}: largest difference {largest}");
        assert!(psnr > 65.0, "{size:?}: PSNR {psnr}");
    }
}

#[test]
fn hard_splats_match_reference() {
    let gpu = Gpu::new();
    for seed in 1..4 {
        let g = scenes::hard(seed);
        let (largest, doubtful, psnr) = compare(&gpu, &g, &scenes::camera([160, 120]), false);
        println!("seed {seed}: largest {largest:.2e}, doubtful {doubtful:.3}, psnr {psnr:.1}");
        assert!(largest < 2e-3, "seed {seed}: largest difference {largest}");
        assert!(psnr > 65.0, "seed {seed}: PSNR {psnr}");
    }
}

/// Tests the 2D Mip filter on ordinary splats, small splats, and corner cases.
#[test]
fn filtered_splats_match_reference() {
    let gpu = Gpu::new();
    let mut small = scenes::ordinary(300, 1, false, 9);
    small.log_scales.iter_mut().for_each(|s| *s -= 1.5);
    for (name, mut g, size) in [
        ("ordinary", scenes::ordinary(200, 2, true, 7), [61, 37]),
        ("small", small, [64, 48]),
        ("hard", scenes::hard(2), [160, 120]),
    ] {
        let plain = render(&g, &scenes::camera(size), 1, false, [0.2, 0.5, 0.8]);
        g.mip = true;
        let filtered = render(&g, &scenes::camera(size), 1, false, [0.2, 0.5, 0.8]);
        let changed = plain.image.iter().zip(&filtered.image).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        let (largest, doubtful, psnr) = compare(&gpu, &g, &scenes::camera(size), false);
        println!("{name}: largest {largest:.2e}, doubtful {doubtful:.3}, psnr {psnr:.1}, changed {changed:.3}");
        assert!(largest < 2e-3 && psnr > 65.0 && changed > 0.02, "{name}: {largest} {psnr} {changed}");
    }
}

#[test]
fn a_planted_error_is_caught() {
    let camera = scenes::camera([32, 24]);
    let g = scenes::ordinary(50, 1, false, 3);
    let truth = render(&g, &camera, 1, false, [0.0; 3]);
    let mut moved = g.clone();
    moved.means[0] += 0.05;
    let other = render(&moved, &camera, 1, false, [0.0; 3]);
    let image: Vec<f32> = other.image.iter().map(|v| *v as f32).collect();
    let transmittance: Vec<f32> = other.transmittance.iter().map(|v| *v as f32).collect();
    assert!(difference(&image, &transmittance, &truth, 3).0 > 2e-3);
}

/// Returns the largest difference of features at conclusive pixels. Features are the last channels of the reference's
/// rows.
fn feature_difference(found: &[f32], truth: &Blended) -> f64 {
    let channels = truth.image.len() / truth.doubtful.len();
    let pixels = truth.image.chunks(channels).zip(found.chunks(FEATURES)).zip(&truth.doubtful);
    let differences = pixels
        .filter(|(_, doubtful)| !**doubtful)
        .flat_map(|((t, f), _)| t[channels - FEATURES..].iter().zip(f).map(|(t, f)| (f64::from(*f) - t).abs()));
    differences.fold(0.0, f64::max)
}

/// Tests one renderer with views of several sizes. Its entry capacity is too small at first.
#[test]
fn features_are_blended_at_every_pixel() {
    let gpu = Gpu::new();
    let device = gpu.device();
    let g = scenes::with_semantics(scenes::ordinary(2500, 0, true, 11), 5);
    let model = Model { sh_degree: 0, normals: true, semantics: true, mip: false };
    let gaussians = GpuGaussians::new(device, model, g.len() as u32, false).unwrap();
    gaussians.upload(device, &scenes::data(&g)).unwrap();
    let channels = Channels { colors: true, normals: true, depth: false };
    let mut renderer = Renderer::with_features(device, gpu.tuning(), &gaussians, [1, 1], channels).unwrap();
    for size in [[33, 20], [61, 37], [17, 3], [1, 1]] {
        let camera = scenes::camera(size);
        let rendered = renderer.render(&gaussians, &scenes::gpu_camera(&camera), 0, [0.5; 3]).unwrap();
        assert_eq!(rendered.channels, 6);
        let pixels = (size[0] * size[1]) as usize;
        let found: Vec<f32> = device.download_as(renderer.features().unwrap(), pixels * FEATURES).unwrap();
        let truth = render(&g, &camera, 0, false, [0.5; 3]);
        let d = feature_difference(&found, &truth);
        assert!(d < 2e-3, "{size:?}: largest difference {d}");
        assert!(truth.doubtful.iter().filter(|d| !**d).count() > pixels / 2, "{size:?} shows too little");
        // The comparison detects a changed feature.
        let mut other = found.clone();
        let sure = truth.doubtful.iter().position(|d| !*d).unwrap();
        other[sure * FEATURES + 31] += 0.01;
        assert!(feature_difference(&other, &truth) > 5e-3);
    }
    // Gaussians without features use the same renderer, followed by those with features.
    let plain = GpuGaussians::new(device, Model { semantics: false, ..model }, g.len() as u32, false).unwrap();
    plain.upload(device, &scenes::data(&g)).unwrap();
    let camera = scenes::gpu_camera(&scenes::camera([33, 20]));
    let without = renderer.render(&plain, &camera, 0, [0.5; 3]).unwrap();
    assert!(renderer.features().is_none());
    let with = renderer.render(&gaussians, &camera, 0, [0.5; 3]).unwrap();
    assert!(renderer.features().is_some() && with.image == without.image);
}

/// Tests that images without colors keep all other channels bit for bit.
#[test]
fn views_without_colors_have_the_same_depth_and_normals() {
    let gpu = Gpu::new();
    let g = scenes::ordinary(200, 2, true, 7);
    let camera = scenes::camera([37, 29]);
    let model = Model { sh_degree: 2, normals: true, semantics: false, mip: false };
    let gaussians = GpuGaussians::new(gpu.device(), model, g.len() as u32, false).unwrap();
    gaussians.upload(gpu.device(), &scenes::data(&g)).unwrap();
    let rendered = |channels: Channels| {
        let mut renderer = Renderer::new(gpu.device(), gpu.tuning(), &gaussians, camera.size, channels).unwrap();
        renderer.render(&gaussians, &scenes::gpu_camera(&camera), 2, [0.3, 0.9, 0.1]).unwrap()
    };
    for normals in [true, false] {
        let all = rendered(Channels { colors: true, normals, depth: true });
        let bare = rendered(Channels { colors: false, normals, depth: true });
        assert_eq!(all.transmittance, bare.transmittance);
        let rest: Vec<f32> = all.image.chunks(all.channels as usize).flat_map(|p| p[3..].to_vec()).collect();
        assert_eq!(bare.image, rest);
        assert!(rest.iter().any(|v| *v > 0.5), "nothing to see");
    }
}
