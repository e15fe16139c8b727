//! Both FIPT layouts: files are written and read back.

mod common;

use std::path::Path;

use common::open;
use common::written::{Seat, assert_sees, encoded, exr, look_at_lists, seats, worst};
use sgs_scene::{GroundTruth, GroundTruthKind, Layout, Scene, SceneOptions};

fn light(seat: &Seat) -> Vec<[f32; 3]> {
    seat.hits().iter().map(|hit| hit.light()).collect()
}

/// Writes a real capture; `number` returns the number of an image.
fn write_real(root: &Path, count: usize, number: impl Fn(usize) -> String) -> Vec<Seat> {
    let mut seats = seats(count);
    // Every camera has a different, off-center principal point.
    for (i, seat) in seats.iter_mut().enumerate() {
        seat.center += glam::DVec2::new(0.5 * i as f64, 0.25 * i as f64);
    }
    for (i, seat) in seats.iter().enumerate() {
        exr(&root.join("Image").join(format!("{}_0001.exr", number(i))), seat.size, &light(seat));
    }
    let (poses, matrices) = look_at_lists(&seats);
    std::fs::write(root.join("cam.txt"), poses).unwrap();
    std::fs::write(root.join("K_list.txt"), matrices).unwrap();
    seats
}

/// Writes a synthetic scene with five training and two validation views. Frames name files that do not exist.
fn write_synthetic(root: &Path) -> [Vec<Seat>; 2] {
    let mut all = seats(7);
    for seat in &mut all {
        seat.center = glam::DVec2::new(24.0, 20.0);
        seat.focal = glam::DVec2::splat(30.0);
    }
    let splits = [all[..5].to_vec(), all[5..].to_vec()];
    for (split, seats) in ["train", "val"].iter().zip(&splits) {
        let folder = root.join(split);
        let mut frames = Vec::new();
        for (i, seat) in seats.iter().enumerate() {
            let hits = seat.hits();
            exr(&folder.join(format!("Image/{i:03}_0001.exr")), seat.size, &light(seat));
            let albedo: Vec<_> = hits.iter().map(|hit| hit.albedo()).collect();
            exr(&folder.join(format!("albedo/{i:03}.exr")), seat.size, &albedo);
            exr(&folder.join(format!("DiffCol/{i:03}_0001.exr")), seat.size, &vec![[0.0; 3]; hits.len()]);
            let roughness: Vec<_> = hits.iter().map(|hit| [hit.roughness(); 3]).collect();
            exr(&folder.join(format!("Roughness/{i:03}_0001.exr")), seat.size, &roughness);
            // Mitsuba's axes: left, up, forward.
            let matrix = seat.matrix([-seat.right, seat.up, seat.ahead]);
            frames.push(format!("{{\"file_path\": \"./old/r_{i}\", \"transform_matrix\": {matrix}}}"));
        }
        let angle = 2.0 * (24.0_f64 / 30.0).atan();
        let json = format!("{{\"camera_angle_x\": {angle}, \"frames\": [{}]}}", frames.join(","));
        std::fs::write(folder.join("transforms.json"), json).unwrap();
    }
    splits
}

#[test]
fn real_captures_preserve_principal_points() {
    let directory = tempfile::tempdir().unwrap();
    let seats = write_real(directory.path(), 9, |i| format!("{i:03}"));
    let scene = open(directory.path());
    assert_eq!((scene.layout, scene.views.len()), (Layout::Fipt, 9));
    assert_eq!(scene.split.test, [0, 8]);
    for (i, seat) in seats.iter().enumerate() {
        let camera = &scene.views[i].camera;
        assert_eq!((camera.cx, camera.cy, camera.fx, camera.fy), (seat.center.x, seat.center.y, 30.0, 32.0));
        assert_sees(camera, seat);
        let hits = seat.hits();
        let image = scene.load_image(i).unwrap();
        assert!(worst(&image, |p| hits[p].light().map(encoded).to_vec(), |_| true) < 1e-5);
    }
    let half = Scene::open(directory.path(), &SceneOptions { scale: 0.5, ..Default::default() }).unwrap();
    assert_eq!(half.views[3].camera.cx, 0.5 * seats[3].center.x);
}

