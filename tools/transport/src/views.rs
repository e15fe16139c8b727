//! Views of a room: the surfaces that they show, and their cameras.

use glam::DVec3;
use sgs_passes::pipeline::Shaded;
use sgs_scene::Camera;

/// Surfaces that the training views show, with their cameras.
pub struct SeenViews {
    /// Surfaces of each view.
    pub(crate) views: Vec<Shaded>,
    cameras: Vec<Camera>,
    /// Position of each camera in world units.
    pub(crate) from: Vec<[f32; 3]>,
}

impl SeenViews {
    /// Creates the views of cameras.
    pub(crate) fn new(views: Vec<Shaded>, cameras: &[Camera]) -> SeenViews {
        let from = cameras.iter().map(|c| c.position().as_vec3().to_array()).collect();
        SeenViews { views, cameras: cameras.to_vec(), from }
    }

    /// Returns the pixel onto which a view projects a point in world units.
    pub(crate) fn pixel(&self, view: usize, point: [f32; 3]) -> Option<usize> {
        let camera = &self.cameras[view];
        let at = camera.project(DVec3::from(point.map(f64::from)))?;
        let inside = at.x >= 0.0 && at.y >= 0.0 && at.x < f64::from(camera.width) && at.y < f64::from(camera.height);
        inside.then(|| at.y as usize * camera.width as usize + at.x as usize)
    }
}
