//! Values before and after activation: opacities, materials, quaternions.

pub(crate) fn logistic(stored: f32) -> f64 {
    1.0 / (1.0 + (-f64::from(stored)).exp())
}

/// Maps a stored value to a material in `range` (see [`crate::ALBEDO_RANGE`]).
pub(crate) fn material(stored: f32, range: [f32; 2]) -> f64 {
    f64::from(range[0]) + f64::from(range[1]) * logistic(stored)
}

/// Inverts [`logistic`], with finite results.
pub(crate) fn unlogistic(value: f64) -> f32 {
    let p = value.clamp(1e-6, 1.0 - 1e-6);
    (p / (1.0 - p)).ln() as f32
}

pub(crate) fn unmaterial(value: f32, range: [f32; 2]) -> f32 {
    unlogistic((f64::from(value) - f64::from(range[0])) / f64::from(range[1]))
}

/// Offset and span of metallic.
pub(crate) const METALLIC_RANGE: [f32; 2] = [0.0, 1.0];

/// Normalizes a quaternion (w, x, y, z); returns the identity if that is impossible.
pub(crate) fn unit(q: [f32; 4]) -> [f64; 4] {
    let q = q.map(f64::from);
    let length = q.iter().map(|v| v * v).sum::<f64>().sqrt();
    if length > 0.0 && length.is_finite() { q.map(|v| v / length) } else { [1.0, 0.0, 0.0, 0.0] }
}

/// Returns the logarithm of a length, with finite results.
pub(crate) fn log_length(length: f32) -> f32 {
    length.clamp(1e-20, f32::MAX).ln()
}

/// Rounds a number from 0 to 1 to a byte.
pub(crate) fn byte(unit: f64) -> u8 {
    (unit * 255.0).round().clamp(0.0, 255.0) as u8
}
