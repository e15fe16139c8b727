//! Random points for scenes without points.

use glam::{DMat3, DVec2, DVec3};
use rand_pcg::{Pcg32, rand_core::Rng};

use super::PointCloud;
use crate::camera::Camera;

/// Random number generator PCG XSH-RR with 32-bit output and 64-bit state.
#[derive(Clone, Debug)]
pub struct Pcg(Pcg32);

impl Pcg {
    /// Stream of PCG's reference implementation.
    const STREAM: u64 = 1_442_695_040_888_963_407 >> 1;

    /// Creates the generator for a seed.
    pub fn new(seed: u64) -> Self {
        Self(Pcg32::new(seed, Self::STREAM))
    }

    /// Returns 32 random bits.
    pub fn next_u32(&mut self) -> u32 {
        self.0.next_u32()
    }

    /// Returns a uniform number in `[0, 1)`.
    pub fn next_f32(&mut self) -> f32 {
        (self.next_u32() >> 8) as f32 / (1 << 24) as f32
    }
}

/// Axis-aligned box for random points. [`RandomBox::around`] bounds the camera centers and their view frustums, each
/// cut off at one depth.
///
/// Depth is unknown without points. The cut is at twice the extent of the cameras. For cameras around an object, the
/// cut is behind the object. For cameras spread over a room, the cut is roughly at the walls.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RandomBox {
    /// Corner with the smallest coordinates.
    pub min: DVec3,
    /// Corner with the largest coordinates.
    pub max: DVec3,
}

