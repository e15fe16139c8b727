//! Gaussian splats in memory, as they are trained and stored: before activation.
//!
//! Scales are logarithms, opacities are logits, quaternions have any length but zero. This crate reads and writes them
//! ([`Splats::read_ply`], [`Splats::write_ply`]) and makes first ones from points ([`Splats::from_points`]); what a
//! value does in an image is not its business.

mod dialect;
mod initial;
mod layout;
mod read;
mod write;

pub use dialect::{ALBEDO_RANGE, PlyDialect, ROUGHNESS_RANGE};

use crate::error::{Result, SceneError};

/// The first spherical harmonic, a constant: `rgb = 0.5 + SH_C0 · dc`.
pub const SH_C0: f32 = 0.282_094_8;

/// A set of splats, structure of arrays.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Splats {
    /// Centers in the world.
    pub means: Vec<[f32; 3]>,
    /// Natural logarithms of the standard deviations along the axes.
    pub log_scales: Vec<[f32; 3]>,
    /// Quaternions `(w, x, y, z)` as stored, not normalized.
    pub rotations: Vec<[f32; 4]>,
    /// Opacities before the logistic function.
    pub opacity_logits: Vec<f32>,
    /// Spherical-harmonics colors by band: band `d` holds `2d + 1` coefficients of three channels for each splat, splat
    /// by splat, coefficient by coefficient, red green blue. Bands above the degree are empty.
    pub sh: [Vec<f32>; 4],
    /// Normals in the world, of any length.
    pub normals: Option<Vec<[f32; 3]>>,
    /// Albedo before activation.
    pub albedo: Option<Vec<[f32; 3]>>,
    /// Roughness before activation.
    pub roughness: Option<Vec<f32>>,
    /// Metallic before activation.
    pub metallic: Option<Vec<f32>>,
    /// Semantic features: their number of channels, and the values splat by splat.
    pub semantic: Option<(usize, Vec<f32>)>,
}

impl Splats {
    /// Number of splats.
    pub fn len(&self) -> usize {
        self.means.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.means.is_empty()
    }

    /// The degree of the spherical harmonics, 0 to 3: that of the highest band present.
    pub fn sh_degree(&self) -> usize {
        self.sh.iter().rposition(|band| !band.is_empty()).unwrap_or(0)
    }

    /// Whether all arrays have the lengths that the number of splats and the degree ask for.
    pub fn check(&self) -> Result<()> {
        let n = self.len();
        let degree = self.sh_degree();
        let mut lengths = vec![
            ("log_scales", self.log_scales.len(), n),
            ("rotations", self.rotations.len(), n),
            ("opacity_logits", self.opacity_logits.len(), n),
        ];
        for (d, band) in self.sh.iter().enumerate().take(degree + 1) {
            lengths.push((["sh[0]", "sh[1]", "sh[2]", "sh[3]"][d], band.len(), n * (2 * d + 1) * 3));
        }
        let three = |v: &Option<Vec<[f32; 3]>>| v.as_ref().map_or(n, Vec::len);
        let one = |v: &Option<Vec<f32>>| v.as_ref().map_or(n, Vec::len);
        lengths.push(("normals", three(&self.normals), n));
        lengths.push(("albedo", three(&self.albedo), n));
        lengths.push(("roughness", one(&self.roughness), n));
        lengths.push(("metallic", one(&self.metallic), n));
        if let Some((channels, values)) = &self.semantic {
            lengths.push(("semantic", values.len(), n.saturating_mul(*channels)));
        }
        match lengths.iter().find(|(_, found, expected)| found != expected) {
            None => Ok(()),
            Some((name, found, expected)) => {
                let problem = format!("{name} has the length {found}, but {n} splats need {expected}");
                Err(SceneError::Data { what: "the splats", problem })
            }
        }
    }
}
