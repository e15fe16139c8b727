//! Reference of `relocate`, `position_noise` and the regularizers.
//!
//! Markov chain Monte Carlo of Kheradmand et al. 2024.
//! Corrected scales follow equation 9 as printed, by its binomial sum; the kernels evaluate an integral instead.

use crate::rng::{normal_from, random_bits, uniform_from};

/// Words that set random numbers apart, as in the kernels.
const WEIGHT: u32 = 0x5245_4c4f;
const DRAW: u32 = 0x4341_5445;
const NOISE: u32 = 0x4e4f_4953;

/// Returns an opacity from its logit.
pub fn opacity(logit: f64) -> f64 {
    1.0 / (1.0 + (-logit).exp())
}

/// Returns the integer weight of a living Gaussian among `count` Gaussians. `index`: its position.
pub fn weight(opacity: f64, count: u32, seed: u32, index: u32) -> u32 {
    let scale = ((1 << 19) - 1).min(u32::MAX / count.max(1));
    let random = uniform_from(random_bits(seed ^ WEIGHT, index, 0));
    ((opacity * f64::from(scale) + random) as u32).min(scale)
}

/// Returns the target of a draw among weights of this sum. The drawn Gaussian is the last whose sum of earlier weights is at
/// most the target.
pub fn target(total: u32, seed: u32, draw: u32) -> u32 {
    ((u64::from(random_bits(seed ^ DRAW, draw, 0)) * u64::from(total)) >> 32) as u32
}

/// Returns the number of Gaussians after growth. `cap`: most Gaussians.
pub fn grown(count: u32, cap: u32) -> u32 {
    (count + count / 20).min(cap).max(count)
}

/// Returns the opacity of each of `n` Gaussians in the place of one. Equation 9.
pub fn opacity_of(opacity: f64, n: u32) -> f64 {
    1.0 - (1.0 - opacity).powf(1.0 / f64::from(n))
}

/// Returns the factor on the scales of `n` Gaussians in the place of one.
///
/// Equation 9, with `part` the corrected opacity.
pub fn scale_factor(opacity: f64, part: f64, n: u32) -> f64 {
    let mut sum = 0.0;
    for i in 1..=n {
        // binomial(i - 1, k)
        let mut binomial = 1.0;
        for k in 0..i {
            let sign = if k % 2 == 0 { 1.0 } else { -1.0 };
            sum += binomial * sign * part.powi(k as i32 + 1) / f64::from(k + 1).sqrt();
            binomial *= f64::from(i - 1 - k) / f64::from(k + 1);
        }
    }
    opacity / sum
}

/// Returns the opacity of `n` Gaussians along a line through their centers.
///
/// In units of the integral of one Gaussian of opacity 1. Simpson's rule.
pub fn opacity_along_line(part: f64, n: u32) -> f64 {
    let (steps, end) = (4000, 8.0);
    let h = end / f64::from(steps);
    let f = |k: i32| -(f64::from(n) * (-part * (-(h * f64::from(k)).powi(2)).exp()).ln_1p()).exp_m1();
    let inner: f64 = (1..steps).map(|k| f64::from(2 + 2 * (k % 2)) * f(k)).sum();
    (f(0) + inner + f(steps)) * h / 3.0 * 2.0 / std::f64::consts::PI.sqrt()
}

/// Returns the noise on a mean.
///
/// None for opaque Gaussians, where the sigmoid is below 1e-10. `scale`: scales; `rows`: rotation by rows; `strength`:
/// `Step::noise`.
pub fn noise(logit: f64, scale: [f64; 3], rows: [[f64; 3]; 3], strength: f64, seed: u32, index: u32) -> [f64; 3] {
    let bits = |k| random_bits(seed ^ NOISE, index, k);
    let ([a, b], [c, _]) = (normal_from(bits(0), bits(1)), normal_from(bits(2), bits(3)));
    let normal = [a, b, c];
    let sigmoid = 1.0 / (1.0 + (100.0 * (opacity(logit) - 0.005)).exp());
    let factor = if sigmoid < 1e-10 { 0.0 } else { strength * sigmoid };
    // The covariance R S S Rᵀ, then its product with the normal numbers.
    let covariance: [[f64; 3]; 3] = std::array::from_fn(|i| {
        std::array::from_fn(|j| (0..3).map(|k| rows[i][k] * scale[k].powi(2) * rows[j][k]).sum())
    });
    covariance.map(|row| factor * (0..3).map(|j| row[j] * normal[j]).sum::<f64>())
}

