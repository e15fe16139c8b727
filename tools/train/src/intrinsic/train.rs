//! Training loop of the intrinsic stage.

use super::consistency::StepKind;
use super::graphs::gone;
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
        while self.submitted < last && go_on() {
            let step = self.submitted + 1;
            let view = self.schedule.view(step);
            let mut kind = self.kind(step);
            let mut values = self.values(step, view);
            if kind != StepKind::Plain && !self.choose(kind, view, &mut values)? {
                kind = StepKind::Plain;
            }
            let pseudo = kind == StepKind::CrossView;
            // Graphs order their own replays, but not those of other graphs.
            let another = step > 1 && self.kind(step - 1) != kind;
            if another || self.surfaces.waits(pseudo) {
                self.finish()?;
            }
            self.make(kind)?;
            let Some(exec) = &mut self.execs[kind as usize] else { return Err(gone()) };
            self.surfaces.with(&self.gaussians, &self.data.views[view].0, view, pseudo, exec, &values)?;
            self.submitted = step;
            self.move_environment(step)?;
            if self.remembers(step) {
                self.finish()?;
                self.remember(step)?;
            }
            // Each graph has its own replays in flight: only steps before a wait for all graphs are surely done.
            let decides = self.decides_after(step);
            if step.is_multiple_of(POLL_INTERVAL) || decides {
                self.finish()?;
                self.poll(step, &mut on_report)?;
            }
            if decides {
                self.decide(step)?;
            }
        }
        self.finish()?;
        self.poll(self.submitted, &mut on_report)
    }
}
