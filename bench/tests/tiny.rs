//! End-to-end tests of `engine-bench` at tiny sizes, with Vulkan validation.
//!
//! Every stage must pass its checks, and `--compare` must set the exit status.

use serde_json::Value;
use std::path::Path;
use std::process::{Command, Output};

const TINY: [&str; 8] = ["--gaussians", "2000", "--size", "70x50", "--repeats", "3", "--warmup", "1"];

fn bench(arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_engine-bench"));
    if let Ok(device) = std::env::var("SGS_TEST_DEVICE") {
        command.args(["--device", &device]);
    }
    command.args(arguments).output().unwrap()
}

#[track_caller]
fn succeeds(arguments: &[&str]) -> Value {
    let out = bench(&[arguments, &["--json", "--validate"]].concat());
    assert!(out.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&out.stderr));
    serde_json::from_slice(&out.stdout).unwrap()
}

/// Returns the values of facts whose names have a prefix.
fn facts_of<'r>(report: &'r Value, prefix: &str) -> Vec<&'r Value> {
    let all = report["facts"].as_array().unwrap().iter();
    all.filter(|f| f["name"].as_str().unwrap().starts_with(prefix)).map(|f| &f["value"]).collect()
}

/// Asserts that `front` reproduces the table and plot of the run.
#[track_caller]
fn assert_shown_unchanged(report: &Value, table: &str, drawing: &str) {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_string_lossy().into_owned();
    let (file, own_table, own_drawing) = (path("report.json"), path("table.md"), path("drawing.svg"));
    std::fs::write(&file, report.to_string()).unwrap();
    let scene = format!("scene={}", report["settings"]["scene"].as_str().unwrap());
    let out = bench(&["front", &file, &scene, "--table", &own_table, "--svg", &own_drawing]);
    assert!(out.status.success() && out.stdout.is_empty(), "{}", String::from_utf8_lossy(&out.stderr));
    let read = |path: &str| std::fs::read_to_string(path).unwrap();
    assert_eq!(read(&own_table), read(table));
    assert!(read(&own_drawing) == read(drawing));
    let out = bench(&["front", &file]);
    assert_eq!(String::from_utf8_lossy(&out.stdout), read(table));
    let out = bench(&["front", &file, "scene=nowhere"]);
    let message = String::from_utf8_lossy(&out.stderr).into_owned();
    assert!(out.status.code() == Some(1) && message.contains(&scene), "{message}");
}

fn names(report: &Value) -> Vec<&str> {
    report["passes"].as_array().unwrap().iter().map(|p| p["pass"].as_str().unwrap()).collect()
}

#[test]
fn stages_are_checked_and_have_a_cost_model() {
    let report = succeeds(&[&["passes", "--normals", "--elements", "5003"], &TINY[..]].concat());
    let names = names(&report);
    for stage in [
        "scan.scan_down",
        "project",
        "blend",
        "blend_bwd",
        "blend_bwd_splat",
        "blend_buckets",
        "blend_bwd_bucket",
        "photometric_bwd",
        "adam",
    ] {
        assert!(names.contains(&stage), "{stage} is not among {names:?}");
    }
    for pass in report["passes"].as_array().unwrap() {
        assert!(pass["bytes"].is_number() && pass["operations"].is_number(), "{pass}");
        assert!(pass["nanoseconds"]["samples"] == 3, "{pass}");
    }
    assert_eq!(report["checks"].as_array().unwrap().len(), 28);
    assert!(report["device"]["driver"].as_str().is_some_and(|d| !d.is_empty()));
}

