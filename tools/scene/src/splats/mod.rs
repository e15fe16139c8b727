//! Gaussian splats in memory: values before activation, as trained and stored.
//!
//! Scales are logarithms, opacities are logits, and quaternions have any nonzero length. This crate reads and writes
//! splats ([`Splats::read_ply`], [`Splats::write_ply`]) and creates initial ones from points ([`Splats::from_points`]).
//! Rendering is not part of this crate.

mod comments;
mod dialect;
mod file;
mod initial;
mod layout;
mod read;
mod write;

pub use dialect::{ALBEDO_RANGE, PlyDialect, ROUGHNESS_RANGE};
pub use file::SplatFile;

use crate::error::{Result, SceneError};

/// Constant of spherical-harmonics band 0: `rgb = 0.5 + SH_C0 · dc`.
pub const SH_C0: f32 = 0.282_094_8;

/// Maximum number of emitters of a scene.
pub const MOST_EMITTERS: u32 = 4096;

/// Set of splats as a structure of arrays.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Splats {
    /// Centers in world space.
    pub means: Vec<[f32; 3]>,
    /// Natural logarithms of the standard deviations along the local axes.
    pub log_scales: Vec<[f32; 3]>,
    /// Quaternions `(w, x, y, z)` as stored, not normalized.
    pub rotations: Vec<[f32; 4]>,
    /// Opacities before the logistic function.
    pub opacity_logits: Vec<f32>,
    /// Spherical-harmonics colors by band. Band `d` holds `2d + 1` RGB coefficients per splat, ordered by splat,
    /// coefficient and channel. Bands above the degree are empty.
    pub sh: [Vec<f32>; 4],
    /// World-space normals of any length.
    pub normals: Option<Vec<[f32; 3]>>,
    /// Albedo before activation.
    pub albedo: Option<Vec<[f32; 3]>>,
    /// Roughness before activation.
    pub roughness: Option<Vec<f32>>,
    /// Metallic before activation.
    pub metallic: Option<Vec<f32>>,
    /// Semantic features: number of channels, and values ordered by splat.
    pub semantic: Option<(usize, Vec<f32>)>,
    /// Emitter that each splat belongs to: 0 emits nothing, `i + 1` belongs to emitter `i` of `emitters.json`.
    /// At most [`MOST_EMITTERS`].
    pub emitters: Option<Vec<u32>>,
    /// Factor above 0 on the light that arrives from emitters and by bounces.
    pub light_gains: Option<Vec<f32>>,
    /// Whether the splats are for the 2D Mip filter. Renderers then scale opacities by the root of the ratio of the projected
    /// covariance's determinants without and with the 0.3 px² of dilation.
    pub antialiased: bool,
}

impl Splats {
    /// Returns the number of splats.
    pub fn len(&self) -> usize {
        self.means.len()
    }

    /// Returns whether the set is empty.
    pub fn is_empty(&self) -> bool {
        self.means.is_empty()
    }

    /// Returns the degree of the spherical harmonics, 0 to 3. The degree is the highest band with values.
    pub fn sh_degree(&self) -> usize {
        self.sh.iter().rposition(|band| !band.is_empty()).unwrap_or(0)
    }

    /// Returns the `keep` most opaque splats in their original order. Of equally opaque splats, the first ones remain.
    #[must_use]
    pub fn strongest(&self, keep: usize) -> Splats {
        let mut order: Vec<usize> = (0..self.len()).collect();
        order.sort_by(|a, b| self.opacity_logits[*b].total_cmp(&self.opacity_logits[*a]));
        order.truncate(keep);
        order.sort_unstable();
        fn of<T: Copy>(order: &[usize], values: &[T], width: usize) -> Vec<T> {
            order.iter().filter_map(|i| values.get(i * width..(i + 1) * width)).flatten().copied().collect()
        }
        let three = |v: &Option<Vec<[f32; 3]>>| v.as_ref().map(|v| of(&order, v, 1));
        let one = |v: &Option<Vec<f32>>| v.as_ref().map(|v| of(&order, v, 1));
        Splats {
            means: of(&order, &self.means, 1),
            log_scales: of(&order, &self.log_scales, 1),
            rotations: of(&order, &self.rotations, 1),
            opacity_logits: of(&order, &self.opacity_logits, 1),
            sh: [0, 1, 2, 3].map(|d| of(&order, &self.sh[d], (2 * d + 1) * 3)),
            normals: three(&self.normals),
            albedo: three(&self.albedo),
            roughness: one(&self.roughness),
            metallic: one(&self.metallic),
            semantic: self.semantic.as_ref().map(|(channels, v)| (*channels, of(&order, v, *channels))),
            emitters: self.emitters.as_ref().map(|v| of(&order, v, 1)),
            light_gains: one(&self.light_gains),
            antialiased: self.antialiased,
        }
    }

