//! The sRGB transfer function (IEC 61966-2-1), both ways.

/// Converts an sRGB-encoded value to linear light. Values outside `[0, 1]` continue the curve; negative values use its
/// linear segment.
pub fn srgb_to_linear(encoded: f32) -> f32 {
    if encoded <= 0.04045 { encoded / 12.92 } else { ((encoded + 0.055) / 1.055).powf(2.4) }
}

/// Converts linear light to an sRGB-encoded value. Values outside `[0, 1]` continue the curve; negative values use its
/// linear segment.
pub fn linear_to_srgb(linear: f32) -> f32 {
    if linear <= 0.003_130_8 { linear * 12.92 } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn transfer_function_matches_known_values() {
        assert_eq!(srgb_to_linear(0.0), 0.0);
        assert!((srgb_to_linear(1.0) - 1.0).abs() < 1e-6);
        // Mid gray 128/255 is 21.586 % of linear white.
        assert!((srgb_to_linear(128.0 / 255.0) - 0.215_861).abs() < 1e-5);
        assert!((linear_to_srgb(0.18) - 0.461_356).abs() < 1e-5);
    }

    #[test]
    fn conversions_are_inverse_and_monotonic() {
        let mut last = -1.0;
        for i in 0..=65_535 {
            let encoded = i as f32 / 65_535.0;
            let linear = srgb_to_linear(encoded);
            assert!((linear_to_srgb(linear) - encoded).abs() < 2e-6, "{i}");
            assert!(linear > last, "{i}");
            last = linear;
        }
    }
}
