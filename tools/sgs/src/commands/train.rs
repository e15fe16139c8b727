//! Training from a scene directory into a run directory: `sgs train`.

use super::progress::Progress;
use crate::common::Common;
use crate::failure::{refuse_usage, usage};
use crate::output::{self, Begin, Permission};
use crate::scenes::{check_start, open_scene, warn_without_priors};
use crate::ui::Stop;
use crate::watch::{Port, Watch};
use anyhow::bail;
use clap::builder::{PossibleValue, StringValueParser, TypedValueParser};
use clap::{Arg, Command};
use sgs_config::{Backward, PRESETS, Preset, Settings, accuracy_named, overlay};
use sgs_engine::Device;
use sgs_run::{KnownEmitters, RunContents, RunDirectory, StageKind};
use sgs_scene::{Scene, SplitRule};
use sgs_train::{Outcome, StartGeometry, Trainer, TrainerOptions};
use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::sync::Arc;

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
    /// Preset: "draft" (quick, on a CPU), "default", "paper" (the paper's sizes and weights), "parity" (those of the
    /// published code). --config, --set and other options override it.
    #[arg(long, value_name = "NAME", value_parser = Names(|| PRESETS.iter().map(|p| p.name).collect()))]
    pub preset: Option<String>,
    /// Accuracy level: "exact", "balanced" or "fast" (docs/how/accuracy.md). Sets accuracy.*, intrinsic.environment.every
    /// and intrinsic.visibility.sample.
    #[arg(long, value_name = "NAME", value_parser = Names(|| vec!["exact", "balanced", "fast"]))]
    pub accuracy: Option<String>,
    /// Settings from a TOML file, as config.toml of a run.
    #[arg(long, value_name = "FILE.toml")]
    pub config: Option<PathBuf>,
    /// Set one setting of config.toml, as geometry.rates.means=0.0001; may be repeated.
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
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

impl Stage {
    /// Returns the stages that this trains.
    ///
    /// `geometry`: whether the transport stage trains its geometry first.
    pub fn kinds(self, settings: &Settings, geometry: bool) -> Vec<StageKind> {
        match self {
            Stage::Geometry => vec![StageKind::Geometry],
            Stage::Intrinsic => vec![StageKind::Intrinsic],
            Stage::Transport if geometry => vec![StageKind::Geometry, StageKind::Transport],
            Stage::Transport => vec![StageKind::Transport],
            Stage::All => {
                let all = StageKind::ALL.into_iter();
                all.filter(|kind| *kind != StageKind::Transport || settings.transport.enabled()).collect()
            }
        }
    }

    /// Returns the option of the command line that selects the stage, after a space.
    fn option(self) -> &'static str {
        match self {
            Stage::Geometry => "",
            Stage::Intrinsic => " --stage intrinsic",
            Stage::All => " --stage all",
            Stage::Transport => " --stage transport",
        }
    }

    /// Returns the stage if it starts from the run's Gaussians.
    fn on_run(self) -> Option<StageKind> {
        match self {
            Stage::Geometry | Stage::All => None,
            Stage::Intrinsic => Some(StageKind::Intrinsic),
            Stage::Transport => Some(StageKind::Transport),
        }
    }
}

/// Returns the settings of the command line.
///
/// Later sources override earlier ones: preset, accuracy level, file, `--set`, dedicated options.
pub fn settings(scene: &Path, o: &Options) -> anyhow::Result<Settings> {
    let mut table = preset_of(o)?;
    overlay(&mut table, accuracy_of(o)?);
    overlay(&mut table, file_of(o)?);
    settings_over(table, scene, o)
}

/// Returns the settings of `--preset`.
fn preset_of(o: &Options) -> anyhow::Result<toml::Table> {
    match &o.preset {
        None => Ok(toml::Table::new()),
        Some(name) => Ok(Preset::find(name)?.table()?),
    }
}

/// Returns the settings of `--accuracy`.
fn accuracy_of(o: &Options) -> anyhow::Result<toml::Table> {
    match &o.accuracy {
        None => Ok(toml::Table::new()),
        Some(name) => Ok(accuracy_named(name)?),
    }
}

/// Returns the settings of `--config`.
fn file_of(o: &Options) -> anyhow::Result<toml::Table> {
    let Some(path) = &o.config else { return Ok(toml::Table::new()) };
    let text = std::fs::read_to_string(path).map_err(|e| usage(format!("\"{}\": {e}.", path.display())))?;
    let wrong = |e: toml::de::Error| e.message().trim().trim_end_matches('.').replace('\n', " ");
    text.parse().map_err(|e| usage(format!("\"{}\": {}.", path.display(), wrong(e))))
}

