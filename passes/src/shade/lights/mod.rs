//! Point lights that emit mixtures of spherical Gaussians: radiance and gradients.
//!
//! A light at p illuminates a point x from direction w = (p - x) / |p - x| with
//! `sum_k mu_k exp(lambda_k (w . b_k - 1))`, where mu is red, green, blue, divided by `max(|p - x|^2, 1e-3)`
//! (SGS-Intrinsic, section 3.2; spherical Gaussians: Wang et al. 2009). Radiance is the sum over the lights times a
//! constant normalizer. A light can therefore be switched off or added without changing the others. Surfaces are
//! Lambertian with a GGX lobe (`brdf.glsl`); see docs/how/mathematics.md.
//!
//! Passes of a step:
//!
//! 1. [`lights_prepare`]: converts raw parameters for shading, and lists the lights that are on;
//! 2. [`lights_train`]: radiance, and sums per pixel that make [`lights_materials_bwd`] cheap; for images [`lights`] or
//!    [`lights_split`];
//! 3. [`lights_materials_bwd`]: gradients of albedo, roughness, metallic;
//! 4. [`lights_regularize`], [`lights_bwd`], [`lights_prepare_bwd`]: gradients of the lights; [`lights_normals_bwd`]:
//!    gradients of trainable normals.
//!
//! Operations of a pair of pixel and light (a multiply-add counts two, an exponential, root or division four): 20 for
//! direction and cosine, for all pairs. Pairs that face each other, about half of them in a room, add 21 per lobe and
//! 100 for the surface (135 in training). With 64 lights of 12 lobes this is 64 (20 + 0.5 (252 + 100)) = 12500 per
//! pixel: 0.96 Gop at 320x240, 24 Gop at 1600x1200. Memory per pixel: 48 bytes read, 12 written, and 24 more in
//! training (48 with metallic). The lights themselves, 25.6 KB, stay in a cache.
//!
//! An include file determines the visibility of a light: `visibility_none.glsl` always returns 1. The kernels' bodies
//! are include files, too, so that a visibility field or traced shadows need only a few lines (`lights_pixels.glsl` has
//! the rules).

pub(in crate::shade) mod backward;
pub(in crate::shade) mod forward;
mod model;
mod prepare;
mod regularize;

pub use backward::{LightGradients, LightParameterGradients, lights_bwd, lights_normals_bwd, lights_prepare_bwd};
pub use forward::{Lights, Shape, Sums, lights, lights_materials_bwd, lights_split, lights_train};
pub use model::{Axes, LightModel, LightParameters};
pub use prepare::{Perturbation, Prepared, lights_prepare, lights_prepare_culled};
pub use regularize::{LightRegularizers, lights_regularize};
