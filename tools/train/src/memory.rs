//! Device memory that the geometry stage will need, summed before any allocation.
//!
//! Guarantees: the sum equals, to the byte, the sizes of all buffers at the first step plus the staging memory of an
//! upload. The sum holds no reserve for growth. Densification itself stops at the budget.

use crate::correspondence::Correspondence;
use crate::error::{Result, TrainError};
use crate::uniforms::uniform;
use serde::Serialize;
use sgs_engine::{Budget, Device, STAGING_BYTES};
use sgs_passes::Tuning;
use sgs_passes::pipeline::{DensifyRule, DensifyStep, GeometryOptions, GeometryStep, InputSizes, PSEUDO_VIEWS, Status};
use sgs_passes::scene::{Decoder, Group, Layout, LearnedViews};

/// Bytes of device memory by purpose.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Needs {
    /// Training photographs.
    pub photographs: u64,
    /// Priors of normals and depths.
    pub priors: u64,
    /// Semantic priors, text embeddings and the decoder.
    pub semantics: u64,
    /// Regions that are compared between views.
    pub regions: u64,
    /// Renderer of the images that a provider is shown.
    pub requested: u64,
    /// Parameters of the Gaussians, at the initial capacity.
    pub parameters: u64,
    /// Adam's moments.
    pub moments: u64,
    /// Later bands of spherical harmonics: parameters, moments and additional step memory.
    pub bands: u64,
    /// Densification statistics.
    pub statistics: u64,
    /// Transients of a step.
    pub arena: u64,
    /// Additional transients of steps with pseudo-views.
    pub pseudo_arena: u64,
    /// Transients of densification, where they exceed those of a step.
    pub densify_arena: u64,
    /// Uniforms and reports.
    pub small: u64,
    /// Staging memory of an upload.
    pub staging: u64,
}

/// Returns the rule of densification for steps with these options.
pub(crate) fn rule_of(options: &GeometryOptions) -> DensifyRule {
    if options.mcmc { DensifyRule::Relocation } else { DensifyRule::Gradient }
}

impl Needs {
    /// Sums the memory of the first steps.
    pub(crate) fn of(
        device: &Device,
        tuning: &Tuning,
        layout: &Layout,
        inputs: &InputSizes,
        options: &GeometryOptions,
    ) -> Result<Needs> {
        let plan = GeometryStep::plan(tuning, layout, inputs, options)?;
        let densify = match layout.statistics || options.mcmc {
            true => DensifyStep::plan(tuning, layout, rule_of(options))?.arena_bytes,
            false => 0,
        };
        // The largest transfer is the Gaussians' columns, their features' moments, or one kind of input data.
        let pairs = if layout.model.semantics { 8 * u64::from(Group::Semantics.width()) } else { 0 };
        let widest = layout.model.column_bytes(layout.capacity).max(pairs * u64::from(layout.capacity));
        let data = inputs.targets.max(inputs.semantics.map_or(0, |s| s.bytes() + Decoder::TRAINING_BYTES));
        let maps = inputs.normals.unwrap_or(0) + inputs.depths.map_or(0, |d| d.0);
        let largest = data.max(inputs.normals.max(inputs.depths.map(|d| d.0)).unwrap_or(0)).max(widest);
        Ok(Needs {
            photographs: inputs.targets * inputs.parts.max(1),
            priors: maps * inputs.parts.max(1),
            semantics: inputs.semantics.map_or(0, |s| s.bytes() + Decoder::TRAINING_BYTES),
            // Known once the regions are loaded.
            regions: 0,
            requested: 0,
            parameters: layout.parameter_bytes(),
            moments: layout.moment_bytes(),
            bands: 0,
            statistics: layout.statistics_bytes(),
            arena: plan.arena_bytes,
            pseudo_arena: 0,
            densify_arena: if densify > plan.arena_bytes { densify } else { 0 },
            small: options.frames_in_flight as u64 * uniform(device)
                + Status::BYTES
                + 16
                + inputs.views.map_or(0, |(count, _)| LearnedViews::bytes(count)),
            staging: STAGING_BYTES.min(largest),
        })
    }

