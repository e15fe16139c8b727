//! Area lights: spheres, one-sided rectangles, and windows onto an environment map.
//!
//! Lights are not part of the triangle mesh. They are intersected, sampled and weighted analytically. Light sampling
//! and BRDF sampling therefore agree exactly.

use std::f32::consts::PI;

use glam::{Vec2, Vec3};

use crate::color::luminance;
use crate::scene::sky::Sky;

/// Emitting surface.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Shape {
    /// Emits outward, equally in all directions.
    Sphere {
        /// Center.
        center: Vec3,
        /// Radius.
        radius: f32,
    },
    /// Emits to the side of `u × v` only.
    Rect {
        /// Corner.
        corner: Vec3,
        /// First edge.
        u: Vec3,
        /// Second edge.
        v: Vec3,
    },
}

/// Emission of the surface.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Emission {
    /// Equal radiance everywhere and in all directions.
    Constant(Vec3),
    /// Environment map behind the surface.
    Sky,
}

/// Area light.
#[derive(Debug, Clone)]
pub(crate) struct Light {
    /// Name in `gt/lights.json`.
    pub(crate) name: String,
    /// Index of the light group.
    pub(crate) group: usize,
    /// Emitting surface.
    pub(crate) shape: Shape,
    /// Emitted radiance.
    pub(crate) emission: Emission,
    /// Id of the instance that owns the light.
    pub(crate) instance: u16,
}

/// Sampled direction towards a light.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Toward {
    /// Unit direction from the shaded point.
    pub(crate) direction: Vec3,
    /// Distance to the light's surface.
    pub(crate) distance: f32,
    /// Probability density per solid angle.
    pub(crate) pdf: f32,
}

impl Light {
    /// Returns the radiance along `direction`, which points towards the light.
    pub(crate) fn radiance(&self, direction: Vec3, sky: &Sky) -> Vec3 {
        match self.emission {
            Emission::Constant(radiance) => radiance,
            Emission::Sky => sky.radiance(direction),
        }
    }

    /// Returns the emitting area.
    pub(crate) fn area(&self) -> f32 {
        match self.shape {
            Shape::Sphere { radius, .. } => 4.0 * PI * radius * radius,
            Shape::Rect { u, v, .. } => u.cross(v).length(),
        }
    }

    /// Returns the outward unit normal at a point of the light.
    pub(crate) fn normal(&self, at: Vec3) -> Vec3 {
        match self.shape {
            Shape::Sphere { center, .. } => (at - center).normalize_or(Vec3::Y),
            Shape::Rect { u, v, .. } => u.cross(v).normalize_or(Vec3::Y),
        }
    }

    /// Returns the distance at which a ray meets the light before `limit`, if any.
    ///
    /// The flag is true if the ray meets the emitting side.
    pub(crate) fn intersect(&self, origin: Vec3, direction: Vec3, limit: f32) -> Option<(f32, bool)> {
        match self.shape {
            Shape::Sphere { center, radius } => {
                let to = center - origin;
                let along = to.dot(direction);
                // The rejection of the vector gives the distance of closest approach: the textbook discriminant cancels
                // for small, distant spheres.
                let off = (to - along * direction).length_squared();
                let inside = radius * radius - off;
                if inside <= 0.0 {
                    return None;
                }
                let t = along - inside.sqrt();
                (t > 1e-4 && t < limit).then_some((t, true))
            }
            Shape::Rect { corner, u, v } => {
                let normal = u.cross(v);
                let slope = direction.dot(normal);
                if slope.abs() < 1e-12 {
                    return None;
                }
                let t = (corner - origin).dot(normal) / slope;
                if !(t > 1e-4 && t < limit) {
                    return None;
                }
                let p = origin + t * direction - corner;
                let (a, b) = (p.dot(u) / u.length_squared(), p.dot(v) / v.length_squared());
                ((0.0..=1.0).contains(&a) && (0.0..=1.0).contains(&b)).then_some((t, slope < 0.0))
            }
        }
    }

