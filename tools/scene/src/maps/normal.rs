//! Normal maps: conversion from several frames to unit vectors in world space.

use std::path::Path;

use glam::DVec3;

use super::bring;
use crate::error::{Result, SceneError};
use crate::image::{Encoding, Image};
use crate::map_file::{NormalFrame, is_opaque, raster};
use crate::view::View;

/// Returns whether a vector of this length may represent a unit vector. In 8-bit files, gray and black both mean
/// "none". Gray has a small length, and black has the length √3.
fn plausible(length: f64, encoding: Encoding) -> bool {
    match encoding {
        Encoding::Srgb => (0.1..1.5).contains(&length),
        Encoding::Linear => length > 1e-3 && length.is_finite(),
    }
}

/// Loads a normal map for a view. The result has three channels with world-space unit vectors, zero where the file has
/// no normal.
pub(crate) fn load(path: &Path, view: &View, frame: NormalFrame) -> Result<Image> {
    let (world, valid) = stored(path, view, frame)?;
    Ok(finish(world, valid, view))
}

/// Reads world-space unit vectors at the file's size, and their mask.
pub(crate) fn stored(path: &Path, view: &View, frame: NormalFrame) -> Result<(Image, Image)> {
    let (raster, encoding) = raster(path)?;
    if raster.channels < 3 {
        let problem = format!("a normal map has 3 channels, but the file has {}", raster.channels);
        return Err(SceneError::image(path, problem));
    }
    let to_world = frame.to_world(view.camera.rotation);
    let mut valid = Image::new(raster.width, raster.height, 1);
    let mut marks = valid.data.iter_mut();
    let world = raster.map_pixels(3, |old, new| {
        let mut n = DVec3::new(f64::from(old[0]), f64::from(old[1]), f64::from(old[2]));
        if encoding == Encoding::Srgb {
            n = 2.0 * n - 1.0;
        }
        let length = n.length();
        if plausible(length, encoding) && is_opaque(old, encoding) {
            let n = to_world * n / length;
            new.copy_from_slice(&[n.x as f32, n.y as f32, n.z as f32]);
            if let Some(mark) = marks.next() {
                *mark = 1.0;
            }
        } else {
            marks.next();
        }
    });
    Ok((world, valid))
}

/// Resizes vectors to the view and normalizes them again.
pub(crate) fn finish(world: Image, valid: Image, view: &View) -> Image {
    let mut map = bring(world, valid, view).image;
    for pixel in map.data.chunks_exact_mut(3) {
        let n = DVec3::new(f64::from(pixel[0]), f64::from(pixel[1]), f64::from(pixel[2]));
        // Opposite normals that cancel have no direction.
        let n = if n.length() > 1e-3 { n.normalize() } else { DVec3::ZERO };
        pixel.copy_from_slice(&[n.x as f32, n.y as f32, n.z as f32]);
    }
    map
}
