//! Training as a whole: the loss falls, and the result depends on scene, settings and seed alone.

use sgs_config::Settings;
use sgs_engine::{Device, DeviceOptions};
use sgs_evaluate::{Evaluation, evaluate};
use sgs_scene::{Scene, SceneOptions};
use sgs_tests::cli::{sgs, sgs_after, signal, start, until, wait};
use sgs_tests::rooms::Room;
use sgs_tests::{Gpu, Place};
use sgs_train::{Geometry, Progress};

fn settings(steps: u32) -> Settings {
    let mut s = Settings::default();
    s.geometry.steps = steps;
    let d = &mut s.geometry.densify;
    (d.from, d.interval, d.until, d.reset_interval) = (5, 5, 0.8, 12);
    (d.grad_threshold, d.max_gaussians) = (5e-5, 3000);
    s
}

fn device() -> Device {
    let select = std::env::var("SGS_TEST_DEVICE").ok();
    Device::open(&DeviceOptions { select, ..Default::default() }).unwrap()
}

#[test]
fn result_depends_on_settings_and_seed_alone() {
    let place = Place::new(Room::default());
    sgs(&place.arguments("a", 40, &["--seed", "3"])).ok();
    sgs(&place.arguments("b", 40, &["--seed", "3"])).ok();
    place.assert_same("a", "b");
    let config = place.text("a/config.toml");
    let again = ["train", &place.text("scene"), "-o", &place.text("c"), "--config", &config];
    sgs(&again).ok();
    place.assert_same("a", "c");
    assert_eq!(place.read("a/config.toml"), place.read("c/config.toml"));
    sgs(&place.arguments("d", 40, &["--seed", "4"])).ok();
    assert_ne!(place.read("a/scene.ply"), place.read("d/scene.ply"), "the seed changes nothing");

    // Resuming with other settings would match neither run.
    let other = ["train", &place.text("scene"), "-o", &place.text("a"), "--resume", "--seed", "9"];
    sgs(&other).refused(&["seed = 3", "9", "resume"]);
    place.assert_same("a", "b");
    // Training over an old run removes its files. A kill before the first checkpoint leaves none of the old run.
    let mut child =
        start(&place.arguments("d", 4000, &["--seed", "3", "--force", "--set", "train.checkpoint_interval=0"]));
    let begun = until(&mut child, || place.logged("d").last() == Some(&10));
    signal(&child, "KILL");
    wait(child);
    assert!(begun && !place.path("d/scene.ply").exists() && !place.path("d/checkpoint/geometry.safetensors").exists());
}

/// Tests entry capacities of one, of almost all entries, and of more than enough. Overflows, growth and repeated steps
/// do not affect the result, also beside densification, resets and resumes.
#[test]
fn initial_entry_capacity_does_not_change_results() {
    let place = Place::new(Room::default());
    let scene = Scene::open(&place.path("scene"), &SceneOptions::default()).unwrap();
    let gpu = Gpu::new();
    let train = |capacity: u32, resumed_at: Option<u32>| {
        let mut s = settings(32);
        s.geometry.entry_capacity = capacity;
        let mut reports = Vec::new();
        let mut on_progress = |p: &Progress| match p {
            Progress::Decided(_) => {}
            Progress::Step(r) => reports.push((r.step, r.gaussians, r.entries, r.losses.total.to_bits())),
            Progress::Densified { step, stats } => reports.push((1000 + step, stats.after, 0, 0)),
        };
        let mut training = Geometry::new(gpu.device(), &scene, &s, None).unwrap();
        if let Some(at) = resumed_at {
            let file = place.path("state");
            training.train(at, &mut on_progress, || true).unwrap();
            training.save(&file).unwrap();
            training = Geometry::new(gpu.device(), &scene, &s, None).unwrap();
            training.restore(&file).unwrap();
        }
        training.train(32, &mut on_progress, || true).unwrap();
        (training.splats().unwrap(), reports)
    };
    let (splats, reports) = train(1 << 20, None);
    let entries: Vec<u32> = reports.iter().filter(|r| r.0 < 1000).map(|r| r.2).collect();
    let most = *entries.iter().max().unwrap();
    assert!(reports.iter().filter(|r| r.0 > 1000).count() >= 4, "densification was to happen: {reports:?}");
    let first = entries[0];
    for (capacity, resumed_at) in
        [(1, None), (first, None), (first / 3, Some(10)), (most - 1, Some(15)), (1, Some(20)), (1 << 20, Some(13))]
    {
        let (other, on_progress) = train(capacity, resumed_at);
        assert_eq!(on_progress, reports, "capacity {capacity}, resumed at {resumed_at:?}");
        assert!(other == splats, "capacity {capacity}, resumed at {resumed_at:?}: the splats differ");
    }
}

