//! Light of a run with emitters: physical lights and their bounces.

use super::emitters::{EditedEmitters, EmitterEdit, edit_emitters};
use super::environment::edit_sky;
use crate::environment::EnvironmentEdit;
use crate::error::Result;
use sgs_engine::Device;
use sgs_passes::pipeline::{FrameEmitter, ShadedScene};
use sgs_passes::transport::{AreaLight, LightShape, Opening, Sky};
use sgs_run::{EmitterFile, OpeningRow, RunDirectory, Visibility, read_emitters, read_sky, shaded_scene};
use sgs_scene::{Scene, Splats};
use sgs_transport::{Bounces, Room, room_of};
use std::sync::Arc;

/// Emitters of a run, and the room in which their light bounces.
#[derive(Clone)]
pub struct Emitting {
    /// Emitters, openings and enclosure.
    pub file: EmitterFile,
    /// Environment that windows show.
    pub(crate) sky: Option<Sky>,
    pub(crate) room: Arc<Room>,
    /// Whether each emitter is where its surface is.
    pub(crate) in_place: Vec<bool>,
}

impl Emitting {
    /// Reads the emitters of a run. Returns `None` if the run has no `emitters.json`.
    ///
    /// The room is built from the training views of the scene. `seed` is that of rays and sample points.
    ///
    /// # Errors
    /// If `emitters.json` is damaged, the Gaussians have no materials, or the device fails.
    pub fn open(
        device: &Device,
        run: &RunDirectory,
        scene: &Scene,
        splats: &Splats,
        seed: u64,
    ) -> Result<Option<Emitting>> {
        let path = run.emitters();
        if !path.is_file() {
            return Ok(None);
        }
        let file = read_emitters(&path)?;
        let sky = file.environment.as_ref().map(|name| read_sky(&run.path(name))).transpose()?;
        let room = room_of(device, scene, splats, &file, seed as u32)?.with_outside(&file.openings, sky.as_ref())?;
        let in_place = vec![true; file.emitters.len()];
        let emitting = Emitting { file, sky, room: Arc::new(room), in_place };
        warn_of_dark_suns(&emitting.file.openings, &emitting.lights());
        Ok(Some(emitting))
    }

    /// Applies an edit to the emitters. The surface of a moved emitter is dark.
    ///
    /// [`crate::Edit::all_emitters`] returns the edit with the lights of its files.
    ///
    /// # Errors
    /// If the edit names an emitter that does not exist.
    pub fn edited(self, edit: &EmitterEdit) -> Result<Emitting> {
        let outside = edit.openings.is_some() || edit.environment != EnvironmentEdit::default();
        let EditedEmitters { file, in_place } = edit_emitters(edit, self.file)?;
        let sky = edit_sky(&edit.environment, self.sky)?;
        // The room stays the same if nothing outside of it changes.
        let room = match outside {
            true => Arc::new((*self.room).clone().with_outside(&file.openings, sky.as_ref())?),
            false => self.room,
        };
        let emitting = Emitting { file, sky, in_place, room };
        if *edit != EmitterEdit::default() {
            warn_of_dark_suns(&emitting.file.openings, &emitting.lights());
        }
        Ok(emitting)
    }

    /// Returns the same emitters in a room with other openings and another environment.
    ///
    /// # Errors
    /// If memory runs out.
    pub(crate) fn with_outside(&self, openings: &[OpeningRow], sky: Option<Sky>) -> Result<Emitting> {
        let room = Arc::new((*self.room).clone().with_outside(openings, sky.as_ref())?);
        Ok(Emitting { file: self.file.clone(), sky, room, in_place: self.in_place.clone() })
    }

    /// Returns the openings as windows whose color is a factor on the environment.
    pub(crate) fn windows(&self, color: [f32; 3]) -> Vec<AreaLight> {
        self.file.openings.iter().map(|o| AreaLight { shape: o.window(), color }).collect()
    }

    /// Returns the radiance of an emitter's surface over its color: 1, or the mean of the environment that a window shows.
    pub(crate) fn surface_of(&self, shape: &LightShape) -> [f32; 3] {
        match (*shape, &self.sky) {
            (LightShape::Window { corner, edge_u, edge_v }, Some(sky)) => {
                sky.mean(Opening { corner, edge_u, edge_v }.normal())
            }
            _ => [1.0; 3],
        }
    }

    /// Returns whether others have the same room, shapes and places.
    pub(crate) fn same_places(&self, other: &Emitting) -> bool {
        let shapes = |e: &Emitting| e.file.emitters.iter().map(|row| row.shape).collect::<Vec<_>>();
        Arc::ptr_eq(&self.room, &other.room) && shapes(self) == shapes(other)
    }