#[test]
fn step_is_measured_traced_and_compared() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_string_lossy().into_owned();
    let trace = path("trace.json");
    let page = path("step.html");
    let step = [&["step", "--normals", "--densify", "--trace", &trace, "--html", &page], &TINY[..]].concat();
    let mut report = succeeds(&step);
    assert!(report["passes"].as_array().unwrap().iter().all(|p| p["bytes"].is_number()));
    let read = |p: &str| serde_json::from_slice::<Value>(&std::fs::read(p).unwrap()).unwrap();
    let events = read(&trace)["traceEvents"].as_array().unwrap().clone();
    assert!(events.iter().any(|e| e["name"] == "project_bwd_adam" && e["dur"].as_f64().unwrap() > 0.0));

    assert!(std::fs::read_to_string(&page).unwrap().contains("of passes, measured"));
    let fact = |name: &str| report["facts"].as_array().unwrap().iter().any(|f| f["name"] == name);
    assert!(fact("host, a replay without its submission, us") && fact("host, the submission of a replay, us"));
    assert!(fact("subgroups of a tile, forward pass") && fact("step: passes, groups, barriers"));

    // No figure is worse than a baseline a hundred times slower; every figure is worse than a faster one.
    for (factor, slower) in [(100.0, false), (1e-3, true)] {
        for list in ["passes", "values"] {
            for row in report[list].as_array_mut().unwrap() {
                let key = if list == "passes" { "nanoseconds" } else { "value" };
                let median = row[key]["median"].as_f64().unwrap();
                row[key]["median"] = Value::from(factor * median);
                row[key]["mad"] = Value::from(0.0);
            }
        }
        let baseline = path("baseline.json");
        std::fs::write(&baseline, report.to_string()).unwrap();
        let out = bench(&[&step[..], &["--compare", &baseline]].concat());
        let message = String::from_utf8_lossy(&out.stderr).into_owned();
        assert_eq!(out.status.code(), Some(i32::from(slower)), "{message}");
        assert_eq!(message.contains("SLOWER geometry_step/"), slower, "{message}");
    }
}

#[test]
fn failures_are_reported_in_one_sentence() {
    let missing = Path::new(env!("CARGO_MANIFEST_DIR")).join("no such folder");
    for (arguments, code) in [
        (vec!["passes", "--filter", "no such stage"], 1),
        (vec!["step", "--scene", missing.to_str().unwrap()], 1),
        (vec!["step", "--size", "0x10"], 2),
        (vec!["ceiling", "--device", "no such device"], 1),
    ] {
        let out = bench(&arguments);
        let message = String::from_utf8_lossy(&out.stderr);
        assert_eq!(out.status.code(), Some(code), "{arguments:?}: {message}");
        assert!(!message.contains("panicked") && (code == 2 || message.lines().count() == 1), "{message}");
    }
}

#[test]
fn script_joins_all_measurements_in_one_file() {
    let folder = tempfile::tempdir().unwrap();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("run-all");
    let mut command = Command::new("sh");
    command.arg(script).args([env!("CARGO_BIN_EXE_engine-bench"), "tiny", "true"]);
    command.env("OUT", folder.path()).env("REPEATS", "2").env("ELEMENTS", "5003");
    command.env("SIZES", "--gaussians 2000 --size 64x48 --warmup 1");
    match std::env::var("SGS_TEST_DEVICE") {
        Ok(device) => command.env("DEVICE", device),
        Err(_) => command.env_remove("DEVICE"),
    };
    let out = command.output().unwrap();
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    let file = folder.path().join("tiny.json");
    let set: Value = serde_json::from_slice(&std::fs::read(&file).unwrap()).unwrap();
    let commands: Vec<_> = set["reports"].as_array().unwrap().iter().map(|r| r["command"].as_str().unwrap()).collect();
    assert_eq!(commands, ["ceiling", "passes", "scaling", "step", "step"]);
    let rates = &set["reports"][0]["ceiling"];
    for name in ["bytes_per_second", "operations_per_second", "atomics_per_second"] {
        assert!(rates[name].as_f64().is_some_and(|rate| rate > 0.0), "{name}: {rates}");
    }
    let table = bench(&["table", file.to_str().unwrap()]);
    let table = String::from_utf8_lossy(&table.stdout).into_owned();
    assert!(table.contains("| step: step by the host's clock | synthetic room, 2000 gaussians, 64x48 |"), "{table}");
    // A failing test program stops the script.
    let mut command = Command::new("sh");
    command.arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("run-all"));
    command.args([env!("CARGO_BIN_EXE_engine-bench"), "failing", "false"]).env("OUT", folder.path());
    assert!(!command.output().unwrap().status.success());
    assert!(!folder.path().join("failing.json").exists());
}

