//! Errors of images and gradients.
//!
//! Non-finite values have infinite error, and different lengths are refused. Otherwise a maximum would ignore NaN,
//! and pairing would ignore surplus elements. The worst results would then count as equal.

use anyhow::ensure;

/// Error of an image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImageError {
    /// Largest absolute difference.
    pub largest: f64,
    /// Mean absolute difference.
    pub mean: f64,
    /// PSNR, dB.
    pub psnr: f64,
}

/// Compares an image with the reference, element by element.
///
/// # Errors
/// If the sizes differ or are zero.
pub fn image_error(image: &[f32], truth: &[f64]) -> anyhow::Result<ImageError> {
    let (own, expected) = (image.len(), truth.len());
    ensure!(own == expected && own > 0, "An image of {own} numbers cannot be compared with one of {expected}.");
    let (mut largest, mut sum, mut square) = (0.0_f64, 0.0, 0.0);
    for (a, b) in image.iter().zip(truth) {
        let d = (f64::from(*a) - b).abs();
        largest = largest.max(d);
        sum += d;
        square += d * d;
    }
    if !(f64::is_finite(sum) && f64::is_finite(square)) {
        return Ok(ImageError { largest: f64::INFINITY, mean: f64::INFINITY, psnr: f64::NEG_INFINITY });
    }
    let n = own as f64;
    Ok(ImageError { largest, mean: sum / n, psnr: -10.0 * (square / n).max(1e-30).log10() })
}

/// Returns the relative error of a gradient: length of the difference over that of `exact`.
///
/// Infinite if the gradient differs from an exact gradient of zero.
///
/// # Errors
/// If the sizes differ.
pub fn of_gradient(exact: &[f32], other: &[f32]) -> anyhow::Result<f64> {
    let (own, expected) = (other.len(), exact.len());
    ensure!(own == expected, "A gradient of {own} numbers cannot be compared with one of {expected}.");
    let (mut off, mut size) = (0.0, 0.0);
    for (a, b) in exact.iter().zip(other) {
        let (a, b) = (f64::from(*a), f64::from(*b));
        off += (a - b).powi(2);
        size += a * a;
    }
    let relative = (off / size).sqrt();
    Ok(match off == 0.0 {
        true => 0.0,
        false if relative.is_finite() => relative,
        false => f64::INFINITY,
    })
}

/// Returns a measurement of a choice if it is finite. Reports contain finite numbers only.
///
/// # Errors
/// If the value is not finite, with a sentence that names the choice.
pub fn finite(choice: &str, what: &str, value: f64) -> anyhow::Result<f64> {
    ensure!(value.is_finite(), "The {what} of \"{choice}\" is not a finite number.");
    Ok(value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn image_error_measures_largest_mean_and_psnr() {
        let e = image_error(&[0.5, 0.25, 1.0, 0.0], &[0.5, 0.5, 1.0, 0.0]).unwrap();
        assert_eq!((e.largest, e.mean), (0.25, 0.0625));
        assert!((e.psnr - 18.062).abs() < 1e-3, "{e:?}");
        assert!(image_error(&[1.0], &[1.0]).unwrap().psnr > 200.0);
    }

    #[test]
    fn non_finite_values_have_infinite_error() {
        for wrong in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            let e = image_error(&[0.5, wrong, 0.5], &[0.5; 3]).unwrap();
            assert_eq!((e.largest, e.mean, e.psnr), (f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY), "{wrong}");
            assert_eq!(of_gradient(&[1.0, 2.0], &[1.0, wrong]).unwrap(), f64::INFINITY, "{wrong}");
            assert_eq!(of_gradient(&[1.0, wrong], &[1.0, 2.0]).unwrap(), f64::INFINITY, "{wrong}");
            assert_eq!(of_gradient(&[0.0], &[wrong]).unwrap(), f64::INFINITY, "{wrong}");
            let message = finite("fast", "mean error", f64::from(wrong)).unwrap_err().to_string();
            assert_eq!(message, "The mean error of \"fast\" is not a finite number.");
        }
        assert_eq!(image_error(&[0.5], &[f64::NAN]).unwrap().mean, f64::INFINITY);
        assert_eq!(finite("fast", "mean error", 0.5).unwrap(), 0.5);
    }

    #[test]
    fn gradient_error_is_relative() {
        assert!((of_gradient(&[3.0, 4.0], &[3.0, 4.5]).unwrap() - 0.1).abs() < 1e-12);
        // Two zero gradients agree exactly; a nonzero gradient differs infinitely from a zero one.
        assert_eq!((of_gradient(&[0.0], &[0.0]).unwrap(), of_gradient(&[], &[]).unwrap()), (0.0, 0.0));
        assert_eq!(of_gradient(&[0.0, 0.0], &[0.0, 1e-20]).unwrap(), f64::INFINITY);
    }

    #[test]
    fn different_lengths_are_refused() {
        let message = image_error(&[0.5, 0.5], &[0.5]).unwrap_err().to_string();
        assert_eq!(message, "An image of 2 numbers cannot be compared with one of 1.");
        assert!(image_error(&[0.5], &[0.5, 0.5]).is_err() && image_error(&[], &[]).is_err());
        assert!(of_gradient(&[1.0, 2.0], &[1.0]).is_err() && of_gradient(&[1.0], &[1.0, 2.0]).is_err());
    }
}
