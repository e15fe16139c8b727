//! Provider of albedo under other lights during training: its input, the use of its answers, and its failures.

use sgs_config::{Settings, VisibilityKind};
use sgs_passes::pipeline::IntrinsicReport;
use sgs_passes::reference::lights::{Raw, perturb};
use sgs_passes::shade::lights::Perturbation;
use sgs_provider::Fallback;
use sgs_run::{LightFile, Shading, Visibility, camera, shaded_scene};
use sgs_scene::{Image, Scene, SceneOptions, Splats, srgb_to_linear, write_ids, write_png};
use sgs_tests::priors::provider;
use sgs_tests::rooms::Room;
use sgs_tests::{Gpu, Place};
use sgs_train::{Geometry, Intrinsic, Schedule};
use std::path::Path;

/// Albedo of each wall in sRGB.
const WALLS: [[f32; 3]; 6] =
    [[0.7, 0.2, 0.2], [0.2, 0.7, 0.2], [0.2, 0.2, 0.7], [0.7, 0.7, 0.2], [0.2, 0.7, 0.7], [0.7, 0.2, 0.7]];

fn settings(steps: u32) -> Settings {
    let mut s = Settings::default();
    s.geometry.densify.until = 0.0;
    s.geometry.steps = 20;
    s.intrinsic.steps = steps;
    s.intrinsic.environment.resolution = 16;
    s.intrinsic.lights.grid = 2;
    s.intrinsic.relight_from = 1;
    s.intrinsic.losses.cross_view = 0.0;
    (s.intrinsic.visibility.levels, s.intrinsic.visibility.log2_table) = (4, 10);
    (s.intrinsic.visibility.coarsest, s.intrinsic.visibility.finest) = (4, 32);
    s
}

/// Creates a room with regions and true materials, but without material priors.
fn place() -> Place {
    let room = Room::default();
    let place = Place::new(room);
    for folder in ["priors/masks", "gt/albedo", "gt/roughness"] {
        std::fs::create_dir_all(place.path(&format!("scene/{folder}"))).unwrap();
    }
    for camera in room.cameras() {
        let walls = room.walls(&camera);
        let (width, height) = (camera.width, camera.height);
        let file = |folder: &str| place.path(&format!("scene/{folder}/{}.png", camera.name));
        let data = walls.iter().flat_map(|w| WALLS[*w].map(srgb_to_linear)).collect();
        write_png(&file("gt/albedo"), &Image { width, height, channels: 3, data }).unwrap();
        let data = walls.iter().map(|w| 0.2 + 0.1 * *w as f32).collect();
        write_png(&file("gt/roughness"), &Image { width, height, channels: 1, data }).unwrap();
        let ids: Vec<u16> = walls.iter().map(|w| 1 + *w as u16).collect();
        write_ids(&file("priors/masks"), width, height, &ids).unwrap();
    }
    place
}

struct Stage {
    place: Place,
    gpu: Gpu,
    scene: Scene,
    splats: Splats,
}

impl Stage {
    fn new() -> Stage {
        let place = place();
        let gpu = Gpu::new();
        let scene = Scene::open(&place.path("scene"), &SceneOptions::default()).unwrap();
        let mut geometry = Geometry::new(gpu.device(), &scene, &settings(1), None).unwrap();
        geometry.train(20, |_| {}, || true).unwrap();
        let splats = geometry.splats().unwrap();
        drop(geometry);
        Stage { place, gpu, scene, splats }
    }

    fn intrinsic(&self, s: &Settings) -> sgs_train::Result<Intrinsic> {
        Intrinsic::new(self.gpu.device(), &self.scene, s, &self.splats)
    }

    /// Trains to the end; returns the reports of all steps and the splats.
    fn train(&self, s: &Settings, resumed_at: Option<u32>) -> (Vec<IntrinsicReport>, Splats) {
        let mut reports = Vec::new();
        let mut training = self.intrinsic(s).unwrap();
        if let Some(at) = resumed_at {
            let file = self.place.path("state");
            training.train(at, |r| reports.push(*r), || true).unwrap();
            training.save(&file).unwrap();
            training = self.intrinsic(s).unwrap();
            training.restore(&file).unwrap();
        }
        training.train(s.intrinsic.steps, |r| reports.push(*r), || true).unwrap();
        (reports, training.splats().unwrap())
    }

    /// Returns the command line of a stand-in that logs its input, and the log's path. The log has a line of JSON per
    /// image.
    fn recorder(&self) -> (String, std::path::PathBuf) {
        let (script, log) = (self.place.path("recorder.py"), self.place.path("shown.jsonl"));
        let text = r#"
import json, sys
sys.path.insert(0, sys.argv[1])
from sgs_priors import service, stand_in

class Recorder:
    name = "recorder"

    def __init__(self):
        self.inner = stand_in.StandIn(sys.argv[2], noise=0)
        self.offers = {"materials": {**self.inner.offers["materials"], "image": "linear"}}

    def answer(self, question):
        shown = {"name": question.hint(0, "name"), "maps": question.text["maps"],
                 "numbers": list(question.images[0].numbers())}
        with open(sys.argv[3], "a") as f:
            f.write(json.dumps(shown) + "\n")
        return self.inner.answer(question)

service.serve(Recorder)
"#;
        std::fs::write(&script, text).unwrap();
        let _ = std::fs::remove_file(&log);
        let priors = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tools/priors");
        let words = [script.display(), priors.display(), self.place.path("scene").display(), log.display()]
            .map(|p| format!("'{p}'"));
        (format!("python3 -B {}", words.join(" ")), log)
    }
}

