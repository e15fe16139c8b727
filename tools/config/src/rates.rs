//! Learning rates of the geometry stage.

use crate::view_rates::ViewRates;
use serde::{Deserialize, Serialize};

/// Learning rates of Adam by group (Kerbl et al. 2023). Rates of other groups are fixed, apart from `factor`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Rates {
    /// Factor on all rates; 0 chooses it by the number of steps, larger for short runs.
    pub factor: f64,
    /// Rates of means at the first step and at the last, times the extent; log-linear between.
    pub means: [f64; 2],
    /// `auto`, or four rates of what is learned of the photographs; 0 learns nothing. `auto` takes 3e-4, 5e-3, 2e-3 and 1e-3
    /// where the depths of a sensor show that exposures differ or that the lens differs from the given one, else 0.
    /// The first is that of each camera: the turn in radians, and the shift times the extent. The second is that of each
    /// exposure: the logarithms of factors on red, green and blue. The third is that of the lens that all share: the
    /// logarithm of the focal length, and the principal point in focal lengths. With the second and the third, vignetting
    /// is learned, too. The fourth is that of its radial distortion: the shift of the corners, relative to their distance
    /// from the principal point.
    pub views: ViewRates,
    /// Rate of log scales. Not a setting.
    #[serde(skip)]
    pub scales: f64,
    /// Rate of quaternions. Not a setting.
    #[serde(skip)]
    pub rotations: f64,
    /// Rate of opacity logits. Not a setting.
    #[serde(skip)]
    pub opacities: f64,
    /// Rate of band 0. Not a setting.
    #[serde(skip)]
    pub sh0: f64,
    /// Rate of the other bands. Not a setting.
    #[serde(skip)]
    pub sh_rest: f64,
    /// Rate of normals. Not a setting.
    #[serde(skip)]
    pub normals: f64,
    /// Rate of semantic features. Not a setting.
    #[serde(skip)]
    pub semantics: f64,
    /// Rate of the feature decoder. Not a setting.
    #[serde(skip)]
    pub decoder: f64,
}

impl Default for Rates {
    fn default() -> Self {
        Rates {
            factor: 0.0,
            means: [1.6e-4, 1.6e-6],
            views: ViewRates::Auto,
            scales: 5e-3,
            rotations: 1e-3,
            opacities: 0.05,
            sh0: 2.5e-3,
            sh_rest: 1.25e-4,
            normals: 0.01,
            semantics: 1e-3,
            decoder: 1e-4,
        }
    }
}
