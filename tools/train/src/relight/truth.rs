//! Relit pictures against ground truth: the true lights in place of the learned ones, no surroundings, and nothing in the way:
//! a visibility field knows what the learned lights see from their places, and says nothing sensible about others, and where
//! rays find shadow the truth still has light that bounced, which is not modeled.
//!
//! A set that changes the materials of an instance is measured under the true lights of the photographs, and, by its name
//! and [`LEARNED`], under all that was learned. Sets whose lights are not known, or that show another edit, are left out.

use super::lights::edit_lights;
use super::select::of_region_everywhere;
use super::{Edit, EnvironmentEdit, LightEdit, MaterialEdit, MaterialValues, NewLight, Relit, Selector, Where};
use crate::error::{Result, TrainError};
use crate::evaluate::Evaluation;
use crate::evaluate_shaded::{ShadedMetrics, mean, measure_relit};
use crate::intrinsic::LightFile;
use crate::shaded::{RunLight, Shading, Visibility};
use serde::Deserialize;
use sgs_engine::Device;
use sgs_scene::{GroundTruth, Scene, Splats};
use std::collections::BTreeMap;
use std::path::Path;

/// Behind the name of a set that changes materials, measured under the learned light.
const LEARNED: &str = "_learned_light";

/// What is read of `gt/lights.json`.
#[derive(Default, Deserialize)]
struct TrueLights {
    #[serde(default)]
    training: Vec<TrueLight>,
    #[serde(default)]
    relight: BTreeMap<String, Vec<TrueLight>>,
}

#[derive(Deserialize)]
struct TrueLight {
    on: bool,
    position: Option<[f32; 3]>,
    point_light_intensity_equivalent: Option<[f32; 3]>,
    corners: Option<[[f32; 3]; 4]>,
    radiance: Option<[f32; 3]>,
}

impl TrueLight {
    /// Nothing, if how bright it is is not known.
    fn as_new(&self) -> Option<NewLight> {
        if let (Some(corners), Some(radiance)) = (self.corners, self.radiance) {
            return Some(NewLight { corners: Some(corners), radiance: Some(radiance), ..Default::default() });
        }
        let (position, intensity) = (self.position?, self.point_light_intensity_equivalent?);
        Some(NewLight { position: Some(position), intensity: Some(intensity), ..Default::default() })
    }
}

/// The edit that puts the true lights of a set in place of the learned ones.
fn edit_of(lights: &[TrueLight]) -> Option<Edit> {
    let add = lights.iter().filter(|l| l.on).map(TrueLight::as_new).collect::<Option<Vec<_>>>()?;
    let lights = LightEdit { off: true, add, ..Default::default() };
    let environment = EnvironmentEdit { off: true, ..Default::default() };
    Some(Edit { lights, environment, ..Default::default() })
}

/// What is read of `gt/relit/NAME.json`, where materials of an instance change.
#[derive(Deserialize)]
struct Painted {
    /// The number of its region in `priors/masks`.
    instance_id: u16,
    new_base_color_linear: [f32; 3],
    new_roughness: Option<f32>,
    new_metallic: Option<f32>,
}

impl Painted {
    /// The edit of materials; none if no Gaussian is of that instance.
    fn edit(&self, device: &Device, scene: &Scene, splats: &Splats) -> Result<Option<MaterialEdit>> {
        let gaussians = of_region_everywhere(device, scene, splats, self.instance_id)?;
        if gaussians.is_empty() {
            return Ok(None);
        }
        // Where nothing is metallic, nothing has to say so.
        let metallic = self.new_metallic.filter(|m| *m > 0.0 || splats.metallic.is_some());
        let set = MaterialValues { albedo: Some(self.new_base_color_linear), roughness: self.new_roughness, metallic };
        let place = Where { gaussians: Some(gaussians), ..Default::default() };
        Ok(Some(MaterialEdit { place, set, scale: MaterialValues::default() }))
    }
}

/// The edits of a set, by the name under which each is measured, and whether the run's own light is on.
fn edits_of(
    name: &str,
    known: &TrueLights,
    painted: impl FnOnce() -> Result<Option<MaterialEdit>>,
) -> Result<Vec<(String, Edit, bool)>> {
    if let Some(lights) = known.relight.get(name) {
        return Ok(edit_of(lights).map(|edit| (name.to_owned(), edit, false)).into_iter().collect());
    }
    let Some(change) = painted()? else { return Ok(Vec::new()) };
    let materials = vec![change];
    let mut all = vec![(format!("{name}{LEARNED}"), Edit { materials: materials.clone(), ..Default::default() }, true)];
    if let Some(edit) = edit_of(&known.training).filter(|e| !e.lights.add.is_empty()) {
        all.push((name.to_owned(), Edit { materials, ..edit }, false));
    }
    Ok(all)
}

fn read<T: serde::de::DeserializeOwned>(path: &Path, what: &str) -> Result<T> {
    let wrong = |reason: String| TrainError::File { path: path.to_owned(), reason };
    let text = std::fs::read_to_string(path).map_err(|e| wrong(e.to_string()))?;
    serde_json::from_str(&text).map_err(|e| wrong(format!("not {what}: {e}")))
}

/// The true lights of the photographs and of all relit sets as lights of a run, as far as it is known how bright they are.
pub(crate) fn true_lights_of(path: &Path) -> Result<Option<LightFile>> {
    let known: TrueLights = read(path, "lights")?;
    let mut lights = None;
    for edit in known.relight.values().chain([&known.training]).filter_map(|set| edit_of(set)) {
        edit.check().map_err(|reason| TrainError::File { path: path.to_owned(), reason })?;
        lights = edit_lights(&edit.lights, lights)?;
    }
    Ok(lights)
}

