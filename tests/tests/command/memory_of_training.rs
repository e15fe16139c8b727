//! Device memory and resident memory of `sgs train`.

use sgs_tests::cli::{sgs, signal, start, until, wait};
use sgs_tests::place::Place;
use sgs_tests::rooms::Room;

#[test]
fn cli_reports_memory_shortage() {
    let place = Place::new(Room { views: 8, size: [64, 48], spacing: 1, ..Room::default() });
    let (scene, run) = (place.text("scene"), place.text("run"));
    let arguments = |more: &[&str]| -> Vec<String> {
        let mut all: Vec<String> = ["train", &scene, "-o", &run, "--geometry-steps", "16"].map(String::from).to_vec();
        for pair in [
            "geometry.densify.from=5",
            "geometry.densify.interval=1",
            "geometry.densify.until=0.8",
            "geometry.densify.grad_threshold=0.0",
            "geometry.densify.max_gaussians=100000",
            "train.checkpoint_interval=4",
        ] {
            all.extend(["--set".into(), pair.into()]);
        }
        all.extend(more.iter().map(|s| (*s).to_owned()));
        all
    };
    let refused = sgs(&arguments(&["--memory-budget", "2M"]));
    refused.refused(&["The first step needs", "MiB of device memory", "the budget leaves 2.0 of 2.0 MiB"]);
    sgs(&arguments(&["--memory-budget", "lots"])).assert_no_panic();

    let plan = sgs(&["plan", &scene, "--memory-budget", "4G", "--json"]).ok().json();
    let total = plan["needs_bytes"].as_u64().unwrap();
    let parts: u64 = plan["needs"].as_object().unwrap().values().map(|v| v.as_u64().unwrap()).sum();
    assert_eq!(total, parts);
    assert!(plan["budget"]["heap"].as_u64() >= plan["budget"]["budget"].as_u64());
    let text = sgs(&["plan", &scene]).ok().stdout;
    for word in ["photographs", "parameters", "moments", "staging", "in all", "of a budget of"] {
        assert!(text.contains(word), "{word}: {text}");
    }

    // At 1.5 times the memory of the first step, densification stops and reports this once.
    let budget = (total + total / 2).to_string();
    let bound = sgs(&arguments(&["--vram", &budget])).ok();
    assert_eq!(bound.stderr.matches("new Gaussians left out after step 12: ").count(), 1, "{}", bound.stderr);
    assert!(bound.stderr.contains(" that densification asked for did not fit into "), "{}", bound.stderr);
    let summary = String::from_utf8(place.read("run/training.json")).unwrap();
    let summary: serde_json::Value = serde_json::from_str(&summary).unwrap();
    assert!(summary["peak_device_bytes"].as_u64().unwrap() <= total + total / 2, "{summary}");
    // The log records the counts of each densification.
    let log = String::from_utf8(place.read("run/log.jsonl")).unwrap();
    let lines = log.lines().map(|l| serde_json::from_str::<serde_json::Value>(l).unwrap());
    let densified: Vec<_> = lines.filter(|l| l["densified"].is_object()).collect();
    let number = |l: &serde_json::Value, what: &str| l["densified"][what].as_u64().unwrap();
    for l in &densified {
        let [before, pruned, cloned, split, after] =
            ["before", "pruned", "cloned", "split", "after"].map(|what| number(l, what));
        assert!(before + cloned + split == pruned + after, "{l}");
        assert!(number(l, "invalid") + number(l, "weightless") <= pruned, "{l}");
    }
    assert!(densified.len() >= 8 && densified.iter().any(|l| number(l, "refused") > 0), "{log}");
}

/// Tests that resident memory does not grow during training. A CPU driver may compile kernels again for each value of a
/// uniform and retain them all, about a megabyte per step.
#[test]
fn resident_memory_does_not_grow_during_training() {
    let place = Place::new(Room { priors: true, ..Room::default() });
    let mut child = start(&[
        "train",
        &place.text("scene"),
        "-o",
        &place.text("run"),
        "--geometry-steps",
        "100000",
        "--no-densify",
        "--set",
        "train.checkpoint_interval=0",
    ]);
    let resident = |id: u32| {
        let status = std::fs::read_to_string(format!("/proc/{id}/status")).unwrap();
        let line = status.lines().find(|l| l.starts_with("RssAnon:")).unwrap().to_owned();
        line.split_whitespace().nth(1).unwrap().parse::<u64>().unwrap()
    };
    let at = |step: u64| place.logged("run").last().is_some_and(|last| *last >= step);
    assert!(until(&mut child, || at(40)), "training was to begin");
    let before = resident(child.id());
    assert!(until(&mut child, || at(160)), "training was to go on");
    let after = resident(child.id());
    signal(&child, "KILL");
    wait(child);
    assert!(after < before + 16_000, "120 steps took {before} to {after} kB");
}
