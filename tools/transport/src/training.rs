//! Room of a training step.

use crate::error::Result;
use crate::room::{Room, near};
use sgs_engine::{Device, DeviceBuffer};
use sgs_passes::pipeline::{
    Camera, Surface, SurfaceShape, TransportContents, TransportMemory, TransportScene, ViewLights,
};
use sgs_passes::transport::{AreaLight, Surfels, nearest_surfels};
use sgs_scene::{Splats, Unit};
use std::sync::Arc;

/// Opacity before activation above which Gaussians describe surfels.
const OPAQUE: f32 = -0.85;
/// Color that stands for black, whose logarithm is not finite.
const LEAST_COLOR: f32 = 1e-4;
/// Bounds of the trained albedo of the enclosure.
const ALBEDO: [f32; 2] = [0.02, 0.95];

/// Lights and transport of a room, as a training step takes them.
pub struct TrainingRoom {
    /// Buffers of the transport.
    pub memory: TransportMemory,
    /// Unit of all lengths, in the scene's unit.
    pub unit: Unit,
    /// Logarithms of the colors of the lights.
    pub log_colors: Vec<f32>,
    /// Raw albedo of the faces of the enclosure.
    pub enclosure: Vec<f32>,
    scene: Arc<TransportScene>,
    lights: Vec<AreaLight>,
}

impl Room {
    /// Prepares the training of the materials and lights of this room.
    ///
    /// `lights` are in world units, in the order of the emitters. `emission` holds the radiance that each Gaussian emits.
    ///
    /// # Errors
    /// If a light is invalid, memory runs out, or the device fails.
    pub fn training(&self, splats: &Splats, lights: &[AreaLight], emission: &[[f32; 3]]) -> Result<TrainingRoom> {
        let lights = self.scaled(lights)?;
        // Transparent Gaussians show no surface.
        let place = |i: usize| match splats.opacity_logits[i] > OPAQUE {
            true => self.unit.place(splats.means[i]),
            false => [f32::NAN; 3],
        };
        let normal = |i: usize| splats.normals.as_ref().map_or([0.0; 3], |n| n[i]);
        let gaussians = Surfels {
            points: (0..splats.len()).map(place).collect(),
            normals: (0..splats.len()).map(normal).map(|n| glam::Vec3::from(n).normalize_or_zero().into()).collect(),
            radii: vec![1.0; splats.len()],
        };
        let discs = &self.surfels.discs;
        let options = near(self.diagonal(), self.surfels.cell);
        let materials = nearest_surfels(&discs.points, &discs.normals, &gaussians, &options);
        let faces: Vec<u32> = self.enclosure.patches().iter().map(|p| p.face).collect();
        let contents = TransportContents {
            lights: &lights,
            surfels: self.surfels.len() as u32,
            faces: &faces,
            nearest: self.nearest(),
            materials: &materials,
            emission,
        };
        let raw = |a: f32| {
            let a = a.clamp(ALBEDO[0], ALBEDO[1]);
            (a / (1.0 - a)).ln()
        };
        Ok(TrainingRoom {
            memory: TransportMemory::new(self.device(), &self.scene, &contents)?,
            unit: self.unit,
            log_colors: lights.iter().flat_map(|l| l.color.map(|c| c.max(LEAST_COLOR).ln())).collect(),
            enclosure: self.albedo().iter().flatten().map(|a| raw(*a)).collect(),
            scene: Arc::clone(&self.scene),
            lights,
        })
    }
}

impl TrainingRoom {
    /// Prepares the computation of the light of views of this shape.
    ///
    /// # Errors
    /// If memory runs out.
    pub fn view_lights(&self, device: &Device, shape: &SurfaceShape) -> Result<ViewLights> {
        Ok(ViewLights::new(device, &self.scene, &self.lights, shape)?)
    }

    /// Returns the colors of the lights of these parameters.
    pub fn colors(log_colors: &[f32]) -> Vec<[f32; 3]> {
        log_colors.chunks_exact(3).map(|c| [c[0].exp(), c[1].exp(), c[2].exp()]).collect()
    }

    /// Returns the albedo of the faces of these parameters.
    pub fn albedo(raw: &[f32]) -> Vec<[f32; 3]> {
        raw.chunks_exact(3).map(|c| [c[0], c[1], c[2]].map(|x| 1.0 / (1.0 + (-x).exp()))).collect()
    }
}

/// Light of the views of a training, in device memory.
pub struct ViewLightBuffers {
    lights: ViewLights,
    /// By view; only one if each step computes it.
    pub buffers: Vec<DeviceBuffer>,
}

impl ViewLightBuffers {
    /// Allocates the light of `count` views.
    ///
    /// # Errors
    /// If memory runs out.
    pub fn new(room: &TrainingRoom, device: &Device, shape: &SurfaceShape, count: usize) -> Result<ViewLightBuffers> {
        let lights = room.view_lights(device, shape)?;
        let buffers = (0..count).map(|_| Ok(lights.allocate()?)).collect::<Result<_>>()?;
        Ok(ViewLightBuffers { lights, buffers })
    }

    /// Computes the light of a view, without waiting for it.
    ///
    /// # Errors
    /// If the device fails.
    pub fn fill(&mut self, surface: &Surface, camera: &Camera, which: usize) -> Result<()> {
        Ok(self.lights.fill(surface, camera, &self.buffers[which])?)
    }

    /// Waits for the submitted work.
    ///
    /// # Errors
    /// If the device fails.
    pub fn finish(&mut self) -> Result<()> {
        Ok(self.lights.finish()?)
    }
}