/// Tests that the capacity for Gaussians does not decide which are refined. Capacity grows with the number of
/// Gaussians.
#[test]
fn gaussian_capacity_does_not_change_results() {
    let place = Place::new(Room { views: 8, size: [64, 48], spacing: 1, ..Room::default() });
    let scene = Scene::open(&place.path("scene"), &SceneOptions::default()).unwrap();
    assert!((12_000..20_000).contains(&scene.points.len()), "{} points", scene.points.len());
    let device = device();
    let mut s = settings(12);
    s.geometry.sh_degree = 0.into();
    // At first, some Gaussians are too faint and pruned, and the others are refined. Their number stays about the same,
    // unlike the capacity that would be allocated. Then all are refined until the capacity is exhausted.
    (s.geometry.densify.grad_threshold, s.geometry.densify.interval) = (0.0, 1);
    (s.geometry.densify.max_gaussians, s.geometry.densify.prune_weight) = (100_000, 0.0);
    s.geometry.densify.prune_opacity = 0.16;
    let train = |resumed_at: Option<u32>| {
        let mut after = Vec::new();
        let mut on_progress = |p: &Progress| {
            if let Progress::Densified { stats, .. } = p {
                after.push((stats.before, stats.after, stats.refused));
            }
        };
        let mut training = Geometry::new(&device, &scene, &s, None).unwrap();
        if let Some(at) = resumed_at {
            let file = place.path("state");
            training.train(at, &mut on_progress, || true).unwrap();
            training.save(&file).unwrap();
            training = Geometry::new(&device, &scene, &s, None).unwrap();
            training.restore(&file).unwrap();
        }
        training.train(12, &mut on_progress, || true).unwrap();
        (training.splats().unwrap(), after)
    };
    let (straight, after) = train(None);
    println!("{} points, then {after:?}", scene.points.len());
    assert!(after[1..].iter().any(|a| a.2 > 0), "room was to matter: {after:?}");
    for at in [5, 6, 8] {
        let (resumed, again) = train(Some(at));
        assert_eq!(after, again, "resumed at {at}");
        assert!(straight == resumed, "resumed at {at}: the splats differ");
    }
}

/// Trains with the library and evaluates at the test views.
fn learn(place: &Place, s: &Settings) -> (Vec<f32>, Evaluation) {
    let scene = Scene::open(&place.path("scene"), &SceneOptions::default()).unwrap();
    let device = device();
    let mut training = Geometry::new(&device, &scene, s, None).unwrap();
    let mut losses = Vec::new();
    let on_progress = |p: &Progress| {
        if let Progress::Step(r) = p {
            losses.push(r.losses.total);
        }
    };
    training.train(s.geometry.steps, on_progress, || true).unwrap();
    let background = s.geometry.background;
    let views = &scene.split.test;
    let result = evaluate(&device, &scene, training.gaussians(), views, background, |_, _| Ok(())).unwrap();
    (losses, result)
}

#[test]
fn training_learns_the_room_and_its_normals() {
    let place = Place::new(Room { size: [48, 36], spacing: 3, priors: true, truth: true, ..Room::default() });
    let mut s = settings(300);
    (s.geometry.densify.from, s.geometry.densify.interval, s.geometry.densify.reset_interval) = (100, 50, 0);
    s.geometry.sh_degree = 1.into();
    let (losses, guided) = learn(&place, &s);
    let mean = |l: &[f32]| l.iter().sum::<f32>() / l.len() as f32;
    let (first, last) = (mean(&losses[..6]), mean(&losses[losses.len() - 12..]));
    let degrees = guided.mean.normal_mae_deg.unwrap();
    println!("loss {first} to {last}; PSNR {:.2}; normals {degrees:.2}°", guided.mean.nvs.psnr);
    assert!(last < 0.4 * first, "the loss went from {first} to {last}");
    assert!(guided.mean.nvs.psnr > 24.0, "PSNR {}", guided.mean.nvs.psnr);
    assert!(degrees < 15.0, "normals are {degrees} degrees off");
    assert!(guided.mean.depth_rel.unwrap() < 0.15);

    // Without the prior, normals come from the surface alone and are rough.
    s.geometry.normals = false;
    let (_, without) = learn(&place, &s);
    let rough = without.mean.normal_mae_deg.unwrap();
    println!("without the prior: PSNR {:.2}; normals {rough:.2}°", without.mean.nvs.psnr);
    assert!(degrees < 0.6 * rough, "{degrees} degrees with the prior, {rough} without");
    assert!(without.mean.nvs.psnr > 24.0, "PSNR {}", without.mean.nvs.psnr);
}

