//! Device tests on lavapipe with 16 lanes.
//!
//! Wide subgroups take other paths than the default 8 lanes. By default, a subset of the tests runs, one program after
//! the other. `SGS_TEST_LANES=all` runs every program that needs a device, which takes half an hour on two cores.

use sgs_tests::Gpu;
use sgs_tests::cli::sgs_with;
use sgs_tests::program::program;
use std::path::Path;
use std::process::Command;

/// Width of lavapipe's vectors in bits, 32 for each lane. At 1024 it crashes.
const WIDTH: &str = "512";

/// Programs and tests that run by default.
///
/// Their sizes or strides depend on the subgroup. Of sub-tiles, buckets and parts of tiles only the short tests run: the
/// others compile dozens of kernels.
const DEFAULT: &[(&str, &[&str])] = &[
    ("alone", &["subgroups::"]),
    (
        "device",
        &[
            "buckets::buckets_fit_the_capacity_of_entries",
            "buckets::gradients_over_many_buckets_match_reference",
            "long_tiles::",
            "splat::",
            "sub_tiles::weights_keep_their_bits",
            "tile_parts::stopped_parts_need_no_checkpoints",
            "visible_bits::",
        ],
    ),
];

/// Programs that need no device or open their own devices.
const WITHOUT_DEVICE: &[&str] = &["docs", "emulated", "lanes", "layers", "modules"];

/// Returns the environment variables of a run at 16 lanes.
///
/// Mesa's cache of compiled kernels does not distinguish widths, so each has its own.
fn variables() -> [(&'static str, String); 2] {
    let cache = Path::new(env!("CARGO_TARGET_TMPDIR")).join("lanes16");
    [("LP_NATIVE_VECTOR_WIDTH", WIDTH.to_owned()), ("MESA_SHADER_CACHE_DIR", cache.to_string_lossy().into_owned())]
}

/// Returns whether the tests run on lavapipe at its default width.
fn applies() -> bool {
    let gpu = Gpu::new();
    let applies = gpu.device().info().driver.starts_with("llvmpipe") && gpu.subgroup_size() == 8;
    if !applies {
        println!("skipped: these tests need lavapipe with 8 lanes");
    }
    applies
}

/// Runs tests of a program at 16 lanes. If they fail, the error is the end of the output.
fn run(name: &str, filters: &[&str]) -> Result<(), String> {
    let mut command = Command::new(program(name));
    command.args(filters).envs(variables()).env_remove("SGS_TEST_LANES");
    let output = command.output().map_err(|e| e.to_string())?;
    let text = format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    if text.contains("running 0 tests") {
        return Err(format!("{name} has no test that matches {filters:?}"));
    }
    if output.status.success() {
        return Ok(());
    }
    let lines: Vec<&str> = text.lines().collect();
    Err(format!("{name} at 16 lanes: {}\n{}", output.status, lines[lines.len().saturating_sub(60)..].join("\n")))
}

/// Lists every program of this folder that needs a device.
fn programs() -> Vec<String> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests");
    let files = std::fs::read_dir(folder).unwrap().flatten();
    let names = files.filter_map(|file| {
        let name = file.file_name().into_string().ok()?;
        let folder = file.path().join("main.rs").is_file();
        if folder { Some(name) } else { Some(name.strip_suffix(".rs")?.to_owned()) }
    });
    let mut names: Vec<String> = names.filter(|name| !WITHOUT_DEVICE.contains(&name.as_str())).collect();
    names.sort_unstable();
    names
}

/// Prints the number of lanes. [`lavapipe_has_16_lanes`] runs this helper.
#[test]
#[ignore = "says how many lanes there are"]
fn says_lanes() {
    println!("lanes: {}", Gpu::new().subgroup_size());
}

#[test]
fn lavapipe_has_16_lanes() {
    if !applies() {
        return;
    }
    let mut command = Command::new(std::env::current_exe().unwrap());
    command.args(["--ignored", "--exact", "--nocapture", "says_lanes"]).envs(variables());
    let output = command.output().unwrap();
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success() && text.contains("lanes: 16"), "{text}{}", String::from_utf8_lossy(&output.stderr));
}

#[test]
fn device_tests_pass_at_16_lanes() {
    if !applies() {
        return;
    }
    let failures: Vec<String> = match std::env::var("SGS_TEST_LANES").as_deref() {
        Ok("all") => programs().iter().filter_map(|name| run(name, &[]).err()).collect(),
        Ok(other) => panic!("SGS_TEST_LANES is \"{other}\"; use all, or leave it unset"),
        Err(_) => DEFAULT.iter().filter_map(|(name, filters)| run(name, filters).err()).collect(),
    };
    assert!(failures.is_empty(), "{}", failures.join("\n\n"));
}

#[test]
fn devices_command_lists_tested_devices_and_lanes() {
    if !applies() {
        return;
    }
    let variables = variables();
    let wide: Vec<(&str, &str)> = variables.iter().map(|(name, value)| (*name, value.as_str())).collect();
    for (environment, lanes) in [(&[][..], 8), (&wide[..], 16)] {
        let listed = sgs_with(&["devices", "--json"], environment).ok().json();
        let devices = listed.as_array().unwrap();
        let lavapipe = devices.iter().find(|d| d["driver"].as_str().unwrap().starts_with("llvmpipe")).unwrap();
        assert_eq!(lavapipe["subgroup_size"], lanes);
        assert_eq!((&lavapipe["tests"], &lavapipe["tested_lanes"]), (&"tested".into(), &vec![8, 16].into()));
        for other in devices.iter().filter(|d| !d["driver"].as_str().unwrap().starts_with("llvmpipe")) {
            assert_eq!(
                (&other["tests"], other["tested_lanes"].as_array().map(Vec::len)),
                (&"not tested".into(), Some(0))
            );
        }
        let text = sgs_with(&["devices"], environment).ok().stdout;
        assert!(text.contains("tested: lavapipe with 8 and 16 lanes"), "{text}");
        assert_eq!(text.matches("not tested: ").count(), devices.len() - 1, "{text}");
    }
}
