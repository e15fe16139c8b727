//! Unit of length of the computation.
//!
//! Learning rates, loss weights and the near plane are tuned for scenes a few units wide. Scenes in millimeters, or
//! with poses of an arbitrary small scale, are computed in another unit. The unit is a power of two, so conversion and
//! back-conversion preserve every digit of a length.

use crate::camera::Camera;
use crate::splats::Splats;
use std::ops::RangeInclusive;

/// Extents of scenes that are computed in their own unit.
const USUAL: RangeInclusive<f64> = 0.25..=16.0;

/// Approximate extent of other scenes in their unit of computation.
const EXTENT: f64 = 2.0;

/// Largest number of splats sampled to estimate the size of a scene.
const SAMPLES: usize = 4096;

/// Unit of length: its size in scene units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Unit(f64);

impl Unit {
    /// Unit of the scene itself.
    pub const OWN: Unit = Unit(1.0);

    /// Returns the unit for a scene of this extent.
    ///
    /// The extent is that of [`crate::Scene::extent`].
    pub fn of_extent(extent: f64) -> Unit {
        if USUAL.contains(&extent) || !extent.is_normal() || extent < 0.0 {
            return Unit::OWN;
        }
        Unit(2_f64.powi((extent / EXTENT).log2().round().clamp(-60.0, 60.0) as i32))
    }

    /// Creates a unit with this length in scene units.
    pub fn of_length(length: f64) -> Unit {
        Unit(length)
    }

    /// Returns the length of the unit in scene units.
    pub fn length(self) -> f64 {
        self.0
    }

    /// Returns the unit of the inverse conversion.
    #[must_use]
    pub fn inverse(self) -> Unit {
        Unit(1.0 / self.0)
    }

    /// Converts a position to this unit.
    pub fn place(self, [x, y, z]: [f32; 3]) -> [f32; 3] {
        let by = (1.0 / self.0) as f32;
        [x * by, y * by, z * by]
    }
}

impl Unit {
    /// Returns the unit for splats without a scene. The extent is their median distance from their center. Only small
    /// scenes get a unit other than their own.
    pub fn of_splats(splats: &Splats) -> Unit {
        let every = splats.len().div_ceil(SAMPLES).max(1);
        let places = || splats.means.iter().step_by(every).filter(|mean| mean.iter().all(|v| v.is_finite()));
        let median = |mut values: Vec<f64>| {
            let middle = values.len() / 2;
            if values.is_empty() { 0.0 } else { *values.select_nth_unstable_by(middle, f64::total_cmp).1 }
        };
        let center = [0, 1, 2].map(|axis| median(places().map(|mean| f64::from(mean[axis])).collect()));
        let away = |mean: &[f32; 3]| (0..3).map(|c| (f64::from(mean[c]) - center[c]).powi(2)).sum::<f64>().sqrt();
        let unit = Unit::of_extent(median(places().map(away).collect()));
        if unit.0 < 1.0 { unit } else { Unit::OWN }
    }
}

impl Camera {
    /// Returns the camera with lengths converted to a unit.
    #[must_use]
    pub fn in_unit(&self, unit: Unit) -> Camera {
        Camera { translation: self.translation / unit.0, near: self.near / unit.0, ..self.clone() }
    }
}

impl Splats {
    /// Returns the splats with lengths converted to a unit.
    #[must_use]
    pub fn in_unit(mut self, unit: Unit) -> Splats {
        if unit != Unit::OWN {
            let less = unit.0.ln() as f32;
            self.means.iter_mut().for_each(|mean| *mean = unit.place(*mean));
            self.log_scales.iter_mut().flatten().for_each(|scale| *scale -= less);
        }
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_are_powers_of_two_that_scale_extents_to_about_two() {
        for extent in [0.25, 1.0, 3.3, 16.0, 0.0, -1.0, f64::NAN, f64::INFINITY, 1e-320] {
            assert_eq!(Unit::of_extent(extent), Unit::OWN, "{extent}");
        }
        for extent in [1e-12, 3e-4, 0.2, 17.0, 2500.0, 1e12] {
            let unit = Unit::of_extent(extent);
            assert_eq!(unit.length().log2().fract(), 0.0);
            assert!((1.4..=2.9).contains(&(extent / unit.length())), "{extent} in {unit:?}");
            assert_eq!(unit.inverse().inverse(), unit);
        }
    }

    #[test]
    fn unit_conversion_of_splats_is_reversible() {
        let splats = Splats {
            means: vec![[1.3, -200.7, 3e-4], [0.0, 1e6, -7.1]],
            log_scales: vec![[-1.5, 2.25, 0.1]; 2],
            ..Splats::default()
        };
        let unit = Unit::of_extent(1700.0);
        let there = splats.clone().in_unit(unit);
        assert_eq!(there.means[0][1], -200.7 / 1024.0);
        assert!((there.log_scales[0][0] - (-1.5 - 1024_f32.ln())).abs() < 1e-6);
        let back = there.in_unit(unit.inverse());
        assert_eq!(back.means, splats.means);
        let near = |(a, b): (&f32, &f32)| (a - b).abs() < 1e-6;
        assert!(back.log_scales.as_flattened().iter().zip(splats.log_scales.as_flattened()).all(near));
    }
}
