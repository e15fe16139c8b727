//! Automatic number of spherical-harmonics bands.
//!
//! A band is added, measured, and retained or removed. Every decision is recorded. Interruptions do not change
//! decisions.

use sgs_config::{Settings, ShDegree};
use sgs_scene::{Scene, SceneOptions};
use sgs_tests::Gpu;
use sgs_tests::cli::sgs;
use sgs_tests::place::Place;
use sgs_tests::rooms::Room;
use sgs_train::{Decision, Geometry, Progress};

const STEPS: u32 = 40;

fn settings(gain: f64) -> Settings {
    let mut s = Settings::default();
    (s.geometry.steps, s.geometry.sh_degree, s.geometry.sh_gain) = (STEPS, ShDegree::Auto, gain);
    let d = &mut s.geometry.densify;
    (d.from, d.interval, d.reset_interval, d.grad_threshold, d.max_gaussians) = (5, 5, 12, 5e-5, 3000);
    s
}

/// Returns a training, its SH degree after each step, and its decisions.
fn train(gpu: &Gpu, scene: &Scene, s: &Settings) -> (Geometry, Vec<u32>, Vec<Decision>) {
    let mut training = Geometry::new(gpu.device(), scene, s, None).unwrap();
    let (mut degrees, mut decided) = (Vec::new(), Vec::new());
    for step in 1..=STEPS {
        let progress = |p: &Progress| {
            if let Progress::Decided(d) = p {
                decided.push(d.clone());
            }
        };
        training.train(step, progress, || true).unwrap();
        degrees.push(training.gaussians().model.sh_degree);
    }
    (training, degrees, decided)
}

#[test]
fn bands_are_added_and_retained_or_removed() {
    let place = Place::new(Room { views: 8, ..Room::default() });
    let scene = Scene::open(&place.path("scene"), &SceneOptions::default()).unwrap();
    let gpu = Gpu::new();
    // Every band is retained.
    let (all, degrees, decided) = train(&gpu, &scene, &settings(-1e9));
    let steps = |d: u32| degrees.iter().filter(|x| **x == d).count();
    assert_eq!([steps(0), steps(3)], [1, 39], "{degrees:?}");
    let about: Vec<_> = decided.iter().map(|d| (d.what.as_str(), d.step, d.on)).collect();
    assert_eq!(about, [("band 1", 6, true), ("band 2", 6, true), ("band 3", 6, true)]);
    assert!(decided.iter().all(|d| d.measured.unwrap().is_finite() && d.reason.contains("that was held back")));
    let splats = all.splats().unwrap();
    assert!(splats.sh[1..].iter().all(|band| band.iter().any(|v| *v != 0.0)), "bands were to be learned");
    assert!(all.needs().bands > 0);
    drop(all);

    // No band is retained: each is tried and removed, and its memory is freed.
    let (none, degrees, decided) = train(&gpu, &scene, &settings(1e9));
    assert_eq!(degrees.iter().filter(|d| **d == 3).count(), 4, "{degrees:?}");
    assert!(degrees[5..].iter().all(|d| *d == 0), "{degrees:?}");
    let [_, second, third] = &decided[..] else { panic!("{decided:?}") };
    assert_eq!((second.what.as_str(), second.step, second.on, second.requested), ("band 2", 6, false, Some(1e9)));
    let text = [second.to_string(), third.to_string()];
    assert!(text[0].starts_with("band 2 left out after step 6: gains "), "{text:?}");
    assert!(text[0].contains(" dB with those above it at 1 view that was held back, limit "), "{text:?}");
    assert!(text[1].contains(" dB at 1 view that was held back, limit "), "{text:?}");
    let splats = none.splats().unwrap();
    assert!(splats.sh_degree() == 0 && splats.sh[1..].iter().all(Vec::is_empty));
    let automatic = none.gaussians().bytes();
    let capacity = none.gaussians().capacity;
    drop(none);
    let mut fixed = settings(0.0);
    fixed.geometry.sh_degree = 0.into();
    let training = Geometry::new(gpu.device(), &scene, &fixed, None).unwrap();
    let per = |bytes: u64, capacity: u32| bytes as f64 / f64::from(capacity);
    let lean = per(training.gaussians().bytes(), training.gaussians().capacity);
    assert!((per(automatic, capacity) - lean).abs() < 0.1, "nothing of a band was to be left");
    assert_eq!(training.needs().bands, 0);
}

