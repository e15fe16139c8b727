//! Training in slices of time, between other work of a program.

use crate::border::{Outcome, fail, optional_string, read, string, write};
use crate::context::{Inner, SgsContext, claim, hand_over, with};
use crate::object::{SceneObject, Thing, TrainerObject};
use crate::types::*;
use sgs_config::Settings;
use sgs_run::{Contents, DirectoryLock, RunDirectory, StageKind};
use sgs_scene::Scene;
use sgs_train::{StartGeometry, Trainer, TrainerOptions};
use std::ffi::c_char;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

/// Fields of `SgsTrainerInfo` as Rust types.
struct Request<'a> {
    dataset: &'a str,
    settings: Option<&'a str>,
    run: Option<&'a Path>,
    resume: bool,
    start: Option<&'a Path>,
    stages: u32,
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
    // A program that opens the run may have another working directory.
    settings.scene = std::path::absolute(dataset).unwrap_or_else(|_| dataset.into());
    settings.check()?;
    Ok(settings)
}

fn stages(flags: u32) -> Outcome<Vec<StageKind>> {
    let all = [
        (SGS_STAGE_GEOMETRY, StageKind::Geometry),
        (SGS_STAGE_INTRINSIC, StageKind::Intrinsic),
        (SGS_STAGE_TRANSPORT, StageKind::Transport),
    ];
    let known = SGS_STAGE_GEOMETRY | SGS_STAGE_INTRINSIC | SGS_STAGE_TRANSPORT;
    if flags & !known != 0 {
        let text = format!(
            "SgsTrainerInfo.stages is {flags}, but must be a sum of SGS_STAGE_GEOMETRY, SGS_STAGE_INTRINSIC and \
             SGS_STAGE_TRANSPORT."
        );
        return fail(SgsResult::SGS_ERROR_ARGUMENT, text);
    }
    let flags = if flags == 0 { SGS_STAGE_GEOMETRY } else { flags };
    Ok(all.into_iter().filter(|(flag, _)| flags & flag != 0).map(|(_, kind)| kind).collect())
}

/// Refuses a directory whose files a new run would destroy.
fn check_new(run: &Path, stages: &[StageKind], start: bool) -> Outcome<()> {
    let name = run.display();
    match Contents::of(run) {
        Contents::Nothing => Ok(()),
        Contents::Run(there) if !there.is_trained() => Ok(()),
        // Materials and emitters are added to the geometry of the run.
        Contents::Run(there) if !start && stages == [StageKind::Intrinsic] && !there.materials => Ok(()),
        Contents::Run(there) if !start && stages == [StageKind::Transport] && !there.transport => Ok(()),
        Contents::Run(_) => fail(
            SgsResult::SGS_ERROR_FILE,
            format!("\"{name}\" holds a run: set SgsTrainerInfo.resume, or name another directory."),
        ),
        _ => fail(
            SgsResult::SGS_ERROR_FILE,
            format!("\"{name}\" holds files that do not belong to a run: name a new or an empty directory."),
        ),
    }
}

fn open(inner: &Inner, request: &Request<'_>) -> Outcome<TrainerObject> {
    let stages = stages(request.stages)?;
    let began = match request.run {
        Some(run) if request.resume => Some(RunDirectory::open(run)?.settings()?),
        Some(run) if !stages.contains(&StageKind::Geometry) => {
            RunDirectory::open(run).and_then(|run| run.settings()).ok()
        }
        _ => None,
    };
    if request.resume && request.settings.is_some() {
        let text = "SgsTrainerInfo.settings must be null where a run is resumed: it continues with its own settings.";
        return fail(SgsResult::SGS_ERROR_ARGUMENT, text);
    }
    let mut settings = match (began, request.settings) {
        (Some(began), None) => began,
        (_, text) => settings(text, request.dataset)?,
    };
    // A program that opens the run may have another working directory.
    settings.scene = std::path::absolute(request.dataset).unwrap_or_else(|_| request.dataset.into());
    let scene = Scene::open(&settings.scene, &settings.scene_options())?;
    let lock = match request.run {
        Some(run) => {
            let check = || match request.resume {
                true => Ok(()),
                false => check_new(run, &stages, request.start.is_some()),
            };
            check()?;
            let lock = DirectoryLock::acquire(run)?;
            // Another training may have ended in the meantime.
            check()?;
            Some(lock)
        }
        None => None,
    };
    let options = TrainerOptions {
        stages,
        run: request.run.map(Path::to_owned),
        resume: request.resume,
        start: request.start.map(|path| StartGeometry::File(path.to_owned())),
    };
    let mut trainer = Trainer::new(&inner.device, Arc::new(scene), &settings, options)?;
    trainer.prepare(&mut ())?;
    TrainerObject::new(trainer, lock)
}

