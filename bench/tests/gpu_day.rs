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

/// Settings of a small model of materials and lights, by key.
const SMALL: [(&str, u32); 7] = [
    ("intrinsic.lights.grid", 2),
    ("intrinsic.lights.lobes", 2),
    ("intrinsic.environment.resolution", 16),
    ("intrinsic.visibility.levels", 2),
    ("intrinsic.visibility.log2_table", 8),
    ("intrinsic.visibility.coarsest", 4),
    ("intrinsic.visibility.finest", 16),
];

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
        std::fs::write(day.path("small.toml"), SMALL.map(|(key, value)| format!("{key} = {value}\n")).concat())
            .unwrap();
        // An installed PyTorch would need a GPU.
        std::fs::create_dir(day.path("python")).unwrap();
        std::fs::write(day.path("python/torch.py"), "raise ImportError('hidden by the test')\n").unwrap();
        day
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Runs some parts at tiny sizes.
    fn run(&self, parts: &str, budget: u32) -> (Output, String) {
        let settings = SMALL.map(|(key, value)| format!(" --set {key}={value}")).concat();
        let mut command = Command::new("sh");
        command.arg(self.path("packed").join("gpu-day")).arg("run").arg(self.path("out"));
        command.env("ONLY", parts).env("BUDGET", budget.to_string()).env("STEPS", "4 2").env("STAGE", "geometry");
        command.env("LARGE", "--gaussians 2000 --size 70x50 --repeats 3").env("JOBS", "2").env("WARMUP", "1");
        command.env("SMALL", "--gaussians 2000 --size 64x48 --repeats 2").env("PASSES", "--filter blend");
        command.env("TRADEOFF", "--filter compact --rounds 1 --train 2").env("PYTHONPATH", self.path("python"));
        let small = self.path("small.toml");
        command.env("MATERIALS", format!("--size 24x18 --repeats 2 --config {}", small.display()));
        command.env("PAPER", format!("--geometry-steps 4 --intrinsic-steps 2{settings}"));
        match std::env::var("SGS_TEST_DEVICE") {
            Ok(device) => command.env("DEVICE", device),
            Err(_) => command.env_remove("DEVICE"),
        };
        let out = command.output().unwrap();
        let summary = std::fs::read_to_string(self.path("out").join("summary.md")).unwrap();
        (out, summary)
    }

    /// Reads the report of a part.
    fn report(&self, part: &str) -> Value {
        let file = self.path("out/reports").join(format!("{part}.json"));
        serde_json::from_slice(&std::fs::read(file).unwrap()).unwrap()
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

/// Returns the names of the rows of a report.
fn names(report: &Value, list: &str, key: &str) -> Vec<String> {
    report[list].as_array().unwrap().iter().map(|row| row[key].as_str().unwrap().to_owned()).collect()
}

#[test]
fn long_parts_are_rehearsed() {
    let day = Day::new();
    let steps = ["step", "step_densify", "step_splat", "step_small_bucket", "step_materials"];
    let parts = [&steps[..], &["passes", "torch", "paper", "scaling", "tradeoff"]].concat();
    let (out, summary) = day.run(&parts.join(" "), 600);
    for part in &parts {
        assert!(summary.contains(&format!("| {part} | done |")), "{summary}\n{}", message(&out));
    }
    assert!(out.status.success() && summary.lines().count() == parts.len() + 2, "{summary}");

    let setting = |part: &str, name: &str| day.report(part)["settings"][name].clone();
    for part in steps {
        assert_eq!(day.report(part)["command"], "step", "{part}");
        assert!(names(&day.report(part), "values", "name").iter().any(|name| name == "step by the host's clock"));
    }
    for (part, size, backward) in [
        ("step", "70x50", "pixel"),
        ("step_densify", "70x50", "pixel"),
        ("step_splat", "70x50", "splat"),
        ("step_small_bucket", "64x48", "bucket"),
    ] {
        assert_eq!((setting(part, "size"), setting(part, "backward")), (size.into(), backward.into()), "{part}");
        let whole = part == "step_densify";
        assert_eq!((setting(part, "densify"), setting(part, "normals")), (whole.into(), whole.into()), "{part}");
    }
    assert_eq!(
        (setting("step_materials", "stage"), setting("step_materials", "lobes")),
        ("intrinsic".into(), 2.into())
    );
    let passes = names(&day.report("passes"), "passes", "pass");
    assert!(["blend", "blend_bwd_bucket"].iter().all(|pass| passes.iter().any(|p| p == pass)), "{passes:?}");
    assert!(!passes.iter().any(|pass| pass.starts_with("scan.")), "{passes:?}");
    assert!(names(&day.report("scaling"), "facts", "name").contains(&"a further Gaussian: bytes".to_owned()));
    assert!(names(&day.report("tradeoff"), "values", "name").contains(&"step, compact".to_owned()));

    let log = std::fs::read_to_string(day.path("out/torch.log")).unwrap();
    assert!(log.contains("hidden by the test") && log.ends_with("PyTorch is not installed\n"), "{log}");
    let table = std::fs::read_to_string(day.path("out/paper/table.md")).unwrap();
    for row in ["| rendered image, PSNR |", "| albedo, PSNR |", "| mean of relit sets, PSNR |", "; 4 and 2 steps."] {
        assert!(table.contains(row), "no {row}: {table}");
    }
    assert!(day.path("out/paper/images/relit.png").exists() && day.path("out/paper/config.toml").exists());
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
