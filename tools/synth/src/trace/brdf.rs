//! BRDF: Lambert plus GGX.
//!
//! Shadowing is height-correlated Smith; Fresnel is Schlick's term. alpha = roughness². F0 = 0.04 for dielectrics and
//! the base color for metals. F90 = min(1, 25 · luminance(F0)). All vectors are in world space, have unit length and
//! point away from the surface.

use std::f32::consts::PI;

use glam::{Vec2, Vec3};

use crate::color::luminance;
use crate::scene::material::Reflectance;

/// Lower bound of alpha: narrower highlights exceed single precision.
const ALPHA_MIN: f32 = 2e-3;

/// BRDF at a surface point for a fixed view direction.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Brdf {
    normal: Vec3,
    view: Vec3,
    diffuse: Vec3,
    f0: Vec3,
    f90: f32,
    alpha: f32,
    nv: f32,
    /// Probability of choosing the specular lobe.
    choice: f32,
}

/// Both lobes for one direction, including the cosine, and its sampling density.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Lobes {
    /// Diffuse lobe.
    pub(crate) diffuse: Vec3,
    /// Specular lobe.
    pub(crate) specular: Vec3,
    /// Probability density per solid angle of [`Brdf::sample`].
    pub(crate) pdf: f32,
}

impl Lobes {
    /// Returns the sum of both lobes.
    pub(crate) fn total(&self) -> Vec3 {
        self.diffuse + self.specular
    }
}

impl Brdf {
    /// Prepares a surface seen along `view`, which must lie on the normal's side.
    pub(crate) fn new(reflectance: &Reflectance, normal: Vec3, view: Vec3) -> Self {
        let f0 = reflectance.f0();
        let f90 = (25.0 * luminance(f0)).min(1.0);
        let nv = normal.dot(view).clamp(1e-4, 1.0);
        let fresnel = f0 + (Vec3::splat(f90) - f0) * (1.0 - nv).powi(5);
        let (s, d) = (luminance(fresnel), luminance(reflectance.diffuse()));
        let choice = if s <= 0.0 {
            0.0
        } else if d <= 0.0 {
            1.0
        } else {
            (s / (s + d)).clamp(0.15, 0.85)
        };
        Self {
            normal,
            view,
            diffuse: reflectance.diffuse(),
            f0,
            f90,
            alpha: (reflectance.roughness * reflectance.roughness).max(ALPHA_MIN),
            nv,
            choice,
        }
    }

    /// Evaluates both lobes for a direction.
    pub(crate) fn eval(&self, light: Vec3) -> Lobes {
        let nl = self.normal.dot(light);
        if nl <= 1e-6 {
            return Lobes::default();
        }
        let diffuse = self.diffuse * (nl / PI);
        let diffuse_pdf = (1.0 - self.choice) * nl / PI;
        if self.choice == 0.0 {
            return Lobes { diffuse, specular: Vec3::ZERO, pdf: diffuse_pdf };
        }
        let half = (light + self.view).normalize_or(self.normal);
        let nh = self.normal.dot(half).clamp(0.0, 1.0);
        let lh = light.dot(half).clamp(0.0, 1.0);
        let a2 = self.alpha * self.alpha;
        // |n × h|² instead of 1 − (n·h)², which cancels near the peak of a narrow highlight.
        let base = a2 * nh * nh + self.normal.cross(half).length_squared();
        let d = a2 / (PI * base * base);
        let (sv, sl) = (self.smith(self.nv), self.smith(nl));
        let v = 0.5 / (nl * sv + self.nv * sl);
        let fresnel = self.f0 + (Vec3::splat(self.f90) - self.f0) * (1.0 - lh).powi(5);
        Lobes { diffuse, specular: fresnel * (d * v * nl), pdf: diffuse_pdf + self.choice * d / (2.0 * (self.nv + sv)) }
    }

    /// Returns √(α² + (1 − α²) x²).
    fn smith(&self, x: f32) -> f32 {
        let a2 = self.alpha * self.alpha;
        (a2 + (1.0 - a2) * x * x).sqrt()
    }

