//! Evaluation of relit images against ground truth.
//!
//! In a run with emitters, the true lights replace the learned ones, with shadows and all bounces ([`super::bounced`]). In a
//! run of the published model, they replace them without environment map and without occlusion. A learned visibility
//! field is valid only for the learned lights at their positions. Where traced rays find shadow, the ground truth still
//! has indirect light, which that model lacks.
//!
//! A set that changes the materials of an instance is measured under the true lights of the photographs. With the
//! suffix [`LEARNED`], it is also measured under all learned light. A set that cannot be rendered has a reason in place
//! of metrics.

use super::bounced::evaluate_bounced;
use super::emitting::Emitting;
use super::lights::edit_lights;
use super::painted::{Known, LEARNED, Painted, key_of, painted_of, read};
use super::true_light::{TrueLight, TrueLights};
use super::{Edit, EnvironmentEdit, LightEdit, MaterialEdit, Relit, Selector};
use crate::error::{RelightError, Result};
use sgs_engine::Device;
use sgs_evaluate::{Evaluation, RelitPair, RelitSet, ShadedMetrics, mean, measure_relit};
use sgs_run::{LightFile, RunError, RunLight, Shading, Visibility};
use sgs_scene::{GroundTruth, Image, Scene, Splats};
use std::path::Path;

/// Returns the edit that replaces the learned lights by the true lights of a set.
///
/// `None` if the brightness of a light that is on is unknown.
fn edit_of(lights: &[TrueLight]) -> Option<Edit> {
    let add = lights.iter().filter(|l| l.on).map(TrueLight::as_new).collect::<Option<Vec<_>>>()?;
    let lights = LightEdit { off: true, add, ..Default::default() };
    let environment = EnvironmentEdit { off: true, ..Default::default() };
    Some(Edit { lights, environment, ..Default::default() })
}

/// Inputs for rendering one measurement of a set.
struct Rendering {
    edit: Edit,
    /// Uses the run's own lights and visibility.
    own: bool,
}

/// Returns the measurements of a set by reported name.
///
/// Each has its rendering, or the reason that it cannot be rendered.
fn renderings_of(
    name: &str,
    known: &TrueLights,
    painted: impl FnOnce() -> Result<Known<MaterialEdit>>,
) -> Result<Vec<(String, Known<Rendering>)>> {
    let dark = |list: &str| format!("gt/lights.json gives no intensity for a light of {list} that is on.");
    if let Some(lights) = known.relight.get(name) {
        let edit = edit_of(lights).ok_or_else(|| dark(&format!("\"{name}\"")));
        return Ok(vec![(name.to_owned(), edit.map(|edit| Rendering { edit, own: false }))]);
    }
    let change = match painted()? {
        Ok(change) => change,
        Err(reason) => return Ok(vec![(name.to_owned(), Err(reason))]),
    };
    let materials = vec![change];
    let learned = Edit { materials: materials.clone(), ..Default::default() };
    let under_true_lights = match edit_of(&known.training) {
        None => Err(dark("training")),
        Some(edit) if edit.lights.add.is_empty() => {
            Err("gt/lights.json lists no light of the training images that is on.".to_owned())
        }
        Some(edit) => Ok(Rendering { edit: Edit { materials, ..edit }, own: false }),
    };
    Ok(vec![
        (format!("{name}{LEARNED}"), Ok(Rendering { edit: learned, own: true })),
        (name.to_owned(), under_true_lights),
    ])
}

/// Reads the true lights of a scene as lights of a run.
///
/// Includes those of the photographs and of all relit sets. Skips sets with lights of unknown brightness.
pub(crate) fn true_lights_of(path: &Path) -> Result<Option<LightFile>> {
    let known: TrueLights = read(path, "lights")?;
    let mut lights = None;
    for edit in known.relight.values().chain([&known.training]).filter_map(|set| edit_of(set)) {
        edit.check().map_err(|reason| RelightError::File { path: path.to_owned(), reason })?;
        lights = edit_lights(&edit.lights, lights)?;
    }
    Ok(lights)
}

/// Returns whether the file of a relit set describes a material edit.
pub(crate) fn true_edit_of(path: &Path) -> Result<bool> {
    let value: serde_json::Value = read(path, "an edit")?;
    Ok(serde_json::from_value::<Painted>(value).is_ok())
}

