//! The transport stage: refusals, files, resuming, and removal with its materials.

use serde_json::{Value, json};
use sgs_config::{Settings, TransportSettings};
use sgs_run::{RunDirectory, StageKind, read_emitters};
use sgs_scene::{Image, Scene, SceneOptions, Splats, write_exr};
use sgs_tests::cli::{Finished, sgs, signal, start, until, wait};
use sgs_tests::rooms::Room;
use sgs_tests::{Gpu, Place, files};
use sgs_train::{Requirement, StartGeometry, TrainError, Trainer, TrainerOptions};
use std::sync::Arc;

/// Synthesizes a small room.
fn place() -> Place {
    let place = Place::new(Room::default());
    std::fs::remove_dir_all(place.path("scene")).unwrap();
    sgs(&["synth", &place.text("scene"), "--scene", "box", "--views", "8", "--size", "32x24"]).ok();
    place
}

fn train(place: &Place, more: &[&str]) -> Finished {
    let (scene, run) = (place.text("scene"), place.text("run"));
    let fixed = ["train", &scene, "-o", &run];
    let small = [
        "intrinsic.environment.resolution=16",
        "intrinsic.lights.grid=2",
        "intrinsic.visibility.levels=2",
        "intrinsic.visibility.log2_table=8",
        "transport.steps=0",
    ];
    let small = if more.contains(&"--resume") { &[][..] } else { &small[..] };
    let sets = small.iter().flat_map(|pair| ["--set", pair]);
    let all: Vec<&str> = fixed.into_iter().chain(sets).chain(more.iter().copied()).collect();
    sgs(&all)
}

/// Trains geometry and materials.
fn materials(place: &Place) {
    train(place, &["--geometry-steps", "20", "--no-densify", "--intrinsic-steps", "2"]).ok();
    train(place, &["--stage", "intrinsic"]).ok();
}

fn summary(place: &Place) -> serde_json::Value {
    serde_json::from_slice(&place.read("run/training.json")).unwrap()
}

/// The stage needs no intrinsic stage, and trains geometry that a run lacks.
#[test]
fn stage_trains_geometry_first_and_starts_from_priors() {
    let place = place();
    let small = ["--set", "transport.surfels=256", "--geometry-steps", "3", "--no-densify"];
    train(&place, &["--stage", "transport", "--set", "transport.surfels=0"])
        .refused_with(2, &["transport.surfels is 0"]);
    assert!(!place.path("run").exists(), "a refused stage made a directory");
    train(&place, &[&["--stage", "transport"][..], &small].concat()).ok();
    let run = RunDirectory::open(&place.path("run")).unwrap();
    let complete = run.complete(&run.settings().unwrap());
    assert_eq!(complete, [StageKind::Geometry, StageKind::Transport]);
    assert!(run.emitters().is_file() && !run.path("lights.json").exists());
    let before = files(&place.path("run"));
    let resumed = train(&place, &["--stage", "transport", "--resume"]).ok();
    assert!(resumed.stderr.contains("nothing to do") && files(&place.path("run")) == before, "{}", resumed.stderr);
    // Materials start from their priors: those of a run change nothing.
    let first = Splats::read_ply(&run.path("scene.ply")).unwrap();
    assert!(first.albedo.is_some() && first.roughness.is_some() && first.emitters.is_some());
    train(&place, &["--stage", "intrinsic", "--intrinsic-steps", "2"]).ok();
    assert!(Splats::read_ply(&run.path("scene.ply")).unwrap() != first);
    train(&place, &["--stage", "transport"]).ok();
    assert!(Splats::read_ply(&run.path("scene.ply")).unwrap() == first);
    let start = place.text("run/scene.ply");
    train(&place, &["--stage", "transport", "--start", &start]).refused_with(2, &["--stage intrinsic"]);
}

/// Reads `training.json` of a run of all stages.
fn all_stages(place: &Place, more: &[&str]) -> Value {
    let steps = ["--stage", "all", "--geometry-steps", "3", "--no-densify", "--intrinsic-steps", "2", "--force"];
    train(place, &[&steps[..], more].concat()).ok();
    summary(place)
}

