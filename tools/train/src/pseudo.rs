//! Pseudo-views: cameras between training views and neighbors (SGS-Intrinsic, algorithm 1).
//! Regions must have the same semantics and albedo from these cameras.
//!
//! Every training view has two sequences of poses, which include their end poses. Sequence 0 leads from the view to the
//! nearest training view. Sequence 1 leads to the view from another neighbor. This neighbor is the second-nearest
//! training view or, as in the paper, the nearest test view (only its pose is used, never its image). The distance is
//! |c1 − c2| + arccos(2 (q1·q2)² − 1), with camera centers c and rotations q. Ties go to the first view in the
//! split's order. Orientations turn along the shorter arc at constant speed.
//!
//! A pseudo-view has the size and intrinsics of its training view. The published code uses the intrinsics of the first
//! training camera for all. Both agree for a single camera; the published choice is wrong where cameras differ.
//!
//! Degenerate scenes are defined. Coincident poses give a constant sequence. A view without other views is its own
//! neighbor. With two training views and no test view, both sequences join the same two views.

mod path;

use crate::error::Result;
use crate::schedule::hash;
use path::{Pose, bend};
use sgs_config::{Neighbors, Position, PseudoOptions};
use sgs_scene::{Camera, Scene};

/// One sequence of a training view.
#[derive(Clone, Debug)]
struct Sequence {
    /// Name of the view at the other end.
    neighbor: String,
    /// First and last pose, and the positions before and after them that bend the path.
    from: Pose,
    to: Pose,
    around: [Option<glam::DVec3>; 2],
}

/// Pseudo-views of a scene: two sequences for every training view.
#[derive(Clone, Debug)]
pub struct PseudoViews {
    poses: u32,
    position: Position,
    /// Training camera and its sequences, by position in the split.
    views: Vec<(Camera, [Sequence; 2])>,
}

impl PseudoViews {
    /// Builds the pseudo-views of a scene's training views, in the order of the split.
    ///
    /// # Errors
    /// If the split names a view that does not exist.
    pub fn new(scene: &Scene, options: &PseudoOptions) -> Result<PseudoViews> {
        let cameras = |list: &[usize]| -> Result<Vec<Camera>> {
            list.iter().map(|&i| Ok(scene.view(i)?.camera.clone())).collect()
        };
        let test = cameras(&scene.split.test)?;
        if options.neighbors == Neighbors::Test && test.is_empty() {
            tracing::warn!("there are no test views; pseudo-views lie between training views alone");
        }
        Ok(PseudoViews::between(&cameras(&scene.split.train)?, &test, options))
    }

    /// Builds the pseudo-views of given cameras.
    pub fn between(train: &[Camera], test: &[Camera], options: &PseudoOptions) -> PseudoViews {
        let poses: Vec<Pose> = train.iter().map(Pose::of).collect();
        let mut views = Vec::new();
        for (i, (camera, own)) in train.iter().zip(&poses).enumerate() {
            let mut others: Vec<usize> = (0..train.len()).filter(|&j| j != i).collect();
            // The sort is stable: ties keep the split's order.
            others.sort_by(|&a, &b| own.distance(&poses[a]).total_cmp(&own.distance(&poses[b])));
            let near = others.first().copied().unwrap_or(i);
            let next = others.get(1).copied().unwrap_or(near);
            let mut second = (train[next].name.clone(), poses[next]);
            if options.neighbors == Neighbors::Test {
                let seen = test.iter().map(|c| (c, Pose::of(c)));
                let nearest = seen.min_by(|(_, a), (_, b)| own.distance(a).total_cmp(&own.distance(b)));
                if let Some((camera, pose)) = nearest {
                    second = (camera.name.clone(), pose);
                }
            }
            let sequence = |neighbor: String, from: Pose, to: Pose| {
                let around = bend(&from, &to, poses.iter().map(|p| p.position));
                Sequence { neighbor, from, to, around }
            };
            let sequences = [sequence(train[near].name.clone(), *own, poses[near]), sequence(second.0, second.1, *own)];
            views.push((camera.clone(), sequences));
        }
        PseudoViews { poses: options.poses.max(1), position: options.position, views }
    }

    /// Returns the number of training views.
    pub fn views(&self) -> usize {
        self.views.len()
    }

    /// Returns the number of poses of each of the two sequences of a view.
    pub fn poses(&self) -> u32 {
        self.poses
    }

    /// Returns the camera of a pseudo-view.
    /// `view`: training view by position in the split; `which`: sequence 0 or 1; `index`: pose below
    /// [`PseudoViews::poses`]. The camera's name is [`PseudoViews::name`].
    pub fn camera(&self, view: usize, which: usize, index: u32) -> Camera {
        let (own, sequences) = &self.views[view];
        let s = &sequences[which];
        let t = f64::from(index) / f64::from(self.poses.max(2) - 1);
        let cubic = self.position == Position::Cubic;
        let pose = s.from.toward(&s.to, t, if cubic { Some(s.around) } else { None });
        let rotation = glam::DMat3::from_quat(pose.rotation).transpose();
        Camera {
            name: self.name(view, which, index),
            rotation,
            translation: -(rotation * pose.position),
            ..own.clone()
        }
    }

    /// Returns the name of a pseudo-view, which is also its file stem: `STEM_0_07`.
    pub fn name(&self, view: usize, which: usize, index: u32) -> String {
        format!("{}_{which}_{index:02}", self.views[view].0.name)
    }

    /// Returns the name of the view at the other end of a sequence.
    pub fn neighbor(&self, view: usize, which: usize) -> &str {
        &self.views[view].1[which].neighbor
    }

    /// Draws the pose of each sequence for a step, uniformly.
    /// The result depends on seed and step only.
    pub fn draw(&self, seed: u64, step: u32) -> [u32; 2] {
        [0x7073_6575_646f_0000, 0x7073_6575_646f_0001].map(|which| {
            let drawn = hash(seed ^ which, u64::from(step)) % u64::from(self.poses);
            drawn as u32
        })
    }

    /// Returns all cameras, by view, then by sequence.
    pub fn cameras(&self) -> Vec<Camera> {
        let all = (0..self.views.len()).flat_map(|v| [(v, 0), (v, 1)]);
        all.flat_map(|(v, which)| (0..self.poses).map(move |i| self.camera(v, which, i))).collect()
    }
}

#[cfg(test)]
mod tests;
