//! What a training takes in the end, if it ends with so many Gaussians.
//!
//! Leaves to others how many that will be: it follows from the photographs, and nobody knows before.

use super::{Geometry, entries_with, next_room};
use crate::error::Result;
use crate::memory::Needs;
use sgs_engine::STAGING_BYTES;
use sgs_passes::pipeline::GeometryOptions;
use sgs_passes::scene::{Layout, Model};

/// Views that are looked at.
const VIEWS: usize = 64;

impl Geometry {
    /// Most tile entries of a training view as things are, before the first step or between calls of [`Geometry::train`]. Parameters are
    /// held meanwhile.
    ///
    /// # Errors
    /// If the device fails.
    pub fn entries(&mut self) -> Result<u32> {
        self.status.hold(&self.device)?;
        let views = self.data.views.len().min(VIEWS);
        let mut most = 0;
        for step in (1..).take(views) {
            let values = self.values(step);
            self.exec()?.submit(&values)?;
            self.exec()?.finish()?;
            most = most.max(self.status.report(step)?.entries);
        }
        self.status.clear_flags(&self.device)?;
        Ok(most)
    }

    /// What training takes at most, if it ends with so many Gaussians, began with `count`, and has so many tile entries now. With all bands of
    /// spherical harmonics that may come.
    ///
    /// # Errors
    /// If so many make no graph.
    pub fn expected(&self, gaussians: u32, count: u32, entries: u32) -> Result<Needs> {
        let g = &self.settings.geometry;
        let now = self.gaussians.layout();
        let model = Model { sh_degree: g.sh_degree.most().max(now.model.sh_degree), ..now.model };
        let capacity = if g.densify.enabled { next_room(gaussians, now.capacity, self.most) } else { now.capacity };
        let layout = Layout { model, capacity, ..now };
        // Room for entries is made with an eighth to spare, half of which is left on average.
        let most = f64::from(entries).max(entries_with(entries, count, gaussians));
        let room = (most * (1.0 + 1.0 / 16.0)) as u32;
        let options = GeometryOptions { entry_capacity: room.max(self.options.entry_capacity), ..self.options };
        let mut needs = Needs::of(&self.device, &self.tuning, &layout, &self.inputs, &options)?;
        if let Some(c) = &self.correspondence {
            needs = needs.with_views(&self.tuning, &layout, &self.inputs, &options, c)?;
        }
        // Checkpoints go through it, and no group is larger than moments of the widest.
        let widest = model.groups().map(|g| 8 * u64::from(g.width())).max().unwrap_or(0);
        needs.staging = STAGING_BYTES.min(widest * u64::from(gaussians));
        Ok(needs)
    }
}
