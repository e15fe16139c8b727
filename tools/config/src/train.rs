//! Settings of both stages: tile sizes, and recovery from divergence.

use super::Settings;
use crate::error::ConfigError;
use serde::{Deserialize, Serialize};
use sgs_engine::DeviceInfo;
use sgs_passes::Tuning;

/// Settings of both stages.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrainSettings {
    /// After divergence: `stop`, `roll-back` to the last good state, or `go-on`.
    pub on_divergence: OnDivergence,
    /// Number of rollbacks at most. Each halves the learning rates.
    pub roll_backs: u32,
    /// Steps between checkpoints of a stage; 0 writes only the last.
    pub checkpoint_interval: u32,
    /// Rows of pixels per tile: 8, 16 or 32; 0 chooses for the device. Tiles have 16 columns, or 8 with subgroups of 8.
    /// Results differ by the order of sums.
    pub tile_rows: u32,
}

/// Reaction to a diverged training.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum OnDivergence {
    /// Ends with an error. The last good state remains on disk.
    #[default]
    Stop,
    /// Returns to the last good state and continues with halved learning rates.
    RollBack,
    /// Continues as long as losses are finite.
    GoOn,
}

impl Default for TrainSettings {
    fn default() -> Self {
        TrainSettings { on_divergence: OnDivergence::default(), roll_backs: 8, checkpoint_interval: 500, tile_rows: 0 }
    }
}

impl TrainSettings {
    /// Checks values that the types do not constrain.
    pub(super) fn check(&self) -> crate::Result<()> {
        if [0, 8, 16, 32].contains(&self.tile_rows) {
            return Ok(());
        }
        Err(ConfigError::range("train.tile_rows", self.tile_rows, "0, 8, 16 or 32"))
    }
}

impl Settings {
    /// Returns kernel sizes for a device with the requested accuracy and tile size.
    pub fn tuning(&self, device: &DeviceInfo) -> Tuning {
        let own = Tuning::for_device(device).with(self.accuracy);
        match self.train.tile_rows {
            0 => own,
            rows => Tuning { tile: [own.tile[0], rows], ..own },
        }
    }
}
