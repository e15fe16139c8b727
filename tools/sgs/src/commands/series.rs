//! Tables of trainings, shared by `sgs ablate` and `sgs robustness`: rows over seeds, trained as a batch.
//!
//! Guarantees: finished runs are recognized and not repeated. The table on disk is updated after every run. Several
//! commands may share a directory.

mod one;
mod run;

use super::batch::{failure_of, storage_failure};
use super::programs::{Jobs, Programs, devices};
use super::train::{Options, settings};
use crate::common::Common;
use crate::failure::{failure, refuse_usage};
use crate::message::say;
use crate::output;
use crate::scenes::{check_start, open_scene};
use crate::ui::Stop;
use anyhow::bail;
use run::TableRun;
use sgs_batch::{
    Batch, Digest, Launch, Limits, Manifest, Phase, Progress, Queue, Report, RunResult, Stage, Store, Timing, Variant,
};
use sgs_config::{Settings, ViewRates};
use sgs_evaluate::metrics::{Lpips, LpipsAbout};
use sgs_run::StageKind;
use sgs_scene::Scene;
use sgs_study::{Ablation, Entry, State};
use std::collections::HashSet;
use std::ffi::OsString;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

#[derive(clap::Args)]
pub struct Series {
    /// Scene directory, with test views.
    pub scene: PathBuf,
    /// Directory for the runs, and for the table as Markdown and JSON. Several commands can share it.
    #[arg(short, long, value_name = "DIR")]
    pub output: PathBuf,
    /// Number of seeds, starting at --seed.
    #[arg(long, value_name = "N", default_value = "3", value_parser = clap::value_parser!(u64).range(1..))]
    pub seeds: u64,
    /// Weights of LPIPS; enables this metric.
    #[arg(long, value_name = "FILE.safetensors")]
    pub lpips: Option<PathBuf>,
    /// Replace existing runs whose settings differ.
    #[arg(long)]
    pub force: bool,
    /// Number of runs that are trained side by side, or "auto": one per device. More make the times of the table longer.
    #[arg(long, value_name = "N|auto", default_value = "auto", value_parser = Jobs::parse)]
    pub jobs: Jobs,
    /// Devices that the jobs take in turn, as --device names them.
    #[arg(long, value_name = "A,B", value_delimiter = ',', conflicts_with = "device")]
    pub devices: Vec<String>,
    /// Train a single run of the table in this process. The command itself starts such processes.
    #[arg(long, hide = true, value_name = "ROW")]
    pub one: Option<String>,
    #[command(flatten)]
    pub options: Options,
}

/// Row of `--one` that stands for the shared geometry.
const START: &str = "start";

/// Folder of the batch that trains the table, below the directory of the table.
const FOLDER: &str = "batch";

/// Settings and scene shared by all trainings.
pub struct Base {
    pub settings: Settings,
    pub scene: Scene,
}

/// Row of the table.
pub struct Row {
    pub entry: Entry,
    /// Settings except for the seed.
    pub settings: Settings,
    /// Whether to train the row. Otherwise the table shows it only if it was measured before.
    pub wanted: bool,
    /// Stage that trains materials, if any.
    pub materials: Option<StageKind>,
    /// Whether views are measured after alignment, too, even with given cameras.
    pub align: bool,
    /// Geometry on which materials are trained; `None` for the row's own geometry.
    pub start: Option<Start>,
}

/// Geometry shared by several rows.
#[derive(Clone)]
pub enum Start {
    /// Geometry from a file.
    File(PathBuf),
    /// Geometry of a training per seed. Its folder may belong to a row.
    Training { entry: Entry, settings: Box<Settings> },
}

/// Opens settings and scene. Refuses a scene without test views.
pub fn base(a: &Series) -> anyhow::Result<Base> {
    let mut settings = settings(&a.scene, &a.options)?;
    // Noise would change what a measurement decides; rows differ by what they name alone.
    if settings.geometry.rates.views == ViewRates::Auto {
        settings.geometry.rates.views = [0.0; 4].into();
    }
    let scene = open_scene(&settings)?;
    check_start(&scene)?;
    if scene.split.test.is_empty() {
        bail!("\"{}\" has no test views to compare at; name some in split.json.", a.scene.display());
    }
    Ok(Base { settings, scene })
}

