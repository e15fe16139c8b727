//! `sgs capture`: refusals and stopping. [`crate::captured`] makes scenes.
//!
//! Tests that need COLMAP, or photographs beside the repository, are skipped without them.

use sgs_scene::{Image, write_png};
use sgs_tests::cli::{self, sgs, sgs_with};
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
