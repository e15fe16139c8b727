//! Priors with equal gains in all views, and albedo priors without retained light.
//!
//! Networks estimate albedo photograph by photograph. Their estimates differ by a gain from view to view, and keep a part of
//! shading and shadows: prior = gain · albedo · light^r. The gains follow from Gaussians that several views show. The
//! light follows from the photograph, photograph = albedo · light, so that albedo is (prior / gain)^(1 / (1 - r)) / photograph^(r / (1 - r)).
//!
//! [`Pairs::residue`] measures r: between two points of the same material, photograph and prior change by light and light^r. Most pairs of
//! pixels at some distance show the same material, the others are outliers of a robust fit.
//!
//! Estimates of roughness differ by a gain from view to view, too, but keep no light.

use rayon::prelude::*;
use sgs_passes::pipeline::WeightColumns;
use sgs_scene::{linear_to_srgb, srgb_to_linear};

/// Maximum number of Gaussians that gains are derived from.
const MOST: usize = 65_536;
/// Number of rounds of the solution for gains.
const ROUNDS: usize = 100;
/// Added to colors, so that black has a logarithm.
const FLOOR: f32 = 0.01;
/// Most that the logarithm of light may differ from its mean.
const RANGE: f32 = 2.5;
/// Least sum of weights, in pixels, with which a Gaussian counts in a view.
const LEAST: f32 = 0.5;

/// Distances of pairs of pixels, as shares of the image's width.
const APART: [f64; 3] = [0.1, 0.2, 0.3];
/// Least cosine between the normals of a pair.
const ALIKE: f32 = 0.9;
/// Luminance that the pixels of a pair exceed: of priors, then of photographs.
const DARK: [f32; 2] = [0.05, 0.02];
/// Linear color from which photographs may be clipped.
const BRIGHT: f32 = 0.9;
/// Difference of logarithms from which pairs are outliers.
const OUTLIER: f32 = 0.1;
/// Candidates of the power of retained light: 0 to 0.5.
const CANDIDATES: usize = 51;
/// Maximum number of pairs.
const PAIRS: usize = 1 << 21;
/// Least number of pairs that a power is measured with.
const LEAST_PAIRS: usize = 1000;

/// Changes of priors and photographs between two points.
#[derive(Default)]
pub(super) struct Pairs {
    /// Changes of the logarithms of prior and photograph.
    changes: Vec<[f32; 2]>,
}

impl Pairs {
    /// Adds the pairs of one of `views` views.
    pub fn add(
        &mut self,
        [width, height]: [usize; 2],
        normals: &[f32],
        [prior, photograph]: [&[u32]; 2],
        views: usize,
    ) {
        let value = |i: usize| {
            let (a, b) = (*prior.get(i)?, *photograph.get(i)?);
            let (estimate, seen) = (luminance(linear(a)), luminance(linear(b)));
            let within = estimate > DARK[0] && seen > DARK[1] && linear(b).iter().all(|v| *v < BRIGHT);
            (a >> 24 != 0 && b >> 24 != 0 && within).then(|| [estimate.ln(), seen.ln()])
        };
        let values: Vec<Option<[f32; 2]>> = (0..width * height).map(value).collect();
        // Whether the surfaces of two pixels face the same way.
        let alike = |i: usize, j: usize| (0..3).map(|k| normals[3 * i + k] * normals[3 * j + k]).sum::<f32>() > ALIKE;
        let all = 2 * APART.len() * width * height * views;
        let stride = (all / PAIRS).isqrt().max(1);
        for share in APART {
            let apart = ((share * width as f64).round() as usize).max(1);
            for (right, down) in [(apart, 0), (0, apart)] {
                for y in (0..height.saturating_sub(down)).step_by(stride) {
                    for x in (0..width.saturating_sub(right)).step_by(stride) {
                        let (i, j) = (y * width + x, (y + down) * width + x + right);
                        if let (Some(a), Some(b), true) = (values[i], values[j], alike(i, j)) {
                            self.changes.push([b[0] - a[0], b[1] - a[1]]);
                        }
                    }
                }
            }
        }
    }

