//! What may be traded for speed, by name: the choices of a whole plan.
//!
//! `engine-bench tradeoff` measures what each is worth (docs/how/accuracy.md). Measures of quality are taken with
//! [`Accuracy::EXACT`] whatever a scene was trained with.

use serde::{Deserialize, Serialize};

/// Choices that buy speed with accuracy: `[accuracy]` of a run's settings.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Accuracy {
    /// Bits of the keys that splats are sorted by along the view: 31, 24 or 16. Each eight bits less save one pass of the
    /// sort. Shorter keys leave splats in the order of their numbers whose depths differ by less than one part in 2^19 (24
    /// bits) or 2^11 (16 bits) of a power of two.
    pub depth_bits: u32,
    /// Smallest opacity of a splat at a pixel that counts: it bounds splats' footprints. 1/255 in 3D Gaussian splatting.
    /// A color channel of a pixel is off by at most this times the largest color, for each splat that is left out.
    pub alpha_min: f32,
    /// A pixel stops where less than this would be left to be seen behind it: 1e-4 in 3D Gaussian splatting.
    pub transmittance_min: f32,
    /// Whether the splat with which a pixel stops is blended. If it is, whatever is left out changes the pixel by at most
    /// `transmittance_min` times the largest color; if not, as in 3D Gaussian splatting, by up to a hundred times as much,
    /// since that splat may hide 99 % of what is behind it.
    pub keep_last: bool,
    /// Whether a cubic stands in for the exponential in splats' opacities: 1.3e-4 off, relatively. For processors where exponentials
    /// are slow; GPUs have them in hardware. No level has it, since no device has been found where a step gains by it.
    pub fast_exp: bool,
    /// Bits of the numbers that the visibility field's second layer multiplies, 32 or 16. With 16 matrix units do it where there are
    /// any ([`Matrices`](crate::Matrices)), and where there are none nothing changes. Sums and everything else keep 32 bits, and
    /// gradients are those of 32. Visibility is off by 2e-4 at most with layers as they start, by 2e-3 with such four times as large.
    pub visibility_operands: u32,
    /// Bits of a channel of splats' colors between projection and blending, 32 or 16. With 16 each is rounded to half precision,
    /// to nearest: off by 2^-11 of itself at most, by 2^-25 where it is below 2^-14, and never above 65504. A picture is off by no
    /// more than that of its brightest splat. Gradients are those at the rounded colors, passed on as if nothing had been rounded.
    pub color_bits: u32,
    /// Bits of a number of the visibility field's tables where they are looked up, 32 or 16, in training. With 16 a copy of the tables
    /// is read, rounded to half precision: off by 2^-11 of itself at most, by 2^-25 where it is below 2^-14. Visibility is off by less than
    /// 1e-3 with features of the size of one. Gradients are those at the rounded numbers; tables and moments keep 32 bits.
    pub table_bits: u32,
    /// Bits of the weights with which Gaussians show at the pixels of the intrinsic stage's views, 32 or 16. With 16 they are kept in
    /// parts of 65535, each off by no more than one of them, in 12 bytes an entry instead of 16; a row adds up to one within half a
    /// part. A material of a pixel is off by at most n + 1 times 7.6e-6 of the difference between the materials of n Gaussians there.
    pub weight_bits: u32,
    /// Bits of a semantic feature of a Gaussian where blending reads it, 32 or 16. With 16 a copy is made at the beginning of a step,
    /// rounded to half precision: off by 2^-11 of itself at most, by 2^-25 where it is below 2^-14; a pixel's is off by no more than
    /// that of the largest. It takes 64 bytes a Gaussian while a step runs. Gradients are those at the rounded features, passed on as
    /// if nothing had been rounded; features and moments keep 32 bits.
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
