//! Numbers stored in fewer bits ([`crate::Accuracy`]), in double precision.

use half::f16;

/// Rounds a number to half precision, to nearest, ties to even. A number larger than the largest half becomes the
/// largest half. NaN stays NaN.
pub fn half(x: f64) -> f64 {
    let most = f16::MAX.to_f64();
    f16::from_f64(x.clamp(-most, most)).to_f64()
}

/// Rounds a number to half precision if `bits` is 16.
pub fn stored(x: f64, bits: u32) -> f64 {
    if bits == 16 { half(x) } else { x }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn halves_have_eleven_significant_bits() {
        for x in [1.0, -0.75, 65504.0, 2.0_f64.powi(-24), 0.0] {
            assert_eq!(half(x), x);
        }
        assert_eq!(half(1.0 + 2.0_f64.powi(-11)), 1.0);
        assert_eq!(half(1.0 + 3.0 * 2.0_f64.powi(-11)), 1.0 + 2.0_f64.powi(-9));
        assert_eq!(half(1e9), 65504.0);
        assert_eq!(half(-f64::INFINITY), -65504.0);
        assert_eq!(half(2.0_f64.powi(-26)), 0.0);
        assert!(half(f64::NAN).is_nan());
        assert_eq!(stored(0.1, 32), 0.1);
        assert_eq!(stored(0.1, 16), half(0.1));
    }
}
