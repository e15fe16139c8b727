//! `sgs view` in a real window under Xvfb, with real input. Cases cover the screen's contents, mouse and keys, and
//! refusals. Edits and images must match those of the other commands.

use glam::{DMat3, DVec3};
use sgs_passes::transport::LightShape;
use sgs_relight::Edit;
use sgs_run::read_lights;
use sgs_scene::{Camera, Image};
use sgs_tests::Place;
use sgs_tests::cli::{sgs, start_with, wait};
use sgs_tests::emitting::{EMITTERS, fabricate_emitting, fabricate_windowed};
use sgs_tests::rooms::Room;
use sgs_tests::runs::{Parts, fabricate};
use sgs_tests::screen::Screen;
use std::path::Path;

const SIZE: [u32; 2] = [240, 160];

/// Returns a camera that sees all of a fabricated run, including its lights.
fn camera() -> Camera {
    let [width, height] = SIZE;
    let (fx, fy, cx, cy) = (200.0, 200.0, 120.0, 80.0);
    let (rotation, translation) = (DMat3::from_rotation_y(0.1), DVec3::new(0.1, -0.1, 3.0));
    Camera { name: "first".into(), width, height, fx, fy, cx, cy, rotation, translation, near: sgs_scene::NEAR }
}

/// Creates a run with materials and lights, and cameras for it.
fn place() -> Place {
    let place = Place::new(Room { views: 4, ..Room::default() });
    fabricate(&place.path("run"), Parts::ALL);
    let second = Camera { name: "second".into(), translation: DVec3::new(-0.3, 0.2, 4.0), ..camera() };
    Camera::write_transforms(&place.path("cameras.json"), &[camera(), second]).unwrap();
    std::fs::create_dir(place.path("out")).unwrap();
    place
}

fn bytes(path: &Path) -> (u32, Vec<u8>) {
    let rendering = image::open(path).unwrap_or_else(|e| panic!("{}: {e}", path.display())).to_rgb8();
    (rendering.width(), rendering.into_raw())
}

/// Compares two images. Returns the largest difference in 255ths and the share of values that differ by more than 8.
fn apart(a: &Path, b: &Path) -> (u8, f64) {
    let ((width, a), (other, b)) = (bytes(a), bytes(b));
    assert_eq!((width, a.len()), (other, b.len()));
    let each = || a.iter().zip(&b).map(|(x, y)| x.abs_diff(*y));
    (each().max().unwrap_or(0), each().filter(|d| *d > 8).count() as f64 / a.len() as f64)
}

/// Returns the first camera of a file.
fn camera_of(path: &Path) -> Camera {
    Camera::read_transforms(path).unwrap().remove(0)
}

#[test]
fn window_matches_render_output() {
    let Some(screen) = Screen::start([400, 300]) else { return };
    let place = place();
    let (run, cameras) = (place.text("run"), place.text("cameras.json"));
    let rendered = place.text("rendered");
    let channels = "rgb,alpha,pbr,albedo,metallic,visibility";
    sgs(&["render", &run, "--cameras", &cameras, "-o", &rendered, "--channels", channels]).ok();
    for channel in channels.split(',') {
        let saved = place.text("saved.png");
        let mut a = vec!["view", &run, "--cameras", &cameras, "--channel", channel, "--json", "--validate"];
        a.extend(["--frames", "8", "--save", &saved]);
        a.extend(["--size", "240x160"]);
        let child = start_with(&a, &[("DISPLAY", screen.name())]);
        let output = wait(child).ok().json();
        assert_eq!((&output["frames"], &output["size"]), (&8.into(), &serde_json::json!(SIZE)), "{output}");
        assert_eq!(output["made_later"], 0, "frames make something: {output}");
        let requested = place.path(&format!("rendered/first_{channel}.png"));
        let (most, _) = apart(&place.path("saved.png"), &requested);
        assert!(most <= 1, "{channel}: {most}");
    }
    let (_, differ) = apart(&place.path("rendered/first_pbr.png"), &place.path("rendered/first_albedo.png"));
    assert!(differ > 0.05, "all channels are alike");
}

