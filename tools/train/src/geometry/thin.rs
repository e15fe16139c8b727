//! Start from fewer points than the scene has. Used where memory does not suffice for all.

use super::{Geometry, GeometryInputs};
use crate::error::Result;
use sgs_config::Settings;
use sgs_engine::Device;
use sgs_scene::{PointCloud, Scene, Splats};

/// Number of points up to which no points are dropped.
pub const MANY_POINTS: usize = 10_000;

/// Share of the points that each attempt retains of the one before.
const RETAINED: [usize; 2] = [7, 10];

/// Divisor of the number of points. At least one in this many is retained.
pub const MOST_THINNED: usize = 10;

impl Geometry {
    /// Prepares training from the scene's points. Where memory does not suffice for all, uses as many as fit.
    ///
    /// # Errors
    /// If data cannot be read, or memory does not suffice for a tenth of the points.
    pub(super) fn from_points(device: &Device, scene: &Scene, settings: &Settings) -> Result<Geometry> {
        let degree = settings.geometry.sh_degree.start() as usize;
        let attempt = |points: &PointCloud| {
            Geometry::of(device, &GeometryInputs::Scene(scene), settings, &Splats::from_points(points, degree)?)
        };
        let all = scene.points.len();
        let first = match attempt(&scene.points) {
            Err(error) if error.is_out_of_memory() && all > MANY_POINTS => error,
            ended => return ended,
        };
        let mut count = all * RETAINED[0] / RETAINED[1];
        while count * MOST_THINNED >= all {
            match attempt(&scene.points.spread(count)) {
                Err(error) if error.is_out_of_memory() => count = count * RETAINED[0] / RETAINED[1],
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