#[test]
fn images_are_assigned_to_cameras_by_number() {
    let directory = tempfile::tempdir().unwrap();
    // Sorted as text, 10 precedes 9.
    let seats = write_real(directory.path(), 12, |i| i.to_string());
    let scene = open(directory.path());
    assert_eq!(scene.views[10].camera.name, "10_0001");
    seats.iter().zip(&scene.views).for_each(|(seat, view)| assert_sees(&view.camera, seat));
    for i in [4, 11] {
        std::fs::remove_file(directory.path().join(format!("Image/{i}_0001.exr"))).unwrap();
    }
    let scene = open(directory.path());
    let skipped: Vec<_> = scene.warnings.iter().filter(|w| w.contains("skipped")).collect();
    assert_eq!((scene.views.len(), skipped.len()), (10, 1));
    assert!(skipped[0].starts_with("2 of 12 frames in ") && skipped[0].contains("cam.txt"), "{}", skipped[0]);
    // Images after the gap keep their own cameras.
    assert_sees(&scene.views[4].camera, &seats[5]);

    // Numbers may start anywhere if images and cameras are equally many.
    let directory = tempfile::tempdir().unwrap();
    let seats = write_real(directory.path(), 5, |i| (i + 98).to_string());
    let scene = open(directory.path());
    seats.iter().zip(&scene.views).for_each(|(seat, view)| assert_sees(&view.camera, seat));
}

#[test]
fn synthetic_scenes_have_mitsuba_axes() {
    let directory = tempfile::tempdir().unwrap();
    let [train, val] = write_synthetic(directory.path());
    let scene = open(directory.path());
    assert_eq!((scene.layout, scene.views.len()), (Layout::Fipt, 7));
    assert_eq!((scene.split.train.as_slice(), scene.split.test.as_slice()), (&[0, 1, 2, 3, 4][..], &[5, 6][..]));
    assert_eq!((scene.views[1].camera.name.as_str(), scene.views[5].camera.name.as_str()), ("train_001", "val_000"));
    for (seat, view) in train.iter().chain(&val).zip(&scene.views) {
        assert_sees(&view.camera, seat);
    }
    let truth = GroundTruth::of(&scene);
    let hits = val[1].hits();
    let albedo = truth.load(GroundTruthKind::Albedo, 6).unwrap().unwrap();
    assert!(worst(&albedo, |p| hits[p].albedo().to_vec(), |_| true) < 1e-6);
    let roughness = truth.load(GroundTruthKind::Roughness, 6).unwrap().unwrap();
    assert!(worst(&roughness, |p| vec![hits[p].roughness()], |_| true) < 1e-6);
    assert!(scene.albedo_prior(6).unwrap().is_none());
    std::fs::remove_dir_all(directory.path().join("val/albedo")).unwrap();
    let diffuse = GroundTruth::of(&open(directory.path())).load(GroundTruthKind::Albedo, 6).unwrap().unwrap();
    assert!(diffuse.data.iter().all(|&v| v == 0.0));

    // A single split is also a scene.
    let scene = open(&directory.path().join("train"));
    assert_eq!((scene.layout, scene.views.len()), (Layout::Fipt, 5));
    assert_sees(&scene.views[2].camera, &train[2]);
}

