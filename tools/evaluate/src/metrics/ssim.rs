//! Structural similarity, as reported in papers on Gaussian splatting.

use sgs_scene::Image;

use super::{MetricError, check};

/// Half of the window, which is 11 pixels wide.
const RADIUS: usize = 5;
const SIGMA: f64 = 1.5;
const C1: f64 = 1e-4;
const C2: f64 = 9e-4;

/// Returns the mean structural similarity of images in `[0, 1]`. The window is a Gaussian of 11×11 pixels with σ 1.5,
/// with zeros outside the image. The mean covers all channels of the pixels that count. Masked pixels of `a` are
/// replaced by those of `b`, so that they do not affect their neighbors.
pub fn ssim(a: &Image, b: &Image, mask: Option<&Image>) -> Result<f64, MetricError> {
    check("ssim", a, b, mask)?;
    let (width, height) = (a.width as usize, a.height as usize);
    let channels = a.channels as usize;
    let window = window();
    let counts = |i: usize| mask.is_none_or(|mask| mask.data[i] > 0.5);
    let counted = (0..width * height).filter(|&i| counts(i)).count();
    if counted == 0 {
        return Err(MetricError::Empty { measure: "ssim" });
    }
    let mut sum = 0.0;
    for c in 0..channels {
        let plane = |image: &Image| -> Vec<f64> {
            image.data.iter().skip(c).step_by(channels).map(|&v| f64::from(v)).collect()
        };
        let (mut a, b) = (plane(a), plane(b));
        for i in (0..width * height).filter(|&i| !counts(i)) {
            a[i] = b[i];
        }
        let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).collect::<Vec<f64>>();
        let blurred = |values: &[f64]| blur(values, width, height, &window);
        let (mean_a, mean_b) = (blurred(&a), blurred(&b));
        let (aa, bb, ab) = (blurred(&product(&a, &a)), blurred(&product(&b, &b)), blurred(&product(&a, &b)));
        for i in (0..width * height).filter(|&i| counts(i)) {
            let (ma, mb) = (mean_a[i], mean_b[i]);
            let (var_a, var_b, cov) = (aa[i] - ma * ma, bb[i] - mb * mb, ab[i] - ma * mb);
            let luminance = (2.0 * ma * mb + C1) / (ma * ma + mb * mb + C1);
            sum += luminance * (2.0 * cov + C2) / (var_a + var_b + C2);
        }
    }
    Ok(sum / (counted * channels) as f64)
}

/// Returns the window along one axis. The two-dimensional window is its product with itself.
fn window() -> [f64; 2 * RADIUS + 1] {
    let mut weights = [0.0; 2 * RADIUS + 1];
    for (i, weight) in weights.iter_mut().enumerate() {
        let x = i as f64 - RADIUS as f64;
        *weight = (-0.5 * (x / SIGMA).powi(2)).exp();
    }
    let total: f64 = weights.iter().sum();
    weights.map(|weight| weight / total)
}

