//! Files of per-pixel maps, read at their stored size.

use std::path::Path;

use glam::{DMat3, DVec3};
use serde::{Deserialize, Serialize};

use crate::error::{Result, SceneError};
use crate::image::{Encoding, Image, NpyArray, read_raster, srgb_to_linear};

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

/// Reads a map at its stored size, and its mask of valid pixels.
pub(crate) fn read(path: &Path, meaning: Meaning) -> Result<(Image, Image)> {
    let (raster, encoding) = raster(path)?;
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
pub(crate) fn is_opaque(pixel: &[f32], encoding: Encoding) -> bool {
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
pub(crate) fn raster(path: &Path) -> Result<(Image, Encoding)> {
    if path.extension().is_none_or(|e| e != "npy") {
        return read_raster(path);
    }
    let array = NpyArray::read(path)?;
    let image = array.to_image()?;
    Ok((image, Encoding::Linear))
}
