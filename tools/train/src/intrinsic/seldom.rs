//! Surroundings whose texels move once in several steps (`intrinsic.environment.every`).
//!
//! Promises: what steps have gathered since the last move goes into checkpoints, so that a training that was stopped goes on with
//! the same bits. A move waits for the steps before it.

use super::Intrinsic;
use crate::error::Result;
use sgs_passes::pipeline::{EnvironmentRefresh, KeptEnvironment, Step};

/// Levels that stay, and what moves the texels.
pub(super) struct Seldom {
    kept: KeptEnvironment,
    /// Made when it is first due.
    refresh: Option<EnvironmentRefresh>,
}

impl Seldom {
    /// The levels.
    pub fn kept(&self) -> &KeptEnvironment {
        &self.kept
    }
}

impl Intrinsic {
    /// Filters the texels as they are, where that is not done in every step.
    pub(super) fn keep_environment(&mut self) -> Result<()> {
        let Some((e, _)) = self.environment.as_ref().filter(|_| self.options.environment_every > 1) else {
            self.seldom = None;
            return Ok(());
        };
        if self.seldom.is_none() {
            self.seldom = Some(Seldom { kept: KeptEnvironment::new(&self.device, e)?, refresh: None });
        }
        Ok(EnvironmentRefresh::filter(&self.device, &self.tuning, &self.inputs(super::StepKind::Plain))?)
    }

    /// How often texels have moved by the end of a step.
    pub(super) fn moves(&self, step: u32) -> u32 {
        let (every, [since, before]) = (self.options.environment_every.max(1), self.paced);
        before + step / every - since / every
    }

    /// Moves texels once in so many steps from now on, after `step` steps with so many moves. Unlike where they move seldom from
    /// the start they are about where they belong by now, and what steps ask is mostly noise: the mean of k steps has a root of k less of
    /// it, so that moves longer by that go as far, and wander no farther, than one with every step.
    pub(super) fn set_pace(&mut self, every: u32, step: u32, moves: u32) -> Result<()> {
        self.finish()?;
        self.forget_steps();
        self.options.environment_every = every;
        self.required.intrinsic.environment.every = every;
        let asked = &self.settings.intrinsic;
        let shorter = (f64::from(asked.environment.every) / f64::from(every)).sqrt() as f32;
        self.options.rates.environment = asked.rates.environment * self.schedule.rates() as f32 * shorter;
        self.paced = [step, moves];
        self.forget_refresh();
        self.keep_environment()
    }

    /// Moves the texels after a step, if it is due.
    pub(super) fn move_environment(&mut self, step: u32) -> Result<()> {
        let every = self.options.environment_every.max(1);
        if self.seldom.is_none() || !step.is_multiple_of(every) {
            return Ok(());
        }
        self.finish()?;
        if self.seldom.as_ref().is_some_and(|s| s.refresh.is_none()) {
            let inputs = self.inputs(super::StepKind::Plain);
            let made = EnvironmentRefresh::new(&self.device, &self.tuning, &inputs, &self.status, &self.options)?;
            if let Some(s) = &mut self.seldom {
                s.refresh = made;
            }
        }
        let moves = f64::from(self.moves(step));
        let values = Step {
            step,
            correction1: (1.0 / (1.0 - 0.9f64.powf(moves))) as f32,
            correction2: (1.0 / (1.0 - 0.999f64.powf(moves))) as f32,
            ..Step::default()
        };
        match self.seldom.as_mut().and_then(|s| s.refresh.as_mut()) {
            Some(refresh) => Ok(refresh.run(&values)?),
            None => Ok(()),
        }
    }

    /// The rate has changed, which is part of the graph.
    pub(super) fn forget_refresh(&mut self) {
        if let Some(s) = &mut self.seldom {
            s.refresh = None;
        }
    }
}
