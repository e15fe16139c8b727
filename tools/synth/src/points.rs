//! Sparse point cloud that imitates structure from motion.
//!
//! Points lie on surfaces with small noise. At least two training views see each point, and one of them colors it.

use glam::{Vec2, Vec3};

use crate::color::{byte, encode3};
use crate::rng::Rng;
use crate::scene::Scene;
use crate::trace::camera::Camera;
use crate::trace::denoise::Image;
use crate::trace::film::feature;

/// Surface point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Point {
    /// World position.
    pub(crate) position: Vec3,
    /// Unit normal, towards the camera that saw the point.
    pub(crate) normal: Vec3,
    /// Display color.
    pub(crate) color: [u8; 3],
}

/// Standard deviation of the position noise, as a fraction of the depth.
const POSITION_NOISE: f32 = 0.0015;
/// Standard deviation of the normal noise in radians.
const NORMAL_NOISE: f32 = 0.06;

/// Chooses `count` points, or fewer when the views hardly overlap.
///
/// Two views must see each point; a scene with a single view needs only that view.
pub(crate) fn choose(scene: &Scene, cameras: &[Camera], images: &[Image], count: usize, seed: u64) -> Vec<Point> {
    let needed = cameras.len().min(2);
    let mut points = Vec::with_capacity(count);
    for attempt in 0..20 * count as u64 {
        if points.len() == count {
            break;
        }
        let rng = &mut Rng::new(&[seed, 0x9017, attempt]);
        let view = rng.index(cameras.len());
        let camera = &cameras[view];
        let pixel = Vec2::new(rng.uniform() * camera.width as f32, rng.uniform() * camera.height as f32);
        let seen = feature(scene, camera, pixel);
        if !seen.surface {
            continue;
        }
        let sightings =
            cameras.iter().filter(|other| visible(scene, other, seen.position, seen.normal)).take(needed).count();
        if sightings < needed {
            continue;
        }
        let index = pixel.y as usize * camera.width + pixel.x as usize;
        let color = encode3(images[view][index]).to_array().map(byte);
        points.push(Point {
            position: seen.position + POSITION_NOISE * seen.depth * rng.normal3(),
            normal: (seen.normal + NORMAL_NOISE * rng.normal3()).normalize_or(Vec3::Y),
            color,
        });
    }
    points
}

/// Returns true if a camera sees the front of a surface point.
fn visible(scene: &Scene, camera: &Camera, point: Vec3, normal: Vec3) -> bool {
    let Some(_) = camera.project(point) else {
        return false;
    };
    let start = point + 1e-3 * normal;
    let to = camera.position - start;
    let distance = to.length();
    to.dot(normal) > 0.0 && !scene.surfaces.occluded(start, to / distance, distance)
}