/// Returns settings of a stage on the Gaussians of a run.
///
/// The base is the settings of the run, which produced the Gaussians. Preset, accuracy level and file override
/// settings of the stage, in this order.
fn settings_of_stage(stage: StageKind, run: &Settings, scene: &Path, o: &Options) -> anyhow::Result<Settings> {
    let mut table = run.to_table()?;
    let of_stage = |mut over: toml::Table| -> anyhow::Result<toml::Table> {
        // Checks the names of the other settings, too, before dropping them.
        Settings::from_table(over.clone())?;
        over.retain(|key, _| key == stage.name());
        Ok(over)
    };
    overlay(&mut table, of_stage(preset_of(o)?)?);
    if stage == StageKind::Intrinsic {
        overlay(&mut table, accuracy_of(o)?);
    }
    overlay(&mut table, of_stage(file_of(o)?)?);
    settings_over(table, scene, o)
}

/// Returns the settings of a table, overridden by `--set` and dedicated options.
fn settings_over(mut table: toml::Table, scene: &Path, o: &Options) -> anyhow::Result<Settings> {
    for pair in &o.set {
        let Some((key, value)) = pair.split_once('=') else {
            refuse_usage!("--set takes KEY=VALUE, not \"{pair}\".");
        };
        set(&mut table, key.trim(), value.trim())?;
    }
    let mut s = Settings::from_table(table)?;
    // The run may be opened from another directory.
    s.scene = std::path::absolute(scene).unwrap_or_else(|_| scene.to_owned());
    if let Some(n) = o.geometry_steps {
        s.geometry.steps = n;
    }
    if let Some(n) = o.intrinsic_steps {
        s.intrinsic.steps = n;
    }
    if let Some(rule) = &o.split {
        s.split = rule.clone();
    }
    if let SplitRule::File(path) = &mut s.split {
        *path = std::path::absolute(&path).unwrap_or_else(|_| path.clone());
    }
    if let Some(n) = o.views {
        s.views = n;
    }
    if let Some(f) = o.scale {
        s.scale = f;
    }
    if o.no_densify {
        s.geometry.densify.until = 0.0;
    }
    if let Some(seed) = o.seed {
        s.seed = seed;
    }
    if let Some(bytes) = o.memory_budget {
        s.memory.budget = bytes;
    }
    s.check()?;
    if o.views == Some(0) {
        refuse_usage!("--views is 0, but there must be at least one training view.");
    }
    Ok(s)
}

fn set(table: &mut toml::Table, key: &str, value: &str) -> anyhow::Result<()> {
    let parsed = format!("x = {value}")
        .parse::<toml::Table>()
        .ok()
        .and_then(|mut t| t.remove("x"))
        .unwrap_or_else(|| toml::Value::String(value.to_owned()));
    let mut parts: Vec<&str> = key.split('.').collect();
    let Some(last) = parts.pop().filter(|l| !l.is_empty()) else {
        refuse_usage!("--set has no key before \"={value}\".");
    };
    let mut at = table;
    for part in parts {
        let entry = at.entry(part).or_insert_with(|| toml::Value::Table(toml::Table::new()));
        let toml::Value::Table(inner) = entry else {
            refuse_usage!("\"{key}\" is not a setting: \"{part}\" is a value.");
        };
        at = inner;
    }
    at.insert(last.to_owned(), parsed);
    Ok(())
}

/// Returns the settings with which a run began. Refuses differing options.
///
/// Changed settings would produce neither the old run nor a new one.
fn resumed(a: &Args) -> anyhow::Result<Settings> {
    let began = RunDirectory::open(&a.output)?.settings()?;
    let mut requested = match (&a.options.config, &a.options.preset, a.stage.on_run()) {
        (None, None, _) => {
            let mut table = began.to_table()?;
            overlay(&mut table, accuracy_of(&a.options)?);
            settings_over(table, &a.scene, &a.options)?
        }
        (_, _, Some(stage)) => settings_of_stage(stage, &began, &a.scene, &a.options)?,
        _ => settings(&a.scene, &a.options)?,
    };
    // Automatic values were decided when the run began.
    if requested.geometry.backward == Backward::Auto {
        requested.geometry.backward = began.geometry.backward;
    }
    if requested.exposure == 0.0 {
        requested.exposure = began.exposure;
    }
    // The scene may have moved, and the memory budget may have changed.
    let mut began = Settings { scene: requested.scene.clone(), memory: requested.memory, ..began };
    // A diverged run may continue with lower rates.
    if RunDirectory::open(&a.output)?.has_diverged() {
        began.train = requested.train;
        began.geometry.rates = requested.geometry.rates;
        began.intrinsic.rates = requested.intrinsic.rates;
    }
    if let Some((name, was, is)) = difference("", &began.to_table()?, &requested.to_table()?) {
        refuse_usage!(
            "\"{}\" was begun with {name} = {was}, not {is}; resume it as it was begun, or train into another directory.",
            a.output.display()
        );
    }
    Ok(began)
}

