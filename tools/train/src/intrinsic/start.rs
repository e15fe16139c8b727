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
use sgs_run::materials::{raw, raw_metallic, raw_roughness};
use sgs_scene::srgb_to_linear;

/// Least sum of weights, in pixels, with which the mean of the priors is used.
const LEAST: f64 = 1e-3;

/// Least initial albedo where lights are trained from nothing.
///
/// The light that a black surface reflects gives no gradient to lights. Where the photograph shows such a surface
/// bright, for example a window, the lights must find this before the albedo closes.
const DARKEST: f32 = 0.1;
/// Least initial albedo under fitted lights: darker than nearly all materials.
const DARKEST_IN_ROOM: f32 = 0.02;

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

#[cfg(test)]
mod tests {
    use super::*;

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
