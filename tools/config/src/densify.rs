//! Settings of densification.

use crate::error::{ConfigError, Result};
use serde::{Deserialize, Serialize};
use sgs_passes::splat::Statistic;

/// Rule by which Gaussians are added and removed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum DensifyRule {
    /// Clones and splits Gaussians by screen gradients of the photometric loss.
    Photometric,
    /// The same by gradients of normal and depth losses, or by raw normals.
    ///
    /// This is the published statistic.
    Geometric,
    /// The same by gradients of every loss.
    ///
    /// Semantic losses count if they move geometry.
    Total,
    /// Markov chain Monte Carlo (Kheradmand et al. 2024).
    ///
    /// Dead Gaussians move onto others, and the number grows by 5 %.
    Mcmc,
}

impl DensifyRule {
    /// Returns the statistic that the kernels accumulate, if the rule uses gradients.
    pub fn gathered(self) -> Option<Statistic> {
        match self {
            DensifyRule::Photometric => Some(Statistic::Photometric),
            DensifyRule::Geometric => Some(Statistic::Geometric),
            DensifyRule::Total => Some(Statistic::Total),
            DensifyRule::Mcmc => None,
        }
    }
}

/// Densification (Kerbl et al. 2023, section 5.2).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DensifyOptions {
    /// First step after which densification runs.
    pub from: u32,
    /// Fraction of the steps after which densification ends; 0 disables it. It ends at least `interval` steps before the
    /// last step.
    pub until: f64,
    /// Steps between densifications.
    pub interval: u32,
    /// Rule: losses whose gradients select Gaussians, `photometric`, `geometric` or `total`; or `mcmc`, which draws Gaussians by their
    /// opacity up to `max_gaussians` and ignores `grad_threshold`, `sizes` and `reset_interval`.
    pub rule: DensifyRule,
    /// Mean screen gradient (NDC) from which a Gaussian is refined. Published for `geometric`: 1e-4.
    pub grad_threshold: f32,
    /// Mean gradient by the raw normal from which a Gaussian is refined; `geometric` only. 0 disables it. Not a setting.
    #[serde(skip)]
    pub normal_threshold: f32,
    /// Two scales as fractions of the extent. The first is the largest that is cloned instead of split. Larger ones than
    /// the second are pruned, after the first opacity reset.
    pub sizes: [f64; 2],
    /// Opacity below which a Gaussian is pruned. Not a setting.
    #[serde(skip)]
    pub prune_opacity: f32,
    /// Blending weight per interval below which a Gaussian is pruned. Applies only if the interval showed all views. Not a
    /// setting.
    #[serde(skip)]
    pub prune_weight: f32,
    /// Steps between opacity resets; 0 disables them.
    pub reset_interval: u32,
    /// Number of Gaussians at most.
    pub max_gaussians: u32,
}

impl Default for DensifyOptions {
    fn default() -> Self {
        DensifyOptions {
            from: 150,
            until: 0.6,
            interval: 100,
            rule: DensifyRule::Total,
            grad_threshold: 4e-4,
            normal_threshold: 6e-8,
            sizes: [0.01, 0.5],
            prune_opacity: 0.005,
            prune_weight: 1e-4,
            reset_interval: 3000,
            max_gaussians: 2_000_000,
        }
    }
}

impl DensifyOptions {
    /// Returns whether Gaussians are densified.
    pub fn enabled(&self) -> bool {
        self.until > 0.0
    }

    /// Returns the statistic that steps accumulate for densification, if any.
    pub fn statistic(&self) -> Option<Statistic> {
        self.rule.gathered().filter(|_| self.enabled())
    }

    /// Returns whether training is a Markov chain Monte Carlo.
    pub fn mcmc(&self) -> bool {
        self.enabled() && self.rule == DensifyRule::Mcmc
    }

    /// Checks values that the types do not constrain.
    pub(super) fn check(&self) -> Result<()> {
        for (name, value) in [
            ("grad_threshold", f64::from(self.grad_threshold)),
            ("normal_threshold", f64::from(self.normal_threshold)),
            ("prune_opacity", f64::from(self.prune_opacity)),
            ("prune_weight", f64::from(self.prune_weight)),
        ] {
            if !(value >= 0.0 && value.is_finite()) {
                let setting = format_args!("geometry.densify.{name}");
                return Err(ConfigError::range(setting, value, "a finite number of at least 0"));
            }
        }
        if self.sizes.iter().any(|v| !(*v >= 0.0 && v.is_finite())) {
            let value = format_args!("{:?}", self.sizes);
            return Err(ConfigError::range("geometry.densify.sizes", value, "two finite numbers of at least 0"));
        }
        if !(0.0..=1.0).contains(&self.until) {
            return Err(ConfigError::range("geometry.densify.until", self.until, "0 to 1"));
        }
        if self.enabled() && self.interval == 0 {
            return Err(ConfigError::range("geometry.densify.interval", "0", "at least 1"));
        }
        if self.max_gaussians == 0 {
            return Err(ConfigError::range("geometry.densify.max_gaussians", "0", "at least 1"));
        }
        Ok(())
    }
}
