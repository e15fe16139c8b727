//! Image files of shaded views: materials and lighting terms.
//!
//! EXR stores the blended linear values. PNG stores light and albedo in sRGB, clamped.

use crate::failure::refuse_usage;
use anyhow::bail;
use sgs_config::Settings;
use sgs_run::{RunDirectory, RunLight, ShadedView, displayed, light_of, read_light};
use sgs_scene::{Image, Splats, write_exr, write_png};
use std::path::{Path, PathBuf};

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

/// Channel of a shaded view.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    Albedo,
    Roughness,
    Metallic,
    Pbr,
    Diffuse,
    Specular,
    Visibility,
    Env,
    Direct,
}

impl Part {
    /// Returns the name of the channel in file names.
    pub fn name(self) -> &'static str {
        match self {
            Part::Albedo => "albedo",
            Part::Roughness => "roughness",
            Part::Metallic => "metallic",
            Part::Pbr => "pbr",
            Part::Diffuse => "diffuse",
            Part::Specular => "specular",
            Part::Visibility => "visibility",
            Part::Env => "env",
            Part::Direct => "direct",
        }
    }

    /// Returns whether the channel depends on the light.
    pub fn is_light(self) -> bool {
        !matches!(self, Part::Albedo | Part::Roughness | Part::Metallic)
    }

    /// Extracts the channel from a view. The background is display-referred and applies to `Pbr` only.
    pub fn of(self, view: &ShadedView, background: [f32; 3]) -> Image {
        match self {
            Part::Albedo => view.albedo(),
            Part::Roughness => view.roughness(),
            Part::Metallic => view.metallic(),
            Part::Pbr => view.radiance(background),
            Part::Diffuse => view.diffuse(),
            Part::Specular => view.specular(),
            Part::Visibility => view.visibility().unwrap_or_else(|| view.coverage()),
            Part::Env => view.environment_map(),
            Part::Direct => view.direct(),
        }
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

/// Reads the light of a run or file: lights inside or beside it, environment map beside it.
pub fn light_of_source(source: &Path, settings: Option<&Settings>) -> anyhow::Result<RunLight> {
    let Some(settings) = settings else {
        return Ok(read_light(source, Settings::default().intrinsic.environment.resolution)?);
    };
    Ok(light_of(&RunDirectory::open(source)?, settings)?)
}

/// Refuses splats that lack the channels shading needs.
pub fn check_materials(source: &Path, splats: &Splats, metallic: bool) -> anyhow::Result<()> {
    let missing = [
        ("materials", splats.albedo.is_none() || splats.roughness.is_none()),
        ("metallic", metallic && splats.metallic.is_none()),
        ("normals", splats.normals.is_none()),
    ];
    if let Some((what, _)) = missing.iter().find(|(_, missing)| *missing) {
        bail!("\"{}\" has no {what}; train its materials with --stage intrinsic.", source.display());
    }
    Ok(())
}

/// Parses the background color of a command line.
pub fn background_of(numbers: &[f32]) -> anyhow::Result<[f32; 3]> {
    let [r, g, b] = *numbers else { refuse_usage!("--background takes three numbers, r,g,b.") };
    if ![r, g, b].iter().all(|v| v.is_finite()) {
        refuse_usage!("--background is {r},{g},{b}, but must be finite numbers.");
    }
    Ok([r, g, b])
}
