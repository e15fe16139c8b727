//! Training of a scene into a run directory: checks, settings, lock and trainer.

use crate::output::{self, Begin, Permission};
use crate::refuse_usage;
use crate::scenes::{check_start, open_scene, warn_without_priors};
use crate::settings::{Overrides, accuracy_of, settings, settings_of_stage, settings_over};
use sgs_config::{Backward, Settings, overlay};
use sgs_engine::Device;
use sgs_run::{DirectoryLock, KnownEmitters, RunContents, RunDirectory, StageKind};
use sgs_scene::Scene;
use sgs_train::{Observer, Outcome, StartGeometry, Trainer, TrainerOptions};
use std::path::PathBuf;
use std::sync::Arc;

/// Stages that are trained.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Stages {
    /// Geometry.
    #[default]
    Geometry,
    /// Materials, lights and shadows of the published model, on the run's geometry.
    Intrinsic,
    /// Materials, emitters and bounced light; trains geometry first if the run has none.
    Transport,
    /// All stages.
    All,
}

impl Stages {
    /// Returns the stages of a name, as `--stage` takes it.
    ///
    /// # Errors
    /// If no stage has this name.
    pub fn named(name: &str) -> anyhow::Result<Stages> {
        Ok(match name {
            "geometry" => Stages::Geometry,
            "intrinsic" => Stages::Intrinsic,
            "transport" => Stages::Transport,
            "all" => Stages::All,
            other => refuse_usage!(
                "stage is \"{other}\", but must be one of \"geometry\", \"intrinsic\", \"transport\", \"all\"."
            ),
        })
    }

    /// Returns the kinds of these stages.
    ///
    /// `geometry`: whether the transport stage trains its geometry first.
    pub fn kinds(self, settings: &Settings, geometry: bool) -> Vec<StageKind> {
        match self {
            Stages::Geometry => vec![StageKind::Geometry],
            Stages::Intrinsic => vec![StageKind::Intrinsic],
            Stages::Transport if geometry => vec![StageKind::Geometry, StageKind::Transport],
            Stages::Transport => vec![StageKind::Transport],
            Stages::All => {
                let all = StageKind::ALL.into_iter();
                all.filter(|kind| *kind != StageKind::Transport || settings.transport.enabled()).collect()
            }
        }
    }

    /// Returns the stage if it starts from the run's Gaussians.
    pub(crate) fn on_run(self) -> Option<StageKind> {
        match self {
            Stages::Geometry | Stages::All => None,
            Stages::Intrinsic => Some(StageKind::Intrinsic),
            Stages::Transport => Some(StageKind::Transport),
        }
    }
}

/// Request of a training.
#[derive(Clone, Debug, Default)]
pub struct TrainRequest {
    /// Scene directory.
    pub scene: PathBuf,
    /// Run directory.
    pub output: PathBuf,
    /// Stages to train.
    pub stages: Stages,
    /// Geometry of the intrinsic stage: a PLY or glTF file.
    pub start: Option<PathBuf>,
    /// Settings that differ from the defaults.
    pub overrides: Overrides,
    /// Continues an interrupted run.
    pub resume: bool,
    /// Replaces a run in the directory.
    pub force: bool,
}

/// Returns whether the transport stage trains its geometry first: the run has none, or it is unfinished and resumed.
fn trains_geometry(a: &TrainRequest, settings: &Settings) -> bool {
    let run = RunContents::of(&a.output).unwrap_or_default();
    let unfinished = || {
        let root = RunDirectory::open(&a.output).ok();
        let complete = root.map(|run| run.complete(settings)).unwrap_or_default();
        run.geometry && !run.materials && !run.transport && !complete.contains(&StageKind::Geometry)
    };
    a.stages == Stages::Transport && (!run.is_trained() || a.resume && unfinished())
}

