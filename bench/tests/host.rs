//! Steady state of both stages, counted by a driver that runs no kernels. No test here depends on time.

use serde_json::Value;
use std::process::Command;

fn host(more: &[&str]) -> std::process::Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_engine-bench"));
    command.args(["host", "--steps", "100", "--size", "32x24", "--json"]).args(more);
    command.output().unwrap()
}

#[test]
fn steps_record_write_and_allocate_nothing() {
    let out = host(&[]);
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    let report: Value = serde_json::from_slice(&out.stdout).unwrap();
    let facts = report["facts"].as_array().unwrap();
    let fact = |name: &str| {
        let found = facts.iter().find(|fact| fact["name"] == name).unwrap_or_else(|| panic!("no fact {name}"));
        found["value"].as_f64().unwrap()
    };
    let stages = ["geometry", "geometry with pseudo-views", "intrinsic", "intrinsic with steps of all kinds"];
    for stage in stages {
        for name in
            ["recorded command buffers", "written descriptors", "allocations of device memory", "created objects"]
        {
            assert_eq!(fact(&format!("{stage}: {name}")), 0.0, "{stage}: {name}");
            // The counters count: setup did all of these.
            assert!(fact(&format!("{stage}: {name} before the measured steps")) >= 5.0, "{stage}: {name}");
        }
        let mut times = report["values"].as_array().unwrap().iter();
        let time = times.find(|v| v["name"] == format!("{stage}: host's time of a step")).unwrap();
        assert_eq!(time["value"]["samples"], 100);
    }
    let submissions = stages.map(|stage| fact(&format!("{stage}: submissions per step")));
    assert_eq!(submissions[..3], [1.0; 3]);
    // Two of three steps compare views or lights, and submit projections first.
    assert!(submissions[3] > 1.6, "{submissions:?}");
}

#[test]
fn missing_driver_is_named() {
    let out = host(&["--driver", "/nowhere/driver.so"]);
    let message = String::from_utf8_lossy(&out.stderr).into_owned();
    assert!(out.status.code() == Some(1) && message.contains("/nowhere/driver.so"), "{message}");
}
