//! Image files of shaded views: materials and lighting terms.
//!
//! EXR stores the blended linear values. PNG stores light and albedo in sRGB, clamped.

use crate::failure::refuse_usage;
use sgs_run::displayed;
use sgs_scene::{Image, write_exr, write_png};
use std::path::{Path, PathBuf};

pub use sgs_api::{Part, check_materials, light_of_source};

/// Format of image files.
#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Format {
    Exr,
    Png,
}

impl Format {
    /// Returns `DIR/STEM_NAME.EXTENSION`.
    pub fn file(self, dir: &Path, stem: &str, name: &str) -> PathBuf {
        let extension = if self == Format::Exr { "exr" } else { "png" };
        dir.join(format!("{stem}_{name}.{extension}"))
    }
}

/// Writes a linear color image or a single channel. Returns the path.
pub fn write(format: Format, dir: &Path, stem: &str, name: &str, image: &Image) -> anyhow::Result<PathBuf> {
    let path = format.file(dir, stem, name);
    let names: &[&str] = if image.channels == 1 { &["Y"] } else { &["R", "G", "B"] };
    match format {
        Format::Exr => write_exr(&path, image, names)?,
        Format::Png => write_png(&path, &shown(image))?,
    }
    Ok(path)
}

/// Converts a linear color image or a single channel to display values.
pub fn shown(image: &Image) -> Image {
    if image.channels == 3 {
        return displayed(image);
    }
    Image { data: image.data.iter().map(|v| v.clamp(0.0, 1.0)).collect(), ..image.clone() }
}

/// Parses the background color of a command line.
pub fn background_of(numbers: &[f32]) -> anyhow::Result<[f32; 3]> {
    let [r, g, b] = *numbers else { refuse_usage!("--background takes three numbers, r,g,b.") };
    if ![r, g, b].iter().all(|v| v.is_finite()) {
        refuse_usage!("--background is {r},{g},{b}, but must be finite numbers.");
    }
    Ok([r, g, b])
}
