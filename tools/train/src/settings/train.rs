//! What becomes of a training that goes wrong.

use serde::{Deserialize, Serialize};

/// What both stages have in common.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrainSettings {
    /// What happens where training has diverged.
    pub on_divergence: OnDivergence,
    /// Most returns to the last good state, each of which halves the learning rates from there on.
    pub roll_backs: u32,
}

/// What happens where training has diverged.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum OnDivergence {
    /// It ends with an error; the last good state is kept.
    #[default]
    Stop,
    /// It returns to the last good state and goes on with halved learning rates.
    RollBack,
    /// It goes on, as long as losses are numbers.
    GoOn,
}

impl Default for TrainSettings {
    fn default() -> Self {
        TrainSettings { on_divergence: OnDivergence::default(), roll_backs: 8 }
    }
}
