//! Settings of the priors: `priors/priors.json`.

use std::path::Path;

use serde::Deserialize;

use crate::error::{Result, SceneError};
use crate::json::read_json;
use crate::map_file::NormalFrame;

/// Content of `priors/priors.json`.
#[derive(Clone, Debug, Default, Deserialize)]
pub(crate) struct PriorSettings {
    /// Settings of normal maps.
    pub(crate) normal: Option<NormalSettings>,
    /// Settings of depth maps.
    pub(crate) depth: Option<DepthSettings>,
}

/// Settings of normal maps.
#[derive(Clone, Debug, Deserialize)]
pub(crate) struct NormalSettings {
    /// Frame of the vectors.
    pub(crate) frame: NormalFrame,
}

/// Meaning of prior depths.
#[derive(Clone, Copy, Debug, Default, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "kebab-case")]
pub enum DepthMeaning {
    /// Camera z in units of the scene.
    #[default]
    Metric,
    /// Camera z up to a factor for each view.
    Scale,
    /// Inverse camera z up to a factor and a shift for each view.
    ///
    /// Networks of relative depth return it.
    InverseScaleShift,
}

impl DepthMeaning {
    /// Returns the word in `priors.json`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Metric => "metric",
            Self::Scale => "scale",
            Self::InverseScaleShift => "inverse-scale-shift",
        }
    }
}

/// Settings of the maps in `priors/depth`.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct DepthSettings {
    /// What the values mean.
    #[serde(default)]
    pub(crate) meaning: DepthMeaning,
    /// Scene units per unit of metric files.
    #[serde(default = "one")]
    pub(crate) unit: f64,
}

fn one() -> f64 {
    1.0
}

impl DepthSettings {
    /// Describes what is wrong with the settings; `None` if nothing is.
    pub(crate) fn problem(self) -> Option<String> {
        let valid = self.unit.is_finite() && self.unit > 0.0;
        (!valid).then(|| format!("the unit of depth is {}; it must be a positive number of scene units", self.unit))
    }
}

impl PriorSettings {
    /// Reads the prior settings of a scene. Fails if required settings are missing.
    pub(crate) fn read(root: &Path) -> Result<Self> {
        let path = root.join("priors/priors.json");
        let settings: Self = if path.is_file() { read_json(&path)? } else { Self::default() };
        let folder = root.join("priors/normal");
        if settings.normal.is_none() && folder.is_dir() {
            let problem = format!(
                "the frame of the normals is unknown; write {{\"normal\": {{\"frame\": \"world\"}}}}, or camera-opencv, \
                 camera-opengl or camera-stablenormal, into {}",
                path.display()
            );
            return Err(SceneError::image(&folder, problem));
        }
        if let Some(problem) = settings.depth.and_then(DepthSettings::problem) {
            return Err(SceneError::image(&path, problem));
        }
        Ok(settings)
    }
}
