//! Merging of light lobes.
//!
//! A lobe is an unnormalized von Mises-Fisher distribution over directions. A merged lobe has the energy of both in
//! each channel and their mean direction. The length of the mean direction determines the sharpness (inverse: Banerjee
//! et al. 2005). The pair whose merging least increases the energy-weighted variance of directions is merged first
//! (Ward 1963), until few enough lobes remain.

use sgs_run::{LightRow, LobeRow};
use std::f64::consts::PI;

type V3 = [f64; 3];

/// Largest sharpness.
/// Sharper lobes look the same, and their energy loses all precision.
const SHARPEST: f64 = 1e4;

/// Returns the integral of exp(sharpness (cosine - 1)) over the sphere.
fn integral(sharpness: f64) -> f64 {
    match sharpness {
        s if s < 1e-6 => 4.0 * PI,
        s => -2.0 * PI * (-2.0 * s).exp_m1() / s,
    }
}

/// Returns the mean cosine of the angle to the axis.
fn concentration(sharpness: f64) -> f64 {
    match sharpness {
        s if s < 1e-3 => s / 3.0,
        s => 1.0 / s.tanh() - 1.0 / s,
    }
}

/// Returns the sharpness of a lobe with this mean cosine.
fn sharpness(mean: f64) -> f64 {
    let square = mean * mean;
    let first = mean * (3.0 - square) / (1.0 - square).max(1e-9);
    // Two steps of Newton's method; the slope is 1 - A^2 - 2 A / s.
    let step = |s: f64| {
        let a = concentration(s);
        let slope = 1.0 - a * a - 2.0 * a / s.max(1e-9);
        if s > 1e-3 && slope > 1e-12 { (s - (a - mean) / slope).max(0.0) } else { s }
    };
    step(step(first)).min(SHARPEST)
}

/// Energy by channel, and the mean direction.
#[derive(Clone, Copy)]
struct Moments {
    energy: V3,
    mean: V3,
}

impl Moments {
    fn of(l: &LobeRow) -> Moments {
        let (s, size) = (f64::from(l.sharpness).min(SHARPEST), integral(f64::from(l.sharpness).min(SHARPEST)));
        let a = concentration(s);
        Moments { energy: l.amplitude.map(|x| size * f64::from(x)), mean: l.axis.map(|x| a * f64::from(x)) }
    }

    fn all(&self) -> f64 {
        self.energy.iter().sum()
    }

    fn with(&self, other: &Moments) -> Moments {
        let (a, b) = (self.all(), other.all());
        let share = if a + b > 0.0 { b / (a + b) } else { 0.5 };
        Moments {
            energy: std::array::from_fn(|c| self.energy[c] + other.energy[c]),
            mean: std::array::from_fn(|k| (1.0 - share) * self.mean[k] + share * other.mean[k]),
        }
    }

    /// Returns the increase of the energy-weighted variance of directions by a merge.
    fn price(&self, other: &Moments) -> f64 {
        let (a, b) = (self.all(), other.all());
        if a + b <= 0.0 {
            return 0.0;
        }
        a * b / (a + b) * (0..3).map(|k| (self.mean[k] - other.mean[k]).powi(2)).sum::<f64>()
    }

    fn lobe(&self) -> LobeRow {
        let length = self.mean.iter().map(|x| x * x).sum::<f64>().sqrt();
        let axis = if length > 1e-9 { self.mean.map(|x| (x / length) as f32) } else { [0.0, 0.0, 1.0] };
        let s = sharpness(length);
        LobeRow { axis, sharpness: s as f32, amplitude: self.energy.map(|e| (e / integral(s)) as f32) }
    }
}

