//! Priors from networks that run over a scene's photographs: `sgs priors`.

use crate::common::Common;
use crate::failure::refuse_usage;
use crate::ui::{Bar, Stop};
use sgs_provider::{FillOptions, Prior, Provider, ProviderOptions, fill, fill_normals_from_depth};
use sgs_scene::{Scene, SceneOptions, SplitRule};
use std::path::PathBuf;
use std::sync::atomic::Ordering;

#[derive(clap::Args)]
pub struct Args {
    /// Scene directory.
    scene: PathBuf,
    /// Command line of the provider (docs/guide/priors.md). For instance "tools/priors/serve stable-normal=WEIGHTS".
    #[arg(long, value_name = "CMD", required_unless_present = "normals_from_depth")]
    provider: Option<String>,
    /// Compute normal priors from depth: the sensor's, or that of priors/depth. Differences reach STEP pixels to each side;
    /// more for noisy depth.
    #[arg(long, value_name = "STEP", num_args = 0..=1, default_missing_value = "1", conflicts_with_all = ["provider", "only", "labels"])]
    normals_from_depth: Option<u32>,
    /// Kinds of priors: normal, depth, semantic, masks, albedo, roughness, metallic; by default all kinds of the provider.
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
    let mut bar = Bar::new(common, "views", options.views.len() as u64, 0);
    let progress = |done: usize, _: usize| bar.set(done as u64, String::new);
    let go_on = || !stop.load(Ordering::SeqCst);
    let (name, filled) = match (&a.provider, a.normals_from_depth) {
        (_, Some(step)) => {
            if !(1..=64).contains(&step) {
                refuse_usage!("--normals-from-depth is {step}; use a number of pixels from 1 to 64.");
            }
            let filled = fill_normals_from_depth(&scene, step as usize, &options, progress, go_on)?;
            ("normals from depth".to_owned(), filled)
        }
        (command, None) => {
            let command = command.clone().unwrap_or_default();
            let mut provider = Provider::start(&ProviderOptions {
                command,
                start_seconds: a.start_seconds,
                answer_seconds: a.answer_seconds,
                seed: a.seed,
                ..ProviderOptions::default()
            })?;
            let filled = fill(&scene, &mut provider, &options, progress, go_on)?;
            (provider.about().name.clone(), filled)
        }
    };
    bar.finish();
    for warning in &filled.warnings {
        tracing::warn!("{warning}");
    }
    if !filled.complete {
        let written = filled.written.len();
        return Err(stop.failure(format!("stopped after {written} files; the same command goes on from there")));
    }
    let summary = serde_json::json!({
        "provider": name,
        "written": filled.written,
        "kept": filled.existing,
        "complete": filled.complete,
    });
    if !common.answer(&summary)? && !common.quiet {
        eprintln!("wrote {} files, kept {}", filled.written.len(), filled.existing);
    }
    Ok(())
}
