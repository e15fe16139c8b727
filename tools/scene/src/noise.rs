//! Noise on the inputs of training, to measure the sensitivity of its results.
//!
//! Guarantees: the same seed gives the same noise. Each kind and view has independent noise. Held-out views,
//! photographs and ground truth are never changed.

use glam::{DMat3, DQuat, DVec3};
use half::f16;

use crate::camera::Camera;
use crate::image::Image;
use crate::maps::FeatureMap;
use crate::points::Pcg;

/// Correlation length of normal noise in pixels.
const PATCH: usize = 16;

/// Amount of noise of each kind; 0 for none.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Noise {
    /// Standard deviation of initial point coordinates, relative to the extent.
    pub positions: f64,
    /// Standard deviation of the rotation of normal priors about each axis, in degrees. Normals within 16 pixels rotate
    /// similarly, because errors of networks are spatially correlated.
    pub normals: f64,
    /// Fraction of semantic cells that take the features of another cell of the view.
    pub semantics: f64,
    /// Standard deviation of camera rotation about each axis, in degrees. Applies to training cameras.
    pub rotations: f64,
    /// Standard deviation of camera coordinates, relative to the scene's extent. Applies to training cameras.
    pub translations: f64,
    /// Seed of all noise.
    pub seed: u64,
}

/// Kinds of noise, each with an independent random stream.
#[derive(Clone, Copy)]
enum Kind {
    Positions,
    Normals,
    Semantics,
    Poses,
}

impl Noise {
    /// Returns the random stream of a kind and view.
    fn stream(&self, kind: Kind, view: usize) -> Stream {
        // SplitMix64 decorrelates consecutive seeds.
        let mixed = |n: u64| {
            let z = n.wrapping_add(0x9e37_79b9_7f4a_7c15);
            let z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            z ^ (z >> 31)
        };
        Stream(Pcg::new(mixed(self.seed ^ mixed(mixed(kind as u64) ^ view as u64))))
    }

    /// Moves points; `extent` is the scene's extent.
    pub(crate) fn move_points(&self, points: &mut [[f32; 3]], extent: f64) {
        if self.positions > 0.0 {
            let mut random = self.stream(Kind::Positions, 0);
            for p in points {
                let moved = DVec3::from(p.map(f64::from)) + random.normal3() * (self.positions * extent);
                *p = moved.as_vec3().to_array();
            }
        }
    }

    /// Returns the camera with pose noise; `extent` is the scene's extent.
    pub(crate) fn moved(&self, camera: &Camera, view: usize, extent: f64) -> Camera {
        let mut random = self.stream(Kind::Poses, view);
        let turn = turn(random.normal3() * self.rotations.to_radians());
        let center = camera.position() + random.normal3() * (self.translations * extent);
        let rotation = turn * camera.rotation;
        Camera { rotation, translation: -(rotation * center), ..camera.clone() }
    }

    /// Rotates the normals of a view.
    pub(crate) fn turn_normals(&self, view: usize, normals: &mut Image) {
        if self.normals <= 0.0 {
            return;
        }
        let mut random = self.stream(Kind::Normals, view);
        let (width, height) = (normals.width as usize, normals.height as usize);
        let across = width / PATCH + 2;
        let nodes: Vec<DVec3> = (0..across * (height / PATCH + 2)).map(|_| random.normal3()).collect();
        for (i, n) in normals.data.as_chunks_mut::<3>().0.iter_mut().enumerate() {
            let at = |v: usize| (v / PATCH, (v % PATCH) as f64 / PATCH as f64);
            let ((x, u), (y, v)) = (at(i % width), at(i / width));
            let weights = [(1.0 - u) * (1.0 - v), u * (1.0 - v), (1.0 - u) * v, u * v];
            let first = y * across + x;
            let sum: DVec3 = [0, 1, across, across + 1].iter().zip(weights).map(|(k, w)| nodes[first + k] * w).sum();
            // Interpolation reduces the variance; dividing by the weights' norm restores it.
            let alike = weights.iter().map(|w| w * w).sum::<f64>().sqrt();
            let old = DVec3::from(n.map(f64::from));
            let new = turn(sum / alike * self.normals.to_radians()) * old;
            // Unknown normals stay zero.
            if old != DVec3::ZERO && new.is_finite() {
                *n = new.as_vec3().to_array();
            }
        }
    }

    /// Replaces some cells of a view by the features of other cells.
    pub(crate) fn mix_features(&self, view: usize, map: &mut FeatureMap) {
        let (cells, channels) = (map.width * map.height, map.channels);
        if self.semantics <= 0.0 || cells == 0 {
            return;
        }
        let mut random = self.stream(Kind::Semantics, view);
        let old: Vec<f16> = map.data.clone();
        for cell in map.data.chunks_exact_mut(channels.max(1)) {
            let (chance, other) = (random.uniform(), (random.uniform() * cells as f64) as usize);
            // Rounding may produce 1.
            let other = other.min(cells - 1);
            if chance < self.semantics {
                cell.copy_from_slice(&old[other * channels..][..channels]);
            }
        }
    }
}

/// Returns the rotation about a vector by its length in radians.
fn turn(vector: DVec3) -> DMat3 {
    DMat3::from_quat(DQuat::from_scaled_axis(vector))
}

/// Stream of random numbers.
struct Stream(Pcg);

impl Stream {
    /// Returns a uniform number between 0 and 1, exclusive.
    fn uniform(&mut self) -> f64 {
        (f64::from(self.0.next_u32()) + 0.5) / f64::from(u32::MAX)
    }

