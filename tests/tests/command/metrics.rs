//! Image metrics against independent implementations on the same images. `tests/data/metrics/make.py` computed the
//! expected values with scikit-image, scipy and flip-evaluator.

use serde_json::{Value, json};
use sgs_evaluate::metrics::{depth_rel, flip, mse, normal_mae_deg, psnr, psnr_scaled, ssim};
use sgs_scene::{Image, LoadOptions, Scene, SceneOptions};
use sgs_tests::rooms::{Room, write_json};
use std::path::{Path, PathBuf};

/// Largest allowed difference, in the unit of each metric.
const AGREE: f64 = 1e-4;

fn data() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("data/metrics")
}

/// Returns images by name, loaded as a scene's photographs are.
fn renderings(names: &[String]) -> Vec<Image> {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("images")).unwrap();
    let first = Room { views: names.len(), size: [72, 54], ..Room::default() }.cameras();
    let cameras: Vec<_> =
        first.into_iter().zip(names).map(|(c, n)| sgs_scene::Camera { name: n.clone(), ..c }).collect();
    for name in names {
        let file = format!("{name}.png");
        std::fs::copy(data().join(&file), folder.path().join("images").join(&file)).unwrap();
    }
    write_json(&folder.path().join("transforms.json"), &sgs_tests::rooms::transforms(&cameras));
    let scene = Scene::open(folder.path(), &SceneOptions::default()).unwrap();
    let find = |name: &String| scene.views.iter().find(|v| v.camera.name == *name).unwrap();
    names.iter().map(|n| find(n).load_image(&LoadOptions::default()).unwrap()).collect()
}

/// Decodes the colors of a normal map to vectors.
fn vectors(image: &Image) -> Image {
    Image { data: image.data.iter().map(|v| 2.0 * v - 1.0).collect(), ..image.clone() }
}

/// Converts red to depth between 1 and 3.
fn depth(image: &Image) -> Image {
    Image { channels: 1, data: image.data.iter().step_by(3).map(|v| 1.0 + 2.0 * v).collect(), ..image.clone() }
}

/// Returns a sentence for each metric that disagrees.
fn disagreements(expected: &Value, found: &[(&str, f64)]) -> Vec<String> {
    let wrong = found.iter().filter(|(k, v)| !expected[*k].as_f64().is_some_and(|e| (e - v).abs() <= AGREE));
    wrong.map(|(k, v)| format!("{k} is {v}, but {} elsewhere", expected[*k])).collect()
}

#[test]
fn metrics_match_independent_implementations() {
    let text = std::fs::read_to_string(data().join("expected.json")).unwrap();
    let expected: Value = serde_json::from_str(&text).unwrap();
    let pairs = expected["pairs"].as_object().unwrap();
    let mut names: Vec<String> = pairs.keys().cloned().collect();
    names.push("truth".into());
    let images = renderings(&names);
    let truth = &images[names.len() - 1];
    for (name, image) in names.iter().zip(&images).filter(|(n, _)| *n != "truth") {
        let found = [
            ("mse", mse(image, truth, None).unwrap()),
            ("psnr", psnr(image, truth, None).unwrap()),
            ("psnr_scaled", psnr_scaled(image, truth, None).unwrap()),
            ("ssim", ssim(image, truth, None).unwrap()),
            ("flip", flip(image, truth, None).unwrap()),
            ("normal_mae_deg", normal_mae_deg(&vectors(image), &vectors(truth), None).unwrap()),
            ("depth_rel", depth_rel(&depth(image), &depth(truth), None).unwrap()),
        ];
        println!("{name}: {found:?}");
        assert_eq!(disagreements(&pairs[name], &found), [""; 0], "{name}");
        // Every metric distinguishes this image from another.
        let other = if name == "blur" { "noise" } else { "blur" };
        assert_eq!(disagreements(&pairs[other], &found).len(), found.len(), "{name}");
    }
    assert!(pairs.len() >= 6);
}

#[test]
fn metric_mismatch_is_detected() {
    let expected = json!({"psnr": 30.0, "ssim": 0.9});
    assert!(disagreements(&expected, &[("psnr", 30.00005), ("ssim", 0.9)]).is_empty());
    let found = [("psnr", 30.0002), ("ssim", f64::NAN), ("flip", 0.1)];
    assert_eq!(disagreements(&expected, &found).len(), 3);
}
