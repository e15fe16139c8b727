//! Radiosity on the host, in double precision, along rays of a transport matrix.

use rayon::prelude::*;
use std::f64::consts::PI;

/// Number of bounces. At a mean reflectance of 0.6, the rest is less than a thousandth.
const ITERATIONS: usize = 14;
/// Number of faces of the enclosure.
pub const FACES: usize = 6;

/// Red, green and blue.
pub type Color = [f64; 3];

/// Radiosity on surfels and patches.
#[derive(Clone, Copy)]
pub struct Radiosity<'a> {
    /// Receiver that each ray meets, `[receivers * rays]`.
    pub targets: &'a [u32],
    /// Rays per receiver.
    pub rays: usize,
    /// Reflectance of the surfels, the first receivers. The others are patches.
    pub surfels: &'a [Color],
    /// Face of each patch.
    pub faces: &'a [u8],
    /// Hemispherical reflectance of a patch's specular lobe, added to its albedo.
    pub sheen: f64,
}

impl Radiosity<'_> {
    /// Returns the reflectance of all receivers.
    pub fn reflectance(&self, enclosure: &[Color; FACES]) -> Vec<Color> {
        let patches = self.faces.iter().map(|f| enclosure[usize::from(*f)].map(|a| (a + self.sheen).min(1.0)));
        self.surfels.iter().copied().chain(patches).collect()
    }

    /// Returns the irradiance of each receiver by bounces. `direct` is the direct irradiance.
    pub fn bounced(&self, direct: &[Color], reflectance: &[Color]) -> Vec<Color> {
        let emitted: Vec<Color> =
            direct.iter().zip(reflectance).map(|(d, r)| [0, 1, 2].map(|c| d[c] * r[c] / PI)).collect();
        let (mut radiosity, mut arriving) = (emitted.clone(), vec![[0.0; 3]; direct.len()]);
        let by = PI / self.rays as f64;
        for _ in 0..ITERATIONS {
            arriving.par_iter_mut().enumerate().with_min_len(256).for_each(|(i, into)| {
                let mut sum = [0.0; 3];
                for met in
                    self.targets[i * self.rays..(i + 1) * self.rays].iter().filter_map(|j| radiosity.get(*j as usize))
                {
                    [0, 1, 2].iter().for_each(|&c| sum[c] += met[c]);
                }
                *into = sum.map(|v| by * v);
            });
            let next = |((a, r), e): ((&Color, &Color), &Color)| [0, 1, 2].map(|c| e[c] + r[c] * a[c] / PI);
            radiosity = arriving.iter().zip(reflectance).zip(&emitted).map(next).collect();
        }
        arriving
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// Returns the receivers that rays meet in a room, by a simple generator.
    pub(crate) fn targets(receivers: usize, rays: usize) -> Vec<u32> {
        let mut state = 1_u64;
        let mut next = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as usize
        };
        (0..receivers * rays).map(|_| (next() % receivers) as u32).collect()
    }

    #[test]
    fn closed_room_of_one_color_is_a_geometric_series() {
        let (targets, surfels) = (targets(46, 8), vec![[0.5; 3]; 40]);
        let room = Radiosity { targets: &targets, rays: 8, surfels: &surfels, faces: &[0, 1, 2, 3, 4, 5], sheen: 0.0 };
        let arriving = room.bounced(&[[1.0; 3]; 46], &room.reflectance(&[[0.5; 3]; FACES]));
        // 0.5 + 0.25 + ..., cut after ITERATIONS terms.
        let series = 1.0 - 0.5_f64.powi(ITERATIONS as i32);
        assert!(arriving.iter().flatten().all(|a| (a - series).abs() < 1e-12), "{arriving:?}");
    }
}