#[test]
fn all_stages_end_with_bounced_light_where_it_explains_the_photographs() {
    let place = place();
    let there = |name: &str| place.path(&format!("run/{name}")).exists();
    let trained = all_stages(&place, &["--set", "transport.surfels=256"]);
    let decision = &trained["transport"]["decisions"][0];
    assert_eq!((&decision["what"], &decision["setting"]), (&"bounced light".into(), &"--stage transport".into()));
    assert_eq!((decision["on"].as_bool(), there("emitters.json")), (Some(true), true), "{decision}");
    assert!(there("lights.json") && trained["intrinsic"].is_object());
    let resumed = train(&place, &["--stage", "all", "--resume"]).ok();
    assert!(resumed.stderr.contains("nothing to do"), "{}", resumed.stderr);
    // The published model has no physical emitters.
    let trained = all_stages(&place, &["--preset", "parity"]);
    assert!(!there("emitters.json") && trained.get("transport").is_none() && trained["intrinsic"].is_object());
    // Photographs of uniform light: each pixel shows a gray albedo.
    for kind in ["images", "priors/albedo"] {
        for file in std::fs::read_dir(place.path(&format!("scene/{kind}"))).unwrap() {
            let path = file.unwrap().path();
            image::RgbImage::from_pixel(32, 24, image::Rgb([120; 3])).save(&path).unwrap();
        }
    }
    let trained = all_stages(&place, &["--set", "transport.surfels=256"]);
    let decision = &trained["transport"]["decisions"][0];
    assert_eq!((decision["on"].as_bool(), there("emitters.json")), (Some(false), false), "{decision}");
    assert!(Splats::read_ply(&place.path("run/scene.ply")).unwrap().emitters.is_none());
    train(&place, &["--stage", "all", "--resume"]).ok();
    // Asked for alone, the stage is trained.
    train(&place, &["--stage", "transport", "--force"]).ok();
    assert!(there("emitters.json"));
}

#[test]
fn stage_writes_emitters_and_keeps_materials() {
    let place = place();
    materials(&place);
    let splats = || Splats::read_ply(&place.path("run/scene.ply")).unwrap();
    let (before, trained) = (splats(), summary(&place));
    let output = train(&place, &["--stage", "transport", "--set", "transport.surfels=512"]).ok();
    assert!(output.stderr.contains("emitters, PSNR") && output.stderr.contains("wrote"), "{}", output.stderr);
    let (run, after) = (RunDirectory::open(&place.path("run")).unwrap(), splats());
    let file = read_emitters(&run.emitters()).unwrap();
    assert_eq!((file.surfels, file.rays), (512, 64));
    let emitters = after.emitters.clone().unwrap();
    assert!(emitters.iter().all(|e| *e as usize <= file.emitters.len()));
    let Splats { albedo, roughness, metallic, .. } = before.clone();
    let same = Splats { emitters: None, albedo, roughness, metallic, ..after };
    assert!(same == before, "the stage changed more than materials");
    let settings = run.settings().unwrap();
    assert_eq!((settings.transport.surfels, settings.geometry.steps, settings.intrinsic.steps), (512, 20, 2));
    let all = StageKind::ALL.to_vec();
    assert_eq!(run.complete(&settings), all);
    let mut summary = summary(&place);
    let own = summary.as_object_mut().unwrap().remove("transport").unwrap();
    assert_eq!(summary, trained, "the summaries of earlier stages stay");
    assert!(own["psnr"].is_number() && own["seconds"].as_f64().unwrap() > 0.0, "{own}");
    assert_eq!((&own["steps"], own["emitters"].as_u64()), (&1.into(), Some(file.emitters.len() as u64)));
    let log = String::from_utf8(place.read("run/log.jsonl")).unwrap();
    let last: serde_json::Value = serde_json::from_str(log.lines().last().unwrap()).unwrap();
    assert_eq!((&last["stage"], &last["step"], &last["psnr"]), (&"transport".into(), &1.into(), &own["psnr"]));

    // A finished stage stays.
    let before = files(&place.path("run"));
    train(&place, &["--stage", "transport"]).refused_with(2, &["has emitters", "--force"]);
    for stage in ["transport", "intrinsic", "all"] {
        let resumed = train(&place, &["--stage", stage, "--resume"]).ok();
        assert!(resumed.stderr.contains("nothing to do"), "{}", resumed.stderr);
    }
    assert!(files(&place.path("run")) == before);
    // The checkpoint restores a stage whose results were not written.
    std::fs::remove_file(run.emitters()).unwrap();
    run.write_json("training.json", &summary).unwrap();
    train(&place, &["--stage", "transport", "--resume"]).ok();
    let again = files(&place.path("run"));
    let same = |name: &str| again[&run.path(name)] == before[&run.path(name)];
    assert!(["emitters.json", "scene.ply", "log.jsonl", "config.toml"].into_iter().all(same));
    // The result depends on nothing else.
    train(&place, &["--stage", "transport", "--set", "transport.surfels=512", "--force"]).ok();
    let again = files(&place.path("run"));
    assert!(["emitters.json", "scene.ply"].iter().all(|name| again[&run.path(name)] == before[&run.path(name)]));

    // Results of the stage go with their materials.
    train(&place, &["--stage", "intrinsic", "--intrinsic-steps", "2", "--force"]).ok();
    let gone = || !run.emitters().exists() && !run.checkpoint(StageKind::Transport).exists();
    assert!(gone() && splats().emitters.is_none() && splats().albedo.is_some());
    assert!(self::summary(&place).get("transport").is_none());
    train(&place, &["--stage", "transport", "--resume"]).ok();
    assert!(!gone() && splats().emitters.is_some());
    train(&place, &["--geometry-steps", "3", "--no-densify", "--force"]).ok();
    assert!(gone() && splats().emitters.is_none());
    assert!(!String::from_utf8(place.read("run/log.jsonl")).unwrap().contains("transport"));
}

