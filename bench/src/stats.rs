//! Robust statistics: medians instead of means, since a shared machine has outliers.

use serde::{Deserialize, Serialize};

/// Statistics of samples.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// Median.
    pub median: f64,
    /// Median absolute deviation from the median.
    pub mad: f64,
    /// Minimum.
    pub least: f64,
    /// Number of samples.
    pub samples: usize,
}

/// Factor from MAD to the standard deviation of a normal distribution.
const SIGMA: f64 = 1.4826;

impl Summary {
    /// Computes the statistics of samples; zeros if there are none.
    pub fn of(samples: &[f64]) -> Summary {
        let center = median(samples);
        let deviations: Vec<f64> = samples.iter().map(|s| (s - center).abs()).collect();
        let least = samples.iter().copied().min_by(f64::total_cmp).unwrap_or(0.0);
        Summary { median: center, mad: median(&deviations), least, samples: samples.len() }
    }

    /// Creates statistics from a known median and standard deviation.
    pub fn known(value: f64, sigma: f64, samples: usize) -> Summary {
        Summary { median: value, mad: sigma / SIGMA, least: value, samples }
    }

    /// Returns the standard deviation estimated from the MAD.
    pub fn sigma(&self) -> f64 {
        SIGMA * self.mad
    }

    /// Returns the statistics in another unit.
    pub fn scaled(&self, factor: f64) -> Summary {
        Summary { median: self.median * factor, mad: self.mad * factor, least: self.least * factor, ..*self }
    }
}

/// Returns the median, 0 for no samples. For an even number, averages the middle two.
pub fn median(samples: &[f64]) -> f64 {
    let mut sorted = samples.to_vec();
    sorted.sort_by(f64::total_cmp);
    match sorted.len() {
        0 => 0.0,
        n if n % 2 == 1 => sorted[n / 2],
        n => 0.5 * (sorted[n / 2 - 1] + sorted[n / 2]),
    }
}

/// Returns the least sample that a share of all samples does not exceed.
///
/// 0 for no samples.
pub fn percentile(samples: &[f64], share: f64) -> f64 {
    let mut sorted = samples.to_vec();
    sorted.sort_by(f64::total_cmp);
    let place = (share * sorted.len() as f64).ceil() as usize;
    sorted.get(place.saturating_sub(1).min(sorted.len().saturating_sub(1))).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentile_is_the_sample_that_a_share_does_not_exceed() {
        let samples: Vec<f64> = (1..=200).rev().map(f64::from).collect();
        assert_eq!([0.0, 0.5, 0.99, 1.0].map(|share| percentile(&samples, share)), [1.0, 100.0, 198.0, 200.0]);
        assert_eq!(percentile(&[], 0.99), 0.0);
    }

    #[test]
    fn outlier_does_not_change_the_statistics() {
        let s = Summary::of(&[10.0, 12.0, 11.0, 1e9, 9.0]);
        assert_eq!((s.median, s.mad, s.least, s.samples), (11.0, 1.0, 9.0, 5));
        assert_eq!(Summary::of(&[1.0, 2.0]).median, 1.5);
        assert_eq!(Summary::of(&[]), Summary::default());
        assert_eq!(s.scaled(2.0).median, 22.0);
    }

    #[test]
    fn sigma_matches_a_normal_distribution() {
        let mut rng = sgs_passes::reference::rng::Pcg::new(1);
        let samples: Vec<f64> = (0..20_001).map(|_| 3.0 + 2.0 * rng.normal()).collect();
        let s = Summary::of(&samples);
        assert!((s.median - 3.0).abs() < 0.05 && (s.sigma() - 2.0).abs() < 0.05, "{s:?}");
        assert!((Summary::known(0.9, 0.02, 8).sigma() - 0.02).abs() < 1e-15);
    }
}
