//! Sizes, parameter layout and initial values of a set of lights.

use sgs_engine::graph::Buffer;

/// Parameterization of lobe axes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Axes {
    /// Two angles, squashed around the centers of a grid of two rows. The grid has one row if the number of lobes is
    /// odd. The polar angle is `center + 3 pi/8 tanh`, the azimuth `center + pi/2 tanh`. This is the published layout;
    /// it does not cover all downward directions.
    #[default]
    Grid,
    /// Vector of any length, normalized on use.
    Free,
}

/// Size of a set of lights.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LightModel {
    /// Number of lights.
    pub lights: u32,
    /// Lobes of a light, at most 32.
    pub lobes: u32,
    /// Parameterization of lobe axes.
    pub axes: Axes,
}

impl Default for LightModel {
    /// Returns 64 lights of 12 lobes on grids.
    fn default() -> Self {
        LightModel { lights: 64, lobes: 12, axes: Axes::Grid }
    }
}

impl LightModel {
    /// Returns whether axes are free vectors.
    pub(super) fn is_free(&self) -> bool {
        self.axes == Axes::Free
    }

    /// Returns the floats of a lobe's row. The row holds the axis (2 or 3), log sharpness and log amplitudes (3).
    pub fn row(&self) -> u32 {
        if self.axes == Axes::Free { 7 } else { 6 }
    }

    /// Returns the bytes of the positions.
    pub fn position_bytes(&self) -> u64 {
        12 * u64::from(self.lights)
    }

    /// Returns the bytes of the lobes.
    pub fn lobe_bytes(&self) -> u64 {
        4 * u64::from(self.lights) * u64::from(self.lobes) * u64::from(self.row())
    }

    /// Returns the bytes of the gains.
    pub fn gain_bytes(&self) -> u64 {
        4 * u64::from(self.lights)
    }

    /// Returns initial positions: a lattice that fills a box, corners included, x fastest. Each axis has as many points
    /// as the cube root of the number of lights, rounded up.
    pub fn start_positions(&self, low: [f32; 3], high: [f32; 3]) -> Vec<[f32; 3]> {
        let side = (1..).find(|s: &u32| s.pow(3) >= self.lights).unwrap_or(1);
        let at = |axis: usize, i: u32| {
            let t = if side > 1 { i as f32 / (side - 1) as f32 } else { 0.5 };
            low[axis] + t * (high[axis] - low[axis])
        };
        (0..self.lights).map(|i| [at(0, i % side), at(1, i / side % side), at(2, i / side / side)]).collect()
    }

    /// Returns initial lobes: the centers of the grid, or a Fibonacci sphere. Sharpness is pi/2, amplitudes are
    /// exp(-4).
    pub fn start_lobes(&self) -> Vec<f32> {
        let rest = [std::f32::consts::FRAC_PI_2.ln(), -4.0, -4.0, -4.0];
        let mut all = Vec::new();
        for lobe in (0..self.lights).flat_map(|_| 0..self.lobes) {
            match self.axes {
                Axes::Grid => all.extend([0.0; 2]),
                Axes::Free => all.extend(fibonacci(lobe, self.lobes)),
            }
            all.extend(rest);
        }
        all
    }
}

/// Returns direction `i` of `count` evenly distributed directions.
fn fibonacci(i: u32, count: u32) -> [f32; 3] {
    let z = 1.0 - (2.0 * f64::from(i) + 1.0) / f64::from(count);
    let azimuth = f64::from(i) * std::f64::consts::PI * (3.0 - 5.0_f64.sqrt());
    let r = (1.0 - z * z).sqrt();
    [(r * azimuth.cos()) as f32, (r * azimuth.sin()) as f32, z as f32]
}

/// Buffers of a set of lights. The first two are trained, each with a gradient of the same shape.
#[derive(Clone, Copy, Debug)]
pub struct LightParameters {
    /// World-space positions, `[lights * 3]`.
    pub positions: Buffer,
    /// Lobes, `[lights * lobes * row]`, see [`LightModel::row`]. Log sharpness is clamped to 9.5, log amplitudes to 15.
    pub lobes: Buffer,
    /// Factors of all amplitudes, `[lights]`. A light with gain 0 is off and costs nothing.
    pub gains: Buffer,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn initial_lights_match_the_published_ones() {
        let model = LightModel::default();
        let positions = model.start_positions([-1.5; 3], [1.5; 3]);
        assert_eq!(positions.len(), 64);
        assert_eq!((positions[0], positions[1], positions[63]), ([-1.5; 3], [-0.5, -1.5, -1.5], [1.5; 3]));
        let lobes = model.start_lobes();
        assert_eq!(4 * lobes.len() as u64, model.lobe_bytes());
        assert_eq!(lobes[..3], [0.0, 0.0, (std::f32::consts::PI / 2.0).ln()]);
    }

    #[test]
    fn free_axes_start_as_evenly_distributed_unit_vectors() {
        let model = LightModel { lights: 2, lobes: 12, axes: Axes::Free };
        let rows = model.start_lobes();
        let mut sum = [0.0_f32; 3];
        for row in rows.chunks(7) {
            let length = row[..3].iter().map(|x| x * x).sum::<f32>();
            assert!((length - 1.0).abs() < 1e-6);
            (0..3).for_each(|i| sum[i] += row[i] / 24.0);
        }
        assert!(sum.iter().all(|s| s.abs() < 0.05), "{sum:?}");
    }

    #[test]
    fn initial_positions_are_distinct_for_any_number_of_lights() {
        for lights in [1, 2, 7, 8, 9, 65] {
            let model = LightModel { lights, ..Default::default() };
            let places = model.start_positions([0.0; 3], [1.0; 3]);
            assert_eq!(places.len(), lights as usize);
            assert!((0..places.len()).all(|i| (0..i).all(|j| places[i] != places[j])));
        }
    }
}
