//! Trainings one after another, and a table of what they came to: what `sgs ablate` and `sgs robustness` share.
//!
//! Promises: what is done is recognized and not done again; the table is on the disk after every run.

use super::eval::{Split, measure};
use super::geometry::{Ended, train_into};
use super::intrinsic::{IntrinsicEnded, intrinsic_into};
use super::train::{Options, Stage, open_scene, settings, validated};
use crate::cameras::splats_of;
use crate::common::Common;
use crate::ui::interrupted;
use anyhow::bail;
use sgs_scene::Scene;
use sgs_train::ablate::{Ablation, Entry, Goal, Measures, State};
use sgs_train::metrics::Lpips;
use sgs_train::{RunDirectory, Settings};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

#[derive(clap::Args)]
pub struct Series {
    /// Scene directory, with test views.
    pub scene: PathBuf,
    /// Directory for a run of each row and seed, and for the table as Markdown and JSON.
    #[arg(short, long, value_name = "DIR")]
    pub output: PathBuf,
    /// How many seeds, from --seed on.
    #[arg(long, value_name = "N", default_value = "3", value_parser = clap::value_parser!(u64).range(1..))]
    pub seeds: u64,
    /// Weights of LPIPS, which is measured, too.
    #[arg(long, value_name = "FILE.safetensors")]
    pub lpips: Option<PathBuf>,
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
}

/// Settings and scene, which must have test views.
pub fn base(a: &Series) -> anyhow::Result<Base> {
    let settings = settings(&a.scene, &a.options)?;
    let scene = open_scene(&settings)?;
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
    lacks: impl Fn(&T) -> sgs_train::Result<Option<(&'static str, String)>>,
) -> anyhow::Result<Vec<T>> {
    let mut kept = Vec::new();
    for one in all {
        match lacks(&one)? {
            None => kept.push(one),
            Some((name, lacking)) if !named => tracing::warn!("The {what} \"{name}\" is left out: {lacking}."),
            Some((name, lacking)) => bail!("The {what} \"{name}\" would differ from no other: {lacking}."),
        }
    }
    Ok(kept)
}

/// Trains and measures what is wanted and was not done before; writes `NAME.json` and `NAME.md`.
pub fn run(common: &Common, a: &Series, name: &str, base: &Settings, rows: &[Row], stage: Stage) -> anyhow::Result<()> {
    let Some(last) = base.seed.checked_add(a.seeds - 1) else {
        bail!("--seeds {} goes beyond the largest seed from --seed {} on.", a.seeds, base.seed);
    };
    let lpips = a.lpips.as_deref().map(|file| Lpips::load(file, Default::default())).transpose()?;
    let goal = Goal { materials: stage != Stage::Geometry, lpips: lpips.as_ref().map(|l| l.about()) };
    let stop = interrupted()?;
    let mut table = Ablation {
        scene: a.scene.display().to_string(),
        steps: base.geometry.steps,
        intrinsic_steps: goal.materials.then_some(base.intrinsic.steps),
        lpips: goal.lpips,
        ..Ablation::default()
    };
    std::fs::create_dir_all(&a.output)
        .map_err(|e| anyhow::anyhow!("\"{}\" cannot be made: {e}.", a.output.display()))?;
    let runs = Runs { common, goal, lpips: lpips.as_ref(), stop: &stop };
    // Seed by seed, so that an early look compares all rows. One that was measured before stays in the table.
    for seed in base.seed..=last {
        for row in rows {
            let asked = Settings { seed, ..row.settings.clone() };
            let root = a.output.join(row.entry.folder(seed));
            match runs.come_to(&row.entry, asked, &root, row.wanted)? {
                Came::To(device, measures) => table.add(&row.entry, seed, device, *measures),
                Came::Nowhere => continue,
                Came::Stopped => {
                    eprintln!("stopped in {}; the same command goes on from there", root.display());
                    std::process::exit(1);
                }
            }
            write(&a.output, name, &table)?;
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
}

impl Runs<'_> {
    /// Trains and measures a run as far as that is wanted and was not done before.
    fn come_to(&self, entry: &Entry, mut asked: Settings, root: &Path, wanted: bool) -> anyhow::Result<Came> {
        if !wanted && !root.is_dir() {
            return Ok(Came::Nowhere);
        }
        // Random points are drawn by the seed.
        let scene = Scene::open(&asked.scene, &asked.scene_options())?;
        asked.exposure = scene.exposure();
        asked.check()?;
        let state = State::of(root, &asked, &self.goal);
        if let State::Measured(measures) = state {
            return Ok(Came::To(trained_on(root), measures));
        }
        if !wanted {
            return Ok(Came::Nowhere);
        }
        if self.stop.load(Ordering::SeqCst) {
            return Ok(Came::Stopped);
        }
        // A device of its own, so that its memory's peak is that of this run.
        let device = self.common.open_device()?;
        if matches!(state, State::Absent | State::Begun) {
            let what = format!("{}, seed {}", entry.name, asked.seed);
            let begun = state == State::Begun;
            let ended = train_into(self.common, &device, &scene, &asked, root, begun, self.stop, &what, None)?;
            if let Ended::Stopped(_) = ended {
                return Ok(Came::Stopped);
            }
        }
        if self.goal.materials && state != State::Trained {
            let begun = RunDirectory::open(root)?.intrinsic_checkpoint().is_file();
            let ended = intrinsic_into(self.common, &device, &scene, &asked, root, None, begun, self.stop, None)?;
            if let IntrinsicEnded::Stopped(_) = ended {
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
}

/// The device that a run names.
fn trained_on(root: &Path) -> String {
    let text = std::fs::read_to_string(root.join("training.json")).unwrap_or_default();
    let value: serde_json::Value = serde_json::from_str(&text).unwrap_or_default();
    value["device"].as_str().unwrap_or("an unknown device").to_owned()
}

/// Writes what is known so far.
fn write(dir: &Path, name: &str, table: &Ablation) -> anyhow::Result<()> {
    let json = serde_json::to_string_pretty(table)?;
    for (end, text) in [("json", json), ("md", table.markdown())] {
        sgs_scene::atomic_write(&dir.join(format!("{name}.{end}")), |f| f.write_all(text.as_bytes()))?;
    }
    Ok(())
}
