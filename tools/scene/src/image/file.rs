//! Reading an image file of any supported format.
//!
//! The extension selects the format, because scenes name their files; the decoder then verifies the content. Decoded
//! sizes are limited by fixed bounds and by the largest image that the file's bytes can hold. A damaged header
//! therefore cannot request memory that the image would not fill.

use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::Path;

use ::image::{DynamicImage, ImageFormat, ImageReader, Limits};

use super::{Image, exr, jpeg};
use crate::camera::MAX_IMAGE_SIDE;
use crate::error::{Result, SceneError, io_error};

/// Largest accepted number of pixels.
pub(super) const MAX_PIXELS: u64 = 1 << 28;

/// Largest number of decoded bytes per byte of a PNG file. Deflate needs at least two bits for 258 bytes.
const PNG_RATIO: u64 = 1032;

/// Encoding of a file's color values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Encoding {
    /// Display-referred values in `[0, 1]` (PNG, JPEG).
    Srgb,
    /// Linear values without an upper limit (EXR).
    Linear,
}

/// Supported extensions, in search order.
pub(crate) const EXTENSIONS: [&str; 4] = ["png", "jpg", "jpeg", "exr"];

/// Returns whether readers support this image extension, in any case.
fn is_image_extension(extension: &str) -> bool {
    EXTENSIONS.contains(&extension.to_lowercase().as_str())
}

/// Returns the file name without its image extension. Names may contain other dots: `frame.0001` is a complete stem.
pub(crate) fn stem_of(path: &Path) -> String {
    let known = path.extension().is_some_and(|e| is_image_extension(&e.to_string_lossy()));
    let name = if known { path.file_stem() } else { path.file_name() };
    name.unwrap_or_default().to_string_lossy().into_owned()
}

enum Kind {
    Exr,
    Png,
    Jpeg,
}

fn kind_of(path: &Path) -> Result<Kind> {
    let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
    match extension.as_str() {
        "exr" => Ok(Kind::Exr),
        "png" => Ok(Kind::Png),
        "jpg" | "jpeg" => Ok(Kind::Jpeg),
        _ => Err(SceneError::image(path, format!("the extension \"{extension}\" is none of png, jpg, jpeg, exr"))),
    }
}

/// Reads an image and its encoding. PNG and JPEG values are divided by their maximum. Gray, gray-alpha, RGB and RGBA
/// images keep their channels. EXR files return all channels, colors first.
pub(crate) fn read_raster(path: &Path) -> Result<(Image, Encoding)> {
    match kind_of(path)? {
        Kind::Exr => Ok((exr::read_exr(path)?.image, Encoding::Linear)),
        Kind::Png => Ok((to_image(decode_png(path)?), Encoding::Srgb)),
        Kind::Jpeg => Ok((jpeg::read(path)?, Encoding::Srgb)),
    }
}

/// Returns the width and height from the file's header.
pub(crate) fn read_size(path: &Path) -> Result<(u32, u32)> {
    match kind_of(path)? {
        Kind::Exr => exr::read_size(path),
        Kind::Png => png_size(path),
        Kind::Jpeg => jpeg::read_size(path),
    }
}

/// Returns the EXIF orientation of the stored pixels if they are not upright: 2 to 8.
pub(crate) fn turning_orientation(path: &Path) -> Option<u16> {
    match kind_of(path) {
        Ok(Kind::Jpeg) => Some(jpeg::exif(path).orientation).filter(|o| *o >= 2),
        _ => None,
    }
}

/// Returns an error for empty or excessive image sizes.
pub(super) fn check_size(path: &Path, width: u32, height: u32) -> Result<()> {
    if width == 0 || height == 0 {
        return Err(SceneError::image(path, format!("the image is {width}×{height} pixels, which is empty")));
    }
    if width > MAX_IMAGE_SIDE || height > MAX_IMAGE_SIDE || u64::from(width) * u64::from(height) > MAX_PIXELS {
        let problem =
            format!("the header gives {width}×{height} pixels, more than an image may have; the file is damaged");
        return Err(SceneError::image(path, problem));
    }
    Ok(())
}

/// Returns an error if an image needs more bytes than the file can hold. Such a file is truncated, or its header is
/// damaged. `held` is the largest number of bytes that the file can hold.
pub(super) fn check_held(path: &Path, (width, height): (u32, u32), bytes: u64, held: u64) -> Result<()> {
    if bytes <= held {
        return Ok(());
    }
    let problem =
        format!("the header gives {width}×{height} pixels, which a file as short as this cannot hold; copy it again");
    Err(SceneError::image(path, problem))
}

