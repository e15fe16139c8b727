//! PSNR contributions of the model's components at training views.
//!
//! The contribution of a component is the PSNR in dB that the shaded image loses without it, with everything else
//! unchanged. This is an upper bound, since the other components could compensate. Materials are not judged this way:
//! images say little about materials. Light is additive, so each light needs only one image. Lights are removed from
//! the faintest on, while all removed lights together contribute at most the threshold.

use super::Watched;
use crate::error::Result;
use crate::intrinsic::Intrinsic;
use rayon::prelude::*;
use sgs_run::{RunLight, Shading, shaded_scene};
use sgs_scene::{Splats, linear_to_srgb, srgb_to_linear};

/// Linear light of the selected pixels of all views, stored consecutively.
pub(super) type Light = Vec<[f32; 3]>;

/// Components of shaded images.
pub(super) struct ShadedViews {
    /// Background behind the surfaces.
    pub behind: Light,
    /// Light of all lights together.
    pub direct: Light,
    /// Light of the environment map.
    pub ambient: Light,
}

/// Returns the sum of squared errors of light against the photographs.
/// Both are compared display-referred.
pub(super) fn error(photos: &[[f32; 3]], light: impl Fn(usize) -> [f32; 3] + Sync) -> f64 {
    let one = |(p, photo): (usize, &[f32; 3])| -> f64 {
        let light = light(p);
        (0..3).map(|c| f64::from(linear_to_srgb(light[c].clamp(0.0, 1.0)) - photo[c]).powi(2)).sum()
    };
    // Fixed chunks make the order of summation independent of the number of threads.
    let parts: Vec<f64> = photos
        .par_chunks(1024)
        .enumerate()
        .map(|(i, chunk)| chunk.iter().enumerate().map(|(k, photo)| one((1024 * i + k, photo))).sum())
        .collect();
    parts.iter().sum()
}

/// Returns the PSNR loss in dB for a growth of the squared error.
/// The error grows from `with` to `without`.
pub(super) fn loss(with: f64, without: f64) -> f64 {
    10.0 * (without.max(1e-12) / with.max(1e-12)).log10()
}

pub(super) fn add(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [0, 1, 2].map(|c| a[c] + b[c])
}

/// Selects the lights that can be removed, from the faintest on.
/// Stops before the image loses more than `gain` dB. Returns each removed light with the PSNR loss of the removed
/// lights up to it. Also returns this loss for the next light, if one remains.
///
/// `parts`: light of each, empty for a light that is off; `rest`: all other light.
pub(super) fn needless(
    photos: &[[f32; 3]],
    rest: &Light,
    parts: &[Light],
    gain: f64,
) -> (Vec<(usize, f64)>, Option<f64>) {
    let energy = |part: &Light| part.iter().flatten().map(|v| f64::from(v.max(0.0))).sum::<f64>();
    let mut order: Vec<(usize, f64)> =
        parts.iter().enumerate().filter(|(_, part)| !part.is_empty()).map(|(i, part)| (i, energy(part))).collect();
    order.sort_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)));
    // Remaining light: sums from the brightest light on, so that nothing is subtracted.
    let mut left = vec![rest.clone()];
    for (i, _) in order.iter().rev() {
        let below = &left[left.len() - 1];
        left.push(below.iter().zip(&parts[*i]).map(|(a, b)| add(*a, *b)).collect());
    }
    let with = error(photos, |p| left[left.len() - 1][p]);
    let mut gone = Vec::new();
    for (k, (i, _)) in order.iter().enumerate() {
        let light = &left[order.len() - 1 - k];
        let lost = loss(with, error(photos, |p| light[p]));
        if lost > gain {
            return (gone, Some(lost));
        }
        gone.push((*i, lost));
    }
    (gone, None)
}

impl Intrinsic {
    pub(super) fn shading(&self, splats: &Splats, light: &RunLight) -> Result<Shading> {
        let (lights, environment) = (light.lights.as_ref(), light.environment.as_ref());
        let scene = shaded_scene(&self.device, splats, lights, environment, &light.visibility)?;
        Ok(Shading::new(&self.device, scene)?.without_visibility())
    }

