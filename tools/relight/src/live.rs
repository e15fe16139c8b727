//! Run on a device whose light changes per frame, for interactive programs.
//!
//! Guarantees: a failed call changes nothing. An edit starts from the run as stored on disk; single changes start from
//! the current state. Changes of lights only write numbers on the host, which each frame uploads.
//! [`sgs_passes::pipeline::LitView`] renders frames; [`Relighter::relit`] yields images on the host.

use super::edit::{Edit, Insert, NewLight};
use super::emitters::{EmitterEdit, NewEmitter};
use super::environment::edit_environment;
use super::light_table::{LightParameters, LightTable};
use super::lights::edit_lights;
use super::lit_emitters::{LitEmitters, LiveEmitters, OnDevice};
use super::{Relit, Selector};
use crate::error::{RelightError, Result};
use sgs_config::Settings;
use sgs_engine::Device;
use sgs_passes::Tuning;
use sgs_passes::pipeline::{Lighting, LitEnvironment, LitScene, ShadedScene};
use sgs_passes::scene::FEATURES;
use sgs_passes::shade::environment::latlong;
use sgs_passes::transport::{AreaLight, Sky};
use sgs_run::{
    EmitterRow, RunDirectory, RunLight, SemanticHead, Texels, Visibility, light_of, read_light, read_splats,
    shaded_environment, shaded_scene,
};
use sgs_scene::{Scene, Splats};
use std::path::{Path, PathBuf};

/// Reason why the environment map of a scene with emitters cannot be changed.
const NO_ENVIRONMENT: &str = "Emitters light the scene, and no environment is behind its windows; set one.";
/// Reason why a scene has no emitters to change.
const NO_EMITTERS: &str = "No emitters light the scene, so that none can be added or changed; use lights.";
/// Default number of lights that may be added before the capacity grows.
const SPARE: u32 = 16;

/// Run under changing light.
///
/// Visibility stays that of the run, learned or traced, however its lights change. In contrast, [`Relit::edited`]
/// switches to traced visibility once none of the run's own lights remains at its position.
pub struct Relighter {
    device: Device,
    tuning: Tuning,
    source: PathBuf,
    settings: Option<Settings>,
    /// Run as stored on disk.
    run: Relit,
    /// Gaussians after a material edit or an insertion; `None` if they are the run's.
    altered: Option<Splats>,
    environment: Option<Texels>,
    rows: LightTable,
    /// Emitters of a run, as stored on disk.
    emitting: Option<LiveEmitters>,
    /// Emitters that light the scene, instead of the lights.
    emitters: Option<LitEmitters>,
    scene: LitScene,
}

/// Reads the Gaussians of a run directory, or of a PLY or glTF file.
///
/// Also returns the settings of a run directory.
///
/// # Errors
/// If the source is neither, is damaged, or training has not finished.
pub fn source_of(source: &Path) -> Result<(Splats, Option<Settings>)> {
    let wrong = |reason: &str| RelightError::File { path: source.to_owned(), reason: reason.to_owned() };
    if !source.is_dir() {
        return match source.exists() {
            true => Ok((read_splats(source)?, None)),
            false => Err(wrong("there is no such run directory, PLY or glTF file")),
        };
    }
    let run = RunDirectory::open(source)?;
    let ply = run.path("scene.ply");
    if !ply.is_file() {
        return Err(wrong("it has no scene.ply yet: training was not finished"));
    }
    Ok((Splats::read_ply(&ply)?, Some(run.settings()?)))
}

