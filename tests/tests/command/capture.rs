//! `sgs capture`: scenes from photographs and videos, by the real COLMAP and ffmpeg.
//!
//! Tests that need these programs, or photographs beside the repository, are skipped without them.

use sgs_scene::{Camera, Image, Layout, Scene, SceneOptions, resize, write_png};
use sgs_tests::cli::{self, sgs, sgs_with};
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Returns photographs of a fox with their cameras, beside the repository. They are not part of it.
fn fox() -> Option<PathBuf> {
    let beside = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data");
    let folder = std::env::var_os("SGS_TEST_DATA").map_or_else(beside, PathBuf::from).join("fox");
    if folder.join("images").is_dir() {
        return Some(folder);
    }
    println!("skipped: there are no photographs in {}", folder.display());
    None
}

/// Returns whether a program is installed.
fn has(program: &str) -> bool {
    let found = Command::new(program).arg("-version").env("QT_QPA_PLATFORM", "offscreen").output().is_ok();
    if !found {
        println!("skipped: {program} is not installed");
    }
    found
}

/// Returns the first photographs of the fox.
fn photographs(fox: &Path, count: usize) -> Vec<PathBuf> {
    let mut all: Vec<PathBuf> = std::fs::read_dir(fox.join("images")).unwrap().map(|e| e.unwrap().path()).collect();
    all.sort();
    all.truncate(count);
    all
}

