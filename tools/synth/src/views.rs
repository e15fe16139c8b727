//! Camera placement.
//!
//! Training cameras follow an arc around the southern half of the room at eye height. They look across its middle, so
//! that neighbors overlap. Test cameras stand between neighbors, a little off their connecting line. Every camera is
//! inside the room, outside furniture, and has free space in front of it as far as the room permits.

use glam::{Vec2, Vec3};

use crate::options::SynthOptions;
use crate::rng::Rng;
use crate::scene::Scene;
use crate::trace::camera::Camera;
use crate::trace::scene::Hit;

/// Horizontal field of view in radians.
pub(crate) const FOV_X: f32 = 70.0 * std::f32::consts::PI / 180.0;

/// Cameras of a scene.
pub(crate) struct Views {
    /// Training cameras.
    pub(crate) train: Vec<Camera>,
    /// Test cameras, numbered after the training cameras.
    pub(crate) test: Vec<Camera>,
}

/// Position, viewing target and roll of a camera.
#[derive(Debug, Clone, Copy)]
struct Pose {
    position: Vec3,
    target: Vec3,
    roll: f32,
}

/// Half of the arc of training cameras, in radians around the vertical axis.
const HALF_ARC: f32 = 1.83;

/// Places all cameras.
pub(crate) fn place(scene: &Scene, options: &SynthOptions) -> Views {
    let mut train: Vec<Pose> = Vec::with_capacity(options.views);
    for i in 0..options.views {
        let along = if options.views == 1 { 0.5 } else { i as f32 / (options.views - 1) as f32 };
        let rng = &mut Rng::new(&[options.seed, 0x7a1, i as u64]);
        train.push(best(scene, |attempt| on_arc(scene, along, i, attempt, rng)));
    }
    let test: Vec<Pose> = (0..options.test_views)
        .map(|j| {
            let rng = &mut Rng::new(&[options.seed, 0x7e57, j as u64]);
            let place = (j as f32 + 0.5) / options.test_views as f32;
            let gap = (place * (train.len() - 1) as f32) as usize;
            let (a, b) = (train[gap], train[(gap + 1).min(train.len() - 1)]);
            best(scene, |attempt| between(&a, &b, attempt, rng))
        })
        .collect();
    let cameras = |poses: Vec<Pose>| {
        poses
            .into_iter()
            .map(|p| Camera::look_at(p.position, p.target, p.roll, FOV_X, options.width, options.height))
            .collect()
    };
    Views { train: cameras(train), test: cameras(test) }
}

/// Returns the first acceptable of 40 candidates, or that with the best score.
fn best(scene: &Scene, mut propose: impl FnMut(usize) -> Pose) -> Pose {
    let mut found: Option<(f32, Pose)> = None;
    for attempt in 0..40 {
        let pose = propose(attempt);
        let score = clearance(scene, &pose);
        if score >= 1.0 {
            return pose;
        }
        if found.is_none_or(|(best, _)| score > best) {
            found = Some((score, pose));
        }
    }
    found.map_or_else(|| propose(0), |(_, pose)| pose)
}

/// Returns a candidate on the arc. Later attempts deviate further.
fn on_arc(scene: &Scene, along: f32, index: usize, attempt: usize, rng: &mut Rng) -> Pose {
    let stray = attempt as f32 / 20.0;
    let (min, max) = (scene.interior.min, scene.interior.max);
    let half = 0.5 * (max - min);
    let inset = |h: f32| h - (0.13 * h + 0.15);
    let angle = HALF_ARC * (2.0 * along - 1.0) + rng.range(-0.05, 0.05) * (1.0 + 3.0 * stray);
    let reach = rng.range(0.93, 1.0) - 0.3 * stray * rng.uniform();
    // Neighbors stand at different heights, which gives parallax in both directions.
    let level = [0.58, 0.50, 0.62, 0.54][index % 4] + rng.range(-0.015, 0.015);
    let position = Vec3::new(
        reach * inset(half.x) * angle.sin(),
        min.y + level * (max.y - min.y),
        reach * inset(half.z) * angle.cos(),
    );
    let away = scene.focus - position;
    let aim = scene.focus + 0.25 * Vec3::new(away.x, 0.0, away.z);
    Pose {
        position,
        target: aim + Vec3::new(rng.range(-0.25, 0.25), rng.range(-0.1, 0.25), rng.range(-0.25, 0.25)),
        roll: rng.range(-0.02, 0.02),
    }
}