/// Returns the size from a PNG header and checks that the file can hold it.
fn png_size(path: &Path) -> Result<(u32, u32)> {
    let (width, height) = open_png(path)?.into_dimensions().map_err(|e| undecodable(path, &e))?;
    check_size(path, width, height)?;
    let mut file = File::open(path).map_err(io_error("read", path))?;
    let length = file.metadata().map_err(io_error("read", path))?.len();
    // Bit depth and color type follow the width and height in the first chunk.
    let mut kind = [0; 2];
    file.seek(SeekFrom::Start(24)).and_then(|_| file.read_exact(&mut kind)).map_err(io_error("read", path))?;
    let samples = match kind[1] {
        2 => 3,
        4 => 2,
        6 => 4,
        _ => 1,
    };
    let bytes = u64::from(width) * u64::from(height) * u64::from(kind[0].max(1)) * samples / 8;
    check_held(path, (width, height), bytes, length.saturating_mul(PNG_RATIO))?;
    Ok((width, height))
}

fn open_png(path: &Path) -> Result<ImageReader<BufReader<File>>> {
    let file = File::open(path).map_err(io_error("read", path))?;
    let mut reader = ImageReader::with_format(BufReader::new(file), ImageFormat::Png);
    let mut limits = Limits::default();
    limits.max_image_width = Some(MAX_IMAGE_SIDE);
    limits.max_image_height = Some(MAX_IMAGE_SIDE);
    limits.max_alloc = Some(MAX_PIXELS * 8);
    reader.limits(limits);
    Ok(reader)
}

fn undecodable(path: &Path, error: &::image::ImageError) -> SceneError {
    SceneError::image(path, format!("the file cannot be read as PNG ({error}); copy or export it again"))
}

/// Decodes a PNG file.
pub(super) fn decode_png(path: &Path) -> Result<DynamicImage> {
    // Check the size before the decoder allocates memory for it.
    png_size(path)?;
    open_png(path)?.decode().map_err(|e| undecodable(path, &e))
}

