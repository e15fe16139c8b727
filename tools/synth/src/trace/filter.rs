//! Edge-avoiding à-trous filter of a color with variance.
//!
//! Five passes of a 5×5 kernel with growing gaps average over up to 125 pixels across. Only pixels of the same surface
//! (plane and normal) contribute, and only if the noise explains their brightness difference. The filter also updates
//! the noise estimate, so later passes accept smaller differences.

use glam::Vec3;
use rayon::prelude::*;

use crate::color::luminance;
use crate::trace::film::Feature;

/// Color and the variance of its luminance.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Estimate {
    /// Color.
    pub(crate) color: Vec3,
    /// Variance of the luminance.
    pub(crate) variance: f32,
}

/// Tolerances for the comparison of neighbors.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Strictness {
    /// Accepted brightness difference in standard deviations.
    pub(crate) brightness: f32,
    /// Exponent of the cosine between normals.
    pub(crate) normal: f32,
    /// Accepted distance from the pixel's plane, in pixel footprints.
    pub(crate) plane: f32,
}

/// Inputs that decide which neighbors contribute.
pub(crate) struct Guide<'a> {
    /// Image width.
    pub(crate) width: usize,
    /// Image height.
    pub(crate) height: usize,
    /// Geometry by pixel.
    pub(crate) features: &'a [Feature],
    /// Size of a pixel at unit depth.
    pub(crate) footprint: f32,
    /// Number of filter passes by pixel.
    pub(crate) passes: &'a [u8],
}

impl Guide<'_> {
    /// Visits the in-image pixels of a 5×5 kernel with gaps of `step`.
    ///
    /// `visit` receives a pixel's index and the kernel's weight.
    fn window(&self, index: usize, step: i32, mut visit: impl FnMut(usize, f32)) {
        let (w, h) = (self.width as i32, self.height as i32);
        let (x, y) = (index as i32 % w, index as i32 / w);
        for dy in -2..=2i32 {
            for dx in -2..=2i32 {
                let (nx, ny) = (x + dx * step, y + dy * step);
                if nx >= 0 && ny >= 0 && nx < w && ny < h {
                    let (i, j) = (dx.unsigned_abs() as usize, dy.unsigned_abs() as usize);
                    visit((ny * w + nx) as usize, KERNEL[i] * KERNEL[j]);
                }
            }
        }
    }
}

/// Binomial weights by distance.
const KERNEL: [f32; 3] = [0.375, 0.25, 0.0625];

/// Largest number of passes for a pixel.
pub(crate) const MAX_PASSES: u8 = 5;

/// Filters the estimates of an image.
pub(crate) fn filter(mut image: Vec<Estimate>, guide: &Guide<'_>, strictness: &Strictness) -> Vec<Estimate> {
    for pass in 0..MAX_PASSES {
        let smooth = smooth_variance(&image, guide);
        image = (0..image.len())
            .into_par_iter()
            .map(|index| {
                if guide.passes[index] <= pass || !guide.features[index].surface {
                    image[index]
                } else {
                    average(&image, &smooth, guide, strictness, index, 1 << pass)
                }
            })
            .collect();
    }
    image
}

/// Computes one pixel of one pass.
fn average(
    image: &[Estimate],
    smooth: &[f32],
    guide: &Guide<'_>,
    strictness: &Strictness,
    index: usize,
    step: i32,
) -> Estimate {
    let here = &guide.features[index];
    let own = luminance(image[index].color);
    let noise = smooth[index].max(0.0).sqrt();
    // A small difference is always accepted: it is invisible, and the samples of a dark pixel may have missed all
    // light.
    let brightness = 1.0 / (strictness.brightness * noise + 1e-4 + 0.004 * own);
    let plane = 1.0 / (strictness.plane * guide.footprint * here.depth * step as f32 + 1e-4);
    let (mut color, mut variance, mut total) = (Vec3::ZERO, 0.0, 0.0);
    guide.window(index, step, |other, kernel| {
        let there = &guide.features[other];
        if !there.surface {
            return;
        }
        let mut weight = kernel;
        if other != index {
            // Both planes are tested, because at a step only one of them separates the two pixels.
            let between = there.position - here.position;
            let off = here.normal.dot(between).abs().max(there.normal.dot(between).abs());
            let difference = (luminance(image[other].color) - own).abs();
            let rough = (here.roughness - there.roughness).abs();
            let facing = here.normal.dot(there.normal).max(0.0);
            weight *= facing.powf(strictness.normal) * (-off * plane - difference * brightness - 6.0 * rough).exp();
        }
        color += weight * image[other].color;
        variance += weight * weight * image[other].variance;
        total += weight;
    });
    Estimate { color: color / total, variance: variance / (total * total) }
}

/// Smooths variances, which are noisy, by a 5×5 mean.
///
/// Neighbors of another orientation have a weight of 0.02.
fn smooth_variance(image: &[Estimate], guide: &Guide<'_>) -> Vec<f32> {
    (0..image.len())
        .into_par_iter()
        .map(|index| {
            let here = &guide.features[index];
            let (mut sum, mut total) = (0.0, 0.0);
            guide.window(index, 1, |other, kernel| {
                let kin = here.normal.dot(guide.features[other].normal) > 0.9;
                let weight = if kin { kernel } else { 0.02 * kernel };
                sum += weight * image[other].variance;
                total += weight;
            });
            sum / total
        })
        .collect()
}
