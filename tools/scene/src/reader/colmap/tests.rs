use std::path::PathBuf;

use glam::DVec3;
use tempfile::TempDir;

use super::*;
use crate::image::{Image, write_png};

const CAMERAS: &str = "# a comment\n3 OPENCV 8 6 5 6 3.5 2.5 0.1 0.2 0.3 0.4\n\n7 SIMPLE_PINHOLE 8 6 5 4 3\n";
const IMAGES: &str = "# a comment\n10 1 0 0 0 1 2 3 3 b c.png\n1.5 2.5 -1 4 5 6\n\
                      11 0.7071067811865476 0 0.7071067811865476 0 0 0 0 7 a.png\n\n12 1 0 0 0 0 0 0 7 gone.png\n";
const POINTS: &str = "# a comment\n1 0.5 -1 2 255 0 51 0.9 10 0 11 1\n5 1 2 3 0 0 0 0.1\n";

fn put(root: &Path, name: &str, content: &[u8]) {
    let path = root.join(name);
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    std::fs::write(path, content).unwrap();
}

fn text_scene() -> (TempDir, PathBuf) {
    let directory = tempfile::tempdir().unwrap();
    let root = directory.path().to_path_buf();
    put(&root, "sparse/0/cameras.txt", CAMERAS.as_bytes());
    put(&root, "sparse/0/images.txt", IMAGES.as_bytes());
    put(&root, "sparse/0/points3D.txt", POINTS.as_bytes());
    std::fs::create_dir(root.join("images")).unwrap();
    for name in ["a.png", "b c.png"] {
        write_png(&root.join("images").join(name), &Image::new(8, 6, 3)).unwrap();
    }
    (directory, root)
}