pub(super) fn to_image(decoded: DynamicImage) -> Image {
    let (width, height) = (decoded.width(), decoded.height());
    let bytes = |raw: Vec<u8>| raw.into_iter().map(|v| f32::from(v) / 255.0).collect();
    let words = |raw: Vec<u16>| raw.into_iter().map(|v| f32::from(v) / 65_535.0).collect();
    let (channels, data) = match decoded {
        DynamicImage::ImageLuma8(image) => (1, bytes(image.into_raw())),
        DynamicImage::ImageLumaA8(image) => (2, bytes(image.into_raw())),
        DynamicImage::ImageRgb8(image) => (3, bytes(image.into_raw())),
        DynamicImage::ImageRgba8(image) => (4, bytes(image.into_raw())),
        DynamicImage::ImageLuma16(image) => (1, words(image.into_raw())),
        DynamicImage::ImageLumaA16(image) => (2, words(image.into_raw())),
        DynamicImage::ImageRgb16(image) => (3, words(image.into_raw())),
        DynamicImage::ImageRgba16(image) => (4, words(image.into_raw())),
        other => (4, other.into_rgba32f().into_raw()),
    };
    Image { width, height, channels, data }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stems_drop_only_image_extensions() {
        let stem = |s: &str| stem_of(Path::new(s));
        assert_eq!(stem("images/000.png"), "000");
        assert_eq!(stem("images/a.JPG"), "a");
        assert_eq!(stem("images/frame.0001"), "frame.0001");
        assert_eq!(stem("images/frame.0001.exr"), "frame.0001");
        assert_eq!(stem(""), "");
    }

    #[test]
    fn jpeg_is_read_and_damage_never_panics() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.JPG");
        let pixels: Vec<u8> = (0..24 * 16 * 3).map(|i| (i * 7 % 256) as u8).collect();
        let buffer = ::image::RgbImage::from_raw(24, 16, pixels).unwrap();
        buffer.save_with_format(&path, ImageFormat::Jpeg).unwrap();
        let (image, encoding) = read_raster(&path).unwrap();
        assert_eq!((image.width, image.height, image.channels, encoding), (24, 16, 3, Encoding::Srgb));
        assert!(image.data.iter().all(|v| (0.0..=1.0).contains(v)));

        let whole = std::fs::read(&path).unwrap();
        std::fs::write(&path, &whole[..whole.len() / 4]).unwrap();
        let error = read_raster(&path).unwrap_err().to_string();
        assert!(error.contains("a.JPG: the JPEG file ends before its image does"), "{error}");
        for i in 0..whole.len() {
            let mut damaged = whole.clone();
            damaged[i] ^= 0xa5;
            std::fs::write(&path, &damaged).unwrap();
            let _ = (read_raster(&path), read_size(&path));
            std::fs::write(&path, &whole[..i]).unwrap();
            let _ = (read_raster(&path), read_size(&path));
        }
    }

    #[test]
    fn invalid_sizes_and_formats_are_rejected() {
        let path = Path::new("a.png");
        assert!(check_size(path, 0, 5).unwrap_err().to_string().contains("0×5 pixels, which is empty"));
        let error = check_size(path, 65_000, 65_000).unwrap_err().to_string();
        assert!(error.contains("65000×65000 pixels, more than an image may have"), "{error}");
        assert!(check_size(path, 16_384, 16_384).is_ok());
        let error = read_raster(Path::new("a.bmp")).unwrap_err().to_string();
        assert_eq!(error, "a.bmp: the extension \"bmp\" is none of png, jpg, jpeg, exr");
        assert!(read_size(Path::new("none.png")).unwrap_err().to_string().starts_with("cannot read none.png"));
    }

    /// A header with four billion pixels must not cause an allocation for them.
    #[test]
    fn excessive_header_size_is_rejected() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.exr");
        super::super::write_exr(&path, &Image::new(3, 2, 1), &["Y"]).unwrap();
        let mut bytes = std::fs::read(&path).unwrap();
        for name in [&b"dataWindow"[..], b"displayWindow"] {
            let at = bytes.windows(name.len()).position(|w| w == name).unwrap() + name.len() + 1 + 6 + 4;
            bytes[at + 8..at + 16].copy_from_slice(&[0xff, 0xff, 0, 0, 0xff, 0xff, 0, 0]);
        }
        std::fs::write(&path, bytes).unwrap();
        let error = read_raster(&path).unwrap_err().to_string();
        assert!(error.contains("65536×65536 pixels, more than an image may have"), "{error}");
    }

    /// A header with a valid size that the file is too short for is rejected as well.
    #[test]
    fn file_too_short_for_its_header_is_rejected() {
        let directory = tempfile::tempdir().unwrap();
        let error = |name: &str, bytes: &[u8]| {
            let path = directory.path().join(name);
            std::fs::write(&path, bytes).unwrap();
            let (size, read) = (read_size(&path).unwrap_err().to_string(), read_raster(&path).unwrap_err().to_string());
            assert_eq!(size, read);
            read
        };
        let path = directory.path().join("a.exr");
        super::super::write_exr(&path, &Image::new(3, 2, 1), &["Y"]).unwrap();
        let mut bytes = std::fs::read(&path).unwrap();
        for name in [&b"dataWindow"[..], b"displayWindow"] {
            let at = bytes.windows(name.len()).position(|w| w == name).unwrap() + name.len() + 1 + 6 + 4;
            bytes[at + 8..at + 16].copy_from_slice(&[0xff, 0x3f, 0, 0, 0xff, 0x3f, 0, 0]);
        }
        let exr = error("b.exr", &bytes);
        let message = "16384×16384 pixels, which a file as short as this cannot hold; copy it again";
        assert!(exr.contains(message), "{exr}");
        // Black compresses best; the highest ratio that occurs in practice must be accepted.
        let black = ::image::GrayImage::new(3000, 3000);
        let path = directory.path().join("a.png");
        black.save(&path).unwrap();
        assert_eq!(read_size(&path).unwrap(), (3000, 3000));
        let whole = std::fs::read(&path).unwrap();
        let png = error("b.png", &whole[..4000]);
        assert!(png.contains("3000×3000 pixels, which a file"), "{png}");
        let path = directory.path().join("a.jpg");
        black.save(&path).unwrap();
        assert_eq!(read_raster(&path).unwrap().0.width, 3000);
        let jpeg = error("b.jpg", &std::fs::read(&path).unwrap()[..1200]);
        assert!(jpeg.contains("3000×3000 pixels, which a file"), "{jpeg}");
    }
}
