//! Resolution of the environment map: no more texels than the images need.
//!
//! The resolution that the smoothest surfaces can resolve is known before the first step ([`super::sizes`]). The detail
//! of the map itself is known only after it has been learned. A step filters all texels regardless of the number of
//! pixels, so half the edge length costs a quarter. The contribution of the finer texels is measured: the PSNR loss of
//! images under a cube whose texels are means of the finer ones.

use crate::error::{Requirement, Result};
use crate::intrinsic::Intrinsic;
use sgs_config::IntrinsicSettings;
use sgs_passes::pipeline::EnvironmentMemory;
use sgs_passes::scene::Trainable;
use sgs_passes::shade::environment::{Environment, EnvironmentOptions, cube};
use sgs_run::{RunLight, Texels, Visibility};

/// Edge length of the smallest cube, in texels.
const LEAST: u32 = 16;

/// Returns the constant tables of an environment map with `size` texels per edge.
pub(in super::super) fn tables(s: &IntrinsicSettings, size: u32) -> Result<Environment> {
    let options = EnvironmentOptions::default();
    let smoothness = options.smoothness.filter(|_| s.losses.environment_smooth > 0.0);
    let made = Environment::new(size, &EnvironmentOptions { smoothness, ..options });
    made.map_err(|e| Requirement::Size { setting: "intrinsic.environment", reason: e.to_string() }.into())
}

/// Returns the texels of a cube that each texel of a smaller cube covers.
/// Each entry holds the index and the share of the smaller cube's solid angle.
fn parts(size: u32, smaller: u32) -> impl Iterator<Item = Vec<(usize, f64)>> {
    let k = size / smaller;
    (0..6 * smaller * smaller).map(move |texel| {
        let (x, row) = (texel % smaller, texel / smaller);
        let (face, y) = (row / smaller, row % smaller);
        let all = (0..k * k).map(|i| (k * x + i % k, k * y + i / k));
        let areas = all.map(|(x, y)| (((face * size + y) * size + x) as usize, cube::solid_angle(size, x, y)));
        let areas: Vec<_> = areas.collect();
        let whole: f64 = areas.iter().map(|a| a.1).sum();
        areas.into_iter().map(|(i, area)| (i, area / whole)).collect()
    })
}

/// Averages an environment map to a smaller cube. Sizes are powers of two.
fn coarser(texels: &Texels, size: u32) -> Texels {
    let mean = |part: Vec<(usize, f64)>| -> [f32; 3] {
        [0, 1, 2].map(|c| part.iter().map(|(i, share)| share * f64::from(texels.data[3 * i + c])).sum::<f64>() as f32)
    };
    Texels { size, data: parts(texels.size, size).flat_map(mean).collect() }
}

/// Returns Adam moments for the texels of a smaller cube.
/// The moments are pairs as in [`Trainable::download_moments`]. The gradient of a coarse texel is the sum of its parts'
/// gradients, and so is the first moment. The root of its second moment is the sum of the parts' roots, an upper bound.
fn coarser_moments(moments: &[f32], from: u32, size: u32) -> Vec<f32> {
    let of = |part: Vec<(usize, f64)>| -> [f32; 6] {
        let pair = |c: usize| {
            let each = || part.iter().map(|(i, _)| &moments[2 * (3 * i + c)..][..2]);
            let scale: f64 = each().map(|m| f64::from(m[1]).sqrt()).sum();
            [each().map(|m| f64::from(m[0])).sum::<f64>() as f32, (scale * scale) as f32]
        };
        let [r, g, b] = [pair(0), pair(1), pair(2)];
        [r[0], r[1], g[0], g[1], b[0], b[1]]
    };
    parts(from, size).flat_map(of).collect()
}

