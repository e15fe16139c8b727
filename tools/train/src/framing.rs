//! Check that the training views see the scene's points.
//! The check runs on the CPU before the first step.
//!
//! Training with views that see no points ends in black images. Poses and points in different units are the usual
//! cause.

use crate::error::Result;
use glam::DVec3;
use sgs_scene::{Camera, Scene, SceneError};

/// Numbers of cells along the width and height of a view. A cell is covered if a point projects to it.
const CELLS: [usize; 2] = [8, 6];

/// Maximum numbers of views and points that are tested, spread evenly over all.
const MOST_VIEWS: usize = 64;
const MOST_POINTS: usize = 20_000;

/// Least mean share of covered cells without a warning.
const ENOUGH_CELLS: f64 = 0.1;

/// Largest share of points nearer than the near plane without a warning.
const FEW_NEAR: f64 = 0.2;

/// Ratio of baseline to point distance below which cameras coincide.
const ONE_PLACE: f64 = 1e-6;

/// Points farther than this multiple of the cameras' baseline have no parallax.
const FAR: f64 = 100.0;

/// Statistics of how the training views see a scene's points.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Framing {
    /// Number of training views.
    pub views: usize,
    /// Number of training views with the pose of an earlier one.
    pub repeated: usize,
    /// Share of the points that at least one view sees.
    pub seen: f64,
    /// Share of a view's cells that show a point, mean over the views.
    pub covered: f64,
    /// Share of the points within the images that are nearer than the near plane.
    pub near: f64,
    /// Largest distance of a camera from the mean of all, in scene units.
    pub baseline: f64,
    /// Median distance of the points from the mean camera position, in scene units.
    pub distance: f64,
}

impl Framing {
    /// Measures a scene.
    pub fn of(scene: &Scene) -> Framing {
        let cameras: Vec<&Camera> = scene.split.train.iter().map(|&i| &scene.views[i].camera).collect();
        let center = cameras.iter().map(|c| c.position()).sum::<DVec3>() / cameras.len().max(1) as f64;
        let baseline = cameras.iter().map(|c| c.position().distance(center)).fold(0.0, f64::max);
        let every = scene.points.len().div_ceil(MOST_POINTS).max(1);
        let points: Vec<DVec3> =
            scene.points.positions.iter().step_by(every).map(|p| DVec3::from(p.map(f64::from))).collect();
        let mut distances: Vec<f64> = points.iter().map(|p| p.distance(center)).collect();
        let middle = distances.len() / 2;
        let distance = match distances.is_empty() {
            true => 0.0,
            false => *distances.select_nth_unstable_by(middle, f64::total_cmp).1,
        };
        let mut seen = vec![false; points.len()];
        let (mut covered, mut within, mut near) = (0.0, 0_u64, 0_u64);
        let step = cameras.len().div_ceil(MOST_VIEWS).max(1);
        let tested: Vec<&Camera> = cameras.iter().copied().step_by(step).collect();
        for camera in &tested {
            let mut cells = [false; CELLS[0] * CELLS[1]];
            for (point, seen) in points.iter().zip(&mut seen) {
                let Some((cell, depth)) = place(camera, *point) else { continue };
                within += 1;
                if depth < camera.near {
                    near += 1;
                } else {
                    (*seen, cells[cell]) = (true, true);
                }
            }
            covered += cells.iter().filter(|c| **c).count() as f64 / cells.len() as f64;
        }
        let share = |count: u64, of: usize| count as f64 / of.max(1) as f64;
        Framing {
            views: cameras.len(),
            repeated: repeated(&cameras),
            seen: share(seen.iter().filter(|s| **s).count() as u64, points.len()),
            covered: covered / tested.len().max(1) as f64,
            near: share(near, within as usize),
            baseline,
            distance,
        }
    }

    /// Rejects a scene if no training view sees any of its points.
    /// Otherwise returns warnings, one sentence each.
    ///
    /// # Errors
    /// [`SceneError::Points`] with the distances and what to do.
    pub fn check(&self, scene: &Scene) -> Result<Vec<String>> {
        let n = scene.points.len();
        let refuse = |problem: String| {
            Err(SceneError::Points { path: scene.root.clone(), place: String::new(), problem }.into())
        };
        let apart = || {
            let shown = |v: f64| if (0.01..1e5).contains(&v) { format!("{v:.3}") } else { format!("{v:.2e}") };
            let (distance, baseline) = (shown(self.distance), shown(self.baseline));
            format!(
                "they lie about {distance} units from the cameras, which lie within {baseline} units; check that poses \
                 and points come from the same reconstruction and have the same units"
            )
        };
        if self.seen == 0.0 {
            return refuse(format!("no training view sees any of the {n} points: {}", apart()));
        }
        let mut warnings = Vec::new();
        if self.near > FEW_NEAR {
            let percent = 100.0 * self.near;
            warnings.push(format!("{percent:.0} % of the points are too near to be drawn: {}", apart()));
        } else if self.covered < ENOUGH_CELLS {
            let percent = 100.0 * self.covered;
            warnings.push(format!("training views show points in only {percent:.1} % of their area: {}", apart()));
        }
        let cameras = self.views;
        // The mean of equal positions is subject to rounding.
        let one_place = self.baseline <= ONE_PLACE * self.distance;
        if one_place && self.repeated > 0 {
            warnings.push(format!(
                "the {cameras} training cameras stand at one place, {} of them with the pose of another one: depth cannot be \
                 learned; check the poses",
                self.repeated
            ));
        } else if self.repeated > 0 {
            let repeated = self.repeated;
            warnings.push(format!(
                "{repeated} of {cameras} training cameras have the pose of another one; check the poses"
            ));
        } else if !one_place && self.distance > FAR * self.baseline && self.covered >= ENOUGH_CELLS {
            warnings.push(format!("the points are too far for parallax: {}", apart()));
        }
        Ok(warnings)
    }
}

/// Returns the cell of a view that a point projects to, and the point's depth.
/// Returns `None` for a point outside the image or behind the camera.
fn place(camera: &Camera, point: DVec3) -> Option<(usize, f64)> {
    let pixel = camera.project(point)?;
    let depth = camera.forward().dot(point - camera.position());
    let sides = [(pixel.x, camera.width, CELLS[0]), (pixel.y, camera.height, CELLS[1])];
    let [x, y] = sides.map(|(at, side, cells)| (at >= 0.0).then(|| (at / f64::from(side) * cells as f64) as usize));
    let (x, y) = (x.filter(|x| *x < CELLS[0])?, y.filter(|y| *y < CELLS[1])?);
    (depth > 0.0).then_some((y * CELLS[0] + x, depth))
}

/// Returns the number of cameras that repeat the pose of an earlier one.
/// Poses are compared bit for bit.
fn repeated(cameras: &[&Camera]) -> usize {
    let bits = |c: &Camera| {
        let numbers = c.rotation.to_cols_array().into_iter().chain(c.translation.to_array());
        numbers.map(f64::to_bits).collect::<Vec<u64>>()
    };
    let poses: std::collections::HashSet<_> = cameras.iter().map(|c| bits(c)).collect();
    cameras.len() - poses.len()
}
