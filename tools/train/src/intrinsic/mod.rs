//! Intrinsic stage: materials, lights, environment map and visibility on fixed geometry.
//!
//! Guarantees: the result depends only on the scene, the splats, the settings and the seed. It depends neither on how
//! memory is divided nor on interruptions of training. Geometry and colors of the splats stay unchanged. A step in the
//! steady state waits only for the second step before it.

mod automatic;
mod consistency;
mod data;
mod decisions;
mod environment_updates;
mod frames;
mod graphs;
mod log;
mod modeled;
mod needs;
mod parameters;
mod poll;
mod prepare;
mod probe;
mod relit;
mod residue;
mod room;
mod saved;
mod stage;
mod start;
mod state;
mod surfaces;
mod train;
mod values;

pub use consistency::{AlbedoComparisons, CONSISTENCY_INTERVAL};
pub use log::{IntrinsicLog, LoggedLosses};
pub use needs::IntrinsicNeeds;
pub use probe::Probe;
pub(crate) use saved::Saved;

use crate::data::TrainingData;
use crate::decision::Decision;
use crate::divergence::{RollBack, Watch};
use crate::idle::IdleLoss;
use crate::schedule::Schedule;
use automatic::Automatic;
use consistency::{Consistency, StepKind};
use environment_updates::EnvironmentUpdates;
use relit::Relit;
use sgs_config::Settings;
use sgs_engine::{Device, DeviceBuffer};
use sgs_passes::Tuning;
use sgs_passes::pipeline::{
    EnvironmentMemory, IntrinsicOptions, IntrinsicParameters, IntrinsicStatus, IntrinsicStep, IntrinsicStepValues,
    RelitView, TransportMemory,
};
use sgs_passes::scene::Gaussians;
use sgs_passes::shade::environment::Environment;
use sgs_passes::shade::lights::LightModel;
use sgs_passes::shade::traced::TracedMemory;
use sgs_scene::{Splats, Unit};
use sgs_transport::TrainingRoom;
use surfaces::Surfaces;

/// Number of replays in flight.
const IN_FLIGHT: usize = 2;

/// Number of steps between polls of the device's reports; the ring holds more.
const POLL_INTERVAL: u32 = 16;

/// Intrinsic stage of one scene.
pub struct Intrinsic {
    device: Device,
    tuning: Tuning,
    /// Settings as requested.
    settings: Settings,
    /// Settings after automatic model selection.
    required: Settings,
    /// State of automatic model selection, if enabled.
    automatic: Option<Automatic>,
    /// Decisions about the model.
    decisions: Vec<Decision>,
    /// Number of decisions already reported.
    reported: usize,
    /// Losses that cannot run.
    idle: Vec<IdleLoss>,
    /// Last values of losses that do not run in every step; negative before the first.
    /// These compare with pseudo-views, with estimates under other lights, and with own priors.
    recent: [f32; 3],
    schedule: Schedule,
    data: TrainingData,
    priors: Priors,
    /// Input splats, with normals.
    splats: Splats,
    gaussians: Gaussians,
    surfaces: Surfaces,
    needs: IntrinsicNeeds,
    parameters: IntrinsicParameters,
    light_model: LightModel,
    /// Box that the lights started in.
    bounds: [[f32; 3]; 2],
    /// Unit of lengths here, in the scene's unit.
    unit: Unit,
    gains: DeviceBuffer,
    environment: Option<(Environment, EnvironmentMemory)>,
    /// State of environment updates that do not run in every step.
    environment_updates: Option<EnvironmentUpdates>,
    /// Step of the last change of the update interval, and updates until then.
    /// Both refer to the environment map.
    update_intervals: [u32; 2],
    /// Acceleration structure for rays to lights.
    traced: Option<TracedMemory>,
    /// Room of the physical lights, if any.
    room: Option<TrainingRoom>,
    /// Buffers of a room that is only planned.
    planned_room: Option<TransportMemory>,
    status: IntrinsicStatus,
    options: IntrinsicOptions,
    consistency: Option<Consistency>,
    /// Renderer of the frames for a provider of masks; built on first use.
    shown: Option<RelitView>,
    /// Provider of albedo under other lights, if any.
    relit: Option<Relit>,
    /// Graphs by [`StepKind`], built on first use.
    execs: [Option<IntrinsicStep>; StepKind::ALL.len()],
    submitted: u32,
    done: u32,
    /// Divergence check.
    watch: Watch,
    /// Rollbacks to the last good state.
    roll_backs: Vec<RollBack>,
}

/// Priors in device memory: a buffer per part of the photographs.
struct Priors {
    albedo: Option<Vec<DeviceBuffer>>,
    roughness: Option<Vec<DeviceBuffer>>,
    metallic: Option<Vec<DeviceBuffer>>,
}

impl Intrinsic {
    /// Returns the number of finished steps.
    pub fn step(&self) -> u32 {
        self.done
    }

    /// Returns the settings as requested.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// Returns the device.
    pub fn device(&self) -> &Device {
        &self.device
    }

    /// Returns the lowest and highest corners of the box that the lights started in.
    pub fn bounds(&self) -> [[f32; 3]; 2] {
        self.bounds.map(|corner| self.unit.inverse().place(corner))
    }

    /// Returns the number of splats.
    pub fn gaussians(&self) -> usize {
        self.splats.len()
    }
}