impl Relighter {
    /// Opens a run directory, or a PLY or glTF file with materials.
    ///
    /// The light is in the file or beside it. `capacity` is the number of lights that fit; 0 fits a few more than the
    /// run has.
    ///
    /// # Errors
    /// If materials or normals are missing, a file is damaged, or memory runs out.
    pub fn open(device: &Device, source: &Path, capacity: u32) -> Result<Relighter> {
        let (splats, settings) = source_of(source)?;
        let missing = [
            ("materials", splats.albedo.is_none() || splats.roughness.is_none()),
            ("normals", splats.normals.is_none()),
        ];
        if let Some((what, _)) = missing.iter().find(|(_, missing)| *missing) {
            let name = source.display();
            let message = format!("\"{name}\" has no {what}; train its materials with --stage intrinsic.");
            return Err(RelightError::Edit(message));
        }
        let light = match &settings {
            Some(settings) => light_of(&RunDirectory::open(source)?, settings)?,
            None => read_light(source, Settings::default().intrinsic.environment.resolution)?,
        };
        let run = Relit { splats, light };
        let tuning = Tuning::for_device(device.info());
        let emitting = match &settings {
            Some(settings) => LiveEmitters::open(device, source, settings, &run.splats)?,
            None => None,
        };
        let scene = match &emitting {
            Some(live) => LitScene::new(device, &tuning, live.emitting.live(device, &run.splats)?)?,
            None => with_light(device, &tuning, &run.splats, run.light.environment.as_ref(), &run.light)?,
        };
        let lights = run.light.lights.as_ref();
        let count = lights.map_or(0, |l| l.lights.len() as u32);
        let mut rows = LightTable::new(lights, if capacity == 0 { count + SPARE } else { capacity }, 1);
        let emitters = match &emitting {
            Some(live) => LitEmitters::new(live.emitting.clone(), &scene)?,
            None => None,
        };
        rows.set_emitters(emitters.as_ref().map(LitEmitters::frame).unwrap_or_default());
        let environment = run.light.environment.clone();
        let (device, source) = (device.clone(), source.to_owned());
        let altered = None;
        Ok(Relighter { device, tuning, source, settings, run, altered, environment, rows, emitting, emitters, scene })
    }

    /// Returns the scene, for frames.
    pub fn scene(&self) -> &LitScene {
        &self.scene
    }

    /// Returns the lights of a frame.
    pub fn lighting(&self) -> &Lighting {
        self.rows.lighting()
    }

    /// Returns whether emitters with bounces light the scene. They then are its lights.
    pub fn has_emitters(&self) -> bool {
        self.emitters.is_some()
    }

    /// Returns an emitter as in `emitters.json`, or as an edit left it.
    ///
    /// # Errors
    /// If the emitter does not exist.
    pub fn emitter(&self, emitter: usize) -> Result<&EmitterRow> {
        match &self.emitters {
            Some(e) => e.table.file(emitter),
            None => refused(format!("Emitter {emitter} does not exist, no emitters light the scene.")),
        }
    }

    /// Returns the number of lights.
    pub fn lights(&self) -> usize {
        self.emitters.as_ref().map_or_else(|| self.rows.len(), |e| e.table.len())
    }

    /// Returns a light.
    ///
    /// # Errors
    /// If the light does not exist.
    pub fn light(&self, light: usize) -> Result<LightParameters> {
        self.emitters.as_ref().map_or_else(|| self.rows.get(light), |e| e.table.get(light))
    }

    /// Returns the linear color of a light, summed over all directions; its largest component is 1.
    ///
    /// # Errors
    /// If the light does not exist.
    pub fn light_color(&self, light: usize) -> Result<[f32; 3]> {
        self.emitters.as_ref().map_or_else(|| self.rows.color(light), |e| e.table.color(light))
    }

    /// Changes a light, without device memory or waiting.
    ///
    /// The next frame shows the direct light of a moved emitter. Its bounces follow [`Relighter::update`].
    ///
    /// # Errors
    /// If the light does not exist, or the values are invalid.
    pub fn set_light(&mut self, light: usize, light_parameters: LightParameters) -> Result<()> {
        if let Some(lit) = &mut self.emitters {
            lit.table.set(light, light_parameters)?;
            self.rows.set_emitters(lit.frame());
            return Ok(());
        }
        self.rows.set(light, light_parameters)
    }

