//! Resizing of images.
//!
//! Along an axis that shrinks, every new pixel is the exact average of the area it covers, for any ratio. Along an axis
//! that grows, values are interpolated linearly between pixel centers. Callers pass values that can be averaged: colors
//! must be linear, not sRGB-encoded.

use super::Image;

/// Filter taps of one axis. Each new pixel has its first old pixel and the weights of that pixel and its successors.
/// Weights sum to one.
struct Axis {
    taps: Vec<(usize, Vec<f64>)>,
}

impl Axis {
    fn new(old: u32, new: u32) -> Self {
        let ratio = f64::from(old) / f64::from(new);
        let last = old as usize - 1;
        let taps = (0..new).map(|i| {
            if new <= old {
                let (from, to) = (f64::from(i) * ratio, f64::from(i + 1) * ratio);
                let first = (from.floor() as usize).min(last);
                let end = (to.ceil() as usize).clamp(first + 1, old as usize);
                let cover = |j: usize| (to.min((j + 1) as f64) - from.max(j as f64)).max(0.0);
                let weights: Vec<f64> = (first..end).map(cover).collect();
                let total: f64 = weights.iter().sum();
                (first, weights.iter().map(|w| w / total).collect())
            } else {
                let center = ((f64::from(i) + 0.5) * ratio - 0.5).clamp(0.0, last as f64);
                let first = (center.floor() as usize).min(last.saturating_sub(1));
                let t = center - first as f64;
                if last == 0 { (0, vec![1.0]) } else { (first, vec![1.0 - t, t]) }
            }
        });
        Self { taps: taps.collect() }
    }
}

/// Resizes like [`resize`] but takes ownership. Avoids a copy if the size is unchanged.
pub(crate) fn resized(image: Image, width: u32, height: u32) -> Image {
    if (width, height) == (image.width, image.height) { image } else { resize(&image, width, height) }
}

/// Resizes an image to `width`×`height`. Returns zeros for an empty image, or for an image whose values do not fit its
/// size.
pub fn resize(image: &Image, width: u32, height: u32) -> Image {
    if (width, height) == (image.width, image.height) {
        return image.clone();
    }
    let mut out = Image::new(width, height, image.channels);
    if out.data.is_empty() || image.check().is_err() {
        return out;
    }
    let channels = image.channels as usize;
    let columns = Axis::new(image.width, width);
    let rows = Axis::new(image.height, height);

    // Each old row is resized to the new width on first use; at most two new rows share an old row.
    let old_stride = image.width as usize * channels;
    let narrow = |y: usize, out: &mut Vec<f64>| {
        let row = &image.data[y * old_stride..(y + 1) * old_stride];
        out.clear();
        for (first, weights) in &columns.taps {
            for c in 0..channels {
                let values = row[first * channels + c..].iter().step_by(channels);
                out.push(weights.iter().zip(values).map(|(w, &v)| w * f64::from(v)).sum());
            }
        }
    };
    let stride = width as usize * channels;
    let mut sum = vec![0.0; stride];
    let mut cache: Vec<(usize, Vec<f64>)> = Vec::new();
    for ((first, weights), target) in rows.taps.iter().zip(out.data.chunks_exact_mut(stride)) {
        cache.retain(|(y, _)| y >= first);
        sum.fill(0.0);
        for (i, weight) in weights.iter().enumerate() {
            let y = first + i;
            let at = cache.iter().position(|(cached, _)| *cached == y).unwrap_or_else(|| {
                let mut row = Vec::with_capacity(stride);
                narrow(y, &mut row);
                cache.push((y, row));
                cache.len() - 1
            });
            for (s, v) in sum.iter_mut().zip(&cache[at].1) {
                *s += weight * v;
            }
            // When a new row covers more than two old rows, only the last can be needed again.
            if weights.len() > 2 && i + 1 < weights.len() {
                cache.swap_remove(at);
            }
        }
        for (t, s) in target.iter_mut().zip(&sum) {
            *t = *s as f32;
        }
    }
    out
}

