//! What views see of the geometry: kept for all training views where that fits, else worked out anew before each step, as it
//! always is for pseudo-views.

use super::Intrinsic;
use crate::data::TrainingData;
use crate::error::Result;
use sgs_engine::Device;
use sgs_passes::Tuning;
use sgs_passes::pipeline::{
    Camera, IntrinsicStep, IntrinsicStepValues, PSEUDO_VIEWS, Surface, SurfaceBuilder, SurfaceShape,
};
use sgs_passes::scene::Gaussians;

/// The surfaces of the training views.
pub(super) struct Surfaces {
    builder: SurfaceBuilder,
    /// By training view; only one where they are worked out anew.
    kept: Vec<Surface>,
    all: bool,
    /// Room for pseudo-views.
    others: Vec<Surface>,
}

impl Surfaces {
    /// Measures all views, `others` among them that are only seen now and then.
    pub fn measure(
        device: &Device,
        tuning: Tuning,
        gaussians: &Gaussians,
        views: &[(Camera, u32)],
        largest: [u32; 2],
        others: &[Camera],
    ) -> Result<SurfaceBuilder> {
        let mut builder = SurfaceBuilder::new(device, tuning, gaussians, largest)?;
        let mut most = 1;
        for camera in views.iter().map(|v| &v.0).chain(others) {
            builder.measure(gaussians, camera)?;
            most = most.max(builder.wanted()?);
        }
        // The room that the fullest view needs, for all: a step is made for one size.
        builder.fit(gaussians, most)?;
        Ok(builder)
    }

    /// Keeps the surfaces of all training views, or room for one.
    pub fn new(
        device: &Device,
        mut builder: SurfaceBuilder,
        gaussians: &Gaussians,
        data: &TrainingData,
        all: bool,
        others: &[Camera],
    ) -> Result<Surfaces> {
        let shape = builder.shape();
        let mut kept = Vec::new();
        for (camera, _) in data.views.iter().take(if all { data.views.len() } else { 1 }) {
            let surface = Surface::new(device, shape)?;
            builder.fill(gaussians, camera, &surface)?;
            builder.finish()?;
            kept.push(surface);
        }
        let room = if others.is_empty() { 0 } else { PSEUDO_VIEWS };
        let others = (0..room).map(|_| Surface::new(device, shape)).collect::<sgs_engine::Result<_>>()?;
        Ok(Surfaces { builder, kept, all, others })
    }

    pub fn shape(&self) -> SurfaceShape {
        self.builder.shape()
    }

    /// The surfaces of a training view; not before the next call where they are worked out anew.
    pub fn kept(&mut self, gaussians: &Gaussians, camera: &Camera, view: usize) -> Result<&Surface> {
        if self.all {
            return Ok(&self.kept[view]);
        }
        self.builder.fill(gaussians, camera, &self.kept[0])?;
        self.builder.finish()?;
        Ok(&self.kept[0])
    }

    /// The surfaces of a pseudo-view, the first or the second of a step; not before the next call.
    pub fn other(&mut self, gaussians: &Gaussians, camera: &Camera, which: usize) -> Result<&Surface> {
        self.builder.fill(gaussians, camera, &self.others[which])?;
        self.builder.finish()?;
        Ok(&self.others[which])
    }

    /// Bytes of all that is kept.
    pub fn bytes(&self) -> u64 {
        self.shape().bytes() * (self.kept.len() + self.others.len()) as u64
    }

    /// Entries of the matrices that are kept, their mean.
    pub fn weights(&self, device: &Device) -> Result<f64> {
        let mut sum = 0;
        for surface in &self.kept {
            sum += surface.weights(device)?.weights.len();
        }
        Ok(sum as f64 / self.kept.len().max(1) as f64)
    }

    /// Whether nothing may be in flight when a step is submitted.
    pub fn waits(&self, pseudo: bool) -> bool {
        pseudo || !self.all
    }

    /// Submits a step on a view, with pseudo-views if it compares some. Where it has to wait ([`Surfaces::waits`]) what was
    /// submitted before must be done: there is one room for what is worked out anew.
    pub fn with(
        &mut self,
        gaussians: &Gaussians,
        camera: &Camera,
        view: usize,
        pseudo: bool,
        exec: &mut IntrinsicStep,
        values: &IntrinsicStepValues,
    ) -> Result<()> {
        let mut fill = |camera: &Camera, into: &Surface| -> Result<()> {
            self.builder.fill(gaussians, camera, into)?;
            Ok(self.builder.finish()?)
        };
        let mine = if self.all { &self.kept[view] } else { &self.kept[0] };
        if !self.all {
            fill(camera, mine)?;
        }
        let others = if pseudo { &self.others[..] } else { &[] };
        for (surface, step) in others.iter().zip(&values.pseudo) {
            fill(&step.camera, surface)?;
        }
        exec.submit(mine, others, values)?;
        Ok(())
    }
}

impl Intrinsic {
    /// Bytes of what is kept of what views see of the geometry.
    pub fn surface_bytes(&self) -> u64 {
        self.surfaces.bytes()
    }

    /// Entries of the sparse matrices that blend materials, mean over the views of which they are kept.
    ///
    /// # Errors
    /// If the device is lost.
    pub fn surface_weights(&self) -> Result<f64> {
        self.surfaces.weights(&self.device)
    }
}
