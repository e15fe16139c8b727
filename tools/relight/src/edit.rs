//! The file that says what becomes of a scene: lights, surroundings, materials, things put in.
//!
//! Everything in it is optional; what it does not know is refused. Lengths are the scene's own, colors linear.
//! `docs/guide/relight.md` describes it for people.

use crate::error::{RelightError, Result};
use serde::{Deserialize, Serialize};
use sgs_run::LobeRow;
use sgs_scene::Placement;
use std::path::{Path, PathBuf};

/// The whole file.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Edit {
    /// Lights.
    pub lights: LightEdit,
    /// The surroundings.
    pub environment: EnvironmentEdit,
    /// Materials, one after the other.
    pub materials: Vec<MaterialEdit>,
    /// Other scenes put in.
    pub insert: Vec<Insert>,
}

/// What becomes of the lights.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LightEdit {
    /// All lights of the run are off.
    pub off: bool,
    /// All lights of the run but these are off.
    pub only: Option<Vec<usize>>,
    /// Single lights of the run; after the two above.
    pub change: Vec<LightChange>,
    /// New lights.
    pub add: Vec<NewLight>,
}

/// What becomes of one light.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LightChange {
    /// Its number in `lights.json`, from 0.
    pub light: Option<usize>,
    /// Off, or on as it was trained (at full gain, if it was off then).
    pub on: Option<bool>,
    /// Factor.
    pub intensity: Option<f32>,
    /// Factors of red, green and blue.
    pub color: Option<[f32; 3]>,
    /// Moves it so far.
    pub by: Option<[f32; 3]>,
    /// Puts it there.
    pub to: Option<[f32; 3]>,
}

/// A new light: in a place, with an intensity or lobes; or a rectangle.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct NewLight {
    /// Where it is.
    pub position: Option<[f32; 3]>,
    /// Radiant intensity, the same in all directions.
    pub intensity: Option<[f32; 3]>,
    /// Radiant intensity as spherical Gaussians; axes point from what is lit to the light.
    pub lobes: Option<Vec<LobeRow>>,
    /// Corners of a rectangle, one after the other around it; it shines to the side from which they go counterclockwise.
    pub corners: Option<[[f32; 3]; 4]>,
    /// Radiance of the rectangle.
    pub radiance: Option<[f32; 3]>,
    /// Patches along each side of the rectangle; 4 by default.
    pub patches: Option<u32>,
}

/// What becomes of the surroundings.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EnvironmentEdit {
    /// There are none.
    pub off: bool,
    /// Others: a latitude-longitude picture, beside the edit file unless the path is absolute.
    pub file: Option<PathBuf>,
    /// Factor.
    pub scale: Option<f32>,
    /// Factors of red, green and blue.
    pub color: Option<[f32; 3]>,
    /// Turned.
    pub rotate: Option<Turn>,
}

/// A rotation, right-handed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Turn {
    /// About this vector, of any length.
    pub axis: [f64; 3],
    /// Degrees.
    pub degrees: f64,
}

/// What becomes of some Gaussians' materials.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MaterialEdit {
    /// Which ones.
    #[serde(rename = "where")]
    pub place: Where,
    /// Values they get.
    #[serde(default)]
    pub set: MaterialValues,
    /// Factors of what they have or get.
    #[serde(default)]
    pub scale: MaterialValues,
}

/// Values or factors of materials.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MaterialValues {
    /// Linear.
    pub albedo: Option<[f32; 3]>,
    /// Roughness.
    pub roughness: Option<f32>,
    /// Metallic.
    pub metallic: Option<f32>,
}

/// Which Gaussians: those that all that is given holds for.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Where {
    /// Whose centers lie between two corners.
    #[serde(rename = "box")]
    pub within: Option<[[f32; 3]; 2]>,
    /// Of these numbers, in the order of `scene.ply`.
    pub gaussians: Option<Vec<usize>>,
    /// Of this semantic class.
    pub class: Option<String>,
    /// That show in this region of a training view.
    pub region: Option<Region>,
}

/// A region of a training view.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Region {
    /// Name of the view.
    pub view: String,
    /// Number of the region in `priors/masks`.
    pub id: u16,
}

/// Another scene put into this one, after scale, rotation and translation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Insert {
    /// A PLY file or a run directory, beside the edit file unless the path is absolute.
    pub source: PathBuf,
    /// Factor of all lengths.
    #[serde(default = "one")]
    pub scale: f32,
    /// Quaternion (w, x, y, z) of any length.
    #[serde(default = "unturned")]
    pub rotation: [f64; 4],
    /// Where its origin comes to lie.
    #[serde(default)]
    pub translation: [f32; 3],
}

