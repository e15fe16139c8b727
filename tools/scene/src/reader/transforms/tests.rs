use std::path::PathBuf;

use glam::DVec3;
use tempfile::TempDir;

use super::*;
use crate::camera::Projection;
use crate::image::{Image, write_png};
use crate::reader::Frame;

const POSE: &str = "[[1,0,0,1],[0,1,0,2],[0,0,1,3],[0,0,0,1]]";

fn read(root: &Path) -> Result<Found> {
    super::read(root, None)
}

/// Creates a scene directory with black 8×6 images.
fn scene(json: &str, images: &[&str]) -> (TempDir, PathBuf) {
    let directory = tempfile::tempdir().unwrap();
    let root = directory.path().to_path_buf();
    std::fs::write(root.join("transforms.json"), json).unwrap();
    for name in images {
        let path = root.join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        write_png(&path, &Image::new(8, 6, 3)).unwrap();
    }
    (directory, root)
}

fn found(json: &str, images: &[&str]) -> Found {
    let (_keep, root) = scene(json, images);
    read(&root).unwrap()
}

fn fail(json: &str, images: &[&str]) -> String {
    let (_keep, root) = scene(json, images);
    let error = read(&root).unwrap_err().to_string();
    error.replace(&format!("{}/", root.display()), "")
}

/// Returns a file with one frame, with extra fields in the frame and at the top.
fn one(top: &str, frame: &str) -> String {
    format!("{{{top} \"frames\": [{{\"file_path\": \"a.png\", \"transform_matrix\": {POSE} {frame}}}]}}")
}

#[test]
fn global_intrinsics_and_opengl_poses_are_read() {
    let found =
        found(&one("\"fl_x\": 5, \"fl_y\": 6, \"cx\": 3.5, \"cy\": 2.5, \"w\": 8.0, \"h\": 6,", ""), &["a.png"]);
    let Frame { camera, lens, image, .. } = &found.frames[0];
    assert_eq!((camera.fx, camera.fy, camera.cx, camera.cy), (5.0, 6.0, 3.5, 2.5));
    assert_eq!((camera.width, camera.height, camera.name.as_str()), (8, 6, "a"));
    assert!((camera.position() - DVec3::new(1.0, 2.0, 3.0)).length() < 1e-12);
    assert!((camera.forward() + DVec3::Z).length() < 1e-12);
    assert!(lens.is_none() && image.ends_with("a.png"));
    assert!(found.warnings.is_empty() && found.points.is_none());
}

#[test]
fn frame_fields_override_the_file_and_size_defaults_to_the_image() {
    let json = one(
        "\"camera_angle_x\": 1.0, \"k1\": 0.1, \"p2\": 0.2, \"w\": 99, \"h\": 99,",
        ", \"fl_x\": 7, \"cx\": 1.25, \"k1\": 0.5, \"k4\": -1, \"width\": 8, \"height\": 6",
    );
    let Frame { camera, lens, .. } = &found(&json, &["a.png"]).frames[0];
    assert_eq!((camera.fx, camera.fy, camera.cx, camera.cy), (7.0, 7.0, 1.25, 3.0));
    assert_eq!((lens.k1, lens.p2, lens.k4, lens.k2), (0.5, 0.2, -1.0, 0.0));

    let Frame { camera, .. } = &found(&one("\"camera_angle_x\": 1.5707963267948966,", ""), &["a.png"]).frames[0];
    assert_eq!((camera.width, camera.height), (8, 6));
    assert!((camera.fx - 4.0).abs() < 1e-9 && camera.fy == camera.fx);
    assert_eq!((camera.cx, camera.cy), (4.0, 3.0));

    let json = one("\"camera_angle_x\": 1.5707963267948966, \"camera_angle_y\": 1.5707963267948966,", "");
    let Frame { camera, .. } = &found(&json, &["a.png"]).frames[0];
    assert!((camera.fx - 4.0).abs() < 1e-9 && (camera.fy - 3.0).abs() < 1e-9);
}

#[test]
fn fisheye_lenses_may_differ_between_frames() {
    let json = one(
        "\"fl_x\": 5, \"camera_model\": \"OPENCV\", \"k1\": 0.1,",
        ", \"camera_model\": \"OPENCV_FISHEYE\", \"k3\": 0.2",
    );
    let Frame { lens, .. } = &found(&json, &["a.png"]).frames[0];
    assert_eq!((lens.projection, lens.k1, lens.k3), (Projection::Equidistant, 0.1, 0.2));
    let json = one("\"fl_x\": 5, \"is_fisheye\": true,", "");
    assert_eq!(found(&json, &["a.png"]).frames[0].lens.projection, Projection::Equidistant);
    assert!(found(&one("\"fl_x\": 5,", ""), &["a.png"]).frames[0].lens.is_none());
}

