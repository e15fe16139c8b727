//! Trainings one after another, and a table of what they came to: what `sgs ablate` and `sgs robustness` share.
//!
//! Promises: what is done is recognized and not done again; the table is on the disk after every run.

use super::eval::{Split, measure};
use super::progress::Progress;
use super::train::{Options, Stage, settings, validated};
use crate::cameras::splats_of;
use crate::common::Common;
use crate::failure::refuse_usage;
use crate::output;
use crate::scenes::{check_start, open_scene};
use crate::ui::Stop;
use anyhow::bail;
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
    /// Number of seeds, from --seed on.
    #[arg(long, value_name = "N", default_value = "3", value_parser = clap::value_parser!(u64).range(1..))]
    pub seeds: u64,
    /// Weights of LPIPS, to measure it.
    #[arg(long, value_name = "FILE.safetensors")]
    pub lpips: Option<PathBuf>,
    /// Replace runs with other settings.
    #[arg(long)]
    pub force: bool,
    #[command(flatten)]
    pub options: Options,
}

/// What all trainings have in common.
pub struct Base {
    pub settings: Settings,
    pub scene: Scene,
}

/// A row of the table.
pub struct Row {
    pub entry: Entry,
    /// Its settings, but for the seed.
    pub settings: Settings,
    /// Whether it is to be trained; else it stays in the table where it was measured before.
    pub wanted: bool,
    /// The geometry of its materials, where that is not its own.
    pub start: Option<Start>,
}

/// Geometry that rows have in common.
#[derive(Clone)]
pub enum Start {
    /// A file.
    File(PathBuf),
    /// What this training comes to, of each seed; its folder may be that of a row.
    Training { entry: Entry, settings: Box<Settings> },
}

impl Start {
    /// Its file for a seed.
    fn file(&self, output: &Path, seed: u64) -> PathBuf {
        match self {
            Start::File(path) => path.clone(),
            Start::Training { entry, .. } => output.join(entry.folder(seed)).join("scene.ply"),
        }
    }
}

/// Settings and scene, which must have test views.
pub fn base(a: &Series) -> anyhow::Result<Base> {
    let settings = settings(&a.scene, &a.options)?;
    let scene = open_scene(&settings)?;
    check_start(&scene)?;
    if scene.split.test.is_empty() {
        bail!("\"{}\" has no test views to compare at; name some in split.json.", a.scene.display());
    }
    Ok(Base { settings, scene })
}

/// Those that differ from the others on this scene. Who asks for another by name is told.
///
/// `what`: what rows are called; `lacks`: why one would differ from no other.
pub fn possible<T: Copy>(
    what: &str,
    all: Vec<T>,
    named: bool,
    lacks: impl Fn(&T) -> sgs_study::Result<Option<(&'static str, String)>>,
) -> anyhow::Result<Vec<T>> {
    let mut kept = Vec::new();
    for one in all {
        match lacks(&one)? {
            None => kept.push(one),
            Some((name, lacking)) if !named => tracing::warn!("The {what} \"{name}\" is left out: {lacking}."),
            Some((name, lacking)) => refuse_usage!("The {what} \"{name}\" would differ from no other: {lacking}."),
        }
    }
    Ok(kept)
}

/// What the table of a series is.
pub struct About<'a> {
    /// Its files' name.
    pub name: &'a str,
    /// Up to where rows are trained.
    pub stage: Stage,
    /// What all begin with, if it is a file.
    pub start: Option<&'a Path>,
}

/// Trains and measures what is wanted and was not done before; writes `NAME.json` and `NAME.md`.
pub fn run(common: &Common, a: &Series, about: &About<'_>, base: &Settings, rows: &[Row]) -> anyhow::Result<()> {
    let Some(last) = base.seed.checked_add(a.seeds - 1) else {
        refuse_usage!("--seeds {} goes beyond the largest seed from --seed {} on.", a.seeds, base.seed);
    };
    let lpips = a.lpips.as_deref().map(|file| Lpips::load(file, Default::default())).transpose()?;
    let goal = Goal { materials: about.stage != Stage::Geometry, lpips: lpips.as_ref().map(|l| l.about()) };
    output::check_series(&a.output, &["ablation", "robustness"])?;
    let stop = Stop::on_signals()?;
    let mut table = Ablation {
        scene: a.scene.display().to_string(),
        steps: about.start.is_none().then_some(base.geometry.steps),
        start: about.start.map(|file| file.display().to_string()),
        intrinsic_steps: goal.materials.then_some(base.intrinsic.steps),
        lpips: goal.lpips,
        ..Ablation::default()
    };
    let _lock = output::lock(&a.output)?;
    let runs = Runs { common, goal, lpips: lpips.as_ref(), stop: &stop, output: &a.output, force: a.force };
    // Seed by seed, so that an early look compares all rows. One that was measured before stays in the table.
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

/// What became of a run.
enum Came {
    /// The device that trained it, and what it came to.
    To(String, Box<Measures>),
    /// It was not done before and is not wanted now.
    Nowhere,
    /// Somebody wanted to stop.
    Stopped,
}

/// How runs are made.
struct Runs<'a> {
    common: &'a Common,
    goal: Goal,
    lpips: Option<&'a Lpips>,
    stop: &'a AtomicBool,
    output: &'a Path,
    /// Whether runs with other settings may be replaced.
    force: bool,
}

