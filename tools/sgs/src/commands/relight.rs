//! `sgs relight`: pictures of a run under other light, of other materials, with other things in it.

use super::train::{open_scene, validated};
use crate::cameras::splats_of;
use crate::classes::head_of;
use crate::common::Common;
use crate::pictures::{self, Format, Part, background_of, check_materials, light_of_source};
use crate::ui::Bar;
use anyhow::bail;
use sgs_scene::{Camera, Scene, Splats};
use sgs_train::{Edit, Insert, Relit, Selector, Settings, Shading, TrainError};
use std::path::PathBuf;

#[derive(clap::Args)]
pub struct Args {
    /// Run directory, or PLY file with materials.
    source: PathBuf,
    /// What changes: see docs/RELIGHT.md. Nothing by default.
    #[arg(long, value_name = "FILE.json")]
    edit: Option<PathBuf>,
    /// Cameras: a transforms file.
    #[arg(long, value_name = "FILE.json")]
    cameras: PathBuf,
    /// Directory for the pictures.
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// What to write. "relit": all light.
    #[arg(long, value_delimiter = ',', default_value = "relit")]
    channels: Vec<Channel>,
    /// File format: exr keeps the values (float32, linear), png shows them.
    #[arg(long, value_enum, default_value = "png")]
    format: Format,
    /// Another place of the scene than the run remembers, for regions of its views.
    #[arg(long)]
    scene: Option<PathBuf>,
    /// Color behind everything.
    #[arg(
        long,
        value_name = "r,g,b",
        value_delimiter = ',',
        num_args = 1,
        default_value = "0,0,0",
        allow_negative_numbers = true
    )]
    background: Vec<f32>,
}

#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Channel {
    Relit,
    Albedo,
    Roughness,
    Metallic,
    Diffuse,
    Specular,
    Env,
    Direct,
}

impl Channel {
    fn part(self) -> Part {
        match self {
            Channel::Relit => Part::Pbr,
            Channel::Albedo => Part::Albedo,
            Channel::Roughness => Part::Roughness,
            Channel::Metallic => Part::Metallic,
            Channel::Diffuse => Part::Diffuse,
            Channel::Specular => Part::Specular,
            Channel::Env => Part::Env,
            Channel::Direct => Part::Direct,
        }
    }
}

pub fn run(common: &Common, a: &Args) -> anyhow::Result<()> {
    let background = background_of(&a.background)?;
    let edit = a.edit.as_deref().map(Edit::read).transpose()?.unwrap_or_default();
    let (splats, settings) = splats_of(&a.source)?;
    check_materials(&a.source, &splats, false)?;
    let cameras = Camera::read_transforms(&a.cameras)?;
    if cameras.is_empty() {
        bail!("\"{}\" holds no cameras.", a.cameras.display());
    }
    let light = light_of_source(&a.source, settings.as_ref())?;
    let by_class = edit.materials.iter().any(|m| m.place.class.is_some());
    let head = match by_class && splats.semantic.is_some() {
        true => Some(head_of(&a.source, &splats)?),
        false => None,
    };
    let scene = scene_of(a, &edit, settings.as_ref())?;
    let device = common.open_device()?;
    let mut selector = Selector { device: &device, head, scene: scene.as_ref() };
    let size = settings.as_ref().map_or(64, |s| s.intrinsic.environment.resolution);
    let relit = Relit { splats, light }.edited(&edit, size, &mut selector, loaded)?;
    if a.channels.contains(&Channel::Metallic) && relit.splats.metallic.is_none() {
        bail!("\"{}\" has no metallic; leave \"metallic\" out of --channels.", a.source.display());
    }
    let mut shading = Shading::new(&device, relit.upload(&device)?)?;
    std::fs::create_dir_all(&a.output)
        .map_err(|e| anyhow::anyhow!("\"{}\" cannot be made: {e}.", a.output.display()))?;
    let mut bar = Bar::new(common, "rendering", cameras.len() as u64, 0);
    let mut written = Vec::new();
    for (i, camera) in cameras.iter().enumerate() {
        let shaded = shading.shade(camera)?;
        for channel in &a.channels {
            let part = channel.part();
            let name = if part == Part::Pbr { "relit" } else { part.name() };
            let image = part.of(&shaded, background);
            written.push(pictures::write(a.format, &a.output, &camera.name, name, &image)?);
        }
        bar.set(i as u64 + 1, || camera.name.clone());
    }
    bar.finish();
    let lights = relit.light.lights.as_ref().map_or(0, |l| l.lights.iter().filter(|l| l.gain > 0.0).count());
    common.answer(&serde_json::json!({"gaussians": relit.splats.len(), "lights": lights, "files": written}))?;
    validated(&device)
}

/// The scene, if regions of its views are asked for.
fn scene_of(a: &Args, edit: &Edit, settings: Option<&Settings>) -> anyhow::Result<Option<Scene>> {
    if edit.materials.iter().all(|m| m.place.region.is_none()) {
        return Ok(None);
    }
    let mut settings = settings.cloned().unwrap_or_default();
    if let Some(scene) = &a.scene {
        settings.scene.clone_from(scene);
    }
    Ok(Some(open_scene(&settings)?))
}

/// What an insertion names.
fn loaded(insert: &Insert) -> sgs_train::Result<Splats> {
    let (splats, _) = splats_of(&insert.source).map_err(|e| TrainError::Setting(e.to_string()))?;
    Ok(splats)
}
