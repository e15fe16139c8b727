//! Simulated normal, albedo, roughness and metallic maps.

use glam::{Quat, Vec3};

use crate::color::{decode3, encode3, luminance};
use crate::priors::Drift;
use crate::rng::Rng;
use crate::trace::camera::Camera;
use crate::trace::denoise::Image;
use crate::trace::film::Film;

/// Maps of one view, rows from the top.
pub(crate) struct Maps {
    /// Unit normals in the camera's OpenGL axes.
    pub(crate) normal: Vec<Vec3>,
    /// Albedo, display-encoded.
    pub(crate) albedo: Vec<Vec3>,
    /// Roughness.
    pub(crate) roughness: Vec<f32>,
    /// Metallic.
    pub(crate) metallic: Vec<f32>,
}

/// Simulates the prior maps of one view. `seed` and `view` key the errors.
pub(crate) fn imitate(film: &Film, image: &Image, camera: &Camera, seed: u64, view: u64) -> Maps {
    let count = film.pixels.len();
    let (w, h) = (film.width, film.height);
    let keyed = |salt: u64| Rng::new(&[seed, view, salt]);
    // Networks predict at a coarser scale than the image, so every map is averaged with its neighbors.
    let normal = blur(&film.features.iter().map(|f| f.normal).collect::<Vec<_>>(), w, h);
    let albedo = blur(&film.pixels.iter().map(|p| p.albedo).collect::<Vec<_>>(), w, h);
    let material = blur(&film.pixels.iter().map(|p| Vec3::new(p.roughness, p.metallic, 0.0)).collect::<Vec<_>>(), w, h);
    let shading = shading(film, image);
    let tilt = Drift::new(&[seed, view, 1], w, 0.35);
    let tint = Drift::new(&[seed, view, 2], w, 0.4);
    let wear = Drift::new(&[seed, view, 3], w, 0.3);
    let gain = Vec3::ONE + 0.04 * keyed(4).normal3();
    let mut noise = keyed(5);
    let mut maps = Maps {
        normal: Vec::with_capacity(count),
        albedo: Vec::with_capacity(count),
        roughness: Vec::with_capacity(count),
        metallic: Vec::with_capacity(count),
    };
    for index in 0..count {
        let (x, y) = (index % w, index / w);
        let instance = u64::from(film.features[index].instance);
        let bias = |salt: u64| Rng::new(&[seed, salt, instance]).normal3();
        let turn = 0.24 * tilt.at(x, y) + 0.035 * bias(11) + 0.025 * noise.normal3();
        let local = camera.local(normal[index]).normalize_or(Vec3::Z);
        maps.normal.push((Quat::from_scaled_axis(turn) * local).normalize());
        let leak = shading[index].powf(0.09).clamp(0.75, 1.25);
        let object = Vec3::ONE + 0.05 * bias(12);
        let color = albedo[index] * gain * object * leak * (Vec3::ONE + 0.13 * tint.at(x, y));
        let display = encode3(color) + 0.012 * noise.normal3();
        maps.albedo.push(display.clamp(Vec3::ZERO, Vec3::ONE));
        let offset = bias(13);
        let drift = wear.at(x, y);
        let rough = material[index].x + 0.055 * offset.x + 0.12 * drift.x + 0.01 * noise.normal();
        maps.roughness.push(rough.clamp(0.02, 1.0));
        // Metals are underestimated; other materials get small positive errors.
        let metal =
            0.88 * material[index].y + (0.03 * offset.y).abs() + (0.09 * drift.y).max(0.0) + 0.01 * noise.normal();
        maps.metallic.push(metal.clamp(0.0, 1.0));
    }
    maps
}

/// Returns the brightness that albedo does not explain.
///
/// Values are relative to the view's median.
fn shading(film: &Film, image: &Image) -> Vec<f32> {
    let ratio: Vec<f32> = film
        .pixels
        .iter()
        .zip(image)
        .map(|(p, c)| {
            let display = decode3(encode3(*c));
            (luminance(display) + 0.01) / (luminance(p.albedo) + 0.03)
        })
        .collect();
    let mut sorted = ratio.clone();
    sorted.sort_by(f32::total_cmp);
    let middle = sorted[sorted.len() / 2].max(1e-3);
    ratio.into_iter().map(|r| r / middle).collect()
}

/// Applies a 3×3 mean with a larger weight on the center.
fn blur(map: &[Vec3], width: usize, height: usize) -> Vec<Vec3> {
    (0..map.len())
        .map(|index| {
            let (x, y) = (index % width, index / width);
            let (mut sum, mut total) = (5.0 * map[index], 5.0);
            for ny in y.saturating_sub(1)..(y + 2).min(height) {
                for nx in x.saturating_sub(1)..(x + 2).min(width) {
                    sum += map[ny * width + nx];
                    total += 1.0;
                }
            }
            sum / total
        })
        .collect()
}
