//! Training loop of the intrinsic stage.

use super::consistency::StepKind;
use super::graphs::{gone, images};
use super::{Intrinsic, POLL_INTERVAL};
use crate::error::Result;
use sgs_passes::pipeline::IntrinsicReport;

impl Intrinsic {
    /// Trains until `last` steps are finished or `go_on` returns false.
    /// Returns with no work in flight.
    ///
    /// # Errors
    /// If the device fails or training diverges.
    pub fn train(
        &mut self,
        last: u32,
        mut on_report: impl FnMut(&IntrinsicReport),
        mut go_on: impl FnMut() -> bool,
    ) -> Result<()> {
        let mut last_ticket = None;
        while self.submitted < last && go_on() {
            let step = self.submitted + 1;
            let view = self.schedule.view(step);
            let mut kind = self.kind(step);
            let mut values = self.values(step, view);
            if kind != StepKind::Plain && !self.choose(kind, view, &mut values)? {
                kind = StepKind::Plain;
            }
            let pseudo = kind == StepKind::CrossView;
            self.make(kind)?;
            let Some(exec) = &mut self.execs[kind as usize] else { return Err(gone()) };
            if self.data.parts.len() > 1 {
                let part = self.data.part_of[view];
                exec.use_images(&images(&self.data, &self.priors, self.relit.as_ref(), kind, part))?;
            }
            let camera = &self.data.views[view].0;
            let ticket = self.surfaces.with(&self.gaussians, camera, view, pseudo, exec, &values)?;
            let before = last_ticket.replace(ticket);
            self.submitted = step;
            self.move_environment(step)?;
            if self.remembers(step) {
                self.finish()?;
                self.remember(step)?;
            }
            if self.decides_after(step) {
                self.finish()?;
                self.poll(step, &mut on_report)?;
                self.decide(step)?;
            } else if let (Some(ticket), true) = (before, step.is_multiple_of(POLL_INTERVAL)) {
                // The device works on the last step meanwhile.
                self.device.wait(ticket, "the step before the last")?;
                self.poll(step - 1, &mut on_report)?;
            }
        }
        self.finish()?;
        self.poll(self.submitted, &mut on_report)
    }
}
