//! Log of the intrinsic stage.
//!
//! Log lines name each loss that runs. Warnings name each loss that has a weight and does not run.

use serde_json::Value;
use sgs_config::{OwnPrior, Settings};
use sgs_run::StageKind;
use sgs_scene::{Scene, SceneOptions, Splats};
use sgs_tests::cli::sgs;
use sgs_tests::intrinsic::{place, settings};
use sgs_tests::priors::provider;
use sgs_tests::rooms::Room;
use sgs_tests::{Gpu, Place};
use sgs_train::{Intrinsic, IntrinsicLog};
use std::collections::BTreeSet;

/// Keys that every log line has, for any losses.
const ALWAYS: [&str; 6] = ["stage", "step", "shaded", "l1", "ssim", "skipped"];
/// Losses that need neither priors nor regions.
const FREE: [&str; 6] =
    ["albedo_smooth", "roughness_smooth", "environment_smooth", "light_position", "light_value", "visibility_jitter"];
const PRIORS: [&str; 5] = ["albedo", "roughness", "metallic", "albedo_gradients", "roughness_gradients"];
const REGIONS: [&str; 3] = ["cross_view", "relight", "own_prior"];

const SMALL: [&str; 8] = [
    "transport.surfels=0",
    "intrinsic.environment.resolution=16",
    "intrinsic.lights.grid=2",
    "intrinsic.relight_from=1",
    "intrinsic.visibility.levels=4",
    "intrinsic.visibility.log2_table=10",
    "intrinsic.visibility.coarsest=4",
    "intrinsic.visibility.finest=32",
];

fn arguments(place: &Place, command: &[&str], more: &[&str]) -> Vec<String> {
    let mut all: Vec<String> = vec![command[0].into(), place.text("scene")];
    all.extend(command[1..].iter().map(|a| (*a).to_owned()));
    all.extend(["--geometry-steps", "2", "--no-densify", "--intrinsic-steps", "12"].map(String::from));
    SMALL.iter().chain(more).for_each(|pair| all.extend(["--set".into(), (*pair).to_owned()]));
    all
}

/// Returns the last log line of the intrinsic stage.
fn last(place: &Place) -> Value {
    let text = String::from_utf8(place.read("run/log.jsonl")).unwrap();
    let mut lines = text.lines().map(|l| serde_json::from_str::<Value>(l).unwrap());
    lines.rfind(|l| l["stage"] == "intrinsic" && l.get("decision").is_none()).unwrap()
}

fn keys(line: &Value) -> BTreeSet<&str> {
    line.as_object().unwrap().keys().map(String::as_str).collect()
}

fn settings_of(warnings: &Value) -> Vec<String> {
    let all = warnings.as_array().map(Vec::as_slice).unwrap_or_default();
    all.iter().map(|w| w["setting"].as_str().unwrap().replace(".losses.", " ")).collect()
}

#[test]
fn the_log_has_every_loss_that_runs() {
    let (place, _) = place();
    let relight_provider = format!("intrinsic.relight.provider={}", provider("misbehave=nothing"));
    let all = [
        relight_provider.as_str(),
        "intrinsic.losses.own_prior=0.2",
        "geometry.losses.correspondence=0",
        "geometry.semantics=false",
    ];
    let run = place.text("run");
    let ended = sgs(&arguments(&place, &["train", "-o", &run, "--stage", "all", "--json"], &all)).ok();
    let line = last(&place);
    let expected: BTreeSet<&str> = [&ALWAYS[..], &FREE, &PRIORS, &REGIONS].concat().into_iter().collect();
    assert_eq!(keys(&line), expected);
    for key in expected.iter().filter(|k| !["stage", "step", "skipped"].contains(k)) {
        assert!(line[*key].as_f64().is_some_and(|v| v > 0.0), "{key}: {line}");
    }
    assert!(!ended.stderr.contains(" not run: "), "{}", ended.stderr);
    let training: Value = serde_json::from_slice(&place.read("run/training.json")).unwrap();
    assert!(training.get("warnings").is_none() && training["intrinsic"].get("warnings").is_none(), "{training}");
}

