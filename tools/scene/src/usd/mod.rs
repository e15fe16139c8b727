//! Writer of USD: splats as `ParticleField3DGaussianSplat` of OpenUSD 26.03, lights as UsdLux.
//!
//! Files are text (`.usda`), or a package of text and images (`.usdz`). Albedo, roughness, metallic and normals are
//! primvars. The transform from the scene to the file is the transform of the root prim, and part of `customLayerData`.

mod lights;
mod package;
mod text;

pub use package::write_usd;

use crate::splats::Splats;

/// Light of UsdLux.
#[derive(Clone, Debug, PartialEq)]
pub struct UsdLight {
    /// Name; its letters and digits name the prim.
    pub name: String,
    /// Shape and place.
    pub shape: UsdShape,
    /// Linear red, green and blue: radiance, or irradiance of directional lights.
    pub color: [f32; 3],
}

/// Shape of a light. Angles are in radians.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum UsdShape {
    /// Sphere. A point is a small sphere that renderers may treat as a point.
    Sphere {
        /// Center.
        center: [f32; 3],
        /// Radius.
        radius: f32,
        /// Whether renderers may treat the sphere as a point.
        point: bool,
    },
    /// Small sphere with a cone of light.
    Spot {
        /// Position.
        position: [f32; 3],
        /// Axis of the cone.
        axis: [f32; 3],
        /// Radius of the sphere.
        radius: f32,
        /// Angle at which the light begins to fall off.
        inner_angle: f32,
        /// Angle at which the light ends.
        outer_angle: f32,
    },
    /// Light from afar.
    Directional {
        /// Direction in which the light travels.
        direction: [f32; 3],
        /// Angular radius.
        angular_radius: f32,
    },
    /// Rectangle that emits on the side of `edge_u` x `edge_v`.
    Rectangle {
        /// Corner where both edges begin.
        corner: [f32; 3],
        /// First edge.
        edge_u: [f32; 3],
        /// Second edge, perpendicular to the first.
        edge_v: [f32; 3],
    },
    /// Disk that emits on the side of its normal.
    Disk {
        /// Center.
        center: [f32; 3],
        /// Normal.
        normal: [f32; 3],
        /// Radius.
        radius: f32,
    },
}

/// Returns the attributes of splats that USD files do not hold.
pub fn usd_leaves_out(splats: &Splats) -> Vec<&'static str> {
    let all = [
        (splats.semantic.is_some(), "semantic features"),
        (splats.emitters.is_some(), "emitters of Gaussians"),
        (splats.light_gains.is_some(), "light gains"),
    ];
    all.into_iter().filter(|(has, _)| *has).map(|(_, name)| name).collect()
}
