//! Materials of surfaces.

use glam::{Vec2, Vec3};

use crate::noise::fractal;
use crate::scene::texture::Texture;

/// Material of a surface: Lambert plus GGX.
///
/// alpha = roughness². F0 is 0.04 for dielectrics and the albedo for metals.
#[derive(Debug, Clone)]
pub(crate) struct Material {
    /// Base color.
    pub(crate) texture: Texture,
    /// Mean roughness.
    pub(crate) roughness: f32,
    /// Largest deviation of the roughness from its mean over the surface.
    pub(crate) spread: f32,
    /// 0 for dielectrics, 1 for metals.
    pub(crate) metallic: f32,
    /// Scale of the dielectric reflectance. 0 gives a purely diffuse surface.
    pub(crate) specular: f32,
}

impl Material {
    /// Creates a dielectric.
    pub(crate) fn new(texture: Texture, roughness: f32) -> Self {
        Self { texture, roughness, spread: 0.0, metallic: 0.0, specular: 1.0 }
    }

    /// Creates a metal of one color.
    pub(crate) fn metal(color: Vec3, roughness: f32) -> Self {
        Self { metallic: 1.0, ..Self::new(Texture::Solid(color), roughness) }
    }

    /// Returns the material with a roughness that varies by the given amount.
    pub(crate) fn varied(self, spread: f32) -> Self {
        Self { spread, ..self }
    }

    /// Returns the reflectance at one point.
    pub(crate) fn at(&self, uv: Vec2) -> Reflectance {
        let wander = if self.spread > 0.0 { self.spread * (2.0 * fractal(uv * 4.0, 2, 99) - 1.0) } else { 0.0 };
        Reflectance {
            albedo: self.texture.color(uv).clamp(Vec3::ZERO, Vec3::splat(0.9)),
            roughness: (self.roughness + wander).clamp(0.03, 1.0),
            metallic: self.metallic,
            specular: self.specular,
        }
    }
}

/// Reflectance parameters at one point of a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Reflectance {
    /// Base color, linear.
    pub(crate) albedo: Vec3,
    /// Perceptual roughness.
    pub(crate) roughness: f32,
    /// 0 for dielectrics, 1 for metals.
    pub(crate) metallic: f32,
    /// Scale of the dielectric reflectance.
    pub(crate) specular: f32,
}

impl Reflectance {
    /// Returns the diffuse albedo.
    pub(crate) fn diffuse(&self) -> Vec3 {
        self.albedo * (1.0 - self.metallic)
    }

    /// Returns the reflectance at normal incidence.
    pub(crate) fn f0(&self) -> Vec3 {
        Vec3::splat(0.04 * self.specular * (1.0 - self.metallic)) + self.albedo * self.metallic
    }
}
