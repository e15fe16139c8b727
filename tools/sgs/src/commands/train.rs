//! Training from a scene directory into a run directory: `sgs train`.

use super::progress::Progress;
use crate::common::Common;
use crate::failure::{refuse_usage, usage};
use crate::message::say;
use crate::ui::Stop;
use crate::watch::{Port, Watch};
use anyhow::bail;
use clap::builder::{PossibleValue, StringValueParser, TypedValueParser};
use clap::{Arg, Command};
use sgs_api::{Overrides, Stages, TrainRequest, prepare_training};
use sgs_config::{ACCURACY_LEVELS, PRESETS, Settings};
use sgs_engine::Device;
use sgs_run::RunDirectory;
use sgs_scene::SplitRule;
use sgs_train::Outcome;
use std::ffi::OsStr;
use std::path::{Path, PathBuf};

/// Names for shell completion. Unknown names are refused later, with a suggestion.
#[derive(Clone)]
struct Names(fn() -> Vec<&'static str>);

impl TypedValueParser for Names {
    type Value = String;

    fn parse_ref(&self, command: &Command, arg: Option<&Arg>, value: &OsStr) -> Result<String, clap::Error> {
        StringValueParser::new().parse_ref(command, arg, value)
    }

    fn possible_values(&self) -> Option<Box<dyn Iterator<Item = PossibleValue> + '_>> {
        Some(Box::new((self.0)().into_iter().map(PossibleValue::new)))
    }
}

/// Options of training, shared with `sgs plan`.
#[derive(clap::Args)]
pub struct Options {
    /// Steps of the geometry stage.
    #[arg(long, value_name = "N")]
    pub geometry_steps: Option<u32>,
    /// Steps of the intrinsic stage.
    #[arg(long, value_name = "N")]
    pub intrinsic_steps: Option<u32>,
    /// Views held out for tests: "every:N" (views 0, N, 2N and so on), "linspace:N" (N views, spread evenly between the
    /// first and the last), a file like split.json, or "auto" (split.json of the scene, else its layout's own split,
    /// else every:8).
    #[arg(long, value_name = "every:N|linspace:N|FILE")]
    pub split: Option<SplitRule>,
    /// Number of training views; all by default. Spread evenly over the views that are not held out.
    #[arg(long, value_name = "N")]
    pub views: Option<usize>,
    /// Factor on the size of the images, at most 1.
    #[arg(long, value_name = "F")]
    pub scale: Option<f64>,
    /// Disable densification; the number of Gaussians stays constant.
    #[arg(long)]
    pub no_densify: bool,
    /// Seed of all random numbers.
    #[arg(long, value_name = "S")]
    pub seed: Option<u64>,
    /// Maximum device memory of training, as bytes or as 512M, 4G. Sets memory.budget of config.toml. Limits growth and
    /// thins points. Refuses only a start that does not fit.
    #[arg(long, visible_alias = "vram", value_name = "BYTES|4G", value_parser = sgs_config::parse_bytes)]
    pub memory_budget: Option<u64>,
    /// Preset: "draft" (quick, on a CPU), "fast" (images of the default in less time), "default", "paper" (the paper's
    /// sizes and weights), "parity" (those of the published code). --config, --set and other options override it.
    #[arg(long, value_name = "NAME", value_parser = Names(|| PRESETS.iter().map(|p| p.name).collect()))]
    pub preset: Option<String>,
    /// Accuracy level: "exact", "compact", "balanced" or "fast" (docs/how/accuracy.md). Sets accuracy.*,
    /// intrinsic.environment.every and intrinsic.visibility.sample.
    #[arg(long, value_name = "NAME", value_parser = Names(|| ACCURACY_LEVELS.to_vec()))]
    pub accuracy: Option<String>,
    /// Settings from a TOML file, as config.toml of a run.
    #[arg(long, value_name = "FILE.toml")]
    pub config: Option<PathBuf>,
    /// Set one setting of config.toml, as geometry.rates.factor=2; may be repeated.
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
}

impl Options {
    /// Returns the options as overrides of settings. Reads the file of `--config`.
    pub fn overrides(&self) -> anyhow::Result<Overrides> {
        let mut set = Vec::new();
        for pair in &self.set {
            let Some((key, value)) = pair.split_once('=') else {
                refuse_usage!("--set takes KEY=VALUE, not \"{pair}\".");
            };
            set.push((key.trim().to_owned(), value_of(value.trim())));
        }
        Ok(Overrides {
            preset: self.preset.clone(),
            accuracy: self.accuracy.clone(),
            config: self.config.as_deref().map(read_settings).transpose()?,
            set,
            geometry_steps: self.geometry_steps,
            intrinsic_steps: self.intrinsic_steps,
            split: self.split.clone(),
            views: self.views,
            scale: self.scale,
            no_densify: self.no_densify,
            seed: self.seed,
            memory_budget: self.memory_budget,
        })
    }
}

/// Parses a value of `--set`; a word without quotes is a string.
fn value_of(value: &str) -> toml::Value {
    let parsed = format!("x = {value}").parse::<toml::Table>().ok().and_then(|mut t| t.remove("x"));
    parsed.unwrap_or_else(|| toml::Value::String(value.to_owned()))
}