    /// Replaces shape and color of an emitter, without device memory or waiting.
    ///
    /// Its gain and the factors of its color become 1. [`Relighter::update`] computes its bounces. A window stays a window.
    ///
    /// # Errors
    /// If no emitters light the scene, the emitter does not exist, or the light is invalid. Nothing changes then.
    pub fn set_emitter(&mut self, emitter: usize, light: AreaLight) -> Result<()> {
        let Some(lit) = &mut self.emitters else { return refused(NO_EMITTERS.to_owned()) };
        lit.replace(emitter, light)?;
        self.rows.set_emitters(lit.frame());
        Ok(())
    }

    /// Adds an emitter after the others and returns its number.
    ///
    /// It takes the place of a removed emitter if there is one. Else it solves the bounces of all emitters and waits, and
    /// views rebuild their plans at their next frame. A window lights the scene in white if no environment is behind it.
    ///
    /// # Errors
    /// If no emitters light the scene, the emitter is invalid, or memory runs out. Nothing changes then.
    pub fn add_emitter(&mut self, new: &NewEmitter) -> Result<usize> {
        let Some(lit) = &mut self.emitters else { return refused(NO_EMITTERS.to_owned()) };
        let splats = self.altered.as_ref().unwrap_or(&self.run.splats);
        let scene = lit.add(OnDevice { device: &self.device, tuning: &self.tuning, splats }, new)?;
        self.rows.set_emitters(lit.frame());
        let number = lit.table.len() - 1;
        if let Some(scene) = scene {
            self.scene = scene;
        }
        Ok(number)
    }

    /// Submits the trace and the solve of one moved emitter. Returns false if the bounces of all are up to date.
    ///
    /// Frames that are submitted afterwards show its bounces. Call it once before each frame.
    ///
    /// # Errors
    /// If the device fails.
    pub fn update(&mut self) -> Result<bool> {
        self.emitters.as_mut().map_or(Ok(false), LitEmitters::update)
    }

    /// Adds a light and returns its index, or that of the first patch of a rectangle.
    ///
    /// If the capacity for lights is exceeded, it at least doubles. Views then rebuild their plans at their next frame.
    /// If emitters light the scene, the light is added as an emitter ([`Relighter::add_emitter`]).
    ///
    /// # Errors
    /// If the light is invalid.
    pub fn add_light(&mut self, new: &NewLight) -> Result<usize> {
        if self.has_emitters() {
            return self.add_emitter(&new.emitter()?);
        }
        self.rows.add(new)
    }

    /// Removes a light or an emitter; the indices of later ones decrease by one. Neither allocates nor waits.
    ///
    /// The surface of a removed emitter is dark.
    ///
    /// # Errors
    /// If the light does not exist.
    pub fn remove_light(&mut self, light: usize) -> Result<()> {
        let Some(lit) = &mut self.emitters else { return self.rows.remove(light) };
        lit.table.remove(light)?;
        self.rows.set_emitters(lit.frame());
        Ok(())
    }

    /// Returns whether the scene has an environment map, or windows show one.
    pub fn has_environment(&self) -> bool {
        self.emitters.as_ref().map_or(self.scene.environment.is_some(), |lit| lit.emitting.sky.is_some())
    }

    /// Sets the factors on the environment map, or on the one that windows show.
    ///
    /// Neither allocates nor waits.
    ///
    /// # Errors
    /// If a factor is negative or not finite, or emitters light the scene and no environment is behind its windows.
    pub fn set_environment_gain(&mut self, gain: [f32; 3]) -> Result<()> {
        let Some(lit) = &mut self.emitters else { return self.rows.set_environment(gain) };
        if lit.emitting.sky.is_none() {
            return refused(NO_ENVIRONMENT.to_owned());
        }
        lit.table.set_environment(gain)?;
        self.rows.set_emitters(lit.frame());
        Ok(())
    }

