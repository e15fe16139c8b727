//! Reference of `densify`: verdicts, slots, and the halves of a split.
//!
//! Slots are filled one by one, rather than through ranks and prefix sums as in the kernels.

use crate::rng::{normal_from, random_bits};

/// Thresholds, as in `Densify` of `densify.glsl`.
#[derive(Clone, Copy, Debug)]
pub struct Settings {
    /// Minimum mean screen gradient of a Gaussian that is refined.
    pub grad_threshold: f64,
    /// Minimum mean gradient of the raw normal that also causes refinement; 0 for none.
    pub normal_threshold: f64,
    /// Size of the largest axis above which to split instead of clone.
    pub split_size: f64,
    /// Opacity below which a Gaussian is pruned.
    pub prune_opacity: f64,
    /// Sum of blending weights below which a Gaussian is pruned.
    pub prune_weight: f64,
    /// Size of the largest axis above which a Gaussian is pruned.
    pub prune_size: f64,
    /// Maximum number of Gaussians afterwards.
    pub cap: usize,
    /// Seed of the random numbers.
    pub seed: u32,
}

/// Inputs of a Gaussian's verdict.
#[derive(Clone, Copy, Debug)]
pub struct Candidate {
    /// Center.
    pub mean: [f64; 3],
    /// Logarithms of scales.
    pub log_scale: [f64; 3],
    /// Quaternion w, x, y, z.
    pub rotation: [f64; 4],
    /// Opacity before the sigmoid.
    pub opacity_logit: f64,
    /// Band 0 of the spherical harmonics.
    pub sh0: [f64; 3],
    /// Densification statistics. Sum of screen gradients, their number, sum of blending weights, sum of gradients of
    /// the raw normal.
    pub statistics: [f64; 4],
}

/// Decision about a Gaussian.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// Keeps the Gaussian.
    Keep,
    /// Removes the Gaussian; `valid` if all of its numbers are finite.
    Prune {
        /// Whether the Gaussian could stay if all others are removed.
        valid: bool,
    },
    /// Clones the Gaussian.
    Clone {
        /// Priority among the Gaussians to be refined.
        strength: u32,
    },
    /// Replaces the Gaussian by two smaller ones.
    Split {
        /// Priority among the Gaussians to be refined.
        strength: u32,
    },
}

impl Verdict {
    fn strength(self) -> Option<u32> {
        match self {
            Verdict::Clone { strength } | Verdict::Split { strength } => Some(strength),
            _ => None,
        }
    }
}

/// Origin of the Gaussian in a slot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Origin {
    /// Unchanged Gaussian of that slot.
    Same(usize),
    /// Clone of the Gaussian in that slot, without moments.
    Duplicate(usize),
    /// Half of the split Gaussian in that slot, without moments.
    Half(usize, u32),
}

/// Returns the verdict on a Gaussian. Kerbl et al. 2023, section 5.2; pruning by weight: SGS-Intrinsic.
pub fn verdict(c: &Candidate, s: &Settings) -> Verdict {
    let numbers = [&c.mean[..], &c.log_scale, &c.rotation, &[c.opacity_logit], &c.sh0];
    let valid = numbers.iter().all(|n| n.iter().all(|x| x.is_finite()));
    if !valid {
        return Verdict::Prune { valid };
    }
    let opacity = 1.0 / (1.0 + (-c.opacity_logit).exp());
    let largest = c.log_scale.iter().fold(f64::MIN, |a, &b| a.max(b)).clamp(-80.0, 80.0).exp();
    if opacity < s.prune_opacity || c.statistics[2] < s.prune_weight || largest > s.prune_size {
        return Verdict::Prune { valid };
    }
    let count = c.statistics[1].max(1.0);
    let (mut gradient, by_normal) = (c.statistics[0] / count, c.statistics[3] / count);
    let by_normals = s.normal_threshold > 0.0 && by_normal >= s.normal_threshold;
    if !gradient.is_finite() || (gradient < s.grad_threshold && !by_normals) {
        return Verdict::Keep;
    }
    if s.normal_threshold > 0.0 {
        gradient = gradient.max(by_normal / s.normal_threshold * s.grad_threshold);
    }
    // Eight steps per octave: the leading bits of the single-precision number.
    let strength = 1 + ((gradient.max(0.0) as f32).to_bits() >> 20);
    if largest > s.split_size { Verdict::Split { strength } } else { Verdict::Clone { strength } }
}

/// Returns whether a Gaussian is pruned only for a lack of blending weight. Its numbers are finite, and its opacity is
/// sufficient.
pub fn weightless(c: &Candidate, s: &Settings) -> bool {
    let goes = verdict(c, s) == Verdict::Prune { valid: true };
    goes && 1.0 / (1.0 + (-c.opacity_logit).exp()) >= s.prune_opacity && c.statistics[2] < s.prune_weight
}