#[test]
fn geometry_tradeoff_is_measured() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_string_lossy().into_owned();
    let (drawing, table) = (path("front.svg"), path("front.md"));
    let all = ["tradeoff", "--filter", "t", "--rounds", "1", "--train", "20", "--svg", &drawing, "--table", &table];
    let report = succeeds(&[&all, &TINY[..]].concat());
    let read = |path: &str| std::fs::read_to_string(path).unwrap();
    assert!(read(&drawing).starts_with("<svg"));
    assert_shown_unchanged(&report, &table, &drawing);
    let rows: Vec<String> = read(&table).lines().skip(2).map(str::to_owned).collect();
    assert!(rows.len() >= 4 && rows[0].starts_with("| exact"), "{rows:?}");
    let value = |name: &str| {
        let row = report["values"].as_array().unwrap().iter().find(|v| v["name"] == name);
        row.unwrap_or_else(|| panic!("no \"{name}\""))["value"]["median"].as_f64().unwrap()
    };
    assert!(value("mean error, exact") < 1e-5);
    // Approximations show in image and gradient errors; exact choices have no error.
    assert!(value("mean error, fast") > 10.0 * value("mean error, exact"));
    assert!(value("gradient error, fast") > 1e-3 && value("gradient error, exact") == 0.0);
    let fact =
        |name: &str| report["facts"].as_array().unwrap().iter().find(|f| f["name"] == name).unwrap()["value"].clone();
    assert!(fact("on the front").as_str().unwrap().len() > 3);
    assert!(fact("standing, exact").is_string() && fact("standing, fast").is_string());
    // Equivalent choices are included but not ranked.
    assert!(facts_of(&report, "standing, tiles of").iter().all(|s| *s == "as exact"));
    assert_eq!(facts_of(&report, "standing, tiles of").len(), 2);
    assert!(!fact("on the front").as_str().unwrap().contains("tiles"));

    // Against a slower baseline with equal errors no figure is worse; a larger error is reported.
    let mut baseline = report.clone();
    let row = |row: &mut Value, factor: f64| {
        row["value"]["median"] = Value::from(factor * row["value"]["median"].as_f64().unwrap());
    };
    // Atomic sums vary in order, sometimes matching that of the exact choice.
    let by_atomics = |r: &&mut Value| r["name"] == "gradient error, backward by atomics";
    let atomics = baseline["values"].as_array_mut().unwrap().iter_mut().find(by_atomics).unwrap();
    atomics["value"]["median"] = Value::from(1e-4);
    for (name, factor, expected) in
        [("step, ", 100.0, "nothing has grown"), ("mean error, fast", 0.5, "GROWN mean error, fast")]
    {
        let rows = baseline["values"].as_array_mut().unwrap().iter_mut();
        rows.filter(|r| r["name"].as_str().unwrap().replace("frame", "step").starts_with(name))
            .for_each(|r| row(r, factor));
        let file = path("baseline.json");
        std::fs::write(&file, baseline.to_string()).unwrap();
        let out = bench(&[&all, &TINY[..], &["--compare", &file]].concat());
        let text = String::from_utf8_lossy(&out.stderr).into_owned();
        assert!(text.contains(expected), "{text}");
        assert_eq!(out.status.code(), Some(i32::from(expected.starts_with("GROWN"))), "{text}");
    }
}