/// A training that is killed twice ends with the files of one that is not.
#[test]
fn training_of_materials_resumes_bit_by_bit() {
    let place = place();
    materials(&place);
    let before = Splats::read_ply(&place.path("run/scene.ply")).unwrap();
    let whole =
        ["--set", "transport.steps=24", "--set", "transport.surfels=256", "--set", "train.checkpoint_interval=4"];
    let stage = [&["--stage", "transport"][..], &whole].concat();
    let copy = |name: &str| {
        std::fs::create_dir(place.path(name)).unwrap();
        for (from, bytes) in files(&place.path("run")) {
            let to = place.path(name).join(from.strip_prefix(place.path("run")).unwrap());
            std::fs::create_dir_all(to.parent().unwrap()).unwrap();
            std::fs::write(to, bytes).unwrap();
        }
    };
    copy("killed");
    train(&place, &stage).ok();
    let (scene, killed) = (place.text("scene"), place.text("killed"));
    let begin = [&["train", &scene, "-o", &killed, "-q"][..], &stage].concat();
    let resume = ["train", &scene, "-o", &killed, "-q", "--stage", "transport", "--resume"];
    for (arguments, step) in [(&begin[..], 9), (&resume[..], 17)] {
        let arguments: Vec<String> = arguments.iter().map(|a| (*a).to_owned()).collect();
        let mut child = start(&arguments);
        let saved = || {
            let log = std::fs::read_to_string(place.path("killed/log.jsonl")).unwrap_or_default();
            let of = |line: &str| serde_json::from_str::<serde_json::Value>(line).unwrap_or_default();
            let last = log
                .lines()
                .map(of)
                .filter(|l| l["stage"] == "transport")
                .filter_map(|l| l["step"].as_u64())
                .next_back();
            last >= Some(step)
        };
        assert!(until(&mut child, saved), "it ended before step {step}");
        signal(&child, "KILL");
        wait(child);
    }
    sgs(&resume).ok();
    for name in ["scene.ply", "emitters.json", "log.jsonl", "config.toml"] {
        let [a, b] = ["run", "killed"].map(|run| place.read(&format!("{run}/{name}")));
        assert!(a == b, "{name} differs");
    }
    let log = String::from_utf8(place.read("run/log.jsonl")).unwrap();
    let last: serde_json::Value = serde_json::from_str(log.lines().last().unwrap()).unwrap();
    assert_eq!((&last["stage"], &last["step"]), (&"transport".into(), &25.into()), "{log}");
    // Materials and gains are trained; all else keeps its bits.
    let after = Splats::read_ply(&place.path("run/scene.ply")).unwrap();
    assert!(after.albedo != before.albedo && after.light_gains.as_ref().is_some_and(|g| g.iter().all(|g| *g > 0.0)));
    let Splats { albedo, roughness, metallic, .. } = after.clone();
    assert!(
        Splats {
            albedo,
            roughness,
            metallic,
            light_gains: after.light_gains.clone(),
            emitters: after.emitters.clone(),
            ..before
        } == after
    );
    assert_eq!(summary(&place)["transport"]["steps"], 25);
    // A checkpoint that says another step is refused.
    let path = place.path("killed/checkpoint/transport.safetensors");
    let bytes = std::fs::read(&path).unwrap();
    let text = b"\"step\":\"25\"";
    let at = bytes.windows(text.len()).position(|w| w == text).unwrap();
    let mut wrong = bytes.clone();
    wrong[at + 8..at + 10].copy_from_slice(b"24");
    std::fs::write(&path, wrong).unwrap();
    std::fs::remove_file(place.path("killed/training.json")).unwrap();
    sgs(&resume).refused(&["damaged", "step 24"]);
}

