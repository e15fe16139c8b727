//! Series of trainings with a table of metrics; shared by `sgs ablate` and `sgs robustness`.
//!
//! Guarantees: finished runs are recognized and not repeated. The table on disk is updated after every run.

use super::progress::Progress;
use super::train::{Options, settings, validated};
use crate::cameras::splats_of;
use crate::common::Common;
use crate::failure::refuse_usage;
use crate::output;
use crate::scenes::{check_start, open_scene};
use crate::ui::Stop;
use anyhow::bail;
use sgs_api::{MeasureOptions, Split, measure};
use sgs_config::Settings;
use sgs_engine::Device;
use sgs_evaluate::metrics::Lpips;
use sgs_run::{RunContents, RunDirectory, StageKind, read_splats};
use sgs_scene::Scene;
use sgs_study::{Ablation, Entry, Goal, Measures, State};
use sgs_train::{Outcome, StartGeometry, Trainer, TrainerOptions};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

#[derive(clap::Args)]
pub struct Series {
    /// Scene directory, with test views.
    pub scene: PathBuf,
    /// Directory for the runs, and for the table as Markdown and JSON.
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
    #[command(flatten)]
    pub options: Options,
}

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

impl Start {
    /// Returns the geometry file for a seed.
    fn file(&self, output: &Path, seed: u64) -> PathBuf {
        match self {
            Start::File(path) => path.clone(),
            Start::Training { entry, .. } => output.join(entry.folder(seed)).join("scene.ply"),
        }
    }
}

/// Opens settings and scene. Refuses a scene without test views.
pub fn base(a: &Series) -> anyhow::Result<Base> {
    let settings = settings(&a.scene, &a.options)?;
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
    /// Geometry file shared by all rows.
    pub start: Option<&'a Path>,
}

/// Trains and measures the rows that are wanted and not done. Writes `NAME.json` and `NAME.md`.
pub fn run(common: &Common, a: &Series, about: &About<'_>, base: &Settings, rows: &[Row]) -> anyhow::Result<()> {
    let Some(last) = base.seed.checked_add(a.seeds - 1) else {
        refuse_usage!("--seeds {} goes beyond the largest seed from --seed {} on.", a.seeds, base.seed);
    };
    let lpips = a.lpips.as_deref().map(|file| Lpips::load(file, Default::default())).transpose()?;
    output::check_series(&a.output, &["ablation", "robustness"])?;
    let stop = Stop::on_signals()?;
    let mut table = Ablation {
        scene: a.scene.display().to_string(),
        steps: about.start.is_none().then_some(base.geometry.steps),
        start: about.start.map(|file| file.display().to_string()),
        intrinsic_steps: rows
            .iter()
            .any(|row| row.wanted && row.materials == Some(StageKind::Intrinsic))
            .then_some(base.intrinsic.steps),
        lpips: lpips.as_ref().map(|l| l.about()),
        ..Ablation::default()
    };
    let _lock = output::lock(&a.output)?;
    let runs = Runs { common, lpips: lpips.as_ref(), stop: &stop, output: &a.output, force: a.force };
    // Seeds are the outer loop, so that an unfinished table already compares all rows. Rows measured before are
    // included.
    for seed in base.seed..=last {
        for row in rows {
            let root = a.output.join(row.entry.folder(seed));
            match runs.come_to(row, seed, &root)? {
                Came::To(device, measures) => table.add(&row.entry, seed, device, *measures),
                Came::Nowhere => continue,
                Came::Stopped => {
                    let text = format!("stopped in {}; the same command goes on from there", root.display());
                    return Err(stop.failure(text));
                }
            }
            write(&a.output, about.name, &table)?;
        }
    }
    if !common.answer(&table)? {
        print!("{}", table.markdown());
    }
    Ok(())
}

/// Result of a run.
enum Came {
    /// Device that trained the run, and its metrics.
    To(String, Box<Measures>),
    /// Neither measured before nor wanted now.
    Nowhere,
    /// Stopped by the user.
    Stopped,
}

/// Context for training and measuring runs.
struct Runs<'a> {
    common: &'a Common,
    lpips: Option<&'a Lpips>,
    stop: &'a AtomicBool,
    output: &'a Path,
    /// Whether runs with other settings may be replaced.
    force: bool,
}

