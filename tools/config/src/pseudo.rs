//! Poses of pseudo-views (SGS-Intrinsic, algorithm 1).

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
    /// Number of poses of a sequence, both ends included. Not a setting.
    #[serde(skip)]
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
