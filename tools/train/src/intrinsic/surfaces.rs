//! Surfaces: the geometry that each view sees, with its blending weights.
//!
//! Surfaces of all training views are stored if they fit into memory. Otherwise each step recomputes the surface of its
//! view, as it always does for pseudo-views.

use super::Intrinsic;
use crate::data::TrainingData;
use crate::error::Result;
use sgs_engine::{Device, Ticket};
use sgs_passes::Tuning;
use sgs_passes::pipeline::{
    Camera, IntrinsicStep, IntrinsicStepValues, PSEUDO_VIEWS, Surface, SurfaceBuilder, SurfaceShape,
};
use sgs_passes::scene::Gaussians;
use sgs_transport::{TrainingRoom, ViewLightBuffers};

/// Surfaces of the training views.
pub(super) struct Surfaces {
    builder: SurfaceBuilder,
    /// Surfaces by training view; only one if each step recomputes it.
    stored: Vec<Surface>,
    all: bool,
    /// Memory for the surfaces of pseudo-views.
    others: Vec<Surface>,
    /// Light of the training views in a room, stored like the surfaces.
    lights: Option<ViewLightBuffers>,
}

impl Surfaces {
    /// Measures all views, including the occasional views in `others`.
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
        // All surfaces get the capacity of the fullest view: a step is compiled for one size.
        builder.fit(gaussians, most)?;
        Ok(builder)
    }

    /// Stores the surfaces of all training views, or allocates one.
    pub fn new(
        device: &Device,
        mut builder: SurfaceBuilder,
        gaussians: &Gaussians,
        data: &TrainingData,
        all: bool,
        others: &[Camera],
    ) -> Result<Surfaces> {
        let shape = builder.shape();
        let mut stored = Vec::new();
        for (camera, _) in data.views.iter().take(if all { data.views.len() } else { 1 }) {
            let surface = Surface::new(device, shape)?;
            builder.fill(gaussians, camera, &surface)?;
            builder.finish()?;
            stored.push(surface);
        }
        let room = if others.is_empty() { 0 } else { PSEUDO_VIEWS };
        let others = (0..room).map(|_| Surface::new(device, shape)).collect::<sgs_engine::Result<_>>()?;
        Ok(Surfaces { builder, stored, all, others, lights: None })
    }

    /// Computes and stores the light of all training views, or allocates one.
    pub fn light(&mut self, device: &Device, room: &TrainingRoom, data: &TrainingData) -> Result<()> {
        let mut lights = ViewLightBuffers::new(room, device, &self.shape(), self.stored.len())?;
        if self.all {
            for (i, (camera, _)) in data.views.iter().enumerate() {
                lights.fill(&self.stored[i], camera, i)?;
            }
            lights.finish()?;
        }
        self.lights = Some(lights);
        Ok(())
    }

    pub fn shape(&self) -> SurfaceShape {
        self.builder.shape()
    }

    /// Returns the surface of a training view.
    /// A recomputed surface is valid until the next call.
    pub fn of_view(&mut self, gaussians: &Gaussians, camera: &Camera, view: usize) -> Result<&Surface> {
        if self.all {
            return Ok(&self.stored[view]);
        }
        self.builder.fill(gaussians, camera, &self.stored[0])?;
        self.builder.finish()?;
        Ok(&self.stored[0])
    }

    /// Returns the surface of the first or second pseudo-view of a step.
    /// The surface is valid until the next call.
    pub fn other(&mut self, gaussians: &Gaussians, camera: &Camera, which: usize) -> Result<&Surface> {
        self.builder.fill(gaussians, camera, &self.others[which])?;
        self.builder.finish()?;
        Ok(&self.others[which])
    }

    /// Returns the number of bytes of all stored surfaces.
    pub fn bytes(&self) -> u64 {
        self.shape().bytes() * (self.stored.len() + self.others.len()) as u64
    }

    /// Returns the mean number of entries of the stored matrices.
    pub fn weights(&self, device: &Device) -> Result<f64> {
        let mut sum = 0;
        for surface in &self.stored {
            sum += surface.weights(device)?.weights.len();
        }
        Ok(sum as f64 / self.stored.len().max(1) as f64)
    }

    /// Returns whether the surfaces of all training views are stored.
    pub fn are_stored(&self) -> bool {
        self.all
    }

    /// Submits a step on a view, with pseudo-views if it compares some. Waits for nothing but the steps long before.
    pub fn with(
        &mut self,
        gaussians: &Gaussians,
        camera: &Camera,
        view: usize,
        pseudo: bool,
        exec: &mut IntrinsicStep,
        values: &IntrinsicStepValues,
    ) -> Result<Ticket> {
        // All graphs share one queue, on which each replay waits for all before it.
        let mut fill =
            |camera: &Camera, into: &Surface| -> Result<()> { Ok(self.builder.fill_again(gaussians, camera, into)?) };
        let mine = if self.all { &self.stored[view] } else { &self.stored[0] };
        if !self.all {
            fill(camera, mine)?;
        }
        let which = if self.all { view } else { 0 };
        if let Some(lights) = self.lights.as_mut().filter(|_| !self.all) {
            lights.fill(mine, camera, which)?;
        }
        let light = self.lights.as_ref().map(|lights| &lights.buffers[which]);
        let others = if pseudo { &self.others[..] } else { &[] };
        for (surface, step) in others.iter().zip(&values.pseudo) {
            fill(&step.camera, surface)?;
        }
        Ok(exec.submit(mine, light, others, values)?)
    }
}

impl Intrinsic {
    /// Returns the number of bytes of all stored surfaces.
    pub fn surface_bytes(&self) -> u64 {
        self.surfaces.bytes()
    }

    /// Returns the mean number of entries of the material-blending matrices.
    /// The matrices are sparse. The mean is over the views with stored surfaces.
    ///
    /// # Errors
    /// If the device is lost.
    pub fn surface_weights(&self) -> Result<f64> {
        self.surfaces.weights(&self.device)
    }
}
