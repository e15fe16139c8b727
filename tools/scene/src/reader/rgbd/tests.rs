use glam::DVec3;

use super::*;
use crate::image::{Image, write_ids, write_png};
use crate::reader::Layout;
use crate::{Scene, SceneOptions};

/// A camera at (1, 2, 3) that looks along the world's x axis: its z axis. Its y axis stays.
const POSE: &str = "0 0 1 1\n0 1 0 2\n-1 0 0 3\n0 0 0 1\n";

fn put(root: &Path, name: &str, content: &str) {
    let path = root.join(name);
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    std::fs::write(path, content).unwrap();
}

fn image(root: &Path, name: &str, size: (u32, u32)) {
    put(root, name, "");
    write_png(&root.join(name), &Image::new(size.0, size.1, 3)).unwrap();
}

fn depth(root: &Path, name: &str) {
    put(root, name, "");
    write_ids(&root.join(name), 2, 1, &[1500, 0]).unwrap();
}

fn check(frame: &Frame) {
    assert!((frame.camera.position() - DVec3::new(1.0, 2.0, 3.0)).length() < 1e-12, "{}", frame.camera.position());
    assert!((frame.camera.forward() - DVec3::X).length() < 1e-12, "{}", frame.camera.forward());
}

fn seven(root: &Path, folder: &str, number: u32, pose: &str) {
    let at = |suffix: &str| format!("{folder}frame-{number:06}.{suffix}");
    image(root, &at("color.png"), (320, 240));
    depth(root, &at("depth.png"));
    put(root, &at("pose.txt"), pose);
}

#[test]
fn frames_of_seven_scenes_have_poses_and_depth() {
    let directory = tempfile::tempdir().unwrap();
    let root = directory.path();
    seven(root, "seq-02/", 7, POSE);
    seven(root, "seq-01/", 7, &POSE.replace(' ', "\t "));
    seven(root, "seq-01/", 8, "nan nan nan nan\nnan nan nan nan\nnan nan nan nan\n0 0 0 1\n");
    assert_eq!(Layout::of(root), Some(Layout::Rgbd));
    let found = read(root).unwrap();
    assert_eq!(found.missing, ["seq-01_frame-000008"]);
    assert!(found.warnings[0].contains("1 of 3 frames"), "{:?}", found.warnings);
    let names: Vec<_> = found.frames.iter().map(|frame| frame.camera.name.as_str()).collect();
    assert_eq!(names, ["seq-01_frame-000007", "seq-02_frame-000007"]);
    found.frames.iter().for_each(check);
    let camera = &found.frames[0].camera;
    assert_eq!([camera.fx, camera.fy, camera.cx, camera.cy], [292.5, 292.5, 160.0, 120.0]);
    let sensor = found.frames[0].beside.depth.clone().unwrap();
    assert_eq!((sensor.path, sensor.unit), (root.join("seq-01/frame-000007.depth.png"), 0.001));
    // 3DMatch adds a calibration, whose size is that of the images.
    put(root, "camera-intrinsics.txt", "300 0 161\n0 301 121\n0 0 1\n");
    let camera = &read(root).unwrap().frames[0].camera;
    assert_eq!([camera.fx, camera.fy, camera.cx, camera.cy], [300.0, 301.0, 161.0, 121.0]);
    let scene = Scene::open(root, &SceneOptions::default()).unwrap();
    assert_eq!(scene.views[1].beside.depth.as_ref().unwrap().unit, 0.001);
}

