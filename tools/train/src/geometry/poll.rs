//! Evaluation of step reports: overflows, losses and divergence. Reports are read some steps later.

use super::{Geometry, Progress};
use crate::divergence::{Group, RollBack, Seen, diverged};
use crate::error::{Result, TrainError};
use sgs_config::OnDivergence;
use sgs_passes::pipeline::StepReport;
use sgs_passes::scene::Group as Parameters;

impl Geometry {
    /// Returns the rollbacks of this training.
    pub fn roll_backs(&self) -> &[RollBack] {
        &self.roll_backs
    }

    /// Records that this state replaces that of a later step. Halves the learning rates from here on. `before`: earlier
    /// rollbacks.
    pub fn roll_back(&mut self, before: &[RollBack], step: u32) {
        self.roll_backs = RollBack::appended(before, step, self.done);
        self.schedule.set_rates(RollBack::rates_after(self.roll_backs.len()));
    }

    /// Evaluates the reports up to a finished step. Returns false if an overflow discarded steps.
    pub(super) fn poll(&mut self, until: u32, on_report: &mut impl FnMut(&Progress)) -> Result<bool> {
        while self.done < until {
            let step = self.done + 1;
            let report = self.status.report(step)?;
            if report.step != step {
                return Err(TrainError::diverged(step, "the device did not report the step"));
            }
            if report.flags != 0 {
                self.grow_entries(step, on_report)?;
                return Ok(false);
            }
            if !report.losses.total.is_finite() {
                let reason = format!("the loss is {} with {} Gaussians visible", report.losses.total, report.visible);
                return Err(self.diverged(step, &reason)?);
            }
            self.done = step;
            self.growth.entries = self.growth.entries.max(report.entries);
            on_report(&Progress::Step(report));
            if let Some(reason) = self.judge(&report) {
                return Err(self.diverged(step, &reason)?);
            }
        }
        Ok(true)
    }

    /// Waits for all submitted steps and evaluates their reports. Returns false if an overflow discarded steps.
    pub(super) fn drain(&mut self, on_report: &mut impl FnMut(&Progress)) -> Result<bool> {
        self.exec()?.finish()?;
        self.poll(self.submitted, on_report)
    }

    /// Raises the entry capacity after an overflow and returns to that step. No parameter has changed since the step
    /// before it.
    fn grow_entries(&mut self, step: u32, on_report: &mut impl FnMut(&Progress)) -> Result<()> {
        self.exec()?.finish()?;
        let mut wanted = 0;
        for s in step..=self.submitted {
            wanted = wanted.max(self.status.report(s)?.entries);
        }
        let room = u64::from(wanted) + u64::from(wanted) / 8;
        self.options.entry_capacity = u32::try_from(room).unwrap_or(u32::MAX);
        if self.promised {
            // The entries of later steps depend on how many steps are in flight.
            let wanted = self.status.report(step)?.entries;
            self.squeeze(step, wanted, on_report)?;
        }
        tracing::debug!(step, wanted, capacity = self.options.entry_capacity, "tile entries grow");
        self.rebuild()?;
        self.status.clear_flags(&self.device)?;
        self.submitted = step - 1;
        Ok(())
    }

    /// Returns a description of the divergence if a finished step shows it.
    fn judge(&mut self, report: &StepReport) -> Option<String> {
        if self.settings.train.on_divergence == OnDivergence::GoOn {
            return None;
        }
        let l = &self.settings.geometry.losses;
        let image = l.l1 * report.losses.l1 + l.dssim * (1.0 - report.losses.ssim);
        self.watch.see(&Seen {
            step: report.step,
            view: self.view(report.step),
            loss: if l.l1 + l.dssim > 0.0 { image } else { report.losses.l1 },
            l1: report.losses.l1,
            skipped: report.skipped,
            of: report.visible,
            rates: self.schedule.roughness(),
        })
    }

    /// Returns the error of a diverged training. Names the parameter that is farthest out.
    fn diverged(&mut self, step: u32, reason: &str) -> Result<TrainError> {
        self.exec()?.finish()?;
        let data = self.gaussians.download(&self.device)?;
        let extent = self.schedule.extent() as f32;
        let decoder = match &self.semantics {
            Some((_, decoder)) => decoder.download(&self.device)?,
            None => Vec::new(),
        };
        let gaussian = |g: Parameters| {
            // Generous ranges of the parameters of a trained scene.
            let (middle, reach) = match g {
                Parameters::Means => (None, 2.0 * extent),
                Parameters::LogScales => (Some((0.01 * extent).ln()), 6.0),
                Parameters::OpacityLogits => (Some(0.0), 12.0),
                Parameters::Rotations => (Some(0.0), 2.0),
                Parameters::Sh0 => (Some(0.0), 3.0),
                Parameters::Sh1 | Parameters::Sh2 | Parameters::Sh3 => (Some(0.0), 1.0),
                // Normals have any length, and features any unit.
                Parameters::Normals | Parameters::Semantics => (Some(0.0), 50.0),
            };
            let pass = if g == Parameters::Semantics { "features_bwd_adam" } else { "project_bwd_adam" };
            Group {
                name: g.name(),
                pass,
                values: data.group(g),
                width: g.width() as usize,
                element: "splat",
                middle,
                reach,
            }
        };
        let mut groups: Vec<Group<'_>> = self.gaussians.model.groups().map(gaussian).collect();
        groups.push(Group {
            name: "decoder",
            pass: "adam.decoder",
            values: &decoder,
            width: 1,
            element: "weight",
            middle: Some(0.0),
            reach: 2.0,
        });
        Ok(diverged(step, reason, &groups))
    }
}
