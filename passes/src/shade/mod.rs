//! Shading: radiance that pixels with points, normals and materials emit to the camera.
//!
//! Guarantees: radiance is linear, per pixel. No buffer has the size of pixels times lights. Kernels use no float
//! atomics, so that results are bit-identical from run to run. Pixels without a surface are zero, and so are their
//! gradients. Losses convert radiance to images.

pub mod environment;
mod gbuffer;
pub mod lights;
mod materials;
mod normals;
mod pixels;
pub mod traced;
pub mod visibility;

pub use gbuffer::{
    GBUFFER_CHANNELS, LEAST_COVERAGE, Room, Rows, SURFACE_DEPTH, Surfaces, Weights, gbuffer, surface_depth,
    unpacked_weights, weight_rows, weight_words, weights,
};
pub use materials::{ALBEDO_RANGE, PixelMaterials, RawMaterials, materials, materials_bwd, values};
pub use normals::{LearnedNormals, normals, normals_bwd};
pub use pixels::Pixels;
