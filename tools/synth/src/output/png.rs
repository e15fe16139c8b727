//! PNG files: 8-bit color with and without alpha, 8-bit gray, 16-bit gray.

use std::path::Path;

use glam::Vec3;
use image::{ColorType, ImageFormat, save_buffer_with_format};

use crate::color::byte;
use crate::error::SynthError;

/// Writes display colors in [0, 1].
pub(crate) fn rgb(path: &Path, width: usize, height: usize, map: &[Vec3]) -> Result<(), SynthError> {
    let bytes: Vec<u8> = map.iter().flat_map(|c| c.to_array().map(byte)).collect();
    save(path, width, height, &bytes, ColorType::Rgb8)
}

/// Writes values in [0, 1] with an alpha of 0 or 1.
pub(crate) fn rgba(path: &Path, width: usize, height: usize, map: &[Vec3], alpha: &[bool]) -> Result<(), SynthError> {
    let pixel = |(c, opaque): (&Vec3, &bool)| [byte(c.x), byte(c.y), byte(c.z), if *opaque { 255 } else { 0 }];
    let bytes: Vec<u8> = map.iter().zip(alpha).flat_map(pixel).collect();
    save(path, width, height, &bytes, ColorType::Rgba8)
}

/// Writes gray values in [0, 1].
pub(crate) fn gray(path: &Path, width: usize, height: usize, map: &[f32]) -> Result<(), SynthError> {
    let bytes: Vec<u8> = map.iter().map(|v| byte(*v)).collect();
    save(path, width, height, &bytes, ColorType::L8)
}

/// Writes 8-bit numbers.
pub(crate) fn bytes(path: &Path, width: usize, height: usize, map: &[u8]) -> Result<(), SynthError> {
    save(path, width, height, map, ColorType::L8)
}

/// Writes 16-bit numbers.
pub(crate) fn words(path: &Path, width: usize, height: usize, map: &[u16]) -> Result<(), SynthError> {
    save(path, width, height, bytemuck::cast_slice(map), ColorType::L16)
}

fn save(path: &Path, width: usize, height: usize, bytes: &[u8], color: ColorType) -> Result<(), SynthError> {
    save_buffer_with_format(path, bytes, width as u32, height as u32, color, ImageFormat::Png)
        .map_err(|e| SynthError::encode(path, e))
}
