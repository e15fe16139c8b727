use super::*;
use crate::image::write_png;

/// Writes a scene of `n` 8×6 views along the x axis that look along −z. Images are `v0.png`, `v1.png`, and so on.
fn write_scene(root: &Path, n: usize, extra: &str) {
    let frame = |i: usize| {
        write_png(&root.join(format!("v{i}.png")), &Image::new(8, 6, 3)).unwrap();
        format!(r#"{{"file_path": "v{i}", "transform_matrix": [[1,0,0,{i}],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}}"#)
    };
    let frames: Vec<_> = (0..n).rev().map(frame).collect();
    let json = format!(r#"{{"fl_x": 4, {extra} "frames": [{}]}}"#, frames.join(","));
    std::fs::write(root.join("transforms.json"), json).unwrap();
}

fn open(root: &Path, change: impl FnOnce(&mut SceneOptions)) -> Result<Scene> {
    let mut options = SceneOptions::default();
    change(&mut options);
    Scene::open(root, &options)
}

#[test]
fn views_are_ordered_by_number_and_split() {
    let directory = tempfile::tempdir().unwrap();
    write_scene(directory.path(), 12, "");
    let scene = open(directory.path(), |_| ()).unwrap();
    let names: Vec<_> = scene.views.iter().map(|view| view.camera.name.as_str()).collect();
    assert_eq!(names, (0..12).map(|i| format!("v{i}")).collect::<Vec<_>>());
    assert_eq!(scene.split.test, [0, 8]);
    assert_eq!(scene.layout, Layout::Transforms);

    let four = open(directory.path(), |o| o.views = Some(4)).unwrap();
    assert_eq!(four.split.train, [1, 4, 7, 11]);
    assert_eq!(four.split.test, [0, 8]);
    let many = open(directory.path(), |o| o.views = Some(99)).unwrap();
    assert_eq!(many.split.train.len(), 10);
    assert!(many.warnings.iter().any(|w| w.contains("asks for 99 training views, but there are 10")));

    std::fs::write(directory.path().join("split.json"), r#"{"train": ["v10", "v2"], "test": []}"#).unwrap();
    let named = open(directory.path(), |_| ()).unwrap();
    assert_eq!(named.split, Split { train: vec![10, 2], test: vec![] });
    assert_eq!(named.load_train_images().unwrap().len(), 2);
    assert!(named.load_image(12).unwrap_err().to_string().contains("there is no view 12; there are 12"));
}

#[test]
fn split_rules_select_the_views() {
    let directory = tempfile::tempdir().unwrap();
    let root = directory.path();
    write_scene(root, 12, "");
    std::fs::write(root.join("split.json"), r#"{"train": ["v1"], "test": ["v2"]}"#).unwrap();
    std::fs::write(root.join("other.json"), r#"{"train": ["v5", "v3"], "test": ["v4"]}"#).unwrap();
    let by = |rule: &str, views: Option<usize>| {
        let opened = open(root, |o| (o.split, o.views) = (rule.parse().unwrap(), views));
        opened.map(|scene| (scene.split.train, scene.split.test)).map_err(|e| e.to_string())
    };
    assert_eq!(by("auto", None).unwrap(), (vec![1], vec![2]));
    assert_eq!(by("every:4", None).unwrap(), (vec![1, 2, 3, 5, 6, 7, 9, 10, 11], vec![0, 4, 8]));
    assert_eq!(by("every:4", Some(3)).unwrap(), (vec![1, 6, 11], vec![0, 4, 8]));
    // linspace(1, 10, 3) is 1, 5.5, 10.
    assert_eq!(by("linspace:3", None).unwrap(), (vec![0, 2, 3, 4, 6, 7, 8, 9, 11], vec![1, 5, 10]));
    let file = root.join("other.json").display().to_string();
    assert_eq!(by(&file, None).unwrap(), (vec![5, 3], vec![4]));
    let error = by("linspace:11", None).unwrap_err();
    assert!(
        error.ends_with("the split linspace:11 needs at least 13 views, but there are 12; hold out fewer"),
        "{error}"
    );
    assert!(by(&root.join("none.json").display().to_string(), None).unwrap_err().contains("none.json"));
    write_scene(root, 1, "");
    let error = by("every:2", None).unwrap_err();
    assert!(error.contains("the split every:2 leaves no training view of 1 views"), "{error}");
}

/// Writes a COLMAP model with six views and three points. Views 1 and 2 see the first point, views 0 and 1 the second,
/// and view 5 the third, twice.
fn write_model(root: &Path, binary: bool) {
    std::fs::create_dir_all(root.join("sparse/0")).unwrap();
    std::fs::create_dir_all(root.join("images")).unwrap();
    let put = |name: &str, content: &[u8]| std::fs::write(root.join("sparse/0").join(name), content).unwrap();
    let tracks = [[1_u32, 2], [0, 1], [5, 5]];
    let names: Vec<String> = (0..6).map(|i| format!("v{i}.png")).collect();
    for name in &names {
        write_png(&root.join("images").join(name), &Image::new(8, 6, 3)).unwrap();
    }
    if !binary {
        put("cameras.txt", b"1 PINHOLE 8 6 4 4 4 3\n");
        let image = |(i, name): (usize, &String)| format!("{} 1 0 0 0 -{i} 0 0 1 {name}\n\n", 20 + i);
        put("images.txt", names.iter().enumerate().map(image).collect::<String>().as_bytes());
        let point = |(i, [a, b]): (usize, &[u32; 2])| format!("{i} {i} 0 3 9 9 9 0.5 {} 0 {} 7\n", 20 + a, 20 + b);
        put("points3D.txt", tracks.iter().enumerate().map(point).collect::<String>().as_bytes());
        return;
    }
    let mut cameras = [&1_u64.to_le_bytes()[..], &1_u32.to_le_bytes(), &1_i32.to_le_bytes()].concat();
    [8_u64, 6].iter().for_each(|v| cameras.extend(v.to_le_bytes()));
    [4.0_f64, 4.0, 4.0, 3.0].iter().for_each(|v| cameras.extend(v.to_le_bytes()));
    put("cameras.bin", &cameras);
    let mut images = 6_u64.to_le_bytes().to_vec();
    for (i, name) in names.iter().enumerate() {
        images.extend((20 + i as u32).to_le_bytes());
        [1.0, 0.0, 0.0, 0.0, -(i as f64), 0.0, 0.0].iter().for_each(|v: &f64| images.extend(v.to_le_bytes()));
        images.extend(1_u32.to_le_bytes());
        images.extend(name.as_bytes());
        images.extend([0; 9]);
    }
    put("images.bin", &images);
    let mut points = 3_u64.to_le_bytes().to_vec();
    for (i, track) in tracks.iter().enumerate() {
        points.extend((i as u64).to_le_bytes());
        [i as f64, 0.0, 3.0].iter().for_each(|v| points.extend(v.to_le_bytes()));
        points.extend([9; 3]);
        points.extend(0.5_f64.to_le_bytes());
        points.extend(2_u64.to_le_bytes());
        for image in track {
            points.extend((20 + image).to_le_bytes());
            points.extend(7_u32.to_le_bytes());
        }
    }
    put("points3D.bin", &points);
}

#[test]
fn points_seen_by_fewer_than_two_training_views_are_excluded() {
    for binary in [false, true] {
        let directory = tempfile::tempdir().unwrap();
        let root = directory.path();
        write_model(root, binary);
        let seen = |rule: &str, views: Option<usize>| {
            let scene = open(root, |o| (o.split, o.views) = (rule.parse().unwrap(), views)).unwrap();
            assert_eq!(scene.layout, Layout::Colmap);
            let colors = scene.points.colors.as_ref().map(Vec::len);
            assert!(colors == Some(scene.points.len()) && !scene.points_are_random);
            let x: Vec<f32> = scene.points.positions.iter().map(|p| p[0]).collect();
            (x, scene.warnings)
        };
        // View 0 is a test view, so its observations do not count.
        let (points, warnings) = seen("every:6", None);
        assert_eq!(points, [0.0]);
        assert_eq!(warnings, ["fewer than two training views see 2 of the 3 points; training starts from the other 1"]);
        std::fs::write(root.join("all.json"), r#"{"train": ["v0", "v1", "v2", "v3", "v4", "v5"]}"#).unwrap();
        let file = root.join("all.json").display().to_string();
        assert_eq!(seen(&file, None).0, [0.0, 1.0]);
        // Views 0 and 5 have no common point, so all points remain.
        let (points, warnings) = seen(&file, Some(2));
        assert_eq!(points, [0.0, 1.0, 2.0]);
        assert!(warnings[0].starts_with("fewer than two training views see any of the 3 points"), "{warnings:?}");
    }
}

#[test]
fn names_sort_in_natural_order() {
    let mut names = ["v10", "v9", "v9a", "a", "v009", "v100000000000000000000000000000000000000001", ""];
    names.sort_by_key(|name| natural_key(name));
    assert_eq!(names, ["", "a", "v100000000000000000000000000000000000000001", "v009", "v9", "v9a", "v10"]);
}

#[test]
fn extent_follows_the_training_cameras() {
    let directory = tempfile::tempdir().unwrap();
    write_scene(directory.path(), 9, "");
    // The mean of training views 1 to 7 is 4.
    assert!((open(directory.path(), |_| ()).unwrap().extent() - 1.1 * 3.0).abs() < 1e-9);
    // A single camera: half the median distance to the points, or 1 without points.
    assert_eq!(open(directory.path(), |o| o.views = Some(1)).unwrap().extent(), 1.0);
    let positions = vec![[1.0, 0.0, -2.0], [1.0, 0.0, -3.0], [1.0, 0.0, -90.0]];
    let points = PointCloud { positions, ..Default::default() };
    points.write_ply(&directory.path().join("points.ply")).unwrap();
    let one = open(directory.path(), |o| o.views = Some(1)).unwrap();
    assert_eq!((one.extent(), one.points_are_random), (1.5, false));
    assert_eq!(one.points, points);
    assert_eq!(extent_of(&[], None), 1.0);
}

#[test]
fn random_points_replace_missing_ones() {
    let directory = tempfile::tempdir().unwrap();
    write_scene(directory.path(), 9, "");
    let scene = open(directory.path(), |o| o.random_points = 5000).unwrap();
    assert!(scene.points_are_random);
    assert_eq!(scene.points.len(), 5000);
    assert!(scene.warnings.iter().all(|w| !w.contains("random points")));
    let start = scene.start_warnings().unwrap();
    assert!(start.iter().any(|w| w.ends_with("has no point cloud; starting from 5000 random points")));
    // The cameras look along −z; the box ends at twice the extent of 3.3.
    assert!(scene.points.positions.iter().all(|p| (-6.601..=0.0).contains(&p[2])));
    assert_eq!(open(directory.path(), |o| o.random_points = 0).unwrap().points.len(), 100);
    let other = open(directory.path(), |o| (o.random_points, o.seed) = (5000, 1)).unwrap();
    assert_ne!(other.points, scene.points);
}

#[test]
fn scaling_applies_to_cameras_and_images() {
    let directory = tempfile::tempdir().unwrap();
    write_scene(directory.path(), 2, "");
    let scene = open(directory.path(), |o| o.scale = 0.5).unwrap();
    let camera = &scene.views[1].camera;
    assert_eq!((camera.width, camera.height, camera.fx, camera.cx), (4, 3, 2.0, 2.0));
    let image = scene.load_image(1).unwrap();
    assert_eq!((image.width, image.height), (4, 3));
    assert_eq!(open(directory.path(), |o| o.scale = 1e-9).unwrap().views[0].camera.width, 1);
}

#[test]
fn strong_distortion_causes_one_warning() {
    let directory = tempfile::tempdir().unwrap();
    write_scene(directory.path(), 3, "\"k1\": 0.5,");
    let scene = open(directory.path(), |_| ()).unwrap();
    assert_eq!(scene.warnings.iter().filter(|w| w.contains("pixels unseen; they repeat the border")).count(), 1);
    write_scene(directory.path(), 3, "\"k1\": -0.01,");
    assert!(!open(directory.path(), |_| ()).unwrap().warnings.iter().any(|w| w.contains("unseen")));
}

#[test]
fn each_error_has_its_message() {
    let directory = tempfile::tempdir().unwrap();
    let root = directory.path();
    write_scene(root, 2, "");
    let fail = |change: fn(&mut SceneOptions)| open(root, change).unwrap_err().to_string();
    assert_eq!(fail(|o| o.views = Some(0)), "--views is 0, but there must be at least one training view");
    assert_eq!(fail(|o| o.scale = 1.5), "--scale is 1.5, but the factor must be above 0 and at most 1");
    assert!(fail(|o| o.scale = f64::NAN).starts_with("--scale is NaN"));
    assert!(fail(|o| o.exposure = Some(0.0)).starts_with("exposure is 0"));

    write_png(&root.join("v1.png"), &Image::new(9, 6, 3)).unwrap();
    write_scene_json_size(root);
    let error = fail(|_| ());
    assert!(error.contains("v1.png is 9×6 pixels, but ") && error.contains("gives 8×6 for its camera"), "{error}");

    std::fs::create_dir(root.join("b")).unwrap();
    write_png(&root.join("b/v0.png"), &Image::new(8, 6, 3)).unwrap();
    let text = std::fs::read_to_string(root.join("transforms.json")).unwrap();
    std::fs::write(root.join("transforms.json"), text.replace("\"v1\"", "\"b/v0\"")).unwrap();
    let error = fail(|_| ());
    assert!(error.contains("have the same stem; splits and priors go by it"), "{error}");

    write_scene(root, 1, "");
    let error = fail(|_| ());
    assert!(error.contains("no training view is left, because without split.json every 8th of the 1 views"), "{error}");
    std::fs::write(root.join("split.json"), r#"{"train": ["v0"]}"#).unwrap();
    assert!(open(root, |_| ()).is_ok());

    std::fs::create_dir_all(root.join("priors/normal")).unwrap();
    let error = fail(|_| ());
    assert!(error.contains("priors/normal: the frame of the normals is unknown; write"), "{error}");
    std::fs::write(root.join("priors/priors.json"), r#"{"normal": {"frame": "left"}}"#).unwrap();
    let error = fail(|_| ());
    assert!(error.contains("priors.json, line 1") && error.contains("unknown variant `left`"), "{error}");
}

/// Adds the size 8×6 to a scene's `transforms.json`.
fn write_scene_json_size(root: &Path) {
    let path = root.join("transforms.json");
    let text = std::fs::read_to_string(&path).unwrap();
    std::fs::write(path, text.replace("\"fl_x\"", "\"w\": 8, \"h\": 6, \"fl_x\"")).unwrap();
}

#[test]
fn masks_beside_the_images_are_used_inverted_or_ignored() {
    let directory = tempfile::tempdir().unwrap();
    let root = directory.path();
    write_scene(root, 3, "");
    std::fs::create_dir(root.join("masks")).unwrap();
    // White in the left quarter; the second mask belongs to a photograph of twice the size.
    for (name, scale) in [("v1.png", 1), ("v2.png.png", 2)] {
        let mut mask = Image::new(8 * scale, 6 * scale, 1);
        let width = mask.width as usize;
        mask.data.iter_mut().enumerate().for_each(|(i, v)| *v = f32::from(u8::from(i % width < width / 4)));
        write_png(&root.join("masks").join(name), &mask).unwrap();
    }
    let masks = |masks: MaskUse| {
        let scene = open(root, |options| options.masks = masks).unwrap();
        let valid = |view| scene.load_mask(view).unwrap().map(|mask| mask.data.iter().sum::<f32>());
        ([valid(0), valid(1), valid(2)], scene.start_warnings().unwrap().pop())
    };
    let (valid, warning) = masks(MaskUse::Valid);
    assert_eq!(valid, [None, Some(12.0), Some(12.0)]);
    let warning = warning.unwrap();
    assert!(
        warning.contains("v1.png leaves out 75 % of its pixels, those that are not white; masks = \"inverted\""),
        "{warning}"
    );
    let (valid, warning) = masks(MaskUse::Inverted);
    assert_eq!(valid, [None, Some(36.0), Some(36.0)]);
    assert!(!warning.unwrap().contains("mask"));
    assert_eq!(masks(MaskUse::Ignored).0, [None; 3]);
    write_png(&root.join("masks/v1.png"), &Image::new(9, 6, 1)).unwrap();
    let error = open(root, |_| ()).unwrap().load_mask(1).unwrap_err().to_string();
    assert!(error.contains("masks/v1.png: the map is 9×6 pixels, but its image"), "{error}");
}

#[test]
fn exif_orientations_are_counted() {
    let directory = tempfile::tempdir().unwrap();
    let root = directory.path();
    write_scene(root, 3, "");
    assert!(open(root, |_| ()).unwrap().warnings.is_empty());
    let jpeg = crate::encode_jpeg(&Image::new(8, 6, 3), 90).unwrap();
    let tiff = b"Exif\0\0II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x03\0\0\0\0\0\0\0";
    let segment = [&[0xff, 0xe1, 0, tiff.len() as u8 + 2], tiff.as_slice()].concat();
    for name in ["v0", "v2"] {
        std::fs::remove_file(root.join(format!("{name}.png"))).unwrap();
        std::fs::write(root.join(format!("{name}.jpg")), [&jpeg[..2], &segment, &jpeg[2..]].concat()).unwrap();
    }
    let warnings = open(root, |_| ()).unwrap().warnings;
    assert!(warnings[0].starts_with("2 images have an EXIF orientation, which is ignored"), "{warnings:?}");
}
