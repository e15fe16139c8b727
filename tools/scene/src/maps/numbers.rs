//! Maps of integers: regions and classes.

use std::path::Path;

use crate::camera::{Camera, Distortion};
use crate::error::Result;
use crate::image::read_ids;
use crate::view::View;

/// Integer id for every pixel.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RegionMap {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// Row-major ids; 0 means none.
    pub ids: Vec<u16>,
}

/// Loads an id map for a view. Ids cannot be averaged: each pixel takes the id at its center.
pub(crate) fn load(path: &Path, view: &View) -> Result<RegionMap> {
    load_seen(path, &view.camera, &view.distortion)
}

/// Loads an id map as seen by a camera through a lens.
pub(crate) fn load_seen(path: &Path, camera: &Camera, lens: &Distortion) -> Result<RegionMap> {
    let (w, h, stored) = read_ids(path)?;
    let ids = stored_pixels(camera, lens, (w, h)).map(|at| stored.get(at).copied().unwrap_or(0)).collect();
    Ok(RegionMap { width: camera.width, height: camera.height, ids })
}

/// Returns the pixel of a stored map at the center of each pixel of a camera.
///
/// The map covers the same field and may have another size.
pub(crate) fn stored_pixels(camera: &Camera, lens: &Distortion, (w, h): (u32, u32)) -> impl Iterator<Item = usize> {
    let (camera, lens) = (camera.clone(), *lens);
    (0..camera.height).flat_map(move |y| {
        let camera = camera.clone();
        (0..camera.width).map(move |x| {
            let nx = (f64::from(x) + 0.5 - camera.cx) / camera.fx;
            let ny = (f64::from(y) + 0.5 - camera.cy) / camera.fy;
            let (dx, dy) = lens.distort(nx, ny);
            let u = (dx * camera.fx + camera.cx) / f64::from(camera.width) * f64::from(w);
            let v = (dy * camera.fy + camera.cy) / f64::from(camera.height) * f64::from(h);
            // The offset keeps pixel centers from rounding down across an edge. The cast saturates at zero.
            let column = ((u + 1e-9).floor() as usize).min(w as usize - 1);
            let row = ((v + 1e-9).floor() as usize).min(h as usize - 1);
            row * w as usize + column
        })
    })
}

/// Returns the stored cell at the center of every undistorted cell. Cells are in row-major order; each item is
/// `[column, row]` in a stored map of the same size.
pub(crate) fn cells(view: &View, width: usize, height: usize) -> impl Iterator<Item = [usize; 2]> {
    let (camera, distortion) = (view.given_camera(), view.distortion);
    let [w, h] = [width, height].map(|n| n as f64);
    let [across, down] = [f64::from(camera.width), f64::from(camera.height)];
    (0..width * height).map(move |i| {
        let (x, y) = ((i % width) as f64 + 0.5, (i / width) as f64 + 0.5);
        let nx = (x / w * across - camera.cx) / camera.fx;
        let ny = (y / h * down - camera.cy) / camera.fy;
        let (dx, dy) = distortion.distort(nx, ny);
        let (u, v) = ((dx * camera.fx + camera.cx) / across * w, (dy * camera.fy + camera.cy) / down * h);
        // The casts saturate at zero.
        [((u + 1e-9).floor() as usize).min(width - 1), ((v + 1e-9).floor() as usize).min(height - 1)]
    })
}
