//! Noise on the inputs of training.

use crate::error::ConfigError;
use serde::{Deserialize, Serialize};
use sgs_scene::{Noise, Scene};

/// Noise on the inputs of training. Test views and ground truth have none.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct NoiseSettings {
    /// Standard deviation of each coordinate of the initial points. The unit is the extent.
    pub positions: f64,
    /// Standard deviation in degrees of the rotation of normal priors about each axis. The rotation is smooth over
    /// neighboring pixels.
    pub normals: f64,
    /// Fraction of the cells of semantic priors that hold another cell of the view.
    pub semantics: f64,
    /// Standard deviations of training cameras: rotation about each axis in degrees, and each coordinate in units of the
    /// extent.
    pub cameras: [f64; 2],
}

impl NoiseSettings {
    /// Returns the scene with this noise; `None` without noise.
    pub fn on(&self, scene: &Scene, seed: u64) -> Option<Scene> {
        let NoiseSettings { positions, normals, semantics, cameras: [rotations, translations] } = *self;
        (*self != NoiseSettings::default())
            .then(|| scene.disturbed(&Noise { positions, normals, semantics, rotations, translations, seed }))
    }

    /// Checks values that the types do not constrain.
    pub(super) fn check(&self) -> crate::Result<()> {
        let most = [
            ("positions", self.positions, 100.0),
            ("normals", self.normals, 180.0),
            ("semantics", self.semantics, 1.0),
        ];
        for (name, value, most) in most {
            if !(0.0..=most).contains(&value) {
                return Err(ConfigError::range(format_args!("noise.{name}"), value, format!("0 to {most}")));
            }
        }
        let [rotation, translation] = self.cameras;
        if !((0.0..=180.0).contains(&rotation) && (0.0..=100.0).contains(&translation)) {
            let value = format_args!("[{rotation}, {translation}]");
            return Err(ConfigError::range("noise.cameras", value, "two numbers, 0 to 180 and 0 to 100"));
        }
        Ok(())
    }
}