    /// Returns the light components of the selected pixels.
    pub(super) fn images(&self, shading: &mut Shading, views: &[Watched]) -> Result<ShadedViews> {
        let behind = self.required.geometry.background.map(srgb_to_linear);
        let mut all = ShadedViews { behind: Vec::new(), direct: Vec::new(), ambient: Vec::new() };
        for view in views {
            let shaded = shading.shade_from(&view.camera)?;
            let covered = shaded.covered();
            for (p, _) in &view.pixels {
                let c = covered[*p];
                let of = |light: &[f32]| [0, 1, 2].map(|k| c * light.get(3 * p + k).copied().unwrap_or(0.0));
                all.behind.push(behind.map(|b| (1.0 - c) * b));
                all.direct.push(of(&shaded.0.direct));
                all.ambient.push(of(&shaded.0.ambient));
            }
        }
        Ok(all)
    }

    /// Returns the light of each light source alone; empty for a light that is off.
    /// Each view's visible geometry is computed once for all lights.
    pub(super) fn each(&self, shading: &mut Shading, views: &[Watched], gains: &[f32]) -> Result<Vec<Light>> {
        let mut all = vec![Light::new(); gains.len()];
        for view in views {
            for (i, light) in all.iter_mut().enumerate().filter(|(i, _)| gains[*i] != 0.0) {
                let mut alone = vec![0.0; gains.len()];
                alone[i] = gains[i];
                shading.set_gains(&self.device, &alone)?;
                let direct = shading.direct_from(&view.camera)?;
                light.extend(view.pixels.iter().map(|(p, _)| [0, 1, 2].map(|k| direct[3 * p + k])));
            }
        }
        Ok(all)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plain(value: f32, pixels: usize) -> Light {
        vec![[value; 3]; pixels]
    }

    #[test]
    fn psnr_loss_is_in_decibels() {
        assert!((loss(1.0, 10.0) - 10.0).abs() < 1e-12 && loss(2.0, 2.0) == 0.0 && loss(2.0, 1.0) < 0.0);
        assert!(loss(0.0, 0.0) == 0.0 && loss(0.0, 1.0).is_finite());
        let photos = plain(0.5, 3000);
        let light = srgb_to_linear(0.75);
        let expected = 9000.0 * 0.0625;
        assert!((error(&photos, |_| [light; 3]) - expected).abs() < 1e-3 * expected);
        // Values above white are clamped to white.
        assert_eq!(error(&photos, |_| [7.0; 3]), error(&photos, |_| [1.0; 3]));
    }

    #[test]
    fn faintest_lights_are_removed_within_the_allowed_psnr_loss() {
        let pixels = 2000;
        let photos: Vec<[f32; 3]> =
            (0..pixels).map(|p| [linear_to_srgb(0.1 + 0.4 * (p % 7) as f32 / 7.0); 3]).collect();
        let lit = |share: f32| (0..pixels).map(|p| [share * (0.1 + 0.4 * (p % 7) as f32 / 7.0); 3]).collect::<Light>();
        // A hundredth more than the photographs: an error of zero has no PSNR.
        let rest = plain(0.01, pixels);
        let parts = [lit(0.5), lit(1e-4), Vec::new(), lit(0.4999), lit(2e-4), plain(0.0, pixels)];
        let of = |rest: &Light, parts: &[Light], gain: f64| -> (Vec<usize>, f64) {
            let (gone, next) = needless(&photos, rest, parts, gain);
            assert!(
                next.is_none_or(|next| next > gain)
                    && next.is_none() == (gone.len() == parts.iter().filter(|p| !p.is_empty()).count())
            );
            (gone.iter().map(|g| g.0).collect(), gone.last().map_or(0.0, |g| g.1))
        };
        let (gone, contribution) = of(&rest, &parts, 0.05);
        assert_eq!(gone, [5, 1, 4]);
        // Here less light is closer to the photographs.
        assert!(contribution < 0.0, "{contribution}");
        let (dark, some) = (plain(0.0, pixels), [lit(0.9), lit(0.05), lit(0.04)]);
        let (gone, contribution) = of(&dark, &some, 15.0);
        assert!(gone == [2] && contribution > 13.0 && contribution <= 15.0, "{gone:?} {contribution}");
        assert_eq!(of(&dark, &some, 0.5).0, [0; 0]);
        // All lights may be removed if none contributes.
        assert_eq!(of(&lit(1.0), &[plain(0.0, pixels), plain(0.0, pixels)], 0.02).0, [0, 1]);
    }
}
