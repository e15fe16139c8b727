//! One synthesized scene in three layouts.
//!
//! Readers find the same cameras, images and ground truth, and training runs on each.

use sgs_scene::{GroundTruth, GroundTruthKind, Image, Layout, Scene, SceneOptions};
use sgs_synth::{SynthLayout, SynthOptions, generate};
use sgs_tests::cli::sgs;
use std::path::Path;

fn make(out: &Path, layout: SynthLayout) -> Scene {
    let size = SynthOptions { views: 4, test_views: 1, width: 48, height: 36, ..SynthOptions::default() };
    let options = SynthOptions { layout, samples_per_pixel: 8, points: 400, ..size };
    generate(out, &options, &|_, _| ()).unwrap();
    Scene::open(out, &SceneOptions::default()).unwrap()
}

/// Returns the largest difference between two images.
fn apart(a: &Image, b: &Image) -> f32 {
    assert_eq!((a.width, a.height, a.channels), (b.width, b.height, b.channels));
    a.data.iter().zip(&b.data).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
}

/// Returns the largest difference of values clipped at white, at valid pixels.
///
/// A pixel is valid if `counts` is above 0.5.
fn clipped_apart(a: &Image, b: &Image, counts: &Image) -> f32 {
    let clip = |image: &Image| {
        let value = |(i, v): (usize, &f32)| if counts.data[i / 3] > 0.5 { v.min(1.0) } else { 0.0 };
        Image { data: image.data.iter().enumerate().map(value).collect(), ..image.clone() }
    };
    apart(&clip(a), &clip(b))
}

/// Compares a scene with its nerfstudio layout view by view.
///
/// `test` is the prefix of the name of the test view.
fn assert_same(scene: &Scene, other: &Scene, test: &str) {
    assert_eq!((scene.split.train.len(), scene.split.test.len()), (4, 1));
    assert_eq!(
        (&scene.points, scene.warnings.len(), scene.exposure()),
        (&other.points, 0, 1.0),
        "{:?}",
        scene.warnings
    );
    let (truth, theirs) = (GroundTruth::of(scene), GroundTruth::of(other));
    let relit = theirs.relit_names();
    assert!(relit.len() == 4 && truth.relit_names() == relit, "{:?}", truth.relit_names());
    for j in 0..5 {
        let name = if j < 4 { format!("train_00{j}") } else { format!("{test}_000") };
        let i = scene.views.iter().position(|view| view.camera.name == name).unwrap();
        assert_eq!(scene.split.test.contains(&i), other.split.test.contains(&j), "{name}");
        let (a, b) = (&scene.views[i].camera, &other.views[j].camera);
        assert_eq!((a.width, a.height, a.cx, a.cy), (b.width, b.height, b.cx, b.cy));
        assert!((a.fx - b.fx).abs() < 1e-4 && (a.fy - b.fy).abs() < 1e-4, "{name}: {} and {}", a.fx, b.fx);
        let turned = (a.rotation - b.rotation).to_cols_array();
        assert!(turned.iter().all(|v| v.abs() < 1e-6) && a.translation.distance(b.translation) < 1e-6, "{name}");
        assert!(apart(&scene.load_image(i).unwrap(), &other.load_image(j).unwrap()) < 0.004, "{name}");
        let mask = theirs.load(GroundTruthKind::Mask, j).unwrap().unwrap();
        assert!(mask.data.iter().filter(|m| **m > 0.5).count() > mask.data.len() / 2);
        for kind in GroundTruthKind::ALL {
            let load =
                |truth: &GroundTruth, view| truth.load(kind, view).unwrap().unwrap_or_else(|| panic!("{kind:?}"));
            let (ours, theirs) = (load(&truth, i), load(&theirs, j));
            // An 8-bit step of a normal component is 1/127, more for normals of half the length.
            let tolerance = if kind == GroundTruthKind::Normal { 0.02 } else { 0.004 };
            let worst = if ours.channels == 3 { clipped_apart(&ours, &theirs, &mask) } else { apart(&ours, &theirs) };
            assert!(worst < tolerance, "{name}: {kind:?} differs by {worst}");
        }
        assert_eq!(truth.semantic(i).unwrap(), theirs.semantic(j).unwrap());
        for set in &relit {
            let (ours, theirs) = (truth.relit(set, i).unwrap(), theirs.relit(set, j).unwrap());
            assert_eq!((ours.is_some(), theirs.is_some()), (j == 4, j == 4), "{name} of {set}");
            if let (Some(ours), Some(theirs)) = (ours, theirs) {
                let all = Image { channels: 1, data: vec![1.0; mask.data.len()], ..mask.clone() };
                // An 8-bit sRGB step near white is 0.009 in linear light.
                assert!(clipped_apart(&ours, &theirs, &all) < 0.01, "{name} of {set}");
            }
        }
    }
}

#[test]
fn layouts_hold_the_same_scene_and_train() {
    let folder = tempfile::tempdir().unwrap();
    let place = |name: &str| folder.path().join(name);
    let reference = make(&place("nerfstudio"), SynthLayout::Nerfstudio);
    let tensoir = make(&place("tensoir"), SynthLayout::TensoIr);
    let fipt = make(&place("fipt"), SynthLayout::Fipt);
    let layouts = [&reference, &tensoir, &fipt].map(|scene| scene.layout);
    assert_eq!(layouts, [Layout::Transforms, Layout::Blender, Layout::Fipt]);
    assert_same(&tensoir, &reference, "test");
    assert_same(&fipt, &reference, "val");
    let trained = ["nerfstudio", "tensoir", "fipt"].map(|name| {
        let (scene, run) = (place(name).display().to_string(), place(&format!("{name}_run")).display().to_string());
        sgs(&["train", &scene, "-o", &run, "--geometry-steps", "30", "--no-densify"]).ok();
        let mean = sgs(&["eval", &run, "--json"]).ok().json()["mean"].clone();
        let of = |key: &str| {
            mean.pointer(key).and_then(serde_json::Value::as_f64).unwrap_or_else(|| panic!("{key}: {mean}"))
        };
        [of("/nvs/psnr"), of("/normal_mae_deg"), of("/depth_rel"), of("/semantic/accuracy")]
    });
    println!("{trained:?}");
    for other in &trained[1..] {
        let tolerances = [0.5, 1.0, 0.02, 0.1];
        for ((a, b), tolerance) in trained[0].iter().zip(other).zip(tolerances) {
            assert!((a - b).abs() < tolerance, "{trained:?}");
        }
    }
}

#[test]
fn the_command_writes_a_layout() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("scene");
    let text = out.display().to_string();
    let make =
        |layout: &str| sgs(&["synth", &text, "--scene", "box", "--views", "2", "--size", "16x16", "--layout", layout]);
    make("colmap").refused(&["no layout is called", "nerfstudio, tensoir, fipt"]);
    make("fipt").ok();
    assert!(out.join("val/Image/000_0001.exr").is_file() && !out.join("transforms.json").exists());
}
