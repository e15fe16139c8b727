//! Cameras on a smooth path through the training cameras.

use super::numbered;
use glam::{DMat3, DQuat, DVec3, DVec4};
use sgs_scene::Camera;

/// Minimum number of frames between two key cameras; denser captures contribute every n-th camera.
const FRAMES_PER_KEY: u32 = 6;

/// Number of cameras up to which the order is improved beyond the nearest neighbor.
const IMPROVED: usize = 400;

/// Pose from camera to world space.
#[derive(Clone, Copy, Debug)]
struct Key {
    position: DVec3,
    rotation: DVec4,
}

/// Returns `frames` cameras along a path, with the first camera's intrinsics.
///
/// The path visits training cameras in the order of their names, or in a clearly shorter order if one is found, as
/// for unordered photographs. Position and orientation follow Catmull-Rom curves with a constant rate of translation
/// and rotation.
pub fn cameras(train: &[Camera], frames: u32) -> Vec<Camera> {
    let Some(like) = train.first() else { return Vec::new() };
    let keys = keys(train, (frames / FRAMES_PER_KEY).max(2) as usize);
    let at = speeds(&keys);
    let total = at.last().copied().unwrap_or(0.0);
    let pose = |i: u32| {
        let s = total * f64::from(i) / f64::from(frames.max(2) - 1);
        let k = at.partition_point(|a| *a <= s).clamp(1, at.len().max(2) - 1) - 1;
        if keys.len() < 2 { keys[0] } else { between(&keys, &at, k, s) }
    };
    (0..frames)
        .map(|i| {
            let Key { position, rotation } = pose(i);
            let to_world = DMat3::from_quat(DQuat::from_vec4(rotation).normalize());
            let rotation = to_world.transpose();
            let name = numbered("path", i, frames);
            Camera { name, rotation, translation: -(rotation * position), ..like.clone() }
        })
        .collect()
}

/// Returns at most `most` key poses in order. Consecutive quaternions have a non-negative dot product.
fn keys(train: &[Camera], most: usize) -> Vec<Key> {
    let order = order(train);
    let count = order.len().min(most);
    let mut keys: Vec<Key> = Vec::with_capacity(count);
    for i in 0..count {
        let camera = &train[order[i * (order.len() - 1) / (count - 1).max(1)]];
        let rotation = DVec4::from(DQuat::from_mat3(&camera.rotation.transpose()).normalize().to_array());
        let turned = keys.last().is_some_and(|last| last.rotation.dot(rotation) < 0.0);
        keys.push(Key { position: camera.position(), rotation: if turned { -rotation } else { rotation } });
    }
    keys
}

/// Returns the distance of two cameras: positions, plus `radius` times the difference of directions.
fn apart(a: &Camera, b: &Camera, radius: f64) -> f64 {
    a.position().distance(b.position()) + radius * (a.forward() - b.forward()).length()
}

/// Returns the order of the names, or a clearly shorter one.
///
/// Another order is taken if its path is shorter than 0.8 of the path in order of the names.
fn order(train: &[Camera]) -> Vec<usize> {
    let named: Vec<usize> = (0..train.len()).collect();
    let mean: DVec3 = train.iter().map(Camera::position).sum::<DVec3>() / train.len().max(1) as f64;
    let radius = train.iter().map(|c| c.position().distance(mean)).fold(0.0, f64::max);
    let cost = |a: usize, b: usize| apart(&train[a], &train[b], 0.5 * radius);
    let length = |order: &[usize]| order.windows(2).map(|w| cost(w[0], w[1])).sum::<f64>();
    let mut left: Vec<usize> = (1..train.len()).collect();
    let mut near = vec![0];
    while !left.is_empty() {
        let last = near[near.len() - 1];
        let best = (0..left.len()).min_by(|&a, &b| cost(last, left[a]).total_cmp(&cost(last, left[b]))).unwrap_or(0);
        near.push(left.remove(best));
    }
    // 2-opt: reverses sections while this shortens the path.
    let mut shorter = near.len() <= IMPROVED;
    while shorter {
        shorter = false;
        for i in 1..near.len() {
            for j in i + 1..near.len() {
                let behind = |a: usize| near.get(j + 1).map_or(0.0, |&n| cost(near[a], n));
                let gain = cost(near[i - 1], near[i]) + behind(j) - cost(near[i - 1], near[j]) - behind(i);
                if gain > 1e-9 * (1.0 + radius) {
                    near[i..=j].reverse();
                    shorter = true;
                }
            }
        }
    }
    if length(&near) < 0.8 * length(&named) { near } else { named }
}