impl Insert {
    /// Where it stands.
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
    /// Reads a file. Paths in it become whole.
    ///
    /// # Errors
    /// If it is not there, holds what is not known, or asks for what cannot be.
    pub fn read(path: &Path) -> Result<Edit> {
        let wrong = |reason: String| RelightError::File { path: path.to_owned(), reason };
        let text = std::fs::read_to_string(path).map_err(|e| wrong(e.to_string()))?;
        Edit::parse(&text, path.parent().unwrap_or(Path::new(""))).map_err(wrong)
    }

    /// From text. Paths in it are meant beside a folder, and become whole.
    ///
    /// # Errors
    /// What is wrong, as part of a sentence: it holds what is not known, or asks for what cannot be.
    pub fn parse(text: &str, beside: &Path) -> std::result::Result<Edit, String> {
        let mut edit: Edit = serde_json::from_str(text).map_err(|e| format!("not an edit: {e}"))?;
        edit.check()?;
        edit.environment.file = edit.environment.file.map(|file| beside.join(file));
        edit.insert.iter_mut().for_each(|i| i.source = beside.join(&i.source));
        Ok(edit)
    }

    /// Whether what is asked for makes sense by itself.
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
        let e = &self.environment;
        if e.off && (e.file.is_some() || e.scale.is_some() || e.color.is_some() || e.rotate.is_some()) {
            return Err("environment is off and changed at once".into());
        }
        positive("environment", e.scale.iter().chain(e.color.iter().flatten()))?;
        if let Some(turn) = &e.rotate {
            let length: f64 = turn.axis.iter().map(|v| v * v).sum();
            if !(length.is_finite() && length > 0.0 && turn.degrees.is_finite()) {
                return Err("environment.rotate needs an axis that is not zero, and finite degrees".into());
            }
        }
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

impl NewLight {
    pub(super) fn check(&self, name: &str) -> std::result::Result<(), String> {
        let place = self.position.is_some();
        let sends = usize::from(self.intensity.is_some()) + usize::from(self.lobes.is_some());
        let rectangle = self.corners.is_some() && self.radiance.is_some();
        let parts = self.corners.is_some() || self.radiance.is_some() || self.patches.is_some();
        let point = place && sends == 1 && !parts;
        if !(point || rectangle && !place && sends == 0) {
            return Err(format!(
                "{name} must have either \"position\" and one of \"intensity\" and \"lobes\", or \"corners\" and \"radiance\""
            ));
        }
        finite(name, self.position.iter().flatten())?;
        finite(name, self.corners.iter().flatten().flatten())?;
        positive(name, self.intensity.iter().chain(&self.radiance).flatten())?;
        let lobes = self.lobes.iter().flatten();
        positive(name, lobes.clone().flat_map(|l| l.amplitude.iter().chain([&l.sharpness])))?;
        if lobes.clone().any(|l| !l.axis.iter().all(|v| v.is_finite()) || l.axis == [0.0; 3]) {
            return Err(format!("{name} has a lobe whose axis is no direction"));
        }
        if self.lobes.as_ref().is_some_and(|l| l.is_empty() || l.len() > 32) {
            return Err(format!("{name} must have 1 to 32 lobes"));
        }
        match self.patches {
            Some(n) if !(1..=64).contains(&n) => Err(format!("{name}.patches is {n}, but must be 1 to 64")),
            _ => Ok(()),
        }
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

fn finite<'v>(name: &str, values: impl IntoIterator<Item = &'v f32>) -> std::result::Result<(), String> {
    match values.into_iter().find(|v| !v.is_finite()) {
        Some(v) => Err(format!("{name} holds {v}, which is not finite")),
        None => Ok(()),
    }
}

fn positive<'v>(name: &str, values: impl IntoIterator<Item = &'v f32>) -> std::result::Result<(), String> {
    match values.into_iter().find(|v| !(v.is_finite() && **v >= 0.0)) {
        Some(v) => Err(format!("{name} holds {v}, but must be finite and at least 0")),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn said(text: &str) -> String {
        match serde_json::from_str::<Edit>(text) {
            Ok(edit) => edit.check().expect_err(text),
            Err(e) => e.to_string(),
        }
    }

    #[test]
    fn every_mistake_has_a_sentence() {
        for (text, words) in [
            (r#"{"lamps": 1}"#, "unknown field `lamps`"),
            (r#"{"lights": {"change": [{"on": false}]}}"#, "lights.change[0] has no \"light\""),
            (r#"{"lights": {"change": [{"light": 1, "by": [0,0,0], "to": [0,0,0]}]}}"#, "both \"by\" and \"to\""),
            (r#"{"lights": {"change": [{"light": 1, "intensity": -1}]}}"#, "holds -1"),
            (r#"{"lights": {"add": [{"position": [0,0,0]}]}}"#, "lights.add[0] must have either"),
            (r#"{"lights": {"add": [{"position": [0,0,0], "lobes": []}]}}"#, "1 to 32 lobes"),
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
            let said = said(text);
            assert!(said.contains(words), "{text}: {said}");
        }
        assert_eq!(serde_json::from_str::<Edit>("{}").unwrap(), Edit::default());
    }
}