#[test]
fn masks_and_depth_are_named_by_frames() {
    let named = ", \"mask_path\": \"m/a.png\", \"depth_file_path\": \".\\\\d\\\\a.png\"";
    let top = "\"fl_x\": 5, \"depth_unit_scale_factor\": 0.002,";
    let (_keep, root) = scene(&one(top, named), &["a.png", "m/a.png", "d/a.png", "masks/a.png"]);
    let beside = &read(&root).unwrap().frames[0].beside;
    assert_eq!(beside.mask, Some(root.join("m/a.png")));
    let depth = beside.depth.as_ref().unwrap();
    assert!(depth.path.ends_with("d/a.png") && depth.unit == 0.002, "{depth:?}");
    std::fs::remove_file(root.join("m/a.png")).unwrap();
    std::fs::remove_file(root.join("d/a.png")).unwrap();
    let found = read(&root).unwrap();
    assert_eq!((&found.frames[0].beside.mask, &found.frames[0].beside.depth), (&None, &None));
    assert!(
        found.warnings[0].contains("1 frames in") && found.warnings[0].contains("name a mask_path"),
        "{:?}",
        found.warnings
    );
    assert!(found.warnings[1].contains("name a depth_file_path that does not exist"), "{:?}", found.warnings);
    let unit = |unit: &str| {
        one(&format!("\"fl_x\": 5, \"depth_unit_scale_factor\": {unit},"), ", \"depth_file_path\": \"a.png\"")
    };
    assert!(fail(&unit("0"), &["a.png"]).contains("depth_unit_scale_factor is 0; it must be a positive number"));
}

#[test]
fn missing_images_are_skipped_with_one_warning() {
    let frame = |name: &str| format!("{{\"file_path\": \"./images/{name}\", \"transform_matrix\": {POSE}}}");
    let names = ["b", "c.png", "d.png", "e"];
    let json = format!("{{\"fl_x\": 5, \"frames\": [{}]}}", names.map(frame).join(","));
    let found = found(&json, &["images/b.png", "images/d.png"]);
    let stems: Vec<_> = found.frames.iter().map(|f| f.camera.name.as_str()).collect();
    assert_eq!(stems, ["b", "d"]);
    assert_eq!(found.missing, ["c", "e"]);
    assert_eq!(found.warnings.len(), 1);
    assert!(found.warnings[0].starts_with("2 of 4 frames in "), "{:?}", found.warnings);
}