/// Convolves along both axes, with zeros outside.
fn blur(values: &[f64], width: usize, height: usize, window: &[f64]) -> Vec<f64> {
    let mut along = vec![0.0; values.len()];
    for (row, out) in values.chunks_exact(width).zip(along.chunks_exact_mut(width)) {
        for (x, out) in out.iter_mut().enumerate() {
            let (from, to) = (x.saturating_sub(RADIUS), (x + RADIUS + 1).min(width));
            let weights = &window[from + RADIUS - x..];
            *out = row[from..to].iter().zip(weights).map(|(v, w)| v * w).sum();
        }
    }
    let mut out = vec![0.0; values.len()];
    for (y, target) in out.chunks_exact_mut(width).enumerate() {
        for row in y.saturating_sub(RADIUS)..(y + RADIUS + 1).min(height) {
            let weight = window[row + RADIUS - y];
            for (t, v) in target.iter_mut().zip(&along[row * width..(row + 1) * width]) {
                *t += weight * v;
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pattern(width: u32, height: u32, channels: u32, seed: u32) -> Image {
        let mut state = seed;
        let mut image = Image::new(width, height, channels);
        for v in &mut image.data {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            *v = (state >> 8) as f32 / (1 << 24) as f32;
        }
        image
    }

    /// Reference: the definition, pixel by pixel and window by window.
    fn definition(a: &Image, b: &Image) -> f64 {
        let mut kernel = [[0.0; 11]; 11];
        let mut total = 0.0;
        for (j, row) in kernel.iter_mut().enumerate() {
            for (i, k) in row.iter_mut().enumerate() {
                let (x, y) = (i as f64 - 5.0, j as f64 - 5.0);
                *k = (-(x * x + y * y) / (2.0 * 1.5 * 1.5)).exp();
                total += *k;
            }
        }
        let mut sum = 0.0;
        for c in 0..a.channels as usize {
            for y in 0..a.height as i64 {
                for x in 0..a.width as i64 {
                    let mut m = [0.0; 5];
                    for (j, row) in kernel.iter().enumerate() {
                        for (i, k) in row.iter().enumerate() {
                            let (u, v) = (x + i as i64 - 5, y + j as i64 - 5);
                            if u < 0 || v < 0 || u >= i64::from(a.width) || v >= i64::from(a.height) {
                                continue;
                            }
                            let p = f64::from(a.pixel(u as u32, v as u32)[c]);
                            let q = f64::from(b.pixel(u as u32, v as u32)[c]);
                            let terms = [p, q, p * p, q * q, p * q];
                            m.iter_mut().zip(terms).for_each(|(m, t)| *m += t * k / total);
                        }
                    }
                    let [p, q, pp, qq, pq] = m;
                    let top = (2.0 * p * q + 1e-4) * (2.0 * (pq - p * q) + 9e-4);
                    sum += top / ((p * p + q * q + 1e-4) * (pp - p * p + qq - q * q + 9e-4));
                }
            }
        }
        sum / f64::from(a.width * a.height * a.channels)
    }

    #[test]
    fn matches_the_definition() {
        for (w, h, c) in [(17, 13, 3), (4, 3, 1), (1, 1, 3), (12, 1, 2)] {
            let (a, b) = (pattern(w, h, c, 1), pattern(w, h, c, 2));
            let (fast, slow) = (ssim(&a, &b, None).unwrap(), definition(&a, &b));
            assert!((fast - slow).abs() < 1e-12, "{w}×{h}×{c}: {fast} {slow}");
        }
    }

    #[test]
    fn equal_images_are_one_and_noise_is_not() {
        let a = pattern(20, 20, 3, 1);
        assert!((ssim(&a, &a, None).unwrap() - 1.0).abs() < 1e-12);
        assert!(ssim(&a, &pattern(20, 20, 3, 2), None).unwrap() < 0.2);
        assert!(ssim(&a, &Image::new(20, 19, 3), None).is_err());
    }

    /// Zeros outside the image reduce the weight of a difference at the border.
    #[test]
    fn border_is_padded_with_zeros() {
        let flat = |v: f32| Image { data: vec![v; 400], ..Image::new(20, 20, 1) };
        let value = ssim(&flat(0.2), &flat(0.8), None).unwrap();
        let center = (2.0 * 0.16 + 1e-4) / (0.04 + 0.64 + 1e-4);
        assert!((value - center).abs() > 1e-3 && (value - definition(&flat(0.2), &flat(0.8))).abs() < 1e-9);
    }

    #[test]
    fn masked_pixels_do_not_affect_the_result() {
        let (mut a, b) = (pattern(20, 16, 3, 1), pattern(20, 16, 3, 2));
        let counts = |p: usize| p % 20 < 12;
        let mask = Image::from_data(20, 16, 1, (0..320).map(|p| f32::from(u8::from(counts(p)))).collect()).unwrap();
        let masked = ssim(&a, &b, Some(&mask)).unwrap();
        assert!((masked - ssim(&a, &b, None).unwrap()).abs() > 1e-3);
        for p in (0..320).filter(|&p| !counts(p)) {
            a.data[3 * p..3 * p + 3].fill(f32::NAN);
        }
        assert_eq!(ssim(&a, &b, Some(&mask)).unwrap(), masked);
        assert!(matches!(ssim(&a, &b, Some(&Image::new(20, 16, 1))), Err(MetricError::Empty { .. })));
    }
}
