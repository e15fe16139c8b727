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
    /// Emitters and bounced light of a room with materials.
    Transport,
}

impl StageKind {
    /// All stages, in their order.
    pub const ALL: [StageKind; 3] = [StageKind::Geometry, StageKind::Intrinsic, StageKind::Transport];

    /// Returns the name in settings, logs and files.
    pub fn name(self) -> &'static str {
        match self {
            StageKind::Geometry => "geometry",
            StageKind::Intrinsic => "intrinsic",
            StageKind::Transport => "transport",
        }
    }

    /// Returns the stage of this name.
    pub fn find(name: &str) -> Option<StageKind> {
        StageKind::ALL.into_iter().find(|kind| kind.name() == name)
    }
}

impl fmt::Display for StageKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}