#[test]
fn an_exported_glb_is_shown() {
    let Some(screen) = Screen::start([400, 300]) else { return };
    let place = place();
    let (run, cameras, glb) = (place.text("run"), place.text("cameras.json"), place.text("scene.glb"));
    sgs(&["export", &run, "-o", &glb]).ok();
    let rendered = place.text("rendered");
    sgs(&["render", &glb, "--cameras", &cameras, "-o", &rendered, "--channels", "rgb,pbr"]).ok();
    for channel in ["rgb", "pbr"] {
        let saved = place.text("saved.png");
        let mut a = vec!["view", &glb, "--cameras", &cameras, "--channel", channel, "--json", "--validate"];
        a.extend(["--frames", "2", "--save", &saved, "--size", "240x160"]);
        wait(start_with(&a, &[("DISPLAY", screen.name())])).ok();
        let (most, _) = apart(&place.path("saved.png"), &place.path(&format!("rendered/first_{channel}.png")));
        assert!(most <= 1, "{channel}: {most}");
    }
}

/// Returns the share of pixels where the screen differs from an image. The image has the window's size. Rows with text
/// are skipped.
/// skipped.
fn on_screen(screen: &Image, rendering: &Path, at: [usize; 2]) -> f64 {
    let (width, texels) = bytes(rendering);
    let rows = texels.len() / 3 / width as usize;
    let mut wrong = 0;
    for y in 48..rows {
        for x in 0..width as usize {
            let (i, k) = (y * width as usize + x, (y + at[1]) * screen.width as usize + x + at[0]);
            wrong += usize::from(
                (0..3).any(|c| (255.0 * screen.data[3 * k + c] - f32::from(texels[3 * i + c])).abs() > 1.5),
            );
        }
    }
    wrong as f64 / ((rows - 48) * width as usize) as f64
}

