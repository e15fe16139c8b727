//! Light transport: noisy radiance and geometric features from a scene and a camera.
//!
//! [`path`] traces one path, [`render`] distributes samples over pixels, [`denoise`] removes the remaining noise.

pub(crate) mod brdf;
pub(crate) mod camera;
pub(crate) mod denoise;
pub(crate) mod film;
pub(crate) mod filter;
pub(crate) mod path;
pub(crate) mod render;
pub(crate) mod sampler;
pub(crate) mod scene;

#[cfg(test)]
mod tests;