/// Returns the settings with which a run began. Refuses differing options.
///
/// Changed settings would produce neither the old run nor a new one.
fn resumed(a: &TrainRequest) -> anyhow::Result<Settings> {
    let began = RunDirectory::open(&a.output)?.settings()?;
    let mut requested = match (&a.overrides.config, &a.overrides.preset, a.stages.on_run()) {
        (None, None, _) => {
            let mut table = began.to_table()?;
            overlay(&mut table, accuracy_of(&a.overrides)?);
            settings_over(table, &a.scene, &a.overrides)?
        }
        (_, _, Some(stage)) => settings_of_stage(stage, &began, &a.scene, &a.overrides)?,
        _ => settings(&a.scene, &a.overrides)?,
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

/// Checked training that holds the lock of its directory.
pub struct Training {
    scene: Arc<Scene>,
    settings: Settings,
    options: TrainerOptions,
    lock: DirectoryLock,
}

/// Checks a request, opens its scene and locks its directory. Returns `None` if the run has all of its steps.
///
/// `say` receives what the user should know.
///
/// # Errors
/// If the request is wrong, the directory is in use, or the scene cannot be trained.
pub fn prepare_training(a: &TrainRequest, mut say: impl FnMut(&str)) -> anyhow::Result<Option<Training>> {
    if a.start.is_some() && a.stages != Stages::Intrinsic {
        refuse_usage!("--start gives geometry to the intrinsic stage; add --stage intrinsic.");
    }
    let begin = match (a.stages, &a.start) {
        (Stages::Intrinsic, None) => Begin::Materials,
        (Stages::Intrinsic, Some(_)) => Begin::MaterialsFrom,
        (Stages::Transport, _) => Begin::Emitters,
        _ => Begin::Geometry,
    };
    let permission = Permission { force: a.force, resume: a.resume };
    output::check_run(&a.output, begin, permission)?;
    let there = a.output.join("config.toml").is_file();
    let resuming = a.resume && there;
    if resuming && a.stages == Stages::Geometry {
        RunDirectory::open(&a.output)?.check_without_materials()?;
    }
    let settings = match a.stages.on_run().filter(|_| there && begin != Begin::MaterialsFrom) {
        _ if resuming => resumed(a)?,
        // The Gaussians and their settings belong to the run.
        Some(stage) => settings_of_stage(stage, &RunDirectory::open(&a.output)?.settings()?, &a.scene, &a.overrides)?,
        None => settings(&a.scene, &a.overrides)?,
    };
    if a.stages == Stages::Transport && !settings.transport.enabled() {
        refuse_usage!("transport.surfels is 0, which leaves the transport stage out; set it to 64 or more.");
    }
    let kinds = a.stages.kinds(&settings, trains_geometry(a, &settings));
    if resuming {
        let complete = RunDirectory::open(&a.output)?.complete(&settings);
        if kinds.iter().all(|kind| complete.contains(kind)) {
            return Ok(None);
        }
    }
    let scene = open_scene(&settings)?;
    if kinds.contains(&StageKind::Geometry) && !resuming {
        check_start(&scene)?;
    }
    if kinds.contains(&StageKind::Transport)
        && !resuming
        && let Some(known) = KnownEmitters::of_scene(&scene)?
    {
        let (count, file) = (known.emitters.len(), KnownEmitters::path(&scene));
        say(&format!("the lights are the {count} emitters of \"{}\"", file.display()));
    }
    if a.stages != Stages::Geometry && !resuming {
        warn_without_priors(&scene)?;
    }
    let lock = output::lock(&a.output)?;
    // Another training may have ended before the lock was acquired.
    output::check_run(&a.output, begin, permission)?;
    let options = TrainerOptions {
        stages: kinds,
        run: Some(a.output.clone()),
        resume: a.resume,
        start: a.start.clone().map(StartGeometry::File),
    };
    Ok(Some(Training { scene: Arc::new(scene), settings, options, lock }))
}

impl Training {
    /// Returns the scene.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// Creates the trainer.
    ///
    /// # Errors
    /// As [`Trainer::new`].
    pub fn trainer(self, device: &Device) -> anyhow::Result<LockedTrainer> {
        let Training { scene, settings, options, lock } = self;
        Ok(LockedTrainer { trainer: Trainer::new(device, scene, &settings, options)?, _lock: lock })
    }
}

/// Trainer that holds the lock of its directory.
pub struct LockedTrainer {
    trainer: Trainer,
    _lock: DirectoryLock,
}

impl LockedTrainer {
    /// Trains until all stages are finished or the observer stops it.
    ///
    /// # Errors
    /// As [`Trainer::run`].
    pub fn run(&mut self, observer: &mut dyn Observer) -> anyhow::Result<Outcome> {
        Ok(self.trainer.run(observer)?)
    }
}