#[test]
fn interruption_does_not_change_band_decisions() {
    let place = Place::new(Room { views: 8, ..Room::default() });
    let scene = Scene::open(&place.path("scene"), &SceneOptions::default()).unwrap();
    let gpu = Gpu::new();
    // A gain of 0.0 leaves the decision to the measurement.
    for gain in [-1e9, 0.0] {
        let s = settings(gain);
        let (straight, _, decided) = train(&gpu, &scene, &s);
        let straight = straight.splats().unwrap();
        for at in [2, 4, 6, 30] {
            let file = place.path("state");
            let mut training = Geometry::new(gpu.device(), &scene, &s, None).unwrap();
            training.train(at, |_| {}, || true).unwrap();
            training.save(&file).unwrap();
            let before = training.decisions().to_vec();
            drop(training);
            let mut training = Geometry::new(gpu.device(), &scene, &s, None).unwrap();
            training.restore(&file).unwrap();
            assert_eq!(training.decisions(), before);
            training.train(STEPS, |_| {}, || true).unwrap();
            let measured: Vec<_> = training.decisions().iter().filter(|d| d.step > 0).cloned().collect();
            assert_eq!(measured, decided, "interrupted after {at}");
            assert!(training.splats().unwrap() == straight, "interrupted after {at}: the splats differ");
        }
    }
}

#[test]
fn band_decisions_are_logged_and_stored() {
    let place = Place::new(Room { views: 8, ..Room::default() });
    // With rates near zero no band gains anything.
    let more = ["--set", "geometry.sh_degree=auto", "--set", "geometry.rates.factor=0.0001"];
    let output = sgs(&place.arguments("run", 40, &more)).ok();
    assert_eq!(output.stderr.matches("band 1 left out after step 6: gains ").count(), 1, "{}", output.stderr);
    let json = |text: &[u8]| serde_json::from_slice::<serde_json::Value>(text).unwrap();
    let summary = json(&place.read("run/training.json"));
    let of = |what: &str| summary["decisions"].as_array().unwrap().iter().find(|d| d["what"] == what).unwrap().clone();
    assert_eq!((&summary["sh_degree"], &of("band 1")["requested"]), (&0.into(), &0.02.into()));
    assert_eq!(of("normals")["reason"], "the scene has no normal priors");
    assert_eq!(of("semantics")["on"], false);
    let log = String::from_utf8(place.read("run/log.jsonl")).unwrap();
    let line = log.lines().find(|l| l.contains("decision")).unwrap();
    assert_eq!(json(line.as_bytes())["decision"]["what"], "band 1");
    let config = String::from_utf8(place.read("run/config.toml")).unwrap();
    assert!(config.contains("sh_degree = \"auto\""), "{config}");
    // Resuming and evaluating the run use the retained bands.
    place.resume("run").ok();
    sgs(&["eval", &place.text("run")]).ok();
    let quiet = sgs(&[&place.arguments("quiet", 40, &more)[..], &["-q".to_owned()]].concat()).ok();
    assert_eq!(quiet.stderr, "");
    place.assert_same("run", "quiet");

    let plan = sgs(&["plan", &place.text("scene"), "--set", "geometry.sh_degree=auto"]).ok().stdout;
    for word in ["of degree 0 at first", "gains 0.02 dB", "bands that may come", "the scene has no semantic priors"] {
        assert!(plan.contains(word), "{word}: {plan}");
    }
    let wrong = sgs(&place.arguments("other", 40, &["--set", "geometry.sh_degree=some"]));
    wrong.refused(&["geometry.sh_degree is \"some\", but must be 0 to 3 or \"auto\"."]);
}
