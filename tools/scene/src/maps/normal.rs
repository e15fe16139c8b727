//! Normal maps: conversion from several frames to unit vectors in world space.

use std::path::Path;

use glam::{DMat3, DVec3};
use serde::{Deserialize, Serialize};

use super::{bring, is_opaque, read};
use crate::error::{Result, SceneError};
use crate::image::{Encoding, Image};
use crate::view::View;

/// Coordinate frame of a file's normals.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize)]
pub enum NormalFrame {
    /// World frame of the scene.
    #[serde(rename = "world")]
    World,
    /// Camera frame: x right, y down, z forward.
    #[serde(rename = "camera-opencv")]
    CameraOpencv,
    /// Camera frame: x right, y up, z toward the viewer.
    #[serde(rename = "camera-opengl")]
    CameraOpengl,
    /// Camera frame of StableNormal: x left, y up, z toward the viewer.
    #[serde(rename = "camera-stablenormal")]
    CameraStablenormal,
}

impl NormalFrame {
    /// Returns the matrix from this frame to world space. `world_to_camera` is the camera's rotation.
    pub fn to_world(self, world_to_camera: DMat3) -> DMat3 {
        let to_opencv = match self {
            Self::World => return DMat3::IDENTITY,
            Self::CameraOpencv => DVec3::new(1.0, 1.0, 1.0),
            Self::CameraOpengl => DVec3::new(1.0, -1.0, -1.0),
            Self::CameraStablenormal => DVec3::new(-1.0, -1.0, -1.0),
        };
        world_to_camera.transpose() * DMat3::from_diagonal(to_opencv)
    }
}

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
    let (raster, encoding) = read(path)?;
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