/// Tests that depth terms need no priors. Each has a switch, and with both off a step has neither loss.
#[test]
fn depth_terms_train_without_normal_priors() {
    let place = Place::new(Room::default());
    let scene = Scene::open(&place.path("scene"), &SceneOptions::default()).unwrap();
    let gpu = Gpu::new();
    let train = |smooth: bool, variance: bool| {
        let mut s = settings(6);
        let l = &mut s.geometry.losses;
        let enabled = |on: bool, weight: f32| if on { weight } else { 0.0 };
        (l.depth_smooth, l.depth_variance) = (enabled(smooth, l.depth_smooth), enabled(variance, l.depth_variance));
        let mut losses = Vec::new();
        let mut training = Geometry::new(gpu.device(), &scene, &s, None).unwrap();
        let report = |p: &Progress| {
            if let Progress::Step(r) = p {
                losses.push((r.losses.depth_smooth, r.losses.depth_variance));
            }
        };
        training.train(6, report, || true).unwrap();
        let decided = training.decisions().iter().find(|d| d.what == "depth terms").unwrap().on;
        assert_eq!(decided, smooth || variance);
        (training.splats().unwrap().means, losses)
    };
    let (none, losses) = train(false, false);
    assert!(losses.iter().all(|l| *l == (0.0, 0.0)), "{losses:?}");
    let (both, losses) = train(true, true);
    assert!(losses.iter().all(|l| l.0 > 0.0 && l.1 > 0.0), "{losses:?}");
    let (smooth, variance) = (train(true, false).0, train(false, true).0);
    let all = [&none, &both, &smooth, &variance];
    for (i, a) in all.iter().enumerate() {
        all[..i].iter().for_each(|b| assert!(a != b, "a switch changes nothing"));
    }
}

/// Tests that metrics without ground truth are absent, not zero.
#[test]
fn metrics_contain_only_available_values() {
    for (priors, truth) in [(true, true), (true, false), (false, true)] {
        let place = Place::new(Room { priors, truth, ..Room::default() });
        let short = ["--set", "geometry.sh_degree=1"];
        sgs(&place.arguments("run", 20, &short)).ok();
        let run = place.text("run");
        sgs(&["eval", &run]).ok();
        sgs(&["eval", &run, "--split", "train"]).ok();
        let metrics: serde_json::Value = serde_json::from_slice(&place.read("run/metrics.json")).unwrap();
        for (split, count) in [("test", 2), ("train", 6)] {
            let views = metrics[split]["views"].as_array().unwrap();
            assert_eq!(views.len(), count);
            for entry in views.iter().chain([&metrics[split]["mean"]]) {
                let entry = entry.as_object().unwrap();
                for key in ["psnr", "ssim", "flip"] {
                    assert!(entry["nvs"][key].as_f64().unwrap() > 0.0, "{entry:?}");
                }
                assert_eq!(entry.contains_key("depth_rel"), truth, "{entry:?}");
                assert_eq!(entry.contains_key("normal_mae_deg"), truth, "{entry:?}");
                assert_eq!(entry.contains_key("normal_coverage"), truth, "{entry:?}");
                assert!(entry.values().all(|v| !v.is_null() && v != 0.0), "{entry:?}");
            }
        }
        for key in ["gaussians", "seconds", "steps_per_second", "peak_device_bytes"] {
            assert!(metrics[key].as_f64().unwrap() > 0.0, "{key}: {metrics}");
        }
        for key in ["pbr", "albedo", "relit"] {
            assert!(metrics.get(key).is_none());
        }
        assert_eq!(place.logged("run"), [1, 10, 20]);
    }
}

/// Tests that ground truth without a known pixel counts as absent.
#[test]
fn ground_truth_without_known_pixels_is_absent() {
    let place = Place::new(Room { priors: true, truth: true, ..Room::default() });
    let empty = sgs_scene::Image::new(32, 24, 3);
    let (_, test) = Room::default().split();
    let path = place.path("scene/gt/normal").join(format!("{}.exr", test[0]));
    sgs_scene::write_exr(&path, &empty, &["X", "Y", "Z"]).unwrap();
    sgs(&place.arguments("run", 10, &[])).ok();
    let metrics = sgs(&["eval", &place.text("run"), "--json"]).ok().json();
    assert!(metrics["views"][0].get("normal_mae_deg").is_none(), "{metrics}");
    assert_eq!(metrics["views"][1]["normal_mae_deg"], metrics["mean"]["normal_mae_deg"]);
}

