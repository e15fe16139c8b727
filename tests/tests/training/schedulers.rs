//! What schedulers use of `sgs batch`: lists, selected runs and their exit statuses, summaries, scripts for Slurm.

use super::batch::Rooms;
use serde_json::Value;
use sgs_tests::cli::{sgs, signal, start, until, wait};
use sgs_tests::files;
use std::os::unix::fs::PermissionsExt;
use std::process::{Command, Stdio};

/// Returns name and state of each listed run.
fn states(rooms: &Rooms) -> Vec<(String, String)> {
    let list = rooms.batch(&["--list", "--json"]).ok().json();
    let text = |run: &Value, key: &str| run[key].as_str().unwrap().to_owned();
    list["runs"].as_array().unwrap().iter().map(|run| (text(run, "name"), text(run, "state"))).collect()
}

#[test]
fn selected_runs_are_trained_and_listed() {
    let rooms = Rooms::new(&["kitchen", "broken"]);
    std::fs::write(rooms.path("scenes/broken/transforms.json"), "{}").unwrap();
    rooms.manifest(5);
    let open = |name: &str| (name.to_owned(), "open".to_owned());
    let names = ["kitchen/tiny/seed0", "kitchen/tiny/seed1", "broken/tiny/seed0", "broken/tiny/seed1"];
    assert_eq!(states(&rooms), names.map(open), "most expensive first");
    let lines = rooms.batch(&["--list"]).ok().stdout;
    let first: Value = serde_json::from_str(lines.lines().next().unwrap()).unwrap();
    assert_eq!((lines.lines().count(), &first["key"]), (4, &Value::from("kitchen.tiny.seed0")));
    assert_eq!((&first["scene"], &first["variant"], &first["seed"]), (&"kitchen".into(), &"tiny".into(), &0.into()));
    assert!(first["cost"].as_u64() > Some(0), "{first}");
    assert!(!rooms.path("out").exists(), "a list made a directory");

    // Another scene may be in work elsewhere: it is not read.
    let only = |name: &str| rooms.batch(&["--only", name, "--json"]);
    let answer = only("kitchen/tiny/seed1").ok().json();
    assert_eq!([&answer["runs"], &answer["done"], &answer["skipped"]], [1, 1, 0], "{answer}");
    assert!(answer["summary"].is_null() && !rooms.path("out/summary.jsonl").exists(), "{answer}");
    let before = files(&rooms.path("out"));
    let answer = only("kitchen/tiny/seed1").ok().json();
    assert_eq!([&answer["runs"], &answer["done"], &answer["skipped"]], [1, 0, 1], "{answer}");
    assert!(files(&rooms.path("out")) == before, "a second call changed files");
    assert!(rooms.gaussians("kitchen/tiny/seed1") == rooms.alone("kitchen", 1));

    rooms.batch(&["--summary"]).refused_with(75, &["3 of 4 runs have no result"]);
    only("broken/tiny/seed0").refused_with(42, &["1 of 1 runs failed", "broken/tiny/seed0"]);
    only("broken/tiny/seed0").refused_with(42, &["1 of 1 runs failed"]);
    let two = ["--only", "kitchen/tiny/seed0", "--only", "broken/tiny/seed1"];
    rooms.batch(&two).refused_with(42, &["1 of 2 runs failed"]);
    rooms.batch(&["--summary"]).refused_with(1, &["2 of 4 runs failed"]);
    let summary = rooms.summary();
    assert_eq!(summary.len(), 4);
    assert!(summary.values().all(|line| line["attempts"] == 1), "{summary:?}");
    let ends = states(&rooms).into_iter().map(|(_, state)| state).collect::<Vec<_>>();
    assert_eq!(ends, ["done", "done", "failed", "failed"]);

    only("kitchen/tiny/seed2").refused_with(2, &["no run \"kitchen/tiny/seed2\"", "--list"]);
    for more in [&["--only", "a/b/seed0", "--shard", "1/2"][..], &["--list", "--summary"], &["--slurm", "x", "--list"]]
    {
        assert_eq!(rooms.batch(more).status, Some(2), "{more:?}");
    }
}