/// Writes the emitters that the scene names.
fn write_known(place: &Place, emitters: &Value, openings: &Value) {
    let file = json!({"format": "sgs-emitters-1", "emitters": emitters, "openings": openings});
    std::fs::write(place.path("scene/emitters.json"), file.to_string()).unwrap();
}

/// Returns an emitter of each type that can be fitted.
fn known() -> Value {
    json!([
        {"name": "point", "shape": {"type": "point", "position": [0.5, 0.5, 0]}},
        {"name": "bulb", "shape": {"type": "sphere", "center": [0, 0.8, 0], "radius": 0.05}},
        {"name": "panel", "shape": {"type": "rectangle", "corner": [-0.5, 0.9, -0.5], "edge_u": [1, 0, 0], "edge_v": [0, 0, 1]}},
        {"name": "disk", "shape": {"type": "disk", "center": [0, -0.5, 0.8], "normal": [0, 0, -1], "radius": 0.2}},
        {"name": "spot", "shape": {"type": "spot", "position": [0, 0.5, 0], "axis": [0, -1, 0], "inner_angle": 20.0, "outer_angle": 40.0}},
        {"name": "sun", "shape": {"type": "directional", "direction": [-1, -1, 0], "angular_radius": 0.27}},
        {"name": "lobe", "shape": {"type": "lobe", "position": [0, 0, -0.5], "axis": [0, 0, 1], "sharpness": 4.0}},
        {"name": "off", "on": false, "shape": {"type": "point", "position": [0, 0, 0]}},
    ])
}

#[test]
fn emitters_that_the_scene_names_are_fitted_and_trained() {
    let place = place();
    let pane = json!([{"corner": [1, 0, -0.5], "edge_u": [0, 0.5, 0], "edge_v": [0, 0, 1]}]);
    write_known(&place, &known(), &pane);
    let small =
        ["--set", "transport.surfels=256", "--geometry-steps", "20", "--no-densify", "--set", "transport.steps=3"];
    let output = train(&place, &[&["--stage", "transport"][..], &small].concat()).ok();
    assert!(output.stderr.contains("7 emitters of \"") && output.stderr.contains("emitters.json"), "{}", output.stderr);
    let run = RunDirectory::open(&place.path("run")).unwrap();
    let file = read_emitters(&run.emitters()).unwrap();
    let names: Vec<&str> = file.emitters.iter().map(|e| e.name.as_str()).collect();
    assert_eq!(names, ["point", "bulb", "panel", "disk", "spot", "sun", "lobe"]);
    let shapes: Vec<Value> =
        file.emitters.iter().map(|e| serde_json::to_value(e.shape).unwrap()["type"].clone()).collect();
    assert_eq!(shapes, ["point", "sphere", "rectangle", "disk", "spot", "directional", "lobe"]);
    assert_eq!((file.openings.len(), file.openings[0].corner), (1, [1.0, 0.0, -0.5]));
    assert!(file.emitters.iter().flat_map(|e| e.color).all(|c| c.is_finite() && c >= 0.0));
    let lit = file.emitters.iter().filter(|e| e.color.iter().sum::<f32>() > 0.01).count();
    assert!(lit >= 2, "{:?}", file.emitters);
    assert_eq!(
        (&summary(&place)["transport"]["emitters"], &summary(&place)["transport"]["steps"]),
        (&7.into(), &4.into())
    );
    // The checkpoint holds the fit: the scene's file is not read again.
    let before = files(&place.path("run"));
    std::fs::write(place.path("scene/emitters.json"), "{").unwrap();
    std::fs::remove_file(run.emitters()).unwrap();
    std::fs::remove_file(place.path("run/training.json")).unwrap();
    train(&place, &["--stage", "transport", "--resume"]).ok();
    let after = files(&place.path("run"));
    assert!(["emitters.json", "scene.ply"].iter().all(|name| after[&run.path(name)] == before[&run.path(name)]));
}

