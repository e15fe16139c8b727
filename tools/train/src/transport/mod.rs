//! Transport stage: emitters and bounced light of a room with materials.
//!
//! The first step is a fit, [`sgs_transport::fit_room`]: each Gaussian gets the emitter that it belongs to. The others train materials,
//! light gains, colors of the emitters and the albedo of the enclosure together. They are steps of an [`Intrinsic`] stage under the
//! lights of the room.
//!
//! After the intrinsic stage, the stage is left out if its light explains the photographs hardly better than uniform light: the
//! Gaussians stay as they are.
//!
//! Guarantees: the result depends only on the scene, the splats, the settings and the seed.

mod plan;
mod saved;
mod stage;

pub use plan::TransportPlan;
pub(crate) use saved::Saved;

use crate::decision::Decision;
use crate::error::{Requirement, Result};
use crate::intrinsic::Intrinsic;
use serde::Serialize;
use sgs_config::{Metallic, Settings, TransportPart};
use sgs_engine::Device;
use sgs_run::StageKind;
use sgs_scene::{Scene, Splats};
use sgs_transport::{FittedRoom, RoomOptions, fit_room, training_room};
use std::fmt;
use std::sync::Arc;

/// Sample points of a light with an extent.
const SAMPLES: u32 = 8;
/// Roughness before activation of matte surfaces.
const MATTE: f32 = 8.0;
/// PSNR that a fitted room must gain over uniform light, in dB.
const LEAST_GAIN: f64 = 1.0;

/// Transport stage of one scene.
pub struct Transport {
    device: Device,
    scene: Arc<Scene>,
    settings: Settings,
    /// Input splats in the scene's unit, without emitters.
    splats: Splats,
    /// The same with the materials from which training starts.
    start: Splats,
    fitted: Option<FittedRoom>,
    /// Decisions about the model.
    decisions: Vec<Decision>,
    /// Training of materials and lights in the fitted room.
    training: Option<Intrinsic>,
    /// Whether the stage may be left out.
    automatic: bool,
}

impl Transport {
    /// Prepares the stage. Materials start from their priors. Without them, albedo starts from the splats' colors,
    /// roughness and metallic from those of the splats.
    ///
    /// # Errors
    /// If a setting is wrong, there are no splats, or memory runs out.
    pub fn new(device: &Device, scene: Arc<Scene>, settings: &Settings, splats: &Splats) -> Result<Transport> {
        settings.check()?;
        if !settings.transport.enabled() {
            return Err(Requirement::Surfels.into());
        }
        if splats.is_empty() {
            return Err(Requirement::NotEmpty.into());
        }
        if settings.memory.budget > 0 {
            device.set_memory_budget(Some(settings.memory.budget));
        }
        let splats = Splats { emitters: None, light_gains: None, ..splats.clone() };
        let mut start = Intrinsic::starting_materials(device, &scene, &in_room(settings), &splats)?;
        if settings.transport.without == Some(TransportPart::Specular) {
            (start.roughness, start.metallic) = (Some(vec![MATTE; start.len()]), None);
        }
        Ok(Transport {
            device: device.clone(),
            scene,
            settings: settings.clone(),
            splats,
            start,
            fitted: None,
            decisions: Vec::new(),
            training: None,
            automatic: false,
        })
    }

    /// Allows the stage to be left out.
    ///
    /// It is if its light explains the photographs hardly better than uniform light.
    #[must_use]
    pub fn automatic(mut self) -> Transport {
        self.automatic = true;
        self
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
        let settings = in_room(&self.settings);
        let seed = settings.seed as u32;
        let room = training_room(&self.device, &self.scene, &self.start, fitted, seed)?;
        let training = Intrinsic::in_room(&self.device, &self.scene, &settings, &self.start, room)?;
        self.decisions.extend_from_slice(training.decisions());
        self.training = Some(training);
        Ok(())
    }

    /// Sets the fitted room, and decides whether it is used.
    fn set_fitted(&mut self, fitted: Option<FittedRoom>) {
        self.decisions = fitted.iter().filter(|_| self.automatic).map(selected).collect();
        self.fitted = fitted;
    }

    /// Returns whether the stage is left out.
    fn is_left_out(&self) -> bool {
        self.decisions.iter().any(|d| d.what == BOUNCED && !d.on)
    }

    /// Fits the room.
    fn fit(&self) -> Result<FittedRoom> {
        let s = &self.settings;
        let options = RoomOptions {
            surfels: s.transport.surfels as usize,
            rays: s.transport.rays,
            samples: SAMPLES,
            seed: s.seed as u32,
            without: s.transport.without,
        };
        Ok(fit_room(&self.device, &self.scene, &self.start, options)?)
    }
}

/// Name of the component that the stage adds.
const BOUNCED: &str = "bounced light";

/// Decides whether a fitted room is used.
fn selected(room: &FittedRoom) -> Decision {
    let gain = room.psnr - room.uniform_psnr;
    let emitters = room.emitters.emitters.len();
    Decision {
        step: 1,
        what: BOUNCED.to_owned(),
        on: emitters > 0 && gain >= LEAST_GAIN,
        reason: format!(
            "{emitters} emitters and their bounces gain {gain:.2} dB over uniform light at the photographs"
        ),
        measured: Some(gain),
        requested: Some(LEAST_GAIN),
        setting: "--stage transport".to_owned(),
    }
}

/// Returns the settings of training in a room: no other lights.
fn in_room(settings: &Settings) -> Settings {
    let mut settings = settings.clone();
    let s = &mut settings.intrinsic;
    (s.lights.grid, s.environment.resolution, s.automatic.enabled) = (0, 0, false);
    s.steps = settings.transport.steps;
    if settings.transport.without == Some(TransportPart::Specular) {
        // Without a prior, and begun at the limit, roughness hardly changes.
        (s.metallic, s.losses.roughness, s.losses.roughness_smooth) = (Metallic::Off, 0.0, 0.0);
    }
    settings
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