/// Returns the names of the entries of a folder.
fn entries(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> =
        std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

/// Returns the largest relative difference between two shapes: of their pairwise distances at a common scale.
fn deformation(a: &[glam::DVec3], b: &[glam::DVec3]) -> f64 {
    let pairs = || (0..a.len()).flat_map(|i| (0..i).map(move |j| (i, j)));
    let scale =
        pairs().map(|(i, j)| a[i].distance(a[j])).sum::<f64>() / pairs().map(|(i, j)| b[i].distance(b[j])).sum::<f64>();
    let longest = pairs().map(|(i, j)| a[i].distance(a[j])).fold(0.0, f64::max);
    pairs().map(|(i, j)| (a[i].distance(a[j]) - scale * b[i].distance(b[j])).abs() / longest).fold(0.0, f64::max)
}

#[test]
fn photographs_become_a_scene_with_the_cameras_that_took_them() {
    let Some(fox) = fox().filter(|_| has("colmap")) else { return };
    let place = tempfile::tempdir().unwrap();
    let at = |name: &str| place.path().join(name);
    let text = |name: &str| at(name).display().to_string();
    std::fs::create_dir(at("photos")).unwrap();
    for photograph in photographs(&fox, 12) {
        std::fs::copy(&photograph, at("photos").join(photograph.file_name().unwrap())).unwrap();
    }
    // A photograph of something else, and one that is damaged.
    write_png(&at("photos/wall.png"), &Image::new(270, 480, 3)).unwrap();
    std::fs::write(at("photos/broken.jpg"), b"\xff\xd8\xff").unwrap();
    let finished = sgs(&["capture", &text("photos"), "-o", &text("scene")]).ok();
    assert!(finished.stderr.contains("not registered: broken.jpg: the JPEG file ends"), "{}", finished.stderr);
    assert!(finished.stderr.contains("not registered: wall.png: too few"), "{}", finished.stderr);
    assert_eq!(entries(place.path()), ["photos", "scene"], "temporary folders are removed");
    assert_eq!(entries(&at("scene")), ["capture.json", "images", "sparse"]);

    let record: serde_json::Value = serde_json::from_slice(&std::fs::read(at("scene/capture.json")).unwrap()).unwrap();
    let registered = record["registered"].as_u64().unwrap() as usize;
    assert_eq!((record["photographs"].as_u64(), record["matcher"].as_str()), (Some(14), Some("exhaustive")));
    assert_eq!(registered + record["unregistered"].as_array().unwrap().len(), 14);
    assert!(registered >= 10, "{record}");
    assert!(record["colmap"].as_str().unwrap().starts_with("COLMAP "), "{record}");

    let scene = Scene::open(&at("scene"), &SceneOptions::default()).unwrap();
    assert_eq!((scene.layout, scene.views.len(), scene.points_are_random), (Layout::Colmap, registered, false));
    assert!(scene.views.iter().all(|view| view.distortion.is_none()), "distortion is removed");
    // Their cameras were estimated before from all 67 photographs of the recording.
    let known = Camera::read_transforms(&fox.join("transforms.json")).unwrap();
    let known: HashMap<&str, &Camera> = known.iter().map(|camera| (camera.name.as_str(), camera)).collect();
    let ours: Vec<_> = scene.views.iter().map(|view| view.camera.position()).collect();
    let theirs: Vec<_> = scene.views.iter().map(|view| known[view.camera.name.as_str()].position()).collect();
    let apart = deformation(&theirs, &ours);
    println!("{registered} of 14 registered; centers differ by {apart:.4} of the longest distance");
    assert!(apart < 0.05, "{apart}");
    assert!(deformation(&theirs, &[&ours[1..], &ours[..1]].concat()) > 0.1, "the comparison sees exchanged cameras");
    sgs(&["capture", &text("photos"), "-o", &text("scene")]).refused_with(2, &["is a scene: name another directory"]);
}

#[test]
fn sharp_frames_of_a_video_become_a_scene() {
    let Some(fox) = fox().filter(|_| has("colmap") && has("ffmpeg")) else { return };
    let place = tempfile::tempdir().unwrap();
    let text = |name: &str| place.path().join(name).display().to_string();
    // Each photograph is one sharp frame between two blurred ones.
    let mut number = 0;
    for photograph in photographs(&fox, 10) {
        let sharp = sgs_scene::read_upright(&photograph).unwrap().image;
        let (w, h) = (sharp.width, sharp.height);
        let blurred = resize(&resize(&sharp, w / 6, h / 6), w, h);
        for frame in [&blurred, &sharp, &blurred] {
            write_png(&place.path().join(format!("{number:03}.png")), frame).unwrap();
            number += 1;
        }
    }
    let mut ffmpeg = Command::new("ffmpeg");
    ffmpeg.args(["-v", "error", "-framerate", "10", "-i", &text("%03d.png"), "-c:v", "ffv1", "-pix_fmt", "bgr0"]);
    assert!(ffmpeg.arg(text("walk.mkv")).status().unwrap().success());
    let options = ["--frames", "10", "--matcher", "exhaustive", "--json"];
    let finished = sgs(&[&["capture", &text("walk.mkv"), "-o", &text("scene")][..], &options].concat()).ok();
    let record = finished.json();
    assert_eq!((record["photographs"].as_u64(), record["source"].as_str()), (Some(10), Some("walk.mkv")));
    assert!(record["registered"].as_u64().unwrap() >= 8, "{record}");
    let sharp: Vec<String> = (0..10).map(|i| format!("frame_{:06}.jpg", 3 * i + 2)).collect();
    let images = entries(&place.path().join("scene/images"));
    assert!(images.iter().all(|name| sharp.contains(name)), "{images:?}");
    sgs(&["capture", &text("000.png"), "-o", &text("none")]).refused_with(42, &["is one photograph"]);
    std::fs::write(text("walk.mp4"), "no video").unwrap();
    sgs(&["-q", "capture", &text("walk.mp4"), "-o", &text("none")])
        .refused_with(42, &["ffmpeg cannot read", "as a video"]);
    assert!(!place.path().join("none").exists());
}

#[test]
fn photographs_without_overlap_are_refused_and_leave_nothing() {
    if !has("colmap") {
        return;
    }
    let place = tempfile::tempdir().unwrap();
    let text = |name: &str| place.path().join(name).display().to_string();
    std::fs::create_dir(text("photos")).unwrap();
    for i in 0..3 {
        let mut image = Image::new(96, 64, 3);
        image.data.iter_mut().for_each(|v| *v = 0.3 * i as f32);
        write_png(&place.path().join(format!("photos/{i}.png")), &image).unwrap();
    }
    let refused = sgs(&["-q", "capture", &text("photos"), "-o", &text("scene")]);
    refused.refused_with(42, &["COLMAP registered none of the 3 images", "overlapping, sharp photographs"]);
    assert_eq!(entries(place.path()), ["photos"]);
    std::fs::remove_file(text("photos/1.png")).unwrap();
    std::fs::remove_file(text("photos/2.png")).unwrap();
    sgs(&["-q", "capture", &text("photos"), "-o", &text("scene")])
        .refused_with(42, &["gives 1 images; cameras need two"]);
    assert_eq!(entries(place.path()), ["photos"]);
}

#[test]
fn stopping_a_capture_leaves_nothing() {
    let Some(fox) = fox().filter(|_| has("colmap")) else { return };
    let place = tempfile::tempdir().unwrap();
    let scene = place.path().join("scene");
    let source = fox.join("images").display().to_string();
    let mut child = cli::start(&["-q", "capture", &source, "-o", &scene.display().to_string()]);
    let begun = || {
        entries(place.path()).iter().any(|name| {
            let colmap = place.path().join(name).join("colmap/database.db");
            colmap.exists()
        })
    };
    assert!(cli::until(&mut child, begun));
    cli::signal(&child, "TERM");
    cli::wait(child).refused_with(75, &["the capture was stopped; nothing was written"]);
    assert_eq!(entries(place.path()), Vec::<String>::new());
}

#[test]
fn missing_programs_and_wrong_sources_are_refused() {
    let place = tempfile::tempdir().unwrap();
    let text = |name: &str| place.path().join(name).display().to_string();
    std::fs::create_dir(text("photos")).unwrap();
    sgs(&["capture", &text("photos"), "-o", &text("scene")]).refused_with(42, &["holds no photographs; give a folder"]);
    sgs(&["capture", &text("none"), "-o", &text("scene")]).refused_with(42, &["none does not exist; give a folder"]);
    for i in 0..2 {
        write_png(&place.path().join(format!("photos/{i}.png")), &Image::new(8, 6, 3)).unwrap();
    }
    let without = sgs_with(&["capture", &text("photos"), "-o", &text("scene")], &[("PATH", "")]);
    without.refused_with(1, &["the program colmap is not on the PATH", "apt-get install colmap"]);
    sgs(&["capture", &text("photos"), "-o", &text("photos")]).refused_with(2, &["do not belong to a scene"]);
    let few = sgs(&["capture", &text("photos"), "-o", &text("scene"), "--frames", "1"]);
    assert_eq!(few.status, Some(2), "{}", few.stderr);
    assert_eq!(entries(place.path()), ["photos"]);
}
