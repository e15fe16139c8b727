//! Regions of the intrinsic stage from each source: masks, classes, masks of pseudo-views, and a provider.

use sgs_config::Settings;
use sgs_passes::pipeline::IntrinsicReport;
use sgs_provider::Fallback;
use sgs_scene::{Scene, SceneOptions, Splats, write_ids};
use sgs_tests::intrinsic::{place, settings};
use sgs_tests::meaning::Meaning;
use sgs_tests::priors::provider;
use sgs_tests::rooms::Room;
use sgs_tests::{Gpu, Place};
use sgs_train::{Intrinsic, PseudoViews};

/// Creates a room with material priors and without masks.
fn stage() -> (Place, Room, Gpu) {
    let (place, room) = place();
    std::fs::remove_dir_all(place.path("scene/priors/masks")).unwrap();
    (place, room, Gpu::new())
}

fn open(place: &Place) -> (Scene, Splats) {
    let scene = Scene::open(&place.path("scene"), &SceneOptions::default()).unwrap();
    let splats = Splats::from_points(&scene.points, 0).unwrap();
    (scene, splats)
}

/// Trains `s.intrinsic.steps` steps. Steps 3, 6, ... compare with pseudo-views; steps 4, 7, ... use other lights.
fn train(gpu: &Gpu, place: &Place, s: &Settings) -> (Vec<IntrinsicReport>, Splats) {
    let (scene, splats) = open(place);
    let mut reports = Vec::new();
    let mut training = Intrinsic::new(gpu.device(), &scene, s, &splats).unwrap();
    training.train(s.intrinsic.steps, |r| reports.push(*r), || true).unwrap();
    (reports, training.splats().unwrap())
}

/// Returns how many steps compared a region between views and with the own prior.
fn compared(reports: &[IntrinsicReport]) -> [usize; 2] {
    let count = |of: fn(&IntrinsicReport) -> bool| reports.iter().filter(|r| of(r)).count();
    [
        count(|r| r.materials.cross_pairs > 0 && r.materials.cross_view > 0.0),
        count(|r| r.materials.own_count > 0 && r.materials.own_prior > 0.0),
    ]
}

#[test]
fn semantic_classes_are_regions_of_the_intrinsic_stage() {
    let (place, room, gpu) = stage();
    assert_eq!(compared(&train(&gpu, &place, &settings(12)).0), [0, 0], "no source of regions");
    Meaning::default().write(&room, &place.path("scene"));
    let (reports, _) = train(&gpu, &place, &settings(12));
    let [views, lights] = compared(&reports);
    assert!(views >= 3 && lights >= 2, "{views} {lights}: {reports:?}");
    // Without semantics, no classes exist.
    let mut off = settings(12);
    off.geometry.semantics = false;
    assert_eq!(compared(&train(&gpu, &place, &off).0), [0, 0]);
}

#[test]
fn masks_of_pseudo_views_replace_depth_in_the_intrinsic_stage() {
    let (place, room) = place();
    let gpu = Gpu::new();
    let s = settings(12);
    let (scene, _) = open(&place);
    let folder = place.path("scene/priors/masks/pseudo");
    std::fs::create_dir_all(&folder).unwrap();
    let carried = train(&gpu, &place, &s).0;
    // Masks without any region: no pseudo-view shows the training view's region.
    for camera in PseudoViews::new(&scene, &s.geometry.pseudo).unwrap().cameras() {
        let none = vec![0; (room.size[0] * room.size[1]) as usize];
        write_ids(&folder.join(format!("{}.png", camera.name)), room.size[0], room.size[1], &none).unwrap();
    }
    let numbered = train(&gpu, &place, &s).0;
    assert!(compared(&carried)[0] >= 3, "{carried:?}");
    assert_eq!(compared(&numbered), [0, compared(&carried)[1]], "{numbered:?}");
}

