//! Pixels that measures leave out because the photograph is invalid there.

use crate::error::Result;
use sgs_scene::{GroundTruth, GroundTruthKind, Image};

/// Blackens the pixels of an image that a mask excludes.
///
/// SSIM, FLIP and LPIPS compare neighborhoods, so values of excluded pixels would count beside the others.
pub(crate) fn blackened(mut image: Image, mask: Option<&Image>) -> Image {
    if let Some(mask) = mask {
        let pixels = image.data.chunks_exact_mut(image.channels.max(1) as usize);
        pixels.zip(&mask.data).filter(|(_, counts)| **counts <= 0.5).for_each(|(pixel, _)| pixel.fill(0.0));
    }
    image
}

/// Returns the mask of a view's ground truth. The mask of the photograph (`mask`) excludes pixels, too.
///
/// # Errors
/// If the mask of the ground truth is damaged.
pub(crate) fn truth_mask(truth: &GroundTruth<'_>, view: usize, mask: Option<&Image>) -> Result<Option<Image>> {
    let own = truth.load(GroundTruthKind::Mask, view)?;
    Ok(own.map(|own| blackened(own, mask)).or_else(|| mask.cloned()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn excluded_pixels_become_black() {
        let image = |channels, data: &[f32]| Image { width: 3, height: 1, channels, data: data.to_vec() };
        let color = image(2, &[1.0, 2.0, f32::NAN, f32::INFINITY, 5.0, f32::NAN]);
        let black = blackened(color.clone(), Some(&image(1, &[1.0, 0.5, 0.6])));
        assert_eq!(black.data[..5], [1.0, 2.0, 0.0, 0.0, 5.0]);
        assert!(black.data[5].is_nan() && blackened(color, None).data[2].is_nan());
    }
}
