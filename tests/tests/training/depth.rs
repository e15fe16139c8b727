//! Prior depths in training: they improve geometry, whatever they mean, and give points to start from.

use sgs_config::Settings;
use sgs_evaluate::evaluate;
use sgs_scene::{GroundTruth, GroundTruthKind, Scene, SceneOptions, write_npy_f32};
use sgs_tests::cli::sgs;
use sgs_tests::rooms::Room;
use sgs_tests::{Gpu, Place};
use std::path::Path;

/// Writes a room with its true depths and without priors. Photographs and depth alone count.
pub(crate) fn room() -> Place {
    Place::new(Room { size: [64, 48], truth: true, ..Room::default() })
}

/// Writes the true depths of the training views as priors. `change` maps view and depth.
fn write_priors(scene: &Path, settings: &str, change: impl Fn(usize, f32) -> f32) {
    let opened = Scene::open(scene, &SceneOptions::default()).unwrap();
    let truth = GroundTruth::of(&opened);
    let folder = scene.join("priors/depth");
    std::fs::create_dir_all(&folder).unwrap();
    for (k, &i) in opened.split.train.iter().enumerate() {
        let map = truth.load(GroundTruthKind::Depth, i).unwrap().unwrap();
        let values: Vec<f32> = map.data.iter().map(|&z| if z > 0.0 { change(k, z) } else { f32::NAN }).collect();
        let file = folder.join(format!("{}.npy", opened.views[i].camera.name));
        write_npy_f32(&file, &[map.height as usize, map.width as usize], &values).unwrap();
    }
    std::fs::write(scene.join("priors/priors.json"), settings).unwrap();
}

/// Trains the room and returns the mean relative error of depth at the test views.
fn depth_error(gpu: &Gpu, scene: &Path, weight: f32) -> f64 {
    let mut s = Settings { scene: scene.to_owned(), ..Settings::default() };
    (s.geometry.steps, s.geometry.densify.until) = (300, 0.0);
    s.geometry.losses.depth = weight;
    let scene = Scene::open(scene, &SceneOptions::default()).unwrap();
    let mut training = sgs_train::Geometry::new(gpu.device(), &scene, &s, None).unwrap();
    let decision = training.decisions().iter().find(|d| d.what == "prior depth").unwrap();
    assert_eq!(decision.on, weight > 0.0, "{decision}");
    let mut last = 0.0;
    let progress = |p: &sgs_train::Progress| {
        if let sgs_train::Progress::Step(r) = p {
            last = r.losses.depth;
        }
    };
    training.train(s.geometry.steps, progress, || true).unwrap();
    assert_eq!(last > 0.0, weight > 0.0);
    let found = evaluate(gpu.device(), &scene, training.gaussians(), &scene.split.test, [0.0; 3], |_, _| Ok(()));
    found.unwrap().mean.depth_rel.unwrap()
}

#[test]
fn prior_depths_of_every_meaning_improve_geometry() {
    let gpu = Gpu::new();
    let place = room();
    let scene = place.path("scene");
    write_priors(&scene, r#"{"depth": {"meaning": "metric", "unit": 0.5}}"#, |_, z| 2.0 * z);
    let without = depth_error(&gpu, &scene, 0.0);
    let metric = depth_error(&gpu, &scene, 0.2);
    // Each view has another factor, and another shift.
    write_priors(&scene, r#"{"depth": {"meaning": "scale"}}"#, |k, z| (1.0 + k as f32) * z);
    let scale = depth_error(&gpu, &scene, 0.2);
    let change = |k: usize, z: f32| (3.0 + k as f32) * (1.0 / z) - 0.5 * k as f32;
    write_priors(&scene, r#"{"depth": {"meaning": "inverse-scale-shift"}}"#, change);
    let shift = depth_error(&gpu, &scene, 0.2);
    println!("depth error: {without:.4} without, {metric:.4} metric, {scale:.4} scale, {shift:.4} scale and shift");
    assert!(metric < 0.6 * without);
    assert!(scale < 0.8 * without && shift < 0.8 * without);
}

/// Gives each frame the true depth as that of a sensor. Removes the points.
pub(crate) fn add_sensor(scene: &Path) {
    let text = std::fs::read_to_string(scene.join("transforms.json")).unwrap();
    let mut listing: serde_json::Value = serde_json::from_str(&text).unwrap();
    listing.as_object_mut().unwrap().remove("ply_file_path");
    listing["depth_unit_scale_factor"] = 1.0.into();
    let opened = Scene::open(scene, &SceneOptions::default()).unwrap();
    let truth = GroundTruth::of(&opened);
    std::fs::create_dir(scene.join("sensor")).unwrap();
    for frame in listing["frames"].as_array_mut().unwrap() {
        let stem = Path::new(frame["file_path"].as_str().unwrap()).file_stem().unwrap().to_str().unwrap().to_owned();
        let i = opened.views.iter().position(|v| v.camera.name == stem).unwrap();
        let map = truth.load(GroundTruthKind::Depth, i).unwrap().unwrap();
        let name = format!("sensor/{stem}.npy");
        write_npy_f32(&scene.join(&name), &[map.height as usize, map.width as usize], &map.data).unwrap();
        frame["depth_file_path"] = name.into();
    }
    std::fs::write(scene.join("transforms.json"), listing.to_string()).unwrap();
    let points = std::fs::remove_file(scene.join("points.ply"));
    assert!(points.is_ok() || opened.points_are_random);
}

/// Tests that a scene without a point cloud starts from depth.
///
/// The sensor is measured at test views.
#[test]
fn sensor_depth_gives_points_and_is_measured() {
    let place = room();
    add_sensor(&place.path("scene"));
    let (scene, run) = (place.text("scene"), place.text("run"));
    let options = ["--stage", "geometry", "--geometry-steps", "60", "--no-densify", "--set", "random_points=3000"];
    let output = sgs(&[&["train", &scene, "-o", &run], &options[..]].concat()).ok();
    assert!(!output.stderr.contains("random points"), "{}", output.stderr);
    let measures = place.text("measures.json");
    sgs(&["eval", &run, "--json", &measures]).ok();
    let measures: serde_json::Value = serde_json::from_slice(&std::fs::read(&measures).unwrap()).unwrap();
    let number = |name: &str| measures["mean"][name].as_f64().unwrap();
    // The sensor shows the truth; only the mask of materials leaves other pixels out.
    assert!(number("sensor_depth_rel") < 0.06, "{measures}");
    assert!((number("sensor_depth_rel") - number("depth_rel")).abs() < 0.02, "{measures}");
}