#[test]
fn frames_of_tum_are_matched_by_time() {
    let directory = tempfile::tempdir().unwrap();
    let root = directory.path().join("rgbd_dataset_freiburg3_desk");
    put(&root, "rgb.txt", "# color\n10.000 rgb/10.000.png\n10.100 rgb/10.100.png\n11.5 rgb/11.5.png\n12 rgb/12.png\n");
    put(&root, "depth.txt", "# depth\n10.095 depth/10.095.png\n10.015 depth/10.015.png\n");
    // A quarter about y turns the camera's z axis to the world's x axis.
    let turned = "1 2 3 0 0.7071067811865476 0 0.7071067811865476";
    put(&root, "groundtruth.txt", &format!("# poses\n10.09 {turned}\n9.99 {turned}\n20 {turned}\n12.0 {turned}\n"));
    for name in ["rgb/10.000.png", "rgb/10.100.png", "rgb/11.5.png"] {
        image(&root, name, (640, 480));
    }
    depth(&root, "depth/10.095.png");
    assert_eq!(Layout::of(&root), Some(Layout::Rgbd));
    let found = read(&root).unwrap();
    assert_eq!(found.missing, ["11.5"]);
    assert!(found.warnings.iter().any(|w| w.contains("1 of 4 frames") && w.contains("image does not exist")));
    found.frames.iter().for_each(check);
    let camera = &found.frames[0].camera;
    assert_eq!((camera.name.as_str(), camera.fx, camera.cy), ("10.000", 535.4, 247.6));
    assert_eq!(found.frames[0].beside.depth, None, "the file does not exist");
    assert_eq!(found.frames[1].beside.depth.as_ref().unwrap().unit, 0.0002);
    put(&root, "groundtruth.txt", "10 1 2 3 0 0 0 x\n");
    let error = read(&root).unwrap_err().to_string();
    assert!(error.contains("groundtruth.txt, line 1: the line is not a time"), "{error}");
    put(&root, "groundtruth.txt", "10 1 2 3\n");
    let error = read(&root).unwrap_err().to_string();
    assert!(error.contains("groundtruth.txt, line 1: \"10 1 2 3\" is not a time and 7 or more values"), "{error}");
}

#[test]
fn frames_of_scannet_are_skipped_where_tracking_was_lost() {
    let directory = tempfile::tempdir().unwrap();
    let root = directory.path();
    for number in 0..3 {
        image(root, &format!("color/{number}.png"), (12, 9));
        put(root, &format!("pose/{number}.txt"), POSE);
    }
    depth(root, "depth/0.png");
    put(root, "pose/1.txt", "-inf -inf -inf -inf\n-inf -inf -inf -inf\n-inf -inf -inf -inf\n-inf -inf -inf -inf\n");
    put(root, "intrinsic/intrinsic_color.txt", "11 0 6 0\n0 12 4.5 0\n0 0 1 0\n0 0 0 1\n");
    assert_eq!(Layout::of(root), Some(Layout::Rgbd));
    let found = read(root).unwrap();
    assert_eq!(found.missing, ["1"]);
    found.frames.iter().for_each(check);
    let camera = &found.frames[1].camera;
    assert_eq!((camera.name.as_str(), camera.fx, camera.fy, camera.cy), ("2", 11.0, 12.0, 4.5));
    assert!(found.frames[0].beside.depth.is_some() && found.frames[1].beside.depth.is_none());
    put(root, "pose/2.txt", "1 0 0 0\n0 2 0 0\n0 0 1 0\n");
    let error = read(root).unwrap_err().to_string();
    assert!(error.contains("2.txt: the pose is not a rigid pose"), "{error}");
    put(root, "intrinsic/intrinsic_color.txt", "11 0 6\n");
    let error = read(root).unwrap_err().to_string();
    assert!(error.contains("intrinsic_color.txt, line 1: \"11 0 6\" is not 4 numbers"), "{error}");
}

#[test]
fn nearest_times_are_within_the_tolerance() {
    let lines: Vec<numbers::Timed> =
        [1.0, 2.0, 2.5].map(|time| numbers::Timed { time, words: Vec::new(), line: 1 }).into();
    let of = |time| numbers::nearest(&lines, time, 0.3);
    assert_eq!(
        [of(0.5), of(0.8), of(1.9), of(2.2), of(2.3), of(2.8), of(3.0)],
        [None, Some(0), Some(1), Some(1), Some(2), Some(2), None]
    );
    assert_eq!(numbers::nearest(&[], 1.0, 1.0), None);
}
