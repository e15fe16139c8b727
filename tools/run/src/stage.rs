//! Training stages.

use serde::Serialize;
use std::fmt;

/// Stages of training, in their order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum StageKind {
    /// Gaussians from photographs.
    Geometry,
    /// Materials, lights and visibility on fixed geometry.
    Intrinsic,
}

impl StageKind {
    /// Returns the name in settings, logs and files.
    pub fn name(self) -> &'static str {
        match self {
            StageKind::Geometry => "geometry",
            StageKind::Intrinsic => "intrinsic",
        }
    }
}

impl fmt::Display for StageKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}