    /// Checks the lengths of all arrays, the emitters and the light gains.
    ///
    /// Lengths must match the number of splats and the degree.
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
        lengths.push(("emitters", self.emitters.as_ref().map_or(n, Vec::len), n));
        lengths.push(("light_gains", one(&self.light_gains), n));
        if let Some(bad) = self.light_gains.iter().flatten().find(|g| !(**g > 0.0 && g.is_finite())) {
            let problem = format!("a splat has the light gain {bad}; use a number above 0");
            return Err(SceneError::Data { what: "the splats", problem });
        }
        if let Some(bad) = self.emitters.iter().flatten().find(|e| **e > MOST_EMITTERS) {
            let problem = format!("a splat belongs to emitter {bad}, but there are {MOST_EMITTERS} at most");
            return Err(SceneError::Data { what: "the splats", problem });
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

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// Returns splats whose parameters follow sines.
    pub(crate) fn waves(n: usize, degree: usize) -> Splats {
        let wave = |k: usize, step: f64, low: f64, high: f64| {
            (0..k).map(|i| (low + (high - low) * (0.5 + 0.5 * (step * i as f64).sin())) as f32).collect::<Vec<f32>>()
        };
        Splats {
            means: wave(3 * n, 1.7, -30.0, 4.0).as_chunks::<3>().0.to_vec(),
            log_scales: wave(3 * n, 2.3, -7.0, 1.0).as_chunks::<3>().0.to_vec(),
            rotations: wave(4 * n, 0.9, -2.0, 2.0).as_chunks::<4>().0.to_vec(),
            opacity_logits: wave(n, 3.1, -5.0, 5.0),
            sh: std::array::from_fn(
                |d| if d <= degree { wave(n * 3 * (2 * d + 1), 1.1, -0.9, 0.9) } else { Vec::new() },
            ),
            ..Splats::default()
        }
    }

    #[test]
    fn most_opaque_splats_keep_their_order_and_values() {
        let n = 5;
        let numbers = |width: usize| (0..n * width).map(|i| i as f32).collect::<Vec<_>>();
        let triples = || numbers(3).as_chunks::<3>().0.to_vec();
        let all = Splats {
            means: triples(),
            log_scales: triples(),
            rotations: numbers(4).as_chunks::<4>().0.to_vec(),
            opacity_logits: vec![0.5, 3.0, -1.0, 3.0, 0.5],
            sh: [numbers(3), numbers(9), numbers(15), Vec::new()],
            normals: Some(triples()),
            albedo: None,
            roughness: Some(numbers(1)),
            metallic: None,
            semantic: Some((2, numbers(2))),
            emitters: Some(vec![0, 7, 0, 2, 4096]),
            light_gains: Some(vec![1.0, 0.5, 3.0, 0.25, 2.0]),
            antialiased: true,
        };
        let some = all.strongest(3);
        some.check().unwrap();
        assert_eq!(some.emitters, Some(vec![0, 7, 2]));
        assert_eq!((some.light_gains, some.antialiased), (Some(vec![1.0, 0.5, 0.25]), true));
        assert_eq!(some.opacity_logits, [0.5, 3.0, 3.0]);
        assert_eq!(some.means, [all.means[0], all.means[1], all.means[3]]);
        assert_eq!(some.sh[1], [&all.sh[1][..18], &all.sh[1][27..36]].concat());
        assert_eq!(
            (some.roughness.unwrap(), some.semantic.unwrap().1),
            (vec![0.0, 1.0, 3.0], vec![0.0, 1.0, 2.0, 3.0, 6.0, 7.0])
        );
        assert!(all.strongest(9) == all && all.strongest(0).is_empty());
    }
}
