//! Trainer: the training loop that all stages of a scene share.
//!
//! A [`Stage`] knows its graph, its state and its schedule. The trainer owns what all stages share: the order of the
//! stages, checkpoints, rollback after divergence, the log, resuming, stopping, and the files of a trained stage. The
//! command line, the C interface, ablations, robustness tables and the quality benchmarks use the trainer. Benchmarks
//! that time single steps drive a stage without it, and so does baking, which fits colors to images.
//!
//! Guarantees: the result depends on the scene, the settings and the seed alone. Pauses, stops, checkpoints and the
//! caller do not change it.

mod observer;
mod record;
mod start;
mod summary;

pub use observer::{Event, Observer, Outcome};
pub use summary::StageSummary;

use crate::error::{Requirement, Result, TrainError};
use crate::geometry::{MANY_POINTS, MOST_THINNED};
use crate::intrinsic::Intrinsic;
use crate::stage::{Stage, StageEvent};
use crate::transport::TransportPlan;
use record::Record;
use sgs_config::{OnDivergence, Settings};
use sgs_engine::Device;
use sgs_run::{KnownEmitters, RunDirectory, StageKind};
use sgs_scene::{Scene, Splats};
use std::cell::RefCell;
use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

/// Number of steps at the end of a stage whose passes are timed for its profile.
const TIMED: u32 = 4;

/// Stages to train, where they are written, and what they start from.
#[derive(Clone, Debug)]
pub struct TrainerOptions {
    /// Stages, in the order of training.
    pub stages: Vec<StageKind>,
    /// Run directory. Without one, training happens in memory: no checkpoints, and divergence is an error. The caller
    /// holds the lock of the directory ([`sgs_run::DirectoryLock`]).
    pub run: Option<PathBuf>,
    /// Continues the training in the run directory.
    pub resume: bool,
    /// Gaussians that a stage after the geometry stage starts from. Default: those of the run, or of the stage before it.
    pub start: Option<StartGeometry>,
}

/// Gaussians that a stage after the geometry stage starts from.
#[derive(Clone, Debug)]
pub enum StartGeometry {
    /// A PLY or glTF file.
    File(PathBuf),
    /// Gaussians in memory.
    Splats(Box<Splats>),
}

impl Default for TrainerOptions {
    fn default() -> TrainerOptions {
        TrainerOptions { stages: vec![StageKind::Geometry], run: None, resume: false, start: None }
    }
}

/// Stage that has not started yet.
#[derive(Clone, Copy)]
struct Next {
    kind: StageKind,
    /// Whether the stage continues from a checkpoint.
    resume: bool,
    /// Whether all its steps are finished. Such a stage is only restored.
    complete: bool,
}

/// Stage that trains, or has trained last.
struct Active {
    stage: Box<dyn Stage>,
    record: Option<Record>,
    /// Step that this training started after.
    first: u32,
    /// Seconds of training.
    seconds: f64,
    /// Whether passes are timed.
    timed: bool,
    finished: bool,
}

/// Trains one or more stages of one scene.
pub struct Trainer {
    device: Device,
    scene: Arc<Scene>,
    settings: Settings,
    options: TrainerOptions,
    next: VecDeque<Next>,
    /// Scene with learned cameras and exposures, for stages after the geometry stage.
    learned: Option<Arc<Scene>>,
    /// Gaussians that the active stage started from, if it did not create them.
    splats: Option<Splats>,
    active: Option<Active>,
    /// Whether an error ended the training.
    failed: bool,
}

