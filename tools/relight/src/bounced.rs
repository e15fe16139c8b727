//! Evaluation of relit images of runs with emitters: true lights and learned emitters.
//!
//! The true lights of a set replace the learned emitters. They cast shadows and bounce. The Gaussians of a learned emitter
//! take the radiance that the true light nearest to the emitter has in the set. Each set of lights is measured four times:
//! under direct light alone, with one bounce, with all bounces, and with all bounces under the learned emitters. The color of
//! a learned emitter changes by the factor by which its nearest true light changes from the photographs to the set. A light that
//! the photographs lack is added to the learned emitters.
//!
//! Directional light and environments enter through the openings of the room: those of the true light if it lists windows, else
//! those of the run. An environment shows in each of them.

use super::emitting::{Emitting, warn_of_dark_suns};
use super::materials::edit_materials;
use super::painted::{LEARNED, key_of, painted_of, read};
use super::true_light::{TrueLight, TrueLights};
use crate::error::Result;
use glam::Vec3;
use sgs_engine::Device;
use sgs_evaluate::{BouncesPsnr, Evaluation, RelitMetrics, RelitPair, RelitSet, ShadedMetrics, mean, measure_relit};
use sgs_passes::pipeline::ShadedScene;
use sgs_passes::transport::{AreaLight, LightShape};
use sgs_run::{OpeningRow, Shading, read_sky};
use sgs_scene::{GroundTruth, Image, Scene, Splats};
use sgs_transport::Bounces;
use std::path::Path;

/// Maximum distance between a learned emitter and its true light.
///
/// As a share of the diagonal of the enclosure. An emitter farther from every true light keeps its color.
const MATCHED: f32 = 0.15;

/// Lights of a measurement.
struct Lights {
    /// Physical lights.
    lights: Vec<AreaLight>,
    /// Radiance that the surfaces of each learned emitter emit.
    radiance: Vec<[f32; 3]>,
}

/// Views that are measured, and what measures them.
struct Measured<'a> {
    device: &'a Device,
    scene: &'a Scene,
    views: &'a [usize],
    truth: GroundTruth<'a>,
}

/// Measures a run with emitters under the true lights of each relit set.
///
/// # Errors
/// If the device fails or the ground truth is damaged.
pub(crate) fn evaluate_bounced(
    device: &Device,
    scene: &Scene,
    splats: &Splats,
    (emitting, seed): (&Emitting, u64),
    known: &TrueLights,
    views: &[usize],
    into: &mut Evaluation,
) -> Result<()> {
    let at = Measured { device, scene, views, truth: GroundTruth::of(scene) };
    let mut skipped = Vec::new();
    let mut parts = Vec::new();
    for name in at.truth.relit_names() {
        let key = key_of(&name);
        if !at.has(&name)? {
            skipped.push((key, "The set has no image of a measured view.".to_owned()));
            continue;
        }
        if let Some(list) = known.relight.get(&name) {
            let place = at.truth.lights();
            let openings = true_openings(list, emitting);
            let learned_room = under_sky(emitting, &emitting.file.openings, list, place.as_deref())?;
            let emitting = &under_sky(emitting, &openings, list, place.as_deref())?;
            let Some(lights) = true_lights(list, known, emitting) else {
                skipped
                    .push((key, format!("gt/lights.json gives no brightness for a light of \"{name}\" that is on.")));
                continue;
            };
            warn_of_dark_suns(&openings, &lights.lights);
            let shaded = |bounces| emitting.shaded(device, splats, &lights.lights, &lights.radiance, bounces);
            let [direct, one_bounce] = [shaded(Bounces::None)?, shaded(Bounces::One)?];
            let [direct, one_bounce] = [at.measure(&name, direct)?, at.measure(&name, one_bounce)?].map(|m| psnr(&m));
            let all = at.measure(&name, shaded(Bounces::All)?)?;
            let learned = match changed_emitters(list, known, &learned_room) {
                Some(l) => {
                    let shaded = learned_room.shaded(device, splats, &l.lights, &l.radiance, Bounces::All)?;
                    Some(psnr(&at.measure(&name, shaded)?))
                }
                None => None,
            };
            parts.push((
                key.clone(),
                BouncesPsnr { direct, one_bounce, all_bounces: psnr(&all), learned_emitters: learned },
            ));
            store(into, &key, all);
            continue;
        }
        let change = match painted_of(device, scene, splats, &at.truth, &name)? {
            Ok(change) => change,
            Err(reason) => {
                skipped.push((key, reason));
                continue;
            }
        };
        let mut edited = splats.clone();
        let mut chosen = vec![false; splats.len()];
        change.place.gaussians.iter().flatten().for_each(|&g| chosen[g] = true);
        edit_materials(&change, &chosen, &mut edited);
        let emitting = emitting.of_splats(device, scene, &edited, seed)?;
        let learned = emitting.own(device, &edited)?;
        store(into, &key_of(&format!("{name}{LEARNED}")), at.measure(&name, learned)?);
        match true_lights(&known.training, known, &emitting) {
            Some(l) if !l.lights.is_empty() => {
                let shaded = emitting.shaded(device, &edited, &l.lights, &l.radiance, Bounces::All)?;
                store(into, &key, at.measure(&name, shaded)?);
            }
            _ => skipped.push((key, "gt/lights.json lists no light of the training images that is on.".to_owned())),
        }
    }
    let all: Vec<&ShadedMetrics> = into.views.iter().filter_map(|v| v.shaded.as_ref()).collect();
    let mut mean = mean(&all);
    mean.relit.extend(skipped.into_iter().map(|(name, reason)| (name, RelitSet::Skipped { reason })));
    mean.relit_bounces.extend(parts);
    into.mean.shaded = Some(mean);
    Ok(())
}

