//! The exposure of linear images: one factor for a whole scene, so that its views stay comparable.
//!
//! A camera is exposed for most of what it sees and lets lamps clip. Here the luminance that a fifth of the pixels exceed
//! is to lie between a quarter of white and white. Where it does, images stay as they are; elsewhere they are multiplied
//! by the power of two nearest to one that brings it there. Only training views have a say.

use rayon::prelude::*;

use crate::error::Result;
use crate::view::View;

/// The most images that are looked at.
const IMAGES: usize = 16;
/// The most pixels of each.
const PIXELS: usize = 16_384;
/// The share of pixels that are darker than the measured luminance.
const SHARE: f64 = 0.8;
/// Where that luminance may lie; two stops, so that some power of two always fits.
const RANGE: (f64, f64) = (0.25, 1.0);

/// The factor for these views; `None` when none of their images is linear.
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

/// The factor for these luminances.
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

    /// Luminances of which a fifth exceed `bright`.
    fn room(bright: f32) -> Vec<f32> {
        (0..1000).map(|i| if i < 800 { bright * i as f32 / 800.0 } else { bright * (i - 799) as f32 }).collect()
    }

    #[test]
    fn what_is_well_exposed_stays() {
        for bright in [0.26, 0.5, 0.9] {
            assert_eq!(factor(room(bright)), 1.0, "{bright}");
        }
        assert_eq!(factor(vec![]), 1.0);
        assert_eq!(factor(vec![0.0; 9]), 1.0);
        assert_eq!(factor(vec![f32::NAN, f32::INFINITY]), 1.0);
    }

    #[test]
    fn stops_bring_any_room_into_the_range() {
        for stop in -20..=20 {
            let scale = 2.0_f32.powi(stop);
            let found = factor(room(0.5 / scale));
            assert!(found.log2().fract() == 0.0, "{stop}: {found}");
            assert!((0.25..=1.0).contains(&(0.5 / scale * found)), "{stop}: {found}");
            assert!(stop.abs() > 1 || found == 1.0, "{stop}: {found}");
        }
        // A lamp that covers little does not darken the room.
        let mut lamp = vec![0.5; 1000];
        lamp.extend(vec![1e6; 100]);
        assert_eq!(factor(lamp), 1.0);
    }
}
