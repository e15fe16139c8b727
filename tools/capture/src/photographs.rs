//! Photographs of a folder, copied upright and in a format that COLMAP reads.
//!
//! JPEG files without an EXIF orientation are copied unchanged. Others are decoded, turned, and written as JPEG (JPEG,
//! WebP) or PNG (PNG, TIFF). HEIC is decoded by libheif's program rather than by a library: libheif is under the LGPL and
//! needs C headers to build against, and HEVC decoders are covered by patents, which a distribution's package settles.

use crate::error::{CaptureError, Result, io_error};
use crate::prepared::{Prepared, QUALITY};
use crate::process::{Processes, Program};
use crate::record::Unregistered;
use sgs_scene::{Image, atomic_write, encode_jpeg, read_upright, write_png};
use std::collections::HashSet;
use std::io::Write;
use std::path::{Path, PathBuf};

const HEIF: Program = Program { name: "heif-convert", package: "libheif-examples" };

/// Extensions of photographs.
const EXTENSIONS: [&str; 8] = ["jpg", "jpeg", "png", "tif", "tiff", "webp", "heic", "heif"];

/// Returns the photographs in a folder, or in its folder `images`, by name.
pub(crate) fn list(source: &Path) -> Result<Vec<PathBuf>> {
    let inner = source.join("images");
    for folder in [source, &inner] {
        if !folder.is_dir() {
            continue;
        }
        let entries = std::fs::read_dir(folder).map_err(io_error("read", folder))?;
        let paths = entries.flatten().map(|entry| entry.path()).filter(|path| path.is_file());
        let mut found: Vec<PathBuf> = paths.filter(|path| EXTENSIONS.contains(&extension(path).as_str())).collect();
        if !found.is_empty() {
            found.sort();
            return Ok(found);
        }
    }
    Err(CaptureError::Input(format!(
        "{} holds no photographs; give a folder with files of the formats {}",
        source.display(),
        EXTENSIONS.join(", ")
    )))
}

/// Returns whether a file has the extension of a photograph.
pub(crate) fn is_photograph(path: &Path) -> bool {
    EXTENSIONS.contains(&extension(path).as_str())
}

fn extension(path: &Path) -> String {
    path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default()
}

/// Copies photographs into `folder`. Returns the copies, and the photographs that cannot be read.
pub(crate) fn prepare(
    files: &[PathBuf],
    folder: &Path,
    processes: &Processes,
) -> Result<(Vec<Prepared>, Vec<Unregistered>)> {
    let (mut prepared, mut unreadable, mut stems) = (Vec::new(), Vec::new(), HashSet::new());
    for path in files {
        processes.check()?;
        let file = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let mut stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        // Views are identified by their stems.
        if !stems.insert(stem.to_lowercase()) {
            stem = file.replace('.', "_");
            stems.insert(stem.to_lowercase());
        }
        match one(path, &stem, folder, processes) {
            Ok(photograph) => prepared.push(Prepared { file, ..photograph }),
            Err(CaptureError::Scene(error)) if !error.is_storage_error() => {
                let reason = error.to_string();
                let reason = reason.strip_prefix(&format!("{}: ", path.display())).unwrap_or(&reason).to_owned();
                unreadable.push(Unregistered { file, reason });
            }
            Err(CaptureError::Program { message, .. }) => {
                unreadable.push(Unregistered { file, reason: format!("the file cannot be read as HEIC ({message})") });
            }
            Err(error) => return Err(error),
        }
    }
    Ok((prepared, unreadable))
}

