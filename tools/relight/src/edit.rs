//! Edit file: changes to the lights, environment map, materials and contents of a scene.
//!
//! Every field is optional; unknown fields are rejected. Lengths are in scene units, colors are linear.
//! `docs/guide/relight.md` describes the file for users.

use crate::emitters::EmitterEdit;
use crate::environment::EnvironmentEdit;
use crate::error::{RelightError, Result};
pub use crate::new_light::NewLight;
use crate::numbers::{finite, positive};
use serde::{Deserialize, Serialize};
use sgs_scene::Placement;
use std::path::{Path, PathBuf};

/// Edit file.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Edit {
    /// Lights of the published model.
    pub lights: LightEdit,
    /// Emitters of a run with `emitters.json`.
    pub emitters: EmitterEdit,
    /// Environment map.
    pub environment: EnvironmentEdit,
    /// Material edits, applied in order.
    pub materials: Vec<MaterialEdit>,
    /// Scenes to insert.
    pub insert: Vec<Insert>,
}

/// Edit of the lights.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LightEdit {
    /// Turns all lights of the run off.
    pub off: bool,
    /// Turns all lights of the run off except these.
    pub only: Option<Vec<usize>>,
    /// Changes to single lights of the run, applied after `off` and `only`.
    pub change: Vec<LightChange>,
    /// New lights.
    pub add: Vec<NewLight>,
}

/// Change of one light.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LightChange {
    /// Index of the light in `lights.json`, from 0.
    pub light: Option<usize>,
    /// Turns the light off, or on with its trained gain (gain 1 if that is 0).
    pub on: Option<bool>,
    /// Factor on the intensity.
    pub intensity: Option<f32>,
    /// Factors on red, green and blue.
    pub color: Option<[f32; 3]>,
    /// Translation.
    pub by: Option<[f32; 3]>,
    /// New position.
    pub to: Option<[f32; 3]>,
}

/// Edit of the materials of selected Gaussians.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MaterialEdit {
    /// Selection of Gaussians.
    #[serde(rename = "where")]
    pub place: Where,
    /// New values.
    #[serde(default)]
    pub set: MaterialValues,
    /// Factors on the old or new values.
    #[serde(default)]
    pub scale: MaterialValues,
}

/// Values of materials, or factors on them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MaterialValues {
    /// Linear albedo.
    pub albedo: Option<[f32; 3]>,
    /// Roughness.
    pub roughness: Option<f32>,
    /// Metallic.
    pub metallic: Option<f32>,
}

/// Selection of Gaussians; all given conditions must hold.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Where {
    /// Box that contains the centers: lower and upper corner.
    #[serde(rename = "box")]
    pub within: Option<[[f32; 3]; 2]>,
    /// Indices in the order of `scene.ply`.
    pub gaussians: Option<Vec<usize>>,
    /// Semantic class.
    pub class: Option<String>,
    /// Region of a training view in which the Gaussians are visible.
    pub region: Option<Region>,
}

/// Region of a training view.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Region {
    /// Name of the view.
    pub view: String,
    /// Id of the region in `priors/masks`.
    pub id: u16,
}

/// Scene to insert, after scaling, rotation and translation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Insert {
    /// PLY file or run directory. A relative path starts at the directory of the edit file.
    pub source: PathBuf,
    /// Factor on all lengths.
    #[serde(default = "one")]
    pub scale: f32,
    /// Quaternion (w, x, y, z) of any nonzero length.
    #[serde(default = "unturned")]
    pub rotation: [f64; 4],
    /// Position of the inserted scene's origin.
    #[serde(default)]
    pub translation: [f32; 3],
}

impl Insert {
    /// Returns the placement.
    pub fn placement(&self) -> Placement {
        Placement {
            scale: f64::from(self.scale),
            rotation: self.rotation,
            translation: self.translation.map(f64::from),
        }
    }
}

fn one() -> f32 {
    1.0
}

fn unturned() -> [f64; 4] {
    [1.0, 0.0, 0.0, 0.0]
}

impl Edit {
    /// Reads an edit file. Resolves relative paths against its directory.
    ///
    /// # Errors
    /// If the file cannot be read, has unknown fields, or requests an impossible edit.
    pub fn read(path: &Path) -> Result<Edit> {
        let wrong = |reason: String| RelightError::File { path: path.to_owned(), reason };
        let text = std::fs::read_to_string(path).map_err(|e| wrong(e.to_string()))?;
        Edit::parse(&text, path.parent().unwrap_or(Path::new(""))).map_err(wrong)
    }

    /// Parses an edit from text. Resolves relative paths against `beside`.
    ///
    /// # Errors
    /// The cause, as part of a sentence: unknown fields, or an impossible edit.
    pub fn parse(text: &str, beside: &Path) -> std::result::Result<Edit, String> {
        let mut edit: Edit = serde_json::from_str(text).map_err(|e| format!("not an edit: {e}"))?;
        edit.check()?;
        for environment in [&mut edit.environment, &mut edit.emitters.environment] {
            environment.file = environment.file.take().map(|file| beside.join(file));
        }
        edit.emitters.file = edit.emitters.file.map(|file| beside.join(file));
        edit.insert.iter_mut().for_each(|i| i.source = beside.join(&i.source));
        Ok(edit)
    }

    /// Returns whether the edit changes the light of the published model.
    pub fn changes_published_light(&self) -> bool {
        self.lights != LightEdit::default() || self.environment != EnvironmentEdit::default()
    }