/// A `transforms.json` whose frames name EXR images has nerfstudio's layout. Its axes are OpenGL's.
#[test]
fn frames_that_name_exr_images_have_opengl_axes() {
    let directory = tempfile::tempdir().unwrap();
    let root = directory.path();
    let seats = seats(9);
    let mut frames = Vec::new();
    for (i, seat) in seats.iter().enumerate() {
        exr(&root.join(format!("Image/{i:03}_0001.exr")), seat.size, &light(seat));
        let matrix = seat.opengl();
        frames.push(format!("{{\"file_path\": \"Image/{i:03}_0001.exr\", \"transform_matrix\": {matrix}}}"));
    }
    let json = format!("{{\"fl_x\": 30, \"fl_y\": 32, \"cx\": 19, \"cy\": 17.5, \"frames\": [{}]}}", frames.join(","));
    std::fs::write(root.join("transforms.json"), json).unwrap();
    let scene = open(root);
    assert_eq!(scene.layout, Layout::Transforms);
    seats.iter().zip(&scene.views).for_each(|(seat, view)| assert_sees(&view.camera, seat));
}

#[test]
fn each_error_has_its_message() {
    let fail = |change: &dyn Fn(&Path)| {
        let directory = tempfile::tempdir().unwrap();
        write_real(directory.path(), 9, |i| format!("{i:03}"));
        change(directory.path());
        let error = Scene::open(directory.path(), &SceneOptions::default()).unwrap_err().to_string();
        error.replace(&format!("{}/", directory.path().display()), "")
    };
    let edit = |root: &Path, name: &str, change: &dyn Fn(&mut Vec<String>)| {
        let text = std::fs::read_to_string(root.join(name)).unwrap();
        let mut lines: Vec<String> = text.lines().map(String::from).collect();
        change(&mut lines);
        std::fs::write(root.join(name), lines.join("\n")).unwrap();
    };
    let error = fail(&|root| edit(root, "cam.txt", &|l| l[4] = "nan 0 0".into()));
    assert!(error.contains("cam.txt, line 5, camera 1: the pose holds values that are not finite"), "{error}");
    let error = fail(&|root| edit(root, "cam.txt", &|l| l[5] = l[4].clone()));
    assert!(error.contains("cam.txt, line 5, camera 1: the camera looks at where it stands"), "{error}");
    let error = fail(&|root| edit(root, "cam.txt", &|l| l.truncate(9)));
    assert!(error.contains("cam.txt: 9 cameras are promised, but there are 8 rows"), "{error}");
    let error = fail(&|root| edit(root, "K_list.txt", &|l| l[0] = "8".into()));
    assert!(error.contains("K_list.txt: 8 cameras are promised, but there are 27 rows"), "{error}");
    let error = fail(&|root| std::fs::write(root.join("K_list.txt"), "1\n30 0 19\n0 32 17\n0 0 1").unwrap());
    assert!(error.contains("K_list.txt: the file has 1 matrices, but cam.txt has 9 cameras"), "{error}");
    let error = fail(&|root| edit(root, "K_list.txt", &|l| l[1] = "30 0 190".into()));
    assert!(error.contains("K_list.txt, line 2, camera 0: the principal point (190, 17.5) lies outside of"), "{error}");
    let error = fail(&|root| edit(root, "K_list.txt", &|l| l[1] = "30 2 19".into()));
    assert!(error.contains("it must be [fx, 0, cx], [0, fy, cy], [0, 0, 1]"), "{error}");
    let error = fail(&|root| edit(root, "K_list.txt", &|l| l[1] = "-30 0 19".into()));
    assert!(error.contains("the focal lengths are -30 and 32"), "{error}");
    let error = fail(&|root| std::fs::remove_dir_all(root.join("Image")).unwrap());
    assert!(error.contains("cannot read Image"), "{error}");
    let error = fail(&|root| {
        std::fs::remove_dir_all(root.join("Image")).unwrap();
        std::fs::create_dir(root.join("Image")).unwrap();
    });
    assert!(error.contains("cam.txt: none of the 9 cameras has its image (the first should be Image/000_0001.exr)"));
    let error = fail(&|root| std::fs::write(root.join("Image/003_0001.exr"), "broken").unwrap());
    assert!(error.contains("Image/003_0001.exr: the file cannot be read as EXR"), "{error}");
}
