//! Cameras, exposures and the lens that training learns: the same bits after interruptions, and poses and focal lengths better
//! than they were given.

use glam::{DMat3, DQuat};
use sgs_config::ViewRates;
use sgs_run::{LearnedCameras, LearnedLens, LearnedViewRow, RunDirectory};
use sgs_scene::{Scene, SceneOptions};
use sgs_tests::cli::sgs;
use sgs_tests::rooms::Room;
use sgs_tests::{Place, files};
use std::path::Path;

const LEARN: [&str; 2] = ["--set", "geometry.rates.views=[1e-3, 5e-3, 1e-3, 1e-3]"];

#[test]
fn killed_training_of_cameras_resumes_with_the_same_bits() {
    let place = Place::new(Room::default());
    let steps = 90;
    sgs(&place.arguments("straight", steps, &LEARN)).ok();
    place.train_killed("killed", steps, &LEARN, &[10, 50]);
    place.assert_same("straight", "killed");
    assert!(place.read("straight/cameras.json") == place.read("killed/cameras.json"));
    // A training without them removes the file of the one before.
    let again = [&["--force"][..], &["--set", "geometry.rates.views=[0, 0, 0, 0]"]].concat();
    sgs(&place.arguments("killed", 20, &again)).ok();
    assert!(!place.path("killed/cameras.json").exists());
}

/// Returns the mean angle between poses and those of the scene, in radians.
fn error(scene: &Scene, poses: &[LearnedViewRow]) -> f64 {
    let angle = |row: &LearnedViewRow| {
        let truth = &scene.views.iter().find(|v| v.camera.name == row.name).unwrap().camera;
        let [x, y, z] = row.world_to_camera.map(|r| [r[0], r[1], r[2]]);
        let turn = DMat3::from_cols_array_2d(&[x, y, z]).transpose() * truth.rotation.transpose();
        2.0 * DQuat::from_mat3(&turn).xyz().length().min(1.0).asin()
    };
    poses.iter().map(angle).sum::<f64>() / poses.len() as f64
}

/// Tests that training corrects cameras that are off by half a degree.
///
/// Later stages and measures use the learned cameras.
#[test]
fn noisy_cameras_are_corrected() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("data/room");
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let text = root.display().to_string();
    let lean = ["--set", "geometry.semantics=false", "--set", "noise.cameras=[0.5, 0.0]", "--no-densify", "-q"];
    let mut psnr = Vec::new();
    for (name, learn) in
        [("given", "geometry.rates.views=[0, 0, 0, 0]"), ("learned", "geometry.rates.views=[5e-4, 0, 0, 0]")]
    {
        let run = path(name);
        let options = ["--stage", "geometry", "--geometry-steps", "500", "--set", learn];
        sgs(&[&["train", &text, "-o", &run], &options[..], &lean].concat()).ok();
        sgs(&["eval", &run, "--align", "--json", &path("measures.json")]).ok();
        let measures = std::fs::read_to_string(folder.path().join("measures.json")).unwrap();
        let measures: serde_json::Value = serde_json::from_str(&measures).unwrap();
        let number = |name: &str| measures.pointer(&format!("/mean/nvs/{name}")).unwrap().as_f64().unwrap();
        psnr.push([number("psnr"), number("psnr_aligned")]);
    }
    let run = RunDirectory::open(&folder.path().join("learned")).unwrap();
    let scene = Scene::open(&root, &SceneOptions::default()).unwrap();
    let settings = run.settings().unwrap();
    let noisy = settings.noise.on(&scene, settings.seed).unwrap();
    let given: Vec<_> =
        noisy.split.train.iter().map(|&i| LearnedViewRow::of(&noisy.views[i].camera, [1.0; 3])).collect();
    let learned = run.learned_views().unwrap().unwrap().views;
    assert_eq!(learned.len(), given.len());
    println!("{psnr:?} {} -> {}", error(&scene, &given), error(&scene, &learned));
    assert!(error(&scene, &learned) < 0.6 * error(&scene, &given));
    assert!(psnr[1][1] > psnr[0][1] + 0.3, "{psnr:?}");
    // Materials train with the learned cameras.
    let more = ["train", &text, "-o", &path("learned"), "--stage", "intrinsic", "--intrinsic-steps", "2", "-q"];
    sgs(&more).ok();
    let after = run.learned_views().unwrap().unwrap();
    assert_eq!(after.views, learned);
    // The noise of the given cameras does not move the learned ones.
    let mut corrected = scene;
    sgs_run::use_learned_views(&mut corrected, &after);
    let again = settings.noise.on(&corrected, settings.seed).unwrap();
    for &i in &corrected.split.train {
        assert_eq!(again.views[i].camera, corrected.views[i].camera);
        assert_eq!(
            LearnedViewRow::of(&again.views[i].camera, [1.0; 3]),
            *learned.iter().find(|row| row.name == again.views[i].camera.name).unwrap()
        );
    }
}

