//! Rendering against the double-precision twin, at ordinary and extreme inputs.

use sgs_passes::pipeline::Renderer;
use sgs_passes::reference::blend::{Blended, render};
use sgs_passes::reference::project::{Camera, Gaussians};
use sgs_passes::scene::{Gaussians as GpuGaussians, Model};
use sgs_passes::splat::Channels;
use sgs_tests::{Gpu, scenes};

/// Renders on the GPU and by the twin; returns the largest difference where nothing is doubtful, the share of doubtful
/// pixels, and the PSNR over all.
fn compare(gpu: &Gpu, g: &Gaussians, camera: &Camera, depth: bool) -> (f64, f64, f64) {
    let degree = (0..4).rev().find(|b| !g.sh[*b].is_empty()).unwrap_or(0) as u32;
    let model = Model { sh_degree: degree, normals: !g.normals.is_empty(), semantics: !g.semantics.is_empty() };
    let channels = Channels { normals: model.normals, depth };
    let device = gpu.device();
    let gaussians = GpuGaussians::new(device, model, g.len() as u32, false).unwrap();
    gaussians.upload(device, &scenes::data(g)).unwrap();
    let mut renderer = Renderer::new(device, gpu.tuning(), &gaussians, camera.size, channels).unwrap();
    let background = [0.2, 0.5, 0.8];
    let picture =
        renderer.render(&gaussians, &scenes::gpu_camera(camera), degree, background.map(|b| b as f32)).unwrap();
    let truth = render(g, camera, degree as usize, depth, background);
    assert!(picture.image.iter().chain(&picture.transmittance).all(|v| v.is_finite()), "a value is not finite");
    difference(&picture.image, &picture.transmittance, &truth, channels.count() as usize)
}

fn difference(image: &[f32], transmittance: &[f32], truth: &Blended, channels: usize) -> (f64, f64, f64) {
    let (mut largest, mut square) = (0.0_f64, 0.0);
    for (p, doubtful) in truth.doubtful.iter().enumerate() {
        for c in 0..channels {
            let t = truth.image[p * channels + c];
            // Depth is in the scene's unit and its square grows with it: both are compared relatively.
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
fn ordinary_splats_agree_with_the_twin() {
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
fn hard_splats_agree_with_the_twin() {
    let gpu = Gpu::new();
    for seed in 1..4 {
        let g = scenes::hard(seed);
        let (largest, doubtful, psnr) = compare(&gpu, &g, &scenes::camera([160, 120]), false);
        println!("seed {seed}: largest {largest:.2e}, doubtful {doubtful:.3}, psnr {psnr:.1}");
        assert!(largest < 2e-3, "seed {seed}: largest difference {largest}");
        assert!(psnr > 65.0, "seed {seed}: PSNR {psnr}");
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
