//! Progress of a training and control over it.

use super::summary::StageSummary;
use crate::decision::Decision;
use crate::divergence::RollBack;
use crate::error::TrainError;
use crate::idle::IdleLoss;
use crate::stage::{Stage, StepFigures};
use sgs_passes::pipeline::DensifyStats;
use sgs_run::StageKind;

/// Event of a training.
pub enum Event<'a> {
    /// A stage starts, or continues after `step`.
    Started {
        /// The stage.
        stage: StageKind,
        /// Finished steps.
        step: u32,
        /// Steps in all.
        steps: u32,
        /// Losses that have a weight and cannot run.
        idle: &'a [IdleLoss],
    },
    /// A step is finished.
    Step {
        /// The stage.
        stage: StageKind,
        /// Steps in all.
        steps: u32,
        /// The figures.
        figures: &'a dyn StepFigures,
    },
    /// Gaussians were cloned, split and pruned after a step.
    Densified {
        /// The step.
        step: u32,
        /// The counts.
        stats: &'a DensifyStats,
    },
    /// Automatic selection changed the model.
    Decision {
        /// The stage.
        stage: StageKind,
        /// The decision.
        decision: &'a Decision,
    },
    /// A stage diverged and continues from an earlier state.
    RolledBack {
        /// The stage.
        stage: StageKind,
        /// Error that describes the divergence.
        error: &'a TrainError,
        /// State that training continues from.
        roll_back: &'a RollBack,
    },
    /// A stage has finished all its steps and written its results.
    Finished {
        /// The stage.
        stage: StageKind,
        /// The summary in `training.json`.
        summary: &'a StageSummary,
    },
}

/// Receives progress and controls a training. `()` lets it run to its end.
pub trait Observer {
    /// Receives an event.
    fn notify(&mut self, _event: &Event<'_>) {}

    /// Returns true to stop training after the current step. A run directory then gets a checkpoint.
    fn should_stop(&mut self) -> bool {
        false
    }

    /// Returns true to pause training after the current step.
    fn should_pause(&mut self) -> bool {
        false
    }

    /// Receives the stage when training has paused, with no work in flight. `ended`: whether the stage is finished.
    fn paused(&mut self, _stage: &dyn Stage, _ended: bool) {}
}

impl Observer for () {}

/// Reason why a training returned.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// All stages are finished.
    Finished,
    /// The observer stopped it after this step of the stage.
    Stopped {
        /// The stage.
        stage: StageKind,
        /// Finished steps.
        step: u32,
    },
}