/// Resizes an image to `width`×`height`, averaging over valid pixels only. Pixels are valid where `valid` (one channel)
/// is not zero. The second result is 1 where at least half of the area is valid, else 0. The first result is 0 where
/// the second is 0.
pub fn resize_valid(image: &Image, valid: &Image, width: u32, height: u32) -> (Image, Image) {
    let channels = image.channels.max(1) as usize;
    let mut gated = image.clone();
    for (pixel, &v) in gated.data.chunks_exact_mut(channels).zip(&valid.data) {
        if v == 0.0 {
            // Multiplication would fail: an invalid value may be infinite.
            pixel.fill(0.0);
        }
    }
    let mut out = resize(&gated, width, height);
    let mut covered = resize(valid, width, height);
    for (pixel, v) in out.data.chunks_exact_mut(channels).zip(&mut covered.data) {
        // The tolerance counts a half-covered pixel despite rounding.
        let keep = *v >= 0.5 - 1e-6;
        for value in pixel.iter_mut() {
            *value = if keep { *value / *v } else { 0.0 };
        }
        *v = f32::from(u8::from(keep));
    }
    (out, covered)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noise(width: u32, height: u32, channels: u32) -> Image {
        let mut state = 7_u32;
        let mut image = Image::new(width, height, channels);
        for v in &mut image.data {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            *v = (state >> 8) as f32 / (1 << 24) as f32;
        }
        image
    }

    fn mean(image: &Image, channel: usize) -> f64 {
        let values = image.data.iter().skip(channel).step_by(image.channels as usize);
        values.map(|&v| f64::from(v)).sum::<f64>() / image.pixels() as f64
    }

    #[test]
    fn shrinking_preserves_the_mean_for_any_ratio() {
        let image = noise(37, 23, 3);
        for (w, h) in [(1, 1), (2, 3), (18, 11), (25, 16), (36, 22), (37, 5), (5, 23)] {
            let small = resize(&image, w, h);
            assert_eq!((small.width, small.height, small.channels), (w, h, 3));
            for c in 0..3 {
                assert!((mean(&small, c) - mean(&image, c)).abs() < 1e-6, "{w}×{h} channel {c}");
            }
        }
    }

    #[test]
    fn downscaled_pixel_is_the_exact_area_average() {
        // 3 → 2: both new pixels share the middle pixel equally.
        let image = Image::from_data(3, 1, 1, vec![1.0, 10.0, 100.0]).unwrap();
        let small = resize(&image, 2, 1);
        assert!((small.data[0] - (1.0 + 5.0) / 1.5).abs() < 1e-5, "{:?}", small.data);
        assert!((small.data[1] - (5.0 + 100.0) / 1.5).abs() < 1e-4, "{:?}", small.data);
        let column = Image::from_data(1, 3, 1, vec![1.0, 10.0, 100.0]).unwrap();
        assert_eq!(resize(&column, 1, 2).data, small.data);
    }

    #[test]
    fn halving_averages_blocks_per_channel() {
        let mut image = Image::new(4, 2, 2);
        for (i, pixel) in image.data.chunks_exact_mut(2).enumerate() {
            pixel.copy_from_slice(&[i as f32, 100.0 + i as f32]);
        }
        assert_eq!(resize(&image, 2, 1).data, [2.5, 102.5, 4.5, 104.5]);
    }

    #[test]
    fn growing_interpolates_between_centers() {
        let image = Image::from_data(2, 1, 1, vec![0.0, 1.0]).unwrap();
        assert_eq!(resize(&image, 4, 1).data, [0.0, 0.25, 0.75, 1.0]);
        assert_eq!(resize(&image, 2, 2).data, [0.0, 1.0, 0.0, 1.0]);
        assert_eq!(resize(&Image::from_data(1, 1, 1, vec![3.0]).unwrap(), 3, 2).data, [3.0; 6]);
    }

    #[test]
    fn mixed_and_empty_sizes_are_handled() {
        let image = noise(5, 9, 1);
        let mixed = resize(&image, 7, 4);
        assert_eq!(mixed.data.len(), 28);
        assert!(mixed.data.iter().all(|v| (0.0..=1.0).contains(v)));
        assert!(resize(&image, 0, 4).data.is_empty());
        assert_eq!(resize(&Image::new(0, 3, 1), 2, 2).data, [0.0; 4]);
        assert_eq!(resize(&image, 5, 9), image);
    }

    #[test]
    fn invalid_pixels_do_not_leak() {
        let image = Image::from_data(4, 1, 1, vec![2.0, f32::INFINITY, f32::NAN, 7.0]).unwrap();
        let valid = Image::from_data(4, 1, 1, vec![1.0, 0.0, 0.0, 0.0]).unwrap();
        let (small, covered) = resize_valid(&image, &valid, 2, 1);
        assert_eq!(small.data, [2.0, 0.0]);
        assert_eq!(covered.data, [1.0, 0.0]);
    }
}