/// Returns the mean difference of albedo from that of the visible wall. Only the provider's answers let training get it
/// right.
fn albedo_error(s: &Stage, splats: &Splats) -> f64 {
    let scene = shaded_scene(s.gpu.device(), splats, None, None, &Visibility::None).unwrap();
    let mut shading = Shading::new(s.gpu.device(), scene).unwrap();
    let room = Room::default();
    let mut sum = (0.0, 0.0);
    for &view in &s.scene.split.train {
        let c = &s.scene.views[view].camera;
        let albedo = shading.shade(c).unwrap().albedo();
        for (p, w) in albedo.data.chunks_exact(3).zip(room.walls(c)) {
            for (v, t) in p.iter().zip(WALLS[w]) {
                sum = (sum.0 + f64::from((v - srgb_to_linear(t)).abs()), sum.1 + 1.0);
            }
        }
    }
    sum.0 / sum.1
}

#[test]
fn relit_answers_supervise_albedo_across_resume() {
    let stage = Stage::new();
    let mut s = settings(60);
    s.intrinsic.rates.materials = 0.05;
    s.intrinsic.relight.provider = provider(&format!("stand-in='{}' --noise 0.02", stage.place.text("scene")));
    s.intrinsic.relight.every = 20;
    s.intrinsic.losses.relight = 4.0;
    (s.intrinsic.losses.albedo_smooth, s.intrinsic.relight.roughness) = (0.0, 0.5);
    let (reports, splats) = stage.train(&s, None);
    for r in &reports {
        let due = r.step % 3 == 1;
        assert!(due == (r.materials.relight_count == 2), "step {}: {:?}", r.step, r.materials);
        assert!(due == (r.materials.relight > 0.0), "step {}: {:?}", r.step, r.materials);
    }
    // The same training runs without a provider.
    let mut alone = s.clone();
    alone.intrinsic.relight.provider = "own".into();
    let (silent, unguided) = stage.train(&alone, None);
    assert!(silent.iter().all(|r| r.materials.relight_count == 0));
    let (reported, untold) = (albedo_error(&stage, &splats), albedo_error(&stage, &unguided));
    println!("albedo is off by {reported} with a provider, {untold} without");
    assert!(reported < 0.8 * untold, "albedo is off by {reported} with a provider, {untold} without");
    assert_ne!(splats.roughness, unguided.roughness);
    // Answers survive an interruption: the result has the same bits, although another process answers.
    for at in [5, 31] {
        let (other, resumed) = stage.train(&s, Some(at));
        assert!(other == reports && resumed == splats, "resumed at {at}");
    }
}