    /// Returns three numbers from the standard normal distribution (Box-Muller).
    fn normal3(&mut self) -> DVec3 {
        let mut one = || {
            let (u, v) = (self.uniform(), self.uniform());
            (-2.0 * u.min(1.0).ln()).max(0.0).sqrt() * (std::f64::consts::TAU * v).cos()
        };
        DVec3::new(one(), one(), one())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noise(seed: u64) -> Noise {
        Noise { positions: 0.1, normals: 10.0, semantics: 0.25, rotations: 2.0, translations: 0.1, seed }
    }

    /// Returns the mean and the standard deviation.
    fn spread(values: &[f64]) -> (f64, f64) {
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n;
        (mean, (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n).sqrt())
    }

    #[test]
    fn random_streams_are_normal_and_independent() {
        let draw = |seed, kind, view| {
            let mut stream = noise(seed).stream(kind, view);
            (0..4000).flat_map(|_| stream.normal3().to_array()).collect::<Vec<f64>>()
        };
        let first = draw(1, Kind::Poses, 0);
        let (mean, deviation) = spread(&first);
        assert!(mean.abs() < 0.03 && (deviation - 1.0).abs() < 0.03, "{mean} {deviation}");
        let beyond = first.iter().filter(|v| v.abs() > 2.0).count() as f64 / first.len() as f64;
        assert!((beyond - 0.0455).abs() < 0.008, "{beyond}");
        assert_eq!(first, draw(1, Kind::Poses, 0));
        for other in [draw(2, Kind::Poses, 0), draw(1, Kind::Normals, 0), draw(1, Kind::Poses, 1)] {
            let together: f64 = first.iter().zip(&other).map(|(a, b)| a * b).sum::<f64>() / first.len() as f64;
            assert!(together.abs() < 0.04, "{together}");
        }
    }

    #[test]
    fn normals_rotate_smoothly_by_the_requested_deviation() {
        let (width, height) = (320_u32, 240_u32);
        let mut image = Image::new(width, height, 3);
        image.data.as_chunks_mut::<3>().0.iter_mut().for_each(|n| *n = [0.0, 0.6, -0.8]);
        image.data[..3].fill(0.0);
        let before = image.clone();
        noise(3).turn_normals(5, &mut image);
        assert_eq!(image.data[..3], [0.0; 3]);
        let vectors =
            |image: &Image| image.data.as_chunks::<3>().0.iter().map(|n| DVec3::from(n.map(f64::from))).collect();
        let (old, new): (Vec<DVec3>, Vec<DVec3>) = (vectors(&before), vectors(&image));
        assert!(new[1..].iter().all(|n| (n.length() - 1.0).abs() < 1e-5));
        // Only two of the three rotation axes move a vector, each with a root mean square of 10 degrees.
        let angle = |a: DVec3, b: DVec3| a.angle_between(b).to_degrees();
        let squares = old.iter().zip(&new).skip(1).map(|(a, b)| angle(*a, *b).powi(2)).sum::<f64>() / new.len() as f64;
        assert!((squares.sqrt() - 200.0_f64.sqrt()).abs() < 1.5, "{}", squares.sqrt());
        let steps: Vec<f64> = new[1..].windows(2).map(|n| angle(n[0], n[1])).collect();
        assert!(spread(&steps).0 < 2.0, "{:?}", spread(&steps));
        let mut same = before.clone();
        Noise { normals: 0.0, ..noise(3) }.turn_normals(5, &mut same);
        assert_eq!(same, before);
    }

    #[test]
    fn requested_fraction_of_cells_is_replaced() {
        let whole = |cells: usize| FeatureMap {
            width: cells / 20,
            height: 20,
            channels: 2,
            data: (0..2 * cells).map(|i| f16::from_f32((i / 2) as f32)).collect(),
        };
        let (before, mut after) = (whole(2000), whole(2000));
        noise(3).mix_features(1, &mut after);
        let cells = |map: &FeatureMap| map.data.chunks(2).map(|c| [c[0].to_f32(), c[1].to_f32()]).collect::<Vec<_>>();
        let (old, new) = (cells(&before), cells(&after));
        assert!(new.iter().all(|c| c[0] == c[1] && old.contains(c)), "a cell is torn");
        let changed = old.iter().zip(&new).filter(|(a, b)| a != b).count();
        assert!((420..580).contains(&changed), "{changed}");
    }

    #[test]
    fn cameras_move_by_the_requested_deviation() {
        let camera = Camera {
            name: "a".into(),
            width: 8,
            height: 6,
            fx: 4.0,
            fy: 4.0,
            cx: 4.0,
            cy: 3.0,
            rotation: turn(DVec3::new(0.3, -0.2, 0.9)),
            translation: DVec3::new(1.0, 2.0, 3.0),
            near: crate::camera::NEAR,
        };
        let moved: Vec<Camera> = (0..3000).map(|view| noise(4).moved(&camera, view, 5.0)).collect();
        let along: Vec<f64> = moved.iter().map(|c| (c.position() - camera.position()).x).collect();
        let (mean, deviation) = spread(&along);
        assert!(mean.abs() < 0.03 && (deviation - 0.5).abs() < 0.03, "{mean} {deviation}");
        let angles: Vec<f64> =
            moved.iter().map(|c| c.forward().angle_between(camera.forward()).to_degrees().powi(2)).collect();
        assert!((spread(&angles).0.sqrt() - 8.0_f64.sqrt()).abs() < 0.2, "{:?}", spread(&angles));
        assert!(moved.iter().all(|c| c.problem().is_none()));
        let still = Noise { rotations: 0.0, ..noise(4) }.moved(&camera, 0, 5.0);
        assert!(still.forward().distance(camera.forward()) < 1e-12 && still.fx == camera.fx);
    }
}
