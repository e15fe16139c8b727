//! Per-pixel maps of views; priors and ground truth are stored alike.
//!
//! A map's file name is the stem of its view. The map covers the same field as the photograph, including its
//! distortion, and may have any size. Loading undistorts it and averages it by area to the size of the view's camera,
//! without invalid pixels.

mod normal;
mod numbers;

use std::path::{Path, PathBuf};

pub(crate) use normal::{finish as finish_normals, load as load_normals, stored as stored_normals};
pub use numbers::RegionMap;
pub(crate) use numbers::{cells, load as load_numbers, load_seen as load_numbers_seen, stored_pixels};

use half::f16;

use crate::error::Result;
use crate::image::{Image, resize_valid, undistort};
use crate::map_file::{self, Meaning};
use crate::view::View;

/// Map with a mask of valid pixels.
#[derive(Clone, Debug, PartialEq)]
pub struct MaskedMap {
    /// Values; 0 where invalid.
    pub image: Image,
    /// Validity in one channel: 1 where the values are valid, else 0.
    pub valid: Image,
}

/// Per-pixel features at their stored size and precision.
#[derive(Clone, Debug, PartialEq)]
pub struct FeatureMap {
    /// Width in cells; the map covers the whole image.
    pub width: usize,
    /// Height in cells.
    pub height: usize,
    /// Number of features per cell.
    pub channels: usize,
    /// Row-major, interleaved values.
    pub data: Vec<f16>,
}

/// Returns the path of a map, with the first extension that exists.
pub(crate) fn find(folder: &Path, stem: &str, extensions: &[&str]) -> Option<PathBuf> {
    extensions.iter().map(|extension| folder.join(format!("{stem}.{extension}"))).find(|path| path.is_file())
}

/// Loads a map for a view.
pub(crate) fn load(path: &Path, view: &View, meaning: Meaning) -> Result<MaskedMap> {
    let (image, valid) = map_file::read(path, meaning)?;
    Ok(bring(image, valid, view))
}

/// Undistorts a map and resizes it to the view.
pub(crate) fn bring(mut image: Image, mut valid: Image, view: &View) -> MaskedMap {
    if !view.distortion.is_none() {
        let channels = image.channels.max(1) as usize;
        for (pixel, v) in image.data.chunks_exact_mut(channels).zip(&valid.data) {
            if *v == 0.0 {
                pixel.fill(0.0);
            }
        }
        let camera = view.stored_camera.scaled(image.width, image.height);
        image = undistort(&image, &camera, &view.distortion);
        valid = undistort(&valid, &camera, &view.distortion);
        for (pixel, v) in image.data.chunks_exact_mut(channels).zip(&mut valid.data) {
            let keep = *v >= 0.5;
            pixel.iter_mut().for_each(|value| *value = if keep { *value / *v } else { 0.0 });
            *v = f32::from(u8::from(keep));
        }
    }
    let (image, valid) = resize_valid(&image, &valid, view.camera.width, view.camera.height);
    MaskedMap { image, valid }
}

#[cfg(test)]
mod tests;