#[test]
fn relit_provider_input_matches_reference_lights() {
    let stage = Stage::new();
    let (command, log) = stage.recorder();
    let mut s = settings(12);
    (s.intrinsic.relight.provider, s.intrinsic.relight.every) = (command, 1000);
    s.intrinsic.environment.resolution = 0;
    s.intrinsic.visibility.kind = VisibilityKind::None;
    s.intrinsic.relight_from = 8;
    s.geometry.background = [0.2, 0.4, 0.6];
    let mut training = stage.intrinsic(&s).unwrap();
    training.train(9, |_| {}, || true).unwrap();
    assert!(!log.exists(), "asked before it was due");
    let (lights, splats, bounds) = (training.lights().unwrap().unwrap(), training.splats().unwrap(), training.bounds());
    training.train(12, |_| {}, || true).unwrap();
    let text = std::fs::read_to_string(&log).unwrap();
    let visible: Vec<serde_json::Value> = text.lines().map(|l| serde_json::from_str(l).unwrap()).collect();
    assert_eq!(visible.len(), 2, "two copies of one view");

    let schedule = Schedule::new(&s, stage.scene.extent(), stage.scene.split.train.len());
    let view = &stage.scene.views[stage.scene.split.train[schedule.view(10)]].camera;
    let seed = schedule.step(10, &camera(view), 0).seed;
    let (model, positions, lobes, gains) = lights.raw();
    let wide = |v: &[f32]| v.iter().map(|x| f64::from(*x)).collect::<Vec<f64>>();
    let raw = Raw { model, positions: wide(&positions), lobes: wide(&lobes), gains: wide(&gains) };
    let side = (0..3).map(|i| bounds[1][i] - bounds[0][i]).fold(0.0, f32::max);
    let mut images = Vec::new();
    for (copy, seen) in visible.iter().enumerate() {
        assert_eq!((seen["name"].as_str().unwrap(), &seen["maps"]), (&*view.name, &serde_json::json!(["albedo"])));
        let moved = perturb(&raw, seed, &Perturbation::published(copy as u32, side / 3.0));
        let narrow = |v: &[f64]| v.iter().map(|x| *x as f32).collect::<Vec<f32>>();
        let (positions, gains) = (narrow(&moved.positions), narrow(&moved.gains));
        let other = LightFile::of(&model, lights.normalizer, &positions, &lobes, &gains);
        let scene = shaded_scene(stage.gpu.device(), &splats, Some(&other), None, &Visibility::None).unwrap();
        let expected = Shading::new(stage.gpu.device(), scene).unwrap().shade(view).unwrap();
        let expected = expected.radiance(s.geometry.background);
        let found: Vec<f32> = seen["numbers"].as_array().unwrap().iter().map(|v| v.as_f64().unwrap() as f32).collect();
        assert_eq!(found.len(), expected.data.len());
        let largest = expected.data.iter().fold(0.0_f32, |a, b| a.max(*b));
        assert!(largest > 0.0);
        for (i, (e, f)) in expected.data.iter().zip(&found).enumerate() {
            assert!((e - f).abs() <= 1e-4 * largest, "copy {copy}, number {i}: {f} is not {e}");
        }
        images.push(found);
    }
    let apart = images[0].iter().zip(&images[1]).map(|(a, b)| (a - b).abs()).fold(0.0_f32, f32::max);
    assert!(apart > 1e-3, "both copies look the same");

    // Queries repeat at the interval `every`. An interval longer than the run queries each view once.
    let mut steps = Vec::new();
    for every in [1, 6, 1000] {
        let (command, log) = stage.recorder();
        (s.intrinsic.relight.provider, s.intrinsic.relight.every, s.intrinsic.relight_from) = (command, every, 1);
        let (reports, _) = stage.train(&s, None);
        let due = reports.iter().filter(|r| r.materials.relight_count > 0).count();
        let requested = std::fs::read_to_string(&log).unwrap().lines().count();
        assert!(requested.is_multiple_of(2) && requested / 2 <= due, "{requested} questions in {due} steps");
        steps.push((requested / 2, due));
    }
    let seen: std::collections::HashSet<usize> = (1..=12).step_by(3).map(|step| schedule.view(step)).collect();
    assert_eq!((steps[0], steps[2]), ((4, 4), (seen.len(), 4)), "{steps:?}");
}

#[test]
fn provider_failures_stop_training_or_disable_queries() {
    let stage = Stage::new();
    let with = |how: &str, fallback: Fallback| {
        let mut s = settings(8);
        s.intrinsic.relight.provider = provider(&format!("misbehave={how}"));
        s.provider.on_failure = fallback;
        s.provider.seconds[1] = if how == "hang" { 0.7 } else { 60.0 };
        s
    };
    let run = |s: &Settings| -> Result<Vec<IntrinsicReport>, String> {
        let mut reports = Vec::new();
        let mut training = stage.intrinsic(s).map_err(|e| e.to_string())?;
        training.train(8, |r| reports.push(*r), || true).map_err(|e| e.to_string())?;
        Ok(reports)
    };
    let alone = run(&settings(8)).unwrap();
    for (how, output) in [
        ("exit", "ended with status 3 before it answered materials; its last words: CUDA out of memory"),
        ("hang", "gave no answer to materials within 0.7 s and was stopped"),
        ("infinite", "answered materials with nonsense and was stopped: the array \"albedo\" holds inf at index 2"),
        ("wrong-color", "must be \"srgb\" or \"linear\", but is \"cmyk\""),
        ("refuse", "cannot answer materials: no such thing is known"),
        ("cannot-load", "there are no weights at /nowhere"),
    ] {
        let error = run(&with(how, Fallback::Stop)).unwrap_err();
        assert!(error.contains(output) && !error.contains('\n'), "{how}: {error}");
        // Training continues as if no provider were configured.
        let reports = run(&with(how, Fallback::GoOn)).unwrap();
        assert!(reports == alone, "{how}");
    }
    let error = run(&with("few-offers", Fallback::GoOn)).unwrap_err();
    assert!(error.contains("intrinsic.relight.provider offers no materials; it offers text"), "{error}");
    // Unknown pixels are not compared.
    let unknown = run(&with("nan", Fallback::Stop)).unwrap();
    assert!(unknown.iter().any(|r| r.materials.relight_count > 0));

    for (change, output) in [
        ((|s| s.intrinsic.relight.every = 0) as fn(&mut Settings), "intrinsic.relight.every is 0"),
        (|s| s.intrinsic.relight.provider = " ".into(), "must be \"own\" or a command line"),
        (|s| s.intrinsic.lights.grid = 0, "intrinsic.lights.grid is 0"),
        (|s| s.intrinsic.losses.relight = f32::NAN, "intrinsic.losses.relight is NaN"),
    ] {
        let mut s = with("nothing", Fallback::Stop);
        change(&mut s);
        let error = run(&s).unwrap_err();
        assert!(error.contains(output), "{error}");
    }
}
