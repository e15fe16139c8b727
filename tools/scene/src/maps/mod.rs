//! Per-pixel maps of views; priors and ground truth are stored alike.
//!
//! A map's file name is the stem of its view. The map covers the same field as the photograph, including its
//! distortion, and may have any size. Loading undistorts it and averages it by area to the size of the view's camera,
//! without invalid pixels.

mod normal;
mod numbers;

use std::path::{Path, PathBuf};

pub use normal::NormalFrame;
pub(crate) use normal::{finish as finish_normals, load as load_normals, stored as stored_normals};
pub use numbers::RegionMap;
pub(crate) use numbers::{cells, load as load_numbers, load_seen as load_numbers_seen};

use crate::error::{Result, SceneError};
use crate::image::{Encoding, Image, NpyArray, read_raster, resize_valid, srgb_to_linear, undistort};
use crate::view::View;

/// Map with a mask of valid pixels.
#[derive(Clone, Debug, PartialEq)]
pub struct MaskedMap {
    /// Values; 0 where invalid.
    pub image: Image,
    /// Validity in one channel: 1 where the values are valid, else 0.
    pub valid: Image,
}

/// Meaning of the values of a map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Meaning {
    /// Three color channels, linear in EXR and sRGB-encoded in PNG; converted to linear.
    Color,
    /// Three color channels, linear in files of any format.
    LinearColor,
    /// First channel, unconverted.
    Scalar,
    /// Channel with this index, unconverted.
    Channel(u32),
    /// Alpha channel; 1 if the file has none.
    Alpha,
    /// First channel, valid only where positive.
    Depth,
}

/// Returns the path of a map, with the first extension that exists.
pub(crate) fn find(folder: &Path, stem: &str, extensions: &[&str]) -> Option<PathBuf> {
    extensions.iter().map(|extension| folder.join(format!("{stem}.{extension}"))).find(|path| path.is_file())
}

/// Loads a map for a view.
pub(crate) fn load(path: &Path, view: &View, meaning: Meaning) -> Result<MaskedMap> {
    let (image, valid) = stored(path, meaning)?;
    Ok(bring(image, valid, view))
}

/// Reads a map at its stored size, and its mask of valid pixels.
pub(crate) fn stored(path: &Path, meaning: Meaning) -> Result<(Image, Image)> {
    let (raster, encoding) = read(path)?;
    let channels = if matches!(meaning, Meaning::Color | Meaning::LinearColor) { 3 } else { 1 };
    if let Meaning::Channel(number) = meaning
        && number >= raster.channels
    {
        let problem = format!("the map has {} channels; it must have {} or more", raster.channels, number + 1);
        return Err(SceneError::image(path, problem));
    }
    let mut valid = Image::new(raster.width, raster.height, 1);
    let mut marks = valid.data.iter_mut();
    let image = raster.map_pixels(channels, |old, new| {
        match (meaning, old, new.len()) {
            (Meaning::Channel(number), old, _) => new.fill(old[number as usize]),
            (Meaning::Alpha, &[_, a] | &[_, _, _, a], _) => new.fill(a),
            (Meaning::Alpha, _, _) => new.fill(1.0),
            (_, &[r, g, b, ..], 3) => new.copy_from_slice(&[r, g, b]),
            (_, &[v, ..], _) => new.fill(v),
            (_, &[], _) => {}
        }
        let opaque = meaning == Meaning::Alpha || is_opaque(old, encoding);
        let meant = opaque && new.iter().all(|v| v.is_finite()) && (meaning != Meaning::Depth || new[0] > 0.0);
        if meaning == Meaning::Color && encoding == Encoding::Srgb {
            new.iter_mut().for_each(|v| *v = srgb_to_linear(*v));
        }
        if let Some(mark) = marks.next() {
            *mark = f32::from(u8::from(meant));
        }
    });
    Ok((image, valid))
}

/// Returns whether a pixel is opaque. Straight alpha marks the pixels for which a map was computed.
fn is_opaque(pixel: &[f32], encoding: Encoding) -> bool {
    !matches!(*pixel, [_, a] | [_, _, _, a] if encoding == Encoding::Srgb && a < 0.5)
}

/// Marks pixels as invalid that a mask of the same size excludes.
pub(crate) fn exclude(valid: &mut Image, mask: &Image) {
    for (v, &m) in valid.data.iter_mut().zip(&mask.data) {
        if m <= 0.5 {
            *v = 0.0;
        }
    }
}

/// Reads EXR, PNG, JPEG, or a NumPy array (see [`NpyArray::to_image`]).
fn read(path: &Path) -> Result<(Image, Encoding)> {
    if path.extension().is_none_or(|e| e != "npy") {
        return read_raster(path);
    }
    let array = NpyArray::read(path)?;
    let image = array.to_image()?;
    Ok((image, Encoding::Linear))
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
