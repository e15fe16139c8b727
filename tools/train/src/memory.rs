//! What training will take of the device's memory, added up before anything is made.
//!
//! Promises that the sum is the one of the buffers that the first step has, byte for byte, plus the staging memory of an
//! upload. Leaves room for growth to densification, which stops where the budget ends.

use crate::correspondence::Correspondence;
use crate::error::{Result, TrainError};
use crate::uniforms::uniform;
use serde::Serialize;
use sgs_config::Settings;
use sgs_engine::{Budget, Device, STAGING_BYTES};
use sgs_passes::Tuning;
use sgs_passes::pipeline::{DensifyStep, GeometryOptions, GeometryStep, InputSizes, PSEUDO_VIEWS, Status};
use sgs_passes::scene::{Decoder, Layout};

/// Bytes of device memory by what they are for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Needs {
    /// Training photographs.
    pub photographs: u64,
    /// Normal priors.
    pub priors: u64,
    /// Semantic priors, texts and the decoder.
    pub semantics: u64,
    /// Regions that are compared between views.
    pub regions: u64,
    /// Pictures of what a network is asked about.
    pub asked: u64,
    /// Parameters of the Gaussians, at first capacity.
    pub parameters: u64,
    /// Adam's moments.
    pub moments: u64,
    /// Both, of bands of spherical harmonics that may come later, and what steps with them take more.
    pub bands: u64,
    /// Densification statistics.
    pub statistics: u64,
    /// Transients of a step.
    pub arena: u64,
    /// More of them from when on there are pseudo-views.
    pub pseudo_arena: u64,
    /// Transients of densification, where they do not fit into those of a step.
    pub densify_arena: u64,
    /// Uniforms and reports.
    pub small: u64,
    /// Staging memory of an upload.
    pub staging: u64,
}

impl Needs {
    /// Adds up what the first steps take.
    pub(crate) fn of(
        device: &Device,
        tuning: &Tuning,
        layout: &Layout,
        inputs: &InputSizes,
        options: &GeometryOptions,
    ) -> Result<Needs> {
        let plan = GeometryStep::plan(tuning, layout, inputs, options)?;
        let densify = if layout.statistics { DensifyStep::plan(tuning, layout)?.arena_bytes } else { 0 };
        // What goes to the device or comes back at once: a group's moments at most, or a kind of data.
        let widest = layout.model.groups().map(|g| 8 * u64::from(g.width())).max().unwrap_or(0);
        let data = inputs.targets.max(inputs.semantics.map_or(0, |s| s.bytes() + Decoder::TRAINING_BYTES));
        let largest = data.max(inputs.normals.unwrap_or(0)).max(widest * u64::from(layout.capacity));
        Ok(Needs {
            photographs: inputs.targets,
            priors: inputs.normals.unwrap_or(0),
            semantics: inputs.semantics.map_or(0, |s| s.bytes() + Decoder::TRAINING_BYTES),
            // Known once they are loaded.
            regions: 0,
            asked: 0,
            parameters: layout.parameter_bytes(),
            moments: layout.moment_bytes(),
            bands: 0,
            statistics: layout.statistics_bytes(),
            arena: plan.arena_bytes,
            pseudo_arena: 0,
            densify_arena: if densify > plan.arena_bytes { densify } else { 0 },
            small: options.frames_in_flight as u64 * uniform(device) + Status::BYTES + 16,
            staging: STAGING_BYTES.min(largest),
        })
    }

    /// Adds what comparing regions between views takes later.
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
        self.asked = correspondence.looking(device, layout, options.largest, options.entry_capacity)?;
        let inputs = InputSizes { regions: Some(self.regions), ..*inputs };
        let options = GeometryOptions { pseudo: Some(correspondence.masks()), ..*options };
        let plan = GeometryStep::plan(tuning, layout, &inputs, &options)?;
        self.pseudo_arena = plan.arena_bytes.saturating_sub(self.arena);
        self.small += (PSEUDO_VIEWS * options.frames_in_flight) as u64 * uniform(device);
        Ok(self)
    }

    /// Adds what comes on top where all bands of spherical harmonics come, with which these are the needs.
    pub(crate) fn with_bands(mut self, all: &Needs) -> Needs {
        self.bands = 0;
        self.bands = all.total().saturating_sub(self.total());
        self
    }

    /// What making room takes for so many, for a moment: one group is there twice, steps are not.
    pub(crate) fn growing(&self, from: &Layout, to: &Layout) -> u64 {
        if to.capacity <= from.capacity {
            return 0;
        }
        let steps = self.arena + self.pseudo_arena + self.densify_arena;
        let widest = from.model.groups().map(|g| 8 * u64::from(g.width())).max().unwrap_or(0);
        self.total() - steps + widest * u64::from(from.capacity)
    }

    /// All of it.
    pub fn total(&self) -> u64 {
        self.parts().into_iter().map(|(_, bytes)| bytes).sum()
    }

    /// What for, and how many bytes.
    pub fn parts(&self) -> [(&'static str, u64); 14] {
        [
            ("photographs", self.photographs),
            ("normal priors", self.priors),
            ("semantic priors", self.semantics),
            ("regions", self.regions),
            ("pictures for a network", self.asked),
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

    /// Refuses if it does not fit.
    pub(crate) fn check(&self, budget: &Budget) -> Result<()> {
        let advice = "use --scale, --views, fewer points, a lower geometry.sh_degree, or a larger --memory-budget";
        // Bands for which there is no room are left out.
        let first = Needs { bands: 0, ..*self };
        refuse_beyond(budget, first.total(), &first.parts(), "The first step", advice)
    }
}

/// Refuses what does not fit, with the figures.
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

/// The budget that settings and device allow together.
pub(crate) fn allowed(device: &Device, settings: &Settings) -> Budget {
    let b = device.budget();
    match settings.geometry.densify.max_mib {
        0 => b,
        mib => Budget { budget: b.budget.min(mib << 20), ..b },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sgs_engine::BudgetSource;

    #[test]
    fn what_does_not_fit_is_refused_with_the_figures() {
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
