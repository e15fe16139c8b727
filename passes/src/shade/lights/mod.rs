//! Point lights that shine as mixtures of spherical Gaussians: from raw parameters to radiance, and back.
//!
//! A light at p shines on a point x from direction w = (p - x) / |p - x| with `sum_k mu_k exp(lambda_k (w . b_k - 1))`, mu in
//! red, green, blue, divided by `max(|p - x|^2, 1e-3)` (SGS-Intrinsic, section 3.2; spherical Gaussians: Wang et al. 2009).
//! Radiance is the sum over the lights times a normalizer that never changes, so that a light can be switched off, or one
//! added, without the others changing. The surface is Lambert's and GGX (`brdf.glsl`); see docs/how/mathematics.md.
//!
//! The way of a step:
//! 1. [`lights_prepare`]: raw parameters to what shading reads, and the list of lights that are on;
//! 2. [`lights_train`]: radiance and, a pixel, sums that make [`lights_materials_bwd`] cheap; for pictures [`lights`] or
//!    [`lights_split`];
//! 3. [`lights_materials_bwd`]: gradients of albedo, roughness, metallic;
//! 4. [`lights_regularize`], [`lights_bwd`], [`lights_prepare_bwd`]: gradients of the lights; [`lights_normals_bwd`]: of
//!    normals, where these are learned. Now and then [`lights_prune`].
//!
//! What a pair of pixel and light costs, in operations (a multiply-add counts two, an exponential, root or division four):
//! 20 for direction and cosine, of all pairs; of those that face each other, about half of them in a room, 21 a lobe and 100
//! for the surface (135 in training). With 64 lights of 12 lobes that is 64 (20 + 0.5 (252 + 100)) = 12500 a pixel:
//! 0.96 Gop at 320x240, 24 Gop at 1600x1200. Memory a pixel: 48 bytes read, 12 written, in training 24 more (48 with metallic);
//! the lights themselves, 25.6 KB, stay in a cache.
//!
//! How far a light is seen is decided by an include file: `visibility_none.glsl` says always. The kernels' bodies are include
//! files, too, so that a field or traced shadows need a few lines of their own (`lights_pixels.glsl` has the rules).

pub(in crate::shade) mod backward;
pub(in crate::shade) mod forward;
mod model;
mod prepare;
mod regularize;

pub use backward::{LightGradients, LightParameterGradients, lights_bwd, lights_normals_bwd, lights_prepare_bwd};
pub use forward::{Lights, Shape, Sums, lights, lights_materials_bwd, lights_split, lights_train};
pub use model::{Axes, LightModel, LightParameters};
pub use prepare::{Perturbation, Prepared, lights_prepare, lights_prepare_culled};
pub use regularize::{LightRegularizers, lights_prune, lights_regularize};