/// Returns the entries that differ from all others on this scene.
///
/// Logs a warning for each entry left out. Refuses such an entry if the user named entries. `what`: name of an entry
/// in messages. `lacks`: name of an entry and the reason why it equals another.
pub fn possible<T: Copy>(
    what: &str,
    all: Vec<T>,
    named: bool,
    lacks: impl Fn(&T) -> sgs_study::Result<Option<(&'static str, String)>>,
) -> anyhow::Result<Vec<T>> {
    let mut remaining = Vec::new();
    for one in all {
        match lacks(&one)? {
            None => remaining.push(one),
            Some((name, lacking)) if !named => tracing::warn!("The {what} \"{name}\" is left out: {lacking}."),
            Some((name, lacking)) => refuse_usage!("The {what} \"{name}\" would differ from no other: {lacking}."),
        }
    }
    Ok(remaining)
}

/// Description of a series and its table.
pub struct About<'a> {
    /// Base name of the table files.
    pub name: &'a str,
    /// Name of the command.
    pub command: &'a str,
    /// Value of `--stage`.
    pub stage: &'a str,
    /// Geometry file shared by all rows.
    pub start: Option<&'a Path>,
}

/// Trains and measures the rows that are wanted and not done. Writes `NAME.json` and `NAME.md`.
pub fn run(common: &Common, a: &Series, about: &About<'_>, base: &Settings, rows: &[Row]) -> anyhow::Result<()> {
    let Some(last) = base.seed.checked_add(a.seeds - 1) else {
        refuse_usage!("--seeds {} goes beyond the largest seed from --seed {} on.", a.seeds, base.seed);
    };
    let lpips = a.lpips.as_deref().map(|file| Lpips::load(file, Default::default())).transpose()?;
    if let Some(name) = &a.one {
        return one::run(common, a, name, base.seed, rows, lpips.as_ref());
    }
    output::check_series(&a.output, &["ablation", "robustness"], FOLDER)?;
    let stop = Stop::on_signals()?;
    let lpips = lpips.map(|lpips| lpips.about());
    // Seeds are the outer loop, so that an unfinished table already compares all rows. Rows measured before are
    // included.
    let mut runs = Vec::new();
    for seed in base.seed..=last {
        for row in rows {
            // A folder shared with another row does not show whether this row was trained.
            let shared = row.entry.run != row.entry.name;
            if row.wanted || !shared && a.output.join(row.entry.folder(seed)).is_dir() {
                runs.push(TableRun::new(row, seed, &a.output)?.0);
            }
        }
    }
    let series = Trainings { common, a, about, base, lpips, stop: &stop, runs };
    series.check()?;
    series.train()?;
    let table = series.write(true)?;
    if !common.answer(&table)? {
        print!("{}", table.markdown());
    }
    Ok(())
}

/// Trainings of a table.
struct Trainings<'a> {
    common: &'a Common,
    a: &'a Series,
    about: &'a About<'a>,
    base: &'a Settings,
    lpips: Option<LpipsAbout>,
    stop: &'a Stop,
    runs: Vec<TableRun<'a>>,
}

/// Run to train: its name in the batch, its directory, settings and seed.
struct Wanted {
    name: &'static str,
    directory: PathBuf,
    settings: Settings,
    seed: u64,
}