    /// Returns the power of the light that priors retain.
    pub fn residue(&self) -> f64 {
        if self.changes.len() < LEAST_PAIRS {
            return 0.0;
        }
        let cost = |candidate: usize| -> f64 {
            let power = candidate as f32 * 0.01;
            // Summed in chunks of a fixed size: the order does not depend on the number of threads.
            let part = |changes: &[[f32; 2]]| -> f64 {
                changes.iter().map(|[prior, seen]| f64::from((prior - power * seen).abs().min(OUTLIER))).sum()
            };
            self.changes.par_chunks(4096).map(part).collect::<Vec<_>>().iter().sum()
        };
        let costs: Vec<f64> = (0..CANDIDATES).map(cost).collect();
        let best = (0..CANDIDATES).min_by(|a, b| costs[*a].total_cmp(&costs[*b])).unwrap_or(0);
        best as f64 * 0.01
    }
}

fn luminance(c: [f32; 3]) -> f32 {
    0.2127 * c[0] + 0.7152 * c[1] + 0.0722 * c[2]
}

/// Mean log prior of Gaussians in the views that show them.
pub(super) struct SharedPriors {
    stride: usize,
    /// Values of a packed prior.
    values: fn(u32) -> [f32; 3],
    /// By view: Gaussian, weight and mean.
    views: Vec<Vec<(u32, f32, [f32; 3])>>,
}

/// Returns the linear color of a packed prior or photograph.
pub(super) fn linear(word: u32) -> [f32; 3] {
    plain(word).map(srgb_to_linear)
}

/// Returns the values of a packed prior that is not encoded.
pub(super) fn plain(word: u32) -> [f32; 3] {
    [0, 8, 16].map(|shift| (word >> shift & 0xff) as f32 / 255.0)
}

fn log(color: [f32; 3]) -> [f32; 3] {
    color.map(|v| (v + FLOOR).ln())
}

fn mean(v: [f32; 3]) -> f32 {
    (v[0] + v[1] + v[2]) / 3.0
}

impl SharedPriors {
    /// Prepares for this number of Gaussians. `values` unpacks a prior.
    pub fn new(gaussians: usize, values: fn(u32) -> [f32; 3]) -> SharedPriors {
        SharedPriors { stride: gaussians.div_ceil(MOST).max(1), values, views: Vec::new() }
    }

    /// Adds the next view.
    pub fn add(&mut self, columns: &WeightColumns, packed: &[u32]) {
        let gaussians = columns.starts.len().saturating_sub(1);
        let of = |gaussian: usize| {
            let (mut sum, mut all) = ([0.0; 3], 0.0);
            for (pixel, weight) in columns.of(gaussian) {
                let word = packed.get(pixel).copied().unwrap_or(0);
                if word >> 24 != 0 && weight.is_finite() {
                    let value = log((self.values)(word));
                    (0..3).for_each(|k| sum[k] += weight * value[k]);
                    all += weight;
                }
            }
            (all >= LEAST).then(|| (gaussian as u32, all, sum.map(|s| s / all)))
        };
        self.views.push((0..gaussians).into_par_iter().step_by(self.stride).filter_map(of).collect());
    }

    /// Returns the logarithms of the views' gains. Their mean is 0.
    ///
    /// Alternates between the Gaussians' means over all views, without gains, and the gains that these means leave.
    pub fn log_gains(&self) -> Vec<[f32; 3]> {
        let mut gains = vec![[0.0_f32; 3]; self.views.len()];
        let count = self.views.iter().flatten().map(|v| v.0 as usize / self.stride + 1).max().unwrap_or(0);
        for _ in 0..ROUNDS {
            let mut sums = vec![[0.0_f64; 4]; count];
            for (view, gain) in self.views.iter().zip(&gains) {
                for (gaussian, weight, value) in view {
                    let sum = &mut sums[*gaussian as usize / self.stride];
                    (0..3).for_each(|k| sum[k] += f64::from(weight * (value[k] - gain[k])));
                    sum[3] += f64::from(*weight);
                }
            }
            for (view, gain) in self.views.iter().zip(&mut gains) {
                let (mut off, mut all) = ([0.0_f64; 3], 0.0);
                for (gaussian, weight, value) in view {
                    let sum = &sums[*gaussian as usize / self.stride];
                    let mean = |k: usize| sum[k] / sum[3];
                    (0..3).for_each(|k| off[k] += f64::from(*weight) * (f64::from(value[k]) - mean(k)));
                    all += f64::from(*weight);
                }
                *gain = if all > 0.0 { off.map(|o| (o / all) as f32) } else { *gain };
            }
            let level: [f32; 3] =
                std::array::from_fn(|k| gains.iter().map(|g| g[k]).sum::<f32>() / gains.len().max(1) as f32);
            gains.iter_mut().for_each(|g| (0..3).for_each(|k| g[k] -= level[k]));
        }
        gains
    }
}