/// Returns the regularizers: weighted means of opacities and scales. `weights`: of opacity and scale.
pub fn regularizer(weights: [f64; 2], logits: &[f64], log_scales: &[f64]) -> f64 {
    let mean = |values: &mut dyn Iterator<Item = f64>, n: usize| values.sum::<f64>() / n.max(1) as f64;
    weights[0] * mean(&mut logits.iter().map(|l| opacity(*l)), logits.len())
        + weights[1] * mean(&mut log_scales.iter().map(|s| s.clamp(-16.0, 8.0).exp()), log_scales.len())
}

/// Returns the gradients of [`regularizer`] by a logit and a log scale.
///
/// `count`: number of Gaussians.
pub fn regularizer_gradient(weights: [f64; 2], logit: f64, log_scale: f64, count: usize) -> [f64; 2] {
    let (n, o) = (count as f64, opacity(logit));
    let scale = if (-16.0..=8.0).contains(&log_scale) { log_scale.exp() } else { 0.0 };
    [weights[0] / n * o * (1.0 - o), weights[1] / (3.0 * n) * scale]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference::difference;
    use crate::rng::Pcg;

    #[test]
    fn binomial_sum_is_the_opacity_along_a_line() {
        for opacity in [0.005, 0.1, 0.5, 0.9, 0.99] {
            for n in [1, 2, 3, 10, 40] {
                let part = opacity_of(opacity, n);
                let (sum, line) = (opacity / scale_factor(opacity, part, n), opacity_along_line(part, n));
                assert!((sum / line - 1.0).abs() < 1e-9, "{opacity} {n}: {sum} {line}");
            }
        }
    }

    #[test]
    fn copies_together_keep_opacity_and_its_integral() {
        let mut rng = Pcg::new(4);
        for _ in 0..100 {
            let (opacity, n) = (rng.range(0.01, 0.99), 1 + rng.next_u32() % 30);
            let part = opacity_of(opacity, n);
            let together = 1.0 - (1.0 - part).powi(n as i32);
            assert!((together - opacity).abs() < 1e-12);
            let factor = scale_factor(opacity, part, n);
            assert!((factor * opacity_along_line(part, n) - opacity).abs() < 1e-9);
            assert!(factor <= 1.0 + 1e-12 && factor > 0.0, "{opacity} {n} {factor}");
        }
    }

    #[test]
    fn gradients_of_regularizers_match_finite_differences() {
        let mut rng = Pcg::new(5);
        let weights = [0.3, 0.7];
        let mut logits: Vec<f64> = (0..6).map(|_| 2.0 * rng.normal()).collect();
        let mut scales: Vec<f64> = (0..18).map(|_| rng.normal()).collect();
        (scales[2], scales[4]) = (-17.0, 9.0);
        for i in 0..18 {
            let gradient = regularizer_gradient(weights, logits[i / 3], scales[i], 6);
            let other = logits.clone();
            let by_scale = difference(&mut scales, i, |s| regularizer(weights, &other, s));
            let scales = scales.clone();
            let by_logit = difference(&mut logits, i / 3, |l| regularizer(weights, l, &scales));
            assert!((by_logit - gradient[0]).abs() < 1e-9 && (by_scale - gradient[1]).abs() < 1e-8);
        }
    }

    #[test]
    fn growth_is_a_twentieth_up_to_the_cap() {
        assert_eq!([grown(19, 100), grown(20, 100), grown(100, 103), grown(100, 50)], [19, 21, 103, 100]);
    }
}