#[test]
fn mouse_and_keys_control_the_view() {
    let Some(screen) = Screen::start([500, 400]) else { return };
    let place = place();
    let (run, cameras, out) = (place.text("run"), place.text("cameras.json"), place.text("out"));
    let mut a = vec!["view", &run, "--cameras", &cameras, "--json", "--validate", "-o", &out];
    a.extend(["--size", "240x160"]);
    let mut child = start_with(&a, &[("DISPLAY", screen.name())]);
    let window = screen.window("sgs view");
    let key = |name: &str| drop(screen.act(&["key", name]));
    let saved = |number: u32| {
        key("p");
        let camera = screen.file(&place.path(&format!("out/view-{number:03}.json")));
        (camera.with_extension("png"), camera_of(&camera))
    };
    let corner = || {
        let geometry = screen.act(&["getwindowgeometry", "--shell", &window]);
        ["X=", "Y="].map(|n| {
            geometry.lines().find_map(|l| l.strip_prefix(n)?.parse::<f64>().ok()).expect("a place of the window")
        })
    };
    let [left, top] = corner();

    // The saved image equals the rendered one. The screen shows the same image with the correct order of colors.
    let (first, seen_with) = saved(0);
    assert!(seen_with.rotation.abs_diff_eq(camera().rotation, 1e-9) && (seen_with.fx - 200.0).abs() < 1e-9);
    sgs(&["render", &run, "--cameras", &place.text("out/view-000.json"), "-o", &place.text("r0")]).ok();
    assert!(apart(&first, &place.path("r0/view-000_rgb.png")).0 <= 1);
    screen
        .until("the image on the screen", || on_screen(&screen.image(), &first, [left as usize, top as usize]) < 1e-3);
    assert!(on_screen(&screen.image(), &first, [left as usize + 3, top as usize]) > 0.1, "anything passes");

    // The shaded image is seen from elsewhere: dragging the background orbits the camera.
    key("2");
    screen.drag("1", [left + 6.0, top + 150.0], [left + 36.0, top + 140.0]);
    let (turned, seen_with) = saved(1);
    assert!((seen_with.position() - camera().position()).length() > 0.1);
    let render = |number: u32, channels: &str| {
        let (file, to) = (place.text(&format!("out/view-{number:03}.json")), place.text("r"));
        sgs(&["render", &run, "--cameras", &file, "-o", &to, "--channels", channels]).ok();
        place.path(&format!("r/view-{number:03}_{channels}.png"))
    };
    assert!(apart(&turned, &render(1, "pbr")).0 <= 1);

    // A light is moved, brightened and colored. The image follows, and `sgs relight` with the saved edit gives the same
    // image.
    let before = read_lights(&place.path("run/lights.json")).unwrap();
    let at = seen_with.project(DVec3::from(before.lights[3].position.map(f64::from))).expect("in front");
    let (from, to) = ([left + at.x, top + at.y], [left + at.x + 24.0, top + at.y - 18.0]);
    screen.drag("1", from, to);
    (0..3).for_each(|_| drop(screen.act(&["click", "4"])));
    ["bracketright", "bracketright", "k"].into_iter().for_each(key);
    key("e");
    let file = screen.file(&place.path("out/edit-000.json"));
    let (moved, still) = saved(2);
    assert_eq!(still.translation, seen_with.translation, "moving a light does not turn the view");
    let edit = Edit::read(&file).unwrap();
    let [change] = &edit.lights.change[..] else { panic!("{edit:?}") };
    assert_eq!((change.light, change.on, edit.environment.scale), (Some(3), None, Some(1.25)), "{edit:?}");
    // A wheel click by XTEST may count twice: it lacks a mouse's valuators, and its release counts as a click as well.
    let notches = change.intensity.expect("it was dimmed up").ln() / 1.1f32.ln();
    assert!([3.0, 6.0].iter().any(|n| (notches - n).abs() < 0.01) && change.color.is_some(), "{edit:?}");
    let now = DVec3::from(change.to.expect("it was moved").map(f64::from));
    let seen = seen_with.project(now).expect("in front");
    assert!((seen.x + left - to[0]).abs() < 1.01 && (seen.y + top - to[1]).abs() < 1.01, "{seen} {to:?}");
    let (turned_to, relit) = (place.text("out/view-002.json"), place.text("relit"));
    sgs(&["relight", &run, "--edit", &file.display().to_string(), "--cameras", &turned_to, "-o", &relit]).ok();
    let (most, _) = apart(&moved, &place.path("relit/view-002_relit.png"));
    assert!(most <= 1, "{most}");
    assert!(apart(&moved, &turned).1 > 0.02, "the edit changes nothing");
    // The key resets all lights.
    key("z");
    assert!(apart(&saved(3).0, &turned).0 <= 1);

    // Exposure, the next camera, walking, another window size, and hiding and showing the window.
    ["plus", "n"].into_iter().for_each(key);
    let (brighter, second) = saved(4);
    assert!(
        (second.position() - Camera::read_transforms(&place.path("cameras.json")).unwrap()[1].position()).length()
            < 1e-9
    );
    assert!(apart(&brighter, &render(4, "pbr")).1 > 0.02);
    key("0");
    screen.act(&["windowsize", "--sync", &window, "301", "203"]);
    screen.act(&["windowunmap", "--sync", &window]);
    screen.act(&["windowmap", "--sync", &window]);
    screen.act(&["windowfocus", "--sync", &window]);
    ["keydown", "keyup"].into_iter().for_each(|how| {
        screen.act(&[how, "w"]);
        std::thread::sleep(std::time::Duration::from_millis(300));
    });
    let (larger, walked) = saved(5);
    assert_eq!([walked.width, walked.height], [301, 203]);
    assert!((walked.position() - second.position()).dot(second.forward()) > 1e-3, "{walked:?}");
    assert!(apart(&larger, &render(5, "pbr")).0 <= 1);
    // Handles are hidden. Once the camera rests, the image fills the window at full resolution.
    key("l");
    let [left, top] = corner();
    screen.until("the image in the larger window", || {
        on_screen(&screen.image(), &larger, [left as usize, top as usize]) < 1e-3
    });

    assert!(child.try_wait().unwrap().is_none());
    key("Escape");
    let output = wait(child).ok().json();
    assert_eq!(output["files"].as_array().map(Vec::len), Some(7), "{output}");
}