/// Changes the photographs of the training views.
///
/// `change` takes the view, the channel, the squared distance from the center (1 at the corners) and the stored byte.
fn repaint(scene: &Scene, change: impl Fn(usize, usize, f64, u8) -> f64) {
    for &view in &scene.split.train {
        let path = &scene.views[view].image_path;
        let mut photograph = image::open(path).unwrap().to_rgb8();
        let (w, h) = (f64::from(photograph.width()), f64::from(photograph.height()));
        for (x, y, pixel) in photograph.enumerate_pixels_mut() {
            let (dx, dy) = (f64::from(x) + 0.5 - 0.5 * w, f64::from(y) + 0.5 - 0.5 * h);
            let share = (dx * dx + dy * dy) / (0.25 * (w * w + h * h));
            for (channel, value) in pixel.0.iter_mut().enumerate() {
                *value = change(view, channel, share, *value).round() as u8;
            }
        }
        photograph.save(path).unwrap();
    }
}

/// Factors on the photograph of a view. They are powers of two, so that products and quotients are exact.
fn exposure(view: usize) -> [f32; 3] {
    [[0.5, 1.0, 2.0], [1.0, 0.25, 1.0], [2.0, 0.5, 0.25]][view % 3]
}

/// Writes exposures, vignetting and the scene's cameras into a run.
fn write_exposures(place: &Place, run: &str, scene: &Scene, gains: fn(usize) -> [f32; 3], vignetting: f32) {
    let rows = scene.split.train.iter().map(|&i| LearnedViewRow::of(&scene.views[i].camera, gains(i)));
    let lens = LearnedLens { vignetting, ..LearnedLens::default() };
    let learned = LearnedCameras { views: rows.collect(), lens };
    RunDirectory::open(&place.path(run)).unwrap().write_learned_views(Some(&learned)).unwrap();
}

/// Tests that later stages do not depend on exposures that are known.
///
/// The same materials, lights and emitters are the result. Photographs hold multiples of four up to 124, so every factor leaves bytes. Both runs then see the same bits.
#[test]
fn later_stages_see_photographs_without_their_exposures() {
    let place = Place::new(Room::default());
    std::fs::remove_dir_all(place.path("scene")).unwrap();
    sgs(&["synth", &place.text("scene"), "--scene", "box", "--views", "8", "--size", "32x24"]).ok();
    let scene = Scene::open(&place.path("scene"), &SceneOptions::default()).unwrap();
    repaint(&scene, |_, _, _, value| f64::from((value >> 3) << 2));
    let even = scene.load_train_images().unwrap();
    let train = |run: &str, more: &[&str]| {
        let (scene, run) = (place.text("scene"), place.text(run));
        let fixed = ["train", &scene, "-o", &run, "-q"];
        let sets = [
            "intrinsic.environment.resolution=16",
            "intrinsic.lights.grid=2",
            "intrinsic.visibility.levels=2",
            "intrinsic.visibility.log2_table=8",
            "transport.surfels=256",
            "transport.steps=2",
        ];
        let sets = sets.iter().flat_map(|pair| ["--set", *pair]);
        let all: Vec<&str> = fixed.into_iter().chain(sets).chain(more.iter().copied()).collect();
        sgs(&all).ok();
    };
    train("even", &["--geometry-steps", "20", "--no-densify", "--intrinsic-steps", "3"]);
    for (from, bytes) in files(&place.path("even")) {
        let to = place.path("uneven").join(from.strip_prefix(place.path("even")).unwrap());
        std::fs::create_dir_all(to.parent().unwrap()).unwrap();
        std::fs::write(to, bytes).unwrap();
    }
    write_exposures(&place, "even", &scene, |_| [1.0; 3], 0.0);
    write_exposures(&place, "uneven", &scene, exposure, 0.0);
    for run in ["even", "uneven"] {
        if run == "uneven" {
            repaint(&scene, |view, channel, _, value| f64::from(value) * f64::from(exposure(view)[channel]));
            assert!(scene.load_train_images().unwrap() != even, "the exposures do not differ");
        }
        train(run, &["--stage", "intrinsic"]);
        train(run, &["--stage", "transport"]);
    }
    for file in ["lights.json", "environment.exr", "emitters.json"] {
        let [a, b] = ["even", "uneven"].map(|run| place.read(&format!("{run}/{file}")));
        assert!(a == b, "{file} depends on the exposures");
    }
    place.assert_same("even", "uneven");
    // Measures and exports see the same pixels.
    let (path, settings) =
        (place.path("uneven"), RunDirectory::open(&place.path("uneven")).unwrap().settings().unwrap());
    let seen = || sgs_api::scenes::open_scene_of_run(&path, &settings).unwrap().load_train_images().unwrap();
    assert!(seen() == even, "an exposure is left");
    // Vignetting rounds the photographs to 8 bits, by half a step at most before it is removed.
    repaint(&scene, |_, _, share, value| f64::from(value) * (-0.5 * share).exp());
    write_exposures(&place, "uneven", &scene, exposure, -0.5);
    let seen = seen();
    for ((seen, even), view) in seen.iter().zip(&even).zip(&scene.split.train) {
        for (at, (seen, even)) in seen.data.iter().zip(&even.data).enumerate() {
            let step = 1.0 / 255.0 / (f64::from(exposure(*view)[at % 3]) * f64::exp(-0.5));
            assert!(f64::from((seen - even).abs()) < 0.501 * step, "view {view}, value {at}: {seen} and not {even}");
        }
    }
}

