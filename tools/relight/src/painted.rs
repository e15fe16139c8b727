//! Relit sets that change the material of an instance: `gt/relit/NAME.json`.

use super::select::of_region_everywhere;
use super::{MaterialEdit, MaterialValues, Where};
use crate::error::{RelightError, Result};
use serde::Deserialize;
use sgs_engine::Device;
use sgs_evaluate::RELIT_MEAN;
use sgs_scene::{GroundTruth, Scene, Splats};
use std::path::Path;

/// Suffix of the name of a material set that is measured under the learned light.
pub(crate) const LEARNED: &str = "_learned_light";

/// Fields of `gt/relit/NAME.json` that are read: the new material of an instance.
#[derive(Deserialize)]
pub(crate) struct Painted {
    /// Id of the instance's region in `priors/masks`.
    instance_id: u16,
    new_base_color_linear: [f32; 3],
    new_roughness: Option<f32>,
    new_metallic: Option<f32>,
}

impl Painted {
    /// Returns the material edit, or the reason that it is impossible.
    pub(crate) fn edit(&self, device: &Device, scene: &Scene, splats: &Splats) -> Result<Known<MaterialEdit>> {
        let gaussians = of_region_everywhere(device, scene, splats, self.instance_id)?;
        if gaussians.is_empty() {
            return Ok(Err(format!("No Gaussian belongs to instance {} of priors/masks.", self.instance_id)));
        }
        // Without metallic, the value of every Gaussian is already 0.
        let metallic = self.new_metallic.filter(|m| *m > 0.0 || splats.metallic.is_some());
        let set = MaterialValues { albedo: Some(self.new_base_color_linear), roughness: self.new_roughness, metallic };
        let place = Where { gaussians: Some(gaussians), ..Default::default() };
        Ok(Ok(MaterialEdit { place, set, scale: MaterialValues::default() }))
    }
}

/// Value, or the sentence that explains its absence.
pub(crate) type Known<T> = std::result::Result<T, String>;

/// Reads a JSON file. `what` names the expected contents in the error, such as "an edit".
pub(crate) fn read<T: serde::de::DeserializeOwned>(path: &Path, what: &str) -> Result<T> {
    let wrong = |reason: String| RelightError::File { path: path.to_owned(), reason };
    let text = std::fs::read_to_string(path).map_err(|e| wrong(e.to_string()))?;
    serde_json::from_str(&text).map_err(|e| wrong(format!("not {what}: {e}")))
}

/// Returns the key of a set in `relit`.
///
/// The key is the name, unless that is the key of the mean over all sets.
pub(crate) fn key_of(name: &str) -> String {
    if name == RELIT_MEAN { format!("{name}_set") } else { name.to_owned() }
}

/// Returns the edit of `gt/relit/NAME.json`, or the reason for its absence.
pub(crate) fn painted_of(
    device: &Device,
    scene: &Scene,
    splats: &Splats,
    truth: &GroundTruth<'_>,
    name: &str,
) -> Result<Known<MaterialEdit>> {
    let Some(path) = truth.relit_edit(name) else {
        return Ok(Err(format!("Neither gt/lights.json nor gt/relit/{name}.json describes the lights of the set.")));
    };
    let value: serde_json::Value = read(&path, "an edit")?;
    match serde_json::from_value::<Painted>(value) {
        Ok(painted) => painted.edit(device, scene, splats),
        Err(_) => Ok(Err(format!(
            "gt/lights.json does not list the set, and gt/relit/{name}.json describes no edit of an instance's material."
        ))),
    }
}
