//! Images of a run under other light, with other materials or inserted objects: `sgs relight`.

use super::train::validated;
use crate::cameras::splats_of;
use crate::common::Common;
use crate::failure::refuse_usage;
use crate::images::{self, Format, Part, background_of, check_materials};
use crate::output;
use crate::ui::Bar;
use crate::video::VideoArgs;
use crate::viewpoints::ViewpointArgs;
use sgs_api::{Relighting, RelitScene, Shadows};
use sgs_engine::Device;
use sgs_relight::{BakeOptions, Edit, bake, bake_cameras, baked_psnr};
use sgs_run::Shading;
use sgs_scene::{Camera, Splats};
use std::path::{Path, PathBuf};

#[derive(clap::Args)]
pub struct Args {
    /// Run directory, or a PLY or glTF file with materials.
    source: PathBuf,
    /// Edit to apply (docs/guide/relight.md); none by default.
    #[arg(long, value_name = "FILE.json")]
    edit: Option<PathBuf>,
    #[command(flatten)]
    viewpoints: ViewpointArgs,
    /// Directory for the images.
    #[arg(short, long, value_name = "DIR", required_unless_present_any = ["bake", "video"])]
    output: Option<PathBuf>,
    #[command(flatten)]
    video: VideoArgs,
    /// Also write the relit scene as a PLY for any 3DGS viewer. Its colors are plain spherical harmonics. They are
    /// fitted to relit images from and between the training views, or from --cameras if the source is a PLY.
    #[arg(long, value_name = "FILE.ply")]
    bake: Option<PathBuf>,
    /// Highest band of the harmonics of --bake; by default that of the scene.
    #[arg(long, value_name = "0..3", requires = "bake", value_parser = clap::value_parser!(u32).range(0..=3))]
    bake_degree: Option<u32>,
    /// Steps of the fit of --bake; 0 shades each Gaussian alone.
    #[arg(long, value_name = "N", requires = "bake", default_value_t = 600)]
    bake_steps: u32,
    /// Channels to write. "relit" is the image under all lighting.
    #[arg(long, value_delimiter = ',', default_value = "relit")]
    channels: Vec<Channel>,
    /// Write into a directory with other files.
    #[arg(long)]
    force: bool,
    /// File format: exr (linear values, float32) or png (display values).
    #[arg(long, value_enum, default_value = "png")]
    format: Format,
    /// Shadows: learned (visibility field), traced (rays through the Gaussians), or none. By default those of the run;
    /// traced if no light of the run is left at its position.
    #[arg(long, value_enum)]
    visibility: Option<Seen>,
    /// Background color.
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

#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Seen {
    Learned,
    Traced,
    None,
}

