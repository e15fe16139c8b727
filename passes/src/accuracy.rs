//! Accuracy settings that trade precision for speed, and named levels.
//!
//! `engine-bench tradeoff` measures the speed gain of each setting (docs/how/accuracy.md). Quality is measured with
//! [`Accuracy::EXACT`], regardless of the accuracy of training.

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
    /// Bits of the operands of the visibility field's second layer: 32 or 16. 16 uses matrix units where the device has
    /// them (see `Matrices`). Visibility changes by at most 2e-4 with initial layers, by 2e-3 with layers four times as
    /// large. Gradients are those of 32 bits.
    pub visibility_operands: u32,
    /// Bits of a color channel of a splat between projection and blending: 32 or 16. 16 rounds to half precision: a
    /// relative error of 2^-11, or 2^-25 below 2^-14; at most 65504. Gradients are taken at the rounded colors.
    pub color_bits: u32,
    /// Bits of a table entry of the visibility field when training reads it: 32 or 16. 16 reads a copy in half
    /// precision. Visibility changes by less than 1e-3 with features of size one. Tables, moments and gradients keep 32
    /// bits.
    pub table_bits: u32,
    /// Bits of the blending weights of the intrinsic stage: 32 or 16. 16 stores multiples of 1/65535, in 12 bytes per
    /// entry instead of 16. A pixel's material changes by at most (n + 1) * 7.6e-6 for n contributing Gaussians.
    pub weight_bits: u32,
}

impl Accuracy {
    /// Definition of 3D Gaussian splatting. Images agree with double precision within 5e-6, absolute or relative to the
    /// color, whichever is larger. This holds at pixels where no splat is at a threshold.
    pub const EXACT: Accuracy = Accuracy {
        depth_bits: 31,
        alpha_min: 1.0 / 255.0,
        transmittance_min: 1e-4,
        keep_last: false,
        visibility_operands: 32,
        color_bits: 32,
        table_bits: 32,
        weight_bits: 32,
    };
}

impl Accuracy {
    /// Slightly reduced accuracy. Pixels stop at a transmittance of 1e-3 and blend their last splat, so the omitted
    /// light is at most 1e-3 of the largest color. Depth keys have 24 bits.
    pub const BALANCED: Accuracy =
        Accuracy { depth_bits: 24, transmittance_min: 1e-3, keep_last: true, ..Accuracy::EXACT };

    /// Reduced accuracy for interactive viewing and drafts. Footprints end at an opacity of 1/64, pixels stop at a
    /// transmittance of 1e-2. Depth keys, operands and tables of the visibility field, colors and blending weights have
    /// 16 bits.
    pub const FAST: Accuracy = Accuracy {
        depth_bits: 16,
        alpha_min: 1.0 / 64.0,
        transmittance_min: 1e-2,
        keep_last: true,
        visibility_operands: 16,
        color_bits: 16,
        table_bits: 16,
        weight_bits: 16,
    };
}

impl Default for Accuracy {
    fn default() -> Self {
        Accuracy::EXACT
    }
}
