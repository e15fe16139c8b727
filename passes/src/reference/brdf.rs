//! Reference of `brdf.glsl`: reflectance for light from one direction.
//!
//! Lambert; GGX with height-correlated Smith masking, Schlick's Fresnel term (Walter et al. 2007; Heitz 2014; Schlick
//! 1994).

use std::f64::consts::PI;

/// Minimum alpha = roughness².
pub const ALPHA_MIN: f64 = 1e-3;
/// Minimum n·v.
pub const NV_MIN: f64 = 1e-4;

/// Vector.
pub type V3 = [f64; 3];

/// Returns the scalar product.
pub fn dot(a: V3, b: V3) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Returns the vector product.
pub fn cross(a: V3, b: V3) -> V3 {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// Returns `a + t b`.
pub fn along(a: V3, t: f64, b: V3) -> V3 {
    [a[0] + t * b[0], a[1] + t * b[1], a[2] + t * b[2]]
}

/// Returns the unit vector; zero for zero.
pub fn unit(a: V3) -> V3 {
    let size = dot(a, a).sqrt();
    if size > 0.0 { a.map(|x| x / size) } else { a }
}

/// Material of a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Material {
    /// Linear albedo.
    pub albedo: V3,
    /// Square root of alpha.
    pub roughness: f64,
    /// Metallic, 0 to 1.
    pub metallic: f64,
}

/// Returns the diffuse and the specular reflectance. `l` and `v` are unit directions to the light and to the viewer,
/// with n·l > 0.
pub fn brdf(m: Material, n: V3, l: V3, v: V3) -> [V3; 2] {
    let a = (m.roughness * m.roughness).max(ALPHA_MIN).powi(2);
    let h = unit(along(l, 1.0, v));
    let (nl, nv, nh) = (dot(n, l), dot(n, v).max(NV_MIN), dot(n, h));
    let x = cross(n, h);
    let d = a / (PI * (a * nh * nh + dot(x, x)).powi(2));
    let visible = 0.5 / (nv * (a + nl * nl * (1.0 - a)).sqrt() + nl * (a + nv * nv * (1.0 - a)).sqrt());
    let c = (1.0 - dot(l, h)).max(0.0).powi(5);
    let f0 = m.albedo.map(|x| 0.04 * (1.0 - m.metallic) + m.metallic * x);
    let f90 = (25.0 * dot(f0, [0.212671, 0.715160, 0.072169])).min(1.0);
    [m.albedo.map(|x| (1.0 - m.metallic) * x / PI), f0.map(|f| (f + (f90 - f) * c) * d * visible)]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the reflected share of a unit beam from direction v. The first number is that of the specular term alone
    /// with F = 1, the second that of all terms.
    ///
    /// The highlight is integrated over half vectors, drawn by the inverse of GGX's distribution. The integral
    /// therefore needs few points, however narrow the highlight: `dl = 4 (l·h) dh`, and points have density `D (n·h)`.
    fn reflected(m: Material, nv: f64) -> [f64; 2] {
        let v = [(1.0 - nv * nv).sqrt(), 0.0, nv];
        let n = [0.0, 0.0, 1.0];
        let a = (m.roughness * m.roughness).max(ALPHA_MIN).powi(2);
        let count = 256;
        let (mut mirror, mut whole) = (0.0, 0.0);
        for i in 0..count {
            for j in 0..count {
                let (s, t) = ((f64::from(i) + 0.5) / f64::from(count), (f64::from(j) + 0.5) / f64::from(count));
                let nh = ((1.0 - s) / (1.0 + (a - 1.0) * s)).sqrt();
                let (sin, cos) = (2.0 * PI * t).sin_cos();
                let h = [(1.0 - nh * nh).sqrt() * cos, (1.0 - nh * nh).sqrt() * sin, nh];
                let vh = dot(v, h);
                let l = along(v.map(|x| -x), 2.0 * vh, h);
                if vh > 0.0 && l[2] > 0.0 {
                    let density = a / (PI * (a * nh * nh + 1.0 - nh * nh).powi(2)) * nh / (4.0 * vh);
                    let one = Material { albedo: [1.0; 3], metallic: 1.0, ..m };
                    mirror += brdf(one, n, l, v)[1][0] * l[2] / density;
                    whole += brdf(m, n, l, v)[1][0] * l[2] / density;
                }
            }
        }
        let points = f64::from(count * count);
        // The Lambertian term is exactly albedo (1 - metallic).
        [mirror / points, whole / points + m.albedo[0] * (1.0 - m.metallic)]
    }

    #[test]
    fn specular_term_conserves_energy() {
        for roughness in [0.04, 0.09, 0.2, 0.4, 0.6, 0.8, 1.0] {
            for nv in [0.02, 0.1, 0.3, 0.6, 0.9, 1.0] {
                let m = Material { albedo: [1.0; 3], roughness, metallic: 1.0 };
                let [mirror, whole] = reflected(m, nv);
                assert!(mirror <= 1.0 + 1e-3 && mirror > 0.3, "{roughness} {nv}: {mirror}");
                assert!((mirror - whole).abs() < 1e-12);
                // A smooth surface loses no energy.
                assert!(roughness > 0.1 || nv < 0.3 || mirror > 0.98, "{roughness} {nv}: {mirror}");
            }
        }
    }

    /// With the Lambertian term, the excess energy is at most the Fresnel term.
    #[test]
    fn dielectric_exceeds_one_at_most_by_its_fresnel_term() {
        for roughness in [0.09, 0.3, 1.0] {
            for nv in [0.1, 0.5, 1.0] {
                let dark = reflected(Material { albedo: [0.0; 3], roughness, metallic: 0.0 }, nv)[1];
                let painted = reflected(Material { albedo: [0.7; 3], roughness, metallic: 0.0 }, nv)[1];
                assert!((painted - dark - 0.7).abs() < 1e-12 && dark <= 1.0 && painted < 1.7, "{roughness} {nv}");
                assert!(nv < 0.5 || painted < 0.8, "{roughness} {nv}: {painted}");
            }
        }
    }

    #[test]
    fn brdf_is_reciprocal() {
        let n = [0.0, 0.0, 1.0];
        let (l, v) = (unit([0.3, -0.2, 0.6]), unit([-0.7, 0.1, 0.4]));
        let m = Material { albedo: [0.2, 0.5, 0.9], roughness: 0.35, metallic: 0.4 };
        for (a, b) in brdf(m, n, l, v).into_iter().flatten().zip(brdf(m, n, v, l).into_iter().flatten()) {
            assert!((a - b).abs() < 1e-14 * (1.0 + a));
        }
    }
}
