//! Views of a room: the surfaces that they show, and their cameras.

use glam::DVec3;
use sgs_passes::pipeline::Shaded;
use sgs_scene::{Camera, Image};

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

    /// Removes the surfaces of invalid pixels of a photograph, where its mask is 0. The pixels explain nothing then.
    pub fn exclude(&mut self, view: usize, mask: &Image) {
        let points = self.views[view].points.chunks_exact_mut(3);
        // A point at infinity is no reliable surface, and no Gaussian is near it.
        points.zip(&mask.data).filter(|(_, valid)| **valid <= 0.5).for_each(|(point, _)| point.fill(f32::INFINITY));
    }

    /// Returns the pixel onto which a view projects a point in world units.
    pub(crate) fn pixel(&self, view: usize, point: [f32; 3]) -> Option<usize> {
        let camera = &self.cameras[view];
        let at = camera.project(DVec3::from(point.map(f64::from)))?;
        let inside = at.x >= 0.0 && at.y >= 0.0 && at.x < f64::from(camera.width) && at.y < f64::from(camera.height);
        inside.then(|| at.y as usize * camera.width as usize + at.x as usize)
    }
}
