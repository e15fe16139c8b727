//! Per-pixel maps that belong to views: priors and ground truth are stored alike.
//!
//! A map lies in a folder under the stem of its view, shows what the photograph shows (with its distortion), and may have
//! any size. It is loaded to the size of the view's camera: undistorted, averaged by area, invalid pixels left out.

mod normal;
mod numbers;

use std::path::{Path, PathBuf};

pub use normal::NormalFrame;
pub(crate) use normal::load as load_normals;
pub use numbers::RegionMap;
pub(crate) use numbers::{cells, load as load_numbers};

use crate::error::Result;
use crate::image::{Encoding, Image, NpyArray, read_raster, resize_valid, srgb_to_linear, undistort};
use crate::view::View;

/// A map, and where it says anything.
#[derive(Clone, Debug, PartialEq)]
pub struct MaskedMap {
    /// The values; 0 where invalid.
    pub image: Image,
    /// One channel: 1 where the values are valid, else 0.
    pub valid: Image,
}

/// What the numbers of a map mean.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Meaning {
    /// Three channels of color: linear in EXR, sRGB-encoded in PNG; linear when loaded.
    Color,
    /// One channel, taken as it is.
    Scalar,
    /// One channel, of which only positive values mean something.
    Depth,
}

/// The file of a map, with the first extension that exists.
pub(crate) fn find(folder: &Path, stem: &str, extensions: &[&str]) -> Option<PathBuf> {
    extensions.iter().map(|extension| folder.join(format!("{stem}.{extension}"))).find(|path| path.is_file())
}

/// Loads a map for a view.
pub(crate) fn load(path: &Path, view: &View, meaning: Meaning) -> Result<MaskedMap> {
    let (raster, encoding) = read(path)?;
    let channels = if meaning == Meaning::Color { 3 } else { 1 };
    let mut valid = Image::new(raster.width, raster.height, 1);
    let mut marks = valid.data.iter_mut();
    let image = raster.map_pixels(channels, |old, new| {
        match (old, new.len()) {
            (&[r, g, b, ..], 3) => new.copy_from_slice(&[r, g, b]),
            (&[v, ..], _) => new.fill(v),
            (&[], _) => {}
        }
        // A straight alpha channel says where the map was computed.
        let opaque = !matches!(*old, [_, a] | [_, _, _, a] if encoding == Encoding::Srgb && a < 0.5);
        let meant = opaque && new.iter().all(|v| v.is_finite()) && (meaning != Meaning::Depth || new[0] > 0.0);
        if meaning == Meaning::Color && encoding == Encoding::Srgb {
            new.iter_mut().for_each(|v| *v = srgb_to_linear(*v));
        }
        if let Some(mark) = marks.next() {
            *mark = f32::from(u8::from(meant));
        }
    });
    Ok(bring(image, valid, view))
}

/// Reads EXR, PNG, JPEG, or an array of height×width×channels.
fn read(path: &Path) -> Result<(Image, Encoding)> {
    if path.extension().is_none_or(|e| e != "npy") {
        return read_raster(path);
    }
    let array = NpyArray::read(path)?;
    let image = array.to_image()?;
    Ok((image, Encoding::Linear))
}

/// Undistorts a map and brings it to the size of the view.
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
