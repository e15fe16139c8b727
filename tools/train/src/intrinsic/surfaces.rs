//! What training views see of the geometry: kept for all of them where that fits, else worked out anew before each step.

use crate::data::TrainingData;
use crate::error::Result;
use crate::memory::allowed;
use crate::settings::Settings;
use sgs_engine::Device;
use sgs_passes::Tuning;
use sgs_passes::pipeline::{Camera, IntrinsicStep, IntrinsicStepValues, Surface, SurfaceBuilder, SurfaceShape};
use sgs_passes::scene::Gaussians;

/// The surfaces of the training views.
pub(super) struct Surfaces {
    builder: SurfaceBuilder,
    /// By training view; only one where they are worked out anew.
    kept: Vec<Surface>,
    all: bool,
}

impl Surfaces {
    /// Measures all views and keeps what fits.
    pub fn new(
        device: &Device,
        tuning: Tuning,
        gaussians: &Gaussians,
        data: &TrainingData,
        settings: &Settings,
    ) -> Result<Surfaces> {
        let mut builder = SurfaceBuilder::new(device, tuning, gaussians, data.largest)?;
        let mut most = 1;
        for (camera, _) in &data.views {
            builder.measure(gaussians, camera)?;
            most = most.max(builder.wanted()?);
        }
        // The room that the fullest view needs, for all: a step is made for one size.
        builder.fit(gaussians, most)?;
        let shape = builder.shape();
        let wanted = shape.bytes() * data.views.len() as u64;
        let limit = match settings.intrinsic.surface_bytes {
            // Half of what is left: the step needs the rest.
            0 => {
                let b = allowed(device, settings);
                b.budget.saturating_sub(b.used) / 2
            }
            bytes => bytes,
        };
        let all = wanted <= limit;
        if !all {
            tracing::info!("what views see of the geometry takes {wanted} bytes: it is worked out anew in each step");
        }
        let mut kept = Vec::new();
        for (camera, _) in data.views.iter().take(if all { data.views.len() } else { 1 }) {
            let surface = Surface::new(device, shape)?;
            builder.fill(gaussians, camera, &surface)?;
            builder.finish()?;
            kept.push(surface);
        }
        Ok(Surfaces { builder, kept, all })
    }

    pub fn shape(&self) -> SurfaceShape {
        self.builder.shape()
    }

    /// Submits a step on a view.
    pub fn with(
        &mut self,
        gaussians: &Gaussians,
        camera: &Camera,
        view: usize,
        exec: &mut IntrinsicStep,
        values: &IntrinsicStepValues,
    ) -> Result<()> {
        if self.all {
            exec.submit(&self.kept[view], values)?;
            return Ok(());
        }
        // The only room there is: the step before must have read it, and it must be full before the next one does.
        exec.finish()?;
        self.builder.fill(gaussians, camera, &self.kept[0])?;
        self.builder.finish()?;
        exec.submit(&self.kept[0], values)?;
        Ok(())
    }
}
