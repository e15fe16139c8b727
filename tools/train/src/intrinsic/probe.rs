//! Probe of a single step: its shaded image and its gradients.
//! Serves to measure the cost of a choice.

use super::Intrinsic;
use super::consistency::StepKind;
use super::graphs::images;
use crate::error::Result;
use sgs_passes::pipeline::{Camera, IntrinsicOptions, IntrinsicStep};

/// Results of a probed step.
#[derive(Clone, Debug, Default)]
pub struct Probe {
    /// Camera of the step's training view.
    pub camera: Camera,
    /// Shaded image, display-referred, three floats per pixel, row by row.
    pub image: Vec<f32>,
    /// Names and gradients of the trained parameters.
    /// Parameters that are not updated in every step are omitted.
    pub gradients: Vec<(&'static str, Vec<f32>)>,
}

/// Returns the gradients: ten times the first moments after one step from zero.
fn first(moments: &[f32]) -> Vec<f32> {
    moments.chunks_exact(2).map(|m| 10.0 * m[0]).collect()
}

impl Intrinsic {
    /// Runs the next step without cross-view comparisons, and undoes it.
    /// Afterwards the state is as before.
    ///
    /// # Errors
    /// If the device fails or memory runs out.
    pub fn probe(&mut self) -> Result<Probe> {
        self.finish()?;
        let step = self.submitted + 1;
        let (view, values) = (self.schedule.view(step), self.values(step, self.schedule.view(step)));
        let mut before = Vec::new();
        for p in self.parameters.all() {
            let (parameters, moments) = (p.download(&self.device)?, p.download_moments(&self.device)?);
            p.upload(&self.device, &parameters)?;
            before.push((parameters, moments));
        }
        let mut field = None;
        if let Some(f) = &self.parameters.visibility {
            let (values, moments) = (f.download(&self.device)?, f.download_moments(&self.device)?);
            let none = moments.each_ref().map(|m| vec![0.0; m.len()]);
            f.upload_moments(&self.device, [&none[0], &none[1]])?;
            field = Some((values, moments));
        }
        let gains: Vec<f32> = self.device.download_as(&self.gains, self.light_model.lights as usize)?;
        let gathered = self.environment_updates.as_ref().map(|s| s.stored().download(&self.device)).transpose()?;

        let options = IntrinsicOptions { image: true, ..StepKind::Plain.options(&self.options) };
        let (part, mut inputs) = (self.data.part_of[view], self.inputs(StepKind::Plain));
        inputs.images = images(&self.data, &self.priors, None, StepKind::Plain, part);
        let mut exec = IntrinsicStep::new(&self.device, &self.tuning, &inputs, &self.status, options)?;
        let camera = self.data.views[view].0;
        self.surfaces.with(&self.gaussians, &camera, view, false, &mut exec, &values)?;
        let mut image = exec.image(&self.device)?;
        image.truncate(3 * camera.size[0] as usize * camera.size[1] as usize);
        let mut gradients = Vec::new();
        for p in self.parameters.all() {
            gradients.push((p.name(), first(&p.download_moments(&self.device)?)));
        }
        gradients.retain(|(name, _)| *name != "environment" || self.environment_updates.is_none());
        if let Some(f) = &self.parameters.visibility {
            let [tables, mlp] = f.download_moments(&self.device)?;
            gradients.extend([("visibility_tables", first(&tables)), ("visibility_mlp", first(&mlp))]);
        }

        for (p, (parameters, moments)) in self.parameters.all().into_iter().zip(&before) {
            p.upload(&self.device, parameters)?;
            p.upload_moments(&self.device, moments)?;
        }
        if let (Some(f), Some(([tables, mlp], moments))) = (&self.parameters.visibility, &field) {
            f.upload(&self.device, tables, mlp)?;
            f.upload_moments(&self.device, [&moments[0], &moments[1]])?;
        }
        self.device.upload(&self.gains, 0, bytemuck::cast_slice(&gains))?;
        if let (Some(s), Some(gathered)) = (&self.environment_updates, &gathered) {
            s.stored().upload(&self.device, gathered)?;
        }
        Ok(Probe { camera, image, gradients })
    }
}
