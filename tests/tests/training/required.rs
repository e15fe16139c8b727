//! `intrinsic.automatic`: terms that the scene does not require are removed. Decisions are reported, stored in
//! checkpoints, and can be overridden.

use serde_json::Value;
use sgs_tests::Place;
use sgs_tests::cli::{sgs, signal, start, until, wait};
use sgs_tests::rooms::Room;

const SMALL: [&str; 8] = [
    "intrinsic.automatic.enabled=true",
    "intrinsic.automatic.limits=[100, 100]",
    "intrinsic.environment.resolution=64",
    "intrinsic.lights.grid=2",
    "intrinsic.visibility.levels=8",
    "intrinsic.visibility.log2_table=10",
    "intrinsic.visibility.finest=1024",
    "train.checkpoint_interval=3",
];

/// Creates a room with material priors, and geometry in `geometry`.
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

/// Returns the step, the subject and the outcome of each decision of a run. The outcome says whether the subject is
/// modeled.
fn decisions(place: &Place, run: &str) -> Vec<(u64, String, bool)> {
    let summary = json(place, &format!("{run}/training.json"));
    let of = |d: &Value| {
        // Measured decisions have a setting of their own. Decisions from the data may have other settings.
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
    // The sizes follow from the wide pixels of 32 x 24 images and the least roughness of 0.3. One wall is metal.
    assert!(texels == 32 && (64..400).contains(&finest) && metallic, "{texels} {finest} {metallic}");
    let whats: Vec<_> = output["decisions"].as_array().unwrap().iter().map(|d| d["what"].clone()).collect();
    let provided = ["albedo between views", "albedo under other lights"];
    assert_eq!(whats, [&["metallic", "environment size", "visibility size"][..], &provided].concat());
    let text = sgs(&[&fixed[..], &plan].concat()).ok().stdout;
    assert!(text.contains("required    visibility size kept: "), "{text}");
    // With automatic sizes off, the requested sizes are used.
    let off = ["--set", "intrinsic.automatic.parts=[\"metallic\"]", "--json"];
    let output = sgs(&[&fixed[..], &plan, &off].concat()).ok().json();
    assert_eq!(of(&output), (64, 1024, true));
}

#[test]
fn terms_with_low_gain_are_disabled_permanently() {
    let place = room();
    // No term gains 100 dB, but one source of light must remain.
    let all = ["intrinsic.automatic.gain=100"];
    let output = sgs(&arguments(&place, "run", &all)).ok().stderr;
    let decided = decisions(&place, "run");
    let out: Vec<_> = decided.iter().filter(|d| d.0 > 0 && !d.2).map(|d| (d.0, d.1.as_str())).collect();
    assert_eq!(out, [(5, "lights")], "{decided:?}");
    assert!(output.contains("lights left out after step 5: together they contribute"), "{output}");
    let logged = String::from_utf8(place.read("run/log.jsonl")).unwrap();
    assert_eq!(logged.matches("\"decision\":").count(), decided.len(), "{logged}");
    let there =
        ["lights.json", "visibility.safetensors", "environment.exr"].map(|f| place.path(&format!("run/{f}")).is_file());
    assert_eq!(there, [false, false, true]);
    // The settings file records the requested values.
    let config = String::from_utf8(place.read("run/config.toml")).unwrap();
    assert!(config.contains("finest = 1024") && config.contains("resolution = 64"));
    sgs(&["eval", &place.text("run"), "-q"]).ok();

    // With every choice off, all terms remain. Without an environment map, one light remains.
    let keep: Vec<&str> = all.into_iter().chain(["intrinsic.automatic.parts=[\"sizes\"]"]).collect();
    sgs(&arguments(&place, "kept", &keep)).ok();
    assert!(decisions(&place, "kept").iter().all(|d| d.0 == 0));
    let dark = [all[0], "intrinsic.environment.resolution=0"];
    sgs(&arguments(&place, "dark", &dark)).ok();
    let lights = json(&place, "dark/lights.json");
    let on = lights["lights"].as_array().unwrap().iter().filter(|l| l["gain"] != 0.0).count();
    assert_eq!(on, 1, "the brightest light stays");
    // By step 15, the light's lobes are merged to one.
    let merged = decisions(&place, "dark").into_iter().find(|d| d.1 == "lobes").map(|d| (d.0, d.2));
    assert_eq!(merged, Some((15, true)));
    assert!(lights["lights"].as_array().unwrap().iter().all(|l| l["lobes"].as_array().unwrap().len() == 1));
}

#[test]
fn terms_are_not_evaluated_before_warmup() {
    let place = room();
    let all = ["intrinsic.automatic.gain=100", "intrinsic.automatic.limits=[0, 100]"];
    // Trained colors are better than materials after a few steps.
    let more = ["--force", "--geometry-steps", "60", "--no-densify", "-q"];
    sgs(&[&["train", &place.text("scene"), "-o", &place.text("geometry")], &more[..]].concat()).ok();
    let output = sgs(&arguments(&place, "run", &all)).ok().stderr;
    let decided = decisions(&place, "run");
    let judged: Vec<_> = decided.iter().filter(|d| d.0 > 0).map(|d| (d.0, d.1.as_str(), d.2)).collect();
    assert_eq!(judged, [(5, "all parts", true), (10, "all parts", true), (15, "all parts", true)]);
    assert!(
        output.contains("dB below those of the splats' own colors (limit: 0): nothing is measured yet"),
        "{output}"
    );
    assert!(place.path("run/lights.json").is_file() && place.path("run/visibility.safetensors").is_file());
}

#[test]
fn automatic_decisions_survive_resume() {
    let place = room();
    // Lights are removed, the environment map stays, and then the run is interrupted.
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
