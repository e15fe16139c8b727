//! `--preset` and `--accuracy`: recorded settings, precedence, refusals. Help and documents name every preset.

use sgs_config::{LobeLayout, PRESETS, Settings};
use sgs_passes::Accuracy;
use sgs_run::RunDirectory;
use sgs_tests::Place;
use sgs_tests::cli::{Finished, sgs};
use sgs_tests::rooms::Room;

/// Trains both stages for a few steps.
fn train(place: &Place, run: &str, more: &[&str]) -> Finished {
    let (scene, to) = (place.text("scene"), place.text(run));
    let a = ["train", &scene, "-o", &to, "--geometry-steps", "3", "--no-densify", "--intrinsic-steps", "2"];
    sgs(&[&a[..], more].concat())
}

/// Returns the settings that a run recorded.
fn settings(place: &Place, run: &str) -> Settings {
    RunDirectory::open(&place.path(run)).unwrap().settings().unwrap()
}

#[test]
fn presets_have_lowest_precedence() {
    let place = Place::new(Room { priors: true, ..Room::default() });
    std::fs::write(place.path("over.toml"), "seed = 5\n[intrinsic.visibility]\ncoarsest = 8\nfinest = 32\n").unwrap();
    let file = place.text("over.toml");
    let train = |run: &str, more: &[&str]| train(&place, run, more);
    let of = |run: &str| settings(&place, run);
    train("no", &["--preset", "drafts"]).refused(&["\"drafts\" is not a preset", "did you mean \"draft\"?", "parity"]);
    assert!(!place.path("no").exists());
    train("a", &["--preset", "parity", "--config", &file, "--set", "intrinsic.visibility.coarsest=4"]).ok();
    let s = of("a");
    assert_eq!(
        (s.seed, s.geometry.steps, s.geometry.dense_adam, s.intrinsic.lights.layout),
        (5, 3, true, LobeLayout::Grid)
    );
    let v = s.intrinsic.visibility;
    assert_eq!((v.coarsest, v.finest, v.log2_table), (4, 32, 18));
    // Another stage on that geometry takes only its own settings from the preset.
    let small = ["--set", "intrinsic.lights.grid=2", "--set", "intrinsic.environment.resolution=16"];
    train("a", &[&["--stage", "intrinsic", "--preset", "draft"][..], &small].concat()).ok();
    let s = of("a");
    assert_eq!((s.seed, s.geometry.dense_adam, s.geometry.sh_degree), (5, true, 3.into()));
    assert_eq!((s.intrinsic.visibility.levels, s.intrinsic.lights.grid), (8, 2));
    // A run resumes only with the settings that it was begun with.
    train("b", &["--preset", "draft"]).ok();
    train("b", &["--preset", "draft", "--resume"]).ok();
    train("b", &["--resume"]).ok();
    train("b", &["--preset", "paper", "--resume"]).refused(&["was begun with", "resume it as it was begun"]);
}

#[test]
fn accuracy_levels_override_presets_but_not_files() {
    let place = Place::new(Room { priors: true, ..Room::default() });
    let file = "[accuracy]\ndepth_bits = 24\n[intrinsic.visibility]\nsample = 7\nlevels = 2\nlog2_table = 8\n\
        [intrinsic.lights]\ngrid = 2\n[intrinsic.environment]\nresolution = 16\n";
    std::fs::write(place.path("over.toml"), file).unwrap();
    let file = place.text("over.toml");
    let train = |run: &str, more: &[&str]| train(&place, run, more);
    let of = |run: &str| settings(&place, run);
    let fast = Accuracy::FAST;
    train("a", &["--accuracy", "fast", "--config", &file]).ok();
    let s = of("a");
    assert_eq!((s.accuracy, s.intrinsic.visibility.sample), (Accuracy { depth_bits: 24, ..fast }, 7));
    train("a", &["--accuracy", "fast", "--config", &file, "--resume"]).ok();
    // An accuracy level overrides the same settings of a preset.
    train("b", &["--preset", "draft", "--accuracy", "fast"]).ok();
    let s = of("b");
    assert_eq!((s.accuracy, s.intrinsic.visibility.sample), (fast, 4));
    train("b", &["--resume", "--accuracy", "fast"]).ok();
    train("b", &["--resume", "--accuracy", "balanced"]).refused(&["was begun with", "accuracy"]);
    // For another stage on that geometry, the file overrides the level as well.
    train("b", &["--stage", "intrinsic", "--accuracy", "exact", "--config", &file]).ok();
    let s = of("b");
    assert_eq!((s.accuracy.color_bits, s.intrinsic.visibility.sample), (32, 7));
}

/// Tests that the last densification is at least an interval before the end. Every preset is tested. New Gaussians are
/// thus optimized for an interval.
#[test]
fn densification_ends_an_interval_before_the_last_step() {
    let place = Place::new(Room { priors: true, views: 6, ..Room::default() });
    let scene = place.text("scene");
    let (steps, interval) = (23, 5);
    let name = |key: &str, value: &str| format!("geometry.{key}={value}");
    let sets = [
        name("densify.from", "5"),
        name("densify.interval", "5"),
        name("densify.grad_threshold", "0"),
        name("densify.max_gaussians", "600"),
        name("sh_degree", "0"),
    ];
    for preset in PRESETS {
        let run = place.text(preset.name);
        let mut a = vec!["train", &scene, "-o", &run, "-q", "--geometry-steps", "23", "--preset", preset.name];
        sets.iter().for_each(|set| a.extend(["--set", set]));
        sgs(&a).ok();
        let log = String::from_utf8(place.read(&format!("{}/log.jsonl", preset.name))).unwrap();
        let lines: Vec<serde_json::Value> = log.lines().map(|l| serde_json::from_str(l).unwrap()).collect();
        let grown: Vec<u64> =
            lines.iter().filter(|l| l.get("densified").is_some()).map(|l| l["step"].as_u64().unwrap()).collect();
        let last = *grown.last().unwrap_or_else(|| panic!("{} never densifies: {log}", preset.name));
        assert!(last + interval <= steps, "{} densifies after step {last} of {steps}", preset.name);
        let ends = settings(&place, preset.name).geometry.densify.until * 23.0;
        assert!(last + 2 * interval > (steps - interval).min(ends as u64), "{} stops early: {grown:?}", preset.name);
    }
}

#[test]
fn help_and_documents_name_every_preset() {
    let help = sgs(&["train", "--help"]).ok().stdout;
    let document = include_str!("../../../docs/reference/presets.md");
    for preset in PRESETS {
        assert!(help.contains(&format!("\"{}\"", preset.name)), "{}", preset.name);
        assert!(document.contains(&format!("| `{}` |", preset.name)), "{}", preset.name);
    }
}
