//! Readers on external rooms.

mod common;

use common::{mse, open, room};
use glam::DVec3;
use sgs_scene::{Camera, Image, Layout, Scene, SceneOptions, Splats};

fn full_mask(image: &Image) -> Image {
    Image::from_data(image.width, image.height, 1, vec![1.0; image.pixels()]).unwrap()
}

#[test]
fn whiteroom_opens_completely() {
    let Some(path) = room("whiteroom") else {
        return;
    };
    let scene = open(&path);
    assert_eq!((scene.layout, scene.views.len(), scene.points.len()), (Layout::Transforms, 24, 5000));
    assert_eq!(scene.split.train, (0..12).collect::<Vec<_>>());
    assert_eq!(scene.split.test, (12..24).collect::<Vec<_>>());
    assert_eq!(scene.warnings, Vec::<String>::new());
    assert!(!scene.points_are_random && scene.points.colors.is_some());
    assert!((0.5..5.0).contains(&scene.extent()), "{}", scene.extent());
    for image in scene.load_train_images().unwrap() {
        assert_eq!((image.width, image.height, image.channels), (160, 120, 3));
        assert!(image.data.iter().all(|v| (0.0..=1.0).contains(v)));
    }
}

fn assert_same_camera(a: &Camera, b: &Camera, tolerance: f64) {
    let difference = |a: f64, b: f64| assert!((a - b).abs() < tolerance * b.abs().max(1.0), "{a} {b}");
    assert_eq!((a.width, a.height), (b.width, b.height));
    [(a.fx, b.fx), (a.fy, b.fy), (a.cx, b.cx), (a.cy, b.cy)].iter().for_each(|&(a, b)| difference(a, b));
    a.rotation.to_cols_array().iter().zip(b.rotation.to_cols_array()).for_each(|(&a, b)| difference(a, b));
    a.translation.to_array().iter().zip(b.translation.to_array()).for_each(|(&a, b)| difference(a, b));
}

#[test]
fn colmap_binary_and_text_forms_match_the_room() {
    let (Some(path), Some(reference)) = (room("whiteroom_colmap"), room("whiteroom")) else {
        return;
    };
    let reference = open(&reference);
    let binary = open(&path);
    let copy = tempfile::tempdir().unwrap();
    std::fs::create_dir_all(copy.path().join("sparse/0")).unwrap();
    std::fs::create_dir(copy.path().join("images")).unwrap();
    for entry in std::fs::read_dir(path.join("images")).unwrap().flatten() {
        std::fs::copy(entry.path(), copy.path().join("images").join(entry.file_name())).unwrap();
    }
    for name in ["cameras.txt", "images.txt", "points3D.txt"] {
        std::fs::copy(path.join("sparse/0").join(name), copy.path().join("sparse/0").join(name)).unwrap();
    }
    let text = open(copy.path());
    for scene in [&binary, &text] {
        assert_eq!((scene.layout, scene.views.len()), (Layout::Colmap, 12));
        assert_eq!(scene.split.test, [0, 8]);
        // Only a test view and one training view see some of the points.
        let [about_points] = &scene.warnings[..] else { panic!("{:?}", scene.warnings) };
        assert!(about_points.starts_with("fewer than two training views see "), "{about_points}");
        assert!((4000..5000).contains(&scene.points.len()), "{}", scene.points.len());
    }
    for i in 0..12 {
        assert_eq!(binary.views[i].camera.name, format!("train_{i:03}"));
        assert_same_camera(&text.views[i].camera, &binary.views[i].camera, 1e-6);
        assert_same_camera(&binary.views[i].camera, &reference.views[i].camera, 1e-5);
        assert_eq!(binary.load_image(i).unwrap(), reference.load_image(i).unwrap());
    }
    assert_eq!(text.points.len(), binary.points.len());
    assert_eq!(text.points.colors, binary.points.colors);
    let positions = text.points.positions.iter().flatten().zip(binary.points.positions.iter().flatten());
    assert!(positions.into_iter().all(|(a, b)| (a - b).abs() < 1e-5));
}