/// Merges a light's lobes until at most `lobes`, and at least one, remain.
/// A light with fewer lobes stays unchanged.
pub(super) fn merged(light: &LightRow, lobes: usize) -> LightRow {
    if light.lobes.len() <= lobes.max(1) {
        return light.clone();
    }
    // Lobes that are not merged stay equal bit for bit.
    let mut left: Vec<(Moments, Option<LobeRow>)> = light.lobes.iter().map(|l| (Moments::of(l), Some(*l))).collect();
    while left.len() > lobes.max(1) {
        let (mut pair, mut least) = ((0, 1), f64::INFINITY);
        for i in 0..left.len() {
            for k in i + 1..left.len() {
                let price = left[i].0.price(&left[k].0);
                if price < least {
                    (pair, least) = ((i, k), price);
                }
            }
        }
        let (other, _) = left.remove(pair.1);
        left[pair.0] = (left[pair.0].0.with(&other), None);
    }
    let lobes = left.into_iter().map(|(moments, own)| own.unwrap_or_else(|| moments.lobe())).collect();
    LightRow { lobes, ..light.clone() }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lobe(axis: [f32; 3], sharpness: f32, amplitude: f32) -> LobeRow {
        LobeRow { axis, sharpness, amplitude: [amplitude, 0.5 * amplitude, 0.0] }
    }

    fn light(lobes: Vec<LobeRow>) -> LightRow {
        LightRow { position: [1.0, 2.0, 3.0], gain: 0.7, lobes }
    }

    fn energy(light: &LightRow) -> V3 {
        let of = |c: usize| light.lobes.iter().map(|l| f64::from(l.amplitude[c]) * integral(l.sharpness.into())).sum();
        [of(0), of(1), of(2)]
    }

    #[test]
    fn sharpness_inverts_the_mean_cosine() {
        for s in [1e-4, 0.01, 0.5, 1.0, 7.0, 100.0, 9000.0] {
            let found = sharpness(concentration(s));
            assert!((found - s).abs() < 0.02 * s + 1e-6, "{s}: {found}");
        }
        assert!((integral(0.0) - 4.0 * PI).abs() < 1e-12 && (integral(1e-5) / (4.0 * PI) - 1.0).abs() < 1e-4);
    }

    #[test]
    fn similar_lobes_merge_first_and_preserve_energy() {
        let x = lobe([1.0, 0.0, 0.0], 8.0, 2.0);
        let near = lobe([0.995, 0.0998, 0.0], 8.0, 1.0);
        let away = lobe([0.0, 0.0, -1.0], 20.0, 5.0);
        let dark = lobe([0.0, 1.0, 0.0], 3.0, 0.0);
        let all = light(vec![x, away, near, dark]);
        let three = merged(&all, 3);
        // The dark lobe merges at no cost, whatever its axis, and changes no other lobe.
        assert_eq!(three.lobes.len(), 3);
        let two = merged(&all, 2);
        assert!(two.lobes.len() == 2 && (two.position, two.gain) == (all.position, all.gain));
        assert!(two.lobes[1] == away && (two.lobes[0].axis[0] - 1.0).abs() < 1e-2, "{two:?}");
        for count in 1..4 {
            let (a, b) = (energy(&all), energy(&merged(&all, count)));
            (0..3).for_each(|c| assert!((a[c] - b[c]).abs() < 1e-4 * a[0], "{count}: {a:?} {b:?}"));
        }
        // Two equal lobes merge into the same lobe with twice the amplitude.
        let double = merged(&light(vec![x, x]), 1).lobes[0];
        assert!((double.sharpness - 8.0).abs() < 0.05 && (double.amplitude[0] - 4.0).abs() < 0.03, "{double:?}");
        // Two opposite lobes merge into a uniform one.
        let opposite = merged(&light(vec![lobe([0.0, 0.0, 1.0], 2.0, 1.0), lobe([0.0, 0.0, -1.0], 2.0, 1.0)]), 1);
        assert!(opposite.lobes[0].sharpness < 1e-3 && opposite.lobes[0].amplitude.iter().all(|a| a.is_finite()));
        assert_eq!(merged(&all, 0).lobes.len(), 1);
        assert!(merged(&all, 4) == all && merged(&all, 9) == all);
        let black = merged(&light(vec![dark; 5]), 2);
        assert!(black.lobes.len() == 2 && energy(&black) == [0.0; 3]);
    }
}