fn one(path: &Path, stem: &str, folder: &Path, processes: &Processes) -> Result<Prepared> {
    let extension = extension(path);
    let converted = folder.join(format!("{stem}.jpg"));
    let heif = ["heic", "heif"].contains(&extension.as_str());
    if heif {
        let mut command = HEIF.command();
        command.args(["-q", &QUALITY.to_string()]).arg(path).arg(&converted);
        processes.run(HEIF, HEIF.name, &mut command)?;
    }
    let source = if heif { &converted } else { path };
    let upright = read_upright(source)?;
    let (image, exif) = (upright.image, upright.exif);
    let mut size = (image.width, image.height);
    let lossless = ["png", "tif", "tiff"].contains(&extension.as_str());
    let name = format!("{stem}.{}", if lossless { "png" } else { "jpg" });
    let target = folder.join(&name);
    match extension.as_str() {
        // The program has turned the pixels; some versions leave the entry.
        _ if heif && exif.orientation >= 5 => size = (size.1, size.0),
        _ if heif => {}
        "jpg" | "jpeg" if exif.orientation == 1 => {
            std::fs::copy(path, &target).map_err(io_error("copy", path))?;
        }
        _ if lossless => write_png(&target, &opaque(image))?,
        _ => {
            let bytes = encode_jpeg(&opaque(image), QUALITY)?;
            atomic_write(&target, |out| out.write_all(&bytes))?;
        }
    }
    let focal = exif.focal_pixels(size.0, size.1);
    Ok(Prepared { file: String::new(), name, size, focal, camera: exif.camera })
}

/// Returns gray or RGB values on black.
fn opaque(image: Image) -> Image {
    if !matches!(image.channels, 2 | 4) {
        return image;
    }
    let colors = image.channels as usize - 1;
    let each = image.data.chunks_exact(colors + 1);
    let data = each.flat_map(|pixel| pixel[..colors].iter().map(|v| v * pixel[colors])).collect();
    Image { width: image.width, height: image.height, channels: colors as u32, data }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::AtomicBool;

    #[test]
    fn photographs_are_copied_upright_under_unique_stems() {
        let (source, target) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let image = Image::from_data(2, 1, 3, vec![0.0, 0.2, 0.4, 0.6, 0.8, 1.0]).unwrap();
        let jpeg = encode_jpeg(&image, 90).unwrap();
        // EXIF data with the orientation 6 after the first marker.
        let tiff = b"Exif\0\0II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0";
        let segment = [&[0xff, 0xe1, 0, tiff.len() as u8 + 2], tiff.as_slice()].concat();
        let turned = [&jpeg[..2], &segment, &jpeg[2..]].concat();
        std::fs::write(source.path().join("a.jpg"), &jpeg).unwrap();
        std::fs::write(source.path().join("b.JPG"), &turned).unwrap();
        std::fs::write(source.path().join("c.jpg"), &jpeg[..jpeg.len() - 4]).unwrap();
        std::fs::write(source.path().join("notes.txt"), "").unwrap();
        write_png(&source.path().join("a.png"), &Image::from_data(1, 1, 4, vec![1.0, 0.5, 0.0, 0.4]).unwrap()).unwrap();
        let files = list(source.path()).unwrap();
        assert_eq!(files.len(), 4);
        let stop = AtomicBool::new(false);
        let processes = Processes { folder: target.path(), stop: &stop };
        let (prepared, unreadable) = prepare(&files, target.path(), &processes).unwrap();
        let found: Vec<_> = prepared.iter().map(|p| (p.file.as_str(), p.name.as_str(), p.size)).collect();
        let expected = [("a.jpg", "a.jpg", (2, 1)), ("a.png", "a_png.png", (1, 1)), ("b.JPG", "b.jpg", (1, 2))];
        assert_eq!(found, expected);
        assert_eq!(unreadable[0].file, "c.jpg");
        assert_eq!(unreadable[0].reason, "the JPEG file ends before its image does; copy it again");
        assert_eq!(std::fs::read(target.path().join("a.jpg")).unwrap(), jpeg);
        let png = read_upright(&target.path().join("a_png.png")).unwrap().image;
        assert_eq!((png.channels, png.data), (3, vec![102.0 / 255.0, 51.0 / 255.0, 0.0]));
    }

    #[test]
    fn folders_without_photographs_are_refused() {
        let source = tempfile::tempdir().unwrap();
        let error = list(source.path()).unwrap_err().to_string();
        assert!(error.contains("holds no photographs; give a folder"), "{error}");
        std::fs::create_dir(source.path().join("images")).unwrap();
        std::fs::write(source.path().join("images/x.HEIC"), "").unwrap();
        assert_eq!(list(source.path()).unwrap(), [source.path().join("images/x.HEIC")]);
    }
}
