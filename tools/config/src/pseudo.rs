//! Where pseudo-views are (SGS-Intrinsic, algorithm 1).

use crate::error::{ConfigError, Result};
use serde::{Deserialize, Serialize};

/// Which views the second sequence comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Neighbors {
    /// The second-nearest training views: nothing is known of test views, not even where they are.
    Training,
    /// The nearest test views, as in the paper; where there are none, as `training`.
    Test,
}

/// How positions go from one pose to the next.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Position {
    /// On the straight line, as in the published code.
    Linear,
    /// On a cubic curve that leaves in the direction of the training view behind and arrives in that of the one ahead.
    Cubic,
}

/// Poses of pseudo-views.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PseudoOptions {
    /// Number of poses of a sequence, both ends included.
    pub poses: u32,
    /// Weight of the distance of positions when neighbors are chosen, in scene units.
    pub lambda_t: f64,
    /// Weight of the angle between orientations when neighbors are chosen, in radians.
    pub lambda_r: f64,
    /// Source of the second sequence's neighbor: `training` or `test` views.
    pub neighbors: Neighbors,
    /// Interpolation of positions: `linear` or `cubic`.
    pub position: Position,
}

impl Default for PseudoOptions {
    fn default() -> Self {
        PseudoOptions {
            poses: 20,
            lambda_t: 1.0,
            lambda_r: 1.0,
            neighbors: Neighbors::Training,
            position: Position::Linear,
        }
    }
}

impl PseudoOptions {
    /// Checks what types cannot; `prefix` is what stands before the names of these settings.
    ///
    /// # Errors
    /// A sentence that names the setting, its value and what it may be.
    pub fn check(&self, prefix: &str) -> Result<()> {
        if !(1..=10_000).contains(&self.poses) {
            let what = format!("{prefix}poses is {}, but must be 1 to 10000.", self.poses);
            return Err(ConfigError::new(what));
        }
        for (name, value) in [("lambda_t", self.lambda_t), ("lambda_r", self.lambda_r)] {
            if !(value >= 0.0 && value.is_finite()) {
                let what = format!("{prefix}{name} is {value}, but must be a finite number of at least 0.");
                return Err(ConfigError::new(what));
            }
        }
        Ok(())
    }
}
