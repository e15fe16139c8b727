//! `intrinsic.automatic`: what the scene does not require is left out, said, kept in checkpoints, and can be insisted upon.

use serde_json::Value;
use sgs_tests::Place;
use sgs_tests::cli::{sgs, signal, start, until, wait};
use sgs_tests::rooms::Room;

const SMALL: [&str; 9] = [
    "intrinsic.automatic.enabled=true",
    "intrinsic.automatic.ready=100",
    "intrinsic.automatic.settled=100",
    "intrinsic.environment.resolution=64",
    "intrinsic.lights.grid=2",
    "intrinsic.visibility.levels=8",
    "intrinsic.visibility.log2_table=10",
    "intrinsic.visibility.finest=1024",
    "intrinsic.checkpoint_interval=3",
];

/// A room with priors of materials, and geometry in `geometry`.
fn room() -> Place {
    let room = Room { priors: true, ..Room::default() };
    let place = Place::new(room);
    room.write_materials(&place.path("scene"));
    let more = ["--geometry-steps", "3", "--no-densify", "-q"];
    sgs(&[&["train", &place.text("scene"), "-o", &place.text("geometry")], &more[..]].concat()).ok();
    place
}

fn arguments(place: &Place, out: &str, more: &[&str]) -> Vec<String> {
    let (scene, out, geometry) = (place.text("scene"), place.text(out), place.text("geometry/scene.ply"));
    let fixed = ["train", &scene, "-o", &out, "--stage", "intrinsic", "--start", &geometry, "--intrinsic-steps", "20"];
    let sets = SMALL.iter().chain(more).flat_map(|s| ["--set", s]);
    fixed.into_iter().chain(sets).map(str::to_owned).collect()
}

fn json(place: &Place, name: &str) -> Value {
    serde_json::from_slice(&place.read(name)).unwrap()
}

/// Step, subject and whether it is modeled, of each decision of a run.
fn decisions(place: &Place, run: &str) -> Vec<(u64, String, bool)> {
    let summary = json(place, &format!("{run}/training.json"));
    let of = |d: &Value| {
        // What was measured is forced by a setting of its own; what follows from the data by others, too.
        let of = if d["step"] == 0 { "intrinsic." } else { "intrinsic.automatic." };
        assert!(d["reason"].is_string() && d["setting"].as_str().unwrap().starts_with(of), "{d}");
        (d["step"].as_u64().unwrap(), d["what"].as_str().unwrap().to_owned(), d["on"].as_bool().unwrap())
    };
    summary["intrinsic"]["decisions"].as_array().map(|all| all.iter().map(of).collect()).unwrap_or_default()
}

#[test]
fn automatic_sizes_are_reported_before_training() {
    let place = room();
    let plan: Vec<&str> = SMALL.iter().flat_map(|s| ["--set", s]).collect();
    let (scene, geometry) = (place.text("scene"), place.text("geometry/scene.ply"));
    let fixed = ["plan", &scene, "--stage", "intrinsic", "--start", &geometry];
    let output = sgs(&[&fixed[..], &plan, &["--json"]].concat()).ok().json();
    let of = |output: &Value| {
        let i = output;
        (i["environment"].as_u64().unwrap(), i["visibility"]["finest"].as_u64().unwrap(), i["metallic"] == true)
    };
    let (texels, finest, metallic) = of(&output);
    // Pixels of an image of 32 x 24 are wide; the smoothest wall has a roughness of 0.3; one wall is metal.
    assert!(texels == 32 && (64..400).contains(&finest) && metallic, "{texels} {finest} {metallic}");
    let whats: Vec<_> = output["decisions"].as_array().unwrap().iter().map(|d| d["what"].clone()).collect();
    let provided = ["albedo between views", "albedo under other lights"];
    assert_eq!(whats, [&["metallic", "environment size", "visibility size"][..], &provided].concat());
    let text = sgs(&[&fixed[..], &plan].concat()).ok().stdout;
    assert!(text.contains("required    visibility size kept: "), "{text}");
    // Insisted upon.
    let off = ["--set", "intrinsic.automatic.sizes=false", "--json"];
    let output = sgs(&[&fixed[..], &plan, &off].concat()).ok().json();
    assert_eq!(of(&output), (64, 1024, true));
}