#[test]
fn tradeoff_quality_is_measured_at_test_views() {
    let folder = tempfile::tempdir().unwrap();
    let room = folder.path().join("room");
    let options = sgs_synth::SynthOptions { views: 4, width: 32, height: 24, ..Default::default() };
    sgs_synth::generate(&room, &options, &|_, _| {}).unwrap();
    let (room, table) = (room.to_string_lossy(), folder.path().join("front.md").to_string_lossy().into_owned());
    let what = ["tradeoff", "--scene", &room, "--filter", "t", "--quality", "12", "--table", &table];
    let report = succeeds(&[&what[..], &["--rounds", "1", "--train", "2", "--repeats", "1", "--warmup", "1"]].concat());
    let facts = report["facts"].as_array().unwrap();
    let fact = |name: &str| facts.iter().find(|f| f["name"] == name).map(|f| f["value"].as_f64().unwrap());
    let (exact, fast) = ("images after training, exact, dB", "images after training, fast, dB");
    assert!(fact(exact).unwrap() > 5.0 && fact(fast).unwrap() > 5.0 && fact(exact) != fact(fast));
    assert!((1.0..180.0).contains(&fact("normals after training, exact, degrees").unwrap()));
    // Other tile sizes give the same result and are requested by a setting.
    let text = std::fs::read_to_string(&table).unwrap();
    assert_eq!(text.matches("| `train.tile_rows=").count(), 2, "{text}");
    let name = |fact: &serde_json::Value| fact["name"].as_str().unwrap().to_owned();
    let tiles: Vec<_> = facts.iter().filter(|f| name(f).starts_with("images after training, tiles of")).collect();
    let same = |f: &&serde_json::Value| (f["value"].as_f64().unwrap() - fact(exact).unwrap()).abs() < 0.2;
    assert!(tiles.len() == 2 && tiles.iter().all(same), "{text}");
    // With classes the image has features as channels. An error appears in the gradient and in the image.
    let what = ["tradeoff", "--scene", &room, "--semantics", "--filter", "colors", "--rounds", "1", "--train", "2"];
    let report = succeeds(&[&what[..], &["--repeats", "1", "--warmup", "1"]].concat());
    let values = report["values"].as_array().unwrap();
    let value = |name: &str| values.iter().find(|v| v["name"] == name).map(|v| v["value"]["median"].as_f64().unwrap());
    let own = value("gradient error, colors in 16 bits").unwrap();
    assert!(own > 1e-6 && own < 0.5, "{own}");
    assert!(value("mean error, colors in 16 bits") > value("mean error, exact"));
    let refused = bench(&["tradeoff", "--stage", "intrinsic", "--scene", &room, "--semantics"]);
    let message = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert!(refused.status.code() == Some(1) && message.contains("--semantics is for --stage geometry"), "{message}");
    let refused = bench(&["tradeoff", "--quality", "2"]);
    let message = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert!(refused.status.code() == Some(1) && message.contains("--quality needs --scene"), "{message}");
}

#[test]
fn intrinsic_tradeoff_is_measured() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_string_lossy().into_owned();
    let (drawing, table, config) = (path("front.svg"), path("front.md"), path("small.toml"));
    let small = "[intrinsic.lights]\ngrid = 1\n[intrinsic.environment]\nresolution = 16\n[intrinsic.visibility]\n\
                 levels = 4\nlog2_table = 8\ncoarsest = 4\nfinest = 32\n";
    std::fs::write(&config, small).unwrap();
    let what = ["tradeoff", "--stage", "intrinsic", "--config", &config, "--filter", "fast, culled", "--quality", "2"];
    let how =
        ["--rounds", "1", "--train", "2", "--size", "24x18", "--repeats", "1", "--svg", &drawing, "--table", &table];
    let report = succeeds(&[&what[..], &how].concat());
    let read = |path: &str| std::fs::read_to_string(path).unwrap();
    assert!(read(&drawing).contains("error of gradients"));
    assert_shown_unchanged(&report, &table, &drawing);
    let rows: Vec<String> = read(&table).lines().skip(2).map(str::to_owned).collect();
    assert!(
        rows.len() == 2 && rows[0].starts_with("| exact") && rows[1].starts_with("| fast, culled, half size"),
        "{rows:?}"
    );
    let value = |name: &str| {
        let row = report["values"].as_array().unwrap().iter().find(|v| v["name"] == name);
        row.unwrap_or_else(|| panic!("no \"{name}\""))["value"]["median"].as_f64().unwrap()
    };
    assert!(value("mean error, exact") < 1e-5 && value("gradient error, exact") == 0.0);
    // A quarter of the pixels gives other gradients; a sample of pairs gives other gradients of the field.
    assert!(value("gradient error, fast, culled, half size") > 1e-3);
    assert!(value("gradient error of the field, fast, culled, half size") > 1e-2);
    let facts = report["facts"].as_array().unwrap();
    let fact = |name: &str| &facts.iter().find(|f| f["name"] == name).unwrap()["value"];
    assert!(fact("albedo after training, fast, culled, half size, dB").as_f64().unwrap() > 3.0);
    assert!(fact("standing, fast, culled, half size").is_string() && fact("standing, exact") != "as exact");
}