    /// Checks the edit without reference to a scene.
    pub(super) fn check(&self) -> std::result::Result<(), String> {
        for (i, c) in self.lights.change.iter().enumerate() {
            let name = format!("lights.change[{i}]");
            let Some(light) = c.light else { return Err(format!("{name} has no \"light\"")) };
            if c.by.is_some() && c.to.is_some() {
                return Err(format!("{name} moves light {light} both \"by\" and \"to\""));
            }
            positive(&name, c.intensity.iter().chain(c.color.iter().flatten()))?;
            finite(&name, c.by.iter().chain(&c.to).flatten())?;
        }
        for (i, light) in self.lights.add.iter().enumerate() {
            light.check(&format!("lights.add[{i}]"))?;
        }
        self.emitters.check()?;
        self.environment.check("environment")?;
        for (i, m) in self.materials.iter().enumerate() {
            m.check(&format!("materials[{i}]"))?;
        }
        for (i, insert) in self.insert.iter().enumerate() {
            let length: f64 = insert.rotation.iter().map(|v| v * v).sum();
            if !(insert.scale.is_finite() && insert.scale > 0.0) {
                return Err(format!("insert[{i}].scale is {}, but must be above 0", insert.scale));
            }
            if !(length.is_finite() && length > 0.0) {
                return Err(format!("insert[{i}].rotation is no quaternion: it must be finite and not zero"));
            }
            finite(&format!("insert[{i}].translation"), &insert.translation)?;
        }
        Ok(())
    }
}

impl MaterialEdit {
    fn check(&self, name: &str) -> std::result::Result<(), String> {
        if self.place == Where::default() {
            return Err(format!("{name}.where is empty: give \"box\", \"gaussians\", \"class\" or \"region\""));
        }
        if let Some([low, high]) = self.place.within {
            finite(name, low.iter().chain(&high))?;
            if (0..3).any(|c| low[c] > high[c]) {
                return Err(format!("{name}.where.box needs its lower corner first"));
            }
        }
        let both = [self.set, self.scale];
        if both.iter().all(|v| *v == MaterialValues::default()) {
            return Err(format!("{name} neither sets nor scales anything"));
        }
        for v in &both {
            positive(name, v.albedo.iter().flatten().chain(&v.roughness).chain(&v.metallic))?;
        }
        let values = self.set.albedo.iter().flatten().chain(&self.set.roughness).chain(&self.set.metallic);
        match values.into_iter().find(|v| **v > 1.0) {
            Some(v) => Err(format!("{name}.set holds {v}, but materials are at most 1")),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn error_of(text: &str) -> String {
        match serde_json::from_str::<Edit>(text) {
            Ok(edit) => edit.check().expect_err(text),
            Err(e) => e.to_string(),
        }
    }

    #[test]
    fn invalid_edits_report_the_cause() {
        for (text, words) in [
            (r#"{"bulbs": 1}"#, "unknown field `bulbs`"),
            (r#"{"lights": {"change": [{"on": false}]}}"#, "lights.change[0] has no \"light\""),
            (r#"{"lights": {"change": [{"light": 1, "by": [0,0,0], "to": [0,0,0]}]}}"#, "both \"by\" and \"to\""),
            (r#"{"lights": {"change": [{"light": 1, "intensity": -1}]}}"#, "holds -1"),
            (r#"{"lights": {"add": [{"position": [0,0,0]}]}}"#, "lights.add[0] must have either"),
            (r#"{"lights": {"add": [{"position": [0,0,0], "lobes": []}]}}"#, "1 to 32 lobes"),
            (r#"{"lights": {"add": [{"position": [0,0,0], "glow": 1}]}}"#, "unknown field `glow`"),
            (r#"{"lights": {"add": [{"type": "cube", "color": [1,1,1]}]}}"#, "the type \"cube\"; use lobes, point"),
            (
                r#"{"lights": {"add": [{"type": "point", "position": [0,0,0], "color": [1,-1,1]}]}}"#,
                "lights.add[0] holds color: -1",
            ),
            (r#"{"emitters": {"change": [{"on": true}]}}"#, "emitters.change[0] has no \"emitter\""),
            (r#"{"environment": {"off": true, "scale": 2}}"#, "off and changed"),
            (r#"{"environment": {"rotate": {"axis": [0,0,0], "degrees": 1}}}"#, "axis that is not zero"),
            (r#"{"materials": [{"where": {}, "set": {"roughness": 0.5}}]}"#, "materials[0].where is empty"),
            (r#"{"materials": [{"where": {"gaussians": [1]}}]}"#, "neither sets nor scales"),
            (
                r#"{"materials": [{"where": {"box": [[1,0,0],[0,1,1]]}, "set": {"roughness": 0.5}}]}"#,
                "lower corner first",
            ),
            (r#"{"materials": [{"where": {"gaussians": [1]}, "set": {"metallic": 1.5}}]}"#, "at most 1"),
            (r#"{"insert": [{"source": "a.ply", "scale": 0}]}"#, "insert[0].scale"),
            (r#"{"insert": [{"source": "a.ply", "rotation": [0,0,0,0]}]}"#, "no quaternion"),
        ] {
            let error = error_of(text);
            assert!(error.contains(words), "{text}: {error}");
        }
        assert_eq!(serde_json::from_str::<Edit>("{}").unwrap(), Edit::default());
    }
}
