//! Splats in glTF 2.0: `KHR_gaussian_splatting` with this project's materials, `KHR_lights_punctual` for lights.
//!
//! What other programs read is what the extensions say: scales, unit quaternions and opacities after activation,
//! harmonics by coefficient. Beside it stand attributes whose names begin with an underscore, as glTF asks of those of
//! applications: materials, normals, and the stored numbers before activation, from which this reader gets every bit
//! back (docs/reference/exchange.md). Lights are points with their mean intensity; what they are more than that is the caller's to
//! put into `extras`.

mod buffer;
mod document;
mod nodes;
mod read;
mod write;

use crate::splats::Splats;

pub use write::write_gltf;

/// The extension of splats.
pub(crate) const SPLATTING: &str = "KHR_gaussian_splatting";
/// The extension of lights.
pub(crate) const LIGHTS: &str = "KHR_lights_punctual";

/// What a glTF file holds of splats and lights.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct GltfScene {
    /// Splats as they are stored, and where each set stands.
    pub parts: Vec<(Splats, Placement)>,
    /// Its point lights.
    pub lights: Vec<PointLight>,
    /// What stands in the `extras` of all lights together.
    pub light_extras: Option<serde_json::Value>,
    /// What was left out, in words.
    pub left_out: Vec<String>,
}

/// Where a node of a glTF file puts what it carries: scaled, turned, moved, in this order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// Factor of all lengths.
    pub scale: f64,
    /// Quaternion (w, x, y, z), of length 1.
    pub rotation: [f64; 4],
    /// Where its origin comes to lie.
    pub translation: [f64; 3],
}

impl Placement {
    /// Where it is.
    pub const NONE: Placement = Placement { scale: 1.0, rotation: [1.0, 0.0, 0.0, 0.0], translation: [0.0; 3] };
}

/// A light that sends the same in all directions.
#[derive(Clone, Debug, PartialEq)]
pub struct PointLight {
    /// Place in the world.
    pub position: [f32; 3],
    /// Linear red, green and blue, factors of the intensity.
    pub color: [f32; 3],
    /// Candela, as glTF has it.
    pub intensity: f32,
    /// What its writer knows beside.
    pub extras: Option<serde_json::Value>,
}

/// The attributes of harmonics, by band and coefficient.
fn sh_name(band: usize, coefficient: usize) -> String {
    format!("{SPLATTING}:SH_DEGREE_{band}_COEF_{coefficient}")
}

/// Whether a stored number still says what stands for all to read. If not, somebody has edited what all read.
fn agrees(shown: f32, value: f64) -> bool {
    (f64::from(shown) - value).abs() <= 2e-7 * value.abs() + 1e-12
}

fn logistic(stored: f32) -> f64 {
    1.0 / (1.0 + (-f64::from(stored)).exp())
}

/// What a material is, from the range of [`crate::ALBEDO_RANGE`] or its like.
fn material(stored: f32, range: [f32; 2]) -> f64 {
    f64::from(range[0]) + f64::from(range[1]) * logistic(stored)
}

/// The way back, never infinite.
fn unlogistic(value: f64) -> f32 {
    let p = value.clamp(1e-6, 1.0 - 1e-6);
    (p / (1.0 - p)).ln() as f32
}

fn unmaterial(value: f32, range: [f32; 2]) -> f32 {
    unlogistic((f64::from(value) - f64::from(range[0])) / f64::from(range[1]))
}

/// The range of metallic.
const METALLIC_RANGE: [f32; 2] = [0.0, 1.0];

/// A quaternion (w, x, y, z) of length 1, from one of any.
fn unit(q: [f32; 4]) -> [f64; 4] {
    let q = q.map(f64::from);
    let length = q.iter().map(|v| v * v).sum::<f64>().sqrt();
    if length > 0.0 && length.is_finite() { q.map(|v| v / length) } else { [1.0, 0.0, 0.0, 0.0] }
}
