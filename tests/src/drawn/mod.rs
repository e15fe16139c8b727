//! Random numbers for property tests: log-uniform and deterministic.

pub mod scenes;

use proptest::prelude::*;
use proptest::test_runner::{Config, RngAlgorithm, TestRng, TestRunner};
use sgs_passes::reference::rng::Pcg;
use std::cell::Cell;

/// Creates a runner with this number of cases, or the number in `SGS_TEST_CASES`.
pub fn runner(cases: u32) -> TestRunner {
    let requested = std::env::var("SGS_TEST_CASES").ok().and_then(|n| n.parse().ok());
    let config = Config { cases: requested.unwrap_or(cases), failure_persistence: None, ..Config::default() };
    TestRunner::new_with_rng(config, TestRng::deterministic_rng(RngAlgorithm::ChaCha))
}

/// Counts of compared nonzero numbers, and of comparisons that detect a 10 % error.
#[derive(Clone, Debug, Default)]
pub struct Compared(Cell<[usize; 2]>);

impl Compared {
    /// Counts a comparison of an expected number with a tolerance.
    pub fn see(&self, expected: f64, slack: f64) {
        let [all, sharp] = self.0.get();
        self.0.set([all + usize::from(expected != 0.0), sharp + usize::from(slack < 0.1 * expected.abs())]);
    }

    /// Fails if too few comparisons were counted or would detect a 10 % error.
    ///
    /// `least`: required number of comparisons. `share`: required fraction of them that detects such an error.
    pub fn check(&self, least: usize, share: f64) {
        let [all, sharp] = self.0.get();
        println!("{all} numbers compared, a tenth would be noticed of {sharp}");
        assert!(all >= least && sharp as f64 >= share * all as f64, "{sharp} of {all} numbers mean something");
    }
}

/// Draws log-uniformly between two powers of ten, given by exponents.
pub fn spread(low: f64, high: f64) -> impl Strategy<Value = f64> {
    (low..high).prop_map(|power| 10_f64.powf(power))
}

/// Draws log-uniformly between two powers of ten, with either sign.
pub fn signed(low: f64, high: f64) -> impl Strategy<Value = f64> {
    (spread(low, high), any::<bool>()).prop_map(|(size, minus)| if minus { -size } else { size })
}

/// Draws a number log-uniformly between two powers of ten, for bulk data.
pub fn log_uniform(rng: &mut Pcg, [low, high]: [f64; 2]) -> f64 {
    10_f64.powf(rng.range(low, high))
}

/// Draws the exponents of two powers of ten, for [`log_uniform`].
pub fn powers(low: f64, high: f64) -> impl Strategy<Value = [f64; 2]> {
    [low..high, low..high].prop_map(|[a, b]| [a.min(b), a.max(b)])
}