/// Removes gains from packed priors that are not encoded.
pub(super) fn equalize(packed: &mut [Vec<u32>], log_gains: &[[f32; 3]]) {
    packed.par_iter_mut().zip(log_gains).for_each(|(priors, gain)| {
        for prior in priors.iter_mut().filter(|prior| **prior >> 24 != 0) {
            let value = log(plain(*prior));
            let byte = |k: usize| {
                let value = ((value[k] - gain[k]).exp() - FLOOR).clamp(0.0, 1.0);
                ((255.0 * value).round() as u32) << (8 * k)
            };
            *prior = (*prior & 0xff00_0000) | byte(0) | byte(1) | byte(2);
        }
    });
}

/// Removes gains and retained light from packed albedo priors.
///
/// `photographs` are packed alike. `residue` is the power of the light that the priors retain.
pub(super) fn correct(packed: &mut [Vec<u32>], photographs: &[Vec<u32>], log_gains: &[[f32; 3]], residue: f64) {
    let share = (residue / (1.0 - residue)) as f32;
    let light = |prior: u32, photograph: u32, gain: [f32; 3]| {
        mean(log(linear(photograph))) - (mean(log(linear(prior))) - mean(gain))
    };
    let known = |prior: u32, photograph: u32| prior >> 24 != 0 && photograph >> 24 != 0;
    let (mut sum, mut count) = (0.0_f64, 0_u64);
    for ((priors, photograph), gain) in packed.iter().zip(photographs).zip(log_gains) {
        for (prior, photograph) in priors.iter().zip(photograph).filter(|(a, b)| known(**a, **b)) {
            sum += f64::from(light(*prior, *photograph, *gain));
            count += 1;
        }
    }
    let level = (sum / count.max(1) as f64) as f32;
    packed.par_iter_mut().zip(photographs).zip(log_gains).for_each(|((priors, photograph), gain)| {
        for (prior, photograph) in priors.iter_mut().zip(photograph).filter(|(a, b)| known(**a, **b)) {
            let off = share * (light(*prior, *photograph, *gain) - level).clamp(-RANGE, RANGE);
            let value = log(linear(*prior));
            let of = |k: usize| linear_to_srgb(((value[k] - gain[k] - off).exp() - FLOOR).clamp(0.0, 1.0));
            let byte = |k: usize| ((255.0 * of(k)).round() as u32) << (8 * k);
            *prior = (*prior & 0xff00_0000) | byte(0) | byte(1) | byte(2);
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: [usize; 2] = [60, 40];
    const RETAINED: f32 = 0.2;

    fn word(color: [f32; 3]) -> u32 {
        let byte = |k: usize| ((255.0 * linear_to_srgb(color[k].clamp(0.0, 1.0))).round() as u32) << (8 * k);
        0xff00_0000 | byte(0) | byte(1) | byte(2)
    }

    /// Returns albedo, prior and photograph of a pixel: stripes of two materials under smooth light.
    fn pixel(x: usize, y: usize, gain: f32, retained: f32) -> ([f32; 3], u32, u32) {
        let albedo = if (x / 15).is_multiple_of(2) { [0.5, 0.4, 0.3] } else { [0.25, 0.3, 0.35] };
        let light = 0.3 + 1.2 * (y as f32 / SIZE[1] as f32) * (0.4 + 0.6 * x as f32 / SIZE[0] as f32);
        (albedo, word(albedo.map(|a| gain * a * light.powf(retained))), word(albedo.map(|a| a * light)))
    }

    fn view(gain: f32, retained: f32) -> (Vec<[f32; 3]>, Vec<u32>, Vec<u32>) {
        let mut all = (Vec::new(), Vec::new(), Vec::new());
        for i in 0..SIZE[0] * SIZE[1] {
            let (albedo, prior, photograph) = pixel(i % SIZE[0], i / SIZE[0], gain, retained);
            all.0.push(albedo);
            all.1.push(prior);
            all.2.push(photograph);
        }
        all
    }

    #[test]
    fn retained_light_is_measured_from_pairs_of_one_material() {
        let normals = [0.0, 0.0, 1.0].repeat(SIZE[0] * SIZE[1]);
        for retained in [0.0, 0.1, RETAINED] {
            let (_, prior, photograph) = view(1.0, retained);
            let mut pairs = Pairs::default();
            pairs.add(SIZE, &normals, [&prior, &photograph], 1);
            let found = pairs.residue();
            assert!((found - f64::from(retained)).abs() < 0.035, "{found} instead of {retained}");
        }
        // Surfaces that face different ways are no pairs, and too few pairs say nothing.
        let (_, prior, photograph) = view(1.0, RETAINED);
        let turned: Vec<f32> =
            (0..SIZE[0] * SIZE[1]).flat_map(|i| if i.is_multiple_of(2) { [1.0, 0.0, 0.0] } else { [0.0; 3] }).collect();
        let mut pairs = Pairs::default();
        pairs.add([3, 2], &turned, [&prior, &photograph], 1);
        assert_eq!(pairs.residue(), 0.0);
    }

    #[test]
    fn corrected_priors_are_the_albedo() {
        let gains = [0.8_f32, 1.25, 1.0];
        let views: Vec<_> = gains.iter().map(|gain| view(*gain, RETAINED)).collect();
        // One Gaussian per pixel, seen by all views.
        let count = SIZE[0] * SIZE[1];
        let columns = WeightColumns {
            starts: (0..=count as u32).collect(),
            pixels: (0..count as u32).collect(),
            weights: vec![1.0; count],
        };
        let mut shared = SharedPriors::new(count, linear);
        views.iter().for_each(|(_, prior, _)| shared.add(&columns, prior));
        let found = shared.log_gains();
        for (gain, found) in gains.iter().zip(&found) {
            assert!(found.iter().all(|f| (f.exp() / gain - 1.0).abs() < 0.02), "{found:?} instead of {gain}");
        }
        let mut priors: Vec<Vec<u32>> = views.iter().map(|v| v.1.clone()).collect();
        let photographs: Vec<Vec<u32>> = views.iter().map(|v| v.2.clone()).collect();
        priors[0][7] = 0;
        correct(&mut priors, &photographs, &found, f64::from(RETAINED));
        assert_eq!(priors[0][7], 0, "an unknown prior stays unknown");
        // Up to a constant factor, which keeps the mean of the priors.
        let ratio = |i: usize, view: usize| linear(priors[view][i])[0] / views[view].0[i][0];
        let all: Vec<f32> =
            (0..count).filter(|i| *i != 7).flat_map(|i| [ratio(i, 0), ratio(i, 1), ratio(i, 2)]).collect();
        let (low, high) = all.iter().fold((f32::MAX, 0.0_f32), |(a, b), r| (a.min(*r), b.max(*r)));
        assert!(high / low < 1.08 && (0.8..1.25).contains(&low), "{low} to {high}");
        let before = |i: usize| linear(views[0].1[i])[0] / views[0].0[i][0];
        assert!(before(count - 1) / before(0) > 1.2, "the priors were wrong");
    }

    #[test]
    fn roughness_of_all_views_has_one_gain() {
        let count = 600;
        let roughness = |i: usize| 0.2 + 0.6 * (i % 7) as f32 / 7.0;
        let pack = |value: f32| 0xff00_0000 | (((255.0 * value).round() as u32) * 0x01_0101);
        let gains = [0.85_f32, 1.1, 1.0];
        let mut priors: Vec<Vec<u32>> =
            gains.iter().map(|gain| (0..count).map(|i| pack(gain * roughness(i))).collect()).collect();
        priors[1][5] = 0;
        let columns = WeightColumns {
            starts: (0..=count as u32).collect(),
            pixels: (0..count as u32).collect(),
            weights: vec![1.0; count],
        };
        let mut shared = SharedPriors::new(count, plain);
        priors.iter().for_each(|prior| shared.add(&columns, prior));
        equalize(&mut priors, &shared.log_gains());
        assert_eq!(priors[1][5], 0, "an unknown prior stays unknown");
        let level = (0.85_f32 * 1.1).cbrt();
        for prior in &priors {
            for (i, word) in prior.iter().enumerate().filter(|(_, word)| **word != 0) {
                let (found, right) = (plain(*word)[0], level * roughness(i));
                assert!((found - right).abs() < 0.012, "{found} instead of {right}");
            }
        }
    }
}
