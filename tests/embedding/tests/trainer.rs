//! Training through the C interface: bit-identical to `sgs train`.

#[macro_use]
mod support;

use sgs::*;
use sgs_tests::Place;
use sgs_tests::cli::sgs as run_sgs;
use sgs_tests::intrinsic::place;
use sgs_tests::rooms::Room;
use std::ffi::CString;
use std::ptr::null;
use support::{Context, text};

/// Trains `run` with both stages by the command line. Returns its settings.
fn by_command(place: &Place, run: &str, more: &[&str]) -> CString {
    let (scene, to) = (place.text("scene"), place.text(run));
    let fixed = ["train", &scene, "-o", &to, "-q"];
    run_sgs(&[&fixed, more].concat()).ok();
    CString::new(place.read(&format!("{run}/config.toml"))).unwrap()
}

const SMALL: [&str; 20] = [
    "--stage",
    "all",
    "--geometry-steps",
    "20",
    "--intrinsic-steps",
    "12",
    "--set",
    "train.checkpoint_interval=8",
    "--set",
    "transport.surfels=0",
    "--set",
    "intrinsic.environment.resolution=16",
    "--set",
    "intrinsic.lights.grid=2",
    "--set",
    "intrinsic.visibility.levels=4",
    "--set",
    "intrinsic.visibility.log2_table=10",
    "--set",
    "intrinsic.visibility.finest=64",
];

#[test]
fn both_stages_match_the_command_line_bit_for_bit() {
    let (place, _) = place();
    let settings = by_command(&place, "command", &SMALL);
    let context = Context::new();
    let dataset = text(&place.path("scene"));
    let both = SGS_STAGE_GEOMETRY | SGS_STAGE_INTRINSIC;
    let same = |run: &str| {
        for file in ["scene.ply", "lights.json", "environment.exr"] {
            assert!(place.read(&format!("command/{file}")) == place.read(&format!("{run}/{file}")), "{run}: {file}");
        }
    };
    let mut info = sized!(SgsTrainerInfo { dataset: dataset.as_ptr(), settings: settings.as_ptr(), stages: both });
    let (mut trainer, mut status) = (0, sized!(SgsTrainStatus {}));
    // SAFETY: all pointers are valid.
    unsafe {
        // In a directory, single steps first.
        let run = text(&place.path("directory"));
        info.run = run.as_ptr();
        context.ok(sgs_trainer_open(context.0, &info, &mut trainer));
        for step in 1..=9 {
            context.ok(sgs_train_step(context.0, trainer, 0.0, &mut status));
            assert_eq!((status.stage, status.step, status.steps), (SGS_STAGE_GEOMETRY, step, 20));
        }
        // The directory has one owner.
        let mut other = 0;
        let taken = sgs_trainer_open(context.0, &info, &mut other);
        context.refused(taken, SgsResult::SGS_ERROR_FILE, "directory");
        context.ok(sgs_destroy(context.0, trainer));
        // The trainer continues from the checkpoint after step 8, with its own settings.
        info.resume = 1;
        let twice = sgs_trainer_open(context.0, &info, &mut trainer);
        context.refused(twice, SgsResult::SGS_ERROR_ARGUMENT, "settings must be null");
        info.settings = null();
        context.ok(sgs_trainer_open(context.0, &info, &mut trainer));
        context.ok(sgs_train_step(context.0, trainer, 0.0, &mut status));
        assert_eq!(status.step, 9);
        context.ok(sgs_train_step(context.0, trainer, 1e6, &mut status));
        assert_eq!((status.stage, status.step, status.finished), (SGS_STAGE_INTRINSIC, 12, 1));
        context.ok(sgs_destroy(context.0, trainer));
        same("directory");
        assert_eq!(place.read("command/config.toml"), place.read("directory/config.toml"));
        // A finished run stays unchanged and is not replaced.
        let summary = place.read("directory/training.json");
        context.ok(sgs_trainer_open(context.0, &info, &mut trainer));
        context.ok(sgs_train_step(context.0, trainer, 1e6, &mut status));
        assert_eq!((status.finished, status.step), (1, 12));
        let export = text(&place.path("exported.ply"));
        context.ok(sgs_trainer_export(context.0, trainer, export.as_ptr()));
        assert!(place.read("exported.ply") == place.read("command/scene.ply"));
        context.ok(sgs_destroy(context.0, trainer));
        same("directory");
        assert_eq!(place.read("directory/training.json"), summary);
        (info.resume, info.settings) = (0, settings.as_ptr());
        let there = sgs_trainer_open(context.0, &info, &mut trainer);
        context.refused(there, SgsResult::SGS_ERROR_FILE, "holds a run");
        // In memory.
        info.run = null();
        context.ok(sgs_trainer_open(context.0, &info, &mut trainer));
        context.ok(sgs_train_step(context.0, trainer, 1e6, &mut status));
        assert_eq!((status.finished, status.roll_backs), (1, 0));
        let saved = text(&place.path("memory"));
        context.ok(sgs_trainer_save(context.0, trainer, saved.as_ptr()));
        context.ok(sgs_destroy(context.0, trainer));
        same("memory");
        // The second stage alone, on the geometry of a file.
        let geometry = by_command(&place, "geometry", &SMALL[2..]);
        let start = text(&place.path("geometry/scene.ply"));
        let alone = text(&place.path("alone"));
        (info.settings, info.start) = (geometry.as_ptr(), start.as_ptr());
        (info.run, info.stages) = (alone.as_ptr(), SGS_STAGE_INTRINSIC);
        context.ok(sgs_trainer_open(context.0, &info, &mut trainer));
        context.ok(sgs_train_step(context.0, trainer, 1e6, &mut status));
        context.ok(sgs_destroy(context.0, trainer));
        same("alone");
        // The transport stage alone.
        let small = ["--stage", "transport", "--set", "transport.surfels=256", "--set", "transport.steps=2"];
        let bounced = by_command(&place, "bounced", &[&SMALL[2..], &small].concat());
        let run = text(&place.path("bounced_alone"));
        (info.settings, info.run, info.stages) = (bounced.as_ptr(), run.as_ptr(), SGS_STAGE_TRANSPORT);
        context.ok(sgs_trainer_open(context.0, &info, &mut trainer));
        context.ok(sgs_train_step(context.0, trainer, 1e6, &mut status));
        assert_eq!((status.stage, status.step, status.finished), (SGS_STAGE_TRANSPORT, 3, 1));
        context.ok(sgs_destroy(context.0, trainer));
        for file in ["scene.ply", "emitters.json"] {
            assert!(place.read(&format!("bounced/{file}")) == place.read(&format!("bounced_alone/{file}")), "{file}");
        }
        info.settings = geometry.as_ptr();
        // A run's own geometry is not replaced by another geometry.
        let replaced = text(&place.path("geometry"));
        info.run = replaced.as_ptr();
        let taken = sgs_trainer_open(context.0, &info, &mut trainer);
        context.refused(taken, SgsResult::SGS_ERROR_FILE, "holds a run");
        (info.run, info.stages) = (null(), both);
        let conflict = sgs_trainer_open(context.0, &info, &mut trainer);
        context.refused(conflict, SgsResult::SGS_ERROR_ARGUMENT, "trained and given at once");
        info.stages = 8;
        let unknown = sgs_trainer_open(context.0, &info, &mut trainer);
        context.refused(unknown, SgsResult::SGS_ERROR_ARGUMENT, "SgsTrainerInfo.stages is 8");
    }
}

