use std::path::PathBuf;

use glam::{DMat3, DVec3};

use super::*;
use crate::camera::{Camera, Distortion};
use crate::image::{write_exr, write_png};
use crate::map_file::NormalFrame;
use crate::reader::Frame;

/// Returns a `width`×`height` view with a camera at the origin with this rotation.
fn view(width: u32, height: u32, rotation: DMat3, lens: Distortion) -> View {
    let camera = Camera {
        name: "a".into(),
        width,
        height,
        fx: 0.6 * f64::from(width),
        fy: 0.6 * f64::from(width),
        cx: 0.5 * f64::from(width),
        cy: 0.5 * f64::from(height),
        rotation,
        translation: DVec3::ZERO,
        near: crate::camera::NEAR,
    };
    View::new(Frame::new(camera, lens, "a.png".into(), "a.json".into()), 1.0)
}

fn plain(width: u32, height: u32) -> View {
    view(width, height, DMat3::IDENTITY, Distortion::default())
}

fn write(image: &Image, name: &str) -> (tempfile::TempDir, PathBuf) {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join(name);
    if name.ends_with("png") {
        write_png(&path, image).unwrap();
    } else {
        write_exr(&path, image, &["R", "G", "B", "A"][..image.channels as usize]).unwrap();
    }
    (directory, path)
}

fn image(width: u32, channels: u32, data: &[f32]) -> Image {
    Image::from_data(width, data.len() as u32 / width / channels, channels, data.to_vec()).unwrap()
}

#[test]
fn invalid_values_are_masked_and_do_not_spread() {
    let nan = f32::NAN;
    let (_keep, path) =
        write(&image(4, 3, &[0.5, 0.25, 1.0, nan, 0.0, 0.0, nan, nan, nan, 0.1, 0.1, f32::INFINITY]), "a.exr");
    let map = load(&path, &plain(2, 1), Meaning::Color).unwrap();
    assert_eq!(map.valid.data, [1.0, 0.0]);
    assert_eq!(map.image.data, [0.5, 0.25, 1.0, 0.0, 0.0, 0.0]);
}

#[test]
fn colors_become_linear_and_scalars_stay_unconverted() {
    let half = 128.0 / 255.0;
    let (_keep, path) = write(&image(1, 3, &[half; 3]), "a.png");
    let color = load(&path, &plain(1, 1), Meaning::Color).unwrap().image;
    assert!(color.data.iter().all(|v| (v - 0.215_861).abs() < 1e-5) && color.channels == 3);
    let scalar = load(&path, &plain(1, 1), Meaning::Scalar).unwrap().image;
    assert_eq!((scalar.data.as_slice(), scalar.channels), (&[half][..], 1));
    let (_keep, gray) = write(&image(1, 1, &[half]), "g.png");
    assert_eq!(load(&gray, &plain(1, 1), Meaning::Color).unwrap().image, color);
}

#[test]
fn png_alpha_marks_valid_pixels() {
    let (_keep, path) = write(&image(2, 4, &[1.0, 1.0, 1.0, 1.0, 0.2, 0.2, 0.2, 0.0]), "a.png");
    let map = load(&path, &plain(2, 1), Meaning::Color).unwrap();
    assert_eq!(map.valid.data, [1.0, 0.0]);
    assert_eq!(map.image.data, [1.0, 1.0, 1.0, 0.0, 0.0, 0.0]);
}

#[test]
fn depth_averages_surfaces_only() {
    let (_keep, path) = write(&image(4, 1, &[2.0, 4.0, 0.0, 3.0]), "a.exr");
    let map = load(&path, &plain(2, 1), Meaning::Depth).unwrap();
    assert_eq!((map.image.data, map.valid.data), (vec![3.0, 3.0], vec![1.0, 1.0]));
    let (_keep, path) = write(&image(2, 1, &[-1.0, f32::INFINITY]), "a.exr");
    assert_eq!(load(&path, &plain(2, 1), Meaning::Depth).unwrap().valid.data, [0.0, 0.0]);
}