/// Metrics of the views of which a set has an image. The index is that in the measured views.
type OfViews = Vec<(usize, RelitMetrics)>;

fn psnr(all: &OfViews) -> f64 {
    all.iter().map(|(_, m)| m.psnr).sum::<f64>() / all.len().max(1) as f64
}

fn store(into: &mut Evaluation, key: &str, all: OfViews) {
    for (i, metrics) in all {
        let found = into.views[i].shaded.get_or_insert_with(ShadedMetrics::default);
        found.relit.insert(key.to_owned(), RelitSet::Measured(metrics));
    }
}

impl Measured<'_> {
    /// Returns whether a set has an image of a measured view.
    fn has(&self, name: &str) -> Result<bool> {
        for view in self.views {
            if self.truth.relit(name, *view)?.is_some() {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Compares a scene with the images of a set.
    fn measure(&self, name: &str, shaded: ShadedScene) -> Result<OfViews> {
        let mut shading = Shading::new(self.device, shaded)?.without_visibility();
        let mut pairs: Vec<(usize, Image, Image, Option<Image>)> = Vec::new();
        for (i, view) in self.views.iter().enumerate() {
            let Some(theirs) = self.truth.relit(name, *view)? else { continue };
            let ours = shading.shade(&self.scene.views[*view].camera)?.radiance([0.0; 3]);
            pairs.push((i, ours, theirs, self.scene.load_mask(*view)?));
        }
        let images: Vec<RelitPair<'_>> = pairs.iter().map(|(_, a, b, mask)| (a, b, mask.as_ref())).collect();
        Ok(pairs.iter().map(|p| p.0).zip(measure_relit(&images)?).collect())
    }
}

/// Returns the true lights of a set that are on, and the radiance of emitters.
///
/// The Gaussians of an emitter emit the color of the true light nearest to it, or nothing if that light is off. Returns `None`
/// if the shape or brightness of a light is unknown.
fn true_lights(list: &[TrueLight], known: &TrueLights, emitting: &Emitting) -> Option<Lights> {
    let inside = list.iter().filter(|l| l.on && l.environment().is_none());
    let mut lights = inside.map(TrueLight::as_area).collect::<Option<Vec<_>>>()?;
    lights.extend(windows_of(list, emitting));
    let emitters = emitting.lights();
    let radiance = emitters.iter().map(|emitter| {
        if let Some(radiance) = shown_sky(emitter, list, emitting) {
            return radiance;
        }
        let now =
            nearest(emitter, &known.training).and_then(|(i, _)| list.iter().find(|l| same(l, &known.training[i])));
        now.filter(|l| l.on).and_then(TrueLight::as_area).map_or([0.0; 3], |l| l.color)
    });
    Some(Lights { radiance: radiance.collect(), lights })
}

/// Returns the environment of a set that is on: its map, and the factor on it.
fn sky_of(list: &[TrueLight]) -> Option<(&Path, [f32; 3])> {
    list.iter().filter(|l| l.on).find_map(TrueLight::environment)
}

/// Returns the windows through which the environment of a set shines.
fn windows_of(list: &[TrueLight], emitting: &Emitting) -> Vec<AreaLight> {
    let skies: Vec<_> = list.iter().filter(|l| l.on).filter_map(|l| Some((l.environment()?.1, l.window()))).collect();
    let of = |(color, window): &([f32; 3], Option<OpeningRow>)| match window {
        Some(opening) => vec![AreaLight { shape: opening.window(), color: *color }],
        None => emitting.windows(*color),
    };
    skies.iter().flat_map(of).collect()
}

/// Returns the opening in which an emitter is.
fn opening_of(emitter: &AreaLight, emitting: &Emitting) -> Option<OpeningRow> {
    let own = OpeningRow::of(&emitter.shape)?;
    emitting.file.openings.iter().copied().find(|o| *o == own)
}

/// Returns the radiance of an emitter's surface under the environment of a set.
///
/// Returns `None` without one, or if the emitter is in no opening.
fn shown_sky(emitter: &AreaLight, list: &[TrueLight], emitting: &Emitting) -> Option<[f32; 3]> {
    let (_, color) = sky_of(list)?;
    let seen = emitting.surface_of(&opening_of(emitter, emitting)?.window());
    Some([0, 1, 2].map(|c| seen[c] * color[c]))
}

/// Returns the emitters in a room with these openings and the environment of a set. `lights`: path of `gt/lights.json`.
fn under_sky(
    emitting: &Emitting,
    openings: &[OpeningRow],
    list: &[TrueLight],
    lights: Option<&Path>,
) -> Result<Emitting> {
    let beside = lights.and_then(Path::parent).unwrap_or(Path::new(""));
    let sky = sky_of(list).map(|(file, _)| read_sky(&beside.join(file))).transpose()?;
    emitting.with_outside(openings, sky)
}

/// Returns the openings of a set: windows of its environment, else the run's.
fn true_openings(list: &[TrueLight], emitting: &Emitting) -> Vec<OpeningRow> {
    let own: Vec<OpeningRow> = list.iter().filter_map(TrueLight::window).collect();
    if own.is_empty() { emitting.file.openings.clone() } else { own }
}

/// View of a relit set. Both images are linear.
#[derive(Clone, Debug)]
pub struct RelitView {
    /// Name of the set.
    pub name: String,
    /// Image under the learned emitters, changed as the true lights change.
    pub ours: Image,
    /// True image.
    pub truth: Image,
}

/// Relights a view as in each relit set whose lights are known.
///
/// The learned emitters change as the true lights do, and all light bounces. Empty without emitters. The images are those of which `relit_bounces` has the PSNR of `learned_emitters`.
///
/// # Errors
/// If the device fails or the ground truth is damaged.
pub fn relit_views(
    device: &Device,
    scene: &Scene,
    splats: &Splats,
    emitting: &Emitting,
    view: usize,
) -> Result<Vec<RelitView>> {
    let truth = GroundTruth::of(scene);
    let Some(path) = truth.lights() else { return Ok(Vec::new()) };
    let known: TrueLights = read(&path, "lights")?;
    let mut all = Vec::new();
    for name in truth.relit_names() {
        let Some(list) = known.relight.get(&name) else { continue };
        let emitting = &under_sky(emitting, &emitting.file.openings, list, Some(&path))?;
        let Some(lights) = changed_emitters(list, &known, emitting) else { continue };
        let Some(theirs) = truth.relit(&name, view)? else { continue };
        let shaded = emitting.shaded(device, splats, &lights.lights, &lights.radiance, Bounces::All)?;
        let mut shading = Shading::new(device, shaded)?.without_visibility();
        let ours = shading.shade(&scene.views[view].camera)?.radiance([0.0; 3]);
        all.push(RelitView { name, ours, truth: theirs });
    }
    Ok(all)
}

/// Returns the learned emitters, changed as their true lights change.
///
/// Lights that the photographs lack follow them. The factor per color is the color of the nearest true light in the set over
/// its color in the photographs. Returns `None` without learned emitters, or if the shape or brightness of a light that the
/// photographs lack is unknown. Where another environment replaces that of the photographs, emitters in openings are dark.
fn changed_emitters(list: &[TrueLight], known: &TrueLights, emitting: &Emitting) -> Option<Lights> {
    let [low, high] = [emitting.file.enclosure.low, emitting.file.enclosure.high].map(glam::Vec3::from);
    let most = MATCHED * low.distance(high);
    // Factor on emitters in openings, if the photographs show an environment there.
    let (before, after) = (sky_of(&known.training), sky_of(list));
    let same_sky = before.zip(after).filter(|(b, a)| b.0 == a.0);
    let factor = before.map(|_| same_sky.map_or([0.0; 3], |(b, a)| [0, 1, 2].map(|c| ratio(a.1[c], b.1[c]))));
    let change = |emitter: &AreaLight| {
        if let (Some(by), Some(_)) = (factor, opening_of(emitter, emitting)) {
            return AreaLight { color: [0, 1, 2].map(|c| emitter.color[c] * by[c]), ..*emitter };
        }
        let Some((i, distance)) = nearest(emitter, &known.training) else { return *emitter };
        let before = known.training[i].as_area().map_or([0.0; 3], |l| l.color);
        let after = list.iter().find(|l| same(l, &known.training[i])).filter(|l| l.on).and_then(TrueLight::as_area);
        let after = after.map_or([0.0; 3], |l| l.color);
        if distance > most {
            return *emitter;
        }
        let by = [0, 1, 2].map(|c| ratio(after[c], before[c]));
        AreaLight { color: [0, 1, 2].map(|c| emitter.color[c] * by[c]), ..*emitter }
    };
    let mut lights: Vec<AreaLight> = emitting.lights().iter().map(change).collect();
    if lights.is_empty() {
        return None;
    }
    let of_surface = |(before, after): (&AreaLight, &AreaLight)| {
        shown_sky(before, list, emitting).filter(|_| same_sky.is_none()).unwrap_or(after.color)
    };
    let radiance = emitting.lights().iter().zip(&lights).map(of_surface).collect();
    lights.extend(added(list, known)?);
    if let Some((_, color)) = sky_of(list).filter(|_| same_sky.is_none()) {
        lights.extend(emitting.windows(color));
    }
    Some(Lights { radiance, lights })
}

/// Returns the factor by which a channel changes; 1 if it was black.
fn ratio(after: f32, before: f32) -> f32 {
    if before > 0.0 { after / before } else { 1.0 }
}

/// Returns the lights of a set that are on and that the photographs lack.
///
/// Returns `None` if one has no known shape or brightness.
fn added(list: &[TrueLight], known: &TrueLights) -> Option<Vec<AreaLight>> {
    let inside = list.iter().filter(|l| l.on && l.environment().is_none());
    let new = inside.filter(|l| !known.training.iter().any(|t| same(l, t)));
    new.map(TrueLight::as_area).collect()
}

/// Returns whether two entries are the same light in different sets: by name, else by place or direction.
fn same(a: &TrueLight, b: &TrueLight) -> bool {
    if !a.name.is_empty() || !b.name.is_empty() {
        return a.name == b.name;
    }
    let along = |l: &AreaLight| match l.shape {
        LightShape::Directional { direction, .. } => Vec3::from(direction).normalize_or_zero(),
        _ => Vec3::ZERO,
    };
    let (Some(a), Some(b)) = (a.as_area(), b.as_area()) else { return false };
    match (a.shape.center(), b.shape.center()) {
        (Some(a), Some(b)) => a.distance(b) < 1e-3,
        (None, None) => along(&a).distance(along(&b)) < 1e-3,
        _ => false,
    }
}

/// Returns the light of a list that is nearest to an emitter, and its distance.
fn nearest(emitter: &AreaLight, list: &[TrueLight]) -> Option<(usize, f32)> {
    let at = emitter.shape.center()?;
    let places = list.iter().enumerate().filter_map(|(i, l)| Some((i, l.as_area()?.shape.center()?.distance(at))));
    places.min_by(|a, b| a.1.total_cmp(&b.1))
}

#[cfg(test)]
mod closures;

#[cfg(test)]
mod tests {
    use super::*;

    fn counted(set: &str) -> Option<usize> {
        let training = r#"[{"on": true, "name": "a", "position": [0,0,0], "intensity": [1,1,1]},
            {"on": true, "direction": [0,-1,0], "irradiance": [1,1,1]}, {"on": true, "position": [5,0,0], "intensity": [1,1,1]}]"#;
        let known = TrueLights { training: serde_json::from_str(training).unwrap(), ..Default::default() };
        added(&serde_json::from_str::<Vec<TrueLight>>(set).unwrap(), &known).map(|l| l.len())
    }

    #[test]
    fn lights_that_the_photographs_lack_are_added() {
        let old = r#"{"on": true, "name": "a", "position": [9,9,9], "intensity": [2,2,2]},
            {"on": true, "direction": [0,-2,0], "irradiance": [2,1,1]}, {"on": true, "position": [5,0,0], "intensity": [1,1,1]}"#;
        assert_eq!(counted(&format!("[{old}]")), Some(0));
        let new =
            |on: bool| format!(r#"[{old}, {{"on": {on}, "name": "b", "position": [1,1,1], "intensity": [1,1,1]}}]"#);
        assert_eq!((counted(&new(true)), counted(&new(false))), (Some(1), Some(0)));
        assert_eq!(counted(r#"[{"on": true, "direction": [0,0,1], "irradiance": [2,1,1]}]"#), Some(1));
        assert_eq!(counted(r#"[{"on": true, "name": "dark", "position": [0,0,0]}]"#), None);
    }
}
