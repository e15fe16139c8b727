//! Starting from fewer points than the scene has, where memory does not suffice for all.

use super::{Geometry, Given};
use crate::error::Result;
use sgs_config::Settings;
use sgs_engine::Device;
use sgs_scene::{PointCloud, Scene, Splats};

/// Fewer points than these are never the reason why memory does not suffice.
pub const MANY_POINTS: usize = 10_000;

/// Each attempt keeps seven tenths of the points of the one before.
const KEPT: [usize; 2] = [7, 10];

/// At least one point in so many stays.
pub const MOST_THINNED: usize = 10;

impl Geometry {
    /// Prepares training from the scene's points, or from as many of them as memory suffices for.
    ///
    /// # Errors
    /// If data cannot be read, or memory does not suffice for a tenth of the points.
    pub(super) fn from_points(device: &Device, scene: &Scene, settings: &Settings) -> Result<Geometry> {
        let degree = settings.geometry.sh_degree.start() as usize;
        let attempt = |points: &PointCloud| {
            Geometry::of(device, &Given::Scene(scene), settings, &Splats::from_points(points, degree)?)
        };
        let all = scene.points.len();
        let first = match attempt(&scene.points) {
            Err(error) if error.is_out_of_memory() && all > MANY_POINTS => error,
            ended => return ended,
        };
        let mut count = all * KEPT[0] / KEPT[1];
        while count * MOST_THINNED >= all {
            match attempt(&scene.points.spread(count)) {
                Err(error) if error.is_out_of_memory() => count = count * KEPT[0] / KEPT[1],
                Ok(training) => {
                    tracing::warn!(
                        "memory does not suffice for all {all} points; training starts from {count} of them"
                    );
                    return Ok(training);
                }
                failed => return failed,
            }
        }
        Err(first)
    }
}
