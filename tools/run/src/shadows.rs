//! Shadow rays traced through the Gaussians of a run.

use crate::convert::gaussian_data;
use crate::error::{Result, RunError};
use sgs_config::VisibilitySettings;
use sgs_engine::Device;
use sgs_passes::scene::Model;
use sgs_passes::shade::traced::{TracedMemory, TracedShape, TracedTree};
use sgs_scene::Splats;

/// Ends of shadow rays.
///
/// The unit is the median over the Gaussians of their largest standard deviation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rays {
    /// Distance of the origin above the surface.
    pub offset: f32,
    /// Distance of the end from the light.
    pub clearance: f32,
}

impl Rays {
    /// Returns the rays of the settings.
    pub fn of(settings: &VisibilitySettings) -> Rays {
        Rays { offset: settings.offset, clearance: settings.clearance }
    }
}

impl Default for Rays {
    fn default() -> Self {
        Rays::of(&VisibilitySettings::default())
    }
}

/// Builds a tree of the visible Gaussians and uploads it.
///
/// # Errors
/// If too many Gaussians lie in one place, or memory runs out.
pub fn traced(device: &Device, splats: &Splats, rays: Rays) -> Result<(TracedMemory, TracedShape)> {
    let model = Model { sh_degree: 0, normals: false, semantics: false, mip: false };
    let tree = TracedTree::new(&gaussian_data(splats, model)).map_err(|e| RunError::Refused(e.to_string()))?;
    let size = size(splats);
    let shape = tree.shape(rays.offset * size, rays.clearance * size);
    Ok((TracedMemory::new(device, &tree)?, shape))
}

/// Returns the median of the largest standard deviations.
///
/// Only Gaussians with an opacity logit above -2 count.
fn size(splats: &Splats) -> f32 {
    // A Gaussian with a NaN in any axis has no size.
    let or_nan = |m: f32, v: &f32| if m.is_nan() || v.is_nan() { f32::NAN } else { m.max(*v) };
    let largest = |i: usize| splats.log_scales[i].iter().fold(f32::NEG_INFINITY, or_nan);
    let shown = (0..splats.len()).filter(|&i| splats.opacity_logits[i] > -2.0);
    let mut all: Vec<f32> = shown.map(largest).filter(|s| s.is_finite()).collect();
    let middle = all.len() / 2;
    match all.is_empty() {
        true => 0.0,
        false => all.select_nth_unstable_by(middle, f32::total_cmp).1.clamp(-16.0, 8.0).exp(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ray_unit_is_the_median_size() {
        let mut splats = Splats {
            means: vec![[0.0; 3]; 5],
            log_scales: [1.0_f32, 2.0, 3.0, 500.0, f32::NAN].map(|s| [s.ln(), -9.0, -9.0]).to_vec(),
            rotations: vec![[1.0, 0.0, 0.0, 0.0]; 5],
            opacity_logits: vec![1.0; 5],
            ..Default::default()
        };
        assert!((size(&splats) - 3.0).abs() < 1e-5);
        splats.opacity_logits[3] = -5.0;
        assert!((size(&splats) - 2.0).abs() < 1e-5);
        assert_eq!(size(&Splats::default()), 0.0);
    }
}
