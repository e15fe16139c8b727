//! Scenes of real photographs and of a video, by the real COLMAP and ffmpeg.
//!
//! Tests are skipped without these programs, or without the photographs beside the repository.

use crate::capture::{entries, fox, has};
use glam::DVec3;
use sgs_capture::{CaptureOptions, Captured, Matcher, capture};
use sgs_scene::{Camera, Image, Layout, Scene, SceneOptions, read_upright, resize, write_png};
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::AtomicBool;

/// Returns the first photographs of the fox.
fn photographs(fox: &Path, count: usize) -> Vec<PathBuf> {
    let mut all: Vec<PathBuf> = std::fs::read_dir(fox.join("images")).unwrap().map(|e| e.unwrap().path()).collect();
    all.sort();
    all.truncate(count);
    all
}

/// Returns the largest relative difference between two shapes: of their pairwise distances at a common scale.
fn deformation(a: &[DVec3], b: &[DVec3]) -> f64 {
    let pairs = || (0..a.len()).flat_map(|i| (0..i).map(move |j| (i, j)));
    let scale =
        pairs().map(|(i, j)| a[i].distance(a[j])).sum::<f64>() / pairs().map(|(i, j)| b[i].distance(b[j])).sum::<f64>();
    let longest = pairs().map(|(i, j)| a[i].distance(a[j])).fold(0.0, f64::max);
    pairs().map(|(i, j)| (a[i].distance(a[j]) - scale * b[i].distance(b[j])).abs() / longest).fold(0.0, f64::max)
}

/// Captures without stopping.
fn run(source: &Path, output: &Path, options: &CaptureOptions) -> sgs_capture::Result<Captured> {
    capture(source, output, options, &AtomicBool::new(false), &|step| println!("{step}"))
}

#[test]
fn photographs_become_a_scene_with_the_cameras_that_took_them() {
    let Some(fox) = fox().filter(|_| has("colmap")) else { return };
    let place = tempfile::tempdir().unwrap();
    let at = |name: &str| place.path().join(name);
    std::fs::create_dir(at("photos")).unwrap();
    for photograph in photographs(&fox, 12) {
        std::fs::copy(&photograph, at("photos").join(photograph.file_name().unwrap())).unwrap();
    }
    // A photograph of something else, and one that is damaged.
    write_png(&at("photos/wall.png"), &Image::new(270, 480, 3)).unwrap();
    std::fs::write(at("photos/broken.jpg"), b"\xff\xd8\xff").unwrap();
    let captured = run(&at("photos"), &at("scene"), &CaptureOptions::default()).unwrap();
    let reason = |file: &str| captured.unregistered.iter().find(|u| u.file == file).map(|u| u.reason.as_str());
    assert!(reason("broken.jpg").is_some_and(|reason| reason.starts_with("the JPEG file ends")), "{captured:?}");
    assert_eq!(reason("wall.png"), Some("too few of its features match other images"), "{captured:?}");
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
    assert_eq!(captured.registered, registered);
}

#[test]
fn sharp_frames_of_a_video_become_a_scene() {
    let Some(fox) = fox().filter(|_| has("colmap") && has("ffmpeg")) else { return };
    let place = tempfile::tempdir().unwrap();
    let at = |name: &str| place.path().join(name);
    // Each photograph is one sharp frame between two blurred ones.
    let mut number = 0;
    for photograph in photographs(&fox, 10) {
        let sharp = read_upright(&photograph).unwrap().image;
        let (w, h) = (sharp.width, sharp.height);
        let blurred = resize(&resize(&sharp, w / 6, h / 6), w, h);
        for frame in [&blurred, &sharp, &blurred] {
            write_png(&place.path().join(format!("{number:03}.png")), frame).unwrap();
            number += 1;
        }
    }
    let mut ffmpeg = Command::new("ffmpeg");
    ffmpeg.args(["-v", "error", "-framerate", "10", "-i", "%03d.png", "-c:v", "ffv1", "-pix_fmt", "bgr0", "walk.mkv"]);
    assert!(ffmpeg.current_dir(place.path()).status().unwrap().success());
    let options = CaptureOptions { frames: 10, matcher: Some(Matcher::Exhaustive) };
    let captured = run(&at("walk.mkv"), &at("scene"), &options).unwrap();
    assert_eq!((captured.photographs, captured.source.as_str()), (10, "walk.mkv"));
    assert!(captured.registered >= 8, "{captured:?}");
    let sharp: Vec<String> = (0..10).map(|i| format!("frame_{:06}.jpg", 3 * i + 2)).collect();
    let images = entries(&place.path().join("scene/images"));
    assert!(images.iter().all(|name| sharp.contains(name)), "{images:?}");
    let fail = |name: &str| run(&at(name), &at("none"), &options).unwrap_err().to_string();
    assert!(fail("000.png").ends_with("000.png is one photograph; give the folder with all of them"));
    std::fs::write(at("walk.mp4"), "no video").unwrap();
    let error = fail("walk.mp4");
    assert!(error.starts_with("ffmpeg cannot read") && error.contains("as a video"), "{error}");
    assert!(!at("none").exists());
}
