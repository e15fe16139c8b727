//! Relit pictures against ground truth: the true lights in place of the learned ones, no surroundings, and nothing in the way:
//! a visibility field knows what the learned lights see from their places, and says nothing sensible about others.
//!
//! Sets that show another edit than one of lights, or lights that are not known, are left out.

use super::{Edit, EnvironmentEdit, LightEdit, NewLight, Relit, Selector};
use crate::error::{Result, TrainError};
use crate::evaluate::Evaluation;
use crate::evaluate_shaded::{ShadedMetrics, mean, measure_relit};
use crate::shaded::{RunLight, Shading};
use serde::Deserialize;
use sgs_engine::Device;
use sgs_scene::{GroundTruth, Scene, Splats};
use std::collections::BTreeMap;

/// What is read of `gt/lights.json`.
#[derive(Deserialize)]
struct TrueLights {
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
    let Some(path) = truth.lights() else { return Ok(()) };
    let wrong = |reason: String| TrainError::File { path: path.clone(), reason };
    let text = std::fs::read_to_string(&path).map_err(|e| wrong(e.to_string()))?;
    let known: TrueLights = serde_json::from_str(&text).map_err(|e| wrong(format!("not lights: {e}")))?;
    for name in truth.relit_names() {
        let Some(edit) = known.relight.get(&name).and_then(|lights| edit_of(lights)) else { continue };
        let mut select = Selector { device, head: None, scene: None };
        let light = RunLight { visibility: None, ..light.clone() };
        let start = Relit { splats: splats.clone(), light };
        let relit =
            start.edited(&edit, 16, &mut select, |i| Err(wrong(format!("it inserts {}", i.source.display()))))?;
        let mut shading = Shading::new(device, relit.upload(device)?)?;
        for (&view, metrics) in views.iter().zip(&mut into.views) {
            let Some(theirs) = truth.relit(&name, view)? else { continue };
            let ours = shading.shade(&scene.views[view].camera)?.radiance([0.0; 3]);
            let found = metrics.shaded.get_or_insert_with(ShadedMetrics::default);
            found.relit.insert(name.clone(), measure_relit(&ours, &theirs)?);
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
}
