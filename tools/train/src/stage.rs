//! Interface between the trainer and a stage.

use crate::decision::Decision;
use crate::divergence::RollBack;
use crate::error::Result;
use crate::idle::IdleLoss;
use serde::Serialize;
use sgs_config::Settings;
use sgs_engine::exec::PassTime;
use sgs_engine::graph::Plan;
use sgs_passes::pipeline::DensifyStats;
use sgs_run::{LearnedCameras, RunDirectory, RunLight, StageKind};
use sgs_scene::{Camera, Image, Splats};
use std::fmt;
use std::path::Path;

/// Figures of a finished step. `Display` prints the most important ones for people.
pub trait StepFigures: fmt::Display {
    /// Returns the step, counted from 1.
    fn step(&self) -> u32;

    /// Returns the loss of the step's image.
    fn loss(&self) -> f32;

    /// Returns the number of Gaussians.
    fn gaussians(&self) -> u32;

    /// Returns the line of `log.jsonl`.
    /// `rates`: the factor of the rollbacks on learning rates.
    ///
    /// # Errors
    /// If JSON cannot represent a value.
    fn log_line(&self, rates: f64) -> serde_json::Result<String>;
}

/// Figures of a fitted room, for the summary.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct RoomFit {
    /// PSNR of the shaded training views, in dB.
    pub psnr: f64,
    /// Number of emitters.
    pub emitters: u32,
}

/// Event that a stage reports while it trains.
pub enum StageEvent<'a> {
    /// A step is finished.
    Step(&'a dyn StepFigures),
    /// Gaussians were cloned, split and pruned after a step.
    Densified {
        /// The step.
        step: u32,
        /// The counts.
        stats: &'a DensifyStats,
    },
    /// Automatic selection changed the model.
    Decision(&'a Decision),
}

/// Stage of training: a graph, its state, and how to save and restore it.
/// [`crate::Trainer`] owns the loop.
pub trait Stage: Send {
    /// Returns the kind of the stage.
    fn kind(&self) -> StageKind;

    /// Returns the number of finished steps.
    fn step(&self) -> u32;

    /// Returns the total number of steps.
    fn steps(&self) -> u32;

    /// Returns the number of steps between checkpoints; 0 means only one at the end.
    fn checkpoint_interval(&self) -> u32;

    /// Returns the settings, with the choices that training made by measurement.
    fn settings(&self) -> &Settings;

    /// Trains until `last` steps are finished or `proceed` returns false.
    /// Returns with no work in flight.
    ///
    /// # Errors
    /// If the device fails or training diverges.
    fn train(
        &mut self,
        last: u32,
        events: &mut dyn FnMut(&StageEvent<'_>),
        proceed: &mut dyn FnMut() -> bool,
    ) -> Result<()>;

    /// Writes a checkpoint.
    ///
    /// # Errors
    /// If the file cannot be written; an existing file then stays intact.
    fn save(&self, path: &Path) -> Result<()>;

    /// Continues from a checkpoint.
    ///
    /// # Errors
    /// If the file is damaged or belongs to other settings.
    fn restore(&mut self, path: &Path) -> Result<()>;

    /// Marks the current state as a rollback candidate unless another is pending.
    /// Returns whether the current state is the candidate.
    fn set_candidate(&mut self) -> bool;

    /// Returns whether the current state is the rollback candidate.
    fn is_candidate(&self) -> bool;

    /// Returns true, once, when training has gone well since the candidate.
    fn validate_candidate(&mut self) -> bool;

    /// Returns the rollbacks after divergence.
    fn roll_backs(&self) -> &[RollBack];

    /// Records that this restored state replaces a state that diverged at `step`.
    /// Halves the learning rates. `before`: earlier rollbacks.
    fn roll_back(&mut self, before: &[RollBack], step: u32);

    /// Returns options of `sgs train` that lower critical learning rates.
    /// These are the rates that most often make the stage diverge.
    fn lower_rates(&self) -> String;

    /// Returns the decisions of automatic model selection.
    fn decisions(&self) -> &[Decision];

    /// Returns the losses that have a weight and cannot run.
    fn idle_losses(&self) -> &[IdleLoss];

    /// Returns the number of Gaussians.
    ///
    /// # Errors
    /// If the device fails.
    fn count(&self) -> Result<u32>;

    /// Returns the spherical-harmonics degree, if the stage trains these bands.
    fn sh_degree(&self) -> Option<u32>;

    /// Returns the Gaussians in the scene's unit.
    ///
    /// # Errors
    /// If the device fails.
    fn splats(&self) -> Result<Splats>;

    /// Returns the learned cameras and exposures of the training views, if any.
    ///
    /// # Errors
    /// If the device fails.
    fn learned_views(&self) -> Result<Option<LearnedCameras>> {
        Ok(None)
    }

    /// Returns all light of the current state, where the stage trains light.
    ///
    /// # Errors
    /// If the device fails.
    fn light(&self) -> Result<Option<RunLight>>;

    /// Returns the figures of the fitted room, if the stage has fitted one.
    fn room(&self) -> Option<RoomFit> {
        None
    }

    /// Renders the current state, display-referred, one image per camera.
    ///
    /// # Errors
    /// If the device fails or memory runs out.
    fn preview(&self, cameras: &[&Camera]) -> Result<Vec<Image>>;

    /// Writes the files of a trained stage into a run directory.
    ///
    /// # Errors
    /// If a file cannot be written.
    fn write_results(&self, run: &RunDirectory) -> Result<()>;

    /// Turns timestamps of passes on or off.
    ///
    /// # Errors
    /// If the device fails.
    fn set_timestamps(&mut self, on: bool) -> Result<()>;

    /// Takes the times of passes since the last call.
    fn take_times(&mut self) -> Vec<PassTime>;

    /// Returns the plan of a step, where all steps replay one graph.
    ///
    /// # Errors
    /// If the plan has to be made again and memory runs out.
    fn plan(&mut self) -> Result<Option<&Plan>>;
}
