//! `engine-bench rooms` over tiny scenes.

use std::path::Path;
use std::process::{Command, Output};

fn run(program: &Path, arguments: &[&str]) -> Output {
    Command::new(program).args(arguments).output().unwrap()
}

#[test]
fn both_ways_are_measured_and_errors_are_sentences() {
    let bench = Path::new(env!("CARGO_BIN_EXE_engine-bench"));
    let sgs = bench.with_file_name("sgs");
    if !sgs.is_file() {
        println!("skipped: {} is missing; cargo build -p sgs makes it", sgs.display());
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (scene, json) = (path("room"), path("rooms.json"));
    let synth = run(&sgs, &["synth", &scene, "--scene", "box", "--views", "8", "--size", "32x24", "-q"]);
    assert!(synth.status.success(), "{synth:?}");
    let done = run(bench, &["rooms", &scene, "--runs", "3", "--steps", "3", "--together", "1,3", "--json", &json]);
    assert!(done.status.success(), "{done:?}");
    let report: serde_json::Value = serde_json::from_slice(&std::fs::read(&json).unwrap()).unwrap();
    let rows = report["rows"].as_array().unwrap();
    let keys: Vec<_> = rows.iter().map(|r| (r["way"].as_str().unwrap(), r["together"].as_u64().unwrap())).collect();
    assert_eq!(keys, [("processes", 1), ("one_process", 1), ("processes", 3), ("one_process", 3)]);
    assert!(rows.iter().all(|r| r["seconds"].as_f64() > Some(0.0)), "{report}");
    for (arguments, words) in [
        (vec!["rooms", &scene, "--together", "0"], "above 0"),
        (vec!["rooms", &scene, "--sgs", "nowhere"], "no program sgs"),
        (vec!["rooms", "nowhere"], "nowhere"),
    ] {
        let refused = run(bench, &arguments);
        let text = String::from_utf8_lossy(&refused.stderr).into_owned();
        assert!(!refused.status.success() && text.contains(words) && !text.contains("panicked"), "{text}");
    }
}