#[test]
fn hdr_renders_match_the_photographs() {
    let (Some(hdr), Some(png)) = (room("whiteroom_interiorverse"), room("whiteroom")) else {
        return;
    };
    let (hdr, png) = (open(&hdr), open(&png));
    assert_eq!((hdr.layout, hdr.views.len()), (Layout::InteriorVerse, 24));
    // The room needs no exposure correction.
    assert_eq!((hdr.exposure(), &hdr.split), (1.0, &png.split));
    assert!(hdr.points_are_random && hdr.warnings.is_empty(), "{:?}", hdr.warnings);
    assert_eq!(hdr.start_warnings().unwrap().len(), 1);
    for i in [0, 11, 23] {
        assert_same_camera(&hdr.views[i].camera, &png.views[i].camera, 1e-9);
        let (a, b) = (hdr.load_image(i).unwrap(), png.load_image(i).unwrap());
        let db = -10.0 * mse(&a, &b, &full_mask(&a)).log10();
        assert!(db > 50.0, "{db}");
    }
}

#[test]
fn large_room_at_half_scale_matches_the_small_room() {
    let (Some(large), Some(small)) = (room("whiteroom_m"), room("whiteroom")) else {
        return;
    };
    let large = Scene::open(&large, &SceneOptions { scale: 0.5, ..Default::default() }).unwrap();
    let small = open(&small);
    assert_same_camera(&large.views[7].camera, &small.views[7].camera, 1e-6);
    let (a, b) = (large.load_image(7).unwrap(), small.load_image(7).unwrap());
    let db = -10.0 * mse(&a, &b, &full_mask(&a)).log10();
    assert!(db > 28.0, "{db}");
}

#[test]
fn fox_skips_missing_frames_and_is_undistorted() {
    let Some(path) = room("fox") else { return };
    let scene = open(&path);
    assert_eq!((scene.views.len(), scene.split.train.len(), scene.split.test.len()), (50, 24, 6));
    assert_eq!(scene.points.len(), 3928);
    assert_eq!(scene.warnings.len(), 1, "{:?}", scene.warnings);
    assert!(scene.warnings[0].starts_with("17 of 67 frames in "), "{}", scene.warnings[0]);
    let view = scene.view(0).unwrap();
    assert_eq!((view.camera.width, view.camera.height), (270, 480));
    assert_eq!((view.camera.cx, view.camera.cy), (138.6395, 241.317));
    assert!((view.distortion.k1 - 0.0578421).abs() < 1e-12);
    let image = scene.load_image(0).unwrap();
    assert_eq!((image.width, image.height, image.channels), (270, 480, 3));
    let unseen = view.coverage().unwrap().data.iter().filter(|&&v| v == 0.0).count();
    assert!(unseen < 270 * 480 / 50, "{unseen}");
}

/// Point colors match the undistorted image best at the ideal projection. The points were triangulated from distorted
/// photographs.
#[test]
fn fox_points_match_the_color_of_their_pixel() {
    let Some(path) = room("fox") else { return };
    let scene = open(&path);
    let error_at = |shift: f64| {
        let (mut sum, mut count) = (0.0, 0.0);
        for &i in scene.split.train.iter().step_by(4) {
            let image = scene.load_image(i).unwrap();
            let camera = &scene.views[i].camera;
            for (p, color) in scene.points.positions.iter().zip(scene.points.colors.as_ref().unwrap()) {
                let Some(pixel) = camera.project(DVec3::from(p.map(f64::from))) else {
                    continue;
                };
                let (x, y) = (pixel.x + shift, pixel.y);
                if x < 0.0 || y < 0.0 || x >= 270.0 || y >= 480.0 {
                    continue;
                }
                let seen = image.pixel(x as u32, y as u32);
                sum += seen.iter().zip(color).map(|(a, b)| f64::from((a - b).abs())).sum::<f64>() / 3.0;
                count += 1.0;
            }
        }
        sum / count
    };
    let (here, left, right) = (error_at(0.0), error_at(-6.0), error_at(6.0));
    assert!(here < 0.9 * left && here < 0.9 * right, "{here} {left} {right}");
}

#[test]
fn bench_rooms_initialize_splats() {
    for (name, points) in [("bench_room", 20_000), ("bench_room100k", 100_000)] {
        let Some(path) = room(name) else { return };
        let scene = open(&path);
        assert_eq!((scene.views.len(), scene.split.train.len(), scene.split.test.len()), (16, 12, 4));
        assert_eq!(scene.points.len(), points);
        let splats = Splats::from_points(&scene.points, 3).unwrap();
        splats.check().unwrap();
        assert_eq!((splats.len(), splats.sh_degree()), (points, 3));
        let mean = splats.log_scales.iter().map(|s| f64::from(s[0])).sum::<f64>() / points as f64;
        assert!((-6.0..-2.0).contains(&mean), "{mean}");
    }
}
