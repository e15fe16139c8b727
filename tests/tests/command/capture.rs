//! `sgs capture`: refusals, stopping and HEIC. [`crate::captured`] makes scenes.
//!
//! Tests that need COLMAP, libheif's programs, or photographs beside the repository, are skipped without them.

use sgs_evaluate::metrics::psnr;
use sgs_scene::{Image, encode_jpeg, read_upright, write_png};
use sgs_tests::cli::{self, sgs, sgs_with};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Returns photographs of a fox with their cameras, beside the repository. They are not part of it.
pub fn fox() -> Option<PathBuf> {
    let beside = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data");
    let folder = std::env::var_os("SGS_TEST_DATA").map_or_else(beside, PathBuf::from).join("fox");
    if folder.join("images").is_dir() {
        return Some(folder);
    }
    println!("skipped: there are no photographs in {}", folder.display());
    None
}

/// Returns whether a program is installed.
pub fn has(program: &str) -> bool {
    let found = Command::new(program).arg("-version").env("QT_QPA_PLATFORM", "offscreen").output().is_ok();
    if !found {
        println!("skipped: {program} is not installed");
    }
    found
}

/// Returns the names of the entries of a folder.
pub fn entries(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> =
        std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[test]
fn photographs_without_overlap_are_refused_and_leave_nothing() {
    if !has("colmap") {
        return;
    }
    let place = tempfile::tempdir().unwrap();
    let text = |name: &str| place.path().join(name).display().to_string();
    std::fs::create_dir(text("photos")).unwrap();
    for i in 0..3 {
        let mut image = Image::new(96, 64, 3);
        image.data.iter_mut().for_each(|v| *v = 0.3 * i as f32);
        write_png(&place.path().join(format!("photos/{i}.png")), &image).unwrap();
    }
    let refused = sgs(&["-q", "capture", &text("photos"), "-o", &text("scene")]);
    refused.refused_with(42, &["COLMAP registered none of the 3 images", "overlapping, sharp photographs"]);
    assert_eq!(entries(place.path()), ["photos"]);
    std::fs::remove_file(text("photos/1.png")).unwrap();
    std::fs::remove_file(text("photos/2.png")).unwrap();
    sgs(&["-q", "capture", &text("photos"), "-o", &text("scene")])
        .refused_with(42, &["gives 1 images; cameras need two"]);
    assert_eq!(entries(place.path()), ["photos"]);
}

#[test]
fn stopping_a_capture_leaves_nothing() {
    let Some(fox) = fox().filter(|_| has("colmap")) else { return };
    let place = tempfile::tempdir().unwrap();
    let scene = place.path().join("scene");
    let source = fox.join("images").display().to_string();
    let mut child = cli::start(&["-q", "capture", &source, "-o", &scene.display().to_string()]);
    let begun = || {
        entries(place.path()).iter().any(|name| {
            let colmap = place.path().join(name).join("colmap/database.db");
            colmap.exists()
        })
    };
    assert!(cli::until(&mut child, begun));
    cli::signal(&child, "TERM");
    cli::wait(child).refused_with(75, &["the capture was stopped; nothing was written"]);
    assert_eq!(entries(place.path()), Vec::<String>::new());
}

#[test]
fn missing_programs_and_wrong_sources_are_refused() {
    let place = tempfile::tempdir().unwrap();
    let text = |name: &str| place.path().join(name).display().to_string();
    std::fs::create_dir(text("photos")).unwrap();
    sgs(&["capture", &text("photos"), "-o", &text("scene")]).refused_with(42, &["holds no photographs; give a folder"]);
    sgs(&["capture", &text("none"), "-o", &text("scene")]).refused_with(42, &["none does not exist; give a folder"]);
    for i in 0..2 {
        write_png(&place.path().join(format!("photos/{i}.png")), &Image::new(8, 6, 3)).unwrap();
    }
    let without = sgs_with(&["capture", &text("photos"), "-o", &text("scene")], &[("PATH", "")]);
    without.refused_with(1, &["the program colmap is not on the PATH", "apt-get install colmap"]);
    sgs(&["capture", &text("photos"), "-o", &text("photos")]).refused_with(2, &["do not belong to a scene"]);
    let few = sgs(&["capture", &text("photos"), "-o", &text("scene"), "--frames", "1"]);
    assert_eq!(few.status, Some(2), "{}", few.stderr);
    assert_eq!(entries(place.path()), ["photos"]);
}

/// Stand-in for COLMAP: keeps the images and the options of feature extraction, and finds no cameras.
const STAND_IN: &str = r#"#!/bin/sh
case "$1 $2" in
    "feature_extractor --"*) cp "$5"/* "$KEPT" && echo "$@" >>"$KEPT/options" ;;
    "mapper --"*) exit 1 ;;
esac
"#;

/// Returns a JPEG image with EXIF data: a focal length of 26 mm, for a film of 36 mm × 24 mm.
fn with_focal_length(image: &Image) -> Vec<u8> {
    let exif = b"Exif\0\0II*\0\x08\0\0\0\x01\0\x69\x87\x04\0\x01\0\0\0\x1a\0\0\0\0\0\0\0\
        \x01\0\x05\xa4\x03\0\x01\0\0\0\x1a\0\0\0\0\0\0\0";
    let jpeg = encode_jpeg(image, 100).unwrap();
    [&jpeg[..2], &[0xff, 0xe1, 0, exif.len() as u8 + 2], exif, &jpeg[2..]].concat()
}

#[test]
fn heic_photographs_reach_colmap_as_taken() {
    if !(has("heif-enc") && has("heif-convert")) {
        return;
    }
    let place = tempfile::tempdir().unwrap();
    let at = |name: &str| place.path().join(name);
    for folder in ["photos", "bin", "kept"] {
        std::fs::create_dir(at(folder)).unwrap();
    }
    let room = Path::new(env!("CARGO_MANIFEST_DIR")).join("data/room/images");
    let images = ["000.png", "001.png"].map(|name| read_upright(&room.join(name)).unwrap().image);
    write_png(&at("a.png"), &images[0]).unwrap();
    std::fs::write(at("b.jpg"), with_focal_length(&images[1])).unwrap();
    for (from, to) in [("a.png", "photos/a.heic"), ("b.jpg", "photos/b.HEIC")] {
        let mut encoder = Command::new("heif-enc");
        encoder.args(["-q", "95", "-o"]).args([at(to), at(from)]);
        let output = encoder.output().unwrap();
        assert!(output.status.success() && at(to).is_file(), "{output:?}");
    }
    std::fs::write(at("photos/c.heic"), "no image").unwrap();
    std::fs::write(at("bin/colmap"), STAND_IN).unwrap();
    std::fs::set_permissions(at("bin/colmap"), std::fs::Permissions::from_mode(0o755)).unwrap();
    let path = format!("{}:{}", at("bin").display(), std::env::var("PATH").unwrap());
    let text = |name: &str| at(name).display().to_string();
    let kept = text("kept");
    let environment = [("PATH", path.as_str()), ("KEPT", kept.as_str())];
    sgs_with(&["-q", "capture", &text("photos"), "-o", &text("scene")], &environment)
        .refused_with(42, &["COLMAP registered none of the 2 images"]);
    assert_eq!(entries(&at("kept")), ["a.jpg", "b.jpg", "options"]);
    for (name, original) in ["a.jpg", "b.jpg"].into_iter().zip(&images) {
        let converted = read_upright(&at("kept").join(name)).unwrap().image;
        let db = psnr(&converted, original, None).unwrap();
        println!("{name}: {db:.1} dB");
        // Of other photographs of the room, and of mirrored ones, it is below 15 dB.
        assert!(db > 30.0, "{name}: {db:.1} dB");
    }
    // Images of different focal lengths have cameras of their own. The diagonal is 120 pixels, that of the film 43.27 mm.
    let options = std::fs::read_to_string(at("kept/options")).unwrap();
    let cameras: Vec<Option<Vec<f64>>> = options.lines().map(camera_parameters).collect();
    let [None, Some(camera)] = &cameras[..] else { panic!("{options}") };
    let expected = [26.0 * 120.0 / 36_f64.hypot(24.0), 48.0, 36.0, 0.0];
    assert_eq!(camera.len(), expected.len(), "{options}");
    assert!(camera.iter().zip(expected).all(|(found, expected)| (found - expected).abs() < 1e-6), "{options}");
}

/// Returns the initial camera parameters among the options of an extraction.
fn camera_parameters(options: &str) -> Option<Vec<f64>> {
    let mut words = options.split(' ').skip_while(|word| *word != "--ImageReader.camera_params").skip(1);
    Some(words.next()?.split(',').map(|number| number.parse().unwrap()).collect())
}
