//! Linear color and its display encoding.

use glam::Vec3;

/// Returns the relative luminance of a linear color.
pub(crate) fn luminance(c: Vec3) -> f32 {
    c.dot(Vec3::new(0.212_671, 0.715_160, 0.072_169))
}

/// Applies the piecewise sRGB curve to one value, clamped to [0, 1].
pub(crate) fn encode(linear: f32) -> f32 {
    let x = linear.clamp(0.0, 1.0);
    if x <= 0.003_130_8 { 12.92 * x } else { 1.055 * x.powf(1.0 / 2.4) - 0.055 }
}

/// Inverts [`encode`].
pub(crate) fn decode(display: f32) -> f32 {
    let x = display.clamp(0.0, 1.0);
    if x <= 0.040_45 { x / 12.92 } else { ((x + 0.055) / 1.055).powf(2.4) }
}

/// Applies [`encode`] to each channel.
pub(crate) fn encode3(c: Vec3) -> Vec3 {
    Vec3::new(encode(c.x), encode(c.y), encode(c.z))
}

/// Applies [`decode`] to each channel.
pub(crate) fn decode3(c: Vec3) -> Vec3 {
    Vec3::new(decode(c.x), decode(c.y), decode(c.z))
}

/// Rounds a value in [0, 1] to eight bits.
pub(crate) fn byte(x: f32) -> u8 {
    (x.clamp(0.0, 1.0) * 255.0 + 0.5) as u8
}

/// Returns the linear color of a display color written as 0xRRGGBB.
pub(crate) fn hex(rgb: u32) -> Vec3 {
    let channel = |shift: u32| ((rgb >> shift) & 255) as f32 / 255.0;
    decode3(Vec3::new(channel(16), channel(8), channel(0)))
}
