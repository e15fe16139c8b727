//! Poses of pseudo-views (SGS-Intrinsic, algorithm 1).

use crate::error::{ConfigError, Result};
use serde::{Deserialize, Serialize};

/// Views from which the second sequence starts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Neighbors {
    /// Second-nearest training views. Uses nothing about test views, not even their poses.
    Training,
    /// Nearest test views, as in the paper. Without test views the same as `training`.
    Test,
}

/// Interpolation of positions between two poses.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Position {
    /// Linear interpolation, as in the published code.
    Linear,
    /// Cubic curve with tangents along the directions to adjacent training views.
    Cubic,
}

/// Poses of pseudo-views.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PseudoOptions {
    /// Number of poses of a sequence, both ends included.
    pub poses: u32,
    /// Source of the second sequence's neighbor: `training` or `test` views.
    pub neighbors: Neighbors,
    /// Interpolation of positions: `linear` or `cubic`.
    pub position: Position,
}

impl Default for PseudoOptions {
    fn default() -> Self {
        PseudoOptions { poses: 20, neighbors: Neighbors::Training, position: Position::Linear }
    }
}

impl PseudoOptions {
    /// Checks values that the types do not constrain; `prefix` precedes the names.
    ///
    /// # Errors
    /// A sentence that names the setting, its value and the allowed values.
    pub fn check(&self, prefix: &str) -> Result<()> {
        if !(1..=10_000).contains(&self.poses) {
            let what = format!("{prefix}poses is {}, but must be 1 to 10000.", self.poses);
            return Err(ConfigError::new(what));
        }
        Ok(())
    }
}
