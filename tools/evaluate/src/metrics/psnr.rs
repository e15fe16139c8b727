//! Mean squared error and PSNR.

use sgs_scene::Image;

use super::{GainFit, MetricError, check, pairs};

/// Returns the mean squared difference over all channels of the pixels that count.
pub fn mse(a: &Image, b: &Image, mask: Option<&Image>) -> Result<f64, MetricError> {
    gained(a, b, mask, &[], "mse")
}

/// Returns the peak signal-to-noise ratio in dB for a peak of 1. Uses the mean squared error of all channels together.
/// Infinite for equal images.
pub fn psnr(a: &Image, b: &Image, mask: Option<&Image>) -> Result<f64, MetricError> {
    gained(a, b, mask, &[], "psnr").map(decibels)
}

/// Returns [`psnr`] after a least-squares gain for each channel of `a`. The gain brings the channel closest to `b`.
///
/// A channel of `a` that is zero everywhere keeps the gain 1. Scaled values are not clipped.
pub fn psnr_scaled(a: &Image, b: &Image, mask: Option<&Image>) -> Result<f64, MetricError> {
    let mut fit = GainFit::new(a.channels as usize);
    fit.add_images(a, b, mask)?;
    let gains = fit.per_channel();
    gained(a, b, mask, &gains, "psnr_scaled").map(decibels)
}

fn decibels(mse: f64) -> f64 {
    -10.0 * mse.log10()
}

/// Returns the mean squared difference after scaling the channels of `a`. Missing gains are 1.
fn gained(
    a: &Image,
    b: &Image,
    mask: Option<&Image>,
    gains: &[f64],
    measure: &'static str,
) -> Result<f64, MetricError> {
    check(measure, a, b, mask)?;
    let (mut sum, mut count) = (0.0, 0_u64);
    for (a, b) in pairs(a, b, mask) {
        for (c, (&a, &b)) in a.iter().zip(b).enumerate() {
            let gain = gains.get(c).copied().unwrap_or(1.0);
            sum += (gain * f64::from(a) - f64::from(b)).powi(2);
            count += 1;
        }
    }
    if count == 0 { Err(MetricError::Empty { measure }) } else { Ok(sum / count as f64) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(channels: u32, data: &[f32]) -> Image {
        Image::from_data(data.len() as u32 / channels, 1, channels, data.to_vec()).unwrap()
    }

    #[test]
    fn difference_of_a_tenth_is_twenty_decibels() {
        let a = image(3, &[0.5, 0.5, 0.5, 0.25, 0.25, 0.25]);
        let b = image(3, &[0.6, 0.4, 0.6, 0.15, 0.35, 0.15]);
        assert!((psnr(&a, &b, None).unwrap() - 20.0).abs() < 1e-5);
        assert!((mse(&a, &b, None).unwrap() - 0.01).abs() < 1e-8);
        assert_eq!(psnr(&a, &a, None).unwrap(), f64::INFINITY);
    }

    /// The mean over channels is taken before the logarithm.
    #[test]
    fn error_is_joint_over_channels() {
        let a = image(3, &[0.1, 0.01, 0.0]);
        let b = image(3, &[0.0, 0.0, 0.0]);
        let expected = -10.0 * ((0.01_f64 + 0.0001) / 3.0).log10();
        assert!((psnr(&a, &b, None).unwrap() - expected).abs() < 1e-5);
    }

    #[test]
    fn masked_pixels_do_not_count() {
        let (a, b) = (image(2, &[0.1, 0.1, f32::NAN, 9.0]), image(2, &[0.0; 4]));
        let mask = image(1, &[1.0, 0.5]);
        assert!((psnr(&a, &b, Some(&mask)).unwrap() - 20.0).abs() < 1e-5);
        let none = image(1, &[0.0, 0.0]);
        assert_eq!(psnr(&a, &b, Some(&none)), Err(MetricError::Empty { measure: "psnr" }));
        assert!(psnr_scaled(&a, &b, Some(&none)).is_err());
    }

    #[test]
    fn gain_is_fitted_per_channel() {
        let a = image(3, &[0.2, 0.4, 0.0, 0.1, 0.3, 0.0]);
        let b = image(3, &[0.4, 0.2, 0.1, 0.2, 0.15, 0.1]);
        // Only the error of the empty channel, 0.1, remains.
        let expected = -10.0 * (0.01_f64 / 3.0).log10();
        assert!((psnr_scaled(&a, &b, None).unwrap() - expected).abs() < 1e-4);
        assert!(psnr(&a, &b, None).unwrap() < expected - 3.0);
    }

    #[test]
    fn fitted_gain_is_optimal() {
        let a = image(1, &[0.2, 0.5, 0.9, 0.4]);
        let b = image(1, &[0.3, 0.4, 0.7, 0.5]);
        let best = psnr_scaled(&a, &b, None).unwrap();
        for gain in [0.5_f32, 0.8, 0.85, 0.9, 0.95, 1.0, 1.1] {
            let other: Vec<f32> = a.data.iter().map(|v| v * gain).collect();
            assert!(psnr(&image(1, &other), &b, None).unwrap() <= best + 1e-5, "{gain}");
        }
    }
}
