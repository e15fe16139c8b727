//! Settings of the priors: `priors/priors.json`.

use std::path::Path;

use serde::Deserialize;

use crate::depth_prior::DepthSettings;
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