/// Returns the accepted Gaussians in placement order, and the number of rejections.
fn accepted(verdicts: &[Verdict], room: usize) -> (Vec<usize>, usize) {
    let strength = |i: &usize| verdicts[*i].strength().unwrap_or(0);
    let mut wanted: Vec<usize> = (0..verdicts.len()).filter(|&i| verdicts[i].strength().is_some()).collect();
    if wanted.len() <= room {
        return (wanted, 0);
    }
    wanted.sort_by_key(|i| (u32::MAX - strength(i), *i));
    let cutoff = strength(&wanted[room]);
    let refused = wanted.split_off(room).len();
    wanted.sort_by_key(|i| (strength(i) <= cutoff, *i));
    (wanted, refused)
}

/// Returns the slots after densification, and the number of rejected refinements.
pub fn layout(verdicts: &[Verdict], cap: usize) -> (Vec<Origin>, usize) {
    let pruned = |v: &Verdict| matches!(v, Verdict::Prune { .. });
    let mut slots: Vec<Option<Origin>> =
        verdicts.iter().enumerate().map(|(i, v)| (!pruned(v)).then_some(Origin::Same(i))).collect();
    if slots.iter().all(Option::is_none) && !slots.is_empty() {
        let spared = verdicts.iter().position(|v| *v == Verdict::Prune { valid: true }).unwrap_or(0);
        slots[spared] = Some(Origin::Same(spared));
    }
    let remaining = slots.iter().flatten().count();
    let (parents, refused) = accepted(verdicts, cap.saturating_sub(remaining));
    for parent in parents {
        let child = if matches!(verdicts[parent], Verdict::Split { .. }) {
            slots[parent] = Some(Origin::Half(parent, 0));
            Origin::Half(parent, 1)
        } else {
            Origin::Duplicate(parent)
        };
        match slots.iter_mut().find(|s| s.is_none()) {
            Some(slot) => *slot = Some(child),
            None => slots.push(Some(child)),
        }
    }
    let after = slots.iter().flatten().count();
    let beyond: Vec<Origin> = slots.split_off(after).into_iter().flatten().collect();
    let mut beyond = beyond.into_iter();
    let filled = slots.into_iter().map(|s| s.or_else(|| beyond.next())).collect::<Option<Vec<_>>>();
    (filled.unwrap_or_default(), refused)
}

/// Returns the center and the logarithms of scales of one half of a split.
pub fn half(c: &Candidate, parent: usize, which: u32, seed: u32) -> ([f64; 3], [f64; 3]) {
    let bits = |k| random_bits(seed, parent as u32, 4 * which + k);
    let ([a, b], [d, _]) = (normal_from(bits(0), bits(1)), normal_from(bits(2), bits(3)));
    let scaled: Vec<f64> = [a, b, d].iter().zip(c.log_scale).map(|(n, s)| n * s.clamp(-16.0, 8.0).exp()).collect();
    let norm = c.rotation.iter().map(|q| q * q).sum::<f64>().sqrt();
    let [w, x, y, z] = if norm > 0.0 { c.rotation.map(|q| q / norm) } else { [1.0, 0.0, 0.0, 0.0] };
    let rows = [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ];
    let offset = rows.map(|r| r.iter().zip(&scaled).map(|(r, s)| r * s).sum::<f64>());
    let mean = [0, 1, 2].map(|k| c.mean[k] + offset[k]);
    (mean, c.log_scale.map(|s| s - 1.6_f64.ln()))
}

#[cfg(test)]
mod tests {
    use super::*;
    const KEEP: Verdict = Verdict::Keep;
    const PRUNE: Verdict = Verdict::Prune { valid: true };

    #[test]
    fn new_gaussians_fill_holes_and_the_tail_fills_the_rest() {
        let clone = Verdict::Clone { strength: 5 };
        let (slots, refused) = layout(&[PRUNE, KEEP, PRUNE, PRUNE, clone, KEEP], 100);
        assert_eq!(
            (slots, refused),
            (vec![Origin::Duplicate(4), Origin::Same(1), Origin::Same(4), Origin::Same(5)], 0)
        );
        let split = Verdict::Split { strength: 5 };
        let (slots, _) = layout(&[split, KEEP], 100);
        assert_eq!(slots, [Origin::Half(0, 0), Origin::Same(1), Origin::Half(0, 1)]);
    }

    #[test]
    fn strongest_are_refined_first_under_a_cap() {
        let of = |strength| Verdict::Clone { strength };
        let (slots, refused) = layout(&[of(1), of(3), of(2), of(2), of(9)], 8);
        assert_eq!(slots[5..], [Origin::Duplicate(1), Origin::Duplicate(4), Origin::Duplicate(2)]);
        assert_eq!(refused, 2);
        assert_eq!(layout(&[of(1), of(3)], 1), (vec![Origin::Same(0), Origin::Same(1)], 2));
    }

    #[test]
    fn at_least_one_gaussian_remains() {
        let bad = Verdict::Prune { valid: false };
        assert_eq!(layout(&[bad, bad, PRUNE, PRUNE], 100).0, [Origin::Same(2)]);
        assert_eq!(layout(&[bad, bad], 100).0, [Origin::Same(0)]);
        assert_eq!(layout(&[], 100).0, []);
    }
}
