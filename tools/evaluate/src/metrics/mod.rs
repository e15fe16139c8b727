//! Image metrics: pure functions of images in memory.
//!
//! Images are compared as they are: the caller encodes, masks and scales them as the metric requires. A mask has one
//! channel and includes a pixel whose value exceeds one half. Every function refuses images of different sizes. It also
//! refuses a mask without pixels instead of returning a meaningless number.

mod depth;
mod flip;
mod gain;
mod label;
mod lpips;
mod normal;
mod psnr;
mod ssim;

pub use depth::depth_rel;
pub use flip::flip;
pub use gain::{GainFit, scaled};
pub use label::label_accuracy;
pub use lpips::{Lpips, LpipsAbout, LpipsNet, LpipsRange};
pub use normal::{NormalError, normal_error, normal_mae_deg};
pub use psnr::{mse, psnr, psnr_scaled};
pub use ssim::ssim;

use sgs_scene::Image;

/// Reason why a metric has no value.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum MetricError {
    /// The images differ in size.
    #[error("{measure} compares {a:?} with {b:?} (width, height, channels); the sizes must agree")]
    Size {
        /// Name of the metric.
        measure: &'static str,
        /// Width, height and channels of the first image.
        a: (u32, u32, u32),
        /// Width, height and channels of the second image or of the mask.
        b: (u32, u32, u32),
    },
    /// The images are too small for the metric.
    #[error("{measure} needs images of at least {least} × {least} pixels, but these have {} × {}", size.0, size.1)]
    Small {
        /// Name of the metric.
        measure: &'static str,
        /// Width and height.
        size: (u32, u32),
        /// Least width and height.
        least: u32,
    },
    /// A file of weights cannot be used.
    #[error("\"{path}\": {reason}.", path = path.display())]
    File {
        /// Path of the file.
        path: std::path::PathBuf,
        /// Reason.
        reason: String,
    },
    /// No pixel counts.
    #[error("{measure} has no pixel to measure: the images are empty, or the mask or the valid values exclude all")]
    Empty {
        /// Name of the metric.
        measure: &'static str,
    },
}

fn size(image: &Image) -> (u32, u32, u32) {
    (image.width, image.height, image.channels)
}

/// Refuses images whose sizes differ, or whose values do not fit their size.
fn check(measure: &'static str, a: &Image, b: &Image, mask: Option<&Image>) -> Result<(), MetricError> {
    let whole = |image: &Image| image.check().is_ok();
    if size(a) != size(b) {
        return Err(MetricError::Size { measure, a: size(a), b: size(b) });
    }
    if !whole(a) || !whole(b) {
        return Err(MetricError::Empty { measure });
    }
    match mask {
        Some(mask) if (mask.width, mask.height, mask.channels) != (a.width, a.height, 1) || !whole(mask) => {
            Err(MetricError::Size { measure, a: size(a), b: size(mask) })
        }
        _ => Ok(()),
    }
}

/// Returns the pixels that count, in pairs. Images of other sizes than [`check`] accepts have missing pairs.
pub(crate) fn pairs<'a>(
    a: &'a Image,
    b: &'a Image,
    mask: Option<&'a Image>,
) -> impl Iterator<Item = (&'a [f32], &'a [f32])> {
    let channels = a.channels.max(1) as usize;
    let counts = move |i: usize| mask.is_none_or(|mask| mask.data.get(i).is_some_and(|&m| m > 0.5));
    let pairs = a.data.chunks_exact(channels).zip(b.data.chunks_exact(channels));
    pairs.enumerate().filter(move |(i, _)| counts(*i)).map(|(_, pair)| pair)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn different_sizes_are_refused() {
        let a = Image::new(4, 2, 3);
        let mask = Image::new(4, 2, 1);
        assert_eq!(check("psnr", &a, &a, Some(&mask)), Ok(()));
        let error = check("psnr", &a, &Image::new(4, 3, 3), None).unwrap_err().to_string();
        assert_eq!(error, "psnr compares (4, 2, 3) with (4, 3, 3) (width, height, channels); the sizes must agree");
        assert!(check("psnr", &a, &a, Some(&a)).is_err());
        assert!(check("psnr", &a, &a, Some(&Image::new(2, 4, 1))).is_err());
        let empty = Image::new(0, 0, 3);
        assert_eq!(check("psnr", &empty, &empty, None), Err(MetricError::Empty { measure: "psnr" }));
        let broken = Image { width: 4, height: 2, channels: 3, data: vec![] };
        assert!(check("psnr", &broken, &broken, None).is_err());
        let broken = Image { width: 4, height: 2, channels: 1, data: vec![] };
        assert!(check("psnr", &a, &a, Some(&broken)).is_err());
    }
}