impl Trainings<'_> {
    fn open(&self) -> impl Iterator<Item = &TableRun<'_>> {
        self.runs.iter().filter(|run| run.row.wanted && !matches!(run.state(self.lpips), State::Measured(_)))
    }

    /// Refuses to replace runs with other settings, before anything is trained.
    fn check(&self) -> anyhow::Result<()> {
        for run in self.open() {
            run.check(&run.state(self.lpips), self.a.force)?;
            if let Some((root, requested)) = run.geometry(&self.a.output)? {
                run::check_geometry(&root, &requested, self.a.force)?;
            }
        }
        Ok(())
    }

    /// Trains what is missing: first shared geometry, then the rows.
    fn train(&self) -> anyhow::Result<()> {
        let mut geometry = Vec::new();
        for run in self.open() {
            if let Some((directory, settings)) = run.geometry(&self.a.output)?
                && !run::is_formed(&directory, &settings)
            {
                geometry.push(Wanted { name: START, directory, settings, seed: run.seed });
            }
        }
        self.work(geometry, Stage::Geometry)?;
        let rows = self.open().map(|run| Wanted {
            name: run.row.entry.run,
            directory: run.root.clone(),
            settings: run.settings.clone(),
            seed: run.seed,
        });
        let stage = match self.runs.iter().find_map(|run| run.row.materials) {
            None => Stage::Geometry,
            Some(StageKind::Transport) => Stage::Transport,
            Some(_) => Stage::All,
        };
        self.work(rows.collect(), stage)
    }

    /// Trains runs as a batch. `stage`: what they are planned with.
    fn work(&self, mut wanted: Vec<Wanted>, stage: Stage) -> anyhow::Result<()> {
        let mut known = HashSet::new();
        wanted.retain(|run| known.insert((run.name, run.seed)));
        if wanted.is_empty() {
            return Ok(());
        }
        let root = self.a.output.join(FOLDER);
        let store = Store::open(&root, Timing::EXPIRY)?;
        let batch = self.batch(&wanted, stage)?;
        for run in &batch.runs {
            store.reopen(run)?;
        }
        batch.write_configs(&root)?;
        let config = self.write_base(&root)?;
        let devices = devices(self.common, &self.a.devices)?;
        let problem = Mutex::new(None);
        let show = |progress: &Progress<'_>| {
            self.show(progress);
            if let (Progress::Ended { .. }, Err(error)) = (progress, self.write(false)) {
                problem.lock().unwrap_or_else(|e| e.into_inner()).get_or_insert(error);
            }
        };
        let queue = Queue {
            store: &store,
            batch: &batch,
            launcher: &Programs {
                common: self.common,
                devices: &devices,
                arguments: &|launch| self.arguments(launch, stage, &config),
            },
            stop: self.stop,
            progress: &show,
            jobs: self.a.jobs.number(devices.len(), 1),
            retry_failed: false,
            retry_temporary: false,
            summarize: false,
            shard: None,
            timing: Timing::default(),
        };
        let report = queue.work()?;
        match problem.into_inner().unwrap_or_else(|e| e.into_inner()) {
            Some(error) => Err(error),
            None => self.finish(&report),
        }
    }

    /// Returns the batch of some runs.
    fn batch(&self, wanted: &[Wanted], stage: Stage) -> anyhow::Result<Batch> {
        let mut variants: Vec<Variant> = Vec::new();
        for run in wanted {
            if variants.iter().all(|variant| variant.name != run.name) {
                variants.push(Variant { name: run.name.to_owned(), settings: run.settings.clone() });
            }
        }
        let mut seeds: Vec<u64> = wanted.iter().map(|run| run.seed).collect();
        seeds.dedup();
        let budget = Some(self.base.memory.budget).filter(|bytes| *bytes > 0);
        let limits = Limits { memory_budget: budget, ..Limits::default() };
        let manifest = Manifest::of_scene(&self.a.scene, variants, seeds, stage, limits)?;
        let mut batch = Batch::new(&manifest, env!("CARGO_PKG_VERSION"), None, self.stop)?;
        let place = |name: &str, seed: u64| wanted.iter().position(|w| w.name == name && w.seed == seed);
        batch.runs.retain(|run| place(&run.variant, run.seed).is_some());
        batch.runs.sort_by_key(|run| place(&run.variant, run.seed));
        for (run, wanted) in batch.runs.iter_mut().zip(wanted) {
            run.directory = Some(std::path::absolute(&wanted.directory)?);
        }
        Ok(batch)
    }

    /// Writes the settings that all rows change. Returns their file.
    fn write_base(&self, root: &Path) -> anyhow::Result<PathBuf> {
        let text = toml::to_string(&self.base.to_table()?)?;
        let mut digest = Digest::new();
        digest.add(text.as_bytes());
        // The hash keeps the settings of commands apart that share the directory.
        let file = root.join("variants").join(format!("base.{:.8}.toml", digest.to_string()));
        sgs_scene::atomic_write(&file, |f| f.write_all(text.as_bytes()))?;
        Ok(file)
    }

    /// Returns the arguments of the process of a run.
    fn arguments(&self, launch: &Launch<'_>, stage: Stage, config: &Path) -> Vec<OsString> {
        let scene = self.a.scene.as_os_str().to_owned();
        if launch.phase == Phase::Plan {
            let mut plan = vec!["plan".into(), scene, "--stage".into(), stage.name().into()];
            plan.extend(["--config".into(), launch.config.clone().into()]);
            return plan;
        }
        let seed = launch.run.seed.to_string();
        let mut train: Vec<OsString> = vec![self.about.command.into(), scene, "-o".into(), (&self.a.output).into()];
        train.extend(["--stage", self.about.stage, "--seed", &seed, "--seeds", "1", "--one"].map(OsString::from));
        train.extend([(&launch.run.variant).into(), "--config".into(), config.into()]);
        for (option, file) in [("--start", self.about.start), ("--lpips", self.a.lpips.as_deref())] {
            train.extend(file.into_iter().flat_map(|file| [option.into(), file.into()]));
        }
        if let Some(bytes) = launch.memory_budget {
            train.extend(["--memory-budget".into(), bytes.to_string().into()]);
        }
        if self.a.force {
            train.push("--force".into());
        }
        train
    }

    /// Prints an event as one line.
    fn show(&self, progress: &Progress<'_>) {
        if self.common.quiet {
            return;
        }
        match progress {
            Progress::Ended { result, ended, total } => {
                let name = name_of(result);
                match &result.error {
                    Some(error) => say(format_args!("failed {ended} of {total}: {name}: {error}")),
                    None => say(format_args!("done {ended} of {total}: {name}, {:.0} s", result.seconds)),
                }
            }
            Progress::Again { name, reason, delay } => {
                say(format_args!("again in {:.0} s: {name}: {reason}", delay.as_secs_f64()));
            }
        }
    }

    /// Returns the error of a batch that did not train all of its runs.
    fn finish(&self, report: &Report) -> anyhow::Result<()> {
        if let Some(error) = &report.storage {
            return Err(storage_failure(error));
        }
        if report.stopped {
            let first = self.open().next().map_or(&self.a.output, |run| &run.root);
            return Err(self
                .stop
                .failure(format!("stopped in {}; the same command goes on from there", first.display())));
        }
        let Some(first) = report.failed.first() else { return Ok(()) };
        let error = first.error.as_deref().unwrap_or("no reason is known");
        let text =
            format!("{} of {} runs failed; the first, {}: {error}", report.failed.len(), report.runs, name_of(first));
        Err(failure(failure_of(&report.failed), text))
    }

    /// Returns the table of the runs that are measured.
    fn table(&self) -> Ablation {
        let (base, about) = (self.base, self.about);
        let has = |run: &TableRun<'_>| run.row.wanted && run.row.materials == Some(StageKind::Intrinsic);
        let mut table = Ablation {
            scene: self.a.scene.display().to_string(),
            steps: about.start.is_none().then_some(base.geometry.steps),
            start: about.start.map(|file| file.display().to_string()),
            intrinsic_steps: self.runs.iter().any(has).then_some(base.intrinsic.steps),
            lpips: self.lpips,
            ..Ablation::default()
        };
        for run in &self.runs {
            if let State::Measured(measures) = run.state(self.lpips) {
                table.add(&run.row.entry, run.seed, run.device(), *measures);
            }
        }
        table
    }

    /// Writes the table as JSON and Markdown, and returns it.
    ///
    /// `last`: whether this command writes no further table. Another one may have measured a run meanwhile.
    fn write(&self, last: bool) -> anyhow::Result<Ablation> {
        let mut table = self.table();
        loop {
            let json = serde_json::to_string_pretty(&table)?;
            for (end, text) in [("json", &json), ("md", &table.markdown())] {
                let file = self.a.output.join(format!("{}.{end}", self.about.name));
                sgs_scene::atomic_write(&file, |f| f.write_all(text.as_bytes()))?;
            }
            if !last {
                return Ok(table);
            }
            let now = self.table();
            if serde_json::to_string_pretty(&now)? == json {
                return Ok(table);
            }
            table = now;
        }
    }
}

/// Returns the name of a run in messages.
fn name_of(result: &RunResult) -> String {
    format!("{}, seed {}", result.variant, result.seed)
}
