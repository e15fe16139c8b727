//! Reference of `msg` and `relight`: multi-scale gradients of a difference. `relight` is the difference itself.
//!
//! Written from the definition: every level is computed from the full image by two-dimensional weights, filters are
//! applied tap by tap, and the backward pass scatters.

use super::taps::{FARID, filtered};

/// Number of levels, each half as wide and high as the previous one.
pub const LEVELS: u32 = 4;
/// Constant under the root of the magnitude.
const FLOOR: f64 = 1e-8;

/// Differences per pixel, and the mask of valid pixels.
#[derive(Clone, Debug)]
pub struct Difference {
    /// Columns and rows.
    pub size: [usize; 2],
    /// Numbers per pixel.
    pub channels: usize,
    /// Differences, `[P * channels]`, zero where no value is present.
    pub values: Vec<f64>,
    /// Mask, `[P]`.
    pub present: Vec<bool>,
}

/// Returns the source pixels and weights of each pixel of a level. The weights of a pixel add up to one.
fn tents(size: [usize; 2], small: [usize; 2]) -> Vec<Vec<(usize, f64)>> {
    let axis = |a: usize, at: usize| -> Vec<(usize, f64)> {
        let scale = size[a] as f64 / small[a] as f64;
        let center = (at as f64 + 0.5) * scale;
        let weight = |i: usize| (1.0 - (i as f64 + 0.5 - center).abs() / scale).max(0.0);
        let all: Vec<(usize, f64)> = (0..size[a]).map(|i| (i, weight(i))).filter(|w| w.1 > 0.0).collect();
        let total: f64 = all.iter().map(|w| w.1).sum();
        all.into_iter().map(|(i, w)| (i, w / total)).collect()
    };
    let columns: Vec<_> = (0..small[0]).map(|x| axis(0, x)).collect();
    let rows: Vec<_> = (0..small[1]).map(|y| axis(1, y)).collect();
    let pair = |row: &Vec<(usize, f64)>, column: &Vec<(usize, f64)>| {
        row.iter().flat_map(|&(y, v)| column.iter().map(move |&(x, w)| (y * size[0] + x, v * w))).collect()
    };
    rows.iter().flat_map(|row| columns.iter().map(move |column| pair(row, column))).collect()
}

/// Level, the source pixels of each of its pixels, and the pixels that count.
struct Level {
    of: Difference,
    made_of: Vec<Vec<(usize, f64)>>,
    counts: Vec<bool>,
}

fn level(d: &Difference, l: u32) -> Level {
    let size = d.size.map(|n| (n >> l).max(1));
    let made_of = tents(d.size, size);
    let sum = |w: &Vec<(usize, f64)>, c: usize| w.iter().map(|&(q, w)| w * d.values[q * d.channels + c]).sum();
    let values = made_of.iter().flat_map(|w| (0..d.channels).map(move |c| sum(w, c))).collect();
    let share = |w: &Vec<(usize, f64)>| w.iter().filter(|q| d.present[q.0]).map(|q| q.1).sum::<f64>();
    let present: Vec<bool> = made_of.iter().map(|w| share(w) >= 0.99903).collect();
    let around = |p: usize| {
        let (x, y) = (p % size[0], p / size[0]);
        let rows = y.saturating_sub(1)..(y + 2).min(size[1]);
        rows.flat_map(|y| (x.saturating_sub(1)..(x + 2).min(size[0])).map(move |x| y * size[0] + x)).collect::<Vec<_>>()
    };
    let counts = (0..size[0] * size[1]).map(|p| around(p).into_iter().all(|q| present[q])).collect();
    Level { of: Difference { size, channels: d.channels, values, present }, made_of, counts }
}

/// Returns the loss and its gradient by the differences. A level without pixels that count adds 0.
pub fn msg(d: &Difference) -> (f64, Vec<f64>) {
    let (mut loss, mut gradient) = (0.0, vec![0.0; d.values.len()]);
    for l in 0..LEVELS {
        let level = level(d, l);
        let count = level.counts.iter().filter(|c| **c).count();
        let share = 1.0 / (f64::from(LEVELS) * (count.max(1) * d.channels) as f64);
        let mut by_level = vec![0.0; level.of.values.len()];
        for p in (0..level.counts.len()).filter(|&p| level.counts[p]) {
            let taps = [false, true].map(|vertical| FARID.taps(level.of.size, p, vertical));
            for c in 0..d.channels {
                let g = [0, 1].map(|k| filtered(&taps[k], &level.of.values, d.channels, c));
                let magnitude = (g[0] * g[0] + g[1] * g[1] + FLOOR).sqrt();
                loss += share * magnitude;
                for k in 0..2 {
                    for &(q, w) in &taps[k] {
                        by_level[q * d.channels + c] += share * g[k] / magnitude * w;
                    }
                }
            }
        }
        for (q, made_of) in level.made_of.iter().enumerate() {
            for &(p, w) in made_of {
                (0..d.channels).for_each(|c| gradient[p * d.channels + c] += w * by_level[q * d.channels + c]);
            }
        }
    }
    for (p, present) in d.present.iter().enumerate() {
        if !present {
            gradient[p * d.channels..][..d.channels].fill(0.0);
        }
    }
    (loss, gradient)
}

/// Returns the squared difference and its gradient. The loss is summed over channels and averaged over the pixels that
/// are present.
pub fn square(d: &Difference) -> (f64, Vec<f64>) {
    let count = d.present.iter().filter(|p| **p).count().max(1) as f64;
    let loss = d.values.iter().map(|x| x * x).sum::<f64>() / count;
    (loss, d.values.iter().map(|x| 2.0 * x / count).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference::difference;
    use crate::rng::Pcg;

    fn random(size: [usize; 2], channels: usize, holes: f64) -> Difference {
        let mut rng = Pcg::new((size[0] * 100 + size[1]) as u32);
        let present: Vec<bool> = (0..size[0] * size[1]).map(|_| rng.uniform() >= holes).collect();
        let value = |i: usize| if present[i / channels] { rng.range(-0.5, 0.5) } else { 0.0 };
        let values = (0..present.len() * channels).map(value).collect();
        Difference { size, channels, values, present }
    }

    #[test]
    fn gradients_match_finite_differences() {
        for (size, channels, holes) in [([1, 1], 1, 0.0), ([9, 7], 3, 0.0), ([20, 17], 1, 0.02), ([3, 16], 3, 0.05)] {
            let d = random(size, channels, holes);
            for of in [msg, square] {
                let (_, gradient) = of(&d);
                let mut values = d.values.clone();
                for (i, g) in gradient.iter().enumerate().filter(|(i, _)| d.present[i / channels]) {
                    let loss = |x: &[f64]| of(&Difference { values: x.to_vec(), ..d.clone() }).0;
                    let fd = difference(&mut values, i, loss);
                    assert!((fd - g).abs() < 1e-7 + 1e-4 * fd.abs(), "{size:?} {i}: {fd} {g}");
                }
            }
        }
    }

    #[test]
    fn offset_costs_almost_nothing_and_ramp_costs_its_slope() {
        let flat = Difference { size: [16, 16], channels: 1, values: vec![0.3; 256], present: vec![true; 256] };
        assert!((msg(&flat).0 - 1e-4).abs() < 1e-9);
        let ramp: Vec<f64> = (0..256).map(|p| 0.01 * (p % 16) as f64).collect();
        let loss = msg(&Difference { values: ramp, ..flat.clone() }).0;
        assert!(loss > 0.008 && loss < 0.011, "{loss}");
        assert_eq!(msg(&Difference { present: vec![false; 256], ..flat }).0, 0.0);
    }
}
