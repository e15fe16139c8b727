//! Cameras, exposures and the lens that training learns: the same bits after interruptions, and poses and focal lengths better
//! than they were given.

use glam::{DMat3, DQuat};
use sgs_run::{LearnedViewRow, RunDirectory};
use sgs_scene::{Scene, SceneOptions};
use sgs_tests::Place;
use sgs_tests::cli::sgs;
use sgs_tests::rooms::Room;
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
    assert!(run.learned_views().unwrap().is_some());
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
