//! Reference of `include/rounding.glsl`: rounding at random to 16 bits, from its definition.
//!
//! A number lies between two neighbors that 16 bits hold. It becomes the one away from zero with the probability of the part
//! that is cut off.

use crate::rng::pcg;

/// Returns the key of a Gaussian's random bits, by the seed of the step.
pub fn key(seed: u32, gaussian: u32) -> u32 {
    pcg(pcg(seed ^ 0x5bd1_e995).wrapping_add(gaussian))
}

/// Returns random bits of a column: `k` is 0 to 3 for the moments of each number, 4 and 5 for two parameters each.
fn bits(key: u32, column: u32, k: u32) -> u32 {
    pcg(key.wrapping_add(8 * column).wrapping_add(k))
}

/// Rounds by `random`, one of `2^width` values.
///
/// The result is a multiple of the power of two `digits` below that of the number. Powers of two below `least` have the
/// multiples of `least`.
fn rounded(x: f64, digits: i32, least: i32, random: u32, width: i32) -> f64 {
    if x == 0.0 || !x.is_finite() {
        return x;
    }
    // The power of two of a double that is no denormal.
    let power = ((x.to_bits() >> 52 & 0x7ff) as i32 - 1023).max(least);
    let unit = 2.0_f64.powi(power - digits);
    let (units, values) = (x.abs() / unit, 2.0_f64.powi(width));
    let whole = units.floor();
    let up = (units - whole) * values >= values - f64::from(random);
    (whole + f64::from(u32::from(up))).copysign(x) * unit
}

/// Rounds both moments of a number to 16 bits: 8 and 9 significant ones. They stay below the largest numbers of their kind.
pub fn moments([first, second]: [f64; 2], key: u32, column: u32, number: u32) -> [f64; 2] {
    let random = bits(key, column, number);
    let most = [2.0 - 2.0_f64.powi(-7), 2.0 - 2.0_f64.powi(-8)].map(|m| m * 2.0_f64.powi(127));
    let first = rounded(first, 7, -126, random & 0xffff, 16).clamp(-most[0], most[0]);
    [first, rounded(second.abs(), 8, -126, random >> 17, 15).min(most[1])]
}

/// Rounds a number of a column of harmonics to half precision.
///
/// It stays below the largest half.
pub fn half(x: f64, key: u32, column: u32, number: u32) -> f64 {
    let random = bits(key, column, 4 + number / 2);
    let random = if number.is_multiple_of(2) { random & 0x1fff } else { random >> 19 };
    rounded(x.clamp(-65504.0, 65504.0), 10, -14, random, 13)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The mean over many keys is the number. Each result is one of its two neighbors.
    #[test]
    fn rounding_is_right_in_the_mean() {
        let n = 40_000;
        for x in [1.000_123, -0.013_7, 3e-7, 700.3] {
            let sums = (0..n).fold([0.0; 3], |[a, b, c], i| {
                let k = key(7, i);
                let [m, v] = moments([x, x * x], k, 3, 1);
                let h = half(x, k, 3, 1);
                assert!((m / x - 1.0).abs() <= 2.0_f64.powi(-7) && (v / (x * x) - 1.0).abs() <= 2.0_f64.powi(-8));
                assert!((h - x).abs() <= (x.abs() * 2.0_f64.powi(-10)).max(2.0_f64.powi(-24)));
                [a + m, b + v, c + h]
            });
            let [m, v, h] = sums.map(|sum| sum / f64::from(n));
            // Five deviations of the mean of numbers that are half a unit off.
            let bound = 5.0 * 0.5 / f64::from(n).sqrt();
            assert!((m / x - 1.0).abs() < bound * 2.0_f64.powi(-7), "{x} {m}");
            assert!((v / (x * x) - 1.0).abs() < bound * 2.0_f64.powi(-8), "{x} {v}");
            assert!((h - x).abs() < bound * (x.abs() * 2.0_f64.powi(-10)).max(2.0_f64.powi(-24)), "{x} {h}");
        }
    }

    #[test]
    fn representable_numbers_stay() {
        for i in 0..1000 {
            let k = key(1, i);
            for x in [0.0, 1.0, -1.5, 65504.0, 2.0_f64.powi(-24), 2.0_f64.powi(-14)] {
                assert_eq!((half(x, k, 5, 2), moments([1.5 * x.signum(), 2.0], k, 5, 2)[1]), (x, 2.0));
            }
        }
        assert_eq!(half(1e9, 1, 2, 3), 65504.0);
        assert!(half(f64::NAN, 1, 2, 3).is_nan() && moments([3.4e38, 3.4e38], 0, 0, 0)[0].is_finite());
    }
}
