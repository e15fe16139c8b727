//! Derivative filters of 3 x 3 taps, applied tap by tap.

/// Values beyond the border.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Border {
    /// Repeats the last pixel.
    Repeat,
    /// Mirrors the image at the last pixel's center.
    Reflect,
}

/// Derivative filter: a difference of neighbors times a weighted sum of three across.
#[derive(Clone, Copy, Debug)]
pub struct Derivative {
    /// Weight of the next pixel in the difference; the previous pixel has its negative.
    pub difference: f64,
    /// Weights of the sum: at the side, in the middle.
    pub smooth: [f64; 2],
    /// Values beyond the border.
    pub border: Border,
}

/// Sobel filter, over 8.
pub const SOBEL: Derivative = Derivative { difference: 0.125, smooth: [1.0, 2.0], border: Border::Repeat };

/// Three-tap filter of Farid and Simoncelli (2004).
pub const FARID: Derivative =
    Derivative { difference: 0.425287, smooth: [0.229879, 0.540242], border: Border::Reflect };

impl Derivative {
    fn inside(&self, at: i64, last: i64) -> i64 {
        let at = match self.border {
            Border::Reflect if at < 0 => -at,
            Border::Reflect if at > last => 2 * last - at,
            _ => at,
        };
        at.clamp(0, last)
    }

    /// Returns the nine taps, pixel and weight, of a direction around a pixel.
    pub fn taps(&self, size: [usize; 2], p: usize, vertical: bool) -> Vec<(usize, f64)> {
        let [width, height] = size.map(|s| s as i64);
        let (x, y) = (p as i64 % width, p as i64 / width);
        let mut taps = Vec::with_capacity(9);
        for dy in -1..=1_i64 {
            for dx in -1..=1_i64 {
                let (along, across) = if vertical { (dy, dx) } else { (dx, dy) };
                let weight = along as f64 * self.difference * self.smooth[usize::from(across == 0)];
                let at = self.inside(y + dy, height - 1) * width + self.inside(x + dx, width - 1);
                taps.push((at as usize, weight));
            }
        }
        taps
    }
}

/// Applies taps to a channel of interleaved values.
pub fn filtered(taps: &[(usize, f64)], values: &[f64], channels: usize, channel: usize) -> f64 {
    taps.iter().map(|&(q, w)| w * values[q * channels + channel]).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ramp_has_its_slope_inside_and_none_across() {
        let size = [7, 5];
        let ramp: Vec<f64> = (0..35).map(|p| (p % 7) as f64).collect();
        for (filter, slope) in [(SOBEL, 1.0), (FARID, 2.0 * 0.425287)] {
            let inner = filtered(&filter.taps(size, 17, false), &ramp, 1, 0);
            assert!((inner - slope).abs() < 1e-6, "{inner}");
            assert!(filtered(&filter.taps(size, 17, true), &ramp, 1, 0).abs() < 1e-12);
        }
        // At the border, repetition halves the slope, and reflection cancels the slope.
        assert!((filtered(&SOBEL.taps(size, 14, false), &ramp, 1, 0) - 0.5).abs() < 1e-12);
        assert_eq!(filtered(&FARID.taps(size, 14, false), &ramp, 1, 0), 0.0);
    }
}
