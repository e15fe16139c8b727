//! Layouts of TensoIR and Blender's synthetic scenes: files are written and read back.

mod common;

use std::path::Path;

use common::open;
use common::written::{Seat, assert_sees, encoded, rgba, worst, worst_angle};
use glam::{DVec2, DVec3};
use sgs_scene::{GroundTruth, GroundTruthKind, Layout, PointCloud, Scene, SceneOptions};

/// Returns the alpha of a pixel: a disk with an edge of 0.6.
fn alpha(seat: &Seat, pixel: usize) -> f32 {
    let (x, y) = ((pixel % seat.size.0 as usize) as f32 - 23.5, (pixel / seat.size.0 as usize) as f32 - 19.5);
    match x.hypot(y) {
        r if r < 14.0 => 1.0,
        r if r < 15.0 => 0.6,
        _ => 0.0,
    }
}

fn inside(seat: &Seat) -> impl Fn(usize) -> bool + '_ {
    |pixel| alpha(seat, pixel) == 1.0
}

/// Point that all cameras look at.
const MIDDLE: DVec3 = DVec3::new(0.1, -0.1, 0.2);

/// Returns cameras on a ring with centered principal points, as in the layout.
fn around(count: usize) -> Vec<Seat> {
    let place = |i: usize| {
        let angle = 2.5 * i as f64;
        MIDDLE + DVec3::new(1.2 * angle.cos(), 0.3 + 0.05 * i as f64, 1.2 * angle.sin())
    };
    let seat = |i| Seat { center: DVec2::new(24.0, 20.0), focal: DVec2::splat(30.0), ..Seat::new(place(i), MIDDLE) };
    (0..count).map(seat).collect()
}

/// Writes one file of frames; `name` returns the path of a frame.
fn write_frames(root: &Path, file: &str, seats: &[Seat], name: impl Fn(usize) -> String) {
    let frame = |(i, seat): (usize, &Seat)| {
        format!("{{\"file_path\": \"{}\", \"rotation\": 0.01, \"transform_matrix\": {}}}", name(i), seat.opengl())
    };
    let frames: Vec<String> = seats.iter().enumerate().map(frame).collect();
    let angle = 2.0 * (24.0_f64 / 30.0).atan();
    let json = format!("\u{feff} {{\"camera_angle_x\": {angle}, \"frames\": [{}]}}", frames.join(", "));
    std::fs::write(root.join(file), json).unwrap();
}

/// Writes TensoIR's files of a view. Transparent pixels have arbitrary colors.
fn write_view(folder: &Path, seat: &Seat, image: &str) {
    let hits = seat.hits();
    let put = |name: &str, value: &dyn Fn(usize) -> [f32; 3]| {
        let pixel = |p: usize| {
            let a = alpha(seat, p);
            let [r, g, b] = if a > 0.0 { value(p) } else { [0.8, 0.1, 0.9] };
            [r, g, b, a]
        };
        let pixels: Vec<[f32; 4]> = (0..hits.len()).map(pixel).collect();
        rgba(&folder.join(name), seat.size, &pixels);
    };
    put(image, &|p| hits[p].light().map(encoded));
    put("rgba_city.png", &|p| hits[p].light().map(|v| encoded(0.25 * v)));
    put("albedo.png", &|p| hits[p].albedo());
    put("normal.png", &|p| [0, 1, 2].map(|k| (hits[p].normal[k] * 0.5 + 0.5) as f32));
    put("roughness.png", &|p| [hits[p].roughness(); 3]);
}

/// Writes a scene with 11 training and 3 test views.
fn write(root: &Path) -> (Vec<Seat>, Vec<Seat>) {
    let seats = around(14);
    let (test, train): (Vec<_>, Vec<_>) = seats.into_iter().enumerate().partition(|(i, _)| i % 5 == 2);
    let take = |seats: Vec<(usize, Seat)>| seats.into_iter().map(|(_, seat)| seat).collect::<Vec<_>>();
    let (train, test) = (take(train), take(test));
    for (split, seats) in [("train", &train), ("test", &test)] {
        for (i, seat) in seats.iter().enumerate() {
            write_view(&root.join(format!("{split}_{i:03}")), seat, "rgba.png");
        }
        write_frames(root, &format!("transforms_{split}.json"), seats, |i| format!("./{split}_{i:03}/rgba"));
    }
    (train, test)
}

fn written() -> (tempfile::TempDir, Vec<Seat>, Vec<Seat>, Scene) {
    let directory = tempfile::tempdir().unwrap();
    let (train, test) = write(directory.path());
    let scene = open(directory.path());
    (directory, train, test, scene)
}

