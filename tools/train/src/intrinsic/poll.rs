//! Evaluation of the steps' delayed reports: losses and divergence.

use super::Intrinsic;
use crate::divergence::{Group, RollBack, Seen, diverged};
use crate::error::{Result, TrainError};
use sgs_config::{IntrinsicRates, OnDivergence};
use sgs_passes::pipeline::IntrinsicReport;

impl Intrinsic {
    /// Returns the rollbacks to the last good state.
    pub fn roll_backs(&self) -> &[RollBack] {
        &self.roll_backs
    }

    /// Records that this restored state replaces a state that diverged at `step`.
    /// Halves the learning rates. `before`: earlier rollbacks.
    pub fn roll_back(&mut self, before: &[RollBack], step: u32) {
        self.roll_backs = RollBack::appended(before, step, self.done);
        self.set_rates(RollBack::rates_after(self.roll_backs.len()));
    }

    /// Sets the factor on all learning rates; a power of two.
    pub(super) fn set_rates(&mut self, factor: f64) {
        let ratio = (factor / self.schedule.rates()) as f32;
        self.schedule.set_rates(factor);
        let r = &mut self.options.rates;
        for rate in [
            &mut r.albedo,
            &mut r.roughness,
            &mut r.metallic,
            &mut r.light_positions,
            &mut r.lights,
            &mut r.environment,
            &mut r.visibility,
            &mut r.normals,
        ] {
            *rate *= ratio;
        }
        if let Some(transport) = &mut self.options.transport {
            transport.gains_rate *= ratio;
            transport.rate *= ratio;
        }
        // The graphs contain the rates.
        self.forget_steps();
        self.forget_refresh();
    }

    /// Evaluates the reports up to a step that is known to be finished.
    pub(super) fn poll(&mut self, until: u32, on_report: &mut impl FnMut(&IntrinsicReport)) -> Result<()> {
        while self.done < until {
            let step = self.done + 1;
            let mut report = self.status.report(step)?;
            if report.step != step {
                return Err(TrainError::diverged(step, "the device did not report the step"));
            }
            let losses = [report.shaded, report.albedo, report.roughness, report.metallic];
            if losses.iter().any(|l| !l.is_finite()) {
                return Err(self.diverged(step, &format!("the losses are {losses:?}"))?);
            }
            let m = &report.materials;
            let seen = [(m.cross_pairs, m.cross_view), (m.relight_count, m.relight), (m.own_count, m.own_prior)];
            for (recent, (count, value)) in self.recent.iter_mut().zip(seen) {
                if count > 0 {
                    *recent = value;
                }
            }
            [report.recent_cross_view, report.recent_relight, report.recent_own_prior] = self.recent;
            self.done = step;
            on_report(&report);
            if let Some(reason) = self.judge(&report) {
                return Err(self.diverged(step, &reason)?);
            }
        }
        Ok(())
    }

    /// Returns the reason if a finished step shows that training has diverged.
    fn judge(&mut self, report: &IntrinsicReport) -> Option<String> {
        if self.required.train.on_divergence == OnDivergence::GoOn {
            return None;
        }
        let l = &self.required.intrinsic.losses;
        self.watch.see(&Seen {
            step: report.step,
            view: self.schedule.view(report.step),
            loss: if l.l1 + l.dssim > 0.0 { report.shaded } else { report.shaded_l1 },
            l1: report.shaded_l1,
            skipped: report.skipped,
            of: 0,
            rates: self.roughness(),
        })
    }

    /// Returns the largest ratio of a learning rate to its default.
    fn roughness(&self) -> f64 {
        let (r, d) = (&self.options.rates, IntrinsicRates::default());
        let times = [
            r.albedo / d.materials,
            r.roughness / d.materials,
            r.metallic / d.materials,
            r.lights / d.lights,
            r.environment / d.environment,
            r.visibility / d.visibility,
        ];
        f64::from(times.into_iter().fold(0.0, f32::max))
    }

    /// Makes the error of a diverged training, with the most extreme parameter.
    /// This parameter is the farthest outside its expected range.
    fn diverged(&mut self, step: u32, reason: &str) -> Result<TrainError> {
        self.finish()?;
        // Generous ranges of the parameters of a trained scene.
        let side = (0..3).map(|i| self.bounds[1][i] - self.bounds[0][i]).fold(0.0, f32::max);
        let mut values = Vec::new();
        for p in self.parameters.all() {
            let (width, element, reach, pass) = match p.name() {
                "albedo" => (3, "splat", 12.0, "adam.albedo"),
                "roughness" => (1, "splat", 12.0, "adam.roughness"),
                "metallic" => (1, "splat", 12.0, "adam.metallic"),
                "gaussian_normals" => (3, "splat", 50.0, "adam.gaussian_normals"),
                "light_positions" => (3, "light", side, "adam.light_positions"),
                "light_lobes" => (self.light_model.row() as usize, "lobe", 20.0, "adam.light_lobes"),
                "environment" => (3, "texel", 100.0, "adam.environment"),
                _ => (1, "number", 10.0, "adam"),
            };
            let middle = (p.name() != "light_positions").then_some(0.0);
            values.push((p.name(), pass, width, element, middle, reach, p.download(&self.device)?));
        }
        if let Some(field) = &self.parameters.visibility {
            let [tables, mlp] = field.download(&self.device)?;
            values.push(("visibility_tables", "visibility_adam", 2, "entry", Some(0.0), 5.0, tables));
            values.push(("visibility_mlp", "visibility_adam_layers", 1, "weight", Some(0.0), 10.0, mlp));
        }
        let groups: Vec<Group<'_>> = values
            .iter()
            .map(|(name, pass, width, element, middle, reach, values)| Group {
                name,
                pass,
                values,
                width: *width,
                element,
                middle: *middle,
                reach: *reach,
            })
            .collect();
        Ok(diverged(step, reason, &groups))
    }
}
