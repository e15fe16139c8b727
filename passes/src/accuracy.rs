//! Accuracy settings that trade precision for speed, and named levels.
//!
//! `engine-bench tradeoff` measures the speed gain of each setting (docs/how/accuracy.md). Quality is measured with
//! [`Accuracy::EXACT`], regardless of the accuracy of training.

use crate::scene::Storage;
use serde::{Deserialize, Serialize};

/// Accuracy traded for speed (docs/how/accuracy.md).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Accuracy {
    /// Bits of the depth sort keys: 31, 24 or 16. 8 bits less save one pass of the sort. 24 and 16 bits do not sort
    /// splats whose depths agree to 1 part in 2^19 and 2^11 of a power of two.
    pub depth_bits: u32,
    /// Smallest opacity of a splat at a pixel; it bounds footprints. 1/255 in 3D Gaussian splatting. Each omitted splat
    /// changes a color by at most this times the largest color.
    pub alpha_min: f32,
    /// Transmittance at which a pixel stops; 1e-4 in 3D Gaussian splatting.
    pub transmittance_min: f32,
    /// Blends the splat at which a pixel stops. This bounds the omitted light by `transmittance_min` times the largest
    /// color; otherwise, as in 3D Gaussian splatting, by 100 times that.
    pub keep_last: bool,
    /// Bits of the visibility field in training: 32 or 16. 16 reads a copy of its tables in half precision, and runs its
    /// second layer on matrix units where the device has them (see `Matrices`). Visibility changes by less than 1e-3 with
    /// features of size one, and on matrix units by 2e-4 with initial layers, by 2e-3 with layers four times as large.
    /// Tables, moments and sums of gradients keep 32 bits. On matrix units, gradients round to 3 * 2^-11 of their terms.
    pub visibility_bits: u32,
    /// Bits of a color channel of a splat between projection and blending: 32 or 16. 16 rounds to half precision: a
    /// relative error of 2^-11, or 2^-25 below 2^-14; at most 65504. Gradients are taken at the rounded colors.
    pub color_bits: u32,
    /// Bits of the blending weights of the intrinsic stage: 32 or 16. 16 stores multiples of 1/65535, in 12 bytes per
    /// entry instead of 16. A pixel's material changes by at most (n + 1) * 7.6e-6 for n contributing Gaussians.
    pub weight_bits: u32,
    /// Bits of harmonics and of Adam's moments in the geometry stage: 32 or 16. 16 takes 400 bytes for a Gaussian with all
    /// bands, statistics included, instead of 736. Updates round at random, right in the mean: a harmonic by at most
    /// 2^-10 of its size, a first moment 2^-7, a second moment 2^-8. Other parameters and semantic features keep 32 bits.
    pub state_bits: u32,
}

impl Accuracy {
    /// Definition of 3D Gaussian splatting. Images agree with double precision within 5e-6, absolute or relative to the
    /// color, whichever is larger. This holds at pixels where no splat is at a threshold.
    pub const EXACT: Accuracy = Accuracy {
        depth_bits: 31,
        alpha_min: 1.0 / 255.0,
        transmittance_min: 1e-4,
        keep_last: false,
        visibility_bits: 32,
        color_bits: 32,
        weight_bits: 32,
        state_bits: 32,
    };
}

impl Accuracy {
    /// Exact images and gradients, with less memory: 16 bits for harmonics and moments in the geometry stage.
    pub const COMPACT: Accuracy = Accuracy { state_bits: 16, ..Accuracy::EXACT };

    /// Slightly reduced accuracy. Pixels stop at a transmittance of 1e-3 and blend their last splat, so the omitted
    /// light is at most 1e-3 of the largest color. Depth keys have 24 bits.
    pub const BALANCED: Accuracy =
        Accuracy { depth_bits: 24, transmittance_min: 1e-3, keep_last: true, ..Accuracy::EXACT };

    /// Reduced accuracy for interactive viewing and drafts. Footprints end at an opacity of 1/64, pixels stop at a
    /// transmittance of 1e-2. Depth keys, the visibility field, colors and blending weights have 16 bits.
    pub const FAST: Accuracy = Accuracy {
        depth_bits: 16,
        alpha_min: 1.0 / 64.0,
        transmittance_min: 1e-2,
        keep_last: true,
        visibility_bits: 16,
        color_bits: 16,
        weight_bits: 16,
        ..Accuracy::EXACT
    };
}

impl Accuracy {
    /// Returns the storage of Gaussians in training.
    pub fn storage(&self) -> Storage {
        if self.state_bits == 16 { Storage::Compact } else { Storage::Exact }
    }
}

impl Default for Accuracy {
    fn default() -> Self {
        Accuracy::EXACT
    }
}
