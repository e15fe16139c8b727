//! What an intrinsic stage models, for those who only want to know.

use super::consistency::StepKind;
use super::{Intrinsic, IntrinsicNeeds};
use sgs_passes::pipeline::IntrinsicOptions;

impl Intrinsic {
    /// What training was reckoned to take of the device's memory.
    pub fn needs(&self) -> &IntrinsicNeeds {
        &self.needs
    }

    /// What is modeled.
    pub fn options(&self) -> &IntrinsicOptions {
        &self.options
    }

    /// Which priors of materials there are: albedo, roughness, metallic.
    pub fn priors(&self) -> [bool; 3] {
        let p = &self.priors;
        [p.albedo.is_some(), p.roughness.is_some(), p.metallic.is_some()]
    }

    /// Whether what views see of the geometry is kept for all of them.
    pub fn keeps_surfaces(&self) -> bool {
        !self.surfaces.waits(false)
    }

    /// Whether albedo is ever compared with pseudo-views, and under other lights.
    pub fn compares(&self) -> [bool; 2] {
        let due = |kind| (1..=self.settings.intrinsic.steps).any(|step| self.kind(step) == kind);
        [due(StepKind::CrossView), due(StepKind::Relight)]
    }
}