#[test]
fn normals_are_averaged_rotated_and_normalized() {
    // The camera's z axis (forward) is the world's y axis.
    let rotation = DMat3::from_cols(DVec3::X, DVec3::Z, -DVec3::Y);
    let s = 0.5_f32.sqrt();
    let (_keep, path) = write(&image(4, 3, &[s, 0.0, s, -s, 0.0, s, 0.0, 0.0, 0.0, f32::NAN, 0.0, 1.0]), "a.exr");
    let view = view(2, 1, rotation, Distortion::default());
    let map = load_normals(&path, &view, NormalFrame::CameraOpencv).unwrap();
    let expected = [0.0, 1.0, 0.0, 0.0, 0.0, 0.0];
    assert!(map.data.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6), "{:?}", map.data);
}

#[test]
fn png_normals_without_a_direction_are_zero() {
    let gray = 128.0 / 255.0;
    let (_keep, path) = write(&image(3, 3, &[0.0, 0.0, 0.0, gray, gray, gray, gray, gray, 1.0]), "a.png");
    let map = load_normals(&path, &plain(3, 1), NormalFrame::World).unwrap();
    assert_eq!(map.data[..6], [0.0; 6]);
    assert!((map.data[8] - 1.0).abs() < 1e-4 && map.data[6].abs() < 0.01);
    let (_keep, path) = write(&image(1, 1, &[1.0]), "g.png");
    let error = load_normals(&path, &plain(1, 1), NormalFrame::World).unwrap_err().to_string();
    assert!(error.ends_with("g.png: a normal map has 3 channels, but the file has 1"), "{error}");
}

#[test]
fn maps_are_undistorted_at_any_stored_size() {
    let lens = Distortion { k1: 0.2, ..Default::default() };
    // A ramp in the distorted photograph, stored at half the photograph's size.
    let ramp: Vec<f32> = (0..60).flat_map(|_| (0..80).map(|x| (x as f32 + 0.5) / 80.0)).collect();
    let (_keep, path) = write(&image(80, 1, &ramp), "a.exr");
    let bent = view(160, 120, DMat3::IDENTITY, lens);
    let map = load(&path, &bent, Meaning::Scalar).unwrap().image;
    assert_eq!((map.width, map.height), (160, 120));
    for x in [30_u32, 80, 120] {
        let nx = (f64::from(x) + 0.5 - 80.0) / 96.0;
        let (dx, _) = lens.distort(nx, 0.5 / 96.0);
        let expected = (dx * 96.0 + 80.0) / 160.0;
        assert!((f64::from(map.pixel(x, 60)[0]) - expected).abs() < 2e-3, "{x}");
    }

    let numbers: Vec<f32> = ramp.iter().map(|v| (v * 80.0).floor() / 255.0).collect();
    let (_keep, path) = write(&image(80, 1, &numbers), "n.png");
    let regions = load_numbers(&path, &bent).unwrap();
    assert_eq!((regions.width, regions.height), (160, 120));
    let (dx, _) = lens.distort((140.5 - 80.0) / 96.0, 0.5 / 96.0);
    let expected = ((dx * 96.0 + 80.0) / 2.0) as u16;
    assert_eq!(regions.ids[60 * 160 + 140], expected);
    // Without distortion, the column would be 70.
    assert_eq!(expected, 72);
}

#[test]
fn numpy_arrays_load_as_maps() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("a.npy");
    let bytes: Vec<u8> = [0.25_f32, 0.5].iter().flat_map(|v| v.to_le_bytes()).collect();
    std::fs::write(&path, crate::image::npy_for_tests("<f4", "(1, 2, 1)", &bytes)).unwrap();
    assert_eq!(load(&path, &plain(2, 1), Meaning::Scalar).unwrap().image.data, [0.25, 0.5]);
}

#[test]
fn extension_order_decides_between_files() {
    let directory = tempfile::tempdir().unwrap();
    assert_eq!(find(directory.path(), "a.b", &["exr", "png"]), None);
    std::fs::write(directory.path().join("a.b.png"), "").unwrap();
    assert!(find(directory.path(), "a.b", &["exr", "png"]).unwrap().ends_with("a.b.png"));
    std::fs::write(directory.path().join("a.b.exr"), "").unwrap();
    assert!(find(directory.path(), "a.b", &["exr", "png"]).unwrap().ends_with("a.b.exr"));
}