/// Returns a candidate between two cameras.
fn between(a: &Pose, b: &Pose, attempt: usize, rng: &mut Rng) -> Pose {
    let t = rng.range(0.35, 0.65);
    let spread = 0.08 + 0.004 * attempt as f32;
    let mut shift = spread * rng.normal3().clamp(Vec3::splat(-2.0), Vec3::splat(2.0));
    // The chord of an arc already lies inside it. A single camera has no neighbor, so its candidates move further.
    if a.position == b.position {
        shift *= 2.0;
    }
    Pose {
        position: a.position.lerp(b.position, t) + shift * Vec3::new(1.0, 0.7, 1.0),
        target: a.target.lerp(b.target, t) + 0.12 * rng.normal3(),
        roll: 0.5 * (a.roll + b.roll),
    }
}

/// Returns the free space around a camera as a score. 1 and above is acceptable.
fn clearance(scene: &Scene, pose: &Pose) -> f32 {
    const MARGIN: f32 = 0.12;
    let p = pose.position;
    let (min, max) = (scene.interior.min, scene.interior.max);
    let walls = (p - min).min(max - p).min_element();
    if walls < MARGIN {
        return walls - 1.0;
    }
    let size = (max - min).min_element();
    let inside = scene
        .obstacles
        .iter()
        .any(|o| p.cmpge(o.min - Vec3::splat(MARGIN)).all() && p.cmple(o.max + Vec3::splat(MARGIN)).all());
    let camera = Camera::look_at(p, pose.target, pose.roll, FOV_X, 16, 12);
    let mut depths: Vec<f32> = (0..16 * 12)
        .map(|i| {
            let pixel = Vec2::new((i % 16) as f32 + 0.5, (i / 16) as f32 + 0.5);
            match scene.hit(p, camera.direction(pixel)) {
                Some(Hit::Surface(hit)) => hit.distance,
                Some(Hit::Light(_, distance, _)) => distance,
                None => 0.0,
            }
        })
        .collect();
    depths.sort_by(f32::total_cmp);
    let score = (depths[0] / (0.2 * size)).min(depths[19] / (0.36 * size)).min(depths[96] / (0.7 * size));
    if inside { score - 1.0 } else { score }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::options::SceneName;

    #[test]
    fn cameras_avoid_obstacles_and_look_inward() {
        for name in SceneName::ALL {
            for seed in [1, 2, 3] {
                let scene = Scene::build(name, seed);
                let options = SynthOptions { scene: name, seed, ..SynthOptions::default() };
                let views = place(&scene, &options);
                assert_eq!((views.train.len(), views.test.len()), (12, 4));
                for camera in views.train.iter().chain(&views.test) {
                    let p = camera.position;
                    let (min, max) = (scene.interior.min, scene.interior.max);
                    assert!(p.cmpgt(min).all() && p.cmplt(max).all(), "{name} {seed}: {p}");
                    for o in &scene.obstacles {
                        let inside = p.cmpge(o.min).all() && p.cmple(o.max).all();
                        assert!(!inside, "{name} {seed}: {p} is inside {o:?}");
                    }
                    let inward = -camera.axes.z_axis.dot((scene.focus - p).normalize());
                    assert!(inward > 0.75, "{name} {seed}: {inward}");
                }
            }
        }
    }

    #[test]
    fn single_training_view_is_supported() {
        let scene = Scene::build(SceneName::Box, 1);
        let options = SynthOptions { views: 1, test_views: 2, ..SynthOptions::default() };
        let views = place(&scene, &options);
        assert_eq!((views.train.len(), views.test.len()), (1, 2));
        assert_ne!(views.train[0].position, views.test[0].position);
    }
}
