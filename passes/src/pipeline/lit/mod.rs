//! Shades Gaussians with materials into images, frame by frame.
//!
//! The lights may change with each frame.
//!
//! Guarantees: lights are parameters of a frame. Moving, coloring, switching, adding and removing lights changes
//! neither plans nor memory within the capacity ([`Lighting::model`]). A prepared frame keeps its lights. Nothing is
//! read back, as in [`super::View`]. Images equal those of [`super::Shader`]. The caller supplies the lights, and
//! submits or records.

mod build;
mod scene;
mod view;

pub use scene::{LitEnvironment, LitScene};
pub use view::LitView;

use super::FrameEmitter;
use crate::shade::lights::LightModel;
use crate::splat::{Encoding, TexelFormat};
use sgs_engine::graph::ImageState;
use sgs_shaders::structs::Camera;

/// Layer of a shaded view. Light is linear radiance of the surfaces times their opacity.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum LitLayer {
    /// All light, over a background color.
    Shaded,
    /// Linear albedo.
    Albedo,
    /// Roughness, in all three channels.
    Roughness,
    /// Metallic, in all three channels.
    Metallic,
    /// Diffuse light, over black.
    Diffuse,
    /// Specular light, over black.
    Specular,
    /// Visibility of the lights, mean over all of them.
    Visibility,
    /// Light of the environment map, over the environment map itself.
    Environment,
    /// Light of the point lights, over black.
    Direct,
}

impl LitLayer {
    /// All layers.
    pub const ALL: [LitLayer; 9] = [
        LitLayer::Shaded,
        LitLayer::Albedo,
        LitLayer::Roughness,
        LitLayer::Metallic,
        LitLayer::Diffuse,
        LitLayer::Specular,
        LitLayer::Visibility,
        LitLayer::Environment,
        LitLayer::Direct,
    ];

    /// Returns the name of the layer.
    pub fn name(self) -> &'static str {
        match self {
            LitLayer::Shaded => "shaded",
            LitLayer::Albedo => "albedo",
            LitLayer::Roughness => "roughness",
            LitLayer::Metallic => "metallic",
            LitLayer::Diffuse => "diffuse",
            LitLayer::Specular => "specular",
            LitLayer::Visibility => "visibility",
            LitLayer::Environment => "environment",
            LitLayer::Direct => "direct",
        }
    }

    /// Returns whether the layer is a value instead of a color, and thus never encoded.
    pub fn is_value(self) -> bool {
        matches!(self, LitLayer::Roughness | LitLayer::Metallic | LitLayer::Visibility)
    }

    /// Returns whether the layer contains light of the point lights.
    fn direct(self) -> bool {
        matches!(self, LitLayer::Shaded | LitLayer::Direct) || self.split()
    }

    /// Returns whether the layer contains light of the environment map.
    fn ambient(self) -> bool {
        matches!(self, LitLayer::Shaded | LitLayer::Environment) || self.split()
    }

    /// Returns whether the layer separates diffuse from specular light.
    fn split(self) -> bool {
        matches!(self, LitLayer::Diffuse | LitLayer::Specular)
    }
}

/// Options of a [`LitView`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LitOptions {
    /// Columns and rows of the images.
    pub size: [u32; 2],
    /// Layer to show.
    pub layer: LitLayer,
    /// Format of the images.
    pub format: TexelFormat,
    /// Encoding of colors; formats that decode sRGB always hold encoded values.
    pub encoding: Encoding,
    /// Image state before a frame, which overwrites all texels.
    pub entry: ImageState,
    /// Image state after a frame.
    pub exit: ImageState,
    /// Maximum number of frames in flight.
    pub frames_in_flight: usize,
    /// Initial capacities of tile entries and of weights; 0 estimates them.
    pub capacity: [u32; 2],
}

/// Inputs of one frame.
#[derive(Clone, Copy, Debug)]
pub struct LitFrame {
    /// Camera.
    pub camera: Camera,
    /// Background of [`LitLayer::Shaded`], linear; exposure does not affect it.
    pub background: [f32; 3],
    /// Factor on all light.
    pub exposure: f32,
}

/// Lights on the host, in world units.
///
/// Padded to the capacity with lights of gain 0.
#[derive(Clone, Debug, PartialEq)]
pub struct Lighting {
    /// Capacity of lights, and lobes per light.
    pub model: LightModel,
    /// Factor on the light of all lights.
    pub normalizer: f32,
    /// Number of lights without padding; visibility is the mean over these.
    pub count: u32,
    /// `[lights * 3]`: positions.
    pub positions: Vec<f32>,
    /// `[lights * lobes * row]`: lobes; see [`LightModel::row`].
    pub lobes: Vec<f32>,
    /// `[lights]`: gains; 0 is off.
    pub gains: Vec<f32>,
    /// Factor on the light of the environment map, per channel.
    pub environment: [f32; 3],
    /// Emitters of a scene with responses to them. They replace the other lights and the environment map.
    pub emitters: Vec<FrameEmitter>,
}

impl Lighting {
    /// Converts the lights to another unit of length; `None` if it is the world's.
    fn in_unit(&self, unit: f32) -> Option<Lighting> {
        (unit != 1.0).then(|| {
            let (by, bright) = (1.0 / unit, 1.0 / (unit * unit));
            Lighting {
                positions: self.positions.iter().map(|v| v * by).collect(),
                gains: self.gains.iter().map(|v| v * bright).collect(),
                emitters: self.emitters.iter().map(|e| e.scaled(by)).collect(),
                ..self.clone()
            }
        })
    }
}