#[test]
fn emitters_that_cannot_be_fitted_are_refused_before_training() {
    let place = place();
    let window = json!([{"name": "pane", "shape": {"type": "window", "corner": [0, 0, 0], "edge_u": [1, 0, 0], "edge_v": [0, 1, 0]}}]);
    let refused = |words: &[&str]| {
        for stage in ["transport", "all"] {
            train(&place, &["--stage", stage]).refused_with(42, words);
        }
        sgs(&["plan", &place.text("scene"), "--stage", "transport"]).refused_with(42, words);
        assert!(!place.path("run").exists(), "a refused training made a directory");
    };
    write_known(&place, &window, &json!([]));
    refused(&["\"pane\" is a window", "emitters.json"]);
    write_known(&place, &json!([known()[5]]), &json!([]));
    refused(&["\"sun\"", "\"openings\""]);
    write_known(&place, &json!([known()[7]]), &json!([]));
    refused(&["no emitter is on"]);
    std::fs::write(place.path("scene/emitters.json"), "{\n\"format\": 1}").unwrap();
    refused(&["emitters.json, line 2", "expected a string"]);
    std::fs::write(place.path("scene/emitters.json"), b"\xff").unwrap();
    train(&place, &["--stage", "transport"]).refused_with(1, &["cannot read", "emitters.json"]);
    // Geometry needs no emitters.
    train(&place, &["--geometry-steps", "3", "--no-densify"]).ok();
    // The plan has room for all emitters.
    let point =
        |i: usize| json!({"name": i.to_string(), "shape": {"type": "point", "position": [0.01 * i as f64, 0, 0]}});
    let plan = |count: usize| {
        write_known(&place, &(0..count).map(point).collect::<Vec<_>>().into(), &json!([]));
        let planned = sgs(&["--json", "plan", &place.text("scene"), "--stage", "transport"]).ok().json();
        planned["emitters"].clone()
    };
    assert_eq!([plan(3), plan(40)], [16, 40]);
}

#[test]
fn library_names_what_is_missing() {
    let (gpu, place) = (Gpu::new(), place());
    let scene = Arc::new(Scene::open(&place.path("scene"), &SceneOptions::default()).unwrap());
    let splats = Splats::from_points(&scene.points, 0).unwrap();
    let run = |start: Option<Splats>, settings: &Settings| {
        let start = start.map(|splats| StartGeometry::Splats(Box::new(splats)));
        let options = TrainerOptions { stages: vec![StageKind::Transport], start, ..Default::default() };
        let mut trainer = Trainer::new(gpu.device(), Arc::clone(&scene), settings, options).unwrap();
        trainer.run(&mut ()).unwrap_err()
    };
    assert!(matches!(run(None, &Settings::default()), TrainError::Requirement(Requirement::Geometry)));
    let none = Settings { transport: TransportSettings { surfels: 0, ..Default::default() }, ..Default::default() };
    assert!(matches!(run(Some(splats), &none), TrainError::Requirement(Requirement::Surfels)));
    assert!(matches!(
        run(Some(Splats::default()), &Settings::default()),
        TrainError::Requirement(Requirement::NotEmpty)
    ));
}

