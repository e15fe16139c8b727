//! Rendering a view of a run.

use crate::convert::camera;
use crate::error::Result;
use sgs_passes::pipeline::{Picture, Renderer};
use sgs_passes::scene::Gaussians;

/// Renders one view with rgb, depth, and normals where the model has them.
///
/// # Errors
/// If the device fails.
pub fn render_view(
    renderer: &mut Renderer,
    gaussians: &Gaussians,
    view: &sgs_scene::Camera,
    background: [f32; 3],
) -> Result<Picture> {
    Ok(renderer.render(gaussians, &camera(view), gaussians.model.sh_degree, background)?)
}
