//! Pixels to be shaded: points, normals and materials.

use super::{PixelMaterials, Surfaces};
use crate::splat::Screen;

/// Shading inputs of a view's pixels. Only pixels with coverage below [`super::LEAST_COVERAGE`] are skipped. Their
/// radiance and gradients are zero, whatever the other values are.
#[derive(Clone, Copy, Debug)]
pub struct Pixels {
    /// Size of the view and position of the camera; tiles are ignored.
    pub screen: Screen,
    /// Points, normals and coverage.
    pub surfaces: Surfaces,
    /// Albedo and roughness; metallic is 0 everywhere unless present.
    pub materials: PixelMaterials,
}
