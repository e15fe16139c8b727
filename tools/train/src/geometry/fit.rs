//! Limit of training to a memory budget (`memory.budget`). Growth is limited to what fits. Where even the tile entries
//! of the current Gaussians do not fit, the faintest Gaussians are removed.
//!
//! Guarantees: growth never exceeds the allowance, and a training whose start fits runs to its end. The result depends
//! on the allowance, not on other properties of the memory.

use super::{Decision, Geometry, Progress, entries_of};
use crate::error::{Result, TrainError};
use crate::memory::Needs;
use serde::{Deserialize, Serialize};
use sgs_config::MOST_BANDS;
use sgs_engine::{Budget, BudgetSource};
use sgs_passes::pipeline::{DensifyStats, GeometryOptions};
use sgs_passes::scene::{GaussianData, Gaussians, Group, Layout, Model, STATISTICS};

/// Margin for small buffers, in bytes.
const SLACK: u64 = 4096;

/// State of growth. Part of checkpoints.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Growth {
    /// Most tile entries of a step since the last densification.
    pub entries: u32,
    /// New Gaussians that densification requested while memory was short. `refused` counts those that memory refused.
    pub requested: u64,
    pub refused: u64,
}

/// Returns the part of a budget that training may use, in bytes. Without a promised budget (the budget is the whole
/// heap), uses 90 % of the heap.
pub(super) fn allowance(b: &Budget) -> u64 {
    let all = if b.source == BudgetSource::Heap && b.budget == b.heap { b.heap / 10 * 9 } else { b.budget };
    all.saturating_sub(b.used)
}

/// Finds the last number from `low` to `high` for which `holds` returns true. `holds` is true up to some number and
/// false beyond it. Returns at least `low`.
pub(super) fn last_that(low: u32, high: u32, holds: impl Fn(u32) -> Result<bool>) -> Result<u32> {
    if high <= low || holds(high)? {
        return Ok(high.max(low));
    }
    let (mut low, mut high) = (low, high);
    while high - low > 1 {
        let middle = low + (high - low) / 2;
        if holds(middle)? {
            low = middle;
        } else {
            high = middle;
        }
    }
    Ok(low)
}

impl Geometry {
    /// Returns whether a layout fits. Includes the step, densification and the growth to the layout.
    pub(super) fn fits(&self, layout: &Layout, entries: u32) -> Result<bool> {
        let options = GeometryOptions { entry_capacity: entries, ..self.options };
        let mut needs = Needs::of(&self.device, &self.tuning, layout, &self.inputs, &options)?;
        if let Some(c) = &self.correspondence {
            needs = needs.with_views(&self.device, &self.tuning, layout, &self.inputs, &options, c)?;
        }
        if needs.arena + needs.pseudo_arena > self.device.info().largest_buffer() {
            return Ok(false);
        }
        Ok(needs.total().max(needs.growing(&self.gaussians.layout(), layout)) + SLACK <= self.allowed)
    }

    /// Returns the model with all bands that may still be added.
    fn model_to_come(&self) -> Model {
        let open = self.bands.as_ref().is_some_and(|b| b.is_open());
        let now = self.gaussians.model;
        Model { sh_degree: if open { MOST_BANDS } else { now.sh_degree }, ..now }
    }

    /// Returns the most Gaussians up to `limit` that fit, at least `count`. Tile entries are extrapolated from those of
    /// the last steps.
    pub(super) fn most_that_fit(&self, count: u32, limit: u32) -> Result<u32> {
        let layout = Layout { model: self.model_to_come(), ..self.gaussians.layout() };
        last_that(count, limit, |n| {
            let layout = Layout { capacity: n.max(layout.capacity), ..layout };
            self.fits(&layout, entries_of(self.growth.entries, count, n))
        })
    }

    /// Counts new Gaussians that memory refused. Reports the sum after the last densification.
    pub(super) fn slowed(
        &mut self,
        step: u32,
        stats: &DensifyStats,
        short: bool,
        on_report: &mut impl FnMut(&Progress),
    ) {
        if short {
            self.growth.requested += u64::from(stats.cloned) + u64::from(stats.split) + u64::from(stats.refused);
            self.growth.refused += u64::from(stats.refused);
        }
        self.growth.entries = 0;
        let Growth { requested, refused, .. } = self.growth;
        if refused > 0 && self.schedule.densifies_last(step) {
            let reason = format!(
                "{refused} of {requested} that densification asked for did not fit into {:.1} MiB; there are {} Gaussians",
                self.allowed as f64 / f64::from(1 << 20),
                stats.after
            );
            self.decide(Decision::of_memory(step, "new Gaussians", reason), on_report);
        }
    }

