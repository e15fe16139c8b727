//! Queries of an intrinsic stage: its model, its memory and the times of its passes.

use super::consistency::{AlbedoComparisons, StepKind};
use super::graphs::gone;
use super::{Intrinsic, IntrinsicNeeds, LoggedLosses};
use crate::error::Result;
use crate::idle::{IdleLoss, PriorKinds};
use sgs_config::IntrinsicSettings;
use sgs_engine::DeviceBuffer;
use sgs_engine::exec::{HostTimes, PassTime};
use sgs_passes::cost::{Cost, Counts, of_plan};
use sgs_passes::pipeline::{Camera, IntrinsicOptions, IntrinsicStep};

impl Intrinsic {
    /// Returns the estimated device memory of training.
    pub fn needs(&self) -> &IntrinsicNeeds {
        &self.needs
    }

    /// Returns the stage's settings after automatic model selection.
    pub fn required(&self) -> &IntrinsicSettings {
        &self.required.intrinsic
    }

    /// Returns the options of the model.
    pub fn options(&self) -> &IntrinsicOptions {
        &self.options
    }

    /// Returns the texels per edge of the environment map, if there is one.
    pub fn environment_size(&self) -> Option<u32> {
        self.environment.as_ref().map(|(e, _)| e.size())
    }

    /// Returns the materials of which priors exist.
    pub fn priors(&self) -> PriorKinds {
        let p = &self.priors;
        PriorKinds { albedo: p.albedo.is_some(), roughness: p.roughness.is_some(), metallic: p.metallic.is_some() }
    }

    /// Returns the losses that have a weight and cannot run.
    pub fn idle_losses(&self) -> &[IdleLoss] {
        &self.idle
    }

    /// Returns the losses that steps currently log.
    pub fn logged_losses(&self) -> LoggedLosses {
        let (s, o) = (&self.required.intrinsic, &self.options);
        let PriorKinds { albedo, roughness, metallic } = self.priors();
        let l = &s.losses;
        LoggedLosses {
            albedo,
            roughness,
            metallic: metallic && o.metallic,
            albedo_gradients: albedo && o.gradients,
            roughness_gradients: albedo && roughness && o.gradients,
            albedo_smooth: l.albedo_smooth > 0.0,
            roughness_smooth: l.roughness_smooth > 0.0,
            environment_smooth: self.environment.is_some() && l.environment_smooth > 0.0,
            light_position: o.lights.is_some() && l.light_position > 0.0,
            light_value: o.lights.is_some() && l.light_value > 0.0,
            visibility_jitter: if self.parameters.visibility.is_some() { l.visibility_jitter } else { 0.0 },
        }
    }

    /// Returns whether the surfaces of all training views are stored.
    pub fn keeps_surfaces(&self) -> bool {
        self.surfaces.are_stored()
    }

    /// Returns the comparisons of albedo that any step makes.
    pub fn comparisons(&self) -> AlbedoComparisons {
        let due = |kind| (1..=self.required.intrinsic.steps).any(|step| self.kind(step) == kind);
        AlbedoComparisons { cross_view: due(StepKind::CrossView), relight: due(StepKind::Relight) }
    }

    /// Returns the ring of the steps' reports, for drivers that run no kernels.
    pub fn reports(&self) -> &DeviceBuffer {
        self.status.reports()
    }

    /// Returns the host time of the steps of all kinds since their graphs were built.
    pub fn host_times(&self) -> HostTimes {
        let of_steps = self.execs.iter().flatten().map(|step| step.host_times());
        of_steps.fold(HostTimes::default(), |sum, times| sum + times)
    }

    /// Turns timestamps of passes on or off.
    ///
    /// # Errors
    /// If the device fails.
    pub fn set_timestamps(&mut self, on: bool) -> Result<()> {
        if self.options.timestamps != on {
            self.finish()?;
            self.options.timestamps = on;
            self.execs = [None, None, None];
        }
        Ok(())
    }

    /// Takes the times of the passes of plain steps since the last call.
    pub fn take_times(&mut self) -> Vec<PassTime> {
        self.execs[0].as_mut().map(|e| e.executor().take_times()).unwrap_or_default()
    }

    /// Returns the counts that determine the cost of a plain step.
    /// Pixels and blending weights are means over views. Lights are those that are on.
    ///
    /// # Errors
    /// If memory runs out.
    pub fn counts(&self) -> Result<Counts> {
        let on = match &self.options.lights {
            Some((model, _)) => {
                let gains: Vec<f32> = self.device.download_as(&self.gains, model.lights as usize)?;
                gains.iter().filter(|g| **g != 0.0).count()
            }
            None => 0,
        };
        let pixels = |c: &Camera| f64::from(c.size[0]) * f64::from(c.size[1]);
        let views = &self.data.views;
        Ok(Counts {
            gaussians: self.splats.len() as f64,
            pixels: views.iter().map(|v| pixels(&v.0)).sum::<f64>() / views.len().max(1) as f64,
            lights: on as f64,
            weights: self.surface_weights()?,
            ..Counts::default()
        })
    }

    /// Returns the operations and memory traffic of a plain step.
    /// Also returns the number of passes of unknown cost.
    ///
    /// # Errors
    /// If memory runs out.
    pub fn step_cost(&mut self) -> Result<(Cost, usize)> {
        let counts = self.counts()?;
        let plan = self.executor()?.executor().plan().clone();
        Ok(of_plan(&plan, &counts))
    }

    /// Returns a plain step, for its plan.
    ///
    /// # Errors
    /// If memory runs out.
    pub fn executor(&mut self) -> Result<&mut IntrinsicStep> {
        self.make(StepKind::Plain)?;
        self.execs[0].as_mut().ok_or_else(gone)
    }
}