/// Settings with learning rates at which training diverges.
const WILD: [&str; 6] =
    ["--geometry-steps", "400", "--set", "geometry.rates.factor=300", "--set", "train.checkpoint_interval=50"];

#[test]
fn divergence_rollback_matches_the_command_line() {
    let place = Place::new(Room::default());
    let back = [&WILD[..], &["--set", "train.on_divergence=roll-back"]].concat();
    let settings = by_command(&place, "command", &back);
    let context = Context::new();
    let (dataset, run) = (text(&place.path("scene")), text(&place.path("run")));
    let mut info = sized!(SgsTrainerInfo { dataset: dataset.as_ptr(), settings: settings.as_ptr(), run: run.as_ptr() });
    let (mut trainer, mut status) = (0, sized!(SgsTrainStatus {}));
    // SAFETY: all pointers are valid.
    unsafe {
        context.ok(sgs_trainer_open(context.0, &info, &mut trainer));
        context.ok(sgs_train_step(context.0, trainer, 1e6, &mut status));
        context.ok(sgs_destroy(context.0, trainer));
        assert!(status.finished == 1 && status.roll_backs > 0);
        place.assert_same("command", "run");
        // Without a directory to roll back to, divergence is an error and ends the trainer.
        info.run = null();
        context.ok(sgs_trainer_open(context.0, &info, &mut trainer));
        for words in ["it has diverged", "ended with an error"] {
            let result = sgs_train_step(context.0, trainer, 1e6, &mut status);
            assert_ne!(result, SgsResult::SGS_OK);
            assert!(context.error().contains(words), "{}", context.error());
            assert_eq!(status.finished, 0);
        }
        let saved = text(&place.path("saved"));
        let result = sgs_trainer_save(context.0, trainer, saved.as_ptr());
        context.refused(result, SgsResult::SGS_ERROR_ARGUMENT, "ended with an error");
    }
}
