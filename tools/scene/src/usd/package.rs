//! Files of USD: text, or a package.

use super::UsdLight;
use super::text::{self, Stage};
use crate::atomic::atomic_write;
use crate::error::{Result, io_error};
use crate::placement::Placement;
use crate::splats::Splats;
use std::io::Write;
use std::path::Path;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

/// Alignment of the files of a package in bytes.
const ALIGNMENT: u16 = 64;

/// Writes splats and lights as `.usda` or `.usdz`.
///
/// A `.usdz` holds the environment map.
///
/// The text of a `.usda` names the environment map by its file name, which must be beside it.
///
/// # Errors
/// Fails if the environment map cannot be read, or if writing fails.
pub fn write_usd(
    path: &Path,
    splats: &Splats,
    lights: &[UsdLight],
    environment: Option<&Path>,
    transform: Option<&Placement>,
) -> Result<()> {
    splats.check()?;
    let package = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("usdz"));
    let beside = environment.and_then(|file| Some(file.file_name()?.to_string_lossy().into_owned()));
    let name = if package { environment.map(|_| "environment.exr") } else { beside.as_deref() };
    let stage = Stage { splats, lights, environment: name, transform };
    if !package {
        return atomic_write(path, |out| text::write(out, &stage));
    }
    let map = environment.map(|file| std::fs::read(file).map_err(io_error("read", file))).transpose()?;
    atomic_write(path, |out| {
        let options = SimpleFileOptions::default()
            .compression_method(CompressionMethod::Stored)
            .last_modified_time(zip::DateTime::default())
            .with_alignment(ALIGNMENT);
        let mut archive = ZipWriter::new(out);
        archive.start_file("scene.usda", options)?;
        text::write(&mut archive, &stage)?;
        if let (Some(name), Some(bytes)) = (name, &map) {
            archive.start_file(name, options)?;
            archive.write_all(bytes)?;
        }
        archive.finish()?;
        Ok(())
    })
}
