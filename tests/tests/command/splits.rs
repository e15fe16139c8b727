//! `--split`: held-out views, the recorded split, and refusals.

use sgs_run::RunDirectory;
use sgs_scene::SplitRule;
use sgs_tests::Place;
use sgs_tests::cli::{sgs, sgs_after};
use sgs_tests::rooms::Room;

/// Returns the names of the views that `sgs eval` measures.
fn measured(place: &Place, run: &str, split: &str) -> Vec<String> {
    let found = sgs(&["eval", &place.text(run), "--split", split, "--json"]).ok().json();
    found["views"].as_array().unwrap().iter().map(|v| v["name"].as_str().unwrap().to_owned()).collect()
}

#[test]
fn a_split_is_recorded_and_kept() {
    let place = Place::new(Room::default());
    sgs(&place.arguments("run", 2, &["--split", "every:3"])).ok();
    assert_eq!(RunDirectory::open(&place.path("run")).unwrap().settings().unwrap().split, SplitRule::Every(3));
    assert_eq!(measured(&place, "run", "test"), ["000", "003", "006"]);
    assert_eq!(measured(&place, "run", "train"), ["001", "002", "004", "005", "007"]);
    // Resuming keeps the split, and another split is refused.
    place.resume("run").ok();
    let (scene, run) = (place.text("scene"), place.text("run"));
    let other = ["train", &scene, "-o", &run, "--resume", "--split", "linspace:2"];
    sgs(&other).refused(&["begun with split", "every:3", "linspace:2"]);
    for (rule, words) in
        [("every:1", "every:N with N of at least 2"), ("linspace:7", "needs at least 9 views, but there are 8")]
    {
        let plan = sgs(&["plan", &scene, "--split", rule]);
        assert!(plan.status != Some(0) && plan.stderr.contains(words), "{}", plan.stderr);
        plan.assert_no_panic();
    }
    sgs(&["plan", &scene, "--split", "linspace:2"]).ok();
}

/// Tests that a split file is relative to the training's working directory.
#[test]
fn a_split_file_is_found_from_any_directory() {
    let place = Place::new(Room::default());
    std::fs::write(place.path("folds.json"), r#"{"train": ["001", "002", "004"], "test": ["007"]}"#).unwrap();
    let preparation = format!("cd '{}'", place.path(".").display());
    let train = ["train", "scene", "-o", "run", "--geometry-steps", "1", "--split", "folds.json", "--views", "2"];
    sgs_after(&preparation, &train).ok();
    assert_eq!(measured(&place, "run", "test"), ["007"]);
    assert_eq!(measured(&place, "run", "train"), ["001", "004"]);
    std::fs::remove_file(place.path("folds.json")).unwrap();
    sgs(&["eval", &place.text("run")]).refused(&["folds.json"]);
}
