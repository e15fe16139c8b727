//! Splats and lights in glTF 2.0.
//!
//! Uses `KHR_gaussian_splatting` with this project's materials, and `KHR_lights_punctual` for lights. Splats may be
//! compressed by `KHR_gaussian_splatting_compression_spz_2`.
//!
//! Other programs read what the extensions define: scales, unit quaternions and opacities after activation, and
//! spherical harmonics by coefficient. Application-specific attributes have names that begin with an underscore, as
//! glTF requires. They hold materials, normals, and the stored values before activation, from which this reader
//! restores every bit (docs/reference/exchange.md). Callers store further properties of a light in its
//! `extras`.

mod buffer;
mod compressed;
mod document;
mod nodes;
mod read;
mod write;

use crate::activation::{METALLIC_RANGE, logistic, material, unit, unlogistic, unmaterial};
use crate::placement::Placement;
use crate::splats::Splats;

pub use write::{GltfCoding, write_gltf};

/// Name of the splat extension.
pub(crate) const SPLATTING: &str = "KHR_gaussian_splatting";
/// Name of the compression extension; a part of the splat extension.
const COMPRESSION: &str = "KHR_gaussian_splatting_compression_spz_2";
/// Name of the compression extension in earlier drafts.
const EARLY_COMPRESSION: &str = "KHR_gaussian_splatting_compression_spz";
/// Name of the light extension.
pub(crate) const LIGHTS: &str = "KHR_lights_punctual";

/// Splats and lights of a glTF file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct GltfScene {
    /// Sets of splats as stored, each with its placement.
    pub parts: Vec<(Splats, Placement)>,
    /// Lights.
    pub lights: Vec<PunctualLight>,
    /// `extras` of the document's light extension.
    pub light_extras: Option<serde_json::Value>,
    /// Descriptions of content that was skipped.
    pub left_out: Vec<String>,
    /// Transform from the scene to the file, if the file records one.
    /// Splats and lights are in the coordinates of the scene.
    pub transform: Option<Placement>,
}

/// Kind of a punctual light. Angles are in radians, from the axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PunctualKind {
    /// Light with equal intensity in all directions.
    Point,
    /// Cone of light.
    Spot {
        /// Angle at which the light begins to fall off.
        inner_angle: f32,
        /// Angle at which the light ends; above the inner one.
        outer_angle: f32,
    },
    /// Light from afar.
    Directional,
}

/// Light of `KHR_lights_punctual`.
#[derive(Clone, Debug, PartialEq)]
pub struct PunctualLight {
    /// Name; empty if the file has none.
    pub name: String,
    /// Kind.
    pub kind: PunctualKind,
    /// Position in world space.
    pub position: [f32; 3],
    /// Direction in which spots and directional lights shine, of unit length: -Z of the node.
    pub direction: [f32; 3],
    /// Linear red, green and blue factors of the intensity.
    pub color: [f32; 3],
    /// Intensity in candela, or lux of directional lights, as in glTF.
    pub intensity: f32,
    /// Application-specific data.
    pub extras: Option<serde_json::Value>,
}

impl PunctualLight {
    /// Returns whether the intensity grows with the square of lengths.
    fn has_intensity(&self) -> bool {
        self.kind != PunctualKind::Directional
    }
}

/// Returns the attribute name of a spherical-harmonics coefficient.
fn sh_name(band: usize, coefficient: usize) -> String {
    format!("{SPLATTING}:SH_DEGREE_{band}_COEF_{coefficient}")
}

/// Returns whether a stored value matches the standard attribute. A mismatch means that another program edited the
/// standard attribute.
fn agrees(shown: f32, value: f64) -> bool {
    (f64::from(shown) - value).abs() <= 2e-7 * value.abs() + 1e-12
}