#[test]
fn emitters_are_moved_switched_dimmed_and_recolored_with_their_bounces() {
    let Some(screen) = Screen::start([500, 400]) else { return };
    let place = Place::new(Room { views: 4, ..Room::default() });
    fabricate_emitting(place.path("").as_path());
    std::fs::create_dir(place.path("out")).unwrap();
    let seen_with = Room::default().cameras()[1].scaled(SIZE[0], SIZE[1]);
    Camera::write_transforms(&place.path("cameras.json"), std::slice::from_ref(&seen_with)).unwrap();
    let (run, cameras, out) = (place.text("run"), place.text("cameras.json"), place.text("out"));
    let rendered = |edit: &[&str]| {
        let fixed = ["relight", &run, "--cameras", &cameras, "-o", &place.text("relit"), "--force"];
        sgs(&[&fixed[..], edit].concat()).ok();
        place.path(&format!("relit/{}_relit.png", seen_with.name))
    };
    // The window without input.
    let saved = place.text("saved.png");
    let mut a = vec!["view", &run, "--cameras", &cameras, "--channel", "pbr", "--json", "--validate"];
    a.extend(["--size", "240x160"]);
    let all = [&a[..], &["--frames", "8", "--save", &saved]].concat();
    let output = wait(start_with(&all, &[("DISPLAY", screen.name())])).ok().json();
    assert_eq!(output["made_later"], 0, "frames make something: {output}");
    // The command solves all emitters at once, to a tolerance.
    let (most, _) = apart(&place.path("saved.png"), &rendered(&[]));
    assert!(most <= 2, "{most}");

    let a = [&a[..], &["-o", &out]].concat();
    let mut child = start_with(&a, &[("DISPLAY", screen.name())]);
    let window = screen.window("sgs view");
    let key = |name: &str| drop(screen.act(&["key", name]));
    let saved = |number: u32| {
        key("p");
        screen.file(&place.path(&format!("out/view-{number:03}.json"))).with_extension("png")
    };
    let geometry = screen.act(&["getwindowgeometry", "--shell", &window]);
    let [left, top] = ["X=", "Y="]
        .map(|n| geometry.lines().find_map(|l| l.strip_prefix(n)?.parse::<f64>().ok()).expect("a place of the window"));
    let first = saved(0);
    assert!(apart(&first, &place.path("saved.png")).0 == 0);
    // A bulb is moved by its handle, recolored and dimmed.
    let at = seen_with.project(DVec3::new(0.4, -0.3, 0.4)).expect("in front");
    screen.drag("1", [left + at.x, top + at.y], [left + at.x - 20.0, top + at.y + 5.0]);
    ["bracketright", "bracketright"].into_iter().for_each(key);
    screen.act(&["click", "5"]);
    key("e");
    let file = screen.file(&place.path("out/edit-000.json"));
    let changed = saved(1);
    let edit = Edit::read(&file).unwrap();
    let [change] = &edit.emitters.change[..] else { panic!("{edit:?}") };
    assert_eq!((change.emitter.as_deref(), change.on), (Some(EMITTERS[1]), None), "{edit:?}");
    let by = DVec3::from(change.by.expect("it was moved").map(f64::from));
    let seen = seen_with.project(DVec3::new(0.4, -0.3, 0.4) + by).expect("in front");
    assert!((seen.x - at.x + 20.0).abs() < 1.01 && (seen.y - at.y - 5.0).abs() < 1.01, "{seen} {at}");
    assert!(change.intensity.is_some_and(|v| v < 0.95) && change.color.is_some(), "{edit:?}");
    assert!(apart(&changed, &rendered(&["--edit", &file.display().to_string()])).0 <= 2);
    assert!(apart(&changed, &first).1 > 0.02, "the edit changes nothing");
    // It is switched off and on. The room has no environment that a key could dim.
    key("o");
    let off = saved(2);
    assert!(apart(&off, &changed).1 > 0.02);
    ["o", "k"].into_iter().for_each(key);
    assert!(apart(&saved(3), &changed).0 == 0);
    key("z");
    assert!(apart(&saved(4), &first).0 <= 1);
    assert!(child.try_wait().unwrap().is_none());
    key("Escape");
    let output = wait(child).ok().json();
    assert_eq!(output["files"].as_array().map(Vec::len), Some(6), "{output}");
}

