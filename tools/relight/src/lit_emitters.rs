//! Emitters that light a scene, with responses on the device.

use super::emitter_table::EmitterTable;
use super::emitters::{EmitterEdit, NewEmitter, free_name};
use super::emitting::{Emitting, warn_of_dark_suns};
use crate::error::{RelightError, Result};
use sgs_config::Settings;
use sgs_engine::Device;
use sgs_passes::Tuning;
use sgs_passes::pipeline::{FrameEmitter, LitScene, Responder};
use sgs_passes::transport::{AreaLight, Sky};
use sgs_run::{EmitterRow, RunDirectory};
use sgs_scene::{MOST_EMITTERS, Scene, Splats};
use std::path::Path;

/// Emitters of a run, and the scene whose training views show its surfaces.
pub struct LiveEmitters {
    pub emitting: Emitting,
    views: Scene,
    seed: u64,
}

impl LiveEmitters {
    /// Opens the emitters of a run. Returns `None` if the run has none or its scene is not there.
    pub fn open(device: &Device, source: &Path, settings: &Settings, splats: &Splats) -> Result<Option<LiveEmitters>> {
        let run = RunDirectory::open(source)?;
        if !run.emitters().is_file() {
            return Ok(None);
        }
        let views = match Scene::open(&settings.scene, &settings.scene_options()) {
            Ok(views) => views,
            Err(error) => {
                tracing::warn!(%error, "the run's scene is not there; its lights are shown instead of its emitters");
                return Ok(None);
            }
        };
        let emitting = Emitting::open(device, &run, &views, splats, settings.seed)?;
        Ok(emitting.map(|emitting| LiveEmitters { emitting, views, seed: settings.seed }))
    }

    /// Returns the emitters after an edit. `altered`: Gaussians that the edit changed.
    pub fn edited(&self, device: &Device, edit: &EmitterEdit, altered: Option<&Splats>) -> Result<Emitting> {
        let emitting = match altered {
            Some(splats) => self.emitting.of_splats(device, &self.views, splats, self.seed)?,
            None => self.emitting.clone(),
        };
        emitting.edited(edit)
    }
}

/// Emitters that light the scene.
pub struct LitEmitters {
    /// Emitters by row of the table, and their room.
    pub emitting: Emitting,
    pub table: EmitterTable,
    /// Update of the responses of moved emitters.
    responder: Responder,
}

/// Device and Gaussians of a scene.
#[derive(Clone, Copy)]
pub struct OnDevice<'a> {
    pub device: &'a Device,
    pub tuning: &'a Tuning,
    pub splats: &'a Splats,
}

impl LitEmitters {
    /// Returns emitters for a scene with responses to them.
    pub fn new(emitting: Emitting, scene: &LitScene) -> Result<Option<LitEmitters>> {
        let Some(transport) = &scene.scene.transport else { return Ok(None) };
        let responder = emitting.room.responder(transport)?;
        let table = EmitterTable::new(&emitting);
        Ok(Some(LitEmitters { emitting, table, responder }))
    }

    /// Solves the bounces of all emitters of a table. Returns the scene, too.
    fn solved(on: OnDevice<'_>, emitting: Emitting, mut table: EmitterTable) -> Result<(LitEmitters, LitScene)> {
        let shaded = emitting.respond(on.device, on.splats, &table.frame())?;
        let scene = LitScene::new(on.device, on.tuning, shaded)?;
        table.mark_current();
        match LitEmitters::new(emitting, &scene)? {
            Some(lit) => Ok((LitEmitters { table, ..lit }, scene)),
            None => Err(RelightError::Edit("The scene has no emitters.".to_owned())),
        }
    }

    /// Returns the emitters after an edit that leaves them where they are. Responses of moved emitters are stale.
    pub fn edited(self, emitting: Emitting) -> LitEmitters {
        let mut table = EmitterTable::new(&emitting);
        table.mark_moved(&self.table);
        LitEmitters { emitting, table, responder: self.responder }
    }

    /// Returns the emitters of a frame.
    pub fn frame(&self) -> Vec<FrameEmitter> {
        self.table.frame()
    }

    /// Submits the update of one response. Returns false if all are up to date.
    pub fn update(&mut self) -> Result<bool> {
        let Some((row, light)) = self.table.take_stale() else { return Ok(false) };
        self.responder.update(row as u32, &self.emitting.room.in_unit(&light))?;
        Ok(true)
    }

    /// Replaces shape and color of an emitter.
    pub fn replace(&mut self, emitter: usize, light: AreaLight) -> Result<()> {
        let row = self.table.row_of(emitter)?;
        self.table.replace(emitter, light)?;
        self.emitting.file.emitters[row].shape = light.shape;
        warn_of_dark_suns(&self.emitting.file.openings, &[light]);
        Ok(())
    }

    /// Adds an emitter after the others. Returns another scene unless the emitter takes the row of a removed one.
    pub fn add(&mut self, on: OnDevice<'_>, new: &NewEmitter) -> Result<Option<LitScene>> {
        let row = self.row(new)?;
        warn_of_dark_suns(&self.emitting.file.openings, &[row.light()]);
        let (mut emitting, mut table) = (self.emitting.clone(), self.table.clone());
        let at = table.add(row.clone());
        let scene = match emitting.file.emitters.get_mut(at) {
            Some(place) => {
                *place = row;
                (self.emitting, self.table) = (emitting, table);
                None
            }
            None if at >= MOST_EMITTERS as usize => {
                return Err(RelightError::Edit(format!("There are {at} emitters; use {MOST_EMITTERS} at most.")));
            }
            None => {
                emitting.file.emitters.push(row);
                emitting.in_place.push(false);
                let (lit, scene) = LitEmitters::solved(on, emitting, table)?;
                *self = lit;
                Some(scene)
            }
        };
        Ok(scene)
    }

    /// Sets the environment that windows show. Returns another scene.
    pub fn set_sky(&mut self, on: OnDevice<'_>, sky: Option<Sky>) -> Result<LitScene> {
        let emitting = self.emitting.with_outside(&self.emitting.file.openings, sky)?;
        let mut table = self.table.clone();
        table.show_environment(&emitting);
        let (lit, scene) = LitEmitters::solved(on, emitting, table)?;
        *self = lit;
        Ok(scene)
    }

    /// Returns the row of a new emitter, with a name that no other has.
    fn row(&self, new: &NewEmitter) -> Result<EmitterRow> {
        let wrong = |reason: String| RelightError::Edit(format!("The new emitter: {reason}."));
        let numbered = || (1..).map(|k| format!("new {k}")).find(|name| !self.table.has(name)).unwrap_or_default();
        let name = new.name.clone().unwrap_or_else(numbered);
        if name.trim().is_empty() {
            return Err(wrong("its name is empty; use a name or none".to_owned()));
        }
        let name = free_name(name, |name| self.table.has(name));
        let row = EmitterRow { name, on: true, color: new.color, shape: new.shape };
        row.light().check().map_err(|e| wrong(e.to_string()))?;
        Ok(row)
    }
}
