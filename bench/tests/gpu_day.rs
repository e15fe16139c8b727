//! Rehearsal of `bench/gpu-day` at tiny sizes.
//!
//! It packs programs and scenes, runs its parts under time limits, and keeps what each part left.

use serde_json::Value;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// Stand-in for the program of device tests. One test fails, and one is not run.
const TESTS: &str = "#!/bin/sh
if [ $1 = --list ]; then
    for i in 1 2 3 4 5 6 7 8 9; do echo t$i: test; done
    exit
fi
shift
for test; do
    case $test in
    t2) printf 'test t2 - should panic ... FAILED\n\nfailures:\nwrong\n\ntest result: FAILED\n' ;;
    t3) ;;
    *) echo \"test $test ... ok\" ;;
    esac
done
";

struct Day {
    folder: tempfile::TempDir,
}

impl Day {
    /// Packs the programs of this build and a room.
    fn new() -> Day {
        let day = Day { folder: tempfile::tempdir().unwrap() };
        let bin = day.path("bin");
        std::fs::create_dir(&bin).unwrap();
        let bench = Path::new(env!("CARGO_BIN_EXE_engine-bench"));
        let sgs = bench.with_file_name("sgs");
        assert!(sgs.exists(), "build sgs first: cargo build -p sgs");
        std::fs::copy(bench, bin.join("engine-bench")).unwrap();
        std::fs::copy(sgs, bin.join("sgs")).unwrap();
        std::fs::write(bin.join("device"), TESTS).unwrap();
        std::fs::set_permissions(bin.join("device"), std::fs::Permissions::from_mode(0o755)).unwrap();
        let (script, room) = (here("gpu-day"), here("../tests/data/room"));
        let mut command = Command::new("sh");
        command.arg(script).arg("pack").arg(day.path("packed")).arg(room).env("BIN", &bin);
        let out = command.output().unwrap();
        assert!(out.status.success(), "{}", message(&out));
        day
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Runs some parts at tiny sizes.
    fn run(&self, parts: &str, budget: u32) -> (Output, String) {
        let tiny = "--gaussians 2000 --size 64x48 --repeats 2";
        let mut command = Command::new("sh");
        command.arg(self.path("packed").join("gpu-day")).arg("run").arg(self.path("out"));
        command.env("ONLY", parts).env("BUDGET", budget.to_string()).env("STEPS", "4 2").env("STAGE", "geometry");
        command.env("LARGE", tiny).env("SMALL", tiny).env("JOBS", "2").env("WARMUP", "1");
        match std::env::var("SGS_TEST_DEVICE") {
            Ok(device) => command.env("DEVICE", device),
            Err(_) => command.env_remove("DEVICE"),
        };
        let out = command.output().unwrap();
        let summary = std::fs::read_to_string(self.path("out").join("summary.md")).unwrap();
        (out, summary)
    }
}

fn here(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(name)
}

fn message(out: &Output) -> String {
    String::from_utf8_lossy(&out.stderr).into_owned()
}

#[test]
fn parts_are_measured_and_failures_end_nothing() {
    let day = Day::new();
    let (out, summary) = day.run("devices tests determinism ceiling step_small", 600);
    let of = |part: &str| {
        let row = summary.lines().find(|l| l.starts_with(&format!("| {part} |")));
        row.unwrap_or_else(|| panic!("no {part}: {summary}\n{}", message(&out))).to_owned()
    };
    for part in ["devices", "ceiling", "step_small", "determinism"] {
        assert!(of(part).contains("| done |"), "{summary}");
    }
    // The failed test and the one that did not run are named, and later parts ran.
    assert!(of("tests").contains("failed (1)") && out.status.code() == Some(1), "{summary}");
    let log = std::fs::read_to_string(day.path("out/tests.log")).unwrap();
    assert!(log.contains("failures:\nwrong") && log.contains("7 of 9 tests passed."), "{log}");
    let tests = std::fs::read_to_string(day.path("out/tests.tsv")).unwrap();
    assert!(tests.contains("FAILED\tt2\n") && tests.ends_with("not run\tt3\n"), "{tests}");
    assert_eq!(std::fs::read_dir(day.path("out/tests")).unwrap().count(), 2, "nine tests take two processes");
    let log = std::fs::read_to_string(day.path("out/determinism.log")).unwrap();
    assert!(log.contains("scene.ply has the same bytes"), "{log}");
    let set: Value = serde_json::from_slice(&std::fs::read(day.path("out/reports.json")).unwrap()).unwrap();
    let commands: Vec<_> = set["reports"].as_array().unwrap().iter().map(|r| r["command"].as_str().unwrap()).collect();
    assert_eq!(commands, ["ceiling", "step"]);
}

#[test]
fn parts_without_time_are_left_out() {
    let day = Day::new();
    let (out, summary) = day.run("devices ceiling", 5);
    assert!(out.status.success(), "{}", message(&out));
    assert_eq!(summary.matches("left out: no time").count(), 2, "{summary}");
    let usage = Command::new("sh").arg(here("gpu-day")).arg("run").output().unwrap();
    assert_eq!(usage.status.code(), Some(2));
    assert!(message(&usage).starts_with("Measures everything on a machine with a GPU"), "{}", message(&usage));
}
