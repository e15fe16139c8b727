use std::path::Path;

use super::*;
use crate::image::{write_ids, write_npy_f32, write_png};
use crate::scene::SceneOptions;
use crate::unit::Unit;

const W: u32 = 8;
const H: u32 = 6;

/// Writes two views along x that look along −z. The first has sensor depth: 2500 units in the left half, none right.
fn write(root: &Path, top: &str) {
    let frame = |i: usize, more: &str| {
        let colors = (0..3 * W * H).map(|at| f32::from(u8::from(at % 3 == 0))).collect();
        write_png(&root.join(format!("v{i}.png")), &Image::from_data(W, H, 3, colors).unwrap()).unwrap();
        format!(r#"{{"file_path": "v{i}", {more} "transform_matrix": [[1,0,0,{i}],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}}"#)
    };
    let frames = [frame(0, r#""depth_file_path": "d.png","#), frame(1, "")].join(",");
    std::fs::write(root.join("transforms.json"), format!(r#"{{"fl_x": 4, {top} "frames": [{frames}]}}"#)).unwrap();
    std::fs::write(root.join("split.json"), r#"{"train": ["v0", "v1"], "test": []}"#).unwrap();
    let mut ids: Vec<u16> = (0..W * H).map(|at| if at % W < W / 2 { 2500 } else { 0 }).collect();
    ids[3] = u16::MAX;
    write_ids(&root.join("d.png"), W, H, &ids).unwrap();
}

fn open(root: &Path) -> Scene {
    Scene::open(root, &SceneOptions::default()).unwrap()
}

#[test]
fn sensor_depth_has_the_units_of_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    for (top, z) in [("", 2.5), (r#""depth_unit_scale_factor": 0.002,"#, 5.0)] {
        write(root, top);
        let scene = open(root);
        assert_eq!(scene.depth_meaning(), DepthMeaning::Metric);
        let map = scene.depth_prior(0).unwrap().unwrap();
        assert_eq!(scene.sensor_depth(0).unwrap().unwrap(), map);
        for (at, (value, known)) in map.image.data.iter().zip(&map.valid.data).enumerate() {
            let unknown = at as u32 % W >= W / 2 || at == 3;
            let expected = if unknown { (0.0, 0.0) } else { (z, 1.0) };
            assert_eq!((*value, *known), expected, "pixel {at}");
        }
        assert_eq!(scene.depth_prior(1).unwrap(), None);
        // Lengths of the computation are in another unit.
        let scaled = scene.in_unit(Unit::of_length(4.0)).depth_prior(0).unwrap().unwrap();
        assert_eq!(scaled.image.data[0], z / 4.0);
        // Half the size takes the depth at the center of each pixel.
        let half = scene.scaled(0.5).depth_prior(0).unwrap().unwrap();
        assert_eq!((half.image.width, half.image.data[1], half.image.data[2]), (W / 2, z, 0.0));
    }
}

#[test]
fn maps_of_the_priors_replace_the_sensor() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    write(root, "");
    let pixels = (W * H) as usize;
    std::fs::create_dir_all(root.join("priors/depth/confidence")).unwrap();
    let values: Vec<f32> = (0..pixels).map(|at| [-0.5, 0.25, f32::NAN, 0.0][at % 4]).collect();
    write_npy_f32(&root.join("priors/depth/v1.npy"), &[H as usize, W as usize], &values).unwrap();
    let confidence: Vec<f32> = (0..pixels).map(|at| if at < 8 { 0.5 } else { 2.0 }).collect();
    write_npy_f32(&root.join("priors/depth/confidence/v1.npy"), &[H as usize, W as usize], &confidence).unwrap();
    let settings = |text: &str| std::fs::write(root.join("priors/priors.json"), text).unwrap();

    settings(r#"{"depth": {"unit": 2.0}}"#);
    let scene = open(root);
    assert!(scene.depth_prior(0).unwrap().is_none());
    assert!(scene.sensor_depth(0).unwrap().is_some());
    let map = scene.depth_prior(1).unwrap().unwrap();
    assert_eq!(map.image.data[..4], [0.0, 0.5, 0.0, 0.0]);
    assert_eq!(map.valid.data[..4], [0.0, 0.5, 0.0, 0.0]);
    assert_eq!(map.valid.data[8..12], [0.0, 1.0, 0.0, 0.0]);

    settings(r#"{"depth": {"meaning": "inverse-scale-shift"}}"#);
    let scene = open(root);
    assert_eq!(scene.depth_meaning(), DepthMeaning::InverseScaleShift);
    let map = scene.depth_prior(1).unwrap().unwrap();
    assert_eq!(map.image.data[..4], [-0.5, 0.25, 0.0, 0.0]);
    assert_eq!(map.valid.data[..4], [0.5, 0.5, 0.0, 0.0]);
    // Depths without a scale give no points.
    assert!(scene.depth_points(10, 0).unwrap().is_none() && scene.points_are_random);

    for (text, expected) in [
        (r#"{"depth": {"unit": 0.0}}"#, "the unit of depth is 0; it must be a positive number"),
        (r#"{"depth": {"meaning": "miles"}}"#, "miles"),
    ] {
        settings(text);
        let error = Scene::open(root, &SceneOptions::default()).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    }
}

#[test]
fn scenes_without_points_start_from_depth() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    write(root, "");
    let scene = open(root);
    assert!(!scene.points_are_random);
    // The left half of one view, each pixel once.
    let points = &scene.points;
    assert_eq!(points.len() as u32, W / 2 * H - 1);
    let mut places: Vec<[i32; 2]> = Vec::new();
    for p in &points.positions {
        assert_eq!(p[2], -2.5);
        let pixel = [p[0] * 4.0 / 2.5 + 4.0, 3.0 - p[1] * 4.0 / 2.5];
        assert!(pixel[0] < 4.0 && pixel.iter().all(|v| (v.fract() - 0.5).abs() < 1e-5), "{pixel:?}");
        places.push(pixel.map(|v| v as i32));
    }
    places.sort_unstable();
    places.dedup();
    assert_eq!(places.len(), points.len());
    assert!(points.colors.as_ref().unwrap().iter().all(|c| *c == [1.0, 0.0, 0.0]));
    let some = scene.depth_points(7, 3).unwrap().unwrap();
    assert_eq!(some.len(), 7);
    assert_eq!(scene.depth_points(7, 3).unwrap().unwrap(), some);
    assert_ne!(scene.depth_points(7, 4).unwrap().unwrap(), some);
}

#[test]
fn missing_depth_files_cause_a_warning() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    write(root, "");
    std::fs::remove_file(root.join("d.png")).unwrap();
    let scene = open(root);
    assert!(
        scene.warnings.iter().any(|w| w.contains("depth_file_path") && w.contains("d.png")),
        "{:?}",
        scene.warnings
    );
    assert!(scene.depth_prior(0).unwrap().is_none() && scene.points_are_random);
    for unit in ["0", "-1", "1e999"] {
        write(root, &format!(r#""depth_unit_scale_factor": {unit},"#));
        let error = Scene::open(root, &SceneOptions::default()).unwrap_err().to_string();
        assert!(error.contains("depth_unit_scale_factor") || unit == "1e999", "{error}");
    }
}
