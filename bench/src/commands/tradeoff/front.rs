//! Pareto front: choices that no other choice beats, within the resolution of times.
//!
//! Equivalent choices are not ranked: their time depends on the device, and they trade no accuracy.

use super::choices::Kind;
use crate::report::standing;
use crate::stats::Summary;
use std::f64::consts::FRAC_PI_2;
use std::fmt;

/// Minimum standard error of a ratio.
const LEAST: f64 = 0.005;

/// Ratio of a choice's time to that of `exact` right before and after it.
///
/// Slow phases of the machine affect both times and cancel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ratio {
    /// Median over all rounds.
    pub value: f64,
    /// Standard error.
    pub off: f64,
    /// Number of rounds.
    pub rounds: usize,
}

impl Ratio {
    /// Ratio of `exact` to itself.
    pub const EXACT: Ratio = Ratio { value: 1.0, off: 0.0, rounds: 1 };

    /// Computes the ratio from one ratio per round.
    pub fn of(rounds: &[f64]) -> Ratio {
        Ratio::from(Summary::of(rounds))
    }

    /// Returns whether value and error are finite.
    fn is_finite(&self) -> bool {
        self.value.is_finite() && self.off.is_finite()
    }

    /// Returns whether this ratio is significantly less.
    fn surely_below(&self, other: &Ratio) -> bool {
        other.value - self.value > 2.0 * self.off.hypot(other.off).max(LEAST)
    }
}

/// Returns the standard error of a median, relative to the standard deviation.
///
/// Applies to normally distributed samples.
fn median_error(samples: usize) -> f64 {
    (FRAC_PI_2 / samples as f64).sqrt()
}

impl From<Summary> for Ratio {
    /// Converts the statistics of single rounds.
    fn from(s: Summary) -> Ratio {
        let rounds = s.samples.max(1);
        let off = median_error(rounds) * s.sigma();
        // A maximum would ignore NaN.
        let off = if off.is_finite() { off.max(LEAST) } else { f64::INFINITY };
        Ratio { value: s.median, off, rounds }
    }
}

impl From<Ratio> for Summary {
    /// Returns the ratio with the spread of single rounds.
    ///
    /// Comparisons of reports use this spread: runs at different times differ by more than rounds of one run.
    fn from(r: Ratio) -> Summary {
        Summary::known(r.value, r.off / median_error(r.rounds), r.rounds)
    }
}

impl fmt::Display for Ratio {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.off == 0.0 { write!(f, "{:.2}", self.value) } else { write!(f, "{:.2} ± {:.2}", self.value, self.off) }
    }
}

/// Standing of a choice among all others.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Standing {
    /// No other choice dominates it in error and time.
    Front,
    /// Another choice is more accurate and not slower, but within timing noise.
    Tie,
    /// Another choice has no larger error and is significantly faster.
    #[default]
    Beaten,
    /// Matches `exact` up to rounding; not ranked.
    Same,
}

impl Standing {
    /// Returns the value of the fact in reports.
    pub fn label(self) -> &'static str {
        match self {
            Standing::Front => standing::FRONT,
            Standing::Tie => standing::TIE,
            Standing::Beaten => standing::BEATEN,
            Standing::Same => standing::SAME,
        }
    }
}

impl fmt::Display for Standing {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Standing::Front => "yes",
            Standing::Tie => "within noise",
            Standing::Beaten => "",
            Standing::Same => standing::SAME,
        })
    }
}

/// Figures that a choice is ranked by.
#[derive(Clone, Copy, Debug)]
pub struct Place {
    /// Effect of the choice.
    pub kind: Kind,
    /// Time relative to `exact`.
    pub time: Ratio,
    /// Error. Errors within one percent of each other count as equal.
    pub error: f64,
}

impl Place {
    fn is_finite(&self) -> bool {
        self.time.is_finite() && self.error.is_finite()
    }

    /// Returns whether the choice can beat others.
    ///
    /// Non-finite figures beat nothing. Equivalent choices do not compete.
    fn ranked(&self) -> bool {
        self.kind != Kind::Same && self.is_finite()
    }
}

