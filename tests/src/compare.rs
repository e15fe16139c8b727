//! Comparisons with absolute plus relative tolerance, and finite differences.

/// Largest difference of two numbers: `absolute + relative * |expected|`.
#[derive(Clone, Copy, Debug)]
pub struct Tolerance {
    /// Absolute term.
    pub absolute: f64,
    /// Relative term.
    pub relative: f64,
}

impl Tolerance {
    /// Creates a tolerance from both terms.
    pub const fn new(absolute: f64, relative: f64) -> Tolerance {
        Tolerance { absolute, relative }
    }
}

/// Returns the element that exceeds its tolerance most.
///
/// The result is its index, the expected and the found value, and their difference as a multiple of the tolerance. NaN
/// is infinitely far from anything but NaN.
pub fn worst(expected: &[f64], found: &[f32], tolerance: Tolerance) -> Option<(usize, f64, f64, f64)> {
    assert_eq!(expected.len(), found.len(), "lengths differ");
    let mut worst: Option<(usize, f64, f64, f64)> = None;
    for (i, (&e, &f)) in expected.iter().zip(found).enumerate() {
        let f = f64::from(f);
        let excess = if e.is_nan() && f.is_nan() || e == f {
            0.0
        } else {
            let ratio = (e - f).abs() / (tolerance.absolute + tolerance.relative * e.abs());
            if ratio.is_nan() { f64::INFINITY } else { ratio }
        };
        if worst.is_none_or(|w| excess > w.3) {
            worst = Some((i, e, f, excess));
        }
    }
    worst
}

/// Fails unless every element is within tolerance.
#[track_caller]
pub fn assert_close(what: &str, expected: &[f64], found: &[f32], tolerance: Tolerance) {
    if let Some((i, e, f, excess)) = worst(expected, found, tolerance) {
        assert!(excess <= 1.0, "{what}: element {i} should be {e}, is {f}: {excess:.2} times {tolerance:?}");
    }
}

/// Returns the central difference of `f` along coordinate `i` of `x`.
pub fn finite_difference(x: &mut [f64], i: usize, step: f64, mut f: impl FnMut(&[f64]) -> f64) -> f64 {
    let old = x[i];
    x[i] = old + step;
    let up = f(x);
    x[i] = old - step;
    let down = f(x);
    x[i] = old;
    (up - down) / (2.0 * step)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn planted_errors_are_caught() {
        let t = Tolerance::new(1e-6, 1e-4);
        assert!(worst(&[1.0, 2.0], &[1.0, 2.0001], t).unwrap().3 <= 1.0);
        assert!(worst(&[1.0, 2.0], &[1.0, 2.001], t).unwrap().3 > 1.0);
        assert!(worst(&[0.0], &[f32::NAN], t).unwrap().3 > 1.0);
        assert!(worst(&[f64::INFINITY], &[1.0], t).unwrap().3 > 1.0);
        assert!(worst(&[f64::NAN], &[f32::NAN], t).unwrap().3 <= 1.0);
    }

    #[test]
    fn finite_difference_of_a_square() {
        let d = finite_difference(&mut [3.0], 0, 1e-5, |x| x[0] * x[0]);
        assert!((d - 6.0).abs() < 1e-8);
    }
}