    /// Replaces the environment map with a latitude-longitude map. If emitters light the scene, their windows show it.
    ///
    /// Linear, three floats per pixel; negative values count as 0. Allocates memory and waits for the device. Frames in
    /// flight use the old map.
    ///
    /// # Errors
    /// If the size is invalid, values are not finite, or memory runs out.
    pub fn set_environment(&mut self, map: &[f32], size: [u32; 2]) -> Result<()> {
        let [width, height] = size;
        if height == 0 || u64::from(width) != 2 * u64::from(height) || width > 1 << 14 {
            let message =
                format!("An environment must be twice as wide as high, up to 16384, but this is {width}×{height}.");
            return Err(RelightError::Edit(message));
        }
        if map.len() as u64 != 3 * u64::from(width) * u64::from(height) {
            let message = format!("An environment of {width}×{height} has not {} floats.", map.len());
            return Err(RelightError::Edit(message));
        }
        if map.iter().any(|v| !v.is_finite()) {
            return Err(RelightError::Edit("An environment must not hold numbers that are not finite.".into()));
        }
        let map: Vec<f32> = map.iter().map(|v| v.max(0.0)).collect();
        if let Some(lit) = &mut self.emitters {
            let splats = self.altered.as_ref().unwrap_or(&self.run.splats);
            let on = OnDevice { device: &self.device, tuning: &self.tuning, splats };
            self.scene = lit.set_sky(on, Sky::new(&map, size))?;
            self.rows.set_emitters(lit.frame());
            return Ok(());
        }
        let cube = self.environment_size();
        let texels = Texels { size: cube, data: latlong::to_cube(&map, size, cube) };
        self.scene.environment = Some(self.filtered(&texels)?);
        self.environment = Some(texels);
        Ok(())
    }

    /// Returns the number of texels along an edge of the environment map.
    pub fn environment_size(&self) -> u32 {
        let current = self.environment.as_ref().or(self.run.light.environment.as_ref()).map(|e| e.size);
        current.unwrap_or_else(|| self.settings.as_ref().map_or(64, |s| s.intrinsic.environment.edge()))
    }

    fn filtered(&self, texels: &Texels) -> Result<LitEnvironment> {
        Ok(LitEnvironment::new(&self.device, &self.tuning, shaded_environment(&self.device, texels)?)?)
    }

    /// Applies an edit to the run as stored on disk; earlier changes are lost.
    ///
    /// An edit of lights alone allocates no device memory within the capacity.
    ///
    /// # Errors
    /// If the edit names something that does not exist. Nothing changes then.
    pub fn edit(&mut self, edit: &Edit) -> Result<()> {
        edit.check().map_err(|reason| RelightError::Edit(format!("The edit cannot be applied: {reason}.")))?;
        if edit.emitters != EmitterEdit::default() {
            if self.emitting.is_none() {
                let source = self.source.display();
                return refused(format!("\"{source}\" has no emitters, or its scene is not there."));
            }
            if edit.changes_published_light() {
                return refused("An edit of \"emitters\" takes no \"lights\" or \"environment\".".to_owned());
            }
        }
        let size = self.run.light.environment.as_ref().map_or_else(|| self.environment_size(), |e| e.size);
        let alters = !edit.materials.is_empty() || !edit.insert.is_empty();
        let initial = &self.run.light;
        let (lights, environment, altered) = if alters {
            let relit = self.altered(edit, size)?;
            (relit.light.lights, relit.light.environment, Some(relit.splats))
        } else {
            let lights = edit_lights(&edit.lights, initial.lights.clone())?;
            (lights, edit_environment(&edit.environment, initial.environment.clone(), size)?, None)
        };
        let emitting = match &self.emitting {
            Some(live) if !edit.changes_published_light() => {
                Some(live.edited(&self.device, &edit.all_emitters()?, altered.as_ref())?)
            }
            _ => None,
        };
        let mut scene = None;
        let mut environment_map = None;
        if let Some(emitting) = &emitting {
            let same = self.emitters.as_ref().is_some_and(|e| e.emitting.same_places(emitting));
            if !same || alters || self.altered.is_some() {
                let splats = altered.as_ref().unwrap_or(&self.run.splats);
                scene = Some(LitScene::new(&self.device, &self.tuning, emitting.live(&self.device, splats)?)?);
            }
        } else if alters || self.altered.is_some() || self.emitters.is_some() {
            let splats = altered.as_ref().unwrap_or(&self.run.splats);
            scene = Some(with_light(&self.device, &self.tuning, splats, environment.as_ref(), initial)?);
        } else if environment != self.environment {
            environment_map = Some(environment.as_ref().map(|texels| self.filtered(texels)).transpose()?);
        }
        let model = self.rows.lighting().model;
        let emitters = match (emitting, &scene, self.emitters.take()) {
            // The responses stay, except those of moved emitters.
            (Some(emitting), None, Some(before)) => Some(before.edited(emitting)),
            (Some(emitting), Some(scene), before) => match LitEmitters::new(emitting, scene) {
                Ok(emitters) => emitters,
                Err(error) => {
                    self.emitters = before;
                    return Err(error);
                }
            },
            _ => None,
        };
        // No call below fails.
        self.rows = LightTable::new(lights.as_ref(), model.lights, model.lobes);
        self.emitters = emitters;
        self.rows.set_emitters(self.emitters.as_ref().map(LitEmitters::frame).unwrap_or_default());
        if let Some(scene) = scene {
            self.scene = scene;
        }
        if let Some(environment_map) = environment_map {
            self.scene.environment = environment_map;
        }
        self.environment = environment;
        self.altered = altered;
        Ok(())
    }

