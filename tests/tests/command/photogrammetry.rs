//! Exports of RealityScan and Metashape open with the cameras that they describe.
//!
//! `make.py` in `tests/data/exports` writes the files in the layouts of these programs. Here the cameras are stated
//! again, as centers and axes.

use glam::{DVec3, Vec3};
use sgs_scene::{Distortion, Image, Layout, Scene, SceneOptions, encode_jpeg, encode_png};
use sgs_tests::files;
use std::path::Path;
use tempfile::TempDir;

/// Center of each camera, and its directions right, down and forward.
const POSES: [[DVec3; 4]; 3] = [
    [DVec3::new(1.0, -2.0, 1.5), DVec3::X, DVec3::NEG_Z, DVec3::Y],
    [DVec3::new(-3.0, 4.0, 1.25), DVec3::new(-0.8, -0.6, 0.0), DVec3::NEG_Z, DVec3::new(0.6, -0.8, 0.0)],
    [DVec3::new(0.5, -1.0, 3.0), DVec3::X, DVec3::new(0.0, -0.6, -0.8), DVec3::new(0.0, 0.8, -0.6)],
];

const POINTS: [DVec3; 2] = [DVec3::new(0.25, 1.5, 1.125), DVec3::new(-0.5, 2.0, 1.0)];
const COLORS: [Vec3; 2] = [Vec3::new(1.0, 0.0, 0.2), Vec3::new(0.4, 0.6, 0.8)];

/// View of an export.
struct Stated {
    name: &'static str,
    /// Photograph.
    file: &'static str,
    size: (u32, u32),
    /// Focal lengths and principal point.
    intrinsics: [f64; 4],
    lens: Distortion,
}

impl Stated {
    const fn pinhole(name: &'static str, file: &'static str, size: (u32, u32), intrinsics: [f64; 4]) -> Self {
        Self { name, file, size, intrinsics, lens: Distortion::NONE }
    }
}

fn write(path: &Path, content: &[u8]) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    std::fs::write(path, content).unwrap();
}

/// Copies an export, and writes its photographs into a folder.
fn export(name: &str, folder: &str, views: &[Stated]) -> TempDir {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("data/exports").join(name);
    let place = tempfile::tempdir().unwrap();
    for (path, content) in files(&source) {
        write(&place.path().join(path.strip_prefix(&source).unwrap()), &content);
    }
    for Stated { file, size: (width, height), .. } in views {
        let image = Image::new(*width, *height, 3);
        let bytes = if file.ends_with(".png") { encode_png(&image) } else { encode_jpeg(&image, 90) };
        write(&place.path().join(folder).join(file), &bytes.unwrap());
    }
    place
}

/// Opens an export and compares its views and points. `axes` maps the stated world to that of the export.
#[track_caller]
fn open(root: &Path, layout: Layout, views: &[Stated], axes: fn(DVec3) -> DVec3) -> Scene {
    let scene = Scene::open(root, &SceneOptions::default()).unwrap();
    assert_eq!((scene.layout, scene.views.len(), scene.points_are_random), (layout, 3, false));
    assert!(scene.warnings.is_empty(), "{:?}", scene.warnings);
    for (stated, [center, right, down, forward]) in views.iter().zip(POSES) {
        let name = stated.name;
        let found = scene.views.iter().position(|view| view.camera.name == name);
        let index = found.unwrap_or_else(|| panic!("{name} is missing"));
        let (camera, lens) = (&scene.views[index].camera, scene.views[index].distortion);
        let intrinsics = [camera.fx, camera.fy, camera.cx, camera.cy];
        assert_eq!(((camera.width, camera.height), intrinsics, lens), (stated.size, stated.intrinsics, stated.lens));
        // Text files round quaternions to nine digits.
        assert!(camera.position().distance(axes(center)) < 1e-7, "{name}: {}", camera.position());
        let to_world = camera.rotation.transpose();
        for (found, expected) in [(to_world.x_axis, right), (to_world.y_axis, down), (to_world.z_axis, forward)] {
            assert!(found.distance(axes(expected)) < 1e-7, "{name}: {found} and {expected}");
        }
        let image = scene.load_image(index).unwrap();
        assert_eq!((image.width, image.height), stated.size, "{name}");
    }
    assert_eq!(scene.points.positions, POINTS.map(|point| axes(point).as_vec3().to_array()));
    let colors = scene.points.colors.as_ref().unwrap();
    assert_eq!(colors.len(), 2);
    for (found, expected) in colors.iter().zip(COLORS) {
        assert!(Vec3::from_array(*found).distance(expected) < 1e-6, "{found:?}");
    }
    scene
}

#[test]
fn realityscan_export_opens_with_its_cameras() {
    // Each image has a camera of its own. Two of them have the same name in different folders.
    let views = [
        Stated::pinhole("view_00_frame_000001", "view_00/frame_000001.jpg", (16, 12), [14.25, 14.25, 8.125, 5.875]),
        Stated::pinhole("view_01_frame_000001", "view_01/frame_000001.jpg", (18, 12), [14.5, 14.5, 8.875, 6.25]),
        Stated::pinhole("frame_000002", "view_01/frame_000002.jpg", (16, 14), [14.75, 14.75, 7.75, 7.125]),
    ];
    for folder in ["", "images"] {
        let place = export("realityscan", folder, &views);
        let mask = encode_png(&Image::new(18, 12, 1)).unwrap();
        write(&place.path().join("masks/view_01/frame_000001.jpg.png"), &mask);
        let scene = open(place.path(), Layout::Colmap, &views, |v| v);
        for (index, view) in scene.views.iter().enumerate() {
            let masked = scene.load_mask(index).unwrap().is_some();
            assert_eq!(masked, view.camera.name == "view_01_frame_000001", "{}", view.camera.name);
        }
    }
}

#[test]
fn metashape_export_opens_with_its_cameras() {
    let views = [
        Stated::pinhole("DSC_0001", "DSC_0001.JPG", (16, 12), [14.25, 14.25, 8.0, 6.0]),
        Stated::pinhole("DSC_0002", "DSC_0002.JPG", (16, 12), [14.25, 14.25, 8.0, 6.0]),
        Stated::pinhole("IMG 7", "IMG 7.png", (18, 13), [15.0, 15.0, 9.0, 6.5]),
    ];
    let place = export("metashape", "images", &views);
    open(place.path(), Layout::Colmap, &views, |v| v);
    // The path of the model opens the same scene.
    open(&place.path().join("sparse/0"), Layout::Colmap, &views, |v| v);
}

#[test]
fn metashape_by_nerfstudio_opens_with_its_cameras() {
    let lens = Distortion { k1: -0.05, k2: 0.01, k3: 0.002, k4: -0.0005, p1: 0.0003, p2: -0.0002, ..Distortion::NONE };
    let distorted = |name, file| Stated { lens, ..Stated::pinhole(name, file, (16, 12), [14.25, 14.25, 8.125, 5.875]) };
    let views = [
        distorted("frame_00001", "frame_00001.png"),
        distorted("frame_00002", "frame_00002.png"),
        Stated::pinhole("frame_00003", "frame_00003.png", (18, 13), [15.0, 15.0, 9.0, 6.5]),
    ];
    let place = export("metashape_nerfstudio", "images", &views);
    // nerfstudio exchanges the axes of the world.
    open(place.path(), Layout::Transforms, &views, |v| DVec3::new(v.z, v.x, v.y));
}
