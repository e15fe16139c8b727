//! Numbers drawn at random for properties: log-uniform ones, the same every time.

pub mod scenes;

use proptest::prelude::*;
use proptest::test_runner::{Config, RngAlgorithm, TestRng, TestRunner};
use sgs_passes::reference::rng::Pcg;
use std::cell::Cell;

/// So many cases, or as many as `SGS_TEST_CASES` asks for.
pub fn runner(cases: u32) -> TestRunner {
    let requested = std::env::var("SGS_TEST_CASES").ok().and_then(|n| n.parse().ok());
    let config = Config { cases: requested.unwrap_or(cases), failure_persistence: None, ..Config::default() };
    TestRunner::new_with_rng(config, TestRng::deterministic_rng(RngAlgorithm::ChaCha))
}

/// How many numbers that are not zero were compared, and of how many of these a tenth more or less would have been noticed.
#[derive(Clone, Debug, Default)]
pub struct Compared(Cell<[usize; 2]>);

impl Compared {
    /// One that was, to so much.
    pub fn see(&self, expected: f64, slack: f64) {
        let [all, sharp] = self.0.get();
        self.0.set([all + usize::from(expected != 0.0), sharp + usize::from(slack < 0.1 * expected.abs())]);
    }

    /// Fails unless there were so many, and a share of them was sharp.
    pub fn check(&self, least: usize, share: f64) {
        let [all, sharp] = self.0.get();
        println!("{all} numbers compared, a tenth would be noticed of {sharp}");
        assert!(all >= least && sharp as f64 >= share * all as f64, "{sharp} of {all} numbers mean something");
    }
}

/// Log-uniform between two powers of ten.
pub fn spread(low: f64, high: f64) -> impl Strategy<Value = f64> {
    (low..high).prop_map(|power| 10_f64.powf(power))
}

/// The same, of either sign.
pub fn signed(low: f64, high: f64) -> impl Strategy<Value = f64> {
    (spread(low, high), any::<bool>()).prop_map(|(size, minus)| if minus { -size } else { size })
}

/// Log-uniform between two powers of ten, where numbers come in bulk.
pub fn log_uniform(rng: &mut Pcg, [low, high]: [f64; 2]) -> f64 {
    10_f64.powf(rng.range(low, high))
}

/// Two powers of ten, between which numbers that come in bulk are drawn.
pub fn powers(low: f64, high: f64) -> impl Strategy<Value = [f64; 2]> {
    [low..high, low..high].prop_map(|[a, b]| [a.min(b), a.max(b)])
}
