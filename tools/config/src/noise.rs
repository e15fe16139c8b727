//! Noise on what training begins with.

use crate::error::ConfigError;
use serde::{Deserialize, Serialize};
use sgs_scene::{Noise, Scene};

/// Noise on what training begins with, to see how much results depend on it. What is measured at is never touched.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct NoiseSettings {
    /// Standard deviation of every coordinate of the initial points, as a share of the scene's extent.
    pub positions: f64,
    /// Standard deviation of the turn of normal priors about every axis, degrees; neighboring pixels turn alike.
    pub normals: f64,
    /// Share of the cells of semantic priors that hold what belongs to another cell of the view.
    pub semantics: f64,
    /// Standard deviation of the turn of training cameras about every axis, degrees.
    pub rotations: f64,
    /// Standard deviation of every coordinate of training cameras, as a share of the scene's extent.
    pub translations: f64,
}

impl NoiseSettings {
    /// The scene with this noise; none if there is no noise.
    pub fn on(&self, scene: &Scene, seed: u64) -> Option<Scene> {
        let NoiseSettings { positions, normals, semantics, rotations, translations } = *self;
        (*self != NoiseSettings::default())
            .then(|| scene.disturbed(&Noise { positions, normals, semantics, rotations, translations, seed }))
    }

    /// Checks what types cannot.
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
