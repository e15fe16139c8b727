//! Light transport: from a scene and a camera to noisy radiance with the features that describe it.
//!
//! [`path`] follows one path, [`render`] spends samples on pixels, [`denoise`] removes the noise that is left.

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