    /// Samples a direction. Returns none if the direction points into the surface.
    pub(crate) fn sample(&self, lobe: f32, random: Vec2) -> Option<(Vec3, Lobes)> {
        let (side, up) = self.normal.any_orthonormal_pair();
        let (sin, cos) = (2.0 * PI * random.x).sin_cos();
        let direction = if lobe < self.choice {
            let to_local = |w: Vec3| Vec3::new(w.dot(side), w.dot(up), w.dot(self.normal));
            let view = to_local(self.view);
            // Samples visible normals: stretch the view to unit roughness, take a uniform point of the spherical cap
            // visible from there, and transform back.
            let stretched = Vec3::new(self.alpha * view.x, self.alpha * view.y, view.z).normalize();
            let z = (1.0 - random.y) * (1.0 + stretched.z) - stretched.z;
            let r = (1.0 - z * z).max(0.0).sqrt();
            let cap = Vec3::new(r * cos, r * sin, z) + stretched;
            let h = Vec3::new(self.alpha * cap.x, self.alpha * cap.y, cap.z.max(1e-6)).normalize();
            let half = side * h.x + up * h.y + self.normal * h.z;
            2.0 * self.view.dot(half) * half - self.view
        } else {
            let r = random.y.sqrt();
            let z = (1.0 - random.y).max(0.0).sqrt();
            side * (r * cos) + up * (r * sin) + self.normal * z
        };
        let direction = direction.normalize();
        let lobes = self.eval(direction);
        (lobes.pdf > 1e-8).then_some((direction, lobes))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::Rng;

    fn reflectance(albedo: f32, roughness: f32, metallic: f32) -> Reflectance {
        Reflectance { albedo: Vec3::splat(albedo), roughness, metallic, specular: 1.0 }
    }

    /// Returns the reflected energy of a view angle, sampled and by a hemisphere grid.
    fn albedos(brdf: &Brdf) -> (f32, f32) {
        let mut rng = Rng::new(&[5]);
        let n = 20_000;
        let sampled = (0..n)
            .filter_map(|_| brdf.sample(rng.uniform(), Vec2::new(rng.uniform(), rng.uniform())))
            .map(|(_, l)| l.total().x / l.pdf)
            .sum::<f32>()
            / n as f32;
        let (nt, np) = (400, 128);
        let mut grid = 0.0;
        for i in 0..nt {
            let z = (i as f32 + 0.5) / nt as f32;
            let r = (1.0 - z * z).sqrt();
            for k in 0..np {
                let (s, c) = (2.0 * PI * (k as f32 + 0.5) / np as f32).sin_cos();
                grid += brdf.eval(Vec3::new(r * c, r * s, z)).total().x;
            }
        }
        (sampled, grid * 2.0 * PI / (nt * np) as f32)
    }

    #[test]
    fn sampling_matches_integration_and_conserves_energy() {
        for roughness in [0.35, 0.6, 1.0] {
            for metallic in [0.0, 1.0] {
                for view in [0.3f32, 0.9] {
                    let v = Vec3::new((1.0 - view * view).sqrt(), 0.0, view);
                    let brdf = Brdf::new(&reflectance(0.9, roughness, metallic), Vec3::Z, v);
                    let (sampled, grid) = albedos(&brdf);
                    assert!(
                        (sampled - grid).abs() < 0.015,
                        "roughness {roughness} metallic {metallic} view {view}: {sampled} {grid}"
                    );
                    assert!(grid < 1.06 && grid > 0.25, "{grid}");
                }
            }
        }
    }

    #[test]
    fn albedo_of_roughest_metal_matches_closed_form() {
        // At alpha = 1 the distribution is flat and the albedo is 1 − x ln((1 + x) / x), with x the cosine of the view.
        for x in [0.3f32, 0.9] {
            let v = Vec3::new((1.0 - x * x).sqrt(), 0.0, x);
            let brdf = Brdf::new(&reflectance(1.0, 1.0, 1.0), Vec3::Z, v);
            let truth = 1.0 - x * ((1.0 + x) / x).ln();
            let (_, grid) = albedos(&brdf);
            assert!((grid - truth).abs() < 2e-3, "{grid} {truth}");
        }
    }

    #[test]
    fn smooth_white_metal_has_albedo_one() {
        let v = Vec3::new(0.6, 0.0, 0.8);
        let brdf = Brdf::new(&reflectance(1.0, 0.06, 1.0), Vec3::Z, v);
        let (sampled, _) = albedos(&brdf);
        assert!((sampled - 1.0).abs() < 5e-3, "{sampled}");
    }

    #[test]
    fn brdf_is_reciprocal() {
        let (a, b) = (Vec3::new(0.5, 0.2, 0.7).normalize(), Vec3::new(-0.6, 0.1, 0.4).normalize());
        let r = reflectance(0.5, 0.3, 0.3);
        let there = Brdf::new(&r, Vec3::Z, a).eval(b).total() / b.z;
        let back = Brdf::new(&r, Vec3::Z, b).eval(a).total() / a.z;
        assert!((there - back).length() < 1e-4 * there.length(), "{there} {back}");
    }
}
