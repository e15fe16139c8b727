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
    /// Standard deviation in degrees of the rotation of cameras about each axis. Applies to training cameras.
    pub rotations: f64,
    /// Standard deviation of each coordinate of training cameras. The unit is the extent.
    pub translations: f64,
}

impl NoiseSettings {
    /// Returns the scene with this noise; `None` without noise.
    pub fn on(&self, scene: &Scene, seed: u64) -> Option<Scene> {
        let NoiseSettings { positions, normals, semantics, rotations, translations } = *self;
        (*self != NoiseSettings::default())
            .then(|| scene.disturbed(&Noise { positions, normals, semantics, rotations, translations, seed }))
    }

    /// Checks values that the types do not constrain.
    pub(super) fn check(&self) -> crate::Result<()> {
        let most = [
            ("positions", self.positions, 100.0),
            ("normals", self.normals, 180.0),
            ("semantics", self.semantics, 1.0),
            ("rotations", self.rotations, 180.0),
            ("translations", self.translations, 100.0),
        ];
        for (name, value, most) in most {
            if !(0.0..=most).contains(&value) {
                return Err(ConfigError::new(format!("noise.{name} is {value}, but must be 0 to {most}.")));
            }
        }
        Ok(())
    }
}
