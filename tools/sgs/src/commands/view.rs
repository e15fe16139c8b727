//! Window that shows a run, a PLY or a glTF file: `sgs view`.

use crate::common::Common;
use crate::failure::refuse_usage;
use anyhow::bail;
use sgs_view::{Channel, KEYS, Options};
use std::path::PathBuf;

#[derive(clap::Args)]
#[command(after_help = KEYS)]
pub struct Args {
    /// Run directory, or a PLY or glTF file.
    source: PathBuf,
    /// Transforms file with cameras to start from and step through. By default the cameras of the run's scene.
    #[arg(long, value_name = "FILE.json")]
    cameras: Option<PathBuf>,
    /// Initial channel, by its name in `sgs render --channels`.
    #[arg(long, value_name = "NAME", value_parser = channel)]
    channel: Option<Channel>,
    /// Size of the window's content; by default the shape of the first camera.
    #[arg(long, value_name = "WxH", value_parser = size)]
    size: Option<[u32; 2]>,
    /// Directory for images (P) and edits (E).
    #[arg(short, long, value_name = "DIR", default_value = ".")]
    output: PathBuf,
    /// Number of frames after which the window closes.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    frames: Option<u64>,
    /// File for the last of these frames.
    #[arg(long, value_name = "FILE.png", requires = "frames")]
    save: Option<PathBuf>,
}

fn channel(name: &str) -> Result<Channel, String> {
    let known = || Channel::ALL.map(Channel::name).join(", ");
    Channel::named(name).ok_or_else(|| format!("there are {}", known()))
}

fn size(text: &str) -> Result<[u32; 2], String> {
    let side = |text: &str| text.parse().ok().filter(|s| (16..=16384).contains(s));
    let sides = text.split_once('x').and_then(|(w, h)| Some([side(w)?, side(h)?]));
    sides.ok_or_else(|| "two numbers of pixels from 16 to 16384, as 1280x720".into())
}

pub fn run(common: &Common, a: &Args) -> anyhow::Result<()> {
    if !a.output.is_dir() {
        refuse_usage!("\"{}\" is no directory.", a.output.display());
    }
    let outcome = sgs_view::run(Options {
        source: a.source.clone(),
        cameras: a.cameras.clone(),
        channel: a.channel,
        size: a.size,
        output: a.output.clone(),
        frames: a.frames,
        save: a.save.clone(),
        device: common.device_options(),
    })?;
    common.answer(&serde_json::json!({
        "frames": outcome.frames,
        "size": outcome.size,
        "device": outcome.device,
        "made_later": outcome.made_later,
        "files": outcome.saved,
    }))?;
    if let Some(first) = outcome.messages.first() {
        bail!("Validation reported {} messages; the first: {first}", outcome.messages.len());
    }
    Ok(())
}