#[test]
fn views_have_folder_names_and_the_split_of_the_layout() {
    let (_keep, train, test, scene) = written();
    assert_eq!((scene.layout, scene.views.len()), (Layout::Blender, 14));
    let name = |i: &usize| scene.views[*i].camera.name.clone();
    assert_eq!(scene.split.train.iter().map(name).collect::<Vec<_>>()[..2], ["train_000", "train_001"]);
    assert_eq!(scene.split.test.iter().map(name).collect::<Vec<_>>(), ["test_000", "test_001", "test_002"]);
    for (indices, seats) in [(&scene.split.train, &train), (&scene.split.test, &test)] {
        assert_eq!(indices.len(), seats.len());
        indices.iter().zip(seats).for_each(|(&i, seat)| assert_sees(&scene.views[i].camera, seat));
    }
}

#[test]
fn images_are_composited_on_the_background() {
    let (keep, _, test, scene) = written();
    let seat = &test[1];
    let hits = seat.hits();
    let over = |background: [f32; 3]| {
        let hits = &hits;
        move |p: usize| {
            let a = alpha(seat, p);
            let color = hits[p].light().map(encoded);
            (0..3).map(|k| if a > 0.0 { color[k] * a } else { 0.0 } + (1.0 - a) * background[k]).collect()
        }
    };
    let image = |scene: &Scene| scene.load_image(scene.split.test[1]).unwrap();
    assert!(worst(&image(&scene), over([0.0; 3]), |_| true) < 2.5 / 255.0);
    for background in [[1.0; 3], [0.2, 0.4, 0.0]] {
        let options = SceneOptions { background, ..Default::default() };
        let scene = Scene::open(keep.path(), &options).unwrap();
        assert!(worst(&image(&scene), over(background), |_| true) < 2.5 / 255.0);
    }
    // All pixels count for training: pixels behind the object show the background.
    assert!(scene.load_mask(0).unwrap().is_none());
}

#[test]
fn ground_truth_is_linear_and_in_world_space() {
    let (_keep, _, test, scene) = written();
    let truth = GroundTruth::of(&scene);
    for (seat, &i) in test.iter().zip(&scene.split.test) {
        let hits = seat.hits();
        let get = |kind| truth.load(kind, i).unwrap().unwrap();
        assert!(worst_angle(&get(GroundTruthKind::Normal), &hits, inside(seat)) < 0.5);
        // Decoded as sRGB, 0.3 would be 0.07.
        assert!(worst(&get(GroundTruthKind::Albedo), |p| hits[p].albedo().to_vec(), inside(seat)) < 0.003);
        assert!(worst(&get(GroundTruthKind::Roughness), |p| vec![hits[p].roughness()], inside(seat)) < 0.003);
        assert!(worst(&get(GroundTruthKind::Mask), |p| vec![alpha(seat, p)], |_| true) < 0.003);
        for kind in [GroundTruthKind::Normal, GroundTruthKind::Albedo] {
            assert_eq!(
                worst(&get(kind), |_| vec![0.0; 3], |p| alpha(seat, p) == 0.0),
                0.0,
                "{kind:?} behind the object"
            );
        }
        assert!(truth.load(GroundTruthKind::Depth, i).unwrap().is_none());
        assert!(scene.albedo_prior(i).unwrap().is_none() && scene.normal_prior(i).unwrap().is_none());
    }
}

#[test]
fn other_lightings_become_relit_sets() {
    let (_keep, _, test, scene) = written();
    let truth = GroundTruth::of(&scene);
    assert_eq!(truth.relit_names(), ["city"]);
    let relit = truth.relit("city", scene.split.test[0]).unwrap().unwrap();
    let hits = test[0].hits();
    let quarter = |p: usize| hits[p].light().map(|v| (0.25 * v).min(1.0)).to_vec();
    assert!(worst(&relit, quarter, inside(&test[0])) < 0.01);
    assert!(truth.relit("night", 0).unwrap().is_none());
}

#[test]
fn random_points_fill_the_box_that_the_cameras_view() {
    let (keep, train, _, scene) = written();
    assert!(scene.points_are_random && scene.points.len() == 100_000);
    let again = open(keep.path());
    assert_eq!(again.points, scene.points);
    let other = Scene::open(keep.path(), &SceneOptions { seed: 5, ..Default::default() }).unwrap();
    assert_ne!(other.points, scene.points);
    // The box is centered on the common target. Its size is the area that the nearest camera shows there.
    let nearest = train.iter().map(|s| s.origin.distance(MIDDLE)).fold(f64::INFINITY, f64::min);
    let half = nearest * 20.0 / 30.0;
    for k in 0..3 {
        let offsets = scene.points.positions.iter().map(|p| f64::from(p[k]) - MIDDLE[k]);
        let (low, high) = offsets.fold((0.0_f64, 0.0_f64), |(l, h), v| (l.min(v), h.max(v)));
        assert!((low + half).abs() < 0.01 * half && (high - half).abs() < 0.01 * half, "{low} {high} {half}");
    }
    PointCloud { positions: vec![[1.0, 2.0, 3.0]], ..Default::default() }
        .write_ply(&keep.path().join("points3d.ply"))
        .unwrap();
    assert_eq!(open(keep.path()).points.positions, [[1.0, 2.0, 3.0]]);
}