    /// Adds the memory of region comparison between views, which begins later.
    pub(crate) fn with_views(
        mut self,
        device: &Device,
        tuning: &Tuning,
        layout: &Layout,
        inputs: &InputSizes,
        options: &GeometryOptions,
        correspondence: &Correspondence,
    ) -> Result<Needs> {
        self.regions = correspondence.bytes();
        self.requested = correspondence.rendering_bytes(device, layout, options.largest, options.entry_capacity)?;
        let inputs = InputSizes { regions: Some(self.regions), ..*inputs };
        let options = GeometryOptions { pseudo: Some(correspondence.masks()), ..*options };
        let plan = GeometryStep::plan(tuning, layout, &inputs, &options)?;
        self.pseudo_arena = plan.arena_bytes.saturating_sub(self.arena);
        self.small += (PSEUDO_VIEWS * options.frames_in_flight) as u64 * uniform(device);
        Ok(self)
    }

    /// Adds the memory of later bands of spherical harmonics.
    /// `all`: the needs with all bands.
    pub(crate) fn with_bands(mut self, all: &Needs) -> Needs {
        self.bands = 0;
        self.bands = all.total().saturating_sub(self.total());
        self
    }

    /// Returns the peak memory of growing to a larger capacity.
    /// One parameter group exists twice during the growth; the memory of steps is released.
    pub(crate) fn growing(&self, from: &Layout, to: &Layout) -> u64 {
        if to.capacity <= from.capacity {
            return 0;
        }
        let steps = self.arena + self.pseudo_arena + self.densify_arena;
        let widest = from.model.groups().map(|g| 8 * u64::from(g.width())).max().unwrap_or(0);
        self.total() - steps + widest * u64::from(from.capacity)
    }

    /// Returns the total number of bytes.
    pub fn total(&self) -> u64 {
        self.parts().into_iter().map(|(_, bytes)| bytes).sum()
    }

    /// Returns all entries with names and bytes.
    pub fn parts(&self) -> [(&'static str, u64); 14] {
        [
            ("photographs", self.photographs),
            ("normal priors", self.priors),
            ("semantic priors", self.semantics),
            ("regions", self.regions),
            ("images for a network", self.requested),
            ("parameters", self.parameters),
            ("moments", self.moments),
            ("bands that may come", self.bands),
            ("statistics", self.statistics),
            ("arena", self.arena),
            ("arena of pseudo-views", self.pseudo_arena),
            ("arena of densification", self.densify_arena),
            ("uniforms and reports", self.small),
            ("staging", self.staging),
        ]
    }

    /// Rejects needs that exceed the budget.
    pub(crate) fn check(&self, budget: &Budget) -> Result<()> {
        let advice = "use --scale, --views, fewer points, a lower geometry.sh_degree, or a larger --memory-budget";
        // Bands that do not fit are left out, so they do not count here.
        let first = Needs { bands: 0, ..*self };
        refuse_beyond(budget, first.total(), &first.parts(), "The first step", advice)
    }
}

/// Rejects a total that exceeds the budget, with the figures.
pub(crate) fn refuse_beyond(
    budget: &Budget,
    total: u64,
    parts: &[(&'static str, u64)],
    what: &str,
    advice: &str,
) -> Result<()> {
    if total <= budget.left() {
        return Ok(());
    }
    let mib = |bytes: u64| format!("{:.1}", bytes as f64 / f64::from(1 << 20));
    let parts: Vec<String> = parts
        .iter()
        .filter(|(_, bytes)| *bytes >= 1 << 16)
        .map(|(name, bytes)| format!("{name} {}", mib(*bytes)))
        .collect();
    Err(TrainError::Memory(format!(
        "{what} needs {} MiB of device memory ({}), but the budget leaves {} of {} MiB; {advice}.",
        mib(total),
        parts.join(", "),
        mib(budget.left()),
        mib(budget.budget)
    )))
}

#[cfg(test)]
mod tests {
    use super::*;
    use sgs_engine::BudgetSource;

    #[test]
    fn needs_beyond_the_budget_are_rejected_with_figures() {
        let needs = Needs { photographs: 3 << 20, arena: 2 << 20, small: 100, ..Needs::default() };
        let budget = |budget, used| Budget { heap: 1 << 30, budget, used, source: BudgetSource::Configured };
        assert!(needs.check(&budget(needs.total(), 0)).is_ok());
        let refused = needs.check(&budget(needs.total(), 1)).unwrap_err().to_string();
        assert!(
            refused.starts_with(
                "The first step needs 5.0 MiB of device memory (photographs 3.0, arena 2.0), but the budget leaves 5.0 of \
                 5.0 MiB"
            ),
            "{refused}"
        );
    }
}