/// Returns the learned factor on focal lengths of a training.
fn learned_focal(scene: &Path, run: &Path, more: &[&str]) -> f64 {
    let (scene, text) = (scene.display().to_string(), run.display().to_string());
    sgs(&[&["train", &scene, "-o", &text, "--stage", "geometry", "-q"], more].concat()).ok();
    RunDirectory::open(run).unwrap().learned_views().unwrap().unwrap().lens.focal
}

/// Tests that focal lengths that are 3 % too large and 3 % too small come together.
///
/// Eight views leave the focal length uncertain by 2 %, so the test does not ask for the true one.
#[test]
fn wrong_focal_lengths_come_together() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("data/room");
    let folder = tempfile::tempdir().unwrap();
    let text = std::fs::read_to_string(root.join("transforms.json")).unwrap();
    let learned = |wrong: f64| {
        let scene = folder.path().join(wrong.to_string());
        std::fs::create_dir(&scene).unwrap();
        for name in ["images", "points.ply", "priors", "split.json"] {
            std::os::unix::fs::symlink(root.join(name), scene.join(name)).unwrap();
        }
        let mut transforms: serde_json::Value = serde_json::from_str(&text).unwrap();
        for name in ["fl_x", "fl_y"] {
            transforms[name] = (wrong * transforms[name].as_f64().unwrap()).into();
        }
        std::fs::write(scene.join("transforms.json"), transforms.to_string()).unwrap();
        let more = ["--geometry-steps", "500", "--no-densify", "--set", "geometry.semantics=false"];
        let learn = ["--set", "geometry.rates.views=[0, 0, 1e-3, 0]"];
        wrong * learned_focal(&scene, &scene.join("run"), &[&more[..], &learn].concat())
    };
    let (large, small) = (learned(1.03), learned(0.97));
    println!("{large} {small}");
    let apart = (large / small).ln().abs();
    assert!(apart < 0.5 * (1.03_f64 / 0.97).ln(), "{large} {small}");
}