#[test]
fn mask_provider_receives_shaded_frames() {
    let (place, _, gpu) = stage();
    let (script, log) = (place.path("recorder.py"), place.path("shown.jsonl"));
    let text = r#"
import json, sys
sys.path.insert(0, sys.argv[1])
from sgs_priors import protocol, service

class Recorder:
    name = "recorder"
    offers = {"masks": {}}

    def answer(self, question):
        images = question.images
        height, width, _ = images[0].shape
        shown = {"names": [question.hint(i, "name") for i in range(3)],
                 "means": [sum(i.numbers()) / len(i.numbers()) for i in images]}
        with open(sys.argv[2], "a") as f:
            f.write(json.dumps(shown) + "\n")
        left = [at % width < width // 2 for at in range(width * height)]
        return {}, {"masks": protocol.pack("BOOL", (3, height, width), left * 3)}

service.serve(Recorder)
"#;
    std::fs::write(&script, text).unwrap();
    let priors = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../tools/priors");
    let words = [script.display(), priors.display(), log.display()].map(|p| format!("'{p}'"));
    let mut s = settings(12);
    s.provider.command = format!("python3 -B {}", words.join(" "));
    let (reports, splats) = train(&gpu, &place, &s);
    assert_eq!(compared(&reports), [4, 3], "{reports:?}");
    let text = std::fs::read_to_string(&log).unwrap();
    let visible: Vec<serde_json::Value> = text.lines().map(|l| serde_json::from_str(l).unwrap()).collect();
    assert_eq!(visible.len(), 7, "four steps between views, three under other lights");
    let names = |i: usize| visible[i]["names"].as_array().unwrap().iter().filter(|n| n.is_string()).count();
    assert_eq!([0, 1, 2, 3, 4, 5, 6].map(names), [1, 3, 1, 3, 1, 3, 1], "{visible:?}");
    let means = visible.iter().flat_map(|s| s["means"].as_array().unwrap()).map(|m| m.as_f64().unwrap());
    assert!(means.clone().all(f64::is_finite) && means.clone().any(|m| m > 0.0), "{visible:?}");
    // A resume changes nothing, because a step's frames depend only on the parameters before it.
    let (scene, start) = open(&place);
    let mut first = Intrinsic::new(gpu.device(), &scene, &s, &start).unwrap();
    first.train(5, |_| {}, || true).unwrap();
    first.save(&place.path("state")).unwrap();
    drop(first);
    let mut second = Intrinsic::new(gpu.device(), &scene, &s, &start).unwrap();
    second.restore(&place.path("state")).unwrap();
    second.train(12, |_| {}, || true).unwrap();
    assert!(second.splats().unwrap() == splats, "resumed with a provider of masks, splats differ");
    // Memory equals the estimate.
    let (taken, needs) = (gpu.device().memory_use().0, *second.needs());
    assert_eq!(taken, needs.total() - needs.staging, "{needs:?}");
}

#[test]
fn the_stand_in_masks_regions_of_the_intrinsic_stage() {
    let (place, room, gpu) = stage();
    // The stand-in reads true classes and depth.
    Meaning::default().write(&room, &place.path("scene"));
    std::fs::remove_dir_all(place.path("scene/priors/semantic")).unwrap();
    let mut s = settings(12);
    s.provider.command = provider(&format!("'stand-in={}'", place.text("scene")));
    let (reports, _) = train(&gpu, &place, &s);
    let [views, lights] = compared(&reports);
    assert!(views >= 2 && lights >= 2, "{views} {lights}: {reports:?}");
    // If its failure is tolerated, training continues without comparisons.
    for what in ["misbehave=exit", "misbehave=cannot-load"] {
        s.provider.command = provider(what);
        s.provider.on_failure = Fallback::GoOn;
        assert_eq!(compared(&train(&gpu, &place, &s).0), [0, 0], "{what}");
        s.provider.on_failure = Fallback::Stop;
        let (scene, splats) = open(&place);
        let error = match Intrinsic::new(gpu.device(), &scene, &s, &splats) {
            Err(error) => error.to_string(),
            Ok(mut training) => training.train(12, |_| {}, || true).unwrap_err().to_string(),
        };
        assert!(error.ends_with('.') && !error.contains('\n'), "{what}: {error}");
    }
}
