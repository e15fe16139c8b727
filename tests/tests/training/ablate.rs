//! `sgs ablate`: variants over seeds, the table of results, and resuming.

use serde_json::Value;
use sgs_tests::Place;
use sgs_tests::cli::{Finished, sgs, signal, start, until, wait};
use sgs_tests::meaning::Meaning;
use sgs_tests::rooms::{Room, write_json};
use std::time::SystemTime;

/// Names of the runs: three variants and two seeds, in a room with normal priors.
const RUNS: [&str; 6] = ["rgb_seed5", "depth_seed5", "normal_seed5", "rgb_seed6", "depth_seed6", "normal_seed6"];

fn room() -> Place {
    Place::new(Room { priors: true, truth: true, ..Room::default() })
}

fn arguments(place: &Place, steps: &str, more: &[&str]) -> Vec<String> {
    let (scene, table) = (place.text("scene"), place.text("table"));
    let fixed = ["ablate", &scene, "-o", &table, "--seed", "5", "--seeds", "2", "--geometry-steps", steps];
    fixed.iter().chain(more).map(|s| (*s).to_owned()).collect()
}

fn ablate(place: &Place, more: &[&str]) -> Finished {
    sgs(&arguments(place, "3", &[&["--no-densify"], more].concat()))
}

fn json(place: &Place, name: &str) -> Value {
    serde_json::from_slice(&place.read(name)).unwrap()
}

/// Returns the times when the splats of each run were written.
fn trained(place: &Place) -> Vec<SystemTime> {
    RUNS.iter()
        .map(|run| place.path(&format!("table/{run}/scene.ply")).metadata().unwrap().modified().unwrap())
        .collect()
}

#[test]
fn ablation_table_holds_means_and_spreads() {
    let place = room();
    let markdown = ablate(&place, &["-q"]).ok().stdout;
    assert_eq!(markdown.as_bytes(), place.read("table/ablation.md"));
    let table = json(&place, "table/ablation.json");
    assert_eq!(ablate(&place, &["--json", "-q"]).ok().json(), table);
    assert_eq!(table["steps"], 3);
    for (i, variant) in ["rgb", "depth", "normal"].into_iter().enumerate() {
        let row = &table["variants"][i];
        assert_eq!(row["name"], variant);
        let measured: Vec<Value> =
            [5, 6].map(|seed| json(&place, &format!("table/{variant}_seed{seed}/metrics.json"))).to_vec();
        let values = |path: &str| [0, 1].map(|k| measured[k].pointer(path).unwrap().as_f64().unwrap());
        for (key, path) in [("psnr", "/test/mean/nvs/psnr"), ("normal_mae_deg", "/test/mean/normal_mae_deg")] {
            let [a, b] = values(path);
            let near = |found: &Value, expected: f64| assert!((found.as_f64().unwrap() - expected).abs() < 1e-9);
            near(&row["mean"][key], 0.5 * (a + b));
            near(&row["deviation"][key], (a - b).abs() / 2.0_f64.sqrt());
            assert!(a != b, "seeds make no difference to {key}");
        }
        let rate = values("/steps_per_second");
        let seconds = row["runs"][0]["seconds_per_step"].as_f64().unwrap();
        assert!((seconds * rate[0] - 1.0).abs() < 1e-9 && row["mean"]["accuracy"].is_null());
        assert_eq!(row["runs"][1]["folder"], format!("{variant}_seed6"));
        assert!(markdown.lines().any(|l| l.starts_with(&format!("| {variant}: ")) && l.contains(" ± ")), "{markdown}");
    }
    assert!(!markdown.contains("aligned"), "nothing was learned of the views: {markdown}");
    // The variants differ in their inputs and equal separate trainings.
    let rgb = place.read("table/rgb_seed5/scene.ply");
    assert_ne!(rgb, place.read("table/normal_seed5/scene.ply"));
    assert_ne!(rgb, place.read("table/depth_seed5/scene.ply"));
    let off = ["normals=false", "losses.depth_smooth=0", "losses.depth_variance=0", "losses.correspondence=0"];
    let off = off.map(|what| format!("geometry.{what}"));
    let off = off.iter().flat_map(|set| ["--set", set]);
    let fixed: Vec<&str> = ["--geometry-steps", "3", "--no-densify", "--seed", "5"].into_iter().chain(off).collect();
    sgs(&[&["train", &place.text("scene"), "-o", &place.text("alone")], &fixed[..]].concat()).ok();
    assert!(rgb == place.read("alone/scene.ply"), "the run is not that of the same settings");
}