    /// Samples a direction towards the light from a point.
    ///
    /// Returns none if the point cannot see the light.
    pub(crate) fn sample(&self, from: Vec3, random: Vec2) -> Option<Toward> {
        match self.shape {
            Shape::Sphere { center, radius } => {
                let to = center - from;
                let d2 = to.length_squared();
                let cap = cap(radius, d2)?;
                let below = random.x * cap;
                let cos = 1.0 - below;
                let sin = (below * (2.0 - below)).max(0.0).sqrt();
                let axis = to / d2.sqrt();
                let (side, up) = axis.any_orthonormal_pair();
                let (s, c) = (2.0 * PI * random.y).sin_cos();
                let direction = (axis * cos + (side * c + up * s) * sin).normalize();
                let along = to.dot(direction);
                let off = (to - along * direction).length_squared();
                Some(Toward {
                    direction,
                    distance: along - (radius * radius - off).max(0.0).sqrt(),
                    pdf: 1.0 / (2.0 * PI * cap),
                })
            }
            Shape::Rect { corner, u, v } => {
                let to = corner + random.x * u + random.y * v - from;
                let d2 = to.length_squared();
                let distance = d2.sqrt();
                let direction = to / distance;
                let normal = u.cross(v);
                let cos_area = -direction.dot(normal);
                (cos_area > 1e-7 && d2 > 1e-8).then(|| Toward { direction, distance, pdf: d2 / cos_area })
            }
        }
    }

    /// Returns the probability density per solid angle of [`Light::sample`].
    ///
    /// The direction must meet the light at `distance`.
    pub(crate) fn pdf(&self, from: Vec3, direction: Vec3, distance: f32) -> f32 {
        match self.shape {
            Shape::Sphere { center, radius } => {
                cap(radius, (center - from).length_squared()).map_or(0.0, |cap| 1.0 / (2.0 * PI * cap))
            }
            Shape::Rect { u, v, .. } => {
                let cos_area = -direction.dot(u.cross(v));
                if cos_area > 1e-7 { distance * distance / cos_area } else { 0.0 }
            }
        }
    }

    /// Estimates the light's contribution to a surface, to choose between lights.
    ///
    /// Zero only where the light certainly contributes nothing.
    pub(crate) fn importance(&self, from: Vec3, normal: Vec3, sky: &Sky) -> f32 {
        let strength = match self.emission {
            Emission::Constant(radiance) => luminance(radiance),
            Emission::Sky => sky.mean(),
        };
        match self.shape {
            Shape::Sphere { center, radius } => {
                let to = center - from;
                let d = to.length().max(radius);
                // The sphere is below the horizon only if its highest point is.
                let height = to.dot(normal) + radius;
                if height <= 0.0 {
                    return 0.0;
                }
                strength * PI * radius * radius * (height / d).max(0.02) / (d * d)
            }
            Shape::Rect { corner, u, v } => {
                let area_normal = u.cross(v);
                let area = area_normal.length();
                let middle = corner + 0.5 * (u + v) - from;
                let facing = -middle.dot(area_normal) / area;
                if facing <= 0.0 {
                    return 0.0;
                }
                let height = [corner, corner + u, corner + v, corner + u + v]
                    .into_iter()
                    .map(|c| (c - from).dot(normal))
                    .fold(middle.dot(normal), f32::max);
                if height <= 0.0 {
                    return 0.0;
                }
                let d2 = middle.length_squared().max(0.25 * area);
                let d = d2.sqrt();
                strength * area * (height / d).clamp(0.02, 1.0) * (facing / d).clamp(0.05, 1.0) / d2
            }
        }
    }
}

/// Returns 1 − cos of the half angle that a sphere subtends, without cancellation.
///
/// Returns none inside the sphere.
fn cap(radius: f32, distance_squared: f32) -> Option<f32> {
    let sin2 = radius * radius / distance_squared;
    (sin2 < 1.0).then(|| sin2 / (1.0 + (1.0 - sin2).sqrt()))
}