#[test]
fn listed_runs_have_their_predicted_memory() {
    let rooms = Rooms::new(&["kitchen", "broken"]);
    std::fs::write(rooms.path("scenes/broken/transforms.json"), "{}").unwrap();
    rooms.manifest(5);
    let peaks = |more: &[&str]| {
        let list = rooms.batch(&[&["--list", "--json"], more].concat()).ok().json();
        let peak = |run: &Value| run["peak_bytes"].as_u64();
        list["runs"].as_array().unwrap().iter().map(peak).collect::<Vec<_>>()
    };
    assert_eq!(peaks(&[]), [None; 4]);
    let planned = peaks(&["--plan"]);
    assert!(planned[0] > Some(1 << 20) && planned[0] == planned[1], "{planned:?}");
    assert_eq!(planned[2..], [None; 2], "a broken scene has a plan");
    assert_eq!(peaks(&[]), planned);
    // Plans are as those of `sgs plan`: the largest number of Gaussians that it expects.
    let config = std::fs::read_dir(rooms.path("out/variants")).unwrap().next().unwrap().unwrap().path();
    let plan =
        sgs(&["plan", &rooms.text("scenes/kitchen"), "--config", config.to_str().unwrap(), "--json"]).ok().json();
    assert_eq!(plan["expected"].as_array().unwrap().last().unwrap()["bytes"].as_u64(), planned[0]);
    rooms.batch(&["--list"]).ok();
    // A batch goes on in the directory of its forecasts.
    rooms.batch(&["--only", "kitchen/tiny/seed0"]).ok();
    assert_eq!(rooms.batch(&["--plan"]).status, Some(2));
}

#[test]
fn temporary_failures_are_tried_again_by_the_next_command() {
    let rooms = Rooms::new(&["kitchen"]);
    rooms.manifest(5);
    let manifest = std::fs::read_to_string(rooms.path("rooms.toml")).unwrap();
    let limited = manifest.clone() + "[limits]\nretries = 0\nmemory_budget = \"2M\"\n";
    std::fs::write(rooms.path("rooms.toml"), limited).unwrap();
    let only = ["--only", "kitchen/tiny/seed0"];
    for attempts in 1..=2 {
        rooms.batch(&only).refused_with(75, &["1 of 1 runs failed", "device memory"]);
        let result = std::fs::read(rooms.path("out/results/kitchen.tiny.seed0.json")).unwrap();
        let result: Value = serde_json::from_slice(&result).unwrap();
        assert_eq!((&result["attempts"], &result["kind"]), (&attempts.into(), &"out_of_memory".into()));
    }
    // Then the memory suffices. The budget is a setting, so that this is another run under the same name.
    std::fs::write(rooms.path("rooms.toml"), manifest).unwrap();
    rooms.batch(&only).ok();
    assert_eq!(states(&rooms)[0], ("kitchen/tiny/seed0".to_owned(), "done".to_owned()));
}

