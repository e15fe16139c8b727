//! A single step, taken apart: the picture that it shades and the gradients that it finds, for whoever measures what a choice
//! costs.

use super::Intrinsic;
use super::consistency::StepKind;
use crate::error::Result;
use sgs_passes::pipeline::{Camera, IntrinsicOptions, IntrinsicStep};

/// What a step shades and finds.
#[derive(Clone, Debug, Default)]
pub struct Probe {
    /// The camera of its training view.
    pub camera: Camera,
    /// The shaded picture, display-referred, three floats a pixel, row by row.
    pub picture: Vec<f32>,
    /// Names of what is learned, and gradients. What does not move with every step has none.
    pub gradients: Vec<(&'static str, Vec<f32>)>,
}

/// First moments after one step from none, which are a tenth of the gradient.
fn first(moments: &[f32]) -> Vec<f32> {
    moments.chunks_exact(2).map(|m| 10.0 * m[0]).collect()
}

impl Intrinsic {
    /// Takes the next step, one that compares nothing with other views, and takes it back: afterwards everything is as before.
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
        let gathered = self.seldom.as_ref().map(|s| s.kept().download(&self.device)).transpose()?;

        let options = IntrinsicOptions { picture: true, ..StepKind::Plain.options(&self.options) };
        let inputs = self.inputs(StepKind::Plain);
        let mut exec = IntrinsicStep::new(&self.device, &self.tuning, &inputs, &self.status, options)?;
        let camera = self.data.views[view].0;
        self.surfaces.with(&self.gaussians, &camera, view, false, &mut exec, &values)?;
        let mut picture = exec.picture(&self.device)?;
        picture.truncate(3 * camera.size[0] as usize * camera.size[1] as usize);
        let mut gradients = Vec::new();
        for p in self.parameters.all() {
            gradients.push((p.name(), first(&p.download_moments(&self.device)?)));
        }
        gradients.retain(|(name, _)| *name != "environment" || self.seldom.is_none());
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
        if let (Some(s), Some(gathered)) = (&self.seldom, &gathered) {
            s.kept().upload(&self.device, gathered)?;
        }
        Ok(Probe { camera, picture, gradients })
    }
}
