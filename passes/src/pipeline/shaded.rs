//! Lights, environment map and visibility of a shaded scene, and a shaded view.

use super::EnvironmentMemory;
use crate::scene::Trainable;
use crate::shade::environment::Environment;
use crate::shade::lights::LightModel;
use crate::shade::traced::{TracedMemory, TracedShape};
use crate::shade::visibility::VisibilityField;
use sgs_shaders::structs::FieldStep;

/// Visibility of lights in device memory.
#[derive(Debug)]
pub enum ShadedVisibility {
    /// Learned visibility field.
    Field {
        /// Hash tables and network layers.
        field: VisibilityField,
        /// Box of the field; the remaining fields of the uniform are filled in per view.
        place: FieldStep,
    },
    /// Visibility by tracing rays through the Gaussians.
    Traced {
        /// Tree over the Gaussians.
        memory: TracedMemory,
        /// Shape of the tree.
        shape: TracedShape,
    },
}

/// Point lights in device memory.
#[derive(Debug)]
pub struct ShadedLights {
    /// Number of lights and layout of their parameters.
    pub model: LightModel,
    /// Factor on the light of all lights.
    pub normalizer: f32,
    /// `[lights * 3]`: positions.
    pub positions: Trainable,
    /// Rows of lobes.
    pub lobes: Trainable,
    /// `[lights]`: gains; 0 is off.
    pub gains: Trainable,
}

/// Environment map in device memory.
#[derive(Debug)]
pub struct ShadedEnvironment {
    /// Filter tables.
    pub tables: Environment,
    /// Device memory of the tables.
    pub memory: EnvironmentMemory,
    /// Texels.
    pub texels: Trainable,
}

/// Shaded view on the host.
///
/// Floats by pixel, row by row. Light is the linear radiance of the surfaces, before compositing over a background.
#[derive(Clone, Debug, Default)]
pub struct Shaded {
    /// Columns and rows.
    pub size: [u32; 2],
    /// Positions in world units, 3 floats per pixel.
    pub points: Vec<f32>,
    /// Normals in world space, unit or zero, 3 floats per pixel.
    pub normals: Vec<f32>,
    /// Opacity, 1 float per pixel.
    pub coverage: Vec<f32>,
    /// Linear albedo and roughness, 4 floats per pixel.
    pub materials: Vec<f32>,
    /// Metallic, 1 float per pixel; empty if the scene has none.
    pub metallic: Vec<f32>,
    /// Light of point lights and physical lights, 3 floats per pixel.
    pub direct: Vec<f32>,
    /// Diffuse term of `direct`, 3 floats per pixel.
    pub direct_diffuse: Vec<f32>,
    /// Light of the environment map, 3 floats per pixel.
    pub ambient: Vec<f32>,
    /// Diffuse term of `ambient`, 3 floats per pixel.
    pub ambient_diffuse: Vec<f32>,
    /// Environment map along each camera ray, 3 floats per pixel.
    pub background: Vec<f32>,
    /// Visibility of the lights, mean over all lights, 1 float per pixel; empty without occlusion.
    pub visibility: Vec<f32>,
    /// Light that bounced between surfaces, 3 floats per pixel; empty without transport.
    pub indirect: Vec<f32>,
    /// Light that the surfaces emit, 3 floats per pixel; empty without transport.
    pub emission: Vec<f32>,
}
