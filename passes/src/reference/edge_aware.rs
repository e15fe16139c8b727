//! Reference of `edge_aware`: an image should be smooth where the photograph is. Invalid pixels do not count.

use super::photometric::{counts, unpack};
use super::taps::{SOBEL, filtered};

/// Returns `exp(-|Sobel of the photograph|)` for each channel of an image. An image with three channels has one value
/// per channel, an image with one channel the mean.
fn edge(photo: &[u32], taps: &[(usize, f64)], channels: usize) -> Vec<f64> {
    let of = |c: usize| (-taps.iter().map(|&(q, w)| w * unpack(photo[q], c)).sum::<f64>().abs()).exp();
    let all = [of(0), of(1), of(2)];
    if channels == 3 { all.to_vec() } else { vec![all.iter().sum::<f64>() / 3.0; channels] }
}

/// Returns the taps of a direction's Sobel filter around a pixel. None if the photograph is invalid at a tap.
fn taps(photo: &[u32], size: [usize; 2], p: usize, vertical: bool) -> Option<Vec<(usize, f64)>> {
    let taps = SOBEL.taps(size, p, vertical);
    taps.iter().all(|&(q, _)| counts(photo[q])).then_some(taps)
}

fn sign(x: f64) -> f64 {
    if x == 0.0 { 0.0 } else { x.signum() }
}

/// Returns the loss of an image of three channels or one. The loss is the mean over pixels and channels.
pub fn edge_aware(image: &[f64], channels: usize, photo: &[u32], size: [usize; 2]) -> f64 {
    let mut sum = 0.0;
    for p in 0..photo.len() {
        for vertical in [false, true] {
            let Some(taps) = taps(photo, size, p, vertical) else { continue };
            let edge = edge(photo, &taps, channels);
            sum += (0..channels).map(|c| edge[c] * filtered(&taps, image, channels, c).abs()).sum::<f64>();
        }
    }
    sum / image.len() as f64
}

/// Returns the gradient of [`edge_aware`].
pub fn edge_aware_bwd(image: &[f64], channels: usize, photo: &[u32], size: [usize; 2]) -> Vec<f64> {
    let mut gradient = vec![0.0; image.len()];
    for p in 0..photo.len() {
        for vertical in [false, true] {
            let Some(taps) = taps(photo, size, p, vertical) else { continue };
            let edge = edge(photo, &taps, channels);
            for c in 0..channels {
                let s = edge[c] * sign(filtered(&taps, image, channels, c)) / image.len() as f64;
                taps.iter().for_each(|&(q, w)| gradient[q * channels + c] += s * w);
            }
        }
    }
    gradient
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference::difference;
    use crate::rng::Pcg;

    #[test]
    fn gradient_matches_finite_differences() {
        let mut rng = Pcg::new(4);
        for (size, channels) in [([1, 1], 3), ([1, 5], 1), ([6, 4], 3), ([5, 3], 1)] {
            let pixels = size[0] * size[1];
            let alpha = |p: usize| if p % 7 == 3 { 0 } else { 0xff00_0000 };
            let photo: Vec<u32> = (0..pixels).map(|p| (rng.next_u32() & 0x00ff_ffff) | alpha(p)).collect();
            let mut image: Vec<f64> = (0..pixels * channels).map(|_| rng.uniform()).collect();
            let gradient = edge_aware_bwd(&image, channels, &photo, size);
            for (i, g) in gradient.iter().enumerate() {
                let fd = difference(&mut image, i, |x| edge_aware(x, channels, &photo, size));
                assert!((fd - g).abs() < 1e-8, "{i}: {fd} {g}");
            }
            // Values at invalid pixels have no effect.
            let loss = edge_aware(&image, channels, &photo, size);
            let invalid = (0..image.len()).filter(|i| i / channels % 7 == 3);
            invalid.for_each(|i| image[i] = f64::NAN);
            assert_eq!(edge_aware(&image, channels, &photo, size), loss);
            assert_eq!(edge_aware_bwd(&image, channels, &photo, size), gradient);
        }
    }
}
