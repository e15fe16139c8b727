//! Synthetic indoor scenes for trials: `sgs synth`.

use crate::common::Common;
use crate::ui::Bar;
use std::path::PathBuf;
use std::sync::Mutex;

#[derive(clap::Args)]
pub struct Args {
    /// Scene directory to create.
    out: PathBuf,
    /// Name of the scene.
    #[arg(long, value_name = "NAME", default_value = "livingroom")]
    scene: String,
    /// Layout of the directory: nerfstudio, tensoir or fipt.
    #[arg(long, value_name = "NAME", default_value = "nerfstudio")]
    layout: String,
    /// Number of training views; test views are additional.
    #[arg(long, value_name = "N")]
    views: Option<usize>,
    /// Width and height of the images in pixels.
    #[arg(long, value_name = "WxH", value_parser = size)]
    size: Option<(usize, usize)>,
    /// Pixels along a cell of the semantic priors; 1 for maps at image resolution.
    #[arg(long, value_name = "PIXELS", default_value_t = 8)]
    semantic_cell: usize,
    /// Fraction of the regions of the semantic priors whose class is wrong, 0 to 1.
    #[arg(long, value_name = "SHARE", default_value_t = 0.0)]
    semantic_wrong: f32,
    /// Replace an existing scene.
    #[arg(long)]
    force: bool,
    /// Seed of furniture and noise.
    #[arg(long, default_value_t = 0)]
    seed: u64,
}

fn size(text: &str) -> Result<(usize, usize), String> {
    let wrong = || format!("\"{text}\" is not a size; write columns x rows, as 160x120");
    let (w, h) = text.split_once(['x', 'X']).ok_or_else(wrong)?;
    Ok((w.parse().map_err(|_| wrong())?, h.parse().map_err(|_| wrong())?))
}

pub fn run(common: &Common, a: &Args) -> anyhow::Result<()> {
    let mut options = sgs_synth::SynthOptions {
        scene: a.scene.parse()?,
        layout: a.layout.parse()?,
        seed: a.seed,
        replace: a.force,
        ..Default::default()
    };
    (options.semantic_cell, options.semantic_wrong) = (a.semantic_cell, a.semantic_wrong);
    if let Some(views) = a.views {
        options.views = views;
    }
    if let Some((width, height)) = a.size {
        (options.width, options.height) = (width, height);
    }
    let bar: Mutex<Option<Bar>> = Mutex::new(None);
    let progress = |done: u64, total: u64| {
        let mut bar = bar.lock().unwrap_or_else(|e| e.into_inner());
        bar.get_or_insert_with(|| Bar::new(common, "rendering", total, 0)).set(done, String::new);
    };
    sgs_synth::generate(&a.out, &options, &progress)?;
    if let Some(bar) = bar.into_inner().unwrap_or_else(|e| e.into_inner()) {
        bar.finish();
    }
    if !common.answer(&serde_json::json!({"scene": a.out}))? && !common.quiet {
        eprintln!("wrote {}", a.out.display());
    }
    Ok(())
}
