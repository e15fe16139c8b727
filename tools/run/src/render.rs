//! Rendering of a single view.

use crate::convert::camera;
use crate::error::Result;
use sgs_passes::pipeline::{RenderedImage, Renderer};
use sgs_passes::scene::Gaussians;

/// Renders a view with color, depth, and normals if the model has them.
///
/// # Errors
/// If the device fails.
pub fn render_view(
    renderer: &mut Renderer,
    gaussians: &Gaussians,
    view: &sgs_scene::Camera,
    background: [f32; 3],
) -> Result<RenderedImage> {
    Ok(renderer.render(gaussians, &camera(view), gaussians.model.sh_degree, background)?)
}
