//! Files of a stage in the run directory during training: checkpoints, rollback checkpoints, log.

use super::summary::{DecisionLine, DensifyLine, StageSummary};
use crate::divergence::RollBack;
use crate::error::{Result, TrainError};
use crate::stage::{Stage, StageEvent};
use serde_json::json;
use sgs_config::Settings;
use sgs_engine::graph::dump::{Track, html, trace};
use sgs_run::{RollbackFiles, RunDirectory, StageKind};
use std::fs::File;
use std::io::Write;
use std::path::PathBuf;

/// Steps between lines of the log. The first and the last step have lines, too.
const LOG_INTERVAL: u32 = 10;

/// Record of one stage in a run directory.
pub(super) struct Record {
    pub run: RunDirectory,
    kind: StageKind,
    log: File,
    /// Settings in `config.toml` of the run.
    settings: Settings,
    /// First failure to write the log. Training continues without it.
    log_error: Option<std::io::Error>,
    rollback: RollbackFiles,
}

impl Record {
    /// Opens the record of a stage that starts, or was restored. `watched`: whether divergence leads to a rollback.
    pub fn open(run: RunDirectory, stage: &dyn Stage, watched: bool) -> Result<Record> {
        let kind = stage.kind();
        run.write_settings(stage.settings())?;
        let rollback = run.rollback_files(kind);
        // The state that a diverged training stopped with is good. Otherwise the process may have been killed between
        // checkpoint and link.
        if run.has_diverged() && stage.step() > 0 {
            rollback.set_candidate()?;
            rollback.validate()?;
        } else if watched && stage.is_candidate() {
            rollback.set_candidate()?;
        }
        run.forget_diverged()?;
        let log = run.open_log(kind, stage.step())?;
        Ok(Record { run, kind, log, settings: stage.settings().clone(), log_error: None, rollback })
    }

    /// Writes the settings of the stage if training has changed them.
    pub fn write_settings(&mut self, stage: &dyn Stage) -> Result<()> {
        if *stage.settings() != self.settings {
            self.run.write_settings(stage.settings())?;
            self.settings = stage.settings().clone();
        }
        Ok(())
    }

    /// Returns the path of the checkpoint.
    pub fn checkpoint(&self) -> PathBuf {
        self.run.checkpoint(self.kind)
    }

    /// Appends an event to the log. `rates`: factor of the rollbacks on learning rates.
    pub fn log(&mut self, event: &StageEvent<'_>, rates: f64, steps: u32) {
        let line = match event {
            StageEvent::Step(figures) => {
                let step = figures.step();
                if !step.is_multiple_of(LOG_INTERVAL) && step != 1 && step != steps {
                    return;
                }
                figures.log_line(rates)
            }
            StageEvent::Densified { step, stats } => serde_json::to_string(&DensifyLine::new(*step, stats)),
            StageEvent::Decision(decision) => serde_json::to_string(&DecisionLine::new(self.kind, decision)),
        };
        if let Err(error) = writeln!(self.log, "{}", line.unwrap_or_default()) {
            self.log_error.get_or_insert(error);
        }
    }

    /// Writes a checkpoint.
    ///
    /// `regular`: whether the checkpoint interval ends at this step. Only such a checkpoint becomes a rollback
    /// candidate, because a result that depends on a rollback must not depend on where a caller stopped training.
    pub fn save(&self, stage: &mut dyn Stage, watched: bool, regular: bool) -> Result<()> {
        if watched {
            self.validate(stage)?;
        }
        let candidate = watched && regular && stage.set_candidate();
        stage.save(&self.checkpoint())?;
        if candidate {
            self.rollback.set_candidate()?;
        }
        Ok(())
    }

    /// Validates the rollback candidate if training has gone well since it was set.
    pub fn validate(&self, stage: &mut dyn Stage) -> Result<()> {
        if stage.validate_candidate() {
            self.rollback.validate()?;
        }
        Ok(())
    }

    /// Restores a fresh stage to the last validated checkpoint, if the run has one.
    pub fn restore_validated(&self, stage: &mut dyn Stage) -> Result<()> {
        match self.rollback.last_validated()? {
            Some(path) => stage.restore(path),
            None => Ok(()),
        }
    }

    /// Drops the lines of the log after the step of the stage.
    pub fn rewind_log(&mut self, stage: &dyn Stage) -> Result<()> {
        self.log = self.run.open_log(self.kind, stage.step())?;
        Ok(())
    }

    /// Saves the state of a stage that cannot recover from divergence. The returned error says how to continue from it.
    pub fn give_up(&self, stage: &mut dyn Stage, before: &[RollBack], error: TrainError) -> Result<TrainError> {
        let TrainError::Diverged { step, reason, .. } = error else { return Ok(error) };
        stage.save(&self.checkpoint())?;
        stage.write_results(&self.run)?;
        self.rollback.remove()?;
        let times = match before.len() {
            0 => String::new(),
            n => format!(" It had gone back {n} times before."),
        };
        let (last, lower) = (stage.step(), stage.lower_rates());
        let about = TrainError::diverged(step, reason.as_str()).to_string();
        let about =
            json!({"stage": self.kind.name(), "step": step, "kept": last, "reason": about, "roll_backs": before});
        self.run.set_diverged(&about)?;
        let advice = format!(
            "{times} The state after step {last} is kept: go on from it with --resume and lower learning rates (as {lower})."
        );
        Ok(TrainError::Diverged { step, reason, advice })
    }

    /// Writes the results of a trained stage.
    pub fn finish(&mut self, stage: &mut dyn Stage, summary: &StageSummary) -> Result<()> {
        if let Some(error) = self.log_error.take() {
            tracing::warn!("log.jsonl could not be written: {error}");
        }
        stage.write_results(&self.run)?;
        let times = stage.take_times();
        if let (false, Some(plan)) = (times.is_empty(), stage.plan()?) {
            let name = format!("{} step", self.kind);
            let replay = times.iter().map(|t| t.start.len()).min().unwrap_or(0).saturating_sub(1);
            let profile = trace(&[Track { name: &name, times: &times, replay }]);
            let page = html(plan, &times);
            for (path, text) in [(self.run.profile(self.kind), profile), (self.run.graph(self.kind), page)] {
                sgs_scene::atomic_write(&path, |f| f.write_all(text.as_bytes()))?;
            }
        }
        self.run.write_summary(self.kind, summary)?;
        Ok(self.rollback.remove()?)
    }
}