/// Tests that training learns half of the distortion of a wrong calibration.
///
/// Gaussians repeat the rest: photographs show a lens only by their disagreement.
#[test]
fn wrong_distortion_is_reduced() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("data/room");
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("scene");
    std::fs::create_dir(&place).unwrap();
    for name in ["images", "points.ply", "split.json"] {
        std::os::unix::fs::symlink(root.join(name), place.join(name)).unwrap();
    }
    let text = std::fs::read_to_string(root.join("transforms.json")).unwrap();
    let mut transforms: serde_json::Value = serde_json::from_str(&text).unwrap();
    let focal = transforms["fl_x"].as_f64().unwrap();
    let size = ["w", "h"].map(|name| transforms[name].as_f64().unwrap());
    let corner = 0.5 * size[0].hypot(size[1]) / focal;
    // The corners are 8 % away from where they belong: the room's images have no distortion.
    transforms["k1"] = (0.08 / corner.powi(2)).into();
    std::fs::write(place.join("transforms.json"), transforms.to_string()).unwrap();
    let run = folder.path().join("run");
    let (scene, text) = (place.display().to_string(), run.display().to_string());
    let learn = ["--geometry-steps", "500", "--set", "geometry.rates.views=[0, 0, 0, 1e-3]"];
    let lean = ["--no-densify", "--set", "geometry.semantics=false", "-q"];
    sgs(&[&["train", &scene, "-o", &text, "--stage", "geometry"], &learn[..], &lean].concat()).ok();
    let learned = RunDirectory::open(&run).unwrap().learned_views().unwrap().unwrap();
    let mut scene = Scene::open(&place, &SceneOptions::default()).unwrap();
    sgs_run::use_learned_views(&mut scene, &learned);
    let (x, _) = scene.views[0].distortion.distort(0.7 * corner, 0.0);
    let (wrong, left) = (0.08 * 0.7_f64.powi(2), x / (0.7 * corner) - 1.0);
    println!("{wrong} -> {left}");
    assert!(left.abs() < 0.6 * wrong, "{wrong} -> {left}");
}

/// Tests that a sensor's depth decides whether cameras and exposures are learned.
///
/// They are where photographs of the same points differ. A training that was killed decides the same.
#[test]
fn sensor_depth_decides_whether_views_are_learned() {
    let place = crate::depth::room();
    let path = place.path("scene");
    crate::depth::add_sensor(&path);
    std::fs::write(place.path("two.toml"), "[geometry]\nsteps = 2\n").unwrap();
    let (scene, options) = (place.text("scene"), place.text("two.toml"));
    let train = |run: &str, more: &[&str]| {
        let run = place.text(run);
        let base = ["train", &scene, "-o", &run, "--stage", "geometry", "--config", &options, "-q"];
        sgs(&[&base[..], more].concat()).ok();
    };
    let decided = |run: &str| {
        let text = std::fs::read_to_string(place.path(run).join("training.json")).unwrap();
        let training: serde_json::Value = serde_json::from_str(&text).unwrap();
        let decisions = training["decisions"].as_array().unwrap();
        let found = decisions.iter().find(|d| d["setting"] == "geometry.rates.views").unwrap();
        (found["on"].as_bool().unwrap(), found["measured"].as_f64().unwrap())
    };
    train("equal", &[]);
    let (on, exposures) = decided("equal");
    assert!(!on && exposures < 0.02 && !place.path("equal/cameras.json").exists(), "{exposures}");

    let opened = Scene::open(&path, &SceneOptions::default()).unwrap();
    repaint(&opened, |view, _, _, byte| [1.0, 0.6, 0.8][view % 3] * f64::from(byte));
    train("different", &[]);
    let (on, exposures) = decided("different");
    // The logarithms of the three factors.
    assert!(on && (0.1..0.35).contains(&exposures), "{exposures}");
    assert!(place.path("different/cameras.json").exists());
    // The same as with the rates.
    let [a, b, c, d] = ViewRates::RECORDING;
    train("given", &["--set", &format!("geometry.rates.views=[{a}, {b}, {c}, {d}]")]);
    for file in ["scene.ply", "cameras.json"] {
        assert!(place.read(&format!("given/{file}")) == place.read(&format!("different/{file}")), "{file}");
    }
    let alone = ["--stage", "geometry"];
    sgs(&place.arguments("straight", 60, &alone)).ok();
    place.train_killed("killed", 60, &alone, &[10, 40]);
    place.assert_same("straight", "killed");
    assert!(place.read("straight/cameras.json") == place.read("killed/cameras.json"));
}

/// Tests that the depths of a sensor show the focal length of its color camera: 525 of 585 pixels in a recording with a Kinect.
#[test]
fn lens_of_a_color_camera_is_found_by_its_sensor() {
    let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data/kitchen");
    if !scene.is_dir() {
        eprintln!("skipped: the recording is not there");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let more = ["--geometry-steps", "2", "--scale", "0.5", "--set", "geometry.rates.views=[0, 0, 1e-3, 0]"];
    let focal = learned_focal(&scene, &folder.path().join("run"), &more);
    // The sensor's centers lie apart, so that depth alone does not show the last percent.
    assert!((focal * 585.0 / 525.0 - 1.0).abs() < 0.03, "{focal}");
}