/// Sends SIGTERM to all processes several times, as Slurm does.
#[test]
fn repeated_termination_lets_the_training_write_its_checkpoint() {
    let rooms = Rooms::new(&["kitchen"]);
    rooms.manifest(150);
    let only = ["--only", "kitchen/tiny/seed0"];
    let log = rooms.path("out/runs/kitchen/tiny/seed0/log.jsonl");
    let logged = || std::fs::read_to_string(&log).unwrap_or_default().lines().count();
    let mut child = start(&rooms.arguments(&only));
    assert!(until(&mut child, || logged() > 2), "it ended before it was stopped");
    let parent = child.id().to_string();
    // Each thread has children of its own.
    let threads = std::fs::read_dir(format!("/proc/{parent}/task")).unwrap().map(|thread| thread.unwrap().path());
    let children: String = threads.map(|t| std::fs::read_to_string(t.join("children")).unwrap_or_default()).collect();
    assert_eq!(children.split_whitespace().count(), 1, "one process trains: {children}");
    for _ in 0..3 {
        for pid in children.split_whitespace().chain([parent.as_str()]) {
            // A process that has ended needs no signal.
            let _ = Command::new("kill").args(["-TERM", pid]).stderr(Stdio::null()).status();
        }
    }
    wait(child).refused_with(75, &["stopped in", "the same command goes on"]);
    assert!(rooms.path("out/runs/kitchen/tiny/seed0/checkpoint").exists(), "there is no checkpoint");
    rooms.batch(&only).ok();
    let log = std::fs::read_to_string(rooms.path("out/runs/kitchen/tiny/seed0.log")).unwrap();
    assert!(log.contains("--resume"), "{log}");
    assert!(rooms.gaussians("kitchen/tiny/seed0") == rooms.alone("kitchen", 0), "it differs from a run alone");
}

/// Runs tasks of the script for Slurm, with stand-ins for its commands.
#[test]
fn array_script_requeues_stopped_tasks_unless_they_are_canceled() {
    let rooms = Rooms::new(&["kitchen"]);
    rooms.manifest(150);
    let script = rooms.text("rooms.sbatch");
    let answer = rooms.batch(&["--slurm", &script, "--json"]).ok().json();
    assert_eq!([&answer["runs"], &answer["tasks"]], [2, 2], "{answer}");
    assert!(!rooms.path("out").exists(), "the script alone made a directory");
    let stand_in = |name: &str, text: &str| {
        let path = rooms.path(&format!("bin/{name}"));
        std::fs::create_dir_all(rooms.path("bin")).unwrap();
        std::fs::write(&path, format!("#!/bin/sh\n{text}\n")).unwrap();
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o755)).unwrap();
    };
    stand_in("scontrol", &format!("echo \"$@\" >>{}", rooms.text("requeued")));
    let path = format!("{}:{}", rooms.text("bin"), std::env::var("PATH").unwrap());
    let task = |index: &str, restarts: &str| {
        let mut bash = Command::new("bash");
        bash.arg(&script).env("PATH", &path).env("SLURM_ARRAY_TASK_ID", index).env("SLURM_JOB_ID", "7");
        bash.env("SLURM_RESTART_COUNT", restarts).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        bash.spawn().unwrap()
    };
    let log = rooms.path("out/runs/kitchen/tiny/seed1/log.jsonl");
    let logged = || std::fs::read_to_string(&log).unwrap_or_default().lines().count();
    let requeued = || std::fs::read_to_string(rooms.path("requeued")).unwrap_or_default();
    for (state, restarts, expected) in
        [("RUNNING", "3", "requeue 7\n"), ("CANCELLED", "3", ""), ("COMPLETING", "3", ""), ("RUNNING", "100", "")]
    {
        stand_in("squeue", &format!("echo {state}"));
        let before = logged();
        let mut child = task("1", restarts);
        assert!(until(&mut child, || logged() > before + 1), "it ended before it was stopped");
        signal(&child, "TERM");
        let ended = wait(child);
        assert_eq!(ended.status, Some(75), "{ended:?}");
        assert_eq!(requeued(), expected, "{state} after {restarts} restarts");
        let _ = std::fs::remove_file(rooms.path("requeued"));
    }
    assert_eq!(wait(task("1", "0")).status, Some(0));
    assert_eq!(wait(task("0", "0")).status, Some(0));
    assert_eq!(requeued(), "");
    rooms.batch(&["--summary"]).ok();
    for seed in [0, 1] {
        assert!(rooms.gaussians(&format!("kitchen/tiny/seed{seed}")) == rooms.alone("kitchen", seed));
    }
    // A folder that is missing is named.
    let missing = rooms.text("missing/rooms.sbatch");
    rooms.batch(&["--slurm", &missing]).refused_with(1, &["missing"]);
}
