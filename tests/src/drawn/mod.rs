//! Numbers drawn at random for properties: log-uniform ones, the same every time.

pub mod scenes;

use proptest::prelude::*;
use proptest::test_runner::{Config, RngAlgorithm, TestRng, TestRunner};
use sgs_passes::reference::rng::Pcg;

/// So many cases, or as many as `SGS_TEST_CASES` asks for.
pub fn runner(cases: u32) -> TestRunner {
    let asked = std::env::var("SGS_TEST_CASES").ok().and_then(|n| n.parse().ok());
    let config = Config { cases: asked.unwrap_or(cases), failure_persistence: None, ..Config::default() };
    TestRunner::new_with_rng(config, TestRng::deterministic_rng(RngAlgorithm::ChaCha))
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