/// Sets: the lights of the photographs, none of them, and one more.
#[test]
fn report_shows_a_view_as_in_each_relit_set() {
    let place = place();
    materials(&place);
    train(&place, &["--stage", "transport", "--set", "transport.surfels=512", "--set", "transport.steps=2"]).ok();
    let read = |name: &str| serde_json::from_slice::<Value>(&place.read(name)).unwrap();
    let mut lights = read("scene/gt/lights.json");
    let same = lights["training"].as_array().unwrap().clone();
    let (mut off, mut new) = (same.clone(), same.clone());
    off.iter_mut().for_each(|light| light["on"] = false.into());
    new.push(json!({"name": "new", "on": true, "position": [0, 1, 0.5], "radius": 0.05, "radiance": [50, 90, 200]}));
    lights["relight"] = json!({"new": new, "off": off, "same": same});
    std::fs::write(place.path("scene/gt/lights.json"), lights.to_string()).unwrap();
    let truth = Image { width: 32, height: 24, channels: 3, data: vec![0.2; 3 * 32 * 24] };
    let split = read("scene/split.json");
    let stems: Vec<&str> = split["test"].as_array().unwrap().iter().map(|stem| stem.as_str().unwrap()).collect();
    for set in ["new", "off", "same"] {
        std::fs::create_dir_all(place.path(&format!("scene/gt/relit/{set}"))).unwrap();
        for stem in &stems {
            write_exr(&place.path(&format!("scene/gt/relit/{set}/{stem}.exr")), &truth, &["R", "G", "B"]).unwrap();
        }
    }
    let (run, page) = (place.text("run"), place.text("page.html"));
    sgs(&["report", &run, "-o", &page]).ok();
    let measured = read("run/metrics.json")["test"]["mean"]["relit_bounces"].clone();
    let learned = |set: &str| measured[set]["learned_emitters"].as_f64().unwrap();
    assert!((learned("new") - learned("same")).abs() > 0.1, "the new light changes nothing: {measured}");
    assert!((learned("off") - learned("same")).abs() > 0.1, "switching off changes nothing: {measured}");
    let html = String::from_utf8(place.read("page.html")).unwrap();
    let section = html.split("<section id=\"relit\">").nth(1).and_then(|s| s.split("</section>").next()).unwrap();
    let count = |text: &str| section.matches(text).count();
    assert_eq!(["photograph", "relit", "truth"].map(|name| count(&format!("<figcaption>{name}"))), [3; 3]);
    for set in ["new", "off", "same"] {
        assert!(section.contains(&format!("<h3>{set}</h3>")), "{set}");
        assert_eq!(count(&format!(", {:.2} dB in the mean", learned(set))), 1, "{set}: {measured}");
    }
}

#[test]
fn relight_edits_emitters() {
    let place = place();
    materials(&place);
    let (run, edit) = (place.text("run"), place.text("edit.json"));
    let relight = |text: &str, more: &[&str]| {
        std::fs::write(place.path("edit.json"), text).unwrap();
        let images = place.text("images");
        let fixed = ["relight", &run, "--edit", &edit, "-o", &images, "--force", "--format", "exr"];
        sgs(&[&fixed[..], more].concat())
    };
    relight(r#"{"emitters": {"off": true}}"#, &[]).refused_with(2, &["no emitters", "--stage transport"]);
    train(&place, &["--stage", "transport", "--set", "transport.surfels=512"]).ok();
    // Mean of all linear values of the images.
    let light = |text: &str| {
        relight(text, &[]).ok();
        let files = std::fs::read_dir(place.path("images")).unwrap().map(|f| f.unwrap().path());
        let images: Vec<_> = files.map(|path| sgs_scene::read_exr(&path).unwrap()).collect();
        let values: Vec<f32> = images.iter().flat_map(|exr| exr.image.data.iter().copied()).collect();
        assert!(values.iter().all(|v| v.is_finite() && *v >= 0.0));
        values.iter().sum::<f32>() / values.len() as f32
    };
    assert!(light(r#"{"emitters": {"off": true}}"#) == 0.0, "it is dark without emitters");
    let lit = |color: f32| {
        let shape = r#"{"type": "sphere", "center": [0, 0, 0], "radius": 0.1}"#;
        light(&format!(
            r#"{{"emitters": {{"off": true, "add": [{{"shape": {shape}, "color": [{color}, {color}, {color}]}}]}}}}"#
        ))
    };
    let (once, twice) = (lit(5.0), lit(10.0));
    assert!(once > 1e-4 && (twice / once - 2.0).abs() < 1e-3, "{once} {twice}");
    let unknown = r#"{"emitters": {"only": ["sun"]}}"#;
    relight(unknown, &[]).refused_with(2, &["emitter \"sun\""]);
    let both = r#"{"emitters": {"off": true}, "lights": {"off": true}}"#;
    relight(both, &[]).refused_with(2, &["\"lights\"", "leave these out"]);
    relight(r#"{"emitters": {"off": true}}"#, &["--visibility", "none"]).refused_with(2, &["--visibility"]);
}
