//! Sharpness of frames, and the choice of sharp ones.
//!
//! The measure is the variance of the Laplacian of the gray values: motion blur removes fine edges and lowers it. It is
//! compared only between frames that follow each other, which show nearly the same.

use crate::pnm::Pnm;
use std::ops::Range;

/// Returns the variance of the Laplacian of the first channel; 0 for images without inner pixels.
pub(crate) fn sharpness(image: &Pnm) -> f32 {
    let (w, h, c) = (image.width as usize, image.height as usize, image.channels as usize);
    if w < 3 || h < 3 {
        return 0.0;
    }
    let at = |x: usize, y: usize| i64::from(image.data[(y * w + x) * c]);
    let (mut sum, mut squares) = (0_i64, 0_i64);
    for y in 1..h - 1 {
        for x in 1..w - 1 {
            let value = at(x - 1, y) + at(x + 1, y) + at(x, y - 1) + at(x, y + 1) - 4 * at(x, y);
            sum += value;
            squares += value * value;
        }
    }
    let count = ((w - 2) * (h - 2)) as f64;
    let mean = sum as f64 / count;
    (squares as f64 / count - mean * mean) as f32
}

/// Returns the sharpest frame of each of `count` equal intervals, in order. Fewer frames than `count` are all taken.
pub(crate) fn sharpest(frames: &[f32], count: usize) -> Vec<usize> {
    let count = count.min(frames.len());
    let interval = |i: usize| -> Range<usize> { i * frames.len() / count..(i + 1) * frames.len() / count };
    let best = |range: Range<usize>| range.max_by(|a, b| frames[*a].total_cmp(&frames[*b]).then(b.cmp(a)));
    (0..count).filter_map(|i| best(interval(i))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns stripes blurred over `radius` pixels to both sides.
    fn stripes(radius: usize) -> Pnm {
        let value = |x: usize| if (x / 4).is_multiple_of(2) { 20.0 } else { 220.0 };
        let blurred = |x: usize| (x..=x + 2 * radius).map(value).sum::<f64>() / (2 * radius + 1) as f64;
        let row: Vec<u8> = (0..64).map(|x| blurred(x) as u8).collect();
        Pnm { width: 64, height: 8, channels: 1, data: row.repeat(8) }
    }

    #[test]
    fn blur_lowers_the_sharpness() {
        let values: Vec<f32> = (0..4).map(|radius| sharpness(&stripes(radius))).collect();
        assert!(values.is_sorted_by(|a, b| a > &(1.5 * b)), "{values:?}");
        assert_eq!(sharpness(&Pnm { width: 5, height: 5, channels: 1, data: vec![77; 25] }), 0.0);
        assert_eq!(sharpness(&Pnm { width: 2, height: 2, channels: 1, data: vec![0, 255, 0, 9] }), 0.0);
    }

    #[test]
    fn each_interval_gives_its_sharpest_frame() {
        let frames = [1.0, 5.0, 2.0, 9.0, 8.0, 7.0, 3.0, 3.0, 4.0];
        assert_eq!(sharpest(&frames, 3), [1, 3, 8]);
        assert_eq!(sharpest(&frames, 2), [3, 4]);
        assert_eq!(sharpest(&frames, 100), (0..9).collect::<Vec<_>>());
        assert_eq!(sharpest(&[1.0, 1.0, f32::NAN, 1.0], 2), [0, 2]);
        assert!(sharpest(&[], 5).is_empty());
    }
}