/// Runs are measured with their learned lens, and after alignment of cameras, too.
#[test]
fn learned_cameras_have_aligned_measures() {
    let place = room();
    let markdown =
        ablate(&place, &["-q", "--only", "rgb", "--set", "geometry.rates.views=[1e-3, 0, 1e-3, 0]"]).ok().stdout;
    assert!(markdown.contains("| PSNR, dB ↑ | PSNR, aligned, dB ↑ | SSIM ↑ | SSIM, aligned ↑ |"), "{markdown}");
    let table = json(&place, "table/ablation.json");
    let row = &table["variants"][0];
    let measured = [5, 6].map(|seed| json(&place, &format!("table/rgb_seed{seed}/metrics.json")));
    for key in ["psnr", "psnr_aligned", "ssim", "ssim_aligned"] {
        let values = [0, 1].map(|i| measured[i]["test"]["mean"]["nvs"][key].as_f64().unwrap());
        assert_eq!([0, 1].map(|i| row["runs"][i][key].as_f64().unwrap()), values, "{key}");
        assert!((row["mean"][key].as_f64().unwrap() - 0.5 * (values[0] + values[1])).abs() < 1e-9, "{key}");
    }
    let again = sgs(&["eval", &place.text("table/rgb_seed5"), "--json"]).ok().json();
    assert_eq!(again["mean"]["nvs"], measured[0]["test"]["mean"]["nvs"]);
}

/// Every term is added once and left out once on a room with all priors.
///
/// Variants with the same settings share a run. Other variants give different splats. Class accuracy is measured.
#[test]
fn every_term_is_a_variant() {
    let room = Room { priors: true, truth: true, ..Room::default() };
    let place = Place::new(room);
    Meaning::default().write(&room, &place.path("scene"));
    let (scene, out) = (place.text("scene"), place.text("table"));
    let fixed = ["ablate", &scene, "-o", &out, "--seeds", "1", "--geometry-steps", "6", "--no-densify", "-q"];
    let from = |step: u32| format!("geometry.correspondence_from={step}");
    // A term that never starts would equal the variant before it.
    let output = sgs(&[&fixed[..8], &["--no-densify", "--set", &from(7)]].concat()).ok();
    assert!(output.stderr.contains("\"correspondence\" is left out: it begins at step 7 of 6"), "{}", output.stderr);
    let only = ["--only", "correspondence", "--set", &from(7)];
    sgs(&[&fixed[..], &only[..]].concat()).refused(&["\"correspondence\" would differ from no other", "step 7 of 6"]);
    std::fs::remove_dir_all(place.path("table")).unwrap();
    sgs(&[&fixed[..], &["--set", &from(3)]].concat()).ok();
    let table = json(&place, "table/ablation.json");
    let names: Vec<_> = table["variants"].as_array().unwrap().iter().map(|v| v["name"].as_str().unwrap()).collect();
    let added = ["rgb", "depth", "normal", "semantic", "correspondence"];
    let left_out = ["no_normal", "no_depth", "no_semantic", "no_correspondence"];
    assert_eq!(names, [&added[..], &left_out[..]].concat());
    let folder = |i: usize| table["variants"][i]["runs"][0]["folder"].as_str().unwrap();
    for (i, name) in names.iter().enumerate() {
        let accuracy = &table["variants"][i]["mean"]["accuracy"];
        let classes = !["rgb", "depth", "normal", "no_semantic"].contains(name);
        assert_eq!(accuracy.is_f64(), classes, "{name}: {accuracy}");
        let ply = |i: usize| place.read(&format!("table/{}/scene.ply", folder(i)));
        (0..i).for_each(|j| assert_eq!(ply(i) == ply(j), folder(i) == folder(j), "{name} and {}", names[j]));
    }
    assert_eq!((folder(7), folder(8)), ("normal_seed0", "semantic_seed0"));
    let text = String::from_utf8(place.read("table/ablation.md")).unwrap();
    assert!(text.contains("labels right") && text.contains("| rgb: photographs alone | 1 |"), "{text}");
}