    /// Makes tile entries fit. Frees unused capacity first, then removes the faintest Gaussians.
    ///
    /// # Errors
    /// If even that does not suffice. Without densification and without a promised budget, no Gaussian may be removed.
    pub(super) fn squeeze(&mut self, step: u32, wanted: u32, on_report: &mut impl FnMut(&Progress)) -> Result<()> {
        let layout = self.gaussians.layout();
        for entries in [self.options.entry_capacity, wanted] {
            if self.fits(&layout, entries)? {
                self.options.entry_capacity = entries;
                return Ok(());
            }
        }
        let count = self.gaussians.count(&self.device)?;
        // A tenth more than in proportion: the Gaussians that stay are the larger ones, and other views see more.
        let entries = |n: u32| {
            let share = f64::from(wanted) * f64::from(n) / f64::from(count.max(1));
            if n == count { wanted } else { (1.1 * share) as u32 }
        };
        let fits = |n: u32| self.fits(&Layout { capacity: n, ..layout }, entries(n));
        // A promised budget takes precedence over the number of Gaussians.
        let keep = match self.settings.geometry.densify.enabled() || self.promised {
            true => last_that(1, count, fits)?,
            false => count,
        };
        if !fits(keep)? {
            return Err(TrainError::Memory(format!(
                "The {wanted} tile entries of step {step} do not fit into {:.1} MiB; use --scale, fewer points, or a larger \
                 --memory-budget.",
                self.allowed as f64 / f64::from(1 << 20)
            )));
        }
        self.options.entry_capacity = entries(keep);
        self.keep_strongest(keep)?;
        if keep < count {
            let reason = format!(
                "the {wanted} tile entries of step {step} did not fit into {:.1} MiB; {keep} of {count} are left",
                self.allowed as f64 / f64::from(1 << 20)
            );
            self.decide(Decision::of_memory(step - 1, "the faintest Gaussians", reason), on_report);
        }
        Ok(())
    }

    /// Keeps the `keep` most opaque Gaussians and removes the others. Reduces the capacity to `keep`.
    fn keep_strongest(&mut self, keep: u32) -> Result<()> {
        self.forget_steps();
        let device = self.device.clone();
        let parameters = self.gaussians.download(&device)?;
        let (moments, statistics) = self.gaussians.download_optimizer(&device)?;
        let opacities = parameters.group(Group::OpacityLogits);
        let mut order: Vec<usize> = (0..opacities.len()).collect();
        order.sort_by(|a, b| opacities[*b].total_cmp(&opacities[*a]));
        order.truncate(keep as usize);
        order.sort_unstable();
        let of = |values: &[f32], width: usize| -> Vec<f32> {
            let rows = order.iter().filter_map(|i| values.get(i * width..(i + 1) * width));
            rows.flatten().copied().collect()
        };
        let (mut retained, mut retained_moments) = (GaussianData::default(), GaussianData::default());
        let layout = self.gaussians.layout();
        for g in layout.model.groups() {
            let width = g.width() as usize;
            retained.groups[g as usize] = of(parameters.group(g), width);
            retained_moments.groups[g as usize] = of(moments.group(g), 2 * width);
        }
        // Two of them would not fit.
        self.gaussians = Gaussians::of(&device, &Layout { capacity: 1, ..layout })?;
        self.gaussians = Gaussians::of(&device, &Layout { capacity: keep, ..layout })?;
        self.gaussians.upload(&device, &retained)?;
        let statistics = of(&statistics, STATISTICS as usize);
        Ok(self.gaussians.upload_optimizer(&device, &retained_moments, &statistics)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn last_that_finds_the_last_number() {
        for last in [0, 5, 6, 17, 99, 100, 200] {
            let found = last_that(5, 100, |n| Ok(n <= last)).unwrap();
            assert_eq!(found, last.clamp(5, 100));
        }
        assert_eq!(last_that(7, 3, |_| panic!("nothing is to be asked")).unwrap(), 7);
    }

    #[test]
    fn budget_without_promise_is_not_exhausted() {
        let b = |source, budget| Budget { heap: 1000, budget, used: 100, source };
        assert_eq!(allowance(&b(BudgetSource::Heap, 1000)), 800);
        assert_eq!(allowance(&b(BudgetSource::Configured, 1000)), 900);
        assert_eq!(allowance(&b(BudgetSource::Driver, 50)), 0);
    }
}