/// Reads a file of settings.
fn read_settings(path: &Path) -> anyhow::Result<toml::Table> {
    let text = std::fs::read_to_string(path).map_err(|e| usage(format!("\"{}\": {e}.", path.display())))?;
    let wrong = |e: toml::de::Error| e.message().trim().trim_end_matches('.').replace('\n', " ");
    text.parse().map_err(|e| usage(format!("\"{}\": {}.", path.display(), wrong(e))))
}

/// Returns the settings of the command line.
pub fn settings(scene: &Path, o: &Options) -> anyhow::Result<Settings> {
    sgs_api::settings(scene, &o.overrides()?)
}

#[derive(clap::Args)]
pub struct Args {
    /// Scene directory.
    scene: PathBuf,
    /// Run directory to create.
    #[arg(short, long, value_name = "RUN")]
    output: PathBuf,
    /// Stage: geometry, intrinsic (materials, lights and shadows of the published model on the run's geometry), transport
    /// (materials, emitters and bounced light; trains geometry first if the run has none), or all of them.
    #[arg(long, value_enum, default_value = "geometry")]
    stage: Stage,
    /// Geometry of the intrinsic stage: a 3DGS PLY or a glTF file.
    #[arg(long, value_name = "FILE")]
    start: Option<PathBuf>,
    #[command(flatten)]
    options: Options,
    /// Continue an interrupted run. A finished run stays unchanged.
    #[arg(long)]
    resume: bool,
    /// Replace the run in the directory.
    #[arg(long, conflicts_with = "resume")]
    force: bool,
    /// Serve a live page of the training to this machine: curves and images of held-back views. Takes at most 5 % of
    /// the time. 0 chooses a free port.
    #[arg(long, value_name = "PORT", num_args = 0..=1, default_missing_value = "8117", require_equals = true)]
    watch: Option<u16>,
}

/// Stages that are trained, planned or compared.
#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Stage {
    Geometry,
    Intrinsic,
    Transport,
    All,
}

impl From<Stage> for Stages {
    fn from(stage: Stage) -> Stages {
        match stage {
            Stage::Geometry => Stages::Geometry,
            Stage::Intrinsic => Stages::Intrinsic,
            Stage::Transport => Stages::Transport,
            Stage::All => Stages::All,
        }
    }
}

impl Stage {
    /// Returns the value of `--stage`.
    pub fn name(self) -> &'static str {
        match self {
            Stage::Geometry => "geometry",
            Stage::Intrinsic => "intrinsic",
            Stage::All => "all",
            Stage::Transport => "transport",
        }
    }

    /// Returns the option of the command line that selects the stage, after a space.
    fn option(self) -> String {
        match self {
            Stage::Geometry => String::new(),
            _ => format!(" --stage {}", self.name()),
        }
    }
}

pub fn run(common: &Common, a: &Args) -> anyhow::Result<()> {
    let port = a.watch.map(Port::take).transpose()?;
    let request = TrainRequest {
        scene: a.scene.clone(),
        output: a.output.clone(),
        stages: a.stage.into(),
        start: a.start.clone(),
        overrides: a.options.overrides()?,
        resume: a.resume,
        force: a.force,
    };
    let say = |text: &str| {
        if !common.quiet {
            say(text);
        }
    };
    let training = match prepare_training(&request, say)? {
        Some(training) => training,
        None => {
            say(&format!("nothing to do: \"{}\" has all of its steps", a.output.display()));
            common.answer(&RunDirectory::open(&a.output)?.training_summary()?)?;
            return Ok(());
        }
    };
    let device = common.open_device()?;
    let stop = Stop::on_signals()?;
    let stopped = |step: u32| {
        let (scene, output, stage) = (a.scene.display(), a.output.display(), a.stage.option());
        stop.failure(format!("stopped after step {step}; go on with: sgs train {scene} -o {output}{stage} --resume"))
    };
    let mut watch = match port {
        Some(port) => {
            say(&format!("watch it at {}", port.address()));
            Some(Watch::begin(port, training.scene(), &a.output, &device)?)
        }
        None => None,
    };
    let mut trainer = training.trainer(&device)?;
    let outcome = trainer.run(&mut Progress::of_run(common, &stop, a.output.clone(), watch.as_mut()))?;
    if let Outcome::Stopped { step, .. } = outcome {
        end_watch(&mut watch, &format!("stopped after step {step}"));
        return Err(stopped(step));
    }
    end_watch(&mut watch, "finished");
    common.answer(&RunDirectory::open(&a.output)?.training_summary()?)?;
    drop(trainer);
    validated(&device)
}

/// Reports on the page of a training how it ended.
fn end_watch(watch: &mut Option<Watch>, how: &str) {
    if let Some(watch) = watch {
        watch.end(how);
    }
}

/// Fails if Vulkan validation reported any message.
pub fn validated(device: &Device) -> anyhow::Result<()> {
    let messages = device.messages().take();
    if let Some(first) = messages.first() {
        bail!("Validation reported {} messages; the first: {first}", messages.len());
    }
    Ok(())
}
