//! What is traded for speed, against the double-precision twin of the same choice; and how far each choice is from none.

use sgs_passes::Accuracy;
use sgs_passes::pipeline::Renderer;
use sgs_passes::reference::blend::{Blended, render, render_at};
use sgs_passes::reference::project::{Camera, Gaussians};
use sgs_passes::scene::{Gaussians as GpuGaussians, Model};
use sgs_passes::splat::Channels;
use sgs_tests::{Gpu, scenes};

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
        ("fast exponential", Accuracy { fast_exp: true, ..EXACT }),
        ("fast", Accuracy::FAST),
    ]
}

fn picture(gpu: &Gpu, g: &Gaussians, camera: &Camera, a: Accuracy) -> Vec<f32> {
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

/// Largest difference where the twin is sure, and the share of pixels where it is not.
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
fn every_choice_agrees_with_its_twin() {
    let gpu = Gpu::new();
    for (name, a) in choices() {
        for seed in 1..3 {
            for g in [scenes::ordinary(300, 2, false, seed), scenes::hard(seed)] {
                let camera = scenes::camera([80, 60]);
                let truth = render_at(&g, &camera, 3, false, BACKGROUND, &a);
                let (largest, doubtful) = difference(&picture(&gpu, &g, &camera, a), &truth);
                println!("{name}, seed {seed}: largest {largest:.2e}, doubtful {doubtful:.3}");
                // The twin's exponential is exact.
                let most = if a.fast_exp { 2e-4 } else { 5e-6 };
                assert!(largest < most, "{name}, seed {seed}: largest difference {largest}");
                assert!(doubtful < 0.5, "{name}, seed {seed}: {doubtful} of the pixels are doubtful");
            }
        }
    }
}

/// Choices that do nothing would be cheap and exact: each must be seen in the picture of the twin, and so in ours.
#[test]
fn every_choice_makes_a_difference() {
    let gpu = Gpu::new();
    let camera = scenes::camera([80, 60]);
    let mut g = scenes::ordinary(3000, 0, false, 5);
    // All at about one distance, so that short keys meet.
    g.means.chunks_exact_mut(3).for_each(|m| m[2] = 4.0 + 1e-3 * m[2]);
    let exact = picture(&gpu, &g, &camera, EXACT);
    for (name, a) in choices().into_iter().skip(1) {
        let found = picture(&gpu, &g, &camera, a);
        assert!(found != exact, "{name} changes nothing");
    }
}

/// Splats whose keys are the same stay in the order of their numbers, whichever is nearer.
#[test]
fn short_keys_keep_the_order_of_numbers() {
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
    let exact = picture(&gpu, &g, &camera, EXACT);
    assert!(exact[middle + 1] > exact[middle], "the second is nearer");
    let short = picture(&gpu, &g, &camera, Accuracy { depth_bits: 16, ..EXACT });
    assert!(short[middle] > short[middle + 1], "the first comes first");
    let truth = render_at(&g, &camera, 0, false, BACKGROUND, &Accuracy { depth_bits: 16, ..EXACT });
    assert!(truth.image[middle] > truth.image[middle + 1], "the twin agrees");
}

/// What `Accuracy` promises of thresholds, on splats whose colors are at most one.
#[test]
fn thresholds_keep_their_bounds() {
    let gpu = Gpu::new();
    let camera = scenes::camera([80, 60]);
    let g = scenes::ordinary(2000, 0, false, 9);
    let largest_color = g.sh[0].iter().fold(0.0_f64, |m, c| m.max(0.5 + 0.282_094_8 * c)).max(0.8);
    // As good as no threshold.
    let truth = render_at(&g, &camera, 0, false, BACKGROUND, &Accuracy { transmittance_min: 1e-12, ..EXACT });
    for (transmittance_min, keep_last) in [(1e-4, false), (1e-3, false), (1e-4, true), (1e-3, true), (1e-2, true)] {
        let a = Accuracy { transmittance_min, keep_last, ..EXACT };
        let (largest, _) = difference(&picture(&gpu, &g, &camera, a), &truth);
        let bound = f64::from(transmittance_min) * largest_color * if keep_last { 1.0 } else { 100.0 };
        println!("{transmittance_min}, {keep_last}: {largest:.2e} of {bound:.2e}");
        assert!(largest > 1e-2 * bound && largest <= bound + 1e-5, "{largest:.2e} of {bound:.2e}");
    }
}

#[test]
#[should_panic(expected = "largest difference")]
fn a_wrong_twin_is_noticed() {
    let gpu = Gpu::new();
    let camera = scenes::camera([80, 60]);
    let g = scenes::ordinary(300, 2, false, 1);
    let truth = render(&g, &camera, 3, false, BACKGROUND);
    let (largest, _) = difference(&picture(&gpu, &g, &camera, Accuracy { alpha_min: 1.0 / 64.0, ..EXACT }), &truth);
    assert!(largest < 2e-3, "largest difference {largest}");
}
