//! Reference of `transport_source` and of `irradiance_blend_bwd`.

use super::V3;
use std::f64::consts::PI;

/// Hemispherical reflectance of a patch's specular lobe.
const SHEEN: f64 = 0.03;
/// Cosine between normal and viewer that stands for all directions.
const FACING: f64 = 0.6;

/// Material of a surfel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SurfelMaterial {
    /// Linear albedo.
    pub albedo: V3,
    /// Roughness.
    pub roughness: f64,
    /// Metallic.
    pub metallic: f64,
}

/// Parameters of a room.
#[derive(Clone, Debug, Default)]
pub struct RoomParameters {
    /// Materials of the surfels.
    pub surfels: Vec<SurfelMaterial>,
    /// Raw albedo of the faces of the enclosure.
    pub enclosure: Vec<V3>,
    /// Face of each patch.
    pub faces: Vec<usize>,
    /// Irradiance of each receiver from each light of color 1, by light.
    pub unit: Vec<Vec<f64>>,
    /// Logarithms of the colors of the lights.
    pub log_colors: Vec<V3>,
}

/// Reflectance and source of all receivers.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RoomSource {
    /// Reflectance.
    pub reflectance: Vec<V3>,
    /// Reflected direct light, as a radiance.
    pub source: Vec<V3>,
}

/// Returns the hemispherical reflectance of a surfel: diffuse, and the split sum as Karis (2014) approximates it.
pub fn reflectance(m: &SurfelMaterial) -> V3 {
    let r = m.roughness;
    let q = [1.0 - r, 0.0425 - 0.0275 * r, 1.04 - 0.572 * r, 0.022 * r - 0.04];
    let a = (q[0] * q[0]).min((-9.28 * FACING).exp2()) * q[0] + q[1];
    let (scale, bias) = (q[2] - 1.04 * a, q[3] + 1.04 * a);
    m.albedo.map(|albedo| {
        let specular = (0.04 * (1.0 - m.metallic) + albedo * m.metallic) * scale + bias;
        (albedo * (1.0 - m.metallic) + specular.max(0.0)).min(1.0)
    })
}

/// Returns reflectance and source of all receivers.
pub fn source(p: &RoomParameters) -> RoomSource {
    let face = |face: &usize| p.enclosure[*face].map(|raw| (1.0 / (1.0 + (-raw).exp()) + SHEEN).min(1.0));
    let of_surfels = p.surfels.iter().map(reflectance);
    let reflectance: Vec<V3> = of_surfels.chain(p.faces.iter().map(face)).collect();
    let direct = |i: usize| -> V3 {
        std::array::from_fn(|k| p.unit.iter().zip(&p.log_colors).map(|(unit, c)| unit[i] * c[k].exp()).sum())
    };
    let source = reflectance.iter().enumerate().map(|(i, rho)| {
        let direct = direct(i);
        std::array::from_fn(|k| rho[k] * direct[k] / PI)
    });
    RoomSource { source: source.collect(), reflectance: reflectance.clone() }
}

/// Returns the irradiance and gain of a pixel: the weighted sum of the Gaussians', with the gain as fourth number.
///
/// `row` holds Gaussians and weights, `irradiance` and `log_gains` the values of all Gaussians.
pub fn blend(row: &[(usize, f64)], irradiance: &[V3], log_gains: &[f64]) -> [f64; 4] {
    let mut sum = [0.0; 4];
    for (gaussian, weight) in row {
        (0..3).for_each(|k| sum[k] += weight * irradiance[*gaussian][k]);
        sum[3] += weight * log_gains[*gaussian].exp();
    }
    sum
}