impl Trainer {
    /// Prepares training. Writes nothing. Uses the device only to check the memory budget.
    ///
    /// # Errors
    /// If settings are wrong, the emitters that the scene names cannot be used, the run cannot be resumed, or the stages cannot
    /// fit into the memory budget.
    pub fn new(device: &Device, scene: Arc<Scene>, settings: &Settings, options: TrainerOptions) -> Result<Trainer> {
        let mut settings = settings.clone();
        // The exposure of the scene belongs to the run: evaluation and resuming use the same one.
        settings.exposure = scene.exposure();
        settings.check()?;
        if options.start.is_some() && options.stages.contains(&StageKind::Geometry) {
            return Err(Requirement::OneGeometry.into());
        }
        if options.stages.contains(&StageKind::Transport) && !options.resume {
            KnownEmitters::of_scene(&scene)?;
        }
        let resumed = match (&options.run, options.resume) {
            (Some(root), true) if root.join("config.toml").is_file() => Some(RunDirectory::open(root)?),
            _ => None,
        };
        let complete = resumed.as_ref().map(|run| run.complete(&settings)).unwrap_or_default();
        let has_checkpoint = |kind: StageKind| resumed.as_ref().is_some_and(|run| run.checkpoint(kind).is_file());
        let mut next = VecDeque::new();
        for (i, &kind) in options.stages.iter().enumerate() {
            let (there, later) = (has_checkpoint(kind), &options.stages[i + 1..]);
            // A stage whose predecessor trains again is trained again.
            let after_another = next.iter().any(|n: &Next| !n.complete);
            let complete = complete.contains(&kind) && !after_another;
            // A run that has a checkpoint of a later stage has finished this one.
            let passed = !after_another && later.iter().any(|kind| has_checkpoint(*kind));
            match kind {
                _ if !later.is_empty() && (passed || complete) => {}
                _ if complete && !there => {}
                StageKind::Geometry => {
                    resumed.as_ref().map_or(Ok(()), RunDirectory::check_without_materials)?;
                    next.push_back(Next { kind, resume: resumed.is_some(), complete });
                }
                StageKind::Intrinsic | StageKind::Transport => {
                    next.push_back(Next { kind, resume: there && !after_another, complete });
                }
            }
        }
        let trainer = Trainer {
            device: device.clone(),
            scene,
            settings,
            options,
            next,
            learned: None,
            splats: None,
            active: None,
            failed: false,
        };
        if trainer.trains_materials_later() && resumed.is_none() && trainer.settings.memory.budget > 0 {
            trainer.check_budget()?;
        }
        Ok(trainer)
    }

    fn trains_both(&self) -> bool {
        [StageKind::Geometry, StageKind::Intrinsic].iter().all(|kind| self.options.stages.contains(kind))
    }

    /// Returns whether the stages are geometry and others after it.
    fn trains_materials_later(&self) -> bool {
        self.options.stages.len() > 1 && self.options.stages.contains(&StageKind::Geometry)
    }

    /// Refuses a budget that a later stage would exceed. Runs before the first stage trains.
    fn check_budget(&self) -> Result<()> {
        // The first stage uses fewer of many points where memory does not suffice for all of them.
        let all = &self.scene.points;
        let cloud = if all.len() > MANY_POINTS { all.spread(all.len() / MOST_THINNED) } else { all.clone() };
        let points = Splats::from_points(&cloud, self.settings.geometry.sh_degree.start() as usize)?;
        for stage in &self.options.stages {
            match stage {
                StageKind::Geometry => {}
                StageKind::Intrinsic => {
                    Intrinsic::planned(&self.device, &self.scene, &self.settings, &points)?;
                }
                StageKind::Transport => {
                    TransportPlan::of(&self.device, &self.scene, &self.settings, &points)?;
                }
            }
        }
        Ok(())
    }

    /// Trains until all stages are finished or the observer stops it.
    ///
    /// # Errors
    /// If the device fails, a file cannot be written, or training diverges for good.
    pub fn run(&mut self, observer: &mut dyn Observer) -> Result<Outcome> {
        loop {
            if let Some(outcome) = self.advance(observer)? {
                return Ok(outcome);
            }
        }
    }

    /// Trains until the next checkpoint, pause, stop or end of a stage. Returns the outcome when no work is left.
    ///
    /// # Errors
    /// As [`Trainer::run`]; after an error the trainer cannot continue.
    pub fn advance(&mut self, observer: &mut dyn Observer) -> Result<Option<Outcome>> {
        if self.failed {
            return Err(Requirement::NotFailed.into());
        }
        let result = self.advance_once(observer);
        self.failed = result.is_err();
        result
    }

    fn advance_once(&mut self, observer: &mut dyn Observer) -> Result<Option<Outcome>> {
        if self.active.as_ref().is_none_or(|active| active.finished) {
            let Some(next) = self.next.front().copied() else { return Ok(Some(Outcome::Finished)) };
            if observer.should_stop() || !self.start(next, observer)? {
                return Ok(Some(Outcome::Stopped { stage: next.kind, step: 0 }));
            }
            if self.active.as_ref().is_some_and(|active| active.finished) {
                return Ok(self.next.is_empty().then_some(Outcome::Finished));
            }
        }
        let stopped = self.train(observer)?;
        let Some(active) = &self.active else { return Ok(None) };
        let (kind, step) = (active.stage.kind(), active.stage.step());
        if step >= active.stage.steps() {
            self.finish(observer)?;
            return Ok(self.next.is_empty().then_some(Outcome::Finished));
        }
        Ok(stopped.then_some(Outcome::Stopped { stage: kind, step }))
    }