/// Returns the same model in binary form, written record by record.
fn binary_files() -> [(&'static str, Vec<u8>); 3] {
    let floats = |v: &[f64]| v.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    let mut cameras = 2_u64.to_le_bytes().to_vec();
    for (id, model, parameters) in
        [(3_u32, 4_i32, &[5., 6., 3.5, 2.5, 0.1, 0.2, 0.3, 0.4][..]), (7, 0, &[5., 4., 3.][..])]
    {
        cameras.extend(id.to_le_bytes());
        cameras.extend(model.to_le_bytes());
        cameras.extend(8_u64.to_le_bytes());
        cameras.extend(6_u64.to_le_bytes());
        cameras.extend(floats(parameters));
    }
    let mut images = 3_u64.to_le_bytes().to_vec();
    let h = 0.5_f64.sqrt();
    for (id, pose, camera, name, observed) in [
        (10_u32, [1., 0., 0., 0., 1., 2., 3.], 3_u32, "b c.png", 2_u64),
        (11, [h, 0., h, 0., 0., 0., 0.], 7, "a.png", 0),
        (12, [1., 0., 0., 0., 0., 0., 0.], 7, "gone.png", 0),
    ] {
        images.extend(id.to_le_bytes());
        images.extend(floats(&pose));
        images.extend(camera.to_le_bytes());
        images.extend(name.as_bytes());
        images.push(0);
        images.extend(observed.to_le_bytes());
        (0..observed).for_each(|_| images.extend([7; 24]));
    }
    let mut points = 2_u64.to_le_bytes().to_vec();
    for (id, p, rgb, track) in [(1_u64, [0.5, -1., 2.], [255_u8, 0, 51], 2_u64), (5, [1., 2., 3.], [0, 0, 0], 0)] {
        points.extend(id.to_le_bytes());
        points.extend(floats(&p));
        points.extend(rgb);
        points.extend(floats(&[0.9]));
        points.extend(track.to_le_bytes());
        for image in 0..track as u32 {
            points.extend((10 + image).to_le_bytes());
            points.extend(image.to_le_bytes());
        }
    }
    [("cameras.bin", cameras), ("images.bin", images), ("points3D.bin", points)]
}

fn binary_scene() -> (TempDir, PathBuf) {
    let (directory, root) = text_scene();
    std::fs::remove_dir_all(root.join("sparse/0")).unwrap();
    for (name, content) in binary_files() {
        put(&root, &format!("sparse/{name}"), &content);
    }
    (directory, root)
}

fn check(found: &Found) {
    assert_eq!(found.missing, ["gone"]);
    assert_eq!(found.warnings.len(), 1);
    let [first, second] = &found.frames[..] else { panic!("{} frames", found.frames.len()) };
    assert_eq!((first.camera.name.as_str(), second.camera.name.as_str()), ("b c", "a"));
    let Camera { width, height, fx, fy, cx, cy, .. } = first.camera;
    assert_eq!((width, height, fx, fy, cx, cy), (8, 6, 5.0, 6.0, 3.5, 2.5));
    let lens = first.lens;
    assert_eq!((lens.k1, lens.k2, lens.p1, lens.p2), (0.1, 0.2, 0.3, 0.4));
    assert!((first.camera.position() + DVec3::new(1.0, 2.0, 3.0)).length() < 1e-12);
    assert!(second.lens.is_none());
    // A quarter turn about y maps the world's −x to the camera's z.
    assert!((second.camera.forward() + DVec3::X).length() < 1e-12);
    let points = found.points.as_ref().unwrap();
    assert_eq!(points.positions, [[0.5, -1.0, 2.0], [1.0, 2.0, 3.0]]);
    assert_eq!(points.colors.as_ref().unwrap()[0], [1.0, 0.0, 0.2]);
    // Images 10 ("b c") and 11 ("a") observe the first point; no image observes the second.
    let tracks = found.tracks.as_ref().unwrap();
    assert_eq!(tracks.seen_twice(&["a", "b c"].into()), [true, false]);
    assert_eq!(tracks.seen_twice(&["a"].into()), [false, false]);
}

#[test]
fn text_model_is_read() {
    let (_keep, root) = text_scene();
    assert_eq!(find(&root).unwrap(), Location { folder: root.join("sparse/0"), binary: false });
    check(&read(&root).unwrap());
}

#[test]
fn binary_model_takes_precedence_over_text() {
    let (_keep, root) = binary_scene();
    put(&root, "sparse/cameras.txt", b"not read");
    assert_eq!(find(&root).unwrap(), Location { folder: root.join("sparse"), binary: true });
    check(&read(&root).unwrap());
}

#[test]
fn points_are_read_from_a_ply_file() {
    let (_keep, root) = text_scene();
    std::fs::remove_file(root.join("sparse/0/points3D.txt")).unwrap();
    assert!(read(&root).unwrap().points.is_none());
    let cloud = PointCloud { positions: vec![[4.0; 3]], ..Default::default() };
    cloud.write_ply(&root.join("sparse/0/points3D.ply")).unwrap();
    assert_eq!(read(&root).unwrap().points.unwrap(), cloud);
}

#[test]
fn each_text_error_has_its_message() {
    let fail = |name: &str, content: &str| {
        let (_keep, root) = text_scene();
        put(&root, &format!("sparse/0/{name}"), content.as_bytes());
        let error = read(&root).unwrap_err().to_string();
        error.replace(&format!("{}/sparse/0/", root.display()), "")
    };
    let cameras = |content: &str| fail("cameras.txt", content);
    assert!(cameras("3 OPENCV 8\n").starts_with("cameras.txt, line 1: the line ends before height in pixels"));
    assert!(cameras("#\nx OPENCV").starts_with("cameras.txt, line 2: \"x\" is no camera number"));
    assert!(cameras("3 NEW 8 6 1 2 3 4 5").contains("line 1: the camera model is NEW, but only"));
    assert!(cameras("3 EQUIRECTANGULAR 8 6 8 6").contains("line 1: the camera model is EQUIRECTANGULAR, a panorama"));
    let fov = CAMERAS.replace("OPENCV 8 6 5 6 3.5 2.5 0.1 0.2 0.3 0.4", "FOV 8 6 5 6 3.5 2.5 4");
    assert!(cameras(&fov).contains("camera 3: the field of view omega is 4 radians; it must lie between -π and π"));
    assert!(cameras("3 PINHOLE 8 6 1 2 3").contains("the model PINHOLE has 3 parameters; it must have 4"));
    assert!(cameras("3 PINHOLE 8 6 1 2 3 x").contains("\"x\" is no camera parameter"));
    assert!(
        cameras("7 PINHOLE 8 6 1 1 4 3").contains("images.txt, line 2 (b c.png): the image has the camera 3, which")
    );
    let nan = CAMERAS.replace("5 6 3.5", "nan 6 3.5");
    assert!(cameras(&nan).contains("cameras.txt, camera 3: the focal lengths are NaN and 6"));
    assert!(cameras(&CAMERAS.replace("8 6 5 6", "0 6 5 6")).contains("the image size is 0×6"));
    assert!(cameras(&CAMERAS.replace("0.4", "inf")).contains("distortion holds values that are not finite"));
    assert!(cameras(&CAMERAS.replace("8 6 5 6", "99999999999 6 5 6")).contains("no side may exceed"));

    let images = |content: &str| fail("images.txt", content);
    assert!(images("# nothing\n").contains("images.txt: no image is registered"));
    assert!(images("1 1 0 0 0 1 2 3 3\n").contains("line 1: the line ends before the name of the image"));
    assert!(images("1 1 0 0 zero\n").contains("line 1: \"zero\" is no part of a quaternion"));
    assert!(images("1 2 0 0 0 1 2 3 3 a.png\n").contains("line 1 (a.png): the quaternion [2.0, 0.0, 0.0, 0.0]"));
    assert!(images("1 1 0 0 0 nan 2 3 3 a.png\n").contains("the pose holds values that are not finite"));
    assert!(images("1 1 0 0 0 1 2 3 3 z.png\n").contains("none of the 1 images exists (the first should be "));

    let points = |content: &str| fail("points3D.txt", content);
    assert!(points("#\n").contains("points3D.txt: the file holds no points"));
    assert!(points("1 0 0 nan 1 2 3 0\n").contains("line 1: the position is not finite"));
    assert!(points("1 0 0 0 1 2 300 0\n").contains("\"300\" is no color from 0 to 255"));
    assert!(points("1 0 0 0 1 2 3 0.5 x 1\n").contains("line 1: \"x\" is no image of a track"));
    assert!(points("1 0 0 0 1 2 3 0.5 10 0 11\n").contains("the line ends before the second half of a track"));
}

#[test]
fn truncated_binary_files_are_errors() {
    let (_keep, root) = binary_scene();
    for (name, content) in binary_files() {
        for length in 0..content.len() {
            put(&root, &format!("sparse/{name}"), &content[..length]);
            let error = read(&root).unwrap_err().to_string();
            assert!(error.contains(name) && error.contains("byte "), "{name} {length}: {error}");
        }
        for i in 0..content.len() {
            let mut damaged = content.clone();
            damaged[i] ^= 0xff;
            put(&root, &format!("sparse/{name}"), &damaged);
            let _ = read(&root);
        }
        put(&root, &format!("sparse/{name}"), &u64::MAX.to_le_bytes());
        let error = read(&root).unwrap_err().to_string();
        assert!(error.contains("byte 0: 18446744073709551615 records are promised, but only 0 bytes"), "{error}");
        put(&root, &format!("sparse/{name}"), &content);
    }
    check(&read(&root).unwrap());
}

#[test]
fn truncated_text_files_never_panic() {
    for (name, content) in [("cameras.txt", CAMERAS), ("images.txt", IMAGES), ("points3D.txt", POINTS)] {
        let (_keep, root) = text_scene();
        for length in 0..content.len() {
            put(&root, &format!("sparse/0/{name}"), &content.as_bytes()[..length]);
            let _ = read(&root);
        }
    }
}

#[test]
fn unsupported_models_are_rejected_by_name() {
    let (_keep, root) = binary_scene();
    let mut cameras = binary_files()[0].1.clone();
    cameras[12] = 18;
    put(&root, "sparse/cameras.bin", &cameras);
    let error = read(&root).unwrap_err().to_string();
    assert!(error.contains("camera 3: the camera model is number 18, but only SIMPLE_PINHOLE"), "{error}");
}

#[test]
fn views_of_equal_stems_are_named_with_their_folders() {
    let (_keep, root) = text_scene();
    let image = |id: u32, name: &str| format!("{id} 1 0 0 0 0 0 0 7 {name}\n\n");
    let names = ["left/deep/0.png", "right\\0.png", "right/1.png", "0.png"];
    let list: String = (1..).zip(names).map(|(id, name)| image(id, name)).collect();
    put(&root, "sparse/0/images.txt", list.as_bytes());
    put(&root, "sparse/0/points3D.txt", b"1 0 0 0 1 2 3 0.5 2 0 3 0\n2 0 0 0 1 2 3 0.5 1 0 4 0\n");
    for name in names {
        let path = root.join("images").join(name.replace('\\', "/"));
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        write_png(&path, &Image::new(8, 6, 3)).unwrap();
    }
    let found = read(&root).unwrap();
    let views: Vec<&str> = found.frames.iter().map(|frame| frame.camera.name.as_str()).collect();
    assert_eq!(views, ["left_deep_0", "right_0", "1", "0"]);
    let tracks = found.tracks.unwrap();
    assert_eq!(tracks.seen_twice(&["right_0", "1"].into()), [true, false]);
    assert_eq!(tracks.seen_twice(&["left_deep_0", "0"].into()), [false, true]);

    // A name that folders and a file make alike.
    write_png(&root.join("images/left_deep_0.png"), &Image::new(8, 6, 3)).unwrap();
    put(&root, "sparse/0/images.txt", format!("{list}{}", image(9, "left_deep_0.png")).as_bytes());
    let error = read(&root).unwrap_err().to_string();
    assert!(error.contains("this image and left/deep/0.png would both be the view left_deep_0"), "{error}");
}

#[test]
fn model_in_the_scene_directory_is_read() {
    let (_keep, root) = text_scene();
    std::fs::rename(root.join("sparse/0"), root.join("model")).unwrap();
    for name in ["cameras.txt", "images.txt", "points3D.txt"] {
        std::fs::rename(root.join("model").join(name), root.join(name)).unwrap();
    }
    assert_eq!(crate::Layout::of(&root), Some(crate::Layout::Colmap));
    check(&read(&root).unwrap());
    for name in ["a.png", "b c.png"] {
        std::fs::rename(root.join("images").join(name), root.join(name)).unwrap();
    }
    check(&read(&root).unwrap());
}

#[test]
fn model_folder_opens_its_scene() {
    use crate::{Layout, Scene, SceneOptions};
    let (_directory, root) = text_scene();
    let root = root.canonicalize().unwrap();
    let open = |path: &Path| Scene::open(path, &SceneOptions::default()).unwrap();
    let scene = open(&root.join("sparse/0"));
    assert_eq!((scene.root.as_path(), scene.layout, scene.views.len()), (root.as_path(), Layout::Colmap, 2));
    // nerfstudio stores COLMAP's folder beside the images.
    std::fs::create_dir(root.join("colmap")).unwrap();
    std::fs::rename(root.join("sparse"), root.join("colmap/sparse")).unwrap();
    for path in [root.clone(), root.join("colmap/sparse/0")] {
        let scene = open(&path);
        assert_eq!((scene.root.as_path(), scene.views.len()), (root.as_path(), 2));
    }
    // A model in a folder with another name belongs to no scene.
    std::fs::rename(root.join("colmap/sparse/0"), root.join("colmap/sparse/1")).unwrap();
    assert!(Scene::open(&root.join("colmap/sparse/1"), &SceneOptions::default()).is_err());
}