impl Runs<'_> {
    /// Trains and measures a run; skips steps that are done or not wanted.
    fn come_to(&self, row: &Row, seed: u64, root: &Path) -> anyhow::Result<Came> {
        // A folder shared with another row does not show whether this row was trained.
        let shared = row.entry.run != row.entry.name;
        if !row.wanted && (shared || !root.is_dir()) {
            return Ok(Came::Nowhere);
        }
        let (scene, requested) = of_seed(&row.settings, seed)?;
        let goal = Goal { materials: row.materials, lpips: self.lpips.map(|l| l.about()) };
        let mut state = State::of(root, &requested, &goal);
        let start = row.start.as_ref().map(|start| start.file(self.output, seed));
        if start.as_deref().is_some_and(|start| state != State::Absent && !is_on(root, start)) {
            state = State::Absent;
        }
        if let State::Measured(measures) = state {
            return Ok(Came::To(trained_on(root), measures));
        }
        if !row.wanted {
            return Ok(Came::Nowhere);
        }
        if let Some(Start::Training { entry, settings }) = &row.start
            && !self.formed(entry, settings, seed)?
        {
            return Ok(Came::Stopped);
        }
        if self.stop.load(Ordering::SeqCst) {
            return Ok(Came::Stopped);
        }
        // Training of materials resumes only if it began with the same settings.
        let began = RunDirectory::open(root).and_then(|run| run.settings()).ok();
        let same = row.materials != Some(StageKind::Transport)
            && state != State::Absent
            && began.is_some_and(|began| began.intrinsic == requested.intrinsic);
        let others = state == State::Formed
            && match row.materials {
                None => false,
                // A stage that was interrupted begins again.
                Some(StageKind::Transport) => root.join("emitters.json").is_file(),
                Some(_) => !same,
            };
        self.check(root, state == State::Absent, others)?;
        let _lock = output::lock(root)?;
        // A new device per run, so that its peak memory is that of this run.
        let device = self.common.open_device()?;
        let scene = Arc::new(scene);
        let name = format!("{}, seed {seed}", row.entry.name);
        let train = |options: TrainerOptions| self.train(&device, &scene, &requested, &name, root, options);
        if row.start.is_none() && matches!(state, State::Absent | State::Begun) {
            let resume = state == State::Begun;
            if !train(TrainerOptions { stages: vec![StageKind::Geometry], resume, ..Default::default() })? {
                return Ok(Came::Stopped);
            }
        }
        if let Some(stage) = row.materials.filter(|_| state != State::Trained) {
            let run = RunDirectory::create(root)?;
            if start.is_some() && state == State::Absent {
                run.forget()?;
            }
            let resume = same && run.checkpoint(stage).is_file();
            if !train(TrainerOptions { stages: vec![stage], resume, start: start.map(StartGeometry::File), run: None })?
            {
                return Ok(Came::Stopped);
            }
        }
        let (splats, _) = splats_of(root)?;
        let run = RunDirectory::open(root)?;
        let options = MeasureOptions { split: Split::Test, lpips: self.lpips, images: None };
        measure(&device, &scene, &run, &splats, &requested, options)?;
        validated(&device)?;
        match Measures::read(&run) {
            Some(measures) => Ok(Came::To(trained_on(root), Box::new(measures))),
            None => bail!("\"{}\" was measured, but its metrics.json does not say so.", root.display()),
        }
    }

    /// Refuses to replace a run or its materials without `--force`.
    fn check(&self, root: &Path, run: bool, materials: bool) -> anyhow::Result<()> {
        let there = RunContents::of(root).unwrap_or_default();
        let has_materials = there.materials || there.transport;
        if !self.force && (run && there.is_trained() || materials && has_materials) {
            refuse_usage!(
                "\"{}\" holds a run with other settings: replace it with --force, or name another directory.",
                root.display()
            );
        }
        Ok(())
    }

    /// Trains the shared geometry unless it is finished. Returns whether it is finished.
    fn formed(&self, entry: &Entry, settings: &Settings, seed: u64) -> anyhow::Result<bool> {
        let root = self.output.join(entry.folder(seed));
        let (scene, requested) = of_seed(settings, seed)?;
        let state = State::of(&root, &requested, &Goal::default());
        if !matches!(state, State::Absent | State::Begun) {
            return Ok(true);
        }
        self.check(&root, state == State::Absent, false)?;
        let _lock = output::lock(&root)?;
        let device = self.common.open_device()?;
        let name = format!("{}, seed {seed}", entry.name);
        let options = TrainerOptions { resume: state == State::Begun, ..Default::default() };
        let finished = self.train(&device, &Arc::new(scene), &requested, &name, &root, options)?;
        validated(&device)?;
        Ok(finished)
    }

    /// Trains a stage into a run directory. Returns whether it finished.
    fn train(
        &self,
        device: &Device,
        scene: &Arc<Scene>,
        settings: &Settings,
        name: &str,
        root: &Path,
        options: TrainerOptions,
    ) -> anyhow::Result<bool> {
        let options = TrainerOptions { run: Some(root.to_owned()), ..options };
        let mut trainer = Trainer::new(device, scene.clone(), settings, options)?;
        let outcome = trainer.run(&mut Progress::of_series(self.common, self.stop, name.to_owned()))?;
        Ok(outcome == Outcome::Finished)
    }
}

/// Returns scene and settings for a seed. The seed determines the random points.
fn of_seed(settings: &Settings, seed: u64) -> anyhow::Result<(Scene, Settings)> {
    let mut requested = Settings { seed, ..settings.clone() };
    let scene = Scene::open(&requested.scene, &requested.scene_options())?;
    requested.exposure = scene.exposure();
    requested.check()?;
    Ok((scene, requested))
}

/// Returns whether a run has the geometry of a file. Missing files count as equal.
fn is_on(root: &Path, start: &Path) -> bool {
    let own = root.join("scene.ply");
    if !own.is_file() || !start.is_file() {
        return true;
    }
    match (read_splats(&own), read_splats(start)) {
        (Ok(a), Ok(b)) => {
            (&a.means, &a.log_scales, &a.rotations) == (&b.means, &b.log_scales, &b.rotations)
                && (&a.opacity_logits, &a.sh) == (&b.opacity_logits, &b.sh)
        }
        _ => false,
    }
}

/// Returns the name of the device that trained a run.
fn trained_on(root: &Path) -> String {
    let text = std::fs::read_to_string(root.join("training.json")).unwrap_or_default();
    let value: serde_json::Value = serde_json::from_str(&text).unwrap_or_default();
    let named = value["device"].as_str().or_else(|| value["intrinsic"]["device"].as_str());
    let named = named.or_else(|| value["transport"]["device"].as_str());
    named.unwrap_or("an unknown device").to_owned()
}

/// Writes the current table as JSON and Markdown.
fn write(dir: &Path, name: &str, table: &Ablation) -> anyhow::Result<()> {
    let json = serde_json::to_string_pretty(table)?;
    for (end, text) in [("json", json), ("md", table.markdown())] {
        sgs_scene::atomic_write(&dir.join(format!("{name}.{end}")), |f| f.write_all(text.as_bytes()))?;
    }
    Ok(())
}