    /// Creates the first stage, so that its state can be read before the first step.
    ///
    /// # Errors
    /// As [`Trainer::run`].
    pub fn prepare(&mut self, observer: &mut dyn Observer) -> Result<()> {
        if self.failed || self.active.is_some() {
            return Ok(());
        }
        let Some(next) = self.next.front().copied() else { return Ok(()) };
        let result = self.start(next, observer).map(|_| ());
        self.failed = result.is_err();
        result
    }

    /// Returns whether divergence leads to a rollback, or at least to a saved state.
    fn rolls_back(&self) -> bool {
        self.options.run.is_some() && self.settings.train.on_divergence != OnDivergence::GoOn
    }

    /// Trains the active stage until its next checkpoint, pause, stop or end. Returns whether the observer stopped it.
    fn train(&mut self, observer: &mut dyn Observer) -> Result<bool> {
        let began = Instant::now();
        let watched = self.rolls_back();
        let stopped = self.train_once(watched, observer);
        if let Some(active) = &mut self.active {
            active.seconds += began.elapsed().as_secs_f64();
        }
        stopped
    }

    fn train_once(&mut self, watched: bool, observer: &mut dyn Observer) -> Result<bool> {
        let Some(active) = &mut self.active else { return Ok(false) };
        let Active { stage, record, .. } = active;
        let (kind, steps) = (stage.kind(), stage.steps());
        let interval = match stage.checkpoint_interval() {
            0 => steps.max(1),
            n => n,
        };
        let mut last = steps;
        if record.is_some() {
            last = last.min((stage.step() / interval + 1) * interval);
            let timed = steps.saturating_sub(TIMED);
            if stage.step() < timed {
                last = last.min(timed);
            } else if !std::mem::replace(&mut active.timed, true) {
                stage.set_timestamps(true)?;
            }
        }
        let rates = stage.roll_backs().last().map_or(1.0, |r| r.rates);
        let mut stopped = false;
        let result = {
            let observer = RefCell::new(&mut *observer);
            let mut events = |event: &StageEvent<'_>| {
                if let Some(record) = record {
                    record.log(event, rates, steps);
                }
                observer.borrow_mut().notify(&match event {
                    StageEvent::Step(figures) => Event::Step { stage: kind, steps, figures: *figures },
                    StageEvent::Densified { step, stats } => Event::Densified { step: *step, stats },
                    StageEvent::Decision(decision) => Event::Decision { stage: kind, decision },
                });
            };
            let mut proceed = || {
                let mut observer = observer.borrow_mut();
                stopped = stopped || observer.should_stop();
                !stopped && !observer.should_pause()
            };
            stage.train(last, &mut events, &mut proceed)
        };
        match result {
            Err(error @ TrainError::Diverged { .. }) if watched => {
                return self.recover(error, observer).map(|()| false);
            }
            other => other?,
        }
        let step = stage.step();
        observer.paused(&**stage, step == steps);
        let Some(record) = record else { return Ok(stopped || observer.should_stop()) };
        // Polled once: an observer that is notified of the stop finds the checkpoint of that step.
        let stopped = stopped || observer.should_stop();
        let regular = step > 0 && step.is_multiple_of(interval);
        if regular || step == steps || stopped {
            record.save(&mut **stage, watched, step.is_multiple_of(interval))?;
            // Settings that were chosen by measurement belong to the run. They follow the checkpoint: otherwise a killed
            // training would begin again with a choice that it had not made at its checkpoint.
            record.write_settings(&**stage)?;
        }
        Ok(stopped)
    }

    /// Continues a diverged stage from its last validated checkpoint. Halves the learning rates. Gives up after as many
    /// rollbacks as the settings allow.
    fn recover(&mut self, error: TrainError, observer: &mut dyn Observer) -> Result<()> {
        let (TrainError::Diverged { step, .. }, Some(active)) = (&error, self.active.take()) else { return Err(error) };
        let Active { mut stage, record, first, seconds, .. } = active;
        let Some(mut record) = record else { return Err(error) };
        let (step, kind, chosen) = (*step, stage.kind(), stage.settings().clone());
        let before = stage.roll_backs().to_vec();
        record.validate(&mut *stage)?;
        // Two stages would not fit into memory.
        drop(stage);
        let mut stage = self.build(kind, &chosen)?;
        record.restore_validated(&mut *stage)?;
        let train = &self.settings.train;
        if train.on_divergence != OnDivergence::RollBack || before.len() as u64 >= u64::from(train.roll_backs) {
            return Err(record.give_up(&mut *stage, &before, error)?);
        }
        stage.roll_back(&before, step);
        if let Some(roll_back) = stage.roll_backs().last() {
            observer.notify(&Event::RolledBack { stage: kind, error: &error, roll_back });
        }
        record.rewind_log(&*stage)?;
        let record = Some(record);
        self.active = Some(Active { stage, record, first, seconds, timed: false, finished: false });
        Ok(())
    }

    /// Writes the results of the active stage.
    fn finish(&mut self, observer: &mut dyn Observer) -> Result<()> {
        let Some(active) = &mut self.active else { return Ok(()) };
        let Active { stage, record, first, seconds, .. } = active;
        let (kind, steps) = (stage.kind(), stage.steps());
        let geometry = kind == StageKind::Geometry;
        let summary = StageSummary {
            steps,
            resumed_from: *first,
            seconds: *seconds,
            steps_per_second: f64::from(steps.saturating_sub(*first)) / seconds.max(1e-9),
            gaussians: geometry.then(|| stage.count()).transpose()?,
            peak_device_bytes: self.device.memory_use().1,
            device: self.device.info().name.clone(),
            roll_backs: stage.roll_backs().to_vec(),
            sh_degree: stage.sh_degree(),
            room: stage.room(),
            decisions: stage.decisions().to_vec(),
            warnings: stage.idle_losses().to_vec(),
        };
        if let Some(record) = record {
            record.finish(&mut **stage, &summary)?;
        }
        active.finished = true;
        // Settings that were chosen by measurement belong to the run, also for the next stage.
        self.settings.clone_from(active.stage.settings());
        observer.notify(&Event::Finished { stage: kind, summary: &summary });
        Ok(())
    }

    /// Stage that trains, or has trained last. None before [`Trainer::prepare`] and the first step, and after an error
    /// that ended training.
    pub fn stage(&self) -> Option<&dyn Stage> {
        self.active.as_ref().map(|active| &*active.stage)
    }

    /// Returns the Gaussians of the stage. If no stage could start, returns its geometry.
    ///
    /// # Errors
    /// If there are none, or the device fails.
    pub fn splats(&self) -> Result<Splats> {
        match (&self.active, &self.splats) {
            (Some(active), _) => active.stage.splats(),
            (None, Some(splats)) => Ok(splats.clone()),
            (None, None) => Err(Requirement::Gaussians.into()),
        }
    }

    /// Returns whether all stages are finished.
    pub fn is_finished(&self) -> bool {
        !self.failed && self.next.is_empty() && self.active.as_ref().is_none_or(|active| active.finished)
    }

    /// Writes the active stage into a run directory, which can be resumed. Writes settings, a checkpoint and the
    /// current results. Removes files of later stages from a directory that is not the trainer's own.
    ///
    /// # Errors
    /// If no stage has started, the training has ended with an error, or a file cannot be written.
    pub fn save(&self, root: &Path) -> Result<()> {
        let Some(active) = self.active.as_ref().filter(|_| !self.failed) else {
            return Err(if self.failed { Requirement::NotFailed } else { Requirement::ActiveStage }.into());
        };
        let stage = &active.stage;
        let run = RunDirectory::create(root)?;
        run.write_settings(stage.settings())?;
        stage.save(&run.checkpoint(stage.kind()))?;
        if self.options.run.as_deref() != Some(root) {
            // Files of an earlier run: resuming would read them as part of this run.
            sgs_run::remove(&run.path("training.json"))?;
            run.forget_diverged()?;
            match stage.kind() {
                StageKind::Geometry => run.forget_intrinsic()?,
                StageKind::Intrinsic => run.forget_transport()?,
                StageKind::Transport => {}
            }
        }
        stage.write_results(&run)
    }
}
