//! Transport stage: emitters and bounced light of a room with materials.
//!
//! The first step is a fit, [`sgs_transport::fit_room`]: each Gaussian gets the emitter that it belongs to. The others train materials,
//! light gains, colors of the emitters and the albedo of the enclosure together. They are steps of an [`Intrinsic`] stage under the
//! lights of the room.
//!
//! Guarantees: the result depends only on the scene, the splats, the settings and the seed.

mod saved;
mod stage;

pub(crate) use saved::Saved;

use crate::error::{Requirement, Result};
use crate::intrinsic::Intrinsic;
use serde::Serialize;
use sgs_config::Settings;
use sgs_engine::Device;
use sgs_run::StageKind;
use sgs_scene::{Scene, Splats};
use sgs_transport::{FittedRoom, RoomOptions, fit_room, training_room};
use std::fmt;
use std::sync::Arc;

/// Sample points of a light with an extent.
const SAMPLES: u32 = 8;

/// Transport stage of one scene.
pub struct Transport {
    device: Device,
    scene: Arc<Scene>,
    settings: Settings,
    /// Input splats in the scene's unit, without emitters.
    splats: Splats,
    fitted: Option<FittedRoom>,
    /// Training of materials and lights in the fitted room.
    training: Option<Intrinsic>,
}

impl Transport {
    /// Prepares the stage on splats with materials.
    ///
    /// # Errors
    /// If a setting is wrong, or the splats lack normals or materials.
    pub fn new(device: &Device, scene: Arc<Scene>, settings: &Settings, splats: &Splats) -> Result<Transport> {
        settings.check()?;
        if splats.is_empty() {
            return Err(Requirement::NotEmpty.into());
        }
        if splats.normals.is_none() || splats.albedo.is_none() || splats.roughness.is_none() {
            return Err(Requirement::Materials.into());
        }
        if settings.memory.budget > 0 {
            device.set_memory_budget(Some(settings.memory.budget));
        }
        let splats = Splats { emitters: None, light_gains: None, ..splats.clone() };
        Ok(Transport {
            device: device.clone(),
            scene,
            settings: settings.clone(),
            splats,
            fitted: None,
            training: None,
        })
    }

    /// Returns the number of steps that train materials and lights.
    fn training_steps(&self) -> u32 {
        self.settings.transport.steps
    }

    /// Prepares the training of materials and lights, unless it exists.
    fn prepare_training(&mut self) -> Result<()> {
        let Some(fitted) = self.fitted.as_ref().filter(|_| self.training.is_none() && self.training_steps() > 0) else {
            return Ok(());
        };
        let mut settings = self.settings.clone();
        let s = &mut settings.intrinsic;
        (s.lights.grid, s.environment.resolution, s.automatic.enabled) = (0, 0, false);
        s.steps = self.training_steps();
        let seed = settings.seed as u32;
        let room = training_room(&self.device, &self.scene, &self.splats, fitted, seed)?;
        self.training = Some(Intrinsic::in_room(&self.device, &self.scene, &settings, &self.splats, room)?);
        Ok(())
    }

    /// Fits the room.
    fn fit(&self) -> Result<FittedRoom> {
        let s = &self.settings;
        let options = RoomOptions {
            surfels: s.transport.surfels as usize,
            rays: s.transport.rays,
            samples: SAMPLES,
            seed: s.seed as u32,
        };
        Ok(fit_room(&self.device, &self.scene, &self.splats, options)?)
    }
}

/// Figures of the fit.
struct Figures {
    psnr: f64,
    emitters: u32,
    gaussians: u32,
}

/// Line of `log.jsonl`.
#[derive(Serialize)]
struct LogLine {
    stage: StageKind,
    step: u32,
    emitters: u32,
    psnr: f64,
}

impl crate::stage::StepFigures for Figures {
    fn step(&self) -> u32 {
        1
    }

    fn loss(&self) -> f32 {
        // Mean squared error of the images.
        10_f64.powf(-0.1 * self.psnr) as f32
    }

    fn gaussians(&self) -> u32 {
        self.gaussians
    }

    fn log_line(&self, _rates: f64) -> serde_json::Result<String> {
        let Figures { psnr, emitters, .. } = *self;
        serde_json::to_string(&LogLine { stage: StageKind::Transport, step: 1, emitters, psnr })
    }
}

impl fmt::Display for Figures {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "emitters {}  PSNR {:.2} dB", self.emitters, self.psnr)
    }
}