/// Measures unranked choices besides ranked ones.
///
/// Unranked are choices of other models and choices that affect later steps only.
#[test]
fn intrinsic_choices_of_every_kind_are_measured() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_string_lossy().into_owned();
    let (room, table, config, baseline) = (path("room"), path("front.md"), path("tiny.toml"), path("baseline.json"));
    let size = sgs_synth::SynthOptions { views: 2, test_views: 1, width: 24, height: 18, ..Default::default() };
    let options = sgs_synth::SynthOptions { points: 500, samples_per_pixel: 16, relit: false, ..size };
    sgs_synth::generate(Path::new(&room), &options, &|_, _| {}).unwrap();
    let tiny = "[intrinsic.lights]\ngrid = 2\nlobes = 2\n[intrinsic.environment]\nresolution = 16\n\
                [intrinsic.visibility]\nlevels = 2\nlog2_table = 8\ncoarsest = 4\nfinest = 16\n";
    std::fs::write(&config, tiny).unwrap();
    let all = ["tradeoff", "--stage", "intrinsic", "--scene", &room, "--config", &config, "--train", "2"];
    let how = [&all[..], &["--rounds", "1", "--repeats", "1", "--table", &table]].concat();
    let fact = |report: &Value, name: &str| {
        report["facts"].as_array().unwrap().iter().find(|f| f["name"] == name).map(|f| f["value"].clone())
    };
    let number = |report: &Value, name: &str| {
        let row = report["values"].as_array().unwrap().iter().find(|v| v["name"] == name);
        row.map(|r| r["value"]["median"].as_f64().unwrap())
    };

    // Another model has quality after training, but no gradient error.
    let models = succeeds(&[&how[..], &["--filter", "fewer lights", "--quality", "3"]].concat());
    for (name, ranked) in [("exact", true), ("fewer lights", false)] {
        for what in ["shaded images", "albedo"] {
            let db = fact(&models, &format!("{what} after training, {name}, dB")).unwrap();
            assert!(db.as_f64().unwrap() > 1.0, "{what}, {name}: {db}");
        }
        assert_eq!(fact(&models, &format!("standing, {name}")).is_some(), ranked, "{name}");
        assert_eq!(number(&models, &format!("gradient error, {name}")).is_some(), ranked, "{name}");
    }
    assert!(number(&models, "step, fewer lights, of exact").unwrap() > 0.0);
    assert_eq!(fact(&models, "steps of a training of its own"), Some(3.into()));
    // The common settings are recorded.
    let settings = models["settings"]["settings"].as_str().unwrap();
    assert!(
        settings.contains("intrinsic.lights.lobes=2") && models["settings"]["filter"] == "fewer lights",
        "{settings}"
    );

    // An environment map updated every few steps has no gradient in a single step and no standing. A sample of pairs
    // shows in the error. Standings among different choices are not compared.
    std::fs::write(&baseline, models.to_string()).unwrap();
    let arguments = ["--filter", "4", "--json", "--validate", "--compare", &baseline, "--tolerance", "1000"];
    let out = bench(&[&how[..], &arguments].concat());
    let message = String::from_utf8_lossy(&out.stderr).into_owned();
    assert!(out.status.success() && message.contains("how they stand among each other is not compared"), "{message}");
    let report: Value = serde_json::from_slice(&out.stdout).unwrap();
    assert_eq!(fact(&report, "standing, environment every 4"), None);
    assert_eq!(fact(&report, "not in the gradient error, environment every 4"), Some("environment".into()));
    assert_eq!(fact(&report, "not in the gradient error, one pair of 4"), None);
    assert!(fact(&report, "standing, one pair of 4").is_some_and(|s| s.is_string()));
    assert!(number(&report, "gradient error of the field, one pair of 4").unwrap() > 1e-2);
    let text = std::fs::read_to_string(&table).unwrap();
    assert!(text.lines().any(|l| l.starts_with("| environment every 4 |") && l.contains(", without environment |")));
}

#[test]
fn savings_are_measured_with_and_without() {
    let report = succeeds(&[
        "savings",
        "--size",
        "50x30",
        "--repeats",
        "2",
        "--warmup",
        "1",
        "--steps",
        "2",
        "--cull-error",
        "0.05",
    ]);
    let rows: Vec<&str> = report["values"].as_array().unwrap().iter().map(|v| v["name"].as_str().unwrap()).collect();
    assert!(rows.len() == 18 && rows.iter().filter(|r| r.ends_with(": without")).count() == 9, "{rows:?}");
    let faster = |f: &&Value| f["name"].as_str().unwrap().ends_with("times faster");
    let facts = report["facts"].as_array().unwrap();
    assert!(facts.iter().filter(faster).all(|f| f["value"].as_f64().unwrap() > 0.0));
    assert_eq!(report["checks"].as_array().unwrap().len(), 5);
    let alone = succeeds(&["savings", "--size", "20x10", "--repeats", "1", "--warmup", "1", "--steps", "0"]);
    assert_eq!(alone["values"].as_array().unwrap().len(), 14);
}

