//! Exposure of linear images: one factor per scene keeps its views comparable.
//!
//! Like a camera, the exposure suits most of the scene and lets bright light sources clip. The luminance exceeded by a
//! fifth of the pixels should lie between a quarter of white and white. If it does, images stay unchanged. Otherwise
//! they are multiplied by the power of two nearest to 1 that brings it into this range. Only training views are
//! measured.

use rayon::prelude::*;

use crate::error::Result;
use crate::view::View;

/// Largest number of measured images.
const IMAGES: usize = 16;
/// Largest number of measured pixels per image.
const PIXELS: usize = 16_384;
/// Fraction of pixels that are darker than the measured luminance.
const SHARE: f64 = 0.8;
/// Target range of that luminance; two stops wide, so a power of two always fits.
const RANGE: (f64, f64) = (0.25, 1.0);

/// Returns the exposure factor for these views. Returns `None` if none of their images is linear.
pub(crate) fn choose(views: &[&View]) -> Result<Option<f32>> {
    let linear: Vec<&View> = views.iter().copied().filter(|view| view.is_linear()).collect();
    if linear.is_empty() {
        return Ok(None);
    }
    let count = linear.len().min(IMAGES);
    let chosen: Vec<&View> = (0..count).map(|i| linear[i * linear.len() / count]).collect();
    let parts: Vec<Vec<f32>> = chosen.par_iter().map(|view| view.luminances(PIXELS)).collect::<Result<_>>()?;
    Ok(Some(factor(parts.concat())))
}

/// Returns the exposure factor for these luminances.
fn factor(mut luminances: Vec<f32>) -> f32 {
    luminances.retain(|v| v.is_finite());
    if luminances.is_empty() {
        return 1.0;
    }
    let at = ((luminances.len() as f64 * SHARE) as usize).min(luminances.len() - 1);
    let bright = f64::from(*luminances.select_nth_unstable_by(at, f32::total_cmp).1);
    if bright <= 0.0 {
        return 1.0;
    }
    let stops = if bright > RANGE.1 {
        -(bright / RANGE.1).log2().ceil()
    } else if bright < RANGE.0 {
        (RANGE.0 / bright).log2().ceil()
    } else {
        0.0
    };
    stops.clamp(-40.0, 40.0).exp2() as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns luminances of which a fifth exceed `bright`.
    fn room(bright: f32) -> Vec<f32> {
        (0..1000).map(|i| if i < 800 { bright * i as f32 / 800.0 } else { bright * (i - 799) as f32 }).collect()
    }

    #[test]
    fn well_exposed_images_are_unchanged() {
        for bright in [0.26, 0.5, 0.9] {
            assert_eq!(factor(room(bright)), 1.0, "{bright}");
        }
        assert_eq!(factor(vec![]), 1.0);
        assert_eq!(factor(vec![0.0; 9]), 1.0);
        assert_eq!(factor(vec![f32::NAN, f32::INFINITY]), 1.0);
    }

    #[test]
    fn exposure_brings_any_scene_into_the_range_in_whole_stops() {
        for stop in -20..=20 {
            let scale = 2.0_f32.powi(stop);
            let found = factor(room(0.5 / scale));
            assert!(found.log2().fract() == 0.0, "{stop}: {found}");
            assert!((0.25..=1.0).contains(&(0.5 / scale * found)), "{stop}: {found}");
            assert!(stop.abs() > 1 || found == 1.0, "{stop}: {found}");
        }
        // A light source that covers few pixels does not darken the scene.
        let mut light = vec![0.5; 1000];
        light.extend(vec![1e6; 100]);
        assert_eq!(factor(light), 1.0);
    }
}