#[test]
fn losses_that_cannot_run_are_warnings() {
    let place = Place::new(Room::default());
    let run = place.text("run");
    let ended =
        sgs(&arguments(&place, &["train", "-o", &run, "--stage", "all"], &["intrinsic.environment.every=4"])).ok();
    let line = last(&place);
    assert_eq!(keys(&line), [&ALWAYS[..], &FREE].concat().into_iter().collect());
    assert!(line["environment_smooth"].as_f64().unwrap() > 0.0, "{line}");
    let training: Value = serde_json::from_slice(&place.read("run/training.json")).unwrap();
    let geometry = ["normal", "normal_smooth", "semantic", "semantic_class", "correspondence"];
    let materials = ["albedo", "roughness", "metallic", "cross_view", "relight", "own_prior"];
    let of = |stage: &str, names: &[&str]| names.iter().map(|n| format!("{stage} {n}")).collect::<Vec<_>>();
    let (geometry, materials) = (of("geometry", &geometry), of("intrinsic", &materials));
    assert_eq!(settings_of(&training["warnings"]), geometry);
    assert_eq!(settings_of(&training["intrinsic"]["warnings"]), materials);
    for text in [
        "L_normal and normal smoothness do not run: the scene has no normal priors; add priors/normal",
        "L_cross_semantic does not run: no regions; add priors/masks, semantic priors or provider.command",
        "L_relight does not run: no provider of materials; set intrinsic.relight.provider",
    ] {
        assert!(ended.stderr.contains(text), "{text}: {}", ended.stderr);
    }
    let plan = sgs(&arguments(&place, &["plan", "--stage", "all", "--json"], &[])).ok().json();
    assert_eq!(settings_of(&plan["warnings"]), geometry);
    assert_eq!(settings_of(&plan["intrinsic"]["warnings"]), materials);
    // With regions, no warning reports missing regions.
    room_with_masks(&place);
    let plan = sgs(&arguments(&place, &["plan", "--stage", "intrinsic"], &[])).ok().stdout;
    assert!(plan.contains("warning     albedo prior"), "{plan}");
    assert!(!plan.contains("regions;") && !plan.contains("no regions"), "{plan}");
}

fn room_with_masks(place: &Place) {
    Room::default().write_materials(&place.path("scene"));
    for kind in ["albedo", "roughness", "metallic"] {
        std::fs::remove_dir_all(place.path(&format!("scene/priors/{kind}"))).unwrap();
    }
}

/// The log does not depend on interruptions of the training.
#[test]
fn interruption_does_not_change_the_log() {
    let (place, _) = place();
    let gpu = Gpu::new();
    let scene = Scene::open(&place.path("scene"), &SceneOptions::default()).unwrap();
    let splats = Splats::from_points(&scene.points, 0).unwrap();
    let mut s: Settings = settings(14);
    s.intrinsic.environment.every = 4;
    s.intrinsic.losses.own_prior = OwnPrior::Weight(0.5);
    let logged = |training: &mut Intrinsic, until: u32, lines: &mut Vec<String>| {
        let runs = training.logged_losses();
        let report = |r: &sgs_passes::pipeline::IntrinsicReport| {
            lines.push(serde_json::to_string(&IntrinsicLog::of((StageKind::Intrinsic, 0), r, &runs, 1.0)).unwrap());
        };
        training.train(until, report, || true).unwrap();
    };
    let mut whole = Vec::new();
    logged(&mut Intrinsic::new(gpu.device(), &scene, &s, &splats).unwrap(), 14, &mut whole);
    let mut parts = Vec::new();
    let mut training = Intrinsic::new(gpu.device(), &scene, &s, &splats).unwrap();
    logged(&mut training, 8, &mut parts);
    training.save(&place.path("state")).unwrap();
    training = Intrinsic::new(gpu.device(), &scene, &s, &splats).unwrap();
    training.restore(&place.path("state")).unwrap();
    logged(&mut training, 14, &mut parts);
    assert_eq!(whole, parts);
    let last: Value = serde_json::from_str(whole.last().unwrap()).unwrap();
    assert!(last["cross_view"].is_f64() && last["own_prior"].is_f64() && last.get("relight").is_none(), "{last}");
}