impl Intrinsic {
    /// Finds the smallest sufficient cube, with its PSNR loss.
    /// If no smaller cube suffices, returns the largest one tried and its loss. Returns none if no smaller cube exists.
    /// `loss`: PSNR loss in dB of images under the given environment map.
    pub(super) fn enough_texels(
        &self,
        gain: f64,
        mut loss: impl FnMut(&RunLight) -> Result<f64>,
    ) -> Result<Option<(u32, f64)>> {
        let Some(fine) = self.scaled_light()?.environment else { return Ok(None) };
        let mut tried = None;
        let smaller = std::iter::successors(Some(LEAST), |size| Some(2 * size)).take_while(|size| *size < fine.size);
        for size in smaller {
            let environment = Some(coarser(&fine, size));
            let contribution = loss(&RunLight { lights: None, environment, visibility: Visibility::None })?;
            tried = Some((size, contribution));
            if contribution <= gain {
                break;
            }
        }
        Ok(tried)
    }

    /// Changes the number of texels per edge of the environment map.
    /// A smaller map averages the current one and keeps its moments; a larger map starts from initial values. The
    /// gradient accumulated since the last update is discarded.
    pub(in super::super) fn set_texels(&mut self, size: u32) -> Result<()> {
        self.finish()?;
        let (Some((e, _)), Some(texels)) = (&self.environment, &self.parameters.environment) else { return Ok(()) };
        if size == e.size() {
            return Ok(());
        }
        let fine = Texels { size: e.size(), data: texels.download(&self.device)? };
        let moments = texels.download_moments(&self.device)?;
        let tables = tables(&self.required.intrinsic, size)?;
        self.forget_steps();
        (self.environment_updates, self.environment, self.parameters.environment) = (None, None, None);
        let fewer = size < fine.size;
        let start = if fewer { coarser(&fine, size).data } else { tables.start(self.required.seed as u32) };
        let texels = Trainable::new(&self.device, "environment", &start, true)?;
        if fewer {
            texels.upload_moments(&self.device, &coarser_moments(&moments, fine.size, size))?;
        }
        self.parameters.environment = Some(texels);
        self.environment = Some((EnvironmentMemory::new(&self.device, &tables)?, tables)).map(|(m, e)| (e, m));
        self.required.intrinsic.environment.resolution = size;
        self.keep_environment()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coarser_cube_preserves_total_light() {
        let fine = |size: u32| {
            let at = |t: u32| cube::texel_direction(size, t).map(|v| (1.0 + v) as f32);
            Texels { size, data: (0..6 * size * size).flat_map(at).collect() }
        };
        let light = |t: &Texels| -> [f64; 3] {
            let area = |i: u32| cube::solid_angle(t.size, i % t.size, i / t.size % t.size);
            let of = |c: u32| (0..6 * t.size * t.size).map(|i| area(i) * f64::from(t.data[(3 * i + c) as usize])).sum();
            [of(0), of(1), of(2)]
        };
        for (from, size) in [(32, 16), (64, 16), (128, 64)] {
            let (whole, less) = (fine(from), coarser(&fine(from), size));
            assert_eq!((less.size, less.data.len()), (size, 18 * (size * size) as usize));
            let (a, b) = (light(&whole), light(&less));
            assert!((0..3).all(|c| (a[c] - b[c]).abs() < 1e-6 * a[c]), "{a:?} {b:?}");
            // Every texel lies where it was: faces and rows are not mixed up.
            let off = less.data.iter().zip(&fine(size).data).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            assert!(off < 4.0 / (size * size) as f32 + 0.1 / size as f32, "{from} {size}: {off}");
        }
    }

    #[test]
    fn coarser_moments_sum_gradients_and_scales() {
        let (from, size) = (32, 16);
        let floats = 18 * (from * from) as usize;
        // All texels share their moments, which differ only by color channel.
        let moments: Vec<f32> = (0..floats).flat_map(|i| [(i % 3) as f32 - 1.0, (1 + i % 3) as f32]).collect();
        let less = coarser_moments(&moments, from, size);
        assert_eq!(less.len(), 2 * 18 * (size * size) as usize);
        for (i, m) in less.as_chunks::<2>().0.iter().enumerate() {
            let (first, second) = (4.0 * ((i % 3) as f32 - 1.0), 16.0 * (1 + i % 3) as f32);
            assert!((m[0] - first).abs() < 1e-5 && (m[1] - second).abs() < 1e-5 * second, "{i}: {m:?}");
        }
    }
}
