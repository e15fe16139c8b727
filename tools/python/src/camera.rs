//! Cameras as plain tuples.

use glam::{DMat3, DVec3};
use sgs_api::usage;
use sgs_scene::{Camera, NEAR, Splats, Unit};

/// Name; columns and rows; focal lengths and principal point in pixels; rotation by rows and translation of
/// world-to-camera; near plane in scene units, or `None` for the default.
pub type CameraTuple = (String, [u32; 2], [f64; 4], [f64; 9], [f64; 3], Option<f64>);

/// Returns the tuple of a camera.
pub fn tuple(camera: &Camera) -> CameraTuple {
    let rows = camera.rotation.transpose().to_cols_array();
    let Camera { fx, fy, cx, cy, .. } = *camera;
    (
        camera.name.clone(),
        [camera.width, camera.height],
        [fx, fy, cx, cy],
        rows,
        camera.translation.to_array(),
        Some(camera.near),
    )
}

/// Returns the camera of a tuple. The near plane of `splats` replaces an absent one.
pub fn camera(tuple: CameraTuple, splats: Option<&Splats>) -> anyhow::Result<Camera> {
    let (name, [width, height], [fx, fy, cx, cy], rows, translation, near) = tuple;
    let near = near.unwrap_or_else(|| NEAR * splats.map_or(1.0, |s| Unit::of_splats(s).length()));
    let rotation = DMat3::from_cols_array(&rows).transpose();
    let camera =
        Camera { name, width, height, fx, fy, cx, cy, rotation, translation: DVec3::from_array(translation), near };
    match camera.problem() {
        Some(problem) => Err(usage(format!("The camera \"{}\" is wrong: {problem}.", camera.name))),
        None if !(near.is_finite() && near > 0.0) => {
            Err(usage(format!("The near plane of \"{}\" is {near}, but must be above 0.", camera.name)))
        }
        None => Ok(camera),
    }
}
