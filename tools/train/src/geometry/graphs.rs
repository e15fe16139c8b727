//! Graphs of the stage, ahead of their first use.

use super::Geometry;
use crate::correspondence::Correspondence;
use crate::error::Result;
use crate::memory::rule_of;
use sgs_passes::pipeline::{DensifyStep, OpacityReset};

impl Geometry {
    /// Builds every graph that training may use, to plan or compile all of them: steps without and with pseudo-views,
    /// densification, and the reset of opacities.
    ///
    /// # Errors
    /// If memory runs out.
    pub fn build_graphs(&mut self) -> Result<()> {
        let current = self.options.pseudo;
        if let Some(masks) = self.correspondence.as_ref().map(Correspondence::masks) {
            self.options.pseudo = Some(masks);
            self.rebuild()?;
        }
        self.options.pseudo = current;
        self.rebuild()?;
        if self.settings.geometry.densify.enabled() {
            DensifyStep::new(&self.device, &self.tuning, &self.gaussians, rule_of(&self.options), None)?;
            OpacityReset::new(&self.device, &self.tuning, &self.gaussians)?;
        }
        Ok(())
    }
}
