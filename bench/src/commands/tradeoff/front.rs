//! Which choices are worth choosing: those that no other beats, as far as times can be told apart.

use std::fmt;

/// Times closer than this are never told apart.
const LEAST: f64 = 0.01;

/// How a choice compares with all others.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Standing {
    /// No other is as close and not slower.
    Front,
    /// Another is as close and, by less than what times vary, not slower.
    Tie,
    /// Another is as close and surely faster.
    #[default]
    Beaten,
}

impl fmt::Display for Standing {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Standing::Front => "yes",
            Standing::Tie => "within noise",
            Standing::Beaten => "",
        })
    }
}

/// By which share times differ that should be the same: what nine in ten choices' least times of the first and of the second half of
/// their rounds stay below. `samples`: of each choice, in order.
pub fn noise<'a>(samples: impl Iterator<Item = &'a [f64]>) -> f64 {
    let least = |s: &[f64]| s.iter().copied().fold(f64::INFINITY, f64::min);
    let off = |s: &'a [f64]| {
        let (first, second) = s.split_at(s.len() / 2);
        let (a, b) = (least(first), least(second));
        (a.is_finite() && b.is_finite() && a > 0.0).then(|| (a - b).abs() / a.min(b))
    };
    let mut all: Vec<f64> = samples.filter_map(off).collect();
    all.sort_by(f64::total_cmp);
    all.get((all.len() * 9).div_ceil(10).saturating_sub(1)).copied().unwrap_or(0.0).max(LEAST)
}

/// Where each stands: `all` are time and error, errors within one percent of each other are the same.
pub fn standings(all: &[(f64, f64)], noise: f64) -> Vec<Standing> {
    let of = |p: &(f64, f64)| {
        let close = || all.iter().filter(|o| o.1 <= p.1);
        let closer = |o: &(f64, f64)| o.1 < 0.99 * p.1;
        if close().any(|o| o.0 < (1.0 - noise) * p.0) {
            Standing::Beaten
        } else if close().any(|o| o.0 <= p.0 && closer(o)) {
            Standing::Tie
        } else {
            Standing::Front
        }
    };
    all.iter().map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use Standing::{Beaten, Front, Tie};

    #[test]
    fn the_front_is_what_nothing_beats() {
        let all = [(10.0, 1e-7), (12.0, 1e-3), (5.0, 1e-2), (5.5, 2e-2)];
        assert_eq!(standings(&all, 0.05), [Front, Beaten, Front, Beaten]);
        // Where the same is measured twice, both stand; what is no faster for its error does not, if that is sure.
        let all = [(10.0, 1e-7), (9.9, 1e-7), (10.1, 1e-3), (9.8, 1e-3), (10.3, 1e-7)];
        assert_eq!(standings(&all, 0.05), [Front, Front, Tie, Front, Front]);
        assert_eq!(standings(&all, 0.01), [Front, Front, Beaten, Front, Beaten]);
        assert_eq!(Tie.to_string(), "within noise");
    }

    #[test]
    fn noise_is_how_far_halves_differ() {
        let same: Vec<Vec<f64>> = (0..9).map(|_| vec![3.0, 2.0, 2.1, 5.0]).collect();
        assert!((noise(same.iter().map(Vec::as_slice)) - 0.05).abs() < 1e-12);
        // One in ten may be anything; two may not.
        let wild = |n: usize| -> Vec<Vec<f64>> {
            (0..10).map(|i| if i < n { vec![1.0, 2.0] } else { vec![1.0, 1.02] }).collect()
        };
        assert!((noise(wild(1).iter().map(Vec::as_slice)) - 0.02).abs() < 1e-12);
        assert!((noise(wild(2).iter().map(Vec::as_slice)) - 1.0).abs() < 1e-12);
        // Of one sample nothing is known.
        assert_eq!(noise([[4.0].as_slice()].into_iter()), LEAST);
    }
}
