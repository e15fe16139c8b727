//! Scenes from photographs or a video: `sgs capture`.

use crate::common::Common;
use crate::message::say;
use crate::output::check_scene;
use crate::ui::Stop;
use sgs_capture::{CaptureError, CaptureOptions, Matcher, capture};
use std::path::PathBuf;

#[derive(clap::Args)]
pub struct Args {
    /// Folder of photographs (JPEG, PNG, TIFF, WebP, HEIC), or a video.
    source: PathBuf,
    /// Scene directory to create.
    #[arg(short, long, value_name = "SCENE")]
    output: PathBuf,
    /// Most frames to take from a video: the sharpest of each of N equal intervals.
    #[arg(long, value_name = "N", default_value_t = CaptureOptions::default().frames as u32, value_parser = clap::value_parser!(u32).range(2..=2000))]
    frames: u32,
    /// Pairs of images to match: all (exhaustive), or neighbors in the order of names (sequential). By default all,
    /// but neighbors for more than 100 frames of a video.
    #[arg(long, value_enum)]
    matcher: Option<Pairs>,
}

#[derive(Clone, Copy, clap::ValueEnum)]
enum Pairs {
    Exhaustive,
    Sequential,
}

pub fn run(common: &Common, a: &Args) -> anyhow::Result<()> {
    check_scene(&a.output)?;
    let stop = Stop::on_signals()?;
    let options = CaptureOptions {
        frames: a.frames as usize,
        matcher: a.matcher.map(|pairs| match pairs {
            Pairs::Exhaustive => Matcher::Exhaustive,
            Pairs::Sequential => Matcher::Sequential,
        }),
    };
    let begun = std::time::Instant::now();
    let progress = |step: &str| {
        if !common.quiet {
            say(format_args!("{step} ({:.0} s)", begun.elapsed().as_secs_f64()));
        }
    };
    let captured = match capture(&a.source, &a.output, &options, &stop, &progress) {
        Err(error @ CaptureError::Stopped) => return Err(stop.failure(error.to_string())),
        result => result?,
    };
    if common.answer(&captured)? || common.quiet {
        return Ok(());
    }
    for missing in &captured.unregistered {
        say(format_args!("not registered: {}: {}", missing.file, missing.reason));
    }
    let (registered, all, points) = (captured.registered, captured.photographs, captured.points);
    let output = a.output.display();
    say(format_args!("registered {registered} of {all} images, {points} points; wrote {output}"));
    Ok(())
}