#[test]
fn terms_with_low_gain_are_disabled_permanently() {
    let place = room();
    // Nothing is worth a hundred decibels; but something has to shine.
    let all = ["intrinsic.automatic.gain=100"];
    let output = sgs(&arguments(&place, "run", &all)).ok().stderr;
    let decided = decisions(&place, "run");
    let out: Vec<_> = decided.iter().filter(|d| d.0 > 0 && !d.2).map(|d| (d.0, d.1.as_str())).collect();
    assert_eq!(out, [(5, "lights")], "{decided:?}");
    assert!(output.contains("lights left out after step 5: together they are worth"), "{output}");
    let logged = String::from_utf8(place.read("run/log.jsonl")).unwrap();
    assert_eq!(logged.matches("\"decision\":").count(), decided.len(), "{logged}");
    let there =
        ["lights.json", "visibility.safetensors", "environment.exr"].map(|f| place.path(&format!("run/{f}")).is_file());
    assert_eq!(there, [false, false, true]);
    // What was asked for stands in the settings.
    let config = String::from_utf8(place.read("run/config.toml")).unwrap();
    assert!(config.contains("finest = 1024") && config.contains("resolution = 64"));
    sgs(&["eval", &place.text("run"), "-q"]).ok();

    // Insisted upon, everything stays; without an environment map a light does.
    let keep = ["metallic", "lights", "lobes", "environment", "visibility", "levels", "texels", "pace"]
        .map(|p| format!("intrinsic.automatic.{p}=false"));
    let keep: Vec<&str> = all.into_iter().chain(keep.iter().map(String::as_str)).collect();
    sgs(&arguments(&place, "kept", &keep)).ok();
    assert!(decisions(&place, "kept").iter().all(|d| d.0 == 0));
    let dark = [all[0], "intrinsic.environment.enabled=false"];
    sgs(&arguments(&place, "dark", &dark)).ok();
    let lights = json(&place, "dark/lights.json");
    let on = lights["lights"].as_array().unwrap().iter().filter(|l| l["gain"] != 0.0).count();
    assert_eq!(on, 1, "the brightest light stays");
    // Of its lobes one will do, by then.
    let merged = decisions(&place, "dark").into_iter().find(|d| d.1 == "lobes").map(|d| (d.0, d.2));
    assert_eq!(merged, Some((15, true)));
    assert!(lights["lights"].as_array().unwrap().iter().all(|l| l["lobes"].as_array().unwrap().len() == 1));
}

#[test]
fn terms_are_not_evaluated_before_warmup() {
    let place = room();
    let all = ["intrinsic.automatic.gain=100", "intrinsic.automatic.ready=0"];
    // Colors that have been trained are better than materials after a few steps.
    let more = ["--force", "--geometry-steps", "60", "--no-densify", "-q"];
    sgs(&[&["train", &place.text("scene"), "-o", &place.text("geometry")], &more[..]].concat()).ok();
    let output = sgs(&arguments(&place, "run", &all)).ok().stderr;
    let decided = decisions(&place, "run");
    let judged: Vec<_> = decided.iter().filter(|d| d.0 > 0).map(|d| (d.0, d.1.as_str(), d.2)).collect();
    assert_eq!(judged, [(5, "all parts", true), (10, "all parts", true), (15, "all parts", true)]);
    assert!(output.contains("dB short of the splats' own colors (asked: 0): nothing is judged yet"), "{output}");
    assert!(place.path("run/lights.json").is_file() && place.path("run/visibility.safetensors").is_file());
}

#[test]
fn automatic_decisions_survive_resume() {
    let place = room();
    // Lights go, surroundings stay; then it is stopped.
    let some = ["intrinsic.automatic.gain=3"];
    let mut child = start(&arguments(&place, "run", &some));
    let checkpoint = place.path("run/checkpoint/intrinsic.safetensors");
    let reached = until(&mut child, || checkpoint.is_file());
    signal(&child, "INT");
    let stopped = wait(child);
    assert!(reached && matches!(stopped.status, Some(0 | 130)), "{stopped:?}");
    if stopped.status == Some(130) {
        let (scene, out) = (place.text("scene"), place.text("run"));
        sgs(&["train", &scene, "-o", &out, "--stage", "intrinsic", "--resume", "-q"]).ok();
    }
    sgs(&arguments(&place, "whole", &some)).ok();
    let whole = decisions(&place, "whole");
    assert!(whole.iter().any(|d| d.0 > 0), "nothing was left out: {whole:?}");
    assert_eq!(decisions(&place, "run"), whole);
    for file in ["scene.ply", "lights.json", "environment.exr"] {
        let of = |run: &str| {
            let path = place.path(&format!("{run}/{file}"));
            path.is_file().then(|| std::fs::read(path).unwrap())
        };
        assert!(of("run") == of("whole"), "{file} differs");
    }
}