    /// Returns the same emitters in the room of other Gaussians.
    ///
    /// For Gaussians with edited materials: the new materials reflect the light that bounces.
    ///
    /// # Errors
    /// If the Gaussians have no materials, or the device fails.
    pub fn of_splats(&self, device: &Device, scene: &Scene, splats: &Splats, seed: u64) -> Result<Emitting> {
        let room = room_of(device, scene, splats, &self.file, seed as u32)?;
        let room = Arc::new(room.with_outside(&self.file.openings, self.sky.as_ref())?);
        Ok(Emitting { file: self.file.clone(), sky: self.sky.clone(), room, in_place: self.in_place.clone() })
    }

    /// Returns the emitters as lights in world units. An emitter that is off has the color 0.
    pub fn lights(&self) -> Vec<AreaLight> {
        self.file.lights()
    }

    /// Returns the Gaussians under lights in world units, which replace the emitters.
    ///
    /// `radiance` holds, for each emitter of the run, the radiance that its surfaces emit. The camera sees it; `lights` light
    /// the room.
    ///
    /// # Errors
    /// If a light is invalid or the device fails.
    pub fn shaded(
        &self,
        device: &Device,
        splats: &Splats,
        lights: &[AreaLight],
        radiance: &[[f32; 3]],
        bounces: Bounces,
    ) -> Result<ShadedScene> {
        let emission = emission(splats, radiance);
        let mut scene = shaded_scene(device, splats, None, None, &Visibility::None)?;
        scene.transport = Some(self.room.light(lights, &emission, bounces)?);
        Ok(scene)
    }

    /// Returns the Gaussians under the run's own emitters.
    ///
    /// # Errors
    /// If the device fails.
    pub fn own(&self, device: &Device, splats: &Splats) -> Result<ShadedScene> {
        let frame = self.frame();
        let radiance: Vec<[f32; 3]> = frame.iter().map(|e| e.surface).collect();
        self.shaded(device, splats, &self.lights(), &radiance, Bounces::All)
    }

    /// Returns the emitters of a frame.
    pub fn frame(&self) -> Vec<FrameEmitter> {
        let of = |(light, in_place): (AreaLight, &bool)| {
            let factor = if *in_place { self.surface_of(&light.shape) } else { [0.0; 3] };
            FrameEmitter { light, surface: [0, 1, 2].map(|c| factor[c] * light.color[c]) }
        };
        self.lights().into_iter().zip(&self.in_place).map(of).collect()
    }

    /// Returns the Gaussians under the run's own emitters, with responses.
    ///
    /// Solves the bounces of each emitter. Other colors then need no solve.
    ///
    /// # Errors
    /// If the device fails.
    pub fn live(&self, device: &Device, splats: &Splats) -> Result<ShadedScene> {
        self.respond(device, splats, &self.frame())
    }

    /// Returns the Gaussians under the emitters of a frame, with responses. The run's own emitters come first.
    ///
    /// # Errors
    /// If the device fails.
    pub(crate) fn respond(&self, device: &Device, splats: &Splats, frame: &[FrameEmitter]) -> Result<ShadedScene> {
        let numbers = splats.emitters.clone().unwrap_or_else(|| vec![0; splats.len()]);
        let mut scene = shaded_scene(device, splats, None, None, &Visibility::None)?;
        scene.transport = Some(self.room.respond(frame, &numbers)?);
        Ok(scene)
    }
}

/// Warns if a room without openings has directional light.
pub(crate) fn warn_of_dark_suns(openings: &[OpeningRow], lights: &[AreaLight]) {
    let shines = |l: &AreaLight| matches!(l.shape, LightShape::Directional { .. }) && l.color != [0.0; 3];
    if openings.is_empty() && lights.iter().any(shines) {
        tracing::warn!(
            "the room has no openings, so its directional light is dark; list the windows under \"openings\" in emitters.json"
        );
    }
}

/// Returns the radiance that each Gaussian emits. `radiance` holds that of each emitter.
pub(crate) fn emission(splats: &Splats, radiance: &[[f32; 3]]) -> Vec<[f32; 3]> {
    let of = |i: usize| match splats.emitters.as_ref().map_or(0, |e| e[i]) {
        0 => [0.0; 3],
        number => radiance.get(number as usize - 1).copied().unwrap_or([0.0; 3]),
    };
    (0..splats.len()).map(of).collect()
}