/// Blender's layout has images with the same name in several folders.
#[test]
fn plain_blender_scenes_are_read() {
    let directory = tempfile::tempdir().unwrap();
    let root = directory.path();
    let seats = around(12);
    for (folder, seats) in [("train", &seats[..]), ("val", &seats[3..6])] {
        for (i, seat) in seats.iter().enumerate() {
            let pixels: Vec<[f32; 4]> = (0..48 * 40).map(|p| [0.5, 0.25, 1.0, alpha(seat, p)]).collect();
            rgba(&root.join(format!("{folder}/r_{i}.png")), seat.size, &pixels);
        }
        write_frames(root, &format!("transforms_{folder}.json"), seats, |i| format!("./{folder}/r_{i}"));
    }
    std::fs::remove_file(root.join("train/r_7.png")).unwrap();
    std::fs::remove_file(root.join("train/r_3.png")).unwrap();
    let scene = open(root);
    let names: Vec<&str> = scene.views.iter().map(|v| v.camera.name.as_str()).collect();
    let order = ["0", "1", "2", "4", "5", "6", "8", "9", "10", "11"].map(|n| format!("train_r_{n}"));
    assert_eq!(names[..10], order);
    assert_eq!((names[10], scene.split.test.as_slice()), ("val_r_0", &[10, 11, 12][..]));
    let skipped: Vec<_> = scene.warnings.iter().filter(|w| w.contains("skipped")).collect();
    assert_eq!(skipped.len(), 1);
    assert!(
        skipped[0].starts_with("2 of 12 frames in ") && skipped[0].contains("transforms_train.json"),
        "{}",
        skipped[0]
    );
    let mask = GroundTruth::of(&scene).load(GroundTruthKind::Mask, 0).unwrap().unwrap();
    assert!(worst(&mask, |p| vec![alpha(&seats[0], p)], |_| true) < 0.003);
    assert!(GroundTruth::of(&scene).load(GroundTruthKind::Albedo, 0).unwrap().is_none());
    // If a test file exists, the validation frames are not read.
    write_frames(root, "transforms_test.json", &seats[..1], |_| "./train/r_0".into());
    let error = Scene::open(root, &SceneOptions::default()).unwrap_err().to_string();
    assert!(error.contains("have the same stem"), "{error}");
}

#[test]
fn each_error_has_its_message() {
    let fail = |change: &dyn Fn(&Path)| {
        let directory = tempfile::tempdir().unwrap();
        write(directory.path());
        change(directory.path());
        let opened = Scene::open(directory.path(), &SceneOptions::default());
        let truth = |scene: &Scene| GroundTruth::of(scene).load(GroundTruthKind::Normal, 0).map(|_| ());
        let error = opened.and_then(|scene| truth(&scene)).unwrap_err().to_string();
        error.replace(&format!("{}/", directory.path().display()), "")
    };
    let edit = |root: &Path, name: &str, from: &str, to: &str| {
        let text = std::fs::read_to_string(root.join(name)).unwrap();
        assert!(text.contains(from), "{from}");
        std::fs::write(root.join(name), text.replacen(from, to, 1)).unwrap();
    };
    let error = fail(&|root| edit(root, "transforms_train.json", "camera_angle_x", "angle"));
    assert!(error.contains("transforms_train.json, frame 0 (./train_000/rgba): there is no focal length"), "{error}");
    let error = fail(&|root| edit(root, "transforms_test.json", "[[", "[[2, 2, "));
    assert!(
        error.contains("transforms_test.json, frame 0 (./test_000/rgba): transform_matrix has rows of [6, 4, 4, 4]")
    );
    let error = fail(&|root| std::fs::write(root.join("transforms_test.json"), "{\"frames\": []}").unwrap());
    assert!(error.contains("transforms_test.json: the list of frames is empty"), "{error}");
    let error = fail(&|root| std::fs::write(root.join("train_004/rgba.png"), "broken").unwrap());
    assert!(error.contains("train_004/rgba.png: the file cannot be read as PNG"), "{error}");
    let error = fail(&|root| rgba(&root.join("test_000/normal.png"), (9, 40), &[[0.5; 4]; 360]));
    assert!(error.contains("test_000/normal.png: the map is 9×40 pixels, but its image test_000/rgba.png"), "{error}");
    let error = fail(&|root| {
        for i in 0..11 {
            std::fs::remove_file(root.join(format!("train_{i:03}/rgba.png"))).unwrap();
        }
    });
    assert!(error.contains("all of the views are test views"), "{error}");
    let error = fail(&|root| {
        (0..11).for_each(|i| std::fs::remove_file(root.join(format!("train_{i:03}/rgba.png"))).unwrap());
        (0..3).for_each(|i| std::fs::remove_file(root.join(format!("test_{i:03}/rgba.png"))).unwrap());
    });
    assert!(error.contains("none of the frames has its image (the first should be ./train_000/rgba)"), "{error}");
}
