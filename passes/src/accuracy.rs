//! What may be traded for speed, by name: the choices of a whole plan.
//!
//! `engine-bench tradeoff` measures what each is worth (docs/how/accuracy.md). Measures of quality are taken with
//! [`Accuracy::EXACT`] whatever a scene was trained with.

use serde::{Deserialize, Serialize};

/// Accuracy traded for speed (docs/how/accuracy.md).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Accuracy {
    /// Bits of the depth sort keys: 31, 24 or 16. 8 bits less save one pass of the sort. 24 and 16 bits do not sort splats
    /// whose depths agree to 1 part in 2^19 and 2^11 of a power of two.
    pub depth_bits: u32,
    /// Smallest opacity of a splat at a pixel; it bounds footprints. 1/255 in 3D Gaussian splatting. Each omitted splat
    /// changes a color by at most this times the largest color.
    pub alpha_min: f32,
    /// Transmittance at which a pixel stops; 1e-4 in 3D Gaussian splatting.
    pub transmittance_min: f32,
    /// Blends the splat at which a pixel stops. This bounds the omitted light by `transmittance_min` times the largest
    /// color; otherwise, as in 3D Gaussian splatting, by 100 times that.
    pub keep_last: bool,
    /// Uses a cubic for the exponential of opacities, with a relative error of 1.3e-4. No accuracy level uses it, because no
    /// measured step became faster.
    pub fast_exp: bool,
    /// Bits of the operands of the visibility field's second layer: 32 or 16. 16 uses matrix units where the device has them
    /// (see `Matrices`). Visibility changes by at most 2e-4 with initial layers, by 2e-3 with layers four times as large.
    /// Gradients are those of 32 bits.
    pub visibility_operands: u32,
    /// Bits of a color channel of a splat between projection and blending: 32 or 16. 16 rounds to half precision: a relative
    /// error of 2^-11, or 2^-25 below 2^-14; at most 65504. Gradients are taken at the rounded colors.
    pub color_bits: u32,
    /// Bits of a table entry of the visibility field when training reads it: 32 or 16. 16 reads a copy in half precision.
    /// Visibility changes by less than 1e-3 with features of size one. Tables, moments and gradients keep 32 bits.
    pub table_bits: u32,
    /// Bits of the blending weights of the intrinsic stage: 32 or 16. 16 stores multiples of 1/65535, in 12 bytes per entry
    /// instead of 16. A pixel's material changes by at most (n + 1) * 7.6e-6 for n contributing Gaussians.
    pub weight_bits: u32,
    /// Bits of a semantic feature when blending reads it: 32 or 16. 16 reads a copy in half precision, which takes 64 bytes
    /// per Gaussian during a step. Features, moments and gradients keep 32 bits.
    pub feature_bits: u32,
}

impl Accuracy {
    /// As 3D Gaussian splatting is defined. Pictures agree with double precision within 5e-6 of a color, or of one where it is
    /// less, at pixels that do not meet a threshold.
    pub const EXACT: Accuracy = Accuracy {
        depth_bits: 31,
        alpha_min: 1.0 / 255.0,
        transmittance_min: 1e-4,
        keep_last: false,
        fast_exp: false,
        visibility_operands: 32,
        color_bits: 32,
        table_bits: 32,
        weight_bits: 32,
        feature_bits: 32,
    };
}

impl Accuracy {
    /// Nearly as good: pixels end at a transmittance of 1e-3, the last splat kept, so that nothing left out is worth more than
    /// 1e-3 of the largest color; 24 bits of depth.
    pub const BALANCED: Accuracy =
        Accuracy { depth_bits: 24, transmittance_min: 1e-3, keep_last: true, ..Accuracy::EXACT };

    /// For looking and for drafts: footprints end at an opacity of 1/64, pixels at a transmittance of 1e-2, sixteen bits of depth,
    /// of what the visibility field multiplies, of its tables, of colors, and of pixels' weights.
    pub const FAST: Accuracy = Accuracy {
        depth_bits: 16,
        alpha_min: 1.0 / 64.0,
        transmittance_min: 1e-2,
        keep_last: true,
        fast_exp: false,
        visibility_operands: 16,
        color_bits: 16,
        table_bits: 16,
        weight_bits: 16,
        feature_bits: 32,
    };
}

impl Default for Accuracy {
    fn default() -> Self {
        Accuracy::EXACT
    }
}
