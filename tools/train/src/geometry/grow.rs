//! Densification between steps, and the capacity that it requires.

use super::{Geometry, Progress, entries_of, next_room};
use crate::error::Result;
use crate::memory::rule_of;
use sgs_passes::pipeline::{DensifySettings, DensifyStep};

impl Geometry {
    /// Adds and removes Gaussians within the memory limit.
    pub(super) fn densify(
        &mut self,
        step: u32,
        mut settings: DensifySettings,
        on_report: &mut impl FnMut(&Progress),
    ) -> Result<()> {
        // Each Gaussian adds at most one.
        let count = self.gaussians.count(&self.device)?;
        let limit = self.most.min(next_room(count.saturating_mul(2), self.gaussians.capacity, self.most));
        let most = self.most_that_fit(count, limit)?;
        settings.cap = settings.cap.min(most);
        if self.was_held_back(step, self.settings.geometry.densify.interval) {
            // Gaussians that only the held-out views show have gathered no weight.
            settings.prune_weight = 0.0;
        }
        if self.densify.is_none() {
            // Densification may use the step's arena: nothing in it outlives a replay.
            let arena = self.exec()?.executor().arena().cloned();
            let rule = rule_of(&self.options);
            self.densify = Some(DensifyStep::new(&self.device, &self.tuning, &self.gaussians, rule, arena)?);
        }
        let Some(densify) = &mut self.densify else { return Ok(()) };
        let stats = densify.run(&settings)?;
        tracing::info!(step, ?stats, most, "densified");
        let entries = entries_of(self.growth.entries, count, stats.after);
        if self.promised && !self.fits(&self.gaussians.layout(), self.options.entry_capacity)? {
            self.options.entry_capacity = self.options.entry_capacity.min(entries.max(1 << 10));
            self.rebuild()?;
        }
        let room = next_room(stats.after, self.gaussians.capacity, most.min(self.most));
        if room > self.gaussians.capacity {
            if self.promised {
                self.options.entry_capacity = self.options.entry_capacity.min(entries.max(1 << 10));
            }
            self.grow(room)?;
        }
        self.slowed(step, &stats, most < limit, on_report);
        on_report(&Progress::Densified { step, stats });
        Ok(())
    }

    /// Raises the capacity for Gaussians. If memory runs out, the current capacity becomes the limit.
    fn grow(&mut self, room: u32) -> Result<()> {
        self.forget_steps();
        match self.gaussians.grow(&self.device, room) {
            Ok(()) => {}
            Err(error) if error.is_out_of_memory() => {
                tracing::debug!(%error, "no room for more Gaussians");
                self.most = self.gaussians.capacity;
                let budget = self.device.budget().budget >> 20;
                tracing::warn!("Densification stops at {} Gaussians: no more fit into {budget} MiB.", self.most);
            }
            Err(error) => return Err(error.into()),
        }
        self.rebuild()
    }
}