#[test]
fn windows_are_switched_and_dimmed_and_points_added() {
    let Some(screen) = Screen::start([500, 400]) else { return };
    let place = Place::new(Room { views: 4, ..Room::default() });
    fabricate_windowed(place.path("").as_path());
    std::fs::create_dir(place.path("out")).unwrap();
    let seen_with = Room::default().cameras()[1].scaled(SIZE[0], SIZE[1]);
    Camera::write_transforms(&place.path("cameras.json"), std::slice::from_ref(&seen_with)).unwrap();
    let (run, cameras, out) = (place.text("run"), place.text("cameras.json"), place.text("out"));
    let mut a = vec!["view", &run, "--cameras", &cameras, "--channel", "pbr", "--json", "--validate", "-o", &out];
    a.extend(["--size", "240x160"]);
    let mut child = start_with(&a, &[("DISPLAY", screen.name())]);
    screen.window("sgs view");
    let key = |name: &str| drop(screen.act(&["key", name]));
    let saved = |number: u32| {
        key("p");
        screen.file(&place.path(&format!("out/view-{number:03}.json"))).with_extension("png")
    };
    // The image of `sgs relight` under the edit that the window writes.
    let relit = |number: u32| {
        key("e");
        let edit = screen.file(&place.path(&format!("out/edit-{number:03}.json")));
        let fixed = ["relight", &run, "--cameras", &cameras, "-o", &place.text("relit"), "--force", "--edit"];
        sgs(&[&fixed[..], &[&edit.display().to_string()]].concat()).ok();
        (place.path(&format!("relit/{}_relit.png", seen_with.name)), Edit::read(&edit).unwrap().emitters)
    };
    let first = saved(0);
    assert!(apart(&first, &relit(0).0).0 <= 2);
    // The environment behind the window is dimmed. Then the window, the first of the emitters, is switched off.
    ["j", "j", "j"].into_iter().for_each(key);
    let dimmed = saved(1);
    let (theirs, edit) = relit(1);
    assert!(apart(&dimmed, &theirs).0 <= 2 && apart(&dimmed, &first).1 > 0.02);
    assert!(edit.environment.scale.is_some_and(|s| (s - 0.512).abs() < 1e-3) && edit.change.is_empty(), "{edit:?}");
    ["Tab", "o"].into_iter().for_each(key);
    let off = saved(2);
    let (theirs, edit) = relit(2);
    assert!(apart(&off, &theirs).0 <= 2 && apart(&off, &dimmed).1 > 0.02);
    assert!(edit.change.len() == 1 && edit.change[0].emitter.as_deref() == Some(EMITTERS[0]), "{edit:?}");
    // A point is added, dimmed and removed.
    ["i", "bracketright"].into_iter().for_each(key);
    let added = saved(3);
    let (theirs, edit) = relit(3);
    assert!(apart(&added, &theirs).0 <= 2 && apart(&added, &off).1 > 0.02);
    assert!(edit.add.len() == 1 && matches!(edit.add[0].shape, LightShape::Point { .. }), "{edit:?}");
    key("Delete");
    assert!(apart(&saved(4), &off).0 == 0);
    key("z");
    assert!(apart(&saved(5), &first).0 <= 1);
    assert!(child.try_wait().unwrap().is_none());
    key("Escape");
    wait(child).ok();
}

#[test]
fn invalid_viewer_arguments_are_refused() {
    let place = Place::new(Room { views: 4, ..Room::default() });
    fabricate(&place.path("run"), Parts::NONE);
    let run = place.text("run");
    let refused = |arguments: &[&str], display: &str, words: &[&str]| {
        wait(start_with(arguments, &[("DISPLAY", display), ("WAYLAND_DISPLAY", ""), ("WAYLAND_SOCKET", "")]))
            .refused(words);
    };
    refused(&["view", &run], "", &["no display", "DISPLAY", "sgs render"]);
    refused(&["view", &run], ":7919", &["no display", "sgs render"]);
    refused(&["view", &run, "-o", &place.text("none")], "", &["none", "no directory"]);
    for wrong in [["--size", "20"], ["--channel", "color"], ["--frames", "0"], ["--save", "a.png"]] {
        assert_eq!(sgs(&[&["view", &run][..], &wrong].concat()).status, Some(2), "{wrong:?}");
    }
    let Some(screen) = Screen::start([300, 200]) else { return };
    refused(&["view", &place.text("no")], screen.name(), &["no", "no such run"]);
    refused(&["view", &run, "--channel", "metallic"], screen.name(), &["has no metallic", "rgb, pbr"]);
    refused(&["view", &run, "--device", "none such"], screen.name(), &["none such"]);
    let cameras = place.text("cameras.json");
    std::fs::write(place.path("cameras.json"), "{\"frames\": []}").unwrap();
    refused(&["view", &run, "--cameras", &cameras], screen.name(), &["cameras.json"]);
}
