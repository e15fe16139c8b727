//! The pixels that are shaded: places, normals, materials.

use super::{PixelMaterials, Surfaces};
use crate::splat::Screen;

/// What a view's pixels are shaded with. Where coverage is below [`super::LEAST_COVERAGE`], and only there, nothing is:
/// whatever the other numbers are, radiance and gradients are zero.
#[derive(Clone, Copy, Debug)]
pub struct Pixels {
    /// The view's size and the camera's place; tiles are of no importance.
    pub screen: Screen,
    /// Points, normals, coverage.
    pub surfaces: Surfaces,
    /// Albedo, roughness; metallic is 0 everywhere unless it is given.
    pub materials: PixelMaterials,
}
