//! Semantic features and text embeddings on disk.

use half::f16;
use sgs_scene::{FeatureMap, Image, Scene, SceneOptions, write_png};
use std::path::Path;

fn npy(descr: &str, shape: &str, data: &[u8]) -> Vec<u8> {
    let mut header = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}");
    while (header.len() + 11) % 64 != 0 {
        header.push(' ');
    }
    header.push('\n');
    let length = (header.len() as u16).to_le_bytes();
    [b"\x93NUMPY\x01\x00", &length[..], header.as_bytes(), data].concat()
}

fn halves(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|&v| f16::from_f32(v).to_le_bytes()).collect()
}

/// Writes a scene with three 8×6 views, two feature maps and two classes. The maps differ in size and have two
/// channels. One view has no map.
fn write_scene(root: &Path, lens: &str) {
    let frame = |i: usize| {
        write_png(&root.join(format!("v{i}.png")), &Image::new(8, 6, 3)).unwrap();
        format!(r#"{{"file_path": "v{i}", "transform_matrix": [[1,0,0,{i}],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}}"#)
    };
    let frames: Vec<String> = (0..3).map(frame).collect();
    let json = format!(r#"{{"fl_x": 4, {lens} "frames": [{}]}}"#, frames.join(","));
    std::fs::write(root.join("transforms.json"), json).unwrap();
    std::fs::create_dir_all(root.join("priors/semantic")).unwrap();
    let write = |name: &str, bytes: Vec<u8>| std::fs::write(root.join("priors/semantic").join(name), bytes).unwrap();
    write("v0.npy", npy("<f2", "(1, 2, 2)", &halves(&[1.0, 0.0, f32::NAN, 2.0])));
    let all: Vec<f32> = (0..48).flat_map(|i| [i as f32, -1.0]).collect();
    write("v1.npy", npy("<f2", "(6, 8, 2)", &halves(&all)));
    let text: Vec<u8> = [3.0_f32, 0.0, 0.0, 0.5].iter().flat_map(|v| v.to_le_bytes()).collect();
    write("text_embeddings.npy", npy("<f4", "(2, 2)", &text));
    write("labels.json", br#"{"labels": ["floor", "wall"]}"#.to_vec());
}

fn open(root: &Path) -> Scene {
    Scene::open(root, &SceneOptions::default()).unwrap()
}

#[test]
fn maps_may_differ_in_size_and_lack_cells() {
    let directory = tempfile::tempdir().unwrap();
    write_scene(directory.path(), "");
    let scene = open(directory.path());
    let map = scene.semantic_prior(0).unwrap().unwrap();
    assert_eq!((map.width, map.height, map.channels), (2, 1, 2));
    assert!(map.data[2].is_nan() && map.data[3] == f16::from_f32(2.0));
    let map = scene.semantic_prior(1).unwrap().unwrap();
    assert_eq!((map.width, map.height, map.data[94]), (8, 6, f16::from_f32(47.0)));
    assert_eq!(scene.semantic_prior(2).unwrap(), None);
}

#[test]
fn channel_mismatch_is_reported() {
    let directory = tempfile::tempdir().unwrap();
    write_scene(directory.path(), "");
    let path = directory.path().join("priors/semantic/v0.npy");
    std::fs::write(&path, npy("<f2", "(1, 2, 3)", &halves(&[1.0; 6]))).unwrap();
    let error = open(directory.path()).semantic_prior(0).unwrap_err().to_string();
    assert!(
        error.contains("v0.npy: the map has 3 features a cell, but text_embeddings.npy beside it has 2"),
        "{error}"
    );
}

#[test]
fn class_names_must_be_unique() {
    let directory = tempfile::tempdir().unwrap();
    write_scene(directory.path(), "");
    let text = open(directory.path()).text_embeddings().unwrap().unwrap();
    assert_eq!(text.class("wall"), Ok(1));
    let error = text.class("chair").unwrap_err().to_string();
    assert_eq!(error, "there is no class \"chair\"; there are floor, wall");
    let labels = directory.path().join("priors/semantic/labels.json");
    let refused = |content: &str| {
        std::fs::write(&labels, content).unwrap();
        open(directory.path()).text_embeddings().unwrap_err().to_string()
    };
    assert!(refused(r#"{"labels": ["wall", "wall"]}"#).contains("labels.json: \"wall\" occurs twice"));
    assert!(refused(r#"{"labels": ["wall"]}"#).contains("each of the 1 classes in labels.json"));
}

/// Checks that features are undistorted cell by cell. The lens compresses the image toward the center: the center
/// stays, and corner cells come from positions further inside.
#[test]
fn distortion_is_removed_cell_by_cell() {
    let directory = tempfile::tempdir().unwrap();
    write_scene(directory.path(), "\"camera_model\": \"OPENCV\", \"k1\": -0.2,");
    let FeatureMap { width, data, .. } = open(directory.path()).semantic_prior(1).unwrap().unwrap();
    let cell = |x: usize, y: usize| data[2 * (y * width + x)].to_f32() as usize;
    assert_eq!(cell(3, 2), 2 * 8 + 3);
    assert_ne!(cell(0, 0), 0);
    assert!(cell(0, 0) % 8 > 0 && cell(7, 5) % 8 < 7);
}
