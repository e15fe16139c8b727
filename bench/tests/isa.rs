//! `engine-bench isa`: compiles for absent GPUs, and fails where kernels became worse.
//!
//! The tests skip where Mesa's RADV is not installed, and say so.

use serde_json::Value;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// Kernels of most tests: without spills, with shared memory, and with many registers.
const KERNELS: &str = "scan_reduce,photometric_bwd,transport_reflect";

fn isa(arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_engine-bench"));
    if let Ok(device) = std::env::var("SGS_TEST_DEVICE") {
        command.args(["--device", &device]);
    }
    command.arg("isa").args(arguments).output().unwrap()
}

fn message(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

fn read(path: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
}

#[test]
fn kernels_are_compiled_and_worse_ones_fail() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("navi21.json");
    let (at, path) = (folder.path().to_str().unwrap(), file.to_str().unwrap());
    let few = ["--family", "navi21", "--lanes", "32", "--kernel", KERNELS];
    let made = isa(&[&few[..], &["-o", path]].concat());
    if !made.status.success() && message(&made).contains("RADV is not installed") {
        println!("skipped: {}", message(&made));
        return;
    }
    assert!(made.status.success(), "{}", message(&made));
    let report = read(&file);
    let rows = report["families"][0]["rows"].as_array().unwrap().clone();
    assert!(rows.iter().all(|r| r["lanes"] == 32));
    let table = String::from_utf8_lossy(&made.stdout).into_owned();
    assert_eq!(table.lines().count(), rows.len() + 2);
    for kernel in KERNELS.split(',') {
        let found: Vec<&Value> = rows.iter().filter(|r| r["kernel"] == kernel).collect();
        assert!(!found.is_empty() && table.contains(&format!("| {kernel} |")), "{table}");
        for row in found {
            let number = |name: &str| row["statistics"][name].as_u64().unwrap();
            assert!((1..=256).contains(&number("VGPRs")) && number("Code size") > 100, "{row}");
            assert!((number("LDS size") > 0) == (kernel != "transport_reflect"), "{row}");
        }
    }

    // The same kernels are not worse than stored, and give the same file.
    let again = folder.path().join("again");
    let same = isa(&[&few[..], &["--check", at, "-o", again.to_str().unwrap()]].concat());
    assert!(same.status.success(), "{}", message(&same));
    assert_eq!(std::fs::read(&again).unwrap(), std::fs::read(&file).unwrap());

    // Stored registers that are fewer by more than a tenth make the kernel worse. A tenth more does not.
    let mut planted = report.clone();
    let rows = planted["families"][0]["rows"].as_array_mut().unwrap();
    let mut worse = 0;
    for row in rows.iter_mut() {
        let registers = row["statistics"]["VGPRs"].as_f64().unwrap();
        let share = if row["kernel"] == "transport_reflect" { 0.8 } else { 0.95 };
        worse += usize::from(row["kernel"] == "transport_reflect");
        row["statistics"]["VGPRs"] = Value::from(share * registers);
    }
    std::fs::write(&file, planted.to_string()).unwrap();
    let refused = isa(&[&few[..], &["--check", at]].concat());
    let text = message(&refused);
    assert_eq!(refused.status.code(), Some(1), "{text}");
    let sentences: Vec<&str> = text.lines().filter(|l| l.contains(" vector registers (stored: ")).collect();
    assert!(worse > 0 && sentences.len() == worse, "{text}");
    assert!(sentences.iter().all(|l| l.starts_with("transport_reflect on navi21 at ")), "{text}");

    // A baseline of another driver is no baseline.
    planted["families"][0]["gpu"]["driver"] = "radv Mesa 0.0".into();
    std::fs::write(&file, planted.to_string()).unwrap();
    let other = isa(&[&few[..], &["--check", at]].concat());
    assert!(other.status.code() == Some(1) && message(&other).contains("is by radv Mesa 0.0"), "{}", message(&other));
}

/// Returns the folder of stored reports.
fn stored() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("results/isa")
}

/// Compares kernels with the stored reports, and returns their table.
///
/// Returns `None` without the driver of the reports.
fn gate(arguments: &[&str]) -> Option<String> {
    let run = isa(&[arguments, &["--check", stored().to_str().unwrap()]].concat());
    let text = message(&run);
    if !run.status.success() && (text.contains("RADV is not installed") || text.contains("The stored report of ")) {
        println!("skipped: {text}");
        return None;
    }
    assert!(run.status.success(), "{text}");
    Some(String::from_utf8_lossy(&run.stdout).into_owned())
}

/// Compiles every kernel of every pipeline for one family.
///
/// It takes most of a minute.
#[test]
fn every_kernel_at_32_lanes_is_not_worse_than_stored() {
    let Some(table) = gate(&["--family", "navi21", "--lanes", "32"]) else { return };
    let report = read(&stored().join("navi21.json"));
    let rows = report["families"][0]["rows"].as_array().unwrap();
    let narrow = rows.iter().filter(|row| row["lanes"] == 32);
    let expected: BTreeSet<&str> = narrow.map(|row| row["kernel"].as_str().unwrap()).collect();
    let cells: Vec<Vec<&str>> = table.lines().skip(2).map(|line| line.split(" | ").collect()).collect();
    assert!(cells.iter().all(|row| row[..2] == ["| navi21", "32"]), "{table}");
    let found: BTreeSet<&str> = cells.iter().map(|row| row[2]).collect();
    // A kernel without stored figures would be gated on spills only.
    let apart: Vec<_> = found.symmetric_difference(&expected).collect();
    assert!(apart.is_empty(), "compiled or stored only: {apart:?}; record bench/results/isa/navi21.json again");
    assert!(found.len() > 100, "only {} kernels", found.len());
}

#[test]
fn some_kernels_at_64_lanes_are_not_worse_than_stored() {
    let Some(table) = gate(&["--lanes", "64", "--kernel", KERNELS]) else { return };
    assert!(table.contains("| navi21 | 64 |") && table.contains("| vega10 | 64 |"), "{table}");
}

#[test]
fn wrong_requests_are_refused_in_one_sentence() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    std::fs::write(
        path("driver.json"),
        r#"{"file_format_version": "1.0.0", "ICD": {"library_path": "none.so", "api_version": "1.3.0"}}"#,
    )
    .unwrap();
    std::fs::write(path("other.json"), "{}").unwrap();
    for (arguments, code, words) in [
        (vec!["--lanes", "7"], 2, "7"),
        (vec!["--driver", "nowhere.json"], 1, "nowhere.json"),
        (vec!["--driver", &path("driver.json")], 1, "cannot compile for navi21"),
        (vec!["--check", "nowhere"], 1, "nowhere"),
        (vec!["--check", &path("other.json")], 1, "is no report of engine-bench isa"),
    ] {
        let out = isa(&arguments);
        let text = message(&out);
        assert_eq!(out.status.code(), Some(code), "{arguments:?}: {text}");
        assert!(text.contains(words) && !text.contains("panicked"), "{arguments:?}: {text}");
        assert!(code == 2 || text.lines().count() == 1, "{arguments:?}: {text}");
    }
}