/// Opens a dataset for training. Locks the run directory, if any, until the trainer is destroyed. Unless it resumes,
/// removes the files of an unfinished training in that directory.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sgs_trainer_open(
    context: *const SgsContext,
    info: *const SgsTrainerInfo,
    trainer: *mut SgsTrainer,
) -> SgsResult {
    // SAFETY: by the caller's contract.
    unsafe {
        with(context, |inner| {
            claim(trainer)?;
            let info = read(info)?;
            let dataset = string(info.dataset, "SgsTrainerInfo.dataset")?;
            let text = optional_string(info.settings, "SgsTrainerInfo.settings")?;
            let run = optional_string(info.run, "SgsTrainerInfo.run")?;
            let start = optional_string(info.start, "SgsTrainerInfo.start")?;
            if info.resume != 0 && run.is_none() {
                return fail(SgsResult::SGS_ERROR_NULL, "SgsTrainerInfo.run is null, but is to be resumed.");
            }
            let request = Request {
                dataset: &dataset,
                settings: text.as_deref(),
                run: run.as_deref().map(Path::new),
                resume: info.resume != 0,
                start: start.as_deref().map(Path::new),
                stages: info.stages,
            };
            let object = open(inner, &request)?;
            hand_over(inner, trainer, Thing::Trainer(Box::new(object)))
        })
    }
}

/// Trains for a time, and at least one step unless all are finished. Returns with no work left on the device. `status`
/// may be null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sgs_train_step(
    context: *const SgsContext,
    trainer: SgsTrainer,
    budget_seconds: f64,
    status: *mut SgsTrainStatus,
) -> SgsResult {
    // SAFETY: by the caller's contract.
    unsafe {
        with(context, |inner| {
            let object = inner.trainer(trainer)?;
            let Ok(budget) = Duration::try_from_secs_f64(budget_seconds) else {
                let text = format!("The budget is {budget_seconds} seconds, but must be a number from 0 on.");
                return fail(SgsResult::SGS_ERROR_ARGUMENT, text);
            };
            if !status.is_null() {
                // An invalid struct is refused before anything is trained.
                write(status, &object.status())?;
            }
            object.train(budget)?;
            if status.is_null() { Ok(()) } else { write(status, &object.status()) }
        })
    }
}

/// Writes settings, a checkpoint and the results of the stage into a run directory. Training can be resumed from it.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sgs_trainer_save(
    context: *const SgsContext,
    trainer: SgsTrainer,
    run: *const c_char,
) -> SgsResult {
    // SAFETY: by the caller's contract.
    unsafe {
        with(context, |inner| {
            let run = string(run, "run")?;
            Ok(inner.trainer(trainer)?.trainer.save(Path::new(&run))?)
        })
    }
}

/// Writes the current Gaussians as a PLY file.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sgs_trainer_export(
    context: *const SgsContext,
    trainer: SgsTrainer,
    path: *const c_char,
) -> SgsResult {
    // SAFETY: by the caller's contract.
    unsafe {
        with(context, |inner| {
            let path = string(path, "path")?;
            Ok(inner.trainer(trainer)?.trainer.splats()?.write_ply(Path::new(&path))?)
        })
    }
}

/// Returns a copy of the current Gaussians as a scene.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sgs_trainer_scene(
    context: *const SgsContext,
    trainer: SgsTrainer,
    scene: *mut SgsScene,
) -> SgsResult {
    // SAFETY: by the caller's contract.
    unsafe {
        with(context, |inner| {
            claim(scene)?;
            let splats = inner.trainer(trainer)?.trainer.splats()?;
            let object = Thing::Scene(Arc::new(SceneObject::new(&inner.device, &splats)?));
            hand_over(inner, scene, object)
        })
    }
}
