//! Trainers.

use crate::border::Outcome;
use crate::types::*;
use sgs_run::{DirectoryLock, StageKind};
use sgs_train::{Event, Observer, Stage, Trainer};
use std::time::{Duration, Instant};

/// Training in progress.
pub struct TrainerObject {
    pub trainer: Trainer,
    loss: f32,
    gaussians: u32,
    /// Lock of the run directory.
    _lock: Option<DirectoryLock>,
}

/// Observer that pauses after a time, but not before the first step.
struct Budget {
    began: Instant,
    seconds: Duration,
    /// Whether a step has started.
    begun: bool,
    loss: f32,
    gaussians: u32,
}

impl Budget {
    fn is_spent(&self) -> bool {
        self.begun && self.began.elapsed() >= self.seconds
    }
}

impl Observer for Budget {
    fn notify(&mut self, event: &Event<'_>) {
        match event {
            Event::Step { figures, .. } => (self.loss, self.gaussians) = (figures.loss(), figures.gaussians()),
            Event::Densified { stats, .. } => self.gaussians = stats.after,
            _ => {}
        }
    }

    fn should_pause(&mut self) -> bool {
        let spent = self.is_spent();
        // The first poll precedes the first step.
        self.begun = true;
        spent
    }
}

impl TrainerObject {
    /// Wraps a prepared trainer. `lock`: lock of its run directory.
    pub fn new(trainer: Trainer, lock: Option<DirectoryLock>) -> Outcome<TrainerObject> {
        let gaussians = trainer.stage().map_or(Ok(0), |stage| stage.count())?;
        Ok(TrainerObject { trainer, loss: 0.0, gaussians, _lock: lock })
    }

    /// Trains for a time, and at least one step unless all are finished.
    pub fn train(&mut self, seconds: Duration) -> Outcome<()> {
        let (loss, gaussians) = (self.loss, self.gaussians);
        let mut budget = Budget { began: Instant::now(), seconds, begun: false, loss, gaussians };
        let mut result = Ok(());
        while !self.trainer.is_finished() && !budget.is_spent() && result.is_ok() {
            result = self.trainer.advance(&mut budget).map(|_| ());
        }
        (self.loss, self.gaussians) = (budget.loss, budget.gaussians);
        Ok(result?)
    }

    /// Returns the progress.
    pub fn status(&self) -> SgsTrainStatus {
        let stage = self.trainer.stage();
        SgsTrainStatus {
            struct_size: 0,
            step: stage.map_or(0, Stage::step),
            steps: stage.map_or(0, Stage::steps),
            finished: u32::from(self.trainer.is_finished()),
            gaussians: self.gaussians,
            loss: self.loss,
            stage: match stage.map(Stage::kind) {
                Some(StageKind::Intrinsic) => SGS_STAGE_INTRINSIC,
                Some(StageKind::Transport) => SGS_STAGE_TRANSPORT,
                _ => SGS_STAGE_GEOMETRY,
            },
            roll_backs: stage.map_or(0, |stage| stage.roll_backs().len() as u32),
        }
    }
}