impl Seen {
    fn shadows(self) -> Shadows {
        match self {
            Seen::Learned => Shadows::Learned,
            Seen::Traced => Shadows::Traced,
            Seen::None => Shadows::None,
        }
    }
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
    if a.video.video.is_some() && a.channels.len() != 1 {
        refuse_usage!("--video shows one channel; name only one with --channels.");
    }
    if let Some(output) = &a.output {
        output::check_images(output, a.force)?;
    }
    let mut video = a.video.open()?;
    let (splats, settings) = splats_of(&a.source)?;
    check_materials(&a.source, &splats, false)?;
    if let Some(file) = &a.bake {
        check_bake(a, file, settings.is_some())?;
    }
    let relighting = Relighting::new(&a.source, &splats, settings.as_ref(), &edit, a.visibility.map(Seen::shadows))?;
    let scene = match relighting.needs_scene() || a.bake.is_some() && settings.is_some() {
        true => Some(a.viewpoints.open_scene(&a.source, settings.as_ref())?),
        false => None,
    };
    let cameras = match a.output.is_some() || video.is_some() || a.viewpoints.choose_cameras() {
        true => a.viewpoints.cameras(&a.source, settings.as_ref(), &splats, scene.as_ref())?,
        false => Vec::new(),
    };
    let from = match (&scene, &settings) {
        (Some(scene), Some(s)) if a.bake.is_some() => bake_cameras(scene, &s.geometry.pseudo)?,
        _ => cameras.clone(),
    };
    let device = common.open_device()?;
    let RelitScene { relit, emitting, mut shading } = relighting.apply(&device, splats, scene.as_ref())?;
    if a.channels.contains(&Channel::Metallic) && relit.splats.metallic.is_none() {
        refuse_usage!("\"{}\" has no metallic; leave \"metallic\" out of --channels.", a.source.display());
    }
    let mut written = Vec::new();
    if let Some(output) = &a.output {
        output::make(output)?;
    }
    if a.output.is_some() || video.is_some() {
        let mut bar = Bar::new(common, "rendering", cameras.len() as u64, 0);
        for (i, camera) in cameras.iter().enumerate() {
            let shaded = shading.shade(camera)?;
            for channel in &a.channels {
                let part = channel.part();
                let name = if part == Part::Pbr { "relit" } else { part.name() };
                let image = part.of(&shaded, background);
                if let Some(output) = &a.output {
                    written.push(images::write(a.format, output, &camera.name, name, &image)?);
                }
                if let Some(video) = &mut video {
                    video.push(&images::shown(&image))?;
                }
            }
            bar.set(i as u64 + 1, || camera.name.clone());
        }
        bar.finish();
    }
    if let Some(video) = video {
        written.push(video.finish()?);
    }
    let lights = match &emitting {
        Some(emitting) => emitting.file.emitters.iter().filter(|e| e.on).count(),
        None => relit.light.lights.as_ref().map_or(0, |l| l.lights.iter().filter(|l| l.gain > 0.0).count()),
    };
    let mut answer = serde_json::json!({"gaussians": relit.splats.len(), "lights": lights, "files": written});
    if let Some(file) = &a.bake {
        let target = BakeTarget { from: &from, others: &cameras, background, file };
        answer["bake"] = baked(common, a, &device, &relit.splats, &mut shading, &target)?;
    }
    common.answer(&answer)?;
    validated(&device)
}

/// Refuses impossible bakes before any work is done.
fn check_bake(a: &Args, file: &Path, run: bool) -> anyhow::Result<()> {
    if file.extension().is_none_or(|e| !e.eq_ignore_ascii_case("ply")) {
        refuse_usage!("\"{}\" does not end in .ply, the format that is written.", file.display());
    }
    let folder = file.parent().filter(|p| !p.as_os_str().is_empty());
    if let Some(folder) = folder.filter(|p| !p.is_dir()) {
        refuse_usage!("\"{}\" is no directory to write into.", folder.display());
    }
    if !run && !a.viewpoints.choose_cameras() {
        refuse_usage!("\"{}\" is no run and has no training views; give --cameras to bake from.", a.source.display());
    }
    Ok(())
}

/// Views and file of a bake.
struct BakeTarget<'a> {
    /// Cameras of the fit.
    from: &'a [Camera],
    /// Other cameras at which the result is measured.
    others: &'a [Camera],
    /// Background color, display-referred.
    background: [f32; 3],
    /// PLY file.
    file: &'a Path,
}

/// Bakes the relit scene, writes it, and returns its PSNR against the relit images.
///
/// Measures at the views of the fit, and at the views of `--cameras` if they differ.
fn baked(
    common: &Common,
    a: &Args,
    device: &Device,
    splats: &Splats,
    shading: &mut Shading,
    &BakeTarget { from, others, background, file }: &BakeTarget<'_>,
) -> anyhow::Result<serde_json::Value> {
    let degree = a.bake_degree.unwrap_or(splats.sh_degree() as u32);
    let options = BakeOptions { degree, steps: a.bake_steps, background };
    let mut bar = Bar::new(common, "baking", u64::from(a.bake_steps), 0);
    let made = bake(device, splats, shading, from, &options, |step| {
        bar.set(u64::from(step), || format!("{} images", from.len()));
    })?;
    bar.finish();
    made.splats.write_ply(file)?;
    let psnr = made.psnr;
    let mut answer = serde_json::json!({"file": file, "degree": degree, "views": from.len(), "psnr": psnr});
    let mut also = String::new();
    if !others.is_empty() && others != from {
        let psnr = baked_psnr(device, &made.splats, shading, others, background)?;
        answer["psnr_cameras"] = psnr.into();
        also = format!(", {psnr:.2} dB at those of --cameras");
    }
    if !common.quiet {
        let (file, views) = (file.display(), from.len());
        eprintln!("wrote {file}: {psnr:.2} dB from the relit images at the {views} views of the fit{also}");
    }
    Ok(answer)
}