/// A driver that reports statistics of kernels has them in the report. Others are refused before anything is measured.
#[test]
fn statistics_of_kernels_are_reported_or_refused() {
    let out = bench(&[&["step"][..], &TINY, &["--kernels", "--json"]].concat());
    if out.status.success() {
        let report: Value = serde_json::from_slice(&out.stdout).unwrap();
        assert!(facts_of(&report, "kernel blend,").iter().any(|f| f.as_str().is_some_and(|text| !text.is_empty())));
        return;
    }
    let error = String::from_utf8_lossy(&out.stderr);
    assert_eq!(out.status.code(), Some(1), "{error}");
    assert!(error.ends_with(" reports no statistics of kernels; leave --kernels out.\n"), "{error}");
    assert!(out.stdout.is_empty());
}

/// Path of a file of the repository.
fn repository(path: &str) -> String {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap().join(path).display().to_string()
}

#[test]
fn batch_of_ten_thousand_rooms_is_near_the_lower_bound() {
    let times = repository("bench/results/batch/summary.jsonl");
    let what = ["batch", "--simulate", "10000", "--devices", "256", "--times", &times, "--seed", "3"];
    let figures = |more: &[&str]| succeeds(&[&what[..], more].concat())["figures"][0].clone();
    let number = |f: &Value, key: &str| f[key].as_f64().unwrap();
    // Measured times and rates; then runs of half an hour with cautious rates.
    for more in [&[][..], &["--cautious", "--mean", "1800"]] {
        let f = figures(more);
        assert_eq!(number(&f, "done") + number(&f, "failed"), 10_000.0, "{f}");
        assert!((1.0..1.1).contains(&number(&f, "ratio")), "{f}");
        assert!(number(&f["loss"], "ratio") < 1.1 && f["loss"]["workers"] == 26, "{f}");
        assert_eq!(f, figures(more), "one seed gave two results");
        assert_ne!(f, figures(&[more, &["--distribution", "lognormal"]].concat()));
    }
    // The first version overloads the disk and stops training for its summaries.
    let first = figures(&["--protocol", "first"]);
    assert!(number(&first, "ratio") > 2.0 && first["broken"].is_string(), "{first}");
    for (wrong, code, word) in [
        (vec!["--failures", "temporary=2"], 1, "temporary is 2"),
        (vec!["--failures", "sometimes=0.1"], 1, "unknown rate"),
        (vec!["--failures", "none.toml"], 1, "cannot be read"),
        (vec!["--mean=-1"], 2, "above 0"),
        (vec!["--run", "nowhere"], 1, "nowhere"),
    ] {
        let out = bench(&[&what[..], &wrong].concat());
        let message = String::from_utf8_lossy(&out.stderr);
        assert!(out.status.code() == Some(code) && message.contains(word), "{wrong:?}: {message}");
        assert!(out.stdout.is_empty() && !message.contains("panicked"), "{message}");
    }
}

/// The real queue over sleeping processes trains each run once.
#[test]
fn rehearsed_queue_is_as_fast_as_simulated() {
    let folder = tempfile::tempdir().unwrap();
    let (times, root) = (repository("bench/results/batch/summary.jsonl"), folder.path().join("rehearsal"));
    let root = root.to_str().unwrap();
    let what = ["batch", "--simulate", "24", "--devices", "4", "--times", &times, "--mean", "0.5"];
    let answer = succeeds(&[&what[..], &["--failures", "temporary=0.1", "--rehearse", root]].concat());
    let (real, simulated) = (&answer["rehearsal"], &answer["figures"][0]);
    assert_eq!(real["ended"], 24);
    let bound = simulated["lower_bound"].as_f64().unwrap();
    let end = real["end"].as_f64().unwrap();
    assert!(end > bound && end < 10.0 * bound + 10.0, "{answer}");
    let again = bench(&[&what[..], &["--rehearse", root]].concat());
    assert_eq!(again.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&again.stderr).contains("name a new directory"));
}
