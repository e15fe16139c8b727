//! Exit statuses, and errors as `--json` prints them. `interruptions.rs` tests statuses of interruptions.

use sgs_tests::Place;
use sgs_tests::cli::sgs;
use sgs_tests::rooms::Room;

#[test]
fn invalid_options_settings_and_devices_have_the_usage_status() {
    let place = Place::new(Room::default());
    let (scene, run) = (place.text("scene"), place.text("run"));
    let train = |more: &[&str]| sgs(&[&["train", &scene, "-o", &run], more].concat());
    train(&["--preset", "drafts"]).refused_with(2, &["\"drafts\" is not a preset"]);
    train(&["--accuracy", "exactly"]).refused_with(2, &["no accuracy"]);
    train(&["--set", "geometry.step=3"]).refused_with(2, &["geometry.steps"]);
    train(&["--set", "geometry.steps=-3"]).refused_with(2, &["geometry.steps is -3"]);
    train(&["--set", "nothing"]).refused_with(2, &["KEY=VALUE"]);
    train(&["--scale", "1.5"]).refused_with(2, &["scale"]);
    train(&["--views", "0"]).refused_with(2, &["at least one training view"]);
    train(&["--device", "no such device"]).refused_with(2, &["no such device"]);
    train(&["--start", "a.ply"]).refused_with(2, &["--stage intrinsic"]);
    train(&["--config", &place.text("none.toml")]).refused_with(2, &["none.toml"]);
    sgs(&["ablate", &scene, "-o", &run, "--only", "magic"]).refused_with(2, &["magic"]);
    sgs(&["synth", &run, "--scene", "castle"]).refused_with(2, &["castle"]);
    assert!(!place.path("run").exists());
}

#[test]
fn invalid_inputs_have_their_own_status() {
    let place = Place::new(Room::default());
    let run = place.text("run");
    sgs(&["train", &place.text("none"), "-o", &run]).refused_with(42, &["does not exist"]);
    std::fs::create_dir(place.path("empty")).unwrap();
    sgs(&["train", &place.text("empty"), "-o", &run]).refused_with(42, &["holds no scene"]);
    std::fs::write(place.path("scene/images/002.png"), b"not an image").unwrap();
    sgs(&["train", &place.text("scene"), "-o", &run]).refused_with(42, &["002.png"]);
    std::fs::write(place.path("scene/transforms.json"), b"{").unwrap();
    sgs(&["plan", &place.text("scene")]).refused_with(42, &["transforms.json"]);
    std::fs::write(place.path("a.ply"), b"ply").unwrap();
    let cameras = place.text("scene/transforms.json");
    sgs(&["render", &place.text("a.ply"), "--cameras", &cameras, "-o", &run]).refused_with(42, &["a.ply"]);
    // Inputs that may exist later have the general status.
    sgs(&["eval", &place.text("empty")]).refused_with(1, &["not a run directory"]);
}

#[test]
fn insufficient_memory_and_time_are_retryable_statuses() {
    let place = Place::new(Room::default());
    let arguments = |more: &[&str]| place.arguments("run", 4, more);
    sgs(&arguments(&["--memory-budget", "64K"])).refused_with(75, &["MiB of device memory"]);
    sgs(&arguments(&["--timeout", "0.000000001"])).refused_with(75, &["did not finish within"]);
    assert!(!place.path("run/scene.ply").exists());
}

#[test]
fn errors_are_json_under_the_json_option() {
    let place = Place::new(Room::default());
    let (none, run) = (place.text("none"), place.text("run"));
    let file = place.text("answer.json");
    let scene = place.text("scene");
    for (arguments, status, kind, word) in [
        (vec!["train", &none, "-o", &run], 42, "input", "does not exist"),
        (vec!["train", &scene, "-o", &run, "--preset", "drafts"], 2, "usage", "not a preset"),
        (vec!["train", &scene, "-o", &run, "--steps", "3"], 2, "usage", "--steps"),
        (vec!["frobnicate"], 2, "usage", "frobnicate"),
        (vec!["eval", &none], 1, "failed", "not a run directory"),
        (vec!["train", &scene, "-o", &run, "--memory-budget", "64K"], 75, "out_of_memory", "memory"),
    ] {
        let finished = sgs(&[&arguments[..], &["--json"]].concat());
        assert_eq!(finished.status, Some(status), "{finished:?}");
        let output = finished.json();
        assert_eq!(output["kind"], kind, "{output}");
        assert!(output["error"].as_str().unwrap().contains(word) && finished.stderr.contains(word), "{finished:?}");
        let finished = sgs(&[&arguments[..], &["--json", &file]].concat());
        assert_eq!((finished.status, finished.stdout.as_str()), (Some(status), ""));
        let written: serde_json::Value = serde_json::from_slice(&place.read("answer.json")).unwrap();
        assert_eq!(written, output);
        std::fs::remove_file(&file).unwrap();
    }
}

#[test]
fn step_option_aliases_suggest_the_right_name() {
    for option in ["--iterations", "--steps"] {
        let finished = sgs(&["train", "scene", "-o", "run", option, "30000"]);
        assert_eq!(finished.status, Some(2));
        assert!(finished.stderr.contains("--geometry-steps N, --intrinsic-steps N"), "{}", finished.stderr);
    }
}
