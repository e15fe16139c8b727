//! Priors from networks that run over a scene's photographs: `sgs priors`.

use crate::common::Common;
use crate::failure::refuse_usage;
use crate::ui::{Bar, Stop};
use sgs_provider::{FillOptions, Prior, Provider, ProviderOptions, fill};
use sgs_scene::{Scene, SceneOptions, SplitRule};
use std::path::PathBuf;
use std::sync::atomic::Ordering;

#[derive(clap::Args)]
pub struct Args {
    /// Scene directory.
    scene: PathBuf,
    /// Command line of the provider (docs/guide/priors.md). For instance "tools/priors/serve stable-normal=WEIGHTS".
    #[arg(long, value_name = "CMD")]
    provider: String,
    /// Kinds of priors: normal, semantic, masks, albedo, roughness, metallic; by default all kinds of the provider.
    #[arg(long, value_name = "KINDS", value_delimiter = ',')]
    only: Vec<Prior>,
    /// Test views, as for training: "every:N", "linspace:N", a file like split.json, or "auto".
    #[arg(long, value_name = "every:N|linspace:N|FILE", default_value = "auto")]
    split: SplitRule,
    /// Views to process.
    #[arg(long, value_enum, default_value = "train")]
    views: Views,
    /// Replace existing files.
    #[arg(long)]
    force: bool,
    /// Class names, separated by commas; by default the existing ones, or those that the provider finds.
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    labels: Vec<String>,
    /// Time limit of an answer of the provider, in seconds.
    #[arg(long, value_name = "S", default_value_t = ProviderOptions::default().answer_seconds)]
    answer_seconds: f64,
    /// Time limit of the provider's start, in seconds.
    #[arg(long, value_name = "S", default_value_t = ProviderOptions::default().start_seconds)]
    start_seconds: f64,
    /// Seed that is sent to the provider.
    #[arg(long, value_name = "S", default_value_t = ProviderOptions::default().seed)]
    seed: u64,
    /// Factor on linear (EXR) photographs; by default chosen from the training views, as for training.
    #[arg(long, value_name = "F")]
    exposure: Option<f32>,
}

#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Views {
    Train,
    All,
}

pub fn run(common: &Common, a: &Args) -> anyhow::Result<()> {
    for (name, seconds) in [("--answer-seconds", a.answer_seconds), ("--start-seconds", a.start_seconds)] {
        if !(seconds > 0.0 && seconds.is_finite()) {
            refuse_usage!("{name} is {seconds}, but must be a number of seconds above 0.");
        }
    }
    let options = SceneOptions { split: a.split.clone(), exposure: a.exposure, ..SceneOptions::default() };
    let scene = Scene::open(&a.scene, &options)?;
    let options = FillOptions {
        only: a.only.clone(),
        views: match a.views {
            Views::Train => scene.split.train.clone(),
            Views::All => (0..scene.views.len()).collect(),
        },
        force: a.force,
        labels: a.labels.iter().map(|l| l.trim().to_owned()).filter(|l| !l.is_empty()).collect(),
    };
    let stop = Stop::on_signals()?;
    let mut provider = Provider::start(&ProviderOptions {
        command: a.provider.clone(),
        start_seconds: a.start_seconds,
        answer_seconds: a.answer_seconds,
        seed: a.seed,
        ..ProviderOptions::default()
    })?;
    let mut bar = Bar::new(common, "views", options.views.len() as u64, 0);
    let progress = |done: usize, _: usize| bar.set(done as u64, String::new);
    let filled = fill(&scene, &mut provider, &options, progress, || !stop.load(Ordering::SeqCst))?;
    bar.finish();
    for warning in &filled.warnings {
        tracing::warn!("{warning}");
    }
    if !filled.complete {
        let written = filled.written.len();
        return Err(stop.failure(format!("stopped after {written} files; the same command goes on from there")));
    }
    let summary = serde_json::json!({
        "provider": provider.about().name,
        "written": filled.written,
        "kept": filled.existing,
        "complete": filled.complete,
    });
    if !common.answer(&summary)? && !common.quiet {
        eprintln!("wrote {} files, kept {}", filled.written.len(), filled.existing);
    }
    Ok(())
}
