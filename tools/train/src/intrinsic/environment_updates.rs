//! Environment map that is updated every N steps.
//! The setting is `intrinsic.environment.every`.
//!
//! Guarantees: checkpoints store the gradient accumulated since the last update, so an interrupted training continues
//! bit for bit. An update waits for the steps before it on the device, not on the host.

use super::Intrinsic;
use crate::error::Result;
use sgs_passes::pipeline::{EnvironmentRefresh, Step, StoredEnvironment};

/// Stored mip levels of the environment map, and the graph that updates its texels.
pub(super) struct EnvironmentUpdates {
    stored: StoredEnvironment,
    /// Update graph, built on first use.
    refresh: Option<EnvironmentRefresh>,
}

impl EnvironmentUpdates {
    /// Returns the stored levels.
    pub fn stored(&self) -> &StoredEnvironment {
        &self.stored
    }

    /// Waits for the submitted update.
    pub fn finish(&mut self) -> Result<()> {
        self.refresh.as_mut().map_or(Ok(()), |refresh| Ok(refresh.finish()?))
    }
}

impl Intrinsic {
    /// Filters the current texels, if updates do not run in every step.
    pub(super) fn keep_environment(&mut self) -> Result<()> {
        let Some((e, _)) = self.environment.as_ref().filter(|_| self.options.environment_every > 1) else {
            self.environment_updates = None;
            return Ok(());
        };
        if self.environment_updates.is_none() {
            self.environment_updates =
                Some(EnvironmentUpdates { stored: StoredEnvironment::new(&self.device, e)?, refresh: None });
        }
        Ok(EnvironmentRefresh::filter(&self.device, &self.tuning, &self.inputs(super::StepKind::Plain))?)
    }

    /// Returns the number of updates of the texels by the end of a step.
    pub(super) fn moves(&self, step: u32) -> u32 {
        let (every, [since, before]) = (self.options.environment_every.max(1), self.update_intervals);
        before + step / every - since / every
    }

    /// Sets the update interval from now on, after `step` steps with `moves` updates.
    /// At this time the texels are near their optimum, and gradients are mostly noise, unlike at the start. The mean of
    /// k gradients has 1/√k of the noise of one. Updates √k times as long therefore travel as far, and drift no
    /// farther, than an update in every step.
    pub(super) fn set_update_interval(&mut self, every: u32, step: u32, moves: u32) -> Result<()> {
        self.finish()?;
        self.forget_steps();
        self.options.environment_every = every;
        self.required.intrinsic.environment.every = every;
        let requested = &self.settings.intrinsic;
        let shorter = (f64::from(requested.environment.every) / f64::from(every)).sqrt() as f32;
        self.options.rates.environment = requested.rates.environment * self.schedule.rates() as f32 * shorter;
        self.update_intervals = [step, moves];
        self.forget_refresh();
        self.keep_environment()
    }

    /// Updates the texels after a step, if an update is due.
    pub(super) fn move_environment(&mut self, step: u32) -> Result<()> {
        let every = self.options.environment_every.max(1);
        if self.environment_updates.is_none() || !step.is_multiple_of(every) {
            return Ok(());
        }
        if self.environment_updates.as_ref().is_some_and(|s| s.refresh.is_none()) {
            let inputs = self.inputs(super::StepKind::Plain);
            let made = EnvironmentRefresh::new(&self.device, &self.tuning, &inputs, &self.status, &self.options)?;
            if let Some(s) = &mut self.environment_updates {
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
        match self.environment_updates.as_mut().and_then(|s| s.refresh.as_mut()) {
            Some(refresh) => Ok(refresh.run(&values)?),
            None => Ok(()),
        }
    }

    /// Drops the update graph, which contains the learning rate.
    pub(super) fn forget_refresh(&mut self) {
        if let Some(s) = &mut self.environment_updates {
            s.refresh = None;
        }
    }
}