impl Runs<'_> {
    /// Trains and measures a run as far as that is wanted and was not done before.
    fn come_to(&self, row: &Row, seed: u64, root: &Path) -> anyhow::Result<Came> {
        // A run of another row says nothing of whether this one was trained before.
        let shared = row.entry.run != row.entry.name;
        if !row.wanted && (shared || !root.is_dir()) {
            return Ok(Came::Nowhere);
        }
        let (scene, asked) = of_seed(&row.settings, seed)?;
        let mut state = State::of(root, &asked, &self.goal);
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
        // Materials are gone on with if they were begun with the same settings.
        let began = RunDirectory::open(root).and_then(|run| run.settings()).ok();
        let same = state != State::Absent && began.is_some_and(|began| began.intrinsic == asked.intrinsic);
        let others = self.goal.materials && state == State::Formed && !same;
        self.check(root, state == State::Absent, others)?;
        let _lock = output::lock(root)?;
        // A device of its own, so that its memory's peak is that of this run.
        let device = self.common.open_device()?;
        let scene = Arc::new(scene);
        let name = format!("{}, seed {seed}", row.entry.name);
        let train = |options: TrainerOptions| self.train(&device, &scene, &asked, &name, root, options);
        if row.start.is_none() && matches!(state, State::Absent | State::Begun) {
            let resume = state == State::Begun;
            if !train(TrainerOptions { stages: vec![StageKind::Geometry], resume, ..Default::default() })? {
                return Ok(Came::Stopped);
            }
        }
        if self.goal.materials && state != State::Trained {
            let run = RunDirectory::create(root)?;
            if start.is_some() && state == State::Absent {
                run.forget()?;
            }
            let resume = same && run.checkpoint(StageKind::Intrinsic).is_file();
            if !train(TrainerOptions {
                stages: vec![StageKind::Intrinsic],
                resume,
                start: start.map(StartGeometry::File),
                run: None,
            })? {
                return Ok(Came::Stopped);
            }
        }
        let (splats, _) = splats_of(root)?;
        let run = RunDirectory::open(root)?;
        measure(&device, &scene, &run, &splats, &asked, Split::Test, self.lpips, None)?;
        validated(&device)?;
        match Measures::read(&run) {
            Some(measures) => Ok(Came::To(trained_on(root), Box::new(measures))),
            None => bail!("\"{}\" was measured, but its metrics.json does not say so.", root.display()),
        }
    }

    /// Refuses to replace a run or its materials, unless `--force` allows it.
    fn check(&self, root: &Path, run: bool, materials: bool) -> anyhow::Result<()> {
        let there = RunContents::of(root).unwrap_or_default();
        if !self.force && (run && there.is_trained() || materials && there.materials) {
            refuse_usage!(
                "\"{}\" holds a run with other settings: replace it with --force, or name another directory.",
                root.display()
            );
        }
        Ok(())
    }

    /// Trains the geometry that rows have in common, as far as that was not done before; whether it is whole.
    fn formed(&self, entry: &Entry, settings: &Settings, seed: u64) -> anyhow::Result<bool> {
        let root = self.output.join(entry.folder(seed));
        let (scene, asked) = of_seed(settings, seed)?;
        let state = State::of(&root, &asked, &Goal::default());
        if !matches!(state, State::Absent | State::Begun) {
            return Ok(true);
        }
        self.check(&root, state == State::Absent, false)?;
        let _lock = output::lock(&root)?;
        let device = self.common.open_device()?;
        let name = format!("{}, seed {seed}", entry.name);
        let options = TrainerOptions { resume: state == State::Begun, ..Default::default() };
        let finished = self.train(&device, &Arc::new(scene), &asked, &name, &root, options)?;
        validated(&device)?;
        Ok(finished)
    }

    /// Trains a stage into a run directory. Returns whether it is finished.
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

/// Scene and settings of a run. Random points are drawn by the seed.
fn of_seed(settings: &Settings, seed: u64) -> anyhow::Result<(Scene, Settings)> {
    let mut asked = Settings { seed, ..settings.clone() };
    let scene = Scene::open(&asked.scene, &asked.scene_options())?;
    asked.exposure = scene.exposure();
    asked.check()?;
    Ok((scene, asked))
}

/// Whether the materials of a run lie on the geometry of a file, as far as both are there.
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

/// The device that a run names.
fn trained_on(root: &Path) -> String {
    let text = std::fs::read_to_string(root.join("training.json")).unwrap_or_default();
    let value: serde_json::Value = serde_json::from_str(&text).unwrap_or_default();
    let named = value["device"].as_str().or_else(|| value["intrinsic"]["device"].as_str());
    named.unwrap_or("an unknown device").to_owned()
}

/// Writes what is known so far.
fn write(dir: &Path, name: &str, table: &Ablation) -> anyhow::Result<()> {
    let json = serde_json::to_string_pretty(table)?;
    for (end, text) in [("json", json), ("md", table.markdown())] {
        sgs_scene::atomic_write(&dir.join(format!("{name}.{end}")), |f| f.write_all(text.as_bytes()))?;
    }
    Ok(())
}
