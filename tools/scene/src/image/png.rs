//! PNG and JPEG encoding of 8-bit images, and PNG files with region or class ids.

use std::io;
use std::path::Path;

use ::image::codecs::jpeg::JpegEncoder;
use ::image::codecs::png::PngEncoder;
use ::image::{DynamicImage, ExtendedColorType, ImageEncoder};

use super::{Image, file};
use crate::atomic::atomic_write;
use crate::error::{Result, SceneError};

/// Writes an image as 8-bit PNG. Images have 1 to 4 channels: gray, gray-alpha, RGB, or RGBA.
///
/// Values are display-referred. They are clamped to `[0, 1]` and rounded to 255 steps; NaN becomes 0.
pub fn write_png(path: &Path, image: &Image) -> Result<()> {
    image.check()?;
    let Some(color) = color_of(image) else {
        let n = image.channels;
        return Err(SceneError::image(path, format!("a PNG holds 1 to 4 channels, not {n}; write an EXR instead")));
    };
    let bytes = bytes_of(image);
    atomic_write(path, |out| {
        PngEncoder::new(out).write_image(&bytes, image.width, image.height, color).map_err(io::Error::other)
    })
}

/// Encodes an image in memory as [`write_png`] does.
pub fn encode_png(image: &Image) -> Result<Vec<u8>> {
    let mut out = Vec::new();
    let color = encodable(image, 4)?;
    let done = PngEncoder::new(&mut out).write_image(&bytes_of(image), image.width, image.height, color);
    done.map_err(|e| SceneError::Data { what: "the image", problem: e.to_string() })?;
    Ok(out)
}

/// Encodes an image with 1 or 3 channels as JPEG in memory. `quality` is from 1 to 100. Values are converted as in
/// [`write_png`].
pub fn encode_jpeg(image: &Image, quality: u8) -> Result<Vec<u8>> {
    let mut out = Vec::new();
    let color = encodable(image, 3)?;
    let encoder = JpegEncoder::new_with_quality(&mut out, quality.clamp(1, 100));
    let done = encoder.write_image(&bytes_of(image), image.width, image.height, color);
    done.map_err(|e| SceneError::Data { what: "the image", problem: e.to_string() })?;
    Ok(out)
}

fn encodable(image: &Image, most: u32) -> Result<ExtendedColorType> {
    image.check()?;
    color_of(image).filter(|_| image.channels <= most).ok_or_else(|| {
        let problem = format!("it has {} channels, but at most {most} can be encoded", image.channels);
        SceneError::Data { what: "the image", problem }
    })
}

fn color_of(image: &Image) -> Option<ExtendedColorType> {
    Some(match image.channels {
        1 => ExtendedColorType::L8,
        2 => ExtendedColorType::La8,
        3 => ExtendedColorType::Rgb8,
        4 => ExtendedColorType::Rgba8,
        _ => return None,
    })
}

fn bytes_of(image: &Image) -> Vec<u8> {
    // Casting NaN to an integer yields 0.
    image.data.iter().map(|v| (v.clamp(0.0, 1.0) * 255.0 + 0.5) as u8).collect()
}

/// Writes integers, row by row, as a 16-bit gray PNG.
pub fn write_ids(path: &Path, width: u32, height: u32, ids: &[u16]) -> Result<()> {
    if ids.is_empty() || ids.len() as u64 != u64::from(width) * u64::from(height) {
        let problem = format!("a size of {width}×{height} does not fit {} numbers", ids.len());
        return Err(SceneError::image(path, problem));
    }
    // The encoder expects native-endian words and converts them to the file's big-endian order.
    let bytes: Vec<u8> = ids.iter().flat_map(|id| id.to_ne_bytes()).collect();
    atomic_write(path, |out| {
        PngEncoder::new(out).write_image(&bytes, width, height, ExtendedColorType::L16).map_err(io::Error::other)
    })
}

