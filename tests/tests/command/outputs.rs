//! Output directories of commands: a wrong `-o` overwrites no result, scene or foreign file. Only one training at a
//! time writes into a run.

use sgs_tests::cli::{Finished, sgs, signal, start, until, wait};
use sgs_tests::rooms::Room;
use sgs_tests::{Place, files};

/// Creates a place with a room that has priors.
fn place() -> Place {
    Place::new(Room { priors: true, ..Room::default() })
}

fn arguments(place: &Place, run: &str, more: &[&str]) -> Vec<String> {
    let (scene, to) = (place.text("scene"), place.text(run));
    let fixed = ["train", &scene, "-o", &to, "-q", "--geometry-steps", "3", "--no-densify", "--intrinsic-steps", "2"];
    let small = [
        "transport.surfels=0",
        "intrinsic.environment.resolution=16",
        "intrinsic.lights.grid=2",
        "intrinsic.visibility.levels=2",
        "intrinsic.visibility.log2_table=8",
    ];
    let sets = small.iter().flat_map(|pair| ["--set", pair]);
    fixed.into_iter().chain(sets).chain(more.iter().copied()).map(str::to_owned).collect()
}

fn train(place: &Place, run: &str, more: &[&str]) -> Finished {
    sgs(&arguments(place, run, more))
}

#[test]
fn a_finished_run_is_replaced_only_by_force() {
    let place = place();
    train(&place, "run", &[]).ok();
    let run = place.path("run");
    let before = files(&run);
    assert!(!before.keys().any(|file| file.ends_with(".lock")), "the lock stays");
    train(&place, "run", &["--seed", "1"]).refused_with(2, &["holds a finished run", "--resume", "--force"]);
    train(&place, "run", &["--stage", "all"]).refused_with(2, &["holds a finished run"]);
    let start = place.text("run/scene.ply");
    train(&place, "run", &["--stage", "intrinsic", "--start", &start]).refused_with(2, &["holds a finished run"]);
    assert!(files(&run) == before, "a refused training changed the run");
    train(&place, "run", &["--seed", "1", "--force"]).ok();
    assert!(place.read("run/scene.ply") != before[&run.join("scene.ply")]);
    assert_eq!(train(&place, "run", &["--force", "--resume"]).status, Some(2));
    // A run that was interrupted is protected as well.
    std::fs::remove_file(run.join("training.json")).unwrap();
    train(&place, "run", &[]).refused_with(2, &["holds an unfinished run", "--resume"]);
}

#[test]
fn materials_are_trained_on_the_geometry_of_a_run_once() {
    let place = place();
    train(&place, "run", &[]).ok();
    train(&place, "run", &["--stage", "intrinsic"]).ok();
    let before = files(&place.path("run"));
    train(&place, "run", &["--stage", "intrinsic"]).refused_with(2, &["has materials", "--resume", "--force"]);
    train(&place, "run", &[]).refused_with(2, &["holds a finished run"]);
    assert!(files(&place.path("run")) == before);
    train(&place, "run", &["--stage", "intrinsic", "--force", "--set", "intrinsic.losses.dssim=0.5"]).ok();
    let [lights, geometry] =
        ["lights.json", "checkpoint/geometry.safetensors"].map(|file| place.path("run").join(file));
    assert!(
        std::fs::read(&lights).unwrap() != before[&lights] && std::fs::read(&geometry).unwrap() == before[&geometry]
    );
}

#[test]
fn resuming_a_finished_run_leaves_every_file() {
    let place = place();
    train(&place, "run", &["--stage", "all"]).ok();
    let (scene, run) = (place.text("scene"), place.text("run"));
    let before = files(&place.path("run"));
    for stage in ["all", "intrinsic"] {
        let resumed = sgs(&["train", &scene, "-o", &run, "--resume", "--stage", stage, "--json"]).ok();
        assert!(resumed.stderr.contains("nothing to do"), "{}", resumed.stderr);
        assert!(resumed.json()["seconds"].as_f64().unwrap() > 0.0);
        assert!(files(&place.path("run")) == before, "--stage {stage} changed the run");
    }
    // Completed geometry is not trained again for incomplete materials.
    train(&place, "half", &[]).ok();
    let geometry = place.read("half/training.json");
    train(&place, "half", &["--stage", "all", "--resume"]).ok();
    let [before, after]: [serde_json::Value; 2] =
        [geometry, place.read("half/training.json")].map(|text| serde_json::from_slice(&text).unwrap());
    assert_eq!((&before["seconds"], after["intrinsic"]["steps"].as_u64()), (&after["seconds"], Some(2)));
}

