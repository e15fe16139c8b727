//! The pixels that are shaded: places, normals, materials.

use sgs_engine::graph::Buffer;

/// One float32 array each, interleaved by pixel, for P = columns times rows of the view.
///
/// Pixels with coverage below 1e-3, and only they, are not shaded: whatever their other numbers are, their radiance and their
/// gradients are zero.
#[derive(Clone, Copy, Debug)]
pub struct Pixels {
    /// Uniform `Step`: the view's size and the camera's place.
    pub step: Buffer,
    /// `[P * 3]`: places in the world.
    pub points: Buffer,
    /// `[P * 3]`: unit normals in the world, or zero.
    pub normals: Buffer,
    /// `[P]`: blended opacity.
    pub coverage: Buffer,
    /// `[P * 4]`: linear albedo (3), roughness.
    pub materials: Buffer,
    /// `[P]`: how metallic; 0 everywhere without it.
    pub metallic: Option<Buffer>,
    /// Columns and rows that no view exceeds, each for itself.
    pub largest: [u32; 2],
}

impl Pixels {
    /// Pixels that no view exceeds.
    pub fn most(&self) -> u64 {
        u64::from(self.largest[0]) * u64::from(self.largest[1])
    }
}