/// Reads the width, height and integers of a gray PNG with 8 or 16 bits.
pub fn read_ids(path: &Path) -> Result<(u32, u32, Vec<u16>)> {
    match file::decode_png(path)? {
        DynamicImage::ImageLuma8(image) => {
            Ok((image.width(), image.height(), image.into_raw().into_iter().map(u16::from).collect()))
        }
        DynamicImage::ImageLuma16(image) => Ok((image.width(), image.height(), image.into_raw())),
        other => {
            let problem = format!("the image is {:?}, but numbers are to be gray with 8 or 16 bits", other.color());
            Err(SceneError::image(path, problem))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Encoding, read_raster, read_size};
    use super::*;

    #[test]
    fn eight_bits_round_trip_for_every_channel_count() {
        let directory = tempfile::tempdir().unwrap();
        for channels in 1..=4_u32 {
            let path = directory.path().join(format!("{channels}.png"));
            let mut image = Image::new(5, 3, channels);
            for (i, v) in image.data.iter_mut().enumerate() {
                *v = (i * 37 % 256) as f32 / 255.0;
            }
            write_png(&path, &image).unwrap();
            assert_eq!(read_size(&path).unwrap(), (5, 3));
            assert_eq!(encode_png(&image).unwrap(), std::fs::read(&path).unwrap());
            assert_eq!(read_raster(&path).unwrap(), (image, Encoding::Srgb));
        }
    }

    #[test]
    fn encoded_jpegs_are_close_to_the_image() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.jpg");
        let data = (0..16 * 16 * 3).map(|i| (i / 48) as f32 / 16.0).collect();
        let image = Image { width: 16, height: 16, channels: 3, data };
        std::fs::write(&path, encode_jpeg(&image, 95).unwrap()).unwrap();
        let (read, _) = read_raster(&path).unwrap();
        assert!(read.data.iter().zip(&image.data).all(|(a, b)| (a - b).abs() < 0.03));
        assert!(encode_jpeg(&Image::new(2, 2, 2 + 3), 95).is_err() && encode_jpeg(&Image::new(2, 2, 4), 95).is_err());
        assert!(encode_png(&Image::new(2, 2, 5)).unwrap_err().to_string().contains("5 channels"));
    }

    #[test]
    fn values_are_clamped_and_rounded() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.png");
        let values = vec![-1.0, 7.0, f32::NAN, 0.499_9 / 255.0, 0.500_1 / 255.0];
        write_png(&path, &Image::from_data(5, 1, 1, values).unwrap()).unwrap();
        assert_eq!(read_ids(&path).unwrap(), (5, 1, vec![0, 255, 0, 0, 1]));
    }

    #[test]
    fn sixteen_bit_numbers_are_exact() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("ids.png");
        let ids: Vec<u16> = vec![0, 1, 300, 65_535];
        ::image::ImageBuffer::<::image::Luma<u16>, _>::from_raw(2, 2, ids.clone()).unwrap().save(&path).unwrap();
        assert_eq!(read_ids(&path).unwrap(), (2, 2, ids.clone()));
        write_ids(&path, 2, 2, &ids).unwrap();
        assert_eq!(read_ids(&path).unwrap(), (2, 2, ids));
        assert!(write_ids(&path, 2, 2, &[1; 3]).unwrap_err().to_string().contains("2×2 does not fit 3 numbers"));
        let (image, _) = read_raster(&path).unwrap();
        assert_eq!(image.data[3], 1.0);
        assert_eq!(image.data[2], 300.0 / 65_535.0);
    }

    #[test]
    fn unsupported_channel_counts_are_rejected() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.png");
        let error = write_png(&path, &Image::new(2, 2, 5)).unwrap_err().to_string();
        assert!(error.ends_with("a PNG holds 1 to 4 channels, not 5; write an EXR instead"), "{error}");
        write_png(&path, &Image::new(2, 2, 3)).unwrap();
        let error = read_ids(&path).unwrap_err().to_string();
        assert!(error.contains("numbers are to be gray"), "{error}");
    }

    #[test]
    fn truncated_or_damaged_files_never_panic() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.png");
        let mut image = Image::new(6, 5, 3);
        for (i, v) in image.data.iter_mut().enumerate() {
            *v = (i * 91 % 256) as f32 / 255.0;
        }
        write_png(&path, &image).unwrap();
        let whole = std::fs::read(&path).unwrap();
        // The last 12 bytes are the end marker; the image is complete without it.
        for length in 0..whole.len() - 12 {
            std::fs::write(&path, &whole[..length]).unwrap();
            let error = read_raster(&path).unwrap_err().to_string();
            assert!(error.starts_with(&path.display().to_string()), "{error}");
            assert!(error.contains("cannot be read as PNG"), "{error}");
        }
        for i in 0..whole.len() {
            let mut damaged = whole.clone();
            damaged[i] ^= 0x5a;
            std::fs::write(&path, &damaged).unwrap();
            let _ = (read_raster(&path), read_size(&path));
        }
    }
}