/// Whether a file of a relit set says what became of materials.
pub(crate) fn true_edit_of(path: &Path) -> Result<bool> {
    let said: serde_json::Value = read(path, "an edit")?;
    Ok(serde_json::from_value::<Painted>(said).is_ok())
}

/// Measures a run under the true lights of each relit set, at views of which an evaluation has metrics already.
///
/// # Errors
/// If the device fails or ground truth is damaged.
pub fn evaluate_relit(
    device: &Device,
    scene: &Scene,
    splats: &Splats,
    light: &RunLight,
    views: &[usize],
    into: &mut Evaluation,
) -> Result<()> {
    let truth = GroundTruth::of(scene);
    let known = match truth.lights() {
        Some(path) => read(&path, "lights")?,
        None => TrueLights::default(),
    };
    for name in truth.relit_names() {
        let theirs = views.iter().map(|v| Ok(truth.relit(&name, *v)?)).collect::<Result<Vec<_>>>()?;
        if theirs.iter().all(Option::is_none) {
            continue;
        }
        let painted = || -> Result<Option<MaterialEdit>> {
            let Some(path) = truth.relit_edit(&name) else { return Ok(None) };
            let said: serde_json::Value = read(&path, "an edit")?;
            // What says something else is another kind of edit.
            let Ok(painted) = serde_json::from_value::<Painted>(said) else { return Ok(None) };
            painted.edit(device, scene, splats)
        };
        for (name, edit, own) in edits_of(&name, &known, painted)? {
            let mut select = Selector { device, head: None, scene: None };
            let visibility = if own { light.visibility.clone() } else { Visibility::None };
            let start = Relit { splats: splats.clone(), light: RunLight { visibility, ..light.clone() } };
            let insert = |_: &super::Insert| Err(TrainError::Setting(format!("The set {name} inserts something.")));
            let relit = start.edited(&edit, 16, &mut select, insert)?;
            let mut shading = Shading::new(device, relit.upload(device)?)?;
            for ((&view, metrics), theirs) in views.iter().zip(&mut into.views).zip(&theirs) {
                let Some(theirs) = theirs else { continue };
                let ours = shading.shade(&scene.views[view].camera)?.radiance([0.0; 3]);
                let found = metrics.shaded.get_or_insert_with(ShadedMetrics::default);
                found.relit.insert(name.clone(), measure_relit(&ours, theirs)?);
            }
        }
    }
    let all: Vec<&ShadedMetrics> = into.views.iter().filter_map(|v| v.shaded.as_ref()).collect();
    into.mean.shaded = Some(mean(&all));
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn true_lights_become_an_edit() {
        let text = r#"{"unit": "metre", "relight": {"a": [
            {"name": "bulb", "on": true, "position": [0, 1, 0], "radius": 0.1, "point_light_intensity_equivalent": [1, 2, 3]},
            {"name": "dark", "on": false, "position": [0, 1, 0]},
            {"name": "pane", "on": true, "corners": [[0,0,0],[1,0,0],[1,1,0],[0,1,0]], "radiance": [1, 1, 1], "position": [0.5, 0.5, 0]}
        ], "b": [{"name": "sky", "on": true, "corners": [[0,0,0],[1,0,0],[1,1,0],[0,1,0]]}]}}"#;
        let known: TrueLights = serde_json::from_str(text).unwrap();
        let edit = edit_of(&known.relight["a"]).unwrap();
        assert!(edit.check().is_ok() && edit.lights.off && edit.environment.off);
        assert_eq!((edit.lights.add.len(), edit.lights.add[0].intensity), (2, Some([1.0, 2.0, 3.0])));
        assert!(edit.lights.add[1].position.is_none());
        assert!(edit_of(&known.relight["b"]).is_none());
    }

    #[test]
    fn painted_sets_are_lit_by_the_true_lights_and_by_the_learned_ones() {
        let text = r#"{"training": [{"on": true, "position": [0, 1, 0], "point_light_intensity_equivalent": [1, 2, 3]}],
            "relight": {"night": [{"on": true, "position": [0, 1, 0]}]}}"#;
        let known: TrueLights = serde_json::from_str(text).unwrap();
        let set = MaterialValues { roughness: Some(0.3), ..Default::default() };
        let place = Where { gaussians: Some(vec![1]), ..Default::default() };
        let change = MaterialEdit { place, set, scale: MaterialValues::default() };
        let found = edits_of("chair", &known, || Ok(Some(change.clone()))).unwrap();
        let names: Vec<_> = found.iter().map(|(name, edit, own)| (name.as_str(), edit.lights.off, *own)).collect();
        assert_eq!(names, [("chair_learned_light", false, true), ("chair", true, false)]);
        assert!(found.iter().all(|(_, edit, _)| edit.check().is_ok() && edit.materials == [change.clone()]));
        let alone = edits_of("chair", &TrueLights::default(), || Ok(Some(change.clone()))).unwrap();
        assert_eq!(alone.len(), 1);
        assert!(edits_of("chair", &known, || Ok(None)).unwrap().is_empty());
        // How bright the lamp of this one is nobody says.
        assert!(edits_of("night", &known, || Ok(Some(change))).unwrap().is_empty());
    }
}