/// Returns the first setting that differs: its name and both values.
fn difference(prefix: &str, a: &toml::Table, b: &toml::Table) -> Option<(String, String, String)> {
    a.iter().find_map(|(key, x)| match (x, b.get(key)) {
        (toml::Value::Table(x), Some(toml::Value::Table(y))) => difference(&format!("{prefix}{key}."), x, y),
        (x, Some(y)) if x != y => Some((format!("{prefix}{key}"), x.to_string(), y.to_string())),
        _ => None,
    })
}

/// Returns whether the transport stage trains its geometry first: the run has none, or it is unfinished and resumed.
fn trains_geometry(a: &Args, settings: &Settings) -> bool {
    let run = RunContents::of(&a.output).unwrap_or_default();
    let unfinished = || {
        let root = RunDirectory::open(&a.output).ok();
        let complete = root.map(|run| run.complete(settings)).unwrap_or_default();
        run.geometry && !run.materials && !run.transport && !complete.contains(&StageKind::Geometry)
    };
    a.stage == Stage::Transport && (!run.is_trained() || a.resume && unfinished())
}

pub fn run(common: &Common, a: &Args) -> anyhow::Result<()> {
    if a.start.is_some() && a.stage != Stage::Intrinsic {
        refuse_usage!("--start gives geometry to the intrinsic stage; add --stage intrinsic.");
    }
    let begin = match (a.stage, &a.start) {
        (Stage::Intrinsic, None) => Begin::Materials,
        (Stage::Intrinsic, Some(_)) => Begin::MaterialsFrom,
        (Stage::Transport, _) => Begin::Emitters,
        _ => Begin::Geometry,
    };
    let permission = Permission { force: a.force, resume: a.resume };
    output::check_run(&a.output, begin, permission)?;
    let port = a.watch.map(Port::take).transpose()?;
    let there = a.output.join("config.toml").is_file();
    let resuming = a.resume && there;
    if resuming && a.stage == Stage::Geometry {
        RunDirectory::open(&a.output)?.check_without_materials()?;
    }
    let settings = match a.stage.on_run().filter(|_| there && begin != Begin::MaterialsFrom) {
        _ if resuming => resumed(a)?,
        // The Gaussians and their settings belong to the run.
        Some(stage) => settings_of_stage(stage, &RunDirectory::open(&a.output)?.settings()?, &a.scene, &a.options)?,
        None => settings(&a.scene, &a.options)?,
    };
    if a.stage == Stage::Transport && !settings.transport.enabled() {
        refuse_usage!("transport.surfels is 0, which leaves the transport stage out; set it to 64 or more.");
    }
    let kinds = a.stage.kinds(&settings, trains_geometry(a, &settings));
    if resuming {
        let run = RunDirectory::open(&a.output)?;
        let complete = run.complete(&settings);
        if kinds.iter().all(|kind| complete.contains(kind)) {
            if !common.quiet {
                eprintln!("nothing to do: \"{}\" has all of its steps", a.output.display());
            }
            common.answer(&run.training_summary()?)?;
            return Ok(());
        }
    }
    let scene = open_scene(&settings)?;
    if kinds.contains(&StageKind::Geometry) && !resuming {
        check_start(&scene)?;
    }
    if kinds.contains(&StageKind::Transport) && !resuming {
        check_emitters(common, &scene)?;
    }
    if a.stage != Stage::Geometry && !resuming {
        warn_without_priors(&scene)?;
    }
    let _lock = output::lock(&a.output)?;
    // Another training may have ended before the lock was acquired.
    output::check_run(&a.output, begin, permission)?;
    let device = common.open_device()?;
    let stop = Stop::on_signals()?;
    let stopped = |step: u32| {
        let (scene, output, stage) = (a.scene.display(), a.output.display(), a.stage.option());
        stop.failure(format!("stopped after step {step}; go on with: sgs train {scene} -o {output}{stage} --resume"))
    };
    let mut watch = match port {
        Some(port) => {
            if !common.quiet {
                eprintln!("watch it at {}", port.address());
            }
            Some(Watch::begin(port, &scene, &a.output, &device)?)
        }
        None => None,
    };
    let options = TrainerOptions {
        stages: kinds,
        run: Some(a.output.clone()),
        resume: a.resume,
        start: a.start.clone().map(StartGeometry::File),
    };
    let mut trainer = Trainer::new(&device, Arc::new(scene), &settings, options)?;
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

/// Checks the emitters that the scene names, and says that they are used.
fn check_emitters(common: &Common, scene: &Scene) -> anyhow::Result<()> {
    if let Some(known) = KnownEmitters::of_scene(scene)?
        && !common.quiet
    {
        let count = known.emitters.len();
        eprintln!("the lights are the {count} emitters of \"{}\"", KnownEmitters::path(scene).display());
    }
    Ok(())
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