    /// Restores the run as stored on disk.
    ///
    /// # Errors
    /// If memory runs out.
    pub fn reset(&mut self) -> Result<()> {
        self.edit(&Edit::default())
    }

    fn altered(&self, edit: &Edit, size: u32) -> Result<Relit> {
        let by_class = edit.materials.iter().any(|m| m.place.class.is_some());
        let classes =
            self.source.is_dir() && self.run.splats.semantic.as_ref().is_some_and(|(width, _)| *width == FEATURES);
        let head = match by_class && classes {
            true => Some(SemanticHead::load(&RunDirectory::open(&self.source)?.semantics())?),
            false => None,
        };
        let by_region = edit.materials.iter().any(|m| m.place.region.is_some());
        let scene = match (&self.settings, by_region) {
            (Some(settings), true) => Some(Scene::open(&settings.scene, &settings.scene_options())?),
            _ => None,
        };
        let mut select = Selector { device: &self.device, head, scene: scene.as_ref() };
        let load = |insert: &Insert| source_of(&insert.source).map(|(splats, _)| splats);
        self.run.clone().edited(edit, size, &mut select, load)
    }

    /// Returns the current state for a [`sgs_passes::pipeline::Shader`].
    ///
    /// # Errors
    /// If memory runs out.
    pub fn shaded(&self) -> Result<ShadedScene> {
        if !self.has_emitters() {
            return self.relit().upload(&self.device);
        }
        let splats = self.altered.as_ref().unwrap_or(&self.run.splats);
        let mut scene = shaded_scene(&self.device, splats, None, None, &Visibility::None)?;
        scene.transport = self.scene.scene.transport.clone();
        scene.set_emitters(&self.lighting().emitters);
        Ok(scene)
    }

    /// Returns the current state on the host, without emitters.
    pub fn relit(&self) -> Relit {
        let splats = self.altered.as_ref().unwrap_or(&self.run.splats).clone();
        let mut environment = self.environment.clone();
        let gain = self.lighting().environment;
        for texel in environment.iter_mut().flat_map(|e| e.data.chunks_exact_mut(3)) {
            texel.iter_mut().zip(&gain).for_each(|(v, g)| *v *= g);
        }
        let visibility = self.run.light.visibility.clone();
        Relit { splats, light: RunLight { lights: self.rows.file(), environment, visibility } }
    }
}

fn refused<T>(text: String) -> Result<T> {
    Err(RelightError::Edit(text))
}

fn with_light(
    device: &Device,
    tuning: &Tuning,
    splats: &Splats,
    environment: Option<&Texels>,
    light: &RunLight,
) -> Result<LitScene> {
    let scene = shaded_scene(device, splats, None, environment, &light.visibility)?;
    Ok(LitScene::new(device, tuning, scene)?)
}
