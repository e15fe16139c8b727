//! Channels of shaded views, and the light that they need.

use anyhow::bail;
use sgs_config::Settings;
use sgs_run::{RunDirectory, RunLight, ShadedView, light_of, read_light};
use sgs_scene::{Image, Splats};
use std::path::Path;

/// Channel of a shaded view.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// Linear albedo.
    Albedo,
    /// Roughness, 0 to 1.
    Roughness,
    /// Metallic, 0 to 1.
    Metallic,
    /// Linear light of all sources over the background.
    Pbr,
    /// Linear diffuse light.
    Diffuse,
    /// Linear specular light.
    Specular,
    /// Mean visibility of the lights, 0 to 1.
    Visibility,
    /// Linear light of the environment map, with the map behind surfaces.
    Env,
    /// Linear light of the point lights.
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
