//! Cameras that `sgs render` and `sgs relight` derive from a scene, and videos.

use sgs_tests::Place;
use sgs_tests::cli::{Finished, sgs, start_with, wait};
use sgs_tests::rooms::Room;
use sgs_tests::runs::{Parts, fabricate};
use std::collections::BTreeSet;
use std::os::unix::fs::PermissionsExt;

/// Creates an untrained run and a room with cameras that see it.
fn place() -> Place {
    let place = Place::new(Room { views: 4, ..Room::default() });
    fabricate(&place.path("run"), Parts::NONE);
    place
}

/// Returns the arguments of a command on the run, with the room as its scene.
fn arguments(place: &Place, command: &str, more: &[&str]) -> Vec<String> {
    let mut all: Vec<String> =
        [command, &place.text("run"), "--scene", &place.text("scene"), "--json"].map(String::from).into();
    all.extend(more.iter().map(|s| (*s).to_owned()));
    all
}

fn run(place: &Place, command: &str, more: &[&str]) -> Finished {
    sgs(&arguments(place, command, more))
}

/// Returns the names of the files that a command has written.
fn written(finished: Finished) -> Vec<String> {
    let answer = finished.ok().json();
    let name = |file: &serde_json::Value| {
        let path = std::path::PathBuf::from(file.as_str().expect("a path"));
        assert!(path.is_file(), "{} is absent", path.display());
        path.file_name().expect("a name").to_string_lossy().into_owned()
    };
    answer["files"].as_array().expect("files").iter().map(name).collect()
}

#[test]
fn views_of_the_scene_are_rendered_by_split() {
    let place = place();
    let out = place.text("out");
    assert_eq!(written(run(&place, "render", &["-o", &out])), ["001_rgb.png"]);
    let all: Vec<String> = ["000", "001", "002", "003"].map(|n| format!("{n}_rgb.png")).into();
    assert_eq!(written(run(&place, "render", &["-o", &out, "--views", "all"])), all);
    let train = written(run(&place, "relight", &["-o", &out, "--views", "train"]));
    assert_eq!(train, ["000_relit.png", "002_relit.png", "003_relit.png"]);
    // A camera file gives the same images.
    let cameras = place.text("scene/transforms.json");
    sgs(&["render", &place.text("run"), "--cameras", &cameras, "-o", &place.text("by_file")]).ok();
    for name in all {
        assert!(place.read(&format!("out/{name}")) == place.read(&format!("by_file/{name}")), "{name}");
    }
    // Without a scene, a command has no cameras.
    sgs(&["render", &place.text("run"), "-o", &out]).refused(&["--scene", "--cameras"]);
    sgs(&["render", &place.text("run/scene.ply"), "-o", &out]).refused(&["is no run", "--scene", "--cameras"]);
    sgs(&["relight", &place.text("run"), "--orbit", "3", "-o", &out]).refused(&["--scene"]);
    for wrong in
        [&["--cameras", "a", "--orbit", "3"][..], &["--orbit", "0"], &["--path", "--views", "all"], &["--frames", "3"]]
    {
        let finished = run(&place, "render", &[&["-o", &out], wrong].concat());
        assert_eq!(finished.status, Some(2), "{wrong:?}: {}", finished.stderr);
    }
    assert_eq!(run(&place, "render", &[]).status, Some(2));
}

#[test]
fn orbits_and_paths_are_rendered_and_written_as_videos() {
    let place = place();
    let (out, gif) = (place.text("out"), place.text("path.gif"));
    let orbit = written(run(&place, "render", &["-o", &out, "--orbit", "5"]));
    assert_eq!(orbit, [0, 1, 2, 3, 4].map(|i| format!("orbit_{i:03}_rgb.png")));
    let different: BTreeSet<Vec<u8>> = orbit.iter().map(|name| place.read(&format!("out/{name}"))).collect();
    assert_eq!(different.len(), 5, "cameras of an orbit coincide");
    let path = written(run(&place, "relight", &["-o", &out, "--path", "--frames", "3", "--video", &gif]));
    assert_eq!(path, ["path_000_relit.png", "path_001_relit.png", "path_002_relit.png", "path.gif"]);
    let bytes = place.read("path.gif");
    assert!(bytes.starts_with(b"GIF89a") && bytes.ends_with(b";"));
    // Without an output directory, only the video is written.
    let depth = ["--channels", "depth", "--orbit", "2", "--video", &gif];
    assert_eq!(written(run(&place, "render", &depth)), ["path.gif"]);
    run(&place, "render", &["--channels", "rgb,depth", "--video", &gif]).refused_with(2, &["--video", "one channel"]);
    run(&place, "render", &["--video", &place.text("a.avi")]).refused_with(2, &["a.avi", ".mp4, .webp or .gif"]);
    run(&place, "relight", &["--video", &place.text("none/a.gif")]).refused_with(2, &["none/a.gif", "does not exist"]);
}

#[test]
fn mp4_needs_ffmpeg_and_says_so() {
    let place = place();
    let mp4 = place.text("orbit.mp4");
    let answered = arguments(&place, "render", &["--orbit", "3", "--video", &mp4]);
    let plain: Vec<String> = answered.iter().map(|a| if a == "--json" { "-q".into() } else { a.clone() }).collect();
    let with_path = |a: &[String], path: &str| wait(start_with(a, &[("PATH", path)]));
    with_path(&plain, "/nowhere").refused(&["orbit.mp4", "ffmpeg", ".gif"]);
    assert!(!place.path("orbit.mp4").exists());
    // The stand-in for `ffmpeg` writes its input to the output file.
    std::fs::create_dir(place.path("bin")).unwrap();
    let program = place.path("bin/ffmpeg");
    let script = "#!/bin/sh\n[ \"$1\" = -version ] && exit 0\nfor last; do :; done\ncat > \"$last\"\n";
    std::fs::write(&program, script).unwrap();
    std::fs::set_permissions(&program, std::fs::Permissions::from_mode(0o755)).unwrap();
    let path = format!("{}:/usr/bin:/bin", place.text("bin"));
    assert_eq!(written(with_path(&answered, &path)), ["orbit.mp4"]);
    assert_eq!(place.read("orbit.mp4").len(), 3 * 32 * 24 * 3);
    // If `ffmpeg` fails, its message is reported.
    std::fs::write(&program, script.replace("cat", "echo no codec >&2; exit 1; cat")).unwrap();
    with_path(&plain, &path).refused(&["orbit.mp4", "ffmpeg failed", "no codec"]);
}