impl RandomBox {
    /// Returns the box around cameras with this extent; `None` without cameras.
    pub fn around<'a>(cameras: impl IntoIterator<Item = &'a Camera>, extent: f64) -> Option<Self> {
        let mut found: Option<Self> = None;
        let mut add = |point: DVec3| {
            let old = found.unwrap_or(Self { min: point, max: point });
            found = Some(Self { min: old.min.min(point), max: old.max.max(point) });
        };
        for camera in cameras {
            add(camera.position());
            let (w, h) = (f64::from(camera.width), f64::from(camera.height));
            for corner in [DVec2::ZERO, DVec2::new(w, 0.0), DVec2::new(0.0, h), DVec2::new(w, h)] {
                add(camera.unproject(corner, 2.0 * extent));
            }
        }
        found
    }

    /// Returns the box of the object that the cameras surround. The center is the point nearest to all optical axes.
    /// Half the side is the smallest half width that any view shows at the center. Returns `None` unless the center is
    /// in front of every camera and the axes pass within a tenth of the mean camera distance.
    pub fn looked_at<'a>(cameras: impl IntoIterator<Item = &'a Camera>) -> Option<Self> {
        let cameras: Vec<&Camera> = cameras.into_iter().collect();
        // The sum of squared distances to the axes is minimal where its gradient is zero.
        let (mut matrix, mut right) = (DMat3::ZERO, DVec3::ZERO);
        for camera in &cameras {
            let axis = camera.forward();
            let across = DMat3::IDENTITY - DMat3::from_cols(axis * axis.x, axis * axis.y, axis * axis.z);
            matrix += across;
            right += across * camera.position();
        }
        if matrix.determinant().abs() < 1e-6 * (cameras.len() as f64).powi(3) {
            return None;
        }
        let center = matrix.inverse() * right;
        let n = cameras.len() as f64;
        let distance = cameras.iter().map(|c| c.position().distance(center)).sum::<f64>() / n;
        let miss = |c: &&Camera| c.forward().cross(center - c.position()).length();
        let ahead = cameras.iter().all(|c| c.forward().dot(center - c.position()) > 0.0);
        if !ahead || cameras.iter().map(miss).sum::<f64>() / n > 0.1 * distance {
            return None;
        }
        let shown = |c: &&Camera| {
            let (w, h) = (f64::from(c.width) / c.fx, f64::from(c.height) / c.fy);
            0.5 * w.min(h) * c.position().distance(center)
        };
        let half = cameras.iter().map(shown).fold(f64::INFINITY, f64::min);
        Some(Self { min: center - half, max: center + half })
    }

    /// Samples `count` uniform points in the box, without colors. The same seed gives the same points.
    pub fn sample(&self, count: usize, seed: u64) -> PointCloud {
        let mut random = Pcg::new(seed);
        let mut coordinate = |k: usize| {
            let t = f64::from(random.next_f32());
            (self.min[k] + (self.max[k] - self.min[k]) * t) as f32
        };
        let positions = (0..count).map(|_| [coordinate(0), coordinate(1), coordinate(2)]).collect();
        PointCloud { positions, colors: None, normals: None }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::tests::camera;

    /// Initial points of a seed, and thus whole trainings, depend on these numbers.
    #[test]
    fn numbers_of_a_seed_never_change() {
        for (seed, expected) in [
            (0, [0xe823_a24e, 0x7a7e_cbd9, 0x89fd_6c06, 0xae64_6aa8]),
            (1, [0x5435_2d7f, 0x6ac2_0236, 0x0768_dd4c, 0x7556_0a43]),
            (u64::MAX, [0xd931_3036, 0xcd4b_6992, 0x7b8e_c69e, 0x999d_d010]),
        ] {
            let mut random = Pcg::new(seed);
            assert_eq!([(); 4].map(|()| random.next_u32()), expected, "{seed}");
        }
    }

    #[test]
    fn numbers_are_seeded_and_uniform() {
        let take = |seed| {
            let mut random = Pcg::new(seed);
            (0..10_000).map(|_| random.next_f32()).collect::<Vec<_>>()
        };
        assert_eq!(take(1), take(1));
        assert_ne!(take(1), take(2));
        let mut bins = [0; 10];
        take(5).iter().for_each(|v| bins[(v * 10.0) as usize] += 1);
        assert!(bins.iter().all(|&n| (900..1100).contains(&n)), "{bins:?}");
    }

    #[test]
    fn box_contains_the_view_frustum() {
        let camera = Camera { rotation: DMat3::IDENTITY, translation: DVec3::ZERO, ..camera() };
        let seen = RandomBox::around([&camera], 1.5).unwrap();
        assert_eq!((seen.min.z, seen.max.z), (0.0, 3.0));
        assert!((seen.min.x + 3.0 * 79.0 / 110.0).abs() < 1e-12);
        assert!((seen.max.y - 3.0 * (120.0 - 62.5) / 115.0).abs() < 1e-12);
        assert_eq!(RandomBox::around([], 1.0), None);
    }

    #[test]
    fn cameras_around_an_object_give_the_box_of_the_object() {
        let center = DVec3::new(0.2, -0.1, 0.3);
        let around = |i: u32| {
            let rotation = DMat3::from_rotation_x(0.3 * f64::from(i % 3)) * DMat3::from_rotation_y(0.8 * f64::from(i));
            let translation = DVec3::new(0.0, 0.0, 4.0) - rotation * center;
            Camera { fx: 220.0, fy: 220.0, cx: 80.0, cy: 60.0, rotation, translation, ..camera() }
        };
        let cameras: Vec<Camera> = (0..9).map(around).collect();
        let seen = RandomBox::looked_at(&cameras).unwrap();
        let half = 4.0 * 60.0 / 220.0;
        assert!(
            (seen.min - (center - half)).length() < 1e-9 && (seen.max - (center + half)).length() < 1e-9,
            "{seen:?}"
        );
        assert_eq!(RandomBox::looked_at(&cameras[..1]), None);
        // Cameras in a room look outward.
        let inside = |c: &Camera| Camera { translation: c.translation - DVec3::new(0.0, 0.0, 6.0), ..c.clone() };
        assert_eq!(RandomBox::looked_at(&cameras.iter().map(inside).collect::<Vec<_>>()), None);
    }

    #[test]
    fn samples_fill_the_box() {
        let seen = RandomBox { min: DVec3::new(-1.0, 2.0, 0.0), max: DVec3::new(1.0, 3.0, 10.0) };
        let cloud = seen.sample(4000, 9);
        assert_eq!(cloud, seen.sample(4000, 9));
        assert_ne!(cloud, seen.sample(4000, 10));
        for k in 0..3 {
            let mean = cloud.positions.iter().map(|p| f64::from(p[k])).sum::<f64>() / 4000.0;
            let size = seen.max[k] - seen.min[k];
            assert!((mean - (seen.min[k] + seen.max[k]) / 2.0).abs() < 0.03 * size);
            assert!(cloud.positions.iter().all(|p| (seen.min[k]..=seen.max[k]).contains(&f64::from(p[k]))));
        }
    }
}
