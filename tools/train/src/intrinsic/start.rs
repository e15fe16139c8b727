//! Initial materials from the priors of the pixels that show a Gaussian.
//!
//! The initial value is the mean over all training views, weighted by the Gaussian's blending weight at each pixel.
//! From gray, the first hundreds of steps would only find that mean, and the lights would absorb the remaining gray.

use super::data::MaterialPriors;
use super::surfaces::Surfaces;
use crate::data::TrainingData;
use crate::error::Result;
use rayon::prelude::*;
use sgs_engine::Device;
use sgs_passes::pipeline::WeightColumns;
use sgs_passes::scene::Gaussians;
use sgs_run::materials::{raw, raw_metallic, raw_roughness, sigmoid};
use sgs_scene::{SH_C0, Splats, srgb_to_linear};

/// Least sum of weights, in pixels, with which the mean of the priors is used.
const LEAST: f64 = 1e-3;

/// Least initial albedo where lights are trained from nothing.
///
/// The light that a black surface reflects gives no gradient to lights. Where the photograph shows such a surface
/// bright, for example a window, the lights must find this before the albedo closes.
const DARKEST: f32 = 0.1;
/// Least initial albedo under fitted lights: darker than nearly all materials.
const DARKEST_IN_ROOM: f32 = 0.02;

/// Mean luminance of albedo that is guessed from colors.
const GUESSED_MEAN: f64 = 0.6;
/// Power of a color in guessed albedo. Light causes the rest of the contrast.
const GUESSED_CONTRAST: f64 = 0.4;
/// Range of guessed albedo.
const GUESSED_RANGE: [f32; 2] = [0.03, 0.9];

/// Materials before activation, where the priors are known.
/// Elsewhere materials are gray and half rough.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Start {
    /// Albedo: `[Gaussians * 3]`.
    pub albedo: Option<Vec<f32>>,
    /// Roughness: `[Gaussians]`.
    pub roughness: Option<Vec<f32>>,
    /// Metallic: `[Gaussians]`.
    pub metallic: Option<Vec<f32>>,
}

/// Computes the initial materials. Waits for the device, view by view.
///
/// `trains_lights`: whether lights are trained from nothing.
pub(super) fn start(
    device: &Device,
    gaussians: &Gaussians,
    surfaces: &mut Surfaces,
    data: &TrainingData,
    [albedo, roughness, metallic]: [Option<&MaterialPriors>; 3],
    trains_lights: bool,
) -> Result<Start> {
    let n = gaussians.capacity as usize;
    let mut sums = [albedo, roughness, metallic].map(|p| p.map(|p| (p, vec![[0.0; 4]; n])));
    if sums.iter().all(Option::is_none) {
        return Ok(Start::default());
    }
    for (i, (camera, _)) in data.views.iter().enumerate() {
        let columns = surfaces.of_view(gaussians, camera, i)?.weights(device)?;
        for (priors, sums) in sums.iter_mut().flatten() {
            gather(&columns, &priors.packed[i], sums);
        }
    }
    let [albedo, roughness, metallic] = sums.map(|s| s.map(|(_, sums)| sums.into_iter().map(mean)));
    let first = |raw: fn(f32) -> f32, otherwise: f32| move |m: Option<[f32; 3]>| m.map_or(otherwise, |m| raw(m[0]));
    let darkest = if trains_lights { DARKEST } else { DARKEST_IN_ROOM };
    // Albedo priors are encoded in sRGB, and so is their mean.
    let encoded = |m: Option<[f32; 3]>| m.map_or([0.0; 3], |m| m.map(|v| raw(srgb_to_linear(v).max(darkest))));
    Ok(Start {
        albedo: albedo.map(|a| a.flat_map(encoded).collect()),
        roughness: roughness.map(|r| r.map(first(raw_roughness, 0.0)).collect()),
        metallic: metallic.map(|m| m.map(first(raw_metallic, -2.0)).collect()),
    })
}

/// Adds a view's priors to the sums of values and weights.
/// `packed`: priors, packed like photographs.
fn gather(columns: &WeightColumns, packed: &[u32], sums: &mut [[f64; 4]]) {
    sums.par_iter_mut().enumerate().for_each(|(gaussian, sum)| {
        for (pixel, weight) in columns.of(gaussian) {
            let word = packed.get(pixel).copied().unwrap_or(0);
            if word >> 24 != 0 && weight.is_finite() {
                let weight = f64::from(weight);
                (0..3).for_each(|c| sum[c] += weight * f64::from(word >> (8 * c) & 0xff) / 255.0);
                sum[3] += weight;
            }
        }
    });
}