/// Ranks all choices. Choices with non-finite figures are beaten.
pub fn standings(all: &[Place]) -> Vec<Standing> {
    let of = |p: &Place| {
        let close = || all.iter().filter(|o| o.ranked() && o.error <= p.error);
        if !p.is_finite() {
            Standing::Beaten
        } else if p.kind == Kind::Same {
            Standing::Same
        } else if close().any(|o| o.time.surely_below(&p.time)) {
            Standing::Beaten
        } else if close().any(|o| o.time.value <= p.time.value && o.error < 0.99 * p.error) {
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
    use Standing::{Beaten, Front, Same, Tie};

    fn standings_of(all: &[(f64, f64)], off: f64) -> Vec<Standing> {
        let place = |&(value, error)| place(Kind::Accuracy, value, off, error);
        standings(&all.iter().map(place).collect::<Vec<_>>())
    }

    fn place(kind: Kind, value: f64, off: f64, error: f64) -> Place {
        Place { kind, time: Ratio { value, off, rounds: 1 }, error }
    }

    #[test]
    fn equivalent_choices_are_not_ranked() {
        let ranked = [(1.0, 1e-7), (0.97, 1e-3), (0.9, 1e-2)].map(|(t, e)| place(Kind::Accuracy, t, 0.005, e));
        let alone = standings(&ranked);
        assert_eq!(alone, [Front, Front, Front]);
        // A fast equivalent choice removes nothing from the front, and a slow one is not beaten.
        for time in [0.5, 0.95, 1.0, 1.5] {
            for error in [0.0, 1e-7, 2e-7] {
                let mut all = ranked.to_vec();
                all.insert(1, place(Kind::Same, time, 0.005, error));
                let mut found = standings(&all);
                assert_eq!(found.remove(1), Same);
                assert_eq!(found, alone, "{time} {error}");
            }
        }
        assert_eq!((Same.label(), Same.to_string().as_str()), (standing::SAME, "as exact"));
        assert_eq!(standings(&[place(Kind::Same, 1.0, 0.005, f64::NAN)]), [Beaten]);
    }

    #[test]
    fn front_holds_undominated_choices() {
        let all = [(1.0, 1e-7), (1.2, 1e-3), (0.5, 1e-2), (0.55, 2e-2)];
        assert_eq!(standings_of(&all, 0.01), [Front, Beaten, Front, Beaten]);
        // Repeated measurements of the same choice are both on the front. A slower choice of equal error leaves the
        // front if the difference is significant.
        let all = [(1.0, 1e-7), (0.99, 1e-7), (1.02, 1e-3), (0.98, 1e-3), (1.03, 1e-7)];
        assert_eq!(standings_of(&all, 0.03), [Front, Front, Tie, Front, Front]);
        assert_eq!(standings_of(&all, 0.005), [Front, Front, Beaten, Front, Beaten]);
        assert_eq!(Tie.to_string(), "within noise");
    }

    #[test]
    fn non_finite_choices_are_never_on_the_front() {
        for wrong in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            // Neither a non-finite error nor a non-finite time reaches the front, even if it is the smallest or the
            // only one.
            assert_eq!(standings_of(&[(1.0, 1e-7), (0.5, wrong)], 0.01), [Front, Beaten], "{wrong}");
            assert_eq!(standings_of(&[(1.0, 1e-7), (wrong, 1e-9)], 0.01), [Front, Beaten], "{wrong}");
            assert_eq!(standings_of(&[(wrong, wrong)], 0.01), [Beaten], "{wrong}");
            let time = Ratio::of(&[wrong, wrong]);
            assert_eq!(standings(&[Place { kind: Kind::Accuracy, time, error: 0.0 }]), [Beaten], "{wrong}");
        }
        assert_eq!(standings_of(&[(1.0, 1e-7)], f64::NAN), [Beaten]);
    }

    #[test]
    fn standard_error_follows_the_spread_of_rounds() {
        let r = Ratio::of(&[0.8, 0.82, 0.78, 5.0, 0.8]);
        assert!((r.value - 0.8).abs() < 1e-12 && (0.01..0.03).contains(&r.off), "{r:?}");
        assert_eq!(r.to_string(), format!("0.80 ± {:.2}", r.off));
        // More rounds reduce the standard error, down to its minimum.
        let often: Vec<f64> = (0..100).map(|i| if i % 2 == 0 { 0.78 } else { 0.82 }).collect();
        assert!(Ratio::of(&often).off < 0.5 * Ratio::of(&often[..4]).off);
        assert_eq!(Ratio::of(&[0.8]), Ratio { value: 0.8, off: LEAST, rounds: 1 });
        assert_eq!(Ratio::EXACT.to_string(), "1.00");
        // Reports contain the spread of single rounds.
        let (all, stored) = (Summary::of(&often[..4]), Summary::from(Ratio::of(&often[..4])));
        assert!((stored.median, stored.samples) == (all.median, 4) && (stored.sigma() - all.sigma()).abs() < 1e-12);
    }
}
