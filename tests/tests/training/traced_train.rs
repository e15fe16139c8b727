//! Traced shadows in training and in images, from settings to files.

use serde_json::json;
use sgs_config::{Settings, VisibilityKind};
use sgs_scene::{Image, Scene, SceneOptions, read_exr};
use sgs_tests::cli::sgs;
use sgs_tests::rooms::Room;
use sgs_tests::{Gpu, Place};
use sgs_train::{Geometry, Intrinsic};

fn settings() -> Settings {
    let mut s = Settings::default();
    s.geometry.steps = 20;
    s.geometry.densify.until = 0.0;
    s.intrinsic.steps = 16;
    s.intrinsic.environment.resolution = 16;
    s.intrinsic.lights.grid = 2;
    s.intrinsic.visibility.kind = VisibilityKind::Traced;
    s
}

/// Tests that training under traced shadows learns and is deterministic. An interruption changes nothing, and training
/// without shadows differs.
#[test]
fn training_uses_traced_shadows() {
    let place = Place::new(Room { priors: true, ..Room::default() });
    let gpu = Gpu::new();
    let scene = Scene::open(&place.path("scene"), &SceneOptions::default()).unwrap();
    let mut geometry = Geometry::new(gpu.device(), &scene, &settings(), None).unwrap();
    geometry.train(20, |_| {}, || true).unwrap();
    let mut splats = geometry.splats().unwrap();
    // Opaque surfaces occlude what is behind them.
    splats.opacity_logits.iter_mut().for_each(|o| *o = o.max(1.0));
    let train = |kind: VisibilityKind, resumed_at: Option<u32>| {
        let mut s = settings();
        s.intrinsic.visibility.kind = kind;
        let mut losses = Vec::new();
        let mut training = Intrinsic::new(gpu.device(), &scene, &s, &splats).unwrap();
        let mut on_progress = |r: &sgs_passes::pipeline::IntrinsicReport| losses.push(r.shaded);
        if let Some(at) = resumed_at {
            training.train(at, &mut on_progress, || true).unwrap();
            training.save(&place.path("state")).unwrap();
            training = Intrinsic::new(gpu.device(), &scene, &s, &splats).unwrap();
            training.restore(&place.path("state")).unwrap();
        }
        training.train(16, &mut on_progress, || true).unwrap();
        (training.splats().unwrap(), training.lights().unwrap(), losses)
    };
    let first = train(VisibilityKind::Traced, None);
    assert!(first == train(VisibilityKind::Traced, Some(7)), "not the same again, or after an interruption");
    let mean = |l: &[f32]| l.iter().sum::<f32>() / l.len() as f32;
    let losses = &first.2;
    assert!(mean(&losses[12..]) < 0.95 * mean(&losses[..4]), "{losses:?}");
    let without = train(VisibilityKind::None, None);
    assert!(without.2[0] != losses[0] && without.1 != first.1);
}

fn rendered(place: &Place, file: &str) -> Image {
    read_exr(&place.path(file)).unwrap().image
}

fn light(image: &Image) -> f32 {
    image.data.iter().sum()
}

#[test]
fn a_run_with_traced_shadows_is_measured_rendered_and_relit() {
    let place = Place::new(Room { priors: true, ..Room::default() });
    let (scene, cameras) = (place.text("scene"), place.text("cameras.json"));
    let train = |run: &str, kind: &str| {
        let (to, kind) = (place.text(run), format!("intrinsic.visibility.kind={kind}"));
        let mut a =
            vec!["train", &scene, "-o", &to, "--geometry-steps", "20", "--no-densify", "--intrinsic-steps", "3"];
        a.extend(["--stage", "all", "--set", &kind]);
        for set in [
            "transport.surfels=0",
            "intrinsic.environment.resolution=16",
            "intrinsic.lights.grid=2",
            "intrinsic.visibility.levels=4",
            "intrinsic.visibility.log2_table=10",
            "intrinsic.visibility.finest=64",
        ] {
            a.extend(["--set", set]);
        }
        sgs(&a)
    };
    train("run", "trace").refused(&["\"intrinsic.visibility.kind\"", "\"trace\"", "did you mean \"traced\"?"]);
    train("run", "traced").ok();
    assert!(!place.path("run/visibility.safetensors").exists());
    sgs(&["eval", &place.text("run")]).ok();
    let metrics: serde_json::Value = serde_json::from_slice(&place.read("run/metrics.json")).unwrap();
    assert!(metrics["test"]["mean"]["pbr"]["psnr"].as_f64().unwrap() > 3.0, "{metrics}");
    let mut all: serde_json::Value = serde_json::from_slice(&place.read("scene/transforms.json")).unwrap();
    all["frames"].as_array_mut().unwrap().truncate(1);
    std::fs::write(place.path("cameras.json"), all.to_string()).unwrap();
    let to = place.text("images");
    let run = place.text("run");
    let channels = ["--channels", "visibility,direct", "--format", "exr"];
    sgs(&[&["render", &run, "--cameras", &cameras, "-o", &to][..], &channels].concat()).ok();
    let seen = rendered(&place, "images/000_visibility.exr");
    assert!(seen.data.iter().all(|v| (0.0..=1.0).contains(v)) && seen.data.iter().any(|v| *v > 0.01));

    let relit = |run: &str, edit: serde_json::Value, into: &str, more: &[&str]| {
        std::fs::write(place.path("edit.json"), edit.to_string()).unwrap();
        let (run, file, to) = (place.text(run), place.text("edit.json"), place.text(into));
        let a = ["relight", &run, "--edit", &file, "--cameras", &cameras, "-o", &to, "--format", "exr"];
        sgs(&[&a[..], &["--channels", "direct"], more].concat())
    };
    relit("run", json!({}), "same", &[]).ok();
    assert_eq!(rendered(&place, "same/000_direct.exr"), rendered(&place, "images/000_direct.exr"));
    relit("run", json!({}), "none", &["--visibility", "none"]).ok();
    let [shadow, none] = ["same", "none"].map(|d| light(&rendered(&place, &format!("{d}/000_direct.exr"))));
    assert!(shadow < none, "{shadow} {none}");
    relit("run", json!({}), "no", &["--visibility", "learned"]).refused(&["no learned visibility", "traced or none"]);
    assert!(!place.path("no").exists());

    // A learned field holds for the run's own lights. If none of them is left, rays are traced.
    train("learned", "field").ok();
    let bulb = json!({"position": [0.1, 0.2, 0.1], "intensity": [1, 1, 1]});
    let of = |into: &str| rendered(&place, &format!("{into}/000_direct.exr"));
    for (edit, name, same) in [
        (json!({"lights": {"off": true, "add": [bulb]}}), "new", "traced"),
        (json!({"lights": {"add": [bulb]}}), "more", "learned"),
    ] {
        for visibility in ["traced", "learned"] {
            relit("learned", edit.clone(), &format!("by_{visibility}"), &["--visibility", visibility]).ok();
        }
        relit("learned", edit, name, &[]).ok();
        assert_eq!(of(name), of(&format!("by_{same}")), "{name}");
        assert_ne!(of("by_traced"), of("by_learned"), "{name}");
    }
}
