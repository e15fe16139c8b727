//! Saving and restoring of the geometry stage.

use super::checkpoint::{self, DecoderValues, State};
use super::{Geometry, first_entry_capacity, kernel_of, last_that};
use crate::course::Course;
use crate::divergence::RollBack;
use crate::error::Result;
use sgs_config::Backward;
use sgs_passes::pipeline::Status;
use sgs_passes::scene::{Gaussians, Layout};
use std::path::Path;

impl Geometry {
    /// Writes a checkpoint with everything that resuming requires.
    ///
    /// # Errors
    /// If the file cannot be written; an earlier one stays whole.
    pub fn save(&self, path: &Path) -> Result<()> {
        let device = &self.device;
        let (moments, statistics) = self.gaussians.download_optimizer(device)?;
        let decoder = match &self.semantics {
            Some((_, decoder)) => Some(DecoderValues {
                parameters: decoder.download(device)?,
                moments: decoder.download_moments(device)?,
            }),
            None => None,
        };
        let state = State {
            step: self.done,
            capacity: self.gaussians.capacity,
            parameters: self.gaussians.download(device)?,
            moments,
            statistics,
            decoder,
            views: match &self.views {
                Some((views, _)) => views.download(device)?,
                None => Vec::new(),
            },
            course: Course { watch: self.watch.save(), roll_backs: self.roll_backs.clone() },
            bands: self.bands.clone(),
            decisions: self.decisions.clone(),
            growth: self.growth.clone(),
            backward: Some(self.settings.geometry.backward).filter(|kernel| *kernel != Backward::Auto),
            model: self.gaussians.model,
        };
        checkpoint::save(path, &state)
    }

    /// Restores the state that [`Geometry::save`] wrote.
    ///
    /// # Errors
    /// If the file is damaged or belongs to other settings.
    pub fn restore(&mut self, path: &Path) -> Result<()> {
        let state = checkpoint::load(
            path,
            self.gaussians.model,
            self.bands.is_some(),
            self.views.as_ref().map(|(v, _)| v.count()),
        )?;
        let count = state.parameters.len() as u32;
        // Densification stops at the capacity, so it has to be restored.
        let enabled = self.settings.geometry.densify.enabled();
        let first = first_entry_capacity(self.settings.geometry.entry_capacity, count);
        let first = self.options.entry_capacity.max(first);
        let room = if enabled { state.capacity.clamp(count, self.most.max(count)) } else { count };
        let layout = Layout {
            model: state.model,
            capacity: room,
            training: true,
            statistics: self.options.statistics.is_some(),
            storage: self.tuning.accuracy.storage(),
        };
        let capacity = last_that(count, room, |capacity| self.fits(&Layout { capacity, ..layout }, first))?;
        // Two sets of Gaussians might not fit.
        self.forget_steps();
        self.gaussians = Gaussians::of(&self.device, &Layout { capacity: 1, ..layout })?;
        self.gaussians = Gaussians::of(&self.device, &Layout { capacity, ..layout })?;
        self.gaussians.upload(&self.device, &state.parameters)?;
        self.gaussians.upload_optimizer(&self.device, &state.moments, &state.statistics)?;
        if let (Some((_, decoder)), Some(values)) = (&self.semantics, &state.decoder) {
            decoder.upload(&self.device, &values.parameters)?;
            decoder.upload_moments(&self.device, &values.moments)?;
        }
        if let Some((views, _)) = &self.views {
            views.upload(&self.device, &state.views)?;
        }
        self.options.entry_capacity = first;
        // The choice of an interrupted training belongs to its result.
        if let (Backward::Auto, Some(kernel)) = (self.settings.geometry.backward, state.backward) {
            self.options.backward = kernel_of(kernel, &self.device)?;
            self.settings.geometry.backward = kernel;
        }
        // The status counts from the start again.
        self.status = Status::new(&self.device)?;
        self.rebuild()?;
        self.submitted = state.step;
        self.done = state.step;
        self.settled = state.step;
        self.watch.restore(&state.course.watch);
        self.schedule.set_rates(RollBack::rates_after(state.course.roll_backs.len()));
        self.roll_backs = state.course.roll_backs;
        self.bands = match self.bands {
            Some(_) => Some(state.bands.unwrap_or_default().checked(path, state.model, self.data.views.len())?),
            None => None,
        };
        self.decisions = state.decisions;
        self.growth = state.growth;
        Ok(())
    }
}