#[test]
fn invalid_output_directories_are_refused() {
    let place = place();
    let before = files(&place.path("scene"));
    std::fs::create_dir(place.path("notes")).unwrap();
    std::fs::write(place.path("notes/diary.txt"), "a day").unwrap();
    std::fs::write(place.path("file"), "").unwrap();
    let ply = place.path("one.ply");
    train(&place, "run", &[]).ok();
    std::fs::copy(place.path("run/scene.ply"), &ply).unwrap();
    let (scene, ply, cameras) = (place.text("scene"), ply.display().to_string(), place.text("scene/transforms.json"));
    for force in [&[][..], &["--force"]] {
        train(&place, "scene", force).refused_with(2, &["is a scene"]);
        train(&place, "notes", force).refused_with(2, &["diary.txt", "name a new or an empty directory"]);
        train(&place, "file", force).refused_with(2, &["is a file"]);
        let render =
            |to: &str| sgs(&[&["render", &ply, "--cameras", &cameras, "-o", &place.text(to), "-q"], force].concat());
        render("scene").refused_with(2, &["is a scene"]);
        render("run").refused_with(2, &["is a run"]);
        render("file").refused_with(2, &["is a file"]);
        let table = |to: &str| {
            let to = place.text(to);
            sgs(&[&["ablate", &scene, "-o", &to, "-q", "--seeds", "1", "--geometry-steps", "1"], force].concat())
        };
        table("scene").refused_with(2, &["is a scene"]);
        table("run").refused_with(2, &["is a run"]);
        table("notes").refused_with(2, &["diary.txt"]);
        if force.is_empty() {
            render("notes").refused_with(2, &["diary.txt", "--force"]);
            sgs(&["synth", &scene, "--scene", "box"]).refused_with(2, &["already holds something", "--force"]);
        } else {
            render("notes").ok();
            sgs(&["synth", &place.text("notes"), "--scene", "box", "--force"])
                .refused_with(2, &["is no scene directory"]);
        }
    }
    // Images may overwrite images.
    for _ in 0..2 {
        sgs(&["render", &ply, "--cameras", &cameras, "-o", &place.text("images"), "-q"]).ok();
    }
    assert!(files(&place.path("scene")) == before, "the scene has changed");
    assert_eq!(std::fs::read_to_string(place.path("notes/diary.txt")).unwrap(), "a day");
    assert_eq!(std::fs::read_to_string(place.path("file")).unwrap(), "");
}

#[test]
fn one_training_at_a_time_writes_into_a_run() {
    let place = place();
    let mut child = start(&place.arguments("run", 80, &[]));
    assert!(until(&mut child, || place.logged("run").last() >= Some(&10)), "it was too fast");
    let process = format!("process {}", child.id());
    let second = |more: &[&str]| sgs(&place.arguments("run", 80, more));
    second(&["--force"]).refused_with(1, &["is locked", &process]);
    second(&["--resume"]).refused_with(1, &["is locked", &process]);
    let output = second(&["--force", "--json"]).json();
    assert_eq!(output["kind"], "locked");
    assert!(output["error"].as_str().unwrap().contains(&process), "{output}");
    // A killed training leaves its lock, and the next training takes the lock over.
    signal(&child, "KILL");
    wait(child);
    assert!(place.path("run/.lock").is_file());
    let resumed = place.resume("run").ok();
    assert!(resumed.stderr.contains("was still locked by") && resumed.stderr.contains(&process), "{}", resumed.stderr);
    assert!(!place.path("run/.lock").exists());
    sgs(&place.arguments("straight", 80, &[])).ok();
    place.assert_same("straight", "run");
}

#[test]
fn a_table_replaces_runs_with_other_settings_only_by_force() {
    let place = place();
    let (scene, to) = (place.text("scene"), place.text("table"));
    let ablate = |more: &[&str]| {
        let fixed = ["ablate", &scene, "-o", &to, "-q", "--seeds", "1", "--no-densify", "--only", "rgb"];
        sgs(&[&fixed, more].concat())
    };
    ablate(&["--geometry-steps", "2"]).ok();
    let before = place.read("table/rgb_seed0/scene.ply");
    ablate(&["--geometry-steps", "3"]).refused_with(2, &["rgb_seed0", "other settings", "--force"]);
    assert!(place.read("table/rgb_seed0/scene.ply") == before);
    ablate(&["--geometry-steps", "2"]).ok();
    ablate(&["--geometry-steps", "3", "--force"]).ok();
    assert!(place.read("table/rgb_seed0/scene.ply") != before);
}
