//! Images in memory and in files.
//!
//! An [`Image`] is a plain array of `f32`. The type does not record whether values are linear or sRGB-encoded; every
//! function documents which of the two it takes and returns. Files: [`read_exr`], [`write_exr`], [`write_png`], and PNG
//! and JPEG through [`View::load_image`](crate::View::load_image).

mod blocks;
mod color;
mod dwa;
mod environment;
mod exif;
mod exr;
mod file;
mod jpeg;
mod npy;
mod npy_write;
mod png;
mod resize;
mod undistort;
mod upright;

pub use color::{linear_to_srgb, srgb_to_linear};
pub use environment::{read_environment, write_environment};
pub use exif::Exif;
pub use exr::{ExrImage, names_exr_layer, read_exr, write_exr, write_exr_layers};
pub(crate) use file::{EXTENSIONS, Encoding, read_raster, read_size, stem_of, turning_orientation};
pub use npy::NpyArray;
#[cfg(test)]
pub(crate) use npy::tests::npy as npy_for_tests;
pub use npy_write::{write_npy_f16, write_npy_f32};
pub use png::{encode_jpeg, encode_png, read_ids, write_ids, write_png};
pub(crate) use resize::resized;
pub use resize::{resize, resize_valid};
pub use undistort::{undistort, undistort_coverage};
pub use upright::{Upright, read_upright};

use crate::error::{Result, SceneError};

/// Row-major, interleaved `f32` pixels, upper left first.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Image {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// Number of values per pixel.
    pub channels: u32,
    /// `width · height · channels` values.
    pub data: Vec<f32>,
}

impl Image {
    /// Creates an image of zeros.
    pub fn new(width: u32, height: u32, channels: u32) -> Self {
        let len = width as usize * height as usize * channels as usize;
        Self { width, height, channels, data: vec![0.0; len] }
    }

    /// Creates an image from its values; fails if their number does not fit the size.
    pub fn from_data(width: u32, height: u32, channels: u32, data: Vec<f32>) -> Result<Self> {
        let image = Self { width, height, channels, data };
        image.check()?;
        Ok(image)
    }

    /// Checks that the number of values fits the size and is not zero. The fields are public, so functions that take an
    /// image from outside the crate call this first.
    pub fn check(&self) -> Result<()> {
        let Self { width, height, channels, .. } = *self;
        let expected = u64::from(width).checked_mul(u64::from(height)).and_then(|n| n.checked_mul(u64::from(channels)));
        if expected == Some(self.data.len() as u64) && !self.data.is_empty() {
            return Ok(());
        }
        let problem = format!(
            "a size of {width}×{height} with {channels} channels does not fit its {} values; both must agree and not be \
             zero",
            self.data.len()
        );
        Err(SceneError::Data { what: "the image", problem })
    }

    /// Returns the number of pixels.
    pub fn pixels(&self) -> usize {
        self.width as usize * self.height as usize
    }

    /// Returns the values of the pixel in column `x`, row `y`.
    ///
    /// # Panics
    ///
    /// Panics if the pixel is outside the image.
    pub fn pixel(&self, x: u32, y: u32) -> &[f32] {
        let channels = self.channels as usize;
        let at = (y as usize * self.width as usize + x as usize) * channels;
        &self.data[at..at + channels]
    }

    /// Returns the mutable values of the pixel in column `x`, row `y`.
    ///
    /// # Panics
    ///
    /// Panics if the pixel is outside the image.
    pub fn pixel_mut(&mut self, x: u32, y: u32) -> &mut [f32] {
        let channels = self.channels as usize;
        let at = (y as usize * self.width as usize + x as usize) * channels;
        &mut self.data[at..at + channels]
    }

    /// Converts each pixel to `channels` values with `convert(old, new)`.
    pub(crate) fn map_pixels(&self, channels: u32, mut convert: impl FnMut(&[f32], &mut [f32])) -> Self {
        let mut out = Self::new(self.width, self.height, channels);
        if self.channels > 0 && channels > 0 {
            let old = self.data.chunks_exact(self.channels as usize);
            for (old, new) in old.zip(out.data.chunks_exact_mut(channels as usize)) {
                convert(old, new);
            }
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_must_fit_the_values() {
        assert!(Image::from_data(2, 1, 3, vec![0.0; 6]).is_ok());
        let error = Image::from_data(2, 2, 3, vec![0.0; 6]).unwrap_err().to_string();
        assert!(error.contains("2×2 with 3 channels does not fit its 6 values"), "{error}");
        assert!(Image::from_data(0, 0, 3, vec![]).is_err());
        assert!(Image { width: u32::MAX, height: u32::MAX, channels: u32::MAX, data: vec![0.0] }.check().is_err());
    }

    #[test]
    fn pixels_are_row_major_and_interleaved() {
        let image = Image::from_data(2, 2, 2, (0..8).map(|i| i as f32).collect()).unwrap();
        assert_eq!(image.pixel(1, 0), [2.0, 3.0]);
        assert_eq!(image.pixel(0, 1), [4.0, 5.0]);
    }
}
