//! Training step by step, between whatever else a program does.

use crate::border::{Outcome, fail, optional_string, read, string, write};
use crate::context::{Inner, SgsContext, Thing, claim, hand_over, with};
use crate::scene::SceneObject;
use crate::types::*;
use sgs_scene::Scene;
use sgs_train::{Geometry, Progress, RunDirectory, Settings};
use std::ffi::c_char;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// A training under way.
pub(crate) struct TrainerObject {
    training: Geometry,
    steps: u32,
    loss: f32,
    gaussians: u32,
}

fn settings(text: Option<&str>, dataset: &str) -> Outcome<Settings> {
    let table = match text {
        None => toml::Table::new(),
        Some(text) => match text.parse::<toml::Table>() {
            Ok(table) => table,
            Err(error) => {
                let error = error.to_string().trim().replace('\n', " ");
                return fail(SgsResult::SGS_ERROR_ARGUMENT, format!("The settings are no TOML: {error}."));
            }
        },
    };
    let mut settings = Settings::from_table(table)?;
    // Whoever opens a run may stand in another directory.
    settings.scene = std::path::absolute(dataset).unwrap_or_else(|_| dataset.into());
    settings.check()?;
    Ok(settings)
}

fn open(inner: &Inner, dataset: &str, text: Option<&str>, run: Option<&str>) -> Outcome<TrainerObject> {
    let mut settings = match (run, text) {
        (Some(run), None) => {
            let mut settings = RunDirectory::open(Path::new(run))?.settings()?;
            settings.scene = std::path::absolute(dataset).unwrap_or_else(|_| dataset.into());
            settings
        }
        _ => settings(text, dataset)?,
    };
    let scene = Scene::open(&settings.scene, &settings.scene_options())?;
    // What was chosen for the scene belongs to the run.
    settings.exposure = scene.exposure();
    let mut training = Geometry::new(&inner.device, &scene, &settings, None)?;
    if let Some(run) = run {
        training.restore(&RunDirectory::open(Path::new(run))?.checkpoint())?;
    }
    let gaussians = training.gaussians().count(&inner.device)?;
    Ok(TrainerObject { training, steps: settings.geometry.steps, loss: 0.0, gaussians })
}

/// Opens a dataset for training.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sgs_trainer_open(
    context: *const SgsContext,
    info: *const SgsTrainerInfo,
    trainer: *mut SgsTrainer,
) -> SgsResult {
    // SAFETY: as the caller promises.
    unsafe {
        with(context, |inner| {
            claim(trainer)?;
            let info = read(info)?;
            let dataset = string(info.dataset, "SgsTrainerInfo.dataset")?;
            let text = optional_string(info.settings, "SgsTrainerInfo.settings")?;
            let run = optional_string(info.run, "SgsTrainerInfo.run")?;
            if info.resume != 0 && run.is_none() {
                return fail(SgsResult::SGS_ERROR_NULL, "SgsTrainerInfo.run is null, but is to be resumed.");
            }
            let run = run.filter(|_| info.resume != 0);
            let object = open(inner, &dataset, text.as_deref(), run.as_deref())?;
            hand_over(inner, trainer, Thing::Trainer(Box::new(object)))
        })
    }
}

/// Trains for a time, and at least one step unless all are done; returns with no work left on the device. `status` may be
/// null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sgs_train_step(
    context: *const SgsContext,
    trainer: SgsTrainer,
    budget_seconds: f64,
    status: *mut SgsTrainStatus,
) -> SgsResult {
    // SAFETY: as the caller promises.
    unsafe {
        with(context, |inner| {
            let object = inner.trainer(trainer)?;
            let Ok(budget) = Duration::try_from_secs_f64(budget_seconds) else {
                let text = format!("The budget is {budget_seconds} seconds, but must be a number from 0 on.");
                return fail(SgsResult::SGS_ERROR_ARGUMENT, text);
            };
            if !status.is_null() {
                // Before anything is trained.
                write(status, &object.status())?;
            }
            object.train(budget)?;
            if status.is_null() { Ok(()) } else { write(status, &object.status()) }
        })
    }
}

impl TrainerObject {
    fn train(&mut self, budget: Duration) -> Outcome<()> {
        let first = self.training.step();
        if first >= self.steps {
            return Ok(());
        }
        let (loss, gaussians) = (&mut self.loss, &mut self.gaussians);
        let heard = |p: &Progress| match p {
            Progress::Step(r) => (*loss, *gaussians) = (r.losses.total, r.gaussians),
            Progress::Densified { stats, .. } => *gaussians = stats.after,
            Progress::Decided(_) => {}
        };
        let began = Instant::now();
        // The first question comes before the first step.
        let mut asked = false;
        let go_on = || !std::mem::replace(&mut asked, true) || began.elapsed() < budget;
        Ok(self.training.train(self.steps, heard, go_on)?)
    }

    fn status(&self) -> SgsTrainStatus {
        let step = self.training.step();
        SgsTrainStatus {
            struct_size: 0,
            step,
            steps: self.steps,
            finished: u32::from(step >= self.steps),
            gaussians: self.gaussians,
            loss: self.loss,
        }
    }
}

/// Writes the run directory: settings, checkpoint, and the Gaussians as they are.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sgs_trainer_save(
    context: *const SgsContext,
    trainer: SgsTrainer,
    run: *const c_char,
) -> SgsResult {
    // SAFETY: as the caller promises.
    unsafe {
        with(context, |inner| {
            let run = string(run, "run")?;
            let training = &inner.trainer(trainer)?.training;
            let run = RunDirectory::create(Path::new(&run))?;
            run.write_settings(training.settings())?;
            training.save(&run.checkpoint())?;
            Ok(training.splats()?.write_ply(&run.path("scene.ply"))?)
        })
    }
}

/// Writes the Gaussians as they are as a PLY file.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sgs_trainer_export(
    context: *const SgsContext,
    trainer: SgsTrainer,
    path: *const c_char,
) -> SgsResult {
    // SAFETY: as the caller promises.
    unsafe {
        with(context, |inner| {
            let path = string(path, "path")?;
            Ok(inner.trainer(trainer)?.training.splats()?.write_ply(Path::new(&path))?)
        })
    }
}

/// The Gaussians as they are, as a scene of its own.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sgs_trainer_scene(
    context: *const SgsContext,
    trainer: SgsTrainer,
    scene: *mut SgsScene,
) -> SgsResult {
    // SAFETY: as the caller promises.
    unsafe {
        with(context, |inner| {
            claim(scene)?;
            let splats = inner.trainer(trainer)?.training.splats()?;
            let object = Thing::Scene(Arc::new(SceneObject::new(inner, &splats)?));
            hand_over(inner, scene, object)
        })
    }
}