#[test]
fn finished_runs_are_not_repeated() {
    let place = room();
    ablate(&place, &["-q"]).ok();
    let table = place.read("table/ablation.json");
    let first = trained(&place);
    let log = ablate(&place, &[]).ok().stderr;
    assert!(!log.contains(", seed "), "something was done again: {log}");
    assert!(trained(&place) == first && place.read("table/ablation.json") == table);
    // A run without metrics is evaluated, not retrained. A run whose settings file is missing or changed is retrained.
    std::fs::remove_file(place.path("table/rgb_seed5/metrics.json")).unwrap();
    ablate(&place, &["-q"]).ok();
    assert!(trained(&place) == first && place.read("table/ablation.json") == table);
    std::fs::remove_file(place.path("table/normal_seed5/config.toml")).unwrap();
    ablate(&place, &["-q"]).ok();
    let again: Vec<bool> = trained(&place).iter().zip(&first).map(|(a, b)| a != b).collect();
    assert_eq!(again, [false, false, true, false, false, false]);
    // `--only` retains the other rows of the table. Changed settings drop all of them.
    ablate(&place, &["-q", "--only", "rgb"]).ok();
    assert_eq!(json(&place, "table/ablation.json")["variants"].as_array().unwrap().len(), 3);
    ablate(&place, &["-q", "--force", "--only", "rgb", "--set", "geometry.losses.dssim=0.5"]).ok();
    let table = json(&place, "table/ablation.json");
    assert_eq!(table["variants"].as_array().unwrap().len(), 1);
    assert_eq!(table["variants"][0]["runs"].as_array().unwrap().len(), 2);
    let config = String::from_utf8(place.read("table/rgb_seed6/config.toml")).unwrap();
    assert!(config.contains("dssim = 0.5") && config.contains("seed = 6") && config.contains("normals = false"));
}

#[test]
fn interrupted_ablation_resumes() {
    let place = room();
    let more = ["--seeds", "1", "--no-densify", "--set", "train.checkpoint_interval=10"];
    let long: Vec<String> =
        arguments(&place, "60", &more[2..]).into_iter().map(|a| if a == "2" { "1".to_owned() } else { a }).collect();
    let mut child = start(&long);
    let reached = until(&mut child, || place.logged("table/normal_seed5").last().is_some_and(|s| *s >= 20));
    signal(&child, "INT");
    let stopped = wait(child);
    assert!(reached && stopped.status == Some(130), "{stopped:?}");
    assert!(stopped.stderr.contains("stopped in") && stopped.stderr.contains("normal_seed5"), "{stopped:?}");
    let half = json(&place, "table/ablation.json");
    assert_eq!(half["variants"].as_array().unwrap().len(), 2, "what is done is in the table");
    sgs(&long).ok();
    let table = json(&place, "table/ablation.json");
    let timed = [0, 1, 2].map(|i| table["variants"][i]["mean"]["seconds_per_step"].is_f64());
    assert_eq!(timed, [true, true, false], "what was interrupted has no time of its own");
    let logged = place.logged("table/normal_seed5");
    assert!(logged.contains(&10) && logged.last() == Some(&60), "{logged:?}");
    let whole = ["train", &place.text("scene"), "-o", &place.text("whole"), "--config"].map(str::to_owned);
    sgs(&[&whole[..], &[place.text("table/normal_seed5/config.toml")]].concat()).ok();
    place.assert_same("table/normal_seed5", "whole");
}