/// Returns the parameter of each key along the path.
///
/// Translation and rotation contribute equally over the whole path.
fn speeds(keys: &[Key]) -> Vec<f64> {
    let moved = |w: &[Key]| w[0].position.distance(w[1].position);
    let turned = |w: &[Key]| 2.0 * w[0].rotation.dot(w[1].rotation).clamp(-1.0, 1.0).acos();
    let sum = |of: &dyn Fn(&[Key]) -> f64| keys.windows(2).map(of).sum::<f64>().max(1e-12);
    let (way, turn) = (sum(&moved), sum(&turned));
    let mut at = vec![0.0];
    for w in keys.windows(2) {
        // Keys in the same place would divide by zero.
        let step = (moved(w) / way + turned(w) / turn).max(1e-9);
        at.push(at[at.len() - 1] + step);
    }
    at
}

/// Returns the pose at `s` between key `k` and the next.
fn between(keys: &[Key], at: &[f64], k: usize, s: f64) -> Key {
    let (a, b) = (k.saturating_sub(1), (k + 2).min(keys.len() - 1));
    let width = at[k + 1] - at[k];
    let t = ((s - at[k]) / width).clamp(0.0, 1.0);
    let (t2, t3) = (t * t, t * t * t);
    let weights = [2.0 * t3 - 3.0 * t2 + 1.0, t3 - 2.0 * t2 + t, 3.0 * t2 - 2.0 * t3, t3 - t2];
    // Tangents are the slopes between the neighbors, in units of this interval.
    let (from, to) = (width / (at[k + 1] - at[a]), width / (at[b] - at[k]));
    let [p, q] = [&keys[k], &keys[k + 1]];
    let position = weights[0] * p.position
        + weights[1] * from * (q.position - keys[a].position)
        + weights[2] * q.position
        + weights[3] * to * (keys[b].position - p.position);
    let rotation = weights[0] * p.rotation
        + weights[1] * from * (q.rotation - keys[a].rotation)
        + weights[2] * q.rotation
        + weights[3] * to * (keys[b].rotation - p.rotation);
    Key { position, rotation }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns cameras along an arc of 1.5 rad that look at its center.
    fn walk(count: usize) -> Vec<Camera> {
        (0..count)
            .map(|i| {
                let angle = 1.5 * i as f64 / (count - 1) as f64;
                let rotation = DMat3::from_rotation_y(angle);
                let position = rotation.transpose() * DVec3::new(0.0, 0.0, -4.0);
                Camera {
                    name: format!("{i:02}"),
                    width: 8,
                    height: 6,
                    fx: 6.0,
                    fy: 6.0,
                    cx: 4.0,
                    cy: 3.0,
                    rotation,
                    translation: -(rotation * position),
                    near: sgs_scene::NEAR,
                }
            })
            .collect()
    }

    #[test]
    fn path_begins_and_ends_at_training_cameras_and_is_smooth() {
        let train = walk(7);
        let path = cameras(&train, 61);
        assert_eq!((path.len(), path[60].name.as_str()), (61, "path_060"));
        for (a, b) in [(&path[0], &train[0]), (&path[60], &train[6])] {
            assert!(a.position().distance(b.position()) < 1e-9 && a.forward().distance(b.forward()) < 1e-9);
        }
        let steps: Vec<f64> = path.windows(2).map(|w| w[0].position().distance(w[1].position())).collect();
        let mean = steps.iter().sum::<f64>() / 60.0;
        assert!(steps.iter().all(|s| (s / mean - 1.0).abs() < 0.3), "{steps:?}");
        // Interpolated cameras stay on the circle and look at its center.
        for c in &path {
            assert!((c.position().length() - 4.0).abs() < 0.02 && c.problem().is_none());
            assert!((c.forward() + c.position().normalize()).length() < 0.02);
        }
    }

    #[test]
    fn shuffled_cameras_are_visited_in_a_short_order() {
        let sorted = walk(11);
        let shuffled: Vec<Camera> = (0..11).map(|i| sorted[i * 4 % 11].clone()).collect();
        let order = order(&shuffled);
        let names: Vec<&str> = order.iter().map(|&i| shuffled[i].name.as_str()).collect();
        assert!(names.is_sorted() || names.iter().rev().is_sorted(), "{names:?}");
        assert_eq!(super::order(&sorted), (0..11).collect::<Vec<_>>());
    }

    #[test]
    fn single_and_equal_cameras_make_a_path() {
        let one = walk(2).remove(0);
        assert!(cameras(std::slice::from_ref(&one), 3).iter().all(|c| c.position().distance(one.position()) < 1e-9));
        let still = cameras(&[one.clone(), one.clone(), one.clone()], 5);
        assert!(still.iter().all(|c| c.problem().is_none() && c.position().distance(one.position()) < 1e-9));
        assert_eq!(cameras(&walk(3), 1).len(), 1);
        assert!(cameras(&[], 5).is_empty());
    }
}
