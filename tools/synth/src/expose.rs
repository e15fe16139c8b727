//! Scales all lights so that images at exposure 1 are well exposed.
//!
//! Renders some training views at a small size. One factor on every light then brings their mean display value to a
//! target, unless too many values would clip.

use glam::Vec3;

use crate::color::encode;
use crate::rng;
use crate::scene::{MAX_GROUPS, Scene};
use crate::trace::camera::Camera;
use crate::trace::denoise;
use crate::trace::path::PathOptions;
use crate::trace::render::render;

/// Target of the mean display value.
const TARGET: f32 = 0.52;
/// Largest fraction of the values on surfaces that may clip.
const CLIPPED_SURFACES: f32 = 0.045;
/// Largest fraction of all values that may clip, lights included.
const CLIPPED: f32 = 0.09;

/// Scales the scene's lights. `seed` keys the samples of the probe renders.
pub(crate) fn expose(scene: &mut Scene, cameras: &[Camera], seed: u64) {
    let options = PathOptions { bounces: 4, ..PathOptions::default() };
    let (mut all, mut surfaces) = (Vec::new(), Vec::new());
    // At most twelve views suffice to measure the brightness of the room.
    let step = cameras.len().div_ceil(12);
    for (index, camera) in cameras.iter().step_by(step).enumerate() {
        let height = (WIDTH * camera.height).div_ceil(camera.width).clamp(6, 60);
        let small = camera.resized(WIDTH, height);
        let key = rng::key(&[seed, 0xe4b0, index as u64]);
        let film = render(scene, &small, key, SAMPLES, &options, &|| {});
        let image = denoise::image(&film, 1.0, &[Vec3::ONE; MAX_GROUPS], false);
        for (color, feature) in image.iter().zip(&film.features) {
            all.extend(color.to_array());
            if feature.surface {
                surfaces.extend(color.to_array());
            }
        }
    }
    let mean = |scale: f32| all.iter().map(|v| encode(scale * v)).sum::<f32>() / all.len() as f32;
    let (mut low, mut high) = (1e-4f32, 1e4f32);
    for _ in 0..40 {
        let middle = (low * high).sqrt();
        if mean(middle) < TARGET {
            low = middle;
        } else {
            high = middle;
        }
    }
    let bright = quantile(&mut surfaces, 1.0 - CLIPPED_SURFACES).max(quantile(&mut all, 1.0 - CLIPPED));
    scene.scale_light(low.min(1.0 / bright.max(1e-4)));
}

/// Width of the probe images in pixels.
const WIDTH: usize = 24;
/// Paths per pixel of the probe images.
const SAMPLES: usize = 24;

/// Returns the quantile of `values` at fraction `share`, or 0 for an empty slice.
fn quantile(values: &mut [f32], share: f32) -> f32 {
    if values.is_empty() {
        return 0.0;
    }
    values.sort_by(f32::total_cmp);
    values[(share * (values.len() - 1) as f32) as usize]
}
