//! Pseudo-views: cameras between training views and their neighbors, from where a region must mean the same (SGS-Intrinsic,
//! algorithm 1).
//!
//! Every training view has two sequences of poses, both with their ends: sequence 0 goes from the view to the training view
//! nearest to it, sequence 1 comes to the view from another neighbor: the second-nearest training view, or, as the paper
//! has it, the nearest test view (its pose is used, never its image). Nearness is
//! λ_t |c1 − c2| + λ_r arccos(2 (q1·q2)² − 1), of camera centers and rotations; of equals the first in the split's order is
//! nearest. Orientations turn by the shorter arc at even speed.
//!
//! A pseudo-view has the size and intrinsics of its training view. The published code gives all of them those of the first
//! training camera, which is the same where there is one camera and wrong where cameras differ.
//!
//! Degenerate scenes are defined: coincident poses give a sequence that stands still; a view without any other has itself
//! as neighbor; with two training views and no test view both sequences join the same two.

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
    /// Poses where it begins and ends, and the positions before and behind that bend it.
    from: Pose,
    to: Pose,
    around: [Option<glam::DVec3>; 2],
}

/// The pseudo-views of a scene: two sequences for every training view.
#[derive(Clone, Debug)]
pub struct PseudoViews {
    poses: u32,
    position: Position,
    /// By position in the split.
    views: Vec<(Camera, [Sequence; 2])>,
}

impl PseudoViews {
    /// Of a scene's training views, in the order of the split.
    ///
    /// # Errors
    /// If an option is impossible, or the split names a view that does not exist.
    pub fn new(scene: &Scene, options: &PseudoOptions) -> Result<PseudoViews> {
        let cameras = |list: &[usize]| -> Result<Vec<Camera>> {
            list.iter().map(|&i| Ok(scene.view(i)?.camera.clone())).collect()
        };
        options.check("geometry.pseudo.")?;
        let test = cameras(&scene.split.test)?;
        if options.neighbors == Neighbors::Test && test.is_empty() {
            tracing::warn!("there are no test views; pseudo-views lie between training views alone");
        }
        Ok(PseudoViews::between(&cameras(&scene.split.train)?, &test, options))
    }

    /// Of cameras.
    pub fn between(train: &[Camera], test: &[Camera], options: &PseudoOptions) -> PseudoViews {
        let poses: Vec<Pose> = train.iter().map(Pose::of).collect();
        let apart = |a: &Pose, b: &Pose| a.distance(b, options.lambda_t, options.lambda_r);
        let mut views = Vec::new();
        for (i, (camera, own)) in train.iter().zip(&poses).enumerate() {
            let mut others: Vec<usize> = (0..train.len()).filter(|&j| j != i).collect();
            // Stable: of equals the first stays first.
            others.sort_by(|&a, &b| apart(own, &poses[a]).total_cmp(&apart(own, &poses[b])));
            let near = others.first().copied().unwrap_or(i);
            let next = others.get(1).copied().unwrap_or(near);
            let mut second = (train[next].name.clone(), poses[next]);
            if options.neighbors == Neighbors::Test {
                let seen = test.iter().map(|c| (c, Pose::of(c)));
                let nearest = seen.min_by(|(_, a), (_, b)| apart(own, a).total_cmp(&apart(own, b)));
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

    /// Training views.
    pub fn views(&self) -> usize {
        self.views.len()
    }

    /// Poses of each of the two sequences of a view.
    pub fn poses(&self) -> u32 {
        self.poses
    }

    /// The camera of a pseudo-view: training view by position in the split, sequence 0 or 1, pose below
    /// [`PseudoViews::poses`]. Its name is that of [`PseudoViews::name`].
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

    /// The name of a pseudo-view, which its files have: `STEM_0_07`.
    pub fn name(&self, view: usize, which: usize, index: u32) -> String {
        format!("{}_{which}_{index:02}", self.views[view].0.name)
    }

    /// The view that a sequence joins the training view with.
    pub fn neighbor(&self, view: usize, which: usize) -> &str {
        &self.views[view].1[which].neighbor
    }

    /// Which pose of each sequence a step sees: uniform, a function of seed and step alone.
    pub fn draw(&self, seed: u64, step: u32) -> [u32; 2] {
        [0x7073_6575_646f_0000, 0x7073_6575_646f_0001].map(|which| {
            let drawn = hash(seed ^ which, u64::from(step)) % u64::from(self.poses);
            drawn as u32
        })
    }

    /// Every camera, view by view, sequence by sequence.
    pub fn cameras(&self) -> Vec<Camera> {
        let all = (0..self.views.len()).flat_map(|v| [(v, 0), (v, 1)]);
        all.flat_map(|(v, which)| (0..self.poses).map(move |i| self.camera(v, which, i))).collect()
    }
}

#[cfg(test)]
mod tests;