/// Light of a run: that of the published model, or emitters whose light bounces.
pub enum LightOfRun<'a> {
    /// Lights, environment map and visibility.
    Published(&'a RunLight),
    /// Emitters, and the seed of the run.
    Emitting(&'a Emitting, u64),
}

/// Measures a run under the true lights of each relit set.
///
/// Measures the views that already have metrics in the evaluation. Every set appears among the means, with a reason if
/// it cannot be rendered.
///
/// # Errors
/// If the device fails or the ground truth is damaged.
pub fn evaluate_relit(
    device: &Device,
    scene: &Scene,
    splats: &Splats,
    light: &LightOfRun<'_>,
    views: &[usize],
    into: &mut Evaluation,
) -> Result<()> {
    let truth = GroundTruth::of(scene);
    let known = match truth.lights() {
        Some(path) => read(&path, "lights")?,
        None => TrueLights::default(),
    };
    let light = match light {
        LightOfRun::Published(light) => *light,
        LightOfRun::Emitting(emitting, seed) => {
            return evaluate_bounced(device, scene, splats, (*emitting, *seed), &known, views, into);
        }
    };
    let mut skipped = Vec::new();
    for name in truth.relit_names() {
        let theirs = views.iter().map(|v| Ok(truth.relit(&name, *v)?)).collect::<Result<Vec<_>>>()?;
        if theirs.iter().all(Option::is_none) {
            skipped.push((key_of(&name), "The set has no image of a measured view.".to_owned()));
            continue;
        }
        let painted = || painted_of(device, scene, splats, &truth, &name);
        for (name, rendering) in renderings_of(&name, &known, painted)? {
            let key = key_of(&name);
            let Rendering { edit, own } = match rendering {
                Ok(rendering) => rendering,
                Err(reason) => {
                    skipped.push((key, reason));
                    continue;
                }
            };
            let mut select = Selector { device, head: None, scene: None };
            let visibility = if own { light.visibility.clone() } else { Visibility::None };
            let start = Relit { splats: splats.clone(), light: RunLight { visibility, ..light.clone() } };
            let insert = |_: &super::Insert| Err(RelightError::Edit(format!("The set {name} inserts something.")));
            let relit = match start.edited(&edit, 16, &mut select, insert) {
                Err(RelightError::Edit(reason) | RelightError::Run(RunError::Refused(reason))) => {
                    skipped.push((key, reason));
                    continue;
                }
                other => other?,
            };
            let mut shading = Shading::new(device, relit.upload(device)?)?.without_visibility();
            let at: Vec<(usize, &Image)> =
                theirs.iter().enumerate().filter_map(|(i, theirs)| Some((i, theirs.as_ref()?))).collect();
            let radiance =
                |&(i, _): &(usize, &Image)| Ok(shading.shade(&scene.views[views[i]].camera)?.radiance([0.0; 3]));
            let ours = at.iter().map(radiance).collect::<Result<Vec<_>>>()?;
            let masks = at.iter().map(|&(i, _)| Ok(scene.load_mask(views[i])?)).collect::<Result<Vec<_>>>()?;
            let images = ours.iter().zip(&at).zip(&masks);
            let pairs: Vec<RelitPair<'_>> =
                images.map(|((ours, (_, theirs)), mask)| (ours, *theirs, mask.as_ref())).collect();
            for ((i, _), metrics) in at.iter().zip(measure_relit(&pairs)?) {
                let found = into.views[*i].shaded.get_or_insert_with(ShadedMetrics::default);
                found.relit.insert(key.clone(), RelitSet::Measured(metrics));
            }
        }
    }
    let all: Vec<&ShadedMetrics> = into.views.iter().filter_map(|v| v.shaded.as_ref()).collect();
    let mut mean = mean(&all);
    mean.relit.extend(skipped.into_iter().map(|(name, reason)| (name, RelitSet::Skipped { reason })));
    into.mean.shaded = Some(mean);
    Ok(())
}

/// Reports every relit set of a scene as skipped, for one reason.
pub fn skip_relit(scene: &Scene, reason: &str, into: &mut Evaluation) {
    let names = GroundTruth::of(scene).relit_names();
    if !names.is_empty() {
        let mean = into.mean.shaded.get_or_insert_with(ShadedMetrics::default);
        let set = |name: String| (key_of(&name), RelitSet::Skipped { reason: reason.to_owned() });
        mean.relit.extend(names.into_iter().map(set));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{MaterialValues, Where};

    #[test]
    fn true_lights_convert_to_an_edit() {
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
    fn material_sets_use_true_and_learned_lights() {
        let text = r#"{"training": [{"on": true, "position": [0, 1, 0], "point_light_intensity_equivalent": [1, 2, 3]}],
            "relight": {"night": [{"on": true, "position": [0, 1, 0]}]}}"#;
        let known: TrueLights = serde_json::from_str(text).unwrap();
        let set = MaterialValues { roughness: Some(0.3), ..Default::default() };
        let place = Where { gaussians: Some(vec![1]), ..Default::default() };
        let change = MaterialEdit { place, set, scale: MaterialValues::default() };
        let of = |name: &str, known: &TrueLights| {
            let found = renderings_of(name, known, || Ok(Ok(change.clone()))).unwrap();
            found.into_iter().map(|(name, r)| (name, r.map(|r| (r.edit, r.own)))).collect::<Vec<_>>()
        };
        let found = of("chair", &known);
        let names: Vec<_> = found.iter().map(|(name, r)| (name.as_str(), r.as_ref().unwrap())).collect();
        let found: Vec<_> = names.iter().map(|(name, (edit, own))| (*name, edit.lights.off, *own)).collect();
        assert_eq!(found, [("chair_learned_light", false, true), ("chair", true, false)]);
        assert!(names.iter().all(|(_, (edit, _))| edit.check().is_ok() && edit.materials == [change.clone()]));
        // Without true lights, the set itself has a reason.
        let alone = of("chair", &TrueLights::default());
        assert!(alone[0].1.is_ok() && alone[1].0 == "chair", "{:?}", alone[1]);
        assert!(alone[1].1.as_ref().unwrap_err().contains("lists no light of the training images"), "{:?}", alone[1]);
        // The brightness of this set's light is unknown.
        let night = of("night", &known);
        assert_eq!((night.len(), night[0].0.as_str()), (1, "night"));
        assert!(night[0].1.as_ref().unwrap_err().contains("no intensity"), "{:?}", night[0]);
        let none = renderings_of("chair", &known, || Ok(Err("No Gaussian.".into()))).unwrap();
        assert!(none.len() == 1 && none[0].1.as_ref().is_err_and(|reason| reason == "No Gaussian."));
    }

    #[test]
    fn set_named_mean_does_not_collide_with_the_mean() {
        assert_eq!((key_of("mean"), key_of("night")), ("mean_set".to_owned(), "night".to_owned()));
    }
}