#[test]
fn validation_reports_nothing_during_a_run() {
    let place = Place::new(Room { priors: true, ..Room::default() });
    let run = sgs(&place.arguments("run", 30, &["--validate"]));
    if run.stderr.contains("validation layer is not installed") {
        println!("skipped: there is no validation layer");
        return;
    }
    run.ok();
    sgs(&["eval", &place.text("run"), "--validate"]).ok();
}

/// Tests that dense Adam updates unseen Gaussians and repeats bit for bit. Validation reports nothing.
#[test]
fn dense_adam_differs_and_is_deterministic() {
    let place = Place::new(Room::default());
    let dense = ["--validate", "--set", "geometry.dense_adam=true"];
    sgs(&place.arguments("sparse", 20, &[])).ok();
    sgs(&place.arguments("dense", 20, &dense)).ok();
    assert_ne!(place.read("sparse/scene.ply"), place.read("dense/scene.ply"));
    sgs(&place.arguments("again", 20, &dense)).ok();
    assert_eq!(place.read("again/scene.ply"), place.read("dense/scene.ply"));
}

/// Tests that choosing the backward kernel changes no parameter. The choice times both kernels on the scene.
#[test]
fn choosing_the_backward_kernel_changes_no_parameter() {
    let place = Place::new(Room::default());
    let scene = Scene::open(&place.path("scene"), &SceneOptions::default()).unwrap();
    let device = device();
    let mut training = Geometry::new(&device, &scene, &settings(12), None).unwrap();
    training.train(6, |_| (), || true).unwrap();
    let before = training.splats().unwrap();
    assert!(training.choose_backward().unwrap(), "no kernel was timed");
    assert_ne!(training.settings().geometry.backward, sgs_config::Backward::Auto);
    assert_eq!(training.splats().unwrap(), before);
    training.train(12, |_| (), || true).unwrap();
    assert_eq!(training.step(), 12);
    assert_ne!(training.splats().unwrap(), before);
}

/// Tests that atomic gradients train like ordered ones, in less memory. A device without float atomics is refused.
#[test]
fn atomic_gradients_match_ordered_losses_in_less_memory() {
    let place = Place::new(Room { priors: true, ..Room::default() });
    let (gpu, scene) = (device(), Scene::open(&place.path("scene"), &SceneOptions::default()).unwrap());
    let with = |backward: sgs_config::Backward| {
        let mut s = settings(20);
        (s.geometry.backward, s.geometry.densify.until) = (backward, 0.0);
        let mut training = Geometry::new(&gpu, &scene, &s, None)?;
        let mut losses = Vec::new();
        let on_progress = |p: &Progress| {
            if let Progress::Step(r) = p {
                losses.push(r.losses.l1);
            }
        };
        training.train(20, on_progress, || true)?;
        Ok::<_, sgs_train::TrainError>((losses, training.needs().arena))
    };
    let ordered = with(sgs_config::Backward::Pixel).unwrap();
    let run = sgs(&place.arguments("run", 10, &["--validate", "--set", "geometry.backward=atomic"]));
    if !gpu.info().optional.float_atomics {
        let error = with(sgs_config::Backward::Atomic).err().unwrap().to_string();
        assert!(error.contains("shaderBufferFloat32AtomicAdd"), "{error}");
        run.refused(&["shaderBufferFloat32AtomicAdd"]);
        return;
    }
    run.ok();
    let atomic = with(sgs_config::Backward::Atomic).unwrap();
    assert!(atomic.1 < ordered.1, "{} and {} bytes of transients", atomic.1, ordered.1);
    assert_eq!(atomic.0.len(), 20);
    for (step, (a, b)) in atomic.0.iter().zip(&ordered.0).enumerate() {
        assert!((a - b).abs() <= 0.02 * b.abs(), "step {}: {a} and {b}", step + 1);
    }
}

/// Tests that a scene's relative path refers to the training's working directory.
#[test]
fn relative_scene_path_is_resolved_from_training_directory() {
    let place = Place::new(Room::default());
    let scene = place.text("scene");
    let run = place.text("run");
    let preparation = format!("cd '{}'", place.path(".").display());
    let short = ["train", "scene", "-o", "run", "--geometry-steps", "1"];
    sgs_after(&preparation, &short).ok();
    sgs(&["eval", &run]).ok();
    let moved = place.text("elsewhere");
    std::fs::rename(&scene, &moved).unwrap();
    sgs(&["eval", &run]).refused(&["is no longer at", &scene, "--scene"]);
    sgs(&["eval", &run, "--scene", &moved]).ok();
}