#[test]
fn held_out_frames_are_read_from_a_companion_file() {
    let (_keep, root) = scene(&one("\"fl_x\": 5,", ""), &["a.png", "b.png", "c.png"]);
    let frame = |name: &str| format!("{{\"file_path\": \"{name}.png\", \"transform_matrix\": {POSE}}}");
    let frames = ["a", "b", "c", "gone"].map(frame).join(",");
    let json = format!("{{\"fl_x\": 7, \"frames\": [{frames}]}}");
    std::fs::write(root.join("transforms_val.json"), json).unwrap();
    let stems = |found: &Found| found.frames.iter().map(|f| f.camera.name.clone()).collect::<Vec<_>>();
    // Companions are not read unless a split names their views.
    assert_eq!(stems(&read(&root).unwrap()), ["a"]);
    std::fs::write(root.join("split.json"), r#"{"train": ["a"], "test": ["b", "gone"]}"#).unwrap();
    let found = read(&root).unwrap();
    assert_eq!(stems(&found), ["a", "b"]);
    assert_eq!((found.frames[0].camera.fx, found.frames[1].camera.fx), (5.0, 7.0));
    assert_eq!(found.missing, ["gone"]);
    assert!(found.warnings[0].starts_with("1 of 2 frames in ") && found.warnings[0].contains("transforms_val.json"));
}

#[test]
fn points_come_from_the_named_or_a_default_file() {
    let cloud = |x: f32| PointCloud { positions: vec![[x, 0.0, 0.0]], ..Default::default() };
    let (_keep, root) = scene(&one("\"fl_x\": 5,", ""), &["a.png"]);
    for (x, name) in [(3.0, "points3d.ply"), (2.0, "init.ply"), (1.0, "points.ply")] {
        cloud(x).write_ply(&root.join(name)).unwrap();
        assert_eq!(read(&root).unwrap().points.unwrap().positions, [[x, 0.0, 0.0]]);
    }
    std::fs::write(root.join("transforms.json"), one("\"fl_x\": 5, \"ply_file_path\": \"init.ply\",", "")).unwrap();
    assert_eq!(read(&root).unwrap().points.unwrap().positions[0][0], 2.0);

    std::fs::remove_file(root.join("init.ply")).unwrap();
    let error = read(&root).unwrap_err().to_string();
    assert!(error.contains("init.ply, which does not exist; put it there or remove the key"), "{error}");
    PointCloud::default().write_ply(&root.join("init.ply")).unwrap();
    let error = read(&root).unwrap_err().to_string();
    assert!(error.contains("init.ply: the file holds no points"), "{error}");
}

#[test]
fn each_error_has_its_message() {
    let good = &["a.png"];
    assert!(fail("{\n\"frames\": [\n}", good).starts_with("transforms.json, line 3, column 1: "));
    assert!(fail("{\"fl_x\": 5}", good).contains("missing field `frames`"));
    let wrong = "{\"w\": 1,\n\"fl_x\": \"a\",\n\"frames\": [\n]}";
    assert!(fail(wrong, good).contains("transforms.json, line 2, column 11: invalid type: string \"a\""));
    let wrong = "{\"frames\": [{\"file_path\": \"a\",\n\"cx\": [],\n\"h\": 2}]}";
    assert!(fail(wrong, good).contains("transforms.json, line 2, column 6: invalid type: sequence"));
    assert!(fail("{\"frames\": []}", good).contains("the list of frames is empty"));
    assert!(fail("{\"frames\": [{}]}", good).contains("frame 0: there is no file_path"));
    assert!(fail("{\"frames\": [{\"file_path\": \"a\"}]}", good).contains("frame 0 (a): there is no transform_matrix"));
    let none = fail(&one("\"fl_x\": 5,", ""), &[]);
    assert!(none.contains("none of the 1 frames has its image (the first should be a.png)"), "{none}");
    let with = |top: &str| fail(&one(top, ""), good);
    assert!(with("").contains("frame 0 (a.png): there is no focal length; add fl_x or camera_angle_x"));
    assert!(with("\"fl_x\": 0,").contains("the focal lengths are 0 and 0 pixels"));
    assert!(with("\"fl_x\": 5, \"fl_y\": -1,").contains("the focal lengths are 5 and -1"));
    assert!(with("\"camera_angle_x\": 3.2,").contains("the field of view is 3.2 radians"));
    assert!(with("\"fl_x\": 5, \"w\": 8.5, \"h\": 6,").contains("the image size is 8.5×6; w and h must be whole"));
    assert!(with("\"fl_x\": 5, \"w\": 0, \"h\": 6,").contains("the image size is 0×6"));
    assert!(with("\"fl_x\": 5, \"w\": 1e6, \"h\": 6,").contains("no side may exceed 65536"));
    assert!(with("\"fl_x\": 5, \"camera_model\": \"EQUIRECTANGULAR\",").contains("camera model is EQUIRECTANGULAR"));
    let skewed = one("\"fl_x\": 5,", "").replace("[1,0,0,1]", "[1,0.5,0,1]");
    assert!(fail(&skewed, good).contains("frame 0 (a.png): transform_matrix is not a rigid pose"));
    let (_keep, root) = scene(&one("\"fl_x\": 5,", ""), &[]);
    std::fs::write(root.join("a.png"), "not an image").unwrap();
    let error = read(&root).unwrap_err().to_string();
    assert!(error.contains("a.png: the file cannot be read as PNG"), "{error}");
}

#[test]
fn cameras_are_read_without_images() {
    let cameras = |json: &str, images: &[&str]| {
        let (_keep, root) = scene(json, images);
        Camera::read_transforms(&root.join("transforms.json"))
    };
    let sized = cameras(&one("\"fl_x\": 5, \"w\": 8, \"h\": 6,", ""), &[]).unwrap();
    assert_eq!((sized[0].name.as_str(), sized[0].width, sized[0].cx), ("a", 8, 4.0));
    let from_image = cameras(&one("\"fl_x\": 5,", ""), &["a.png"]).unwrap();
    assert_eq!(from_image, sized);
    let error = cameras(&one("\"fl_x\": 5,", ""), &[]).unwrap_err().to_string();
    assert!(error.contains("frame 0 (a.png): the image size is unknown; add w and h"), "{error}");

    let frame = format!("{{\"transform_matrix\": {POSE}}}");
    let unnamed = format!("{{\"fl_x\": 5, \"w\": 8, \"h\": 6, \"frames\": [{frame}, {frame}]}}");
    let names: Vec<_> = cameras(&unnamed, &[]).unwrap().into_iter().map(|c| c.name).collect();
    assert_eq!(names, ["000", "001"]);
    let twice = unnamed.replace("{\"tr", "{\"file_path\": \"x.png\", \"tr");
    let error = cameras(&twice, &[]).unwrap_err().to_string();
    assert!(error.contains("frame 1 (x.png): the name \"x\" was used before"), "{error}");
    assert!(
        Camera::read_transforms(Path::new("/none.json")).unwrap_err().to_string().contains("cannot read /none.json")
    );
}

#[test]
fn truncated_files_are_errors_and_damage_never_panics() {
    let json = one("\"fl_x\": 5, \"w\": 8, \"h\": 6, \"k1\": 0.1,", ", \"fl_y\": 6");
    let (_keep, root) = scene(&json, &["a.png"]);
    let path = root.join("transforms.json");
    assert!(read(&root).is_ok());
    for length in 0..json.len() {
        std::fs::write(&path, &json[..length]).unwrap();
        assert!(read(&root).unwrap_err().to_string().contains("transforms.json, line 1, column "));
        for byte in *b"9-\"[}x" {
            let mut damaged = json.clone().into_bytes();
            damaged[length] = byte;
            std::fs::write(&path, &damaged).unwrap();
            let _ = (read(&root), Camera::read_transforms(&path));
        }
    }
}