#[test]
fn invalid_ablations_are_refused() {
    let place = Place::new(Room::default());
    ablate(&place, &["--only", "rgb,magic"]).refused(&["no variant \"magic\"", "there are rgb, depth, normal"]);
    ablate(&place, &["--only", "normal"]).refused(&["\"normal\" would differ from no other", "no priors/normal"]);
    ablate(&place, &["--set", "geometry.stepz=1"]).refused(&["geometry.steps"]);
    assert!(!place.path("table").exists(), "a refused table leaves nothing");
    assert_eq!(sgs(&arguments(&place, "3", &["--seeds", "0"])).status, Some(2));
    // Without priors, photographs and depth terms remain.
    let left = ablate(&place, &["--seed", "7"]);
    assert_eq!(left.status, Some(2), "a seed twice");
    let left = ablate(&place, &[]).ok();
    assert!(left.stderr.contains("\"normal\" is left out") && left.stderr.contains("priors/normal"), "{left:?}");
    assert_eq!(json(&place, "table/ablation.json")["variants"].as_array().unwrap().len(), 2);
    let split = serde_json::json!({"train": ["000", "001", "002"], "test": []});
    write_json(&place.path("scene/split.json"), &split);
    ablate(&place, &[]).refused(&["no test views", "split.json"]);
}

/// Returns the number of processes that a run was trained by.
fn processes(place: &Place, row: &str, seed: u64) -> usize {
    let log = place.read(&format!("table/batch/runs/scene/{row}/seed{seed}.log"));
    String::from_utf8(log).unwrap().lines().filter(|line| line.starts_with("$ ")).count()
}

/// Two commands with two jobs each train a table together: each run once, with the results of one job.
#[test]
fn commands_share_a_table() {
    let place = room();
    let both = arguments(&place, "3", &["--no-densify", "--jobs", "2"]);
    let commands = [start(&both), start(&both)];
    for command in commands {
        let ended = wait(command);
        assert_eq!(ended.status, Some(0), "{ended:?}");
    }
    for (row, seed) in ["rgb", "depth", "normal"].into_iter().flat_map(|row| [(row, 5), (row, 6)]) {
        assert_eq!(processes(&place, row, seed), 1, "{row} {seed}");
    }
    let shared = json(&place, "table/ablation.json");
    let splats = RUNS.map(|run| place.read(&format!("table/{run}/scene.ply")));
    assert_eq!(shared["variants"].as_array().unwrap().len(), 3);
    assert!(shared["variants"].as_array().unwrap().iter().all(|row| row["runs"].as_array().unwrap().len() == 2));
    std::fs::remove_dir_all(place.path("table")).unwrap();
    ablate(&place, &["-q"]).ok();
    assert!(splats == RUNS.map(|run| place.read(&format!("table/{run}/scene.ply"))), "jobs change the results");
    // The folder of the batch belongs to the table.
    sgs(&["batch", "none.toml", "-o", &place.text("table")]).refused(&["none.toml"]);
    let folder = place.path("table/batch/leases");
    assert_eq!(std::fs::read_dir(folder).unwrap().count(), 0, "a lease is left");
}

/// A row that fails does not end the others. It is trained again by the next command.
#[test]
fn failed_rows_leave_the_others() {
    let place = room();
    let prior = std::fs::read_dir(place.path("scene/priors/normal")).unwrap().next().unwrap().unwrap().path();
    let before = std::fs::read(&prior).unwrap();
    std::fs::write(&prior, "no image").unwrap();
    let failed = ablate(&place, &["--json"]);
    assert_eq!(failed.status, Some(42), "{failed:?}");
    assert_eq!(failed.json()["kind"], "input");
    let error = failed.json()["error"].as_str().unwrap().to_owned();
    assert!(error.contains("2 of 6 runs failed; the first, normal, seed 5: "), "{error}");
    assert!(failed.stderr.contains("done 1 of 6: rgb, seed 5"), "{}", failed.stderr);
    let names =
        |table: &Value| table["variants"].as_array().unwrap().iter().map(|v| v["name"].clone()).collect::<Vec<_>>();
    assert_eq!(names(&json(&place, "table/ablation.json")), ["rgb", "depth"]);
    std::fs::write(&prior, before).unwrap();
    let log = ablate(&place, &[]).ok().stderr;
    assert!(log.contains("done 2 of 2: normal, seed 6"), "{log}");
    assert_eq!(names(&json(&place, "table/ablation.json")), ["rgb", "depth", "normal"]);
}
