//! Run of a table: a row with a seed, and what its directory holds.

use super::{Row, Start};
use crate::failure::refuse_usage;
use sgs_config::Settings;
use sgs_evaluate::metrics::LpipsAbout;
use sgs_run::{RunContents, RunDirectory, StageKind, read_splats};
use sgs_scene::Scene;
use sgs_study::{Goal, Measures, State};
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

/// Run of a table.
pub struct TableRun<'a> {
    pub row: &'a Row,
    pub seed: u64,
    /// Settings with the seed.
    pub settings: Settings,
    /// Run directory.
    pub root: PathBuf,
    /// Geometry on which materials are trained; `None` for the run's own geometry.
    pub start: Option<PathBuf>,
    /// What was measured, once it is known. Geometry files are large.
    measured: OnceLock<Measures>,
}

impl<'a> TableRun<'a> {
    /// Creates the run of a row with a seed. Also returns its scene.
    pub fn new(row: &'a Row, seed: u64, output: &Path) -> anyhow::Result<(TableRun<'a>, Scene)> {
        let (scene, settings) = of_seed(&row.settings, seed)?;
        let start = row.start.as_ref().map(|start| match start {
            Start::File(path) => path.clone(),
            Start::Training { entry, .. } => output.join(entry.folder(seed)).join("scene.ply"),
        });
        let root = output.join(row.entry.folder(seed));
        Ok((TableRun { row, seed, settings, root, start, measured: OnceLock::new() }, scene))
    }

    /// Returns directory and settings of the shared geometry that the run needs.
    pub fn geometry(&self, output: &Path) -> anyhow::Result<Option<(PathBuf, Settings)>> {
        let Some(Start::Training { entry, settings }) = &self.row.start else { return Ok(None) };
        Ok(Some((output.join(entry.folder(self.seed)), of_seed(settings, self.seed)?.1)))
    }

    /// Reads the state of the run directory.
    pub fn state(&self, lpips: Option<LpipsAbout>) -> State {
        if let Some(measures) = self.measured.get() {
            return State::Measured(Box::new(*measures));
        }
        // A row that is only shown keeps the measures that it has.
        let align = self.row.align && self.row.wanted;
        let state = State::of(&self.root, &self.settings, &Goal { materials: self.row.materials, lpips, align });
        if self.start.as_ref().is_some_and(|start| state != State::Absent && !is_on(&self.root, start)) {
            return State::Absent;
        }
        if let State::Measured(measures) = &state {
            self.measured.get_or_init(|| **measures);
        }
        state
    }

    /// Returns whether materials in the directory began with the same settings.
    pub fn has_begun_materials(&self, state: &State) -> bool {
        let began = RunDirectory::open(&self.root).and_then(|run| run.settings()).ok();
        // A transport stage that was interrupted begins again.
        self.row.materials != Some(StageKind::Transport)
            && *state != State::Absent
            && began.is_some_and(|began| began.intrinsic == self.settings.intrinsic)
    }

    /// Refuses to replace a run or its materials without `--force`.
    pub fn check(&self, state: &State, force: bool) -> anyhow::Result<()> {
        let replaced = *state == State::Formed
            && match self.row.materials {
                None => false,
                Some(StageKind::Transport) => self.root.join("emitters.json").is_file(),
                Some(_) => !self.has_begun_materials(state),
            };
        check(&self.root, *state == State::Absent, replaced, force)
    }

    /// Returns the name of the device that trained the run.
    pub fn device(&self) -> String {
        let text = std::fs::read_to_string(self.root.join("training.json")).unwrap_or_default();
        let value: serde_json::Value = serde_json::from_str(&text).unwrap_or_default();
        let named = value["device"].as_str().or_else(|| value["intrinsic"]["device"].as_str());
        let named = named.or_else(|| value["transport"]["device"].as_str());
        named.unwrap_or("an unknown device").to_owned()
    }
}

/// Returns scene and settings for a seed. The seed determines the random points.
pub fn of_seed(settings: &Settings, seed: u64) -> anyhow::Result<(Scene, Settings)> {
    let mut requested = Settings { seed, ..settings.clone() };
    let scene = Scene::open(&requested.scene, &requested.scene_options())?;
    requested.exposure = scene.exposure();
    requested.check()?;
    Ok((scene, requested))
}

/// Reads the state of a directory of shared geometry.
pub fn state_of_geometry(root: &Path, requested: &Settings) -> State {
    State::of(root, requested, &Goal::default())
}

/// Returns whether shared geometry is trained.
pub fn is_formed(root: &Path, requested: &Settings) -> bool {
    !matches!(state_of_geometry(root, requested), State::Absent | State::Begun)
}

/// Refuses to replace other geometry without `--force`.
pub fn check_geometry(root: &Path, requested: &Settings, force: bool) -> anyhow::Result<()> {
    check(root, state_of_geometry(root, requested) == State::Absent, false, force)
}

fn check(root: &Path, run: bool, materials: bool, force: bool) -> anyhow::Result<()> {
    let there = RunContents::of(root).unwrap_or_default();
    let has_materials = there.materials || there.transport;
    if !force && (run && there.is_trained() || materials && has_materials) {
        refuse_usage!(
            "\"{}\" holds a run with other settings: replace it with --force, or name another directory.",
            root.display()
        );
    }
    Ok(())
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
