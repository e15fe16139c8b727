//! `sgs render`: pictures of a run or a PLY from any cameras.

use super::train::validated;
use crate::cameras::{splats_of, upload};
use crate::common::Common;
use crate::ui::Bar;
use anyhow::bail;
use sgs_passes::Tuning;
use sgs_passes::pipeline::{Picture, Renderer};
use sgs_passes::splat::Channels;
use sgs_scene::{Camera, Image, write_exr, write_png};
use std::path::{Path, PathBuf};

#[derive(clap::Args)]
pub struct Args {
    /// Run directory or PLY file.
    source: PathBuf,
    /// Cameras: a transforms file.
    #[arg(long, value_name = "FILE.json")]
    cameras: PathBuf,
    /// Directory for the pictures.
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// What to write.
    #[arg(long, value_delimiter = ',', default_value = "rgb")]
    channels: Vec<Channel>,
    /// File format: exr keeps the blended values (float32), png shows them.
    #[arg(long, value_enum, default_value = "png")]
    format: Format,
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
    Rgb,
    Alpha,
    Depth,
    Normal,
}

#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Format {
    Exr,
    Png,
}

pub fn run(common: &Common, a: &Args) -> anyhow::Result<()> {
    let [r, g, b] = a.background[..] else { bail!("--background takes three numbers, r,g,b.") };
    if ![r, g, b].iter().all(|v| v.is_finite()) {
        bail!("--background is {r},{g},{b}, but must be finite numbers.");
    }
    let (splats, _) = splats_of(&a.source)?;
    let cameras = Camera::read_transforms(&a.cameras)?;
    if cameras.is_empty() {
        bail!("\"{}\" holds no cameras.", a.cameras.display());
    }
    if a.channels.contains(&Channel::Normal) && splats.normals.is_none() {
        bail!("\"{}\" holds no normals; leave \"normal\" out of --channels.", a.source.display());
    }
    let device = common.open_device()?;
    let gaussians = upload(&device, &splats)?;
    let channels =
        Channels { normals: a.channels.contains(&Channel::Normal), depth: a.channels.contains(&Channel::Depth) };
    let mut renderer = Renderer::new(&device, Tuning::for_device(device.info()), &gaussians, [1, 1], channels)?;
    std::fs::create_dir_all(&a.output)
        .map_err(|e| anyhow::anyhow!("\"{}\" cannot be made: {e}.", a.output.display()))?;
    let mut bar = Bar::new(common, "rendering", cameras.len() as u64, 0);
    let mut written = Vec::new();
    for (i, camera) in cameras.iter().enumerate() {
        let c = sgs_train::camera(camera);
        let picture = renderer.render(&gaussians, &c, gaussians.model.sh_degree, [r, g, b])?;
        for channel in &a.channels {
            written.push(write(&a.output, &camera.name, *channel, a.format, &picture, channels)?);
        }
        bar.set(i as u64 + 1, || camera.name.clone());
    }
    bar.finish();
    common.answer(&serde_json::json!({"gaussians": splats.len(), "files": written}))?;
    validated(&device)
}

/// Writes one channel of a picture; gives the file's path.
fn write(
    dir: &Path,
    stem: &str,
    channel: Channel,
    format: Format,
    p: &Picture,
    channels: Channels,
) -> anyhow::Result<PathBuf> {
    let c = p.channels as usize;
    let pixels = p.transmittance.len();
    let pick = |from: usize, count: usize| -> Vec<f32> {
        (0..pixels).flat_map(|i| (from..from + count).map(move |k| p.image[i * c + k])).collect()
    };
    let (name, names, data): (&str, &[&str], Vec<f32>) = match channel {
        Channel::Rgb => ("rgb", &["R", "G", "B"], pick(0, 3)),
        Channel::Alpha => ("alpha", &["Y"], p.transmittance.iter().map(|t| 1.0 - t).collect()),
        Channel::Normal => ("normal", &["X", "Y", "Z"], pick(3, 3)),
        Channel::Depth => ("depth", &["Z"], pick(if channels.normals { 6 } else { 3 }, 1)),
    };
    let mut image = Image { width: p.size[0], height: p.size[1], channels: names.len() as u32, data };
    let extension = if format == Format::Exr { "exr" } else { "png" };
    let path = dir.join(format!("{stem}_{name}.{extension}"));
    match format {
        Format::Exr => write_exr(&path, &image, names)?,
        Format::Png => {
            match channel {
                Channel::Normal => image.data.iter_mut().for_each(|v| *v = *v * 0.5 + 0.5),
                Channel::Depth => {
                    let far = image.data.iter().fold(1e-6_f32, |m, v| m.max(*v));
                    image.data.iter_mut().for_each(|v| *v /= far);
                }
                _ => {}
            }
            image.data.iter_mut().for_each(|v| *v = v.clamp(0.0, 1.0));
            write_png(&path, &image)?;
        }
    }
    Ok(path)
}