fn mean(sum: [f64; 4]) -> Option<[f32; 3]> {
    (sum[3] >= LEAST).then(|| [0, 1, 2].map(|c| (sum[c] / sum[3]) as f32))
}

/// Guesses albedo from the colors of band 0, for scenes without albedo priors.
///
/// It has a part of the colors' contrast around their geometric mean, which becomes gray: the color of that mean is
/// left to light. Means are weighted by opacity. From gray, texture would have to be explained by light.
///
/// Returns albedo before activation: `[Gaussians]`.
pub(super) fn albedo_of_colors(splats: &Splats) -> Vec<[f32; 3]> {
    // Black has no logarithm.
    let log = |dc: f32| f64::from(srgb_to_linear((0.5 + SH_C0 * dc).clamp(0.0, 1.0)).max(1e-3)).ln();
    let logs: Vec<[f64; 3]> = splats.sh[0].as_chunks::<3>().0.iter().map(|c| c.map(log)).collect();
    let opacity = |i: usize| f64::from(sigmoid(splats.opacity_logits[i]));
    let total = (0..logs.len()).map(opacity).sum::<f64>().max(f64::MIN_POSITIVE);
    let mean = |of: &dyn Fn(usize) -> f64| (0..logs.len()).map(|i| opacity(i) * of(i)).sum::<f64>() / total;
    let center = [0, 1, 2].map(|c| mean(&|i| logs[i][c]));
    let contrast = |i: usize| [0, 1, 2].map(|c| (GUESSED_CONTRAST * (logs[i][c] - center[c])).exp());
    let luminance = |i: usize| contrast(i).iter().zip([0.2126, 0.7152, 0.0722]).map(|(v, w)| v * w).sum();
    let scale = GUESSED_MEAN / mean(&luminance).max(f64::MIN_POSITIVE);
    let [least, most] = GUESSED_RANGE;
    let guess = |i: usize| contrast(i).map(|v| raw(((scale * v) as f32).clamp(least, most)));
    (0..logs.len()).map(guess).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use sgs_run::materials::value;
    use sgs_scene::linear_to_srgb;

    #[test]
    fn guessed_albedo_has_part_of_the_contrast_around_gray() {
        let dc = |linear: f32| (linear_to_srgb(linear) - 0.5) / SH_C0;
        let mut splats = Splats::default();
        // The last Gaussian is transparent.
        splats.sh[0] = [0.2, 0.1, 0.05, 0.1, 0.05, 0.1, 1.0, 0.0, 1.0].map(dc).to_vec();
        splats.opacity_logits = vec![40.0, 40.0, -200.0];
        let albedo: Vec<f32> = albedo_of_colors(&splats).as_flattened().iter().map(|v| value(*v)).collect();
        let luminance = |i: usize| 0.2126 * albedo[3 * i] + 0.7152 * albedo[3 * i + 1] + 0.0722 * albedo[3 * i + 2];
        assert!((0.5 * (luminance(0) + luminance(1)) - 0.6).abs() < 1e-3, "{albedo:?}");
        // Each channel's geometric mean is the same gray.
        let gray = [0, 1, 2].map(|c| (albedo[c] * albedo[3 + c]).sqrt());
        assert!((gray[0] / gray[1] - 1.0).abs() < 1e-3 && (gray[2] / gray[1] - 1.0).abs() < 1e-3, "{albedo:?}");
        for (c, ratio) in [2.0, 2.0, 0.5_f32].into_iter().enumerate() {
            assert!((albedo[c] / albedo[3 + c] - ratio.powf(0.4)).abs() < 1e-3, "{albedo:?}");
        }
        // White is cut; black counts as 0.001.
        let black = gray[1] * (1e-3 / 0.005_f32.sqrt()).powf(0.4);
        assert!((albedo[6] - 0.9).abs() < 1e-3 && (albedo[7] - black).abs() < 1e-3, "{albedo:?}");
        assert!(albedo_of_colors(&Splats::default()).is_empty());
    }

    #[test]
    fn initial_materials_are_weighted_means_of_valid_priors() {
        let columns =
            WeightColumns { starts: vec![0, 3, 3, 4], pixels: vec![0, 1, 2, 2], weights: vec![0.25, 0.75, 5.0, 1.0] };
        let packed = [0xff00_00ff, 0xff00_ff00, 0x0012_3456];
        let mut sums = vec![[0.0; 4]; 3];
        gather(&columns, &packed, &mut sums);
        let means: Vec<_> = sums.into_iter().map(mean).collect();
        assert_eq!(means, [Some([0.25, 0.75, 0.0]), None, None]);
    }
}
