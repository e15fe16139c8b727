//! Cameras on a circle around the center of a scene.

use super::{numbered, up_of};
use glam::{DMat3, DVec3};
use sgs_scene::Camera;

/// Fraction of the cameras that must face a point for it to be the center.
const FACING: f64 = 0.6;

/// Returns `count` level cameras on a circle that look at its center.
///
/// Intrinsics are those of the first training camera. The center is the point nearest to the training cameras'
/// viewing axes. If most cameras face away from that point, for example in the middle of a room, the center is the
/// median of the Gaussians. Height and distance are medians over the training cameras. If all training cameras stand
/// in the same place, the new cameras turn in that place.
pub fn cameras(train: &[Camera], means: &[[f32; 3]], count: u32) -> Vec<Camera> {
    let Some(first) = train.first() else { return Vec::new() };
    let up = up_of(train);
    let mean = train.iter().map(Camera::position).sum::<DVec3>() / train.len() as f64;
    let one_place = train.iter().all(|c| c.position().distance(mean) <= 1e-6 * (1.0 + mean.length()));
    let center = if one_place { mean } else { focus(train).unwrap_or_else(|| middle(means)) };
    let offset = |camera: &Camera| camera.position() - center;
    let level = |v: DVec3| v - up * v.dot(up);
    let height = median(train.iter().map(|c| offset(c).dot(up)).collect());
    let distance = median(train.iter().map(|c| level(offset(c)).length()).collect());
    let in_place = distance <= 1e-6 * (1.0 + center.length());
    let start = if in_place { level(first.forward()) } else { level(offset(first)) };
    let start = start.try_normalize().unwrap_or_else(|| up.any_orthonormal_vector());
    let side = up.cross(start);
    (0..count)
        .map(|i| {
            let (sin, cos) = (std::f64::consts::TAU * f64::from(i) / f64::from(count)).sin_cos();
            let outward = cos * start + sin * side;
            let position = center + height * up + distance * outward;
            let forward = if in_place { outward } else { center - position };
            facing(first, numbered("orbit", i, count), position, forward, up)
        })
        .collect()
}

/// Returns `like` at `position`, looking along `forward` with a level horizon.
fn facing(like: &Camera, name: String, position: DVec3, forward: DVec3, up: DVec3) -> Camera {
    let forward = forward.normalize_or(DVec3::Z);
    let right = forward.cross(up).try_normalize().unwrap_or_else(|| forward.any_orthonormal_vector());
    let rotation = DMat3::from_cols(right, forward.cross(right), forward).transpose();
    Camera { name, rotation, translation: -(rotation * position), ..like.clone() }
}

/// Returns the least-squares intersection of the viewing axes.
///
/// Returns `None` if the axes are parallel or if too few cameras face the point.
fn focus(cameras: &[Camera]) -> Option<DVec3> {
    let (mut matrix, mut right) = (DMat3::ZERO, DVec3::ZERO);
    for camera in cameras {
        let f = camera.forward();
        let across = DMat3::IDENTITY - DMat3::from_cols(f * f.x, f * f.y, f * f.z);
        matrix += across;
        right += across * camera.position();
    }
    // Parallel axes have no nearest point. The determinant grows with the cube of the number of cameras.
    let count = cameras.len() as f64;
    if matrix.determinant() < 1e-4 * count.powi(3) {
        return None;
    }
    let point = matrix.inverse() * right;
    let toward = cameras.iter().filter(|c| (point - c.position()).dot(c.forward()) > 0.0).count();
    (point.is_finite() && toward as f64 >= FACING * count).then_some(point)
}

/// Returns the median of positions for each axis.
fn middle(means: &[[f32; 3]]) -> DVec3 {
    let along = |axis: usize| median(means.iter().map(|m| f64::from(m[axis])).filter(|v| v.is_finite()).collect());
    DVec3::new(along(0), along(1), along(2))
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera(position: DVec3, forward: DVec3) -> Camera {
        let (width, height) = (40, 30);
        let rotation = DMat3::IDENTITY;
        let translation = DVec3::ZERO;
        let like = Camera {
            name: "a".into(),
            width,
            height,
            fx: 30.0,
            fy: 30.0,
            cx: 20.0,
            cy: 15.0,
            rotation,
            translation,
            near: sgs_scene::NEAR,
        };
        facing(&like, "a".into(), position, forward, DVec3::Y)
    }

    /// Returns cameras on an arc of radius 3 at height 1. They face its center (`sign` 1) or away from it (-1).
    fn arc(center: DVec3, sign: f64) -> Vec<Camera> {
        let place = |i: i32| {
            let angle = 0.3 * f64::from(i);
            DVec3::new(3.0 * angle.cos(), 1.0, 3.0 * angle.sin())
        };
        (0..5).map(|i| camera(center + place(i), -sign * place(i))).collect()
    }

    #[test]
    fn orbit_keeps_height_and_distance_and_looks_at_the_center() {
        let center = DVec3::new(1.0, -2.0, 5.0);
        let all = cameras(&arc(center, 1.0), &[[9.0; 3]], 8);
        assert_eq!((all.len(), all[3].name.as_str(), all[0].width), (8, "orbit_003", 40));
        for c in &all {
            let offset = c.position() - center;
            assert!((offset.y - 1.0).abs() < 0.1 && (offset.with_y(0.0).length() - 3.0).abs() < 0.1, "{offset}");
            let pixel = c.project(center).expect("in front");
            assert!((pixel - glam::DVec2::new(20.0, 15.0)).length() < 1.0, "{pixel}");
            // The image's x axis is level, and its y axis points down.
            let to_world = c.rotation.transpose();
            assert!((to_world * DVec3::X).y.abs() < 0.05 && (to_world * DVec3::Y).y < 0.0);
            assert!((c.rotation.determinant() - 1.0).abs() < 1e-9);
        }
    }

    #[test]
    fn outward_cameras_orbit_the_median_of_the_gaussians() {
        let all = cameras(&arc(DVec3::ZERO, -1.0), &[[0.5, 0.0, 0.0]], 4);
        let means = DVec3::new(0.5, 0.0, 0.0);
        assert!(all.iter().all(|c| (means - c.position()).dot(c.forward()) > 2.0));
    }

    #[test]
    fn cameras_in_one_place_turn_in_place() {
        let place = DVec3::new(1.0, 2.0, 3.0);
        let train: Vec<Camera> = [DVec3::X, DVec3::Z, DVec3::NEG_X].map(|f| camera(place, f)).to_vec();
        let all = cameras(&train, &[], 4);
        assert!(all.iter().all(|c| c.position().distance(place) < 1e-9 && c.problem().is_none()));
        assert!((all[0].forward() - DVec3::X).length() < 1e-9 && (all[2].forward() + DVec3::X).length() < 1e-9);
        assert!(cameras(&[], &[], 4).is_empty());
    }
}
