//! Photographs of common formats, turned upright.
//!
//! Programs that estimate cameras take them. Cameras from elsewhere refer to the stored pixels.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use ::image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader, Limits};

use super::{Exif, Image, file, jpeg};
use crate::camera::MAX_IMAGE_SIDE;
use crate::error::{Result, SceneError, io_error};

/// Largest number of decoded bytes per byte of a photograph. Uniform images can be smaller; photographs are not.
const RATIO: u64 = 1032;

/// Photograph with upright pixels.
#[derive(Clone, Debug, PartialEq)]
pub struct Upright {
    /// Display-referred pixels, turned as the EXIF orientation demands.
    pub image: Image,
    /// EXIF data of the file.
    pub exif: Exif,
}

/// Reads a PNG, JPEG, TIFF or WebP file and applies its EXIF orientation.
pub fn read_upright(path: &Path) -> Result<Upright> {
    let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
    let (image, exif) = match extension.as_str() {
        "jpg" | "jpeg" => (jpeg::read(path)?, jpeg::exif(path)),
        "png" => decode(path, ImageFormat::Png)?,
        "tif" | "tiff" => decode(path, ImageFormat::Tiff)?,
        "webp" => decode(path, ImageFormat::WebP)?,
        _ => {
            let problem = format!("the extension \"{extension}\" is none of jpg, jpeg, png, tif, tiff, webp");
            return Err(SceneError::image(path, problem));
        }
    };
    Ok(Upright { image: turned(image, exif.orientation), exif })
}

/// Decodes a file with the decoders of the crate `image`.
fn decode(path: &Path, format: ImageFormat) -> Result<(Image, Exif)> {
    let wrong = |e: &dyn std::fmt::Display| {
        SceneError::image(path, format!("the file cannot be read as {format:?} ({e}); copy or export it again"))
    };
    let file = File::open(path).map_err(io_error("read", path))?;
    let mut reader = ImageReader::with_format(BufReader::new(file), format);
    let mut limits = Limits::default();
    limits.max_image_width = Some(MAX_IMAGE_SIDE);
    limits.max_image_height = Some(MAX_IMAGE_SIDE);
    limits.max_alloc = Some(file::MAX_PIXELS * 8);
    reader.limits(limits);
    let mut decoder = reader.into_decoder().map_err(|e| wrong(&e))?;
    let (width, height) = decoder.dimensions();
    file::check_size(path, width, height)?;
    let length = path.metadata().map_err(io_error("read", path))?.len();
    file::check_held(path, (width, height), decoder.total_bytes(), length.saturating_mul(RATIO))?;
    let exif = match format {
        // A TIFF file is EXIF data itself.
        ImageFormat::Tiff => Exif::parse(&std::fs::read(path).map_err(io_error("read", path))?),
        _ => decoder.exif_metadata().ok().flatten().map_or_else(Exif::default, |bytes| Exif::parse(&bytes)),
    };
    let decoded = DynamicImage::from_decoder(decoder).map_err(|e| wrong(&e))?;
    Ok((file::to_image(decoded), exif))
}

/// Returns an image turned as an EXIF orientation demands.
fn turned(image: Image, orientation: u16) -> Image {
    let (w, h) = (image.width, image.height);
    let source = |x: u32, y: u32| match orientation {
        2 => (w - 1 - x, y),
        3 => (w - 1 - x, h - 1 - y),
        4 => (x, h - 1 - y),
        5 => (y, x),
        6 => (y, h - 1 - x),
        7 => (w - 1 - y, h - 1 - x),
        _ => (w - 1 - y, x),
    };
    if !(2..=8).contains(&orientation) {
        return image;
    }
    let (width, height) = if orientation >= 5 { (h, w) } else { (w, h) };
    let mut data = Vec::with_capacity(image.data.len());
    for y in 0..height {
        for x in 0..width {
            let (u, v) = source(x, y);
            data.extend_from_slice(image.pixel(u, v));
        }
    }
    Image { width, height, channels: image.channels, data }
}

#[cfg(test)]
mod tests {
    use ::image::metadata::Orientation;
    use ::image::{ExtendedColorType, ImageBuffer, ImageEncoder, Rgb, codecs};

    use super::*;
    use crate::image::exif::tests::exif;

    fn image() -> ImageBuffer<Rgb<u8>, Vec<u8>> {
        ImageBuffer::from_fn(5, 3, |x, y| Rgb([40 * x as u8, 70 * y as u8, 9]))
    }

    #[test]
    fn pixels_are_turned_as_by_another_library() {
        let ours = file::to_image(DynamicImage::ImageRgb8(image()));
        for orientation in 1..=8_u8 {
            let mut theirs = DynamicImage::ImageRgb8(image());
            theirs.apply_orientation(Orientation::from_exif(orientation).unwrap());
            assert_eq!(turned(ours.clone(), orientation.into()), file::to_image(theirs), "{orientation}");
        }
    }

    #[test]
    fn formats_are_read_with_their_exif_data() {
        let directory = tempfile::tempdir().unwrap();
        let data = exif(6, "Maker Phone", &[(0xa405, [26, 1])]);
        let raw = image().into_raw();
        let expected = turned(file::to_image(DynamicImage::ImageRgb8(image())), 6);
        let color = ExtendedColorType::Rgb8;
        let mut png = Vec::new();
        let mut encoder = codecs::png::PngEncoder::new(&mut png);
        encoder.set_exif_metadata(data.clone()).unwrap();
        encoder.write_image(&raw, 5, 3, color).unwrap();
        let mut webp = Vec::new();
        let mut encoder = codecs::webp::WebPEncoder::new_lossless(&mut webp);
        encoder.set_exif_metadata(data).unwrap();
        encoder.write_image(&raw, 5, 3, color).unwrap();
        for (name, bytes) in [("a.PNG", png), ("a.webp", webp)] {
            let path = directory.path().join(name);
            std::fs::write(&path, &bytes).unwrap();
            let read = read_upright(&path).unwrap();
            assert_eq!(read.image, expected, "{name}");
            assert_eq!((read.exif.orientation, read.exif.camera.as_str()), (6, "Maker Phone"), "{name}");
            std::fs::write(&path, &bytes[..40]).unwrap();
            let error = read_upright(&path).unwrap_err().to_string();
            assert!(error.contains(name) && error.contains("copy or export it again"), "{error}");
        }
        let path = directory.path().join("a.tif");
        DynamicImage::ImageRgb8(image()).save_with_format(&path, ImageFormat::Tiff).unwrap();
        let read = read_upright(&path).unwrap();
        assert_eq!((read.image, read.exif.orientation), (turned(expected, 8), 1));
        let error = read_upright(&directory.path().join("a.gif")).unwrap_err().to_string();
        assert!(error.contains("is none of jpg, jpeg, png, tif, tiff, webp"), "{error}");
    }
}
