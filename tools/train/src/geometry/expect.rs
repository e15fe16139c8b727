//! Estimate of memory and work of a training.
//!
//! The caller states the number of Gaussians at its end. That number depends on the photographs and is unknown before
//! training.

use super::{Geometry, entries_with, last_that, next_room};
use crate::error::Result;
use crate::memory::Needs;
use sgs_config::ShDegree;
use sgs_engine::STAGING_BYTES;
use sgs_passes::cost::{Cost, Counts, of_plan};
use sgs_passes::pipeline::{GeometryOptions, GeometryStep, InputSizes};
use sgs_passes::scene::{Layout, Model};

/// Number of views that are measured, at most.
const VIEWS: usize = 64;

/// Measurement of the Gaussians in the training views.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sight {
    /// Number of Gaussians.
    pub gaussians: f64,
    /// Tile entries of the view that has most.
    pub most_entries: u32,
    /// Tile entries of a view, mean.
    pub entries: f64,
    /// Gaussians that are visible in a view, mean.
    pub visible: f64,
    /// Pixels of a view, mean.
    pub pixels: f64,
}

impl Sight {
    /// Extrapolates the measurement to another number of Gaussians. They grow from these.
    #[must_use]
    pub fn with(&self, gaussians: u32) -> Sight {
        let (now, then) = (self.gaussians.max(1.0), f64::from(gaussians));
        Sight {
            gaussians: then,
            visible: self.visible * then / now,
            entries: entries_with(self.entries as u32, now as u32, gaussians),
            most_entries: entries_with(self.most_entries, now as u32, gaussians) as u32,
            ..*self
        }
    }
}

impl Geometry {
    /// Measures the training views with the current Gaussians. Call before the first step or between calls of
    /// [`Geometry::train`]. Parameters do not change.
    ///
    /// # Errors
    /// If the device fails.
    pub fn sight(&mut self) -> Result<Sight> {
        self.status.hold(&self.device)?;
        let views = self.data.views.len().min(VIEWS);
        let mut sight = Sight { gaussians: self.gaussians.count(&self.device)?.into(), ..Sight::default() };
        let share = 1.0 / views.max(1) as f64;
        for step in (1..).take(views) {
            let values = self.values_after(step, 0);
            self.exec_of(step)?.submit(&values)?;
            self.exec()?.finish()?;
            let report = self.status.report(step)?;
            let [width, height] = self.data.views[self.schedule.view(step)].0.size;
            sight.most_entries = sight.most_entries.max(report.entries);
            sight.entries += share * f64::from(report.entries);
            sight.visible += share * f64::from(report.visible);
            sight.pixels += share * f64::from(width) * f64::from(height);
        }
        self.status.clear_flags(&self.device)?;
        Ok(sight)
    }

    /// Returns the cost of a step and the number of passes of unknown cost. The cost is an upper bound: no Gaussian
    /// occludes another, and every pixel has a semantic target.
    ///
    /// # Errors
    /// If there is no step, because memory ran out.
    pub fn step_cost(&mut self, sight: &Sight) -> Result<(Cost, usize)> {
        let counts = self.counts(sight);
        Ok(of_plan(self.executor()?.plan(), &counts))
    }

    /// Returns the cost of a step that compares its view with pseudo-views. Assumes that pseudo-views see as much as
    /// training views do. Returns none if no step does so.
    ///
    /// # Errors
    /// If the step has no valid graph.
    pub fn pseudo_step_cost(&self, sight: &Sight) -> Result<Option<(Cost, usize)>> {
        let Some(c) = &self.correspondence else { return Ok(None) };
        let inputs = InputSizes { regions: Some(c.bytes()), ..self.inputs };
        let options = GeometryOptions { pseudo: Some(c.masks()), ..self.options };
        let plan = GeometryStep::plan(&self.tuning, &self.gaussians.layout(), &inputs, &options)?;
        Ok(Some(of_plan(&plan, &self.counts(sight))))
    }

    fn counts(&self, sight: &Sight) -> Counts {
        let tile = f64::from(self.tuning.tile[0] * self.tuning.tile[1]);
        Counts {
            gaussians: sight.gaussians,
            visible: sight.visible,
            entries: sight.entries,
            pixels: sight.pixels,
            pairs: tile * sight.entries,
            width: self.gaussians.model.width().into(),
            samples: sight.pixels,
            masked: sight.pixels,
            wanted: sight.pixels,
            ..Counts::default()
        }
    }

    /// Returns the memory of a training that ends with `gaussians` Gaussians, at most. `count`: number of Gaussians at
    /// its start. `entries`: current number of tile entries. Includes all bands of spherical harmonics that may be
    /// added.
    ///
    /// # Errors
    /// If that many Gaussians have no valid graph.
    pub fn expected(&self, gaussians: u32, count: u32, entries: u32) -> Result<Needs> {
        self.expected_of(self.settings.geometry.sh_degree.most(), gaussians, count, entries)
    }

    /// Returns the same without the bands that may be added. Returns none if the number of bands is fixed.
    ///
    /// # Errors
    /// If that many Gaussians have no valid graph.
    pub fn expected_without_bands(&self, gaussians: u32, count: u32, entries: u32) -> Result<Option<Needs>> {
        let auto = self.settings.geometry.sh_degree == ShDegree::Auto;
        auto.then(|| self.expected_of(0, gaussians, count, entries)).transpose()
    }

    /// Returns the most Gaussians with which training stays within the budget. Uses [`Geometry::expected`]. Settings
    /// and the device's bindings limit the number.
    ///
    /// # Errors
    /// If that many Gaussians have no valid graph.
    pub fn most_within_budget(&self, count: u32, entries: u32) -> Result<u32> {
        if !self.settings.geometry.densify.enabled() {
            return Ok(count);
        }
        last_that(count, self.most, |n| Ok(self.expected(n, count, entries)?.total() <= self.allowed))
    }

    fn expected_of(&self, sh_degree: u32, gaussians: u32, count: u32, entries: u32) -> Result<Needs> {
        let g = &self.settings.geometry;
        let now = self.gaussians.layout();
        let model = Model { sh_degree: sh_degree.max(now.model.sh_degree), ..now.model };
        let capacity = if g.densify.enabled() { next_room(gaussians, now.capacity, self.most) } else { now.capacity };
        let layout = Layout { model, capacity, ..now };
        // The capacity for entries is an eighth larger than needed when it grows; half of that remains on average.
        let most = f64::from(entries).max(entries_with(entries, count, gaussians));
        let room = (most * (1.0 + 1.0 / 16.0)) as u32;
        let options = GeometryOptions { entry_capacity: room.max(self.options.entry_capacity), ..self.options };
        let mut needs = Needs::of(&self.device, &self.tuning, &layout, &self.inputs, &options)?;
        if let Some(c) = &self.correspondence {
            needs = needs.with_views(&self.device, &self.tuning, &layout, &self.inputs, &options, c)?;
        }
        // Checkpoints pass through staging memory. No group is larger than the moments of the widest.
        let widest = model.groups().map(|g| 8 * u64::from(g.width())).max().unwrap_or(0);
        needs.staging = STAGING_BYTES.min(widest * u64::from(gaussians));
        Ok(needs)
    }
}
