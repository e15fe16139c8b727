//! Reference of `present`: four components of a texel before rounding to the format.

use crate::splat::{Channels, Encoding, Layer, Presented, TexelFormat};

/// Decodes a channel from sRGB to linear light (IEC 61966-2-1). The curve continues beyond 0 and 1.
pub fn linear(v: f64) -> f64 {
    if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
}

/// Returns the components of every pixel, red first. `image` is `[pixels * channels]`, `transmittance` is `[pixels]`.
pub fn present(image: &[f64], transmittance: &[f64], channels: Channels, as_: &Presented) -> Vec<[f64; 4]> {
    let c = channels.count() as usize;
    let eight = !matches!(as_.format, TexelFormat::Rgba16Float | TexelFormat::Rgba32Float);
    let texel = |(pixel, t): (&[f64], &f64)| {
        let alpha = 1.0 - t;
        let three = |first: usize| [pixel[first], pixel[first + 1], pixel[first + 2]];
        let rgb = match as_.layer {
            Layer::Color if as_.encoding == Encoding::Linear && !as_.format.srgb() => three(0).map(linear),
            Layer::Color => three(0),
            Layer::Depth => [pixel[c - 2] * f64::from(as_.depth_scale); 3],
            Layer::Normal if eight => three(3).map(|n| 0.5 * n + 0.5),
            Layer::Normal => three(3),
            Layer::Alpha => [alpha; 3],
        };
        [rgb[0], rgb[1], rgb[2], alpha]
    };
    image.chunks_exact(c).zip(transmittance).map(texel).collect()
}

/// Returns the bytes of an 8-bit texel in memory order.
pub fn eight_bit(texel: [f64; 4], format: TexelFormat) -> [u8; 4] {
    let byte = |v: f64| if v > 0.0 { (v.min(1.0) * 255.0 + 0.5) as u8 } else { 0 };
    let [r, g, b, a] = texel.map(byte);
    match format {
        TexelFormat::Bgra8Unorm | TexelFormat::Bgra8Srgb => [b, g, r, a],
        _ => [r, g, b, a],
    }
}
