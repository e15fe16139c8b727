//! Gaussians with materials, shaded into images frame by frame under lights that change from frame to frame.
//!
//! Promises: lights are parameters of a frame. Moving, coloring, switching, adding and removing them changes neither plans
//! nor memory as long as there is room for them ([`Lighting::model`]), and a frame that was prepared keeps the lights that
//! it was prepared with. Nothing is read back on the way, as in [`super::View`]. Pictures are those of [`super::Shader`].
//! Leaves to others where lights come from, and submitting or recording.

mod build;
mod scene;
mod view;

pub use scene::{LitEnvironment, LitScene};
pub use view::LitView;

use crate::shade::lights::LightModel;
use crate::splat::{Encoding, TexelFormat};
use sgs_engine::graph::ImageState;
use sgs_shaders::structs::Camera;

/// What of a shaded view is shown. Light is linear, and what surfaces send times their opacity.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum LitLayer {
    /// All light, over a color.
    Shaded,
    /// Linear albedo.
    Albedo,
    /// Roughness, in all three components.
    Roughness,
    /// Metallic.
    Metallic,
    /// Diffuse light, over black.
    Diffuse,
    /// Specular light, over black.
    Specular,
    /// How much of the lights is seen, mean over all of them.
    Visibility,
    /// Light of the surroundings, over the surroundings themselves.
    Environment,
    /// Light of lamps, over black.
    Direct,
}

impl LitLayer {
    /// All of them.
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

    /// Its name.
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

    /// Whether it is no color, so that it is never encoded.
    pub fn is_value(self) -> bool {
        matches!(self, LitLayer::Roughness | LitLayer::Metallic | LitLayer::Visibility)
    }

    /// Whether light of lamps is in it.
    fn direct(self) -> bool {
        matches!(self, LitLayer::Shaded | LitLayer::Direct) || self.split()
    }

    /// Whether light of the surroundings is in it.
    fn ambient(self) -> bool {
        matches!(self, LitLayer::Shaded | LitLayer::Environment) || self.split()
    }

    /// Whether diffuse light is told from specular.
    fn split(self) -> bool {
        matches!(self, LitLayer::Diffuse | LitLayer::Specular)
    }
}

/// What a view is made for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LitOptions {
    /// Columns and rows of the images.
    pub size: [u32; 2],
    /// What is shown.
    pub layer: LitLayer,
    /// The format of the images.
    pub format: TexelFormat,
    /// How colors are encoded; formats that decode sRGB hold encoded values either way.
    pub encoding: Encoding,
    /// The state in which images are found; their texels are overwritten.
    pub entry: ImageState,
    /// The state in which images are left.
    pub exit: ImageState,
    /// Frames that may be in flight together.
    pub frames_in_flight: usize,
    /// Room for tile entries and for weights at first; 0 guesses.
    pub capacity: [u32; 2],
}

/// One frame.
#[derive(Clone, Copy, Debug)]
pub struct LitFrame {
    /// From where.
    pub camera: Camera,
    /// What lies behind [`LitLayer::Shaded`], linear; exposure does not change it.
    pub background: [f32; 3],
    /// Factor of all light.
    pub exposure: f32,
}

/// Lights on the host, in the world's unit of length, as many as there is room for: those that are not there have a gain of 0.
#[derive(Clone, Debug, PartialEq)]
pub struct Lighting {
    /// Room for lights, and lobes of each.
    pub model: LightModel,
    /// Factor of all their light.
    pub normalizer: f32,
    /// Lights that there are, which is what visibility is the mean over.
    pub count: u32,
    /// `[lights * 3]`
    pub positions: Vec<f32>,
    /// `[lights * lobes * row]`, see [`LightModel::row`].
    pub lobes: Vec<f32>,
    /// `[lights]`; 0 is off.
    pub gains: Vec<f32>,
    /// Factors of the light of the surroundings.
    pub environment: [f32; 3],
}

impl Lighting {
    /// The same lights in another unit of length; none where it is the world's.
    fn in_unit(&self, unit: f32) -> Option<Lighting> {
        (unit != 1.0).then(|| {
            let (by, bright) = (1.0 / unit, 1.0 / (unit * unit));
            Lighting {
                positions: self.positions.iter().map(|v| v * by).collect(),
                gains: self.gains.iter().map(|v| v * bright).collect(),
                ..self.clone()
            }
        })
    }
}
