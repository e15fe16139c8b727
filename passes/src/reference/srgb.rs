//! sRGB encoding (IEC 61966-2-1), its derivative and its inverse. The encoding is clamped at black and white.

/// Encodes linear light; a value that is not finite is black.
pub fn encode(linear: f64) -> f64 {
    let v = if linear.is_finite() { linear.clamp(0.0, 1.0) } else { 0.0 };
    if v > 0.003_130_8 { 1.055 * v.powf(1.0 / 2.4) - 0.055 } else { 12.92 * v }
}

/// Returns the derivative of the encoding before clamping. Beyond black and white, the derivative is that at black or
/// white.
pub fn slope(linear: f64) -> f64 {
    if linear > 0.003_130_8 { 1.055 / 2.4 * linear.min(1.0).powf(1.0 / 2.4 - 1.0) } else { 12.92 }
}

/// Returns the derivative of [`encode`], zero where the value was clamped.
pub fn derivative(linear: f64) -> f64 {
    if (0.0..=1.0).contains(&linear) { slope(linear) } else { 0.0 }
}

/// Decodes to linear light.
pub fn decode(encoded: f64) -> f64 {
    super::present::linear(encoded.clamp(0.0, 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference::difference;

    #[test]
    fn decode_inverts_encode_and_derivative_matches_differences() {
        for i in 0..=1000 {
            let v = f64::from(i) / 1000.0;
            assert!((encode(decode(v)) - v).abs() < 1e-6, "{v}");
            let x = 0.001 + 0.99 * v;
            if (x - 0.003_130_8).abs() > 1e-4 {
                let fd = difference(&mut [x], 0, |x| encode(x[0]));
                assert!((fd - derivative(x)).abs() < 1e-4 * fd, "{x}: {fd}");
            }
        }
        assert_eq!([encode(-1.0), encode(f64::NAN)], [0.0; 2]);
        assert!((encode(2.0) - 1.0).abs() < 1e-12);
        assert_eq!([derivative(-0.1), derivative(1.1), derivative(f64::NAN)], [0.0; 3]);
    }
}
