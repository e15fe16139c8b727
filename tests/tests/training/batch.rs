//! Batches: `sgs batch` over several scenes, kills, several commands at once, failures and refusals.

use serde_json::Value;
use sgs_tests::cli::{Finished, sgs, signal, start, until, wait};
use sgs_tests::files;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// Settings that give the same bits on each attempt, and are quick.
const SETTINGS: &str = "geometry = { backward = \"pixel\", steps = STEPS, sh_degree = 0, densify = { until = 0.0 } }, \
     train = { checkpoint_interval = 5 }";

/// Folder with tiny scenes and a manifest.
pub struct Rooms(TempDir);

impl Rooms {
    /// Synthesizes rooms that differ in their images.
    pub fn new(names: &[&str]) -> Rooms {
        let rooms = Rooms(tempfile::tempdir().unwrap());
        for (i, name) in names.iter().enumerate() {
            let seed = i.to_string();
            let scene = rooms.text(&format!("scenes/{name}"));
            sgs(&["synth", &scene, "--scene", "box", "--views", "8", "--size", "32x24", "--seed", &seed]).ok();
        }
        rooms
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    pub fn text(&self, name: &str) -> String {
        self.path(name).display().to_string()
    }

    /// Writes a manifest of all scenes with two seeds.
    pub fn manifest(&self, steps: u32) {
        let settings = SETTINGS.replace("STEPS", &steps.to_string());
        let text = format!(
            "scenes = [\"scenes/*\"]\nseeds = [0, 1]\n[[variants]]\nname = \"tiny\"\nsettings = {{ {settings} }}\n"
        );
        std::fs::write(self.path("rooms.toml"), text).unwrap();
    }

    pub fn arguments(&self, more: &[&str]) -> Vec<String> {
        let all = ["batch", &self.text("rooms.toml"), "-o", &self.text("out"), "-q"];
        all.iter().chain(more).map(|s| (*s).to_owned()).collect()
    }

    pub fn batch(&self, more: &[&str]) -> Finished {
        sgs(&self.arguments(more))
    }

    /// Returns the lines of the summary by name of the run.
    pub fn summary(&self) -> BTreeMap<String, Value> {
        let text = std::fs::read_to_string(self.path("out/summary.jsonl")).unwrap();
        let lines = text.lines().map(|l| serde_json::from_str::<Value>(l).unwrap());
        let name = |l: &Value| format!("{}/tiny/seed{}", l["scene"].as_str().unwrap(), l["seed"]);
        lines.map(|l| (name(&l), l)).collect()
    }

    /// Trains a run alone, with the same options. Returns the bytes of its Gaussians.
    pub fn alone(&self, scene: &str, seed: u64) -> Vec<u8> {
        let (scene, run, seed) = (self.text(&format!("scenes/{scene}")), self.text("alone"), seed.to_string());
        let configs = std::fs::read_dir(self.path("out/variants")).unwrap().map(|e| e.unwrap().path());
        let config = configs.map(|p| p.display().to_string()).max().unwrap();
        sgs(&["train", &scene, "-o", &run, "--config", &config, "--seed", &seed, "--force"]).ok();
        std::fs::read(self.path("alone/scene.ply")).unwrap()
    }

    pub fn gaussians(&self, run: &str) -> Vec<u8> {
        std::fs::read(self.path(&format!("out/runs/{run}/scene.ply"))).unwrap()
    }

    pub fn leases(&self) -> usize {
        std::fs::read_dir(self.path("out/leases")).unwrap().count()
    }
}

#[test]
fn all_runs_are_trained_once_and_measured() {
    let rooms = Rooms::new(&["kitchen", "bath"]);
    rooms.manifest(5);
    let answer = rooms.batch(&["--json", "--jobs", "2"]).ok().json();
    let counts = ["runs", "done", "skipped"].map(|key| answer[key].as_u64().unwrap());
    assert_eq!(counts, [4, 4, 0], "{answer}");
    let summary = rooms.summary();
    let names: Vec<_> = summary.keys().map(String::as_str).collect();
    assert_eq!(names, ["bath/tiny/seed0", "bath/tiny/seed1", "kitchen/tiny/seed0", "kitchen/tiny/seed1"]);
    for (name, line) in &summary {
        let metrics = std::fs::read(rooms.path(&format!("out/runs/{name}/metrics.json"))).unwrap();
        let metrics: Value = serde_json::from_slice(&metrics).unwrap();
        let psnr = metrics["test"]["mean"]["nvs"]["psnr"].as_f64().unwrap();
        assert_eq!(line["measures"]["nvs.psnr"].as_f64(), Some(psnr), "{line}");
        assert_eq!((&line["state"], &line["attempts"]), (&"done".into(), &1.into()), "{line}");
        assert!(line["gaussians"].as_u64() > Some(0) && line["device"].is_string(), "{line}");
        let log = std::fs::read_to_string(rooms.path(&format!("out/runs/{name}.log"))).unwrap();
        assert!(log.starts_with("$ ") && log.lines().next().unwrap().contains(" train "), "{log}");
    }
    for scene in ["kitchen", "bath"] {
        assert!(rooms.gaussians(&format!("{scene}/tiny/seed1")) == rooms.alone(scene, 1), "{scene} differs");
    }
    assert!(rooms.gaussians("kitchen/tiny/seed0") != rooms.gaussians("kitchen/tiny/seed1"));
    assert!(rooms.gaussians("kitchen/tiny/seed0") != rooms.gaussians("bath/tiny/seed0"));
    assert_eq!(rooms.leases(), 0);

    // The same command again changes nothing.
    let before = files(&rooms.path("out"));
    let answer = rooms.batch(&["--json"]).ok().json();
    assert_eq!((answer["skipped"].as_u64(), answer["done"].as_u64()), (Some(4), Some(0)));
    assert!(files(&rooms.path("out")) == before, "a second call changed files");

    // The gate passes on equal results, and fails on a better baseline.
    let baseline = rooms.text("out/summary.jsonl");
    rooms.batch(&["--baseline", &baseline]).ok();
    let better = std::fs::read_to_string(&baseline).unwrap().lines().next().unwrap().to_owned();
    let mut better: Value = serde_json::from_str(&better).unwrap();
    better["measures"]["nvs.psnr"] = 99.0.into();
    std::fs::write(rooms.path("better.jsonl"), better.to_string()).unwrap();
    let better = rooms.text("better.jsonl");
    rooms.batch(&["--baseline", &better]).refused_with(1, &["/tiny/seed0 has nvs.psnr", "below the baseline's 99.00"]);

    // One byte of a scene trains its runs again, and no other.
    let image = std::fs::read_dir(rooms.path("scenes/bath/images")).unwrap().next().unwrap().unwrap().path();
    let mut pixels = image::open(&image).unwrap().to_rgb8();
    pixels.get_pixel_mut(3, 3).0[0] ^= 0x80;
    pixels.save(&image).unwrap();
    let answer = rooms.batch(&["--json"]).ok().json();
    assert_eq!((answer["skipped"].as_u64(), answer["done"].as_u64()), (Some(2), Some(2)));
    assert!(rooms.gaussians("bath/tiny/seed1") == rooms.alone("bath", 1), "the changed scene was not trained again");
}

/// Kills the supervisor in the middle. Its process ends by itself; the next command ends with the same bits.
#[test]
fn killed_batch_goes_on_with_the_same_bits() {
    let rooms = Rooms::new(&["kitchen"]);
    rooms.manifest(150);
    let logged = |seed: u32| {
        let log = rooms.path(&format!("out/runs/kitchen/tiny/seed{seed}/log.jsonl"));
        std::fs::read_to_string(log).unwrap_or_default().lines().count()
    };
    let mut child = start(&rooms.arguments(&["--jobs", "1"]));
    assert!(until(&mut child, || logged(0) > 2), "it ended before it was killed");
    signal(&child, "KILL");
    assert_eq!(wait(child).status, None);
    assert_eq!(rooms.leases(), 1, "the lease of the killed command stays");
    // Interrupts the next one while it trains the second run.
    let mut child = start(&rooms.arguments(&["--jobs", "1"]));
    assert!(until(&mut child, || logged(1) > 2), "it ended before it was interrupted");
    signal(&child, "TERM");
    wait(child).refused_with(75, &["stopped in", "the same command goes on"]);
    rooms.batch(&["--jobs", "1"]).ok();
    let summary = rooms.summary();
    let attempts: Vec<_> = summary.values().map(|l| l["attempts"].as_u64().unwrap()).collect();
    assert!(summary.len() == 2 && attempts.iter().all(|n| *n == 2), "{attempts:?}");
    assert_eq!(rooms.leases(), 0);
    for seed in [0, 1] {
        let name = format!("kitchen/tiny/seed{seed}");
        let log = std::fs::read_to_string(rooms.path(&format!("out/runs/{name}.log"))).unwrap();
        assert!(log.contains("--resume"), "{log}");
        assert!(rooms.gaussians(&name) == rooms.alone("kitchen", seed), "{name} differs from a run alone");
    }
}

#[test]
fn commands_over_one_directory_share_the_runs() {
    let rooms = Rooms::new(&["kitchen", "bath", "hall"]);
    rooms.manifest(5);
    let commands: Vec<_> = (0..2).map(|_| start(&rooms.arguments(&["--json"]))).collect();
    let answers: Vec<Value> = commands.into_iter().map(|c| wait(c).ok().json()).collect();
    assert!(answers.iter().all(|a| a["runs"] == 6), "{answers:?}");
    let summary = rooms.summary();
    assert_eq!(summary.len(), 6);
    for (name, line) in summary {
        assert_eq!((&line["state"], &line["attempts"]), (&"done".into(), &1.into()), "{line}");
        let log = std::fs::read_to_string(rooms.path(&format!("out/runs/{name}.log"))).unwrap();
        assert_eq!(log.lines().filter(|l| l.starts_with("$ ")).count(), 2, "trained or measured twice: {log}");
    }
    assert_eq!((std::fs::read_dir(rooms.path("out/results")).unwrap().count(), rooms.leases()), (6, 0));
}

/// Cuts an image, but keeps its header.
fn truncate(scene: &Path) {
    let image = std::fs::read_dir(scene.join("images")).unwrap().next().unwrap().unwrap().path();
    let bytes = std::fs::read(&image).unwrap();
    std::fs::write(&image, &bytes[..bytes.len() / 2]).unwrap();
}

#[test]
fn failing_scene_is_recorded_and_others_are_done() {
    let rooms = Rooms::new(&["kitchen", "broken"]);
    truncate(&rooms.path("scenes/broken"));
    rooms.manifest(5);
    let refused = rooms.batch(&[]);
    refused.refused_with(1, &["2 of 4 runs failed", "broken/tiny/seed0"]);
    let summary = rooms.summary();
    let states: Vec<_> = summary.values().map(|l| l["state"].as_str().unwrap()).collect();
    assert_eq!(states, ["failed", "failed", "done", "done"]);
    let first = &summary["broken/tiny/seed0"];
    assert!(first["attempts"] == 1 && first["error"].as_str().is_some_and(|e| e.contains("images")), "{first}");
    let page = std::fs::read_to_string(rooms.path("out/summary.md")).unwrap();
    assert!(page.contains("## Failures") && page.contains("- broken/tiny/seed0 ("), "{page}");
    assert!(rooms.path("out/summary.html").is_file());
    // The failed runs stay as they are, unless they are requested.
    rooms.batch(&[]).refused_with(1, &["2 of 4 runs failed"]);
    assert_eq!(rooms.summary()["broken/tiny/seed0"]["attempts"], 1);
    rooms.batch(&["--retry-failed", "--shard", "1/2"]).refused_with(1, &["1 of 2 runs failed"]);
    let attempts = ["seed0", "seed1"].map(|s| rooms.summary()[&format!("broken/tiny/{s}")]["attempts"].clone());
    assert_eq!(attempts, [Value::from(2), Value::from(1)]);
}

#[test]
fn wrong_manifests_are_refused_and_write_nothing() {
    let rooms = Rooms::new(&["kitchen"]);
    let refused = |text: &str, words: &[&str]| {
        std::fs::write(rooms.path("rooms.toml"), text).unwrap();
        for json in [&[][..], &["--json"]] {
            rooms.batch(json).refused_with(2, words);
        }
        assert!(!rooms.path("out").exists(), "a refused manifest made a directory");
    };
    refused("scenes = [\"scenes/k*\"]\nsteps = 3", &["rooms.toml", "unknown field `steps`"]);
    refused("scenes = [\"scenes/x*\"]", &["matches no scene"]);
    refused("scenes = [\"nowhere\"]", &["\"nowhere\" is no scene"]);
    refused("scenes = [\"scenes/*\"]\nstage = \"intrinsic\"", &["needs trained geometry"]);
    let wrong = "scenes = [\"scenes/*\"]\n[[variants]]\nname = \"a\"\nsettings = { geometry = { step = 3 } }";
    refused(wrong, &["variant \"a\"", "did you mean \"geometry.steps\"?"]);
    rooms.manifest(3);
    for (more, words) in [
        (&["--shard", "3/2"][..], "is no shard"),
        (&["--jobs", "0"], "0"),
        (&["--tolerance", "1"], "--baseline"),
        (&["--baseline", "none.jsonl"], "none.jsonl"),
    ] {
        let refused = rooms.batch(more);
        assert!(refused.status == Some(2) && refused.stderr.contains(words), "{refused:?}");
        assert!(!rooms.path("out").exists());
    }
    // Neither a scene nor another program's files are written into.
    let scene = rooms.text("scenes/kitchen");
    let before = files(&rooms.path("scenes/kitchen"));
    sgs(&["batch", &rooms.text("rooms.toml"), "-o", &scene]).refused_with(2, &["is a scene"]);
    assert!(files(&rooms.path("scenes/kitchen")) == before);
    std::fs::create_dir(rooms.path("out")).unwrap();
    std::fs::write(rooms.path("out/thesis.txt"), "").unwrap();
    rooms.batch(&[]).refused_with(2, &["thesis.txt"]);
}
