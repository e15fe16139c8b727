//! Checks before the first step of a training: refused inputs, and warnings.

use sgs_run::read_lights;
use sgs_scene::{Image, Splats, write_png};
use sgs_tests::Place;
use sgs_tests::cli::{Finished, sgs};
use sgs_tests::rooms::{Room, write_json};
use std::path::Path;

/// Transforms the positions of a room's cameras and points.
fn move_room(scene: &Path, cameras: impl Fn(f64) -> f64, points: impl Fn(f64) -> f64) {
    let file = scene.join("transforms.json");
    let mut value: serde_json::Value = serde_json::from_slice(&std::fs::read(&file).unwrap()).unwrap();
    for frame in value["frames"].as_array_mut().unwrap() {
        for row in 0..3 {
            let at = &mut frame["transform_matrix"][row][3];
            *at = cameras(at.as_f64().unwrap()).into();
        }
    }
    write_json(&file, &value);
    let file = scene.join("points.ply");
    let text = std::fs::read_to_string(&file).unwrap();
    let (header, body) = text.split_once("end_header\n").unwrap();
    let lines = body.lines().map(|line| {
        let numbers: Vec<&str> = line.split(' ').collect();
        let moved = numbers[..3].iter().map(|v| format!("{:e}", points(v.parse().unwrap())));
        moved.chain(numbers[3..].iter().map(|v| (*v).to_owned())).collect::<Vec<_>>().join(" ") + "\n"
    });
    std::fs::write(&file, format!("{header}end_header\n{}", lines.collect::<String>())).unwrap();
}

fn train(place: &Place, more: &[&str]) -> Finished {
    let (scene, run) = (place.text("scene"), place.text("run"));
    sgs(&[&["train", &scene, "-o", &run, "--geometry-steps", "1", "--no-densify", "--force"], more].concat())
}

/// Trains both stages for a few steps.
fn train_all(place: &Place, run: &str) {
    let small = [
        "transport.surfels=0",
        "geometry.densify.from=10",
        "geometry.densify.interval=10",
        "intrinsic.lights.grid=2",
        "intrinsic.lights.lobes=2",
        "intrinsic.environment.resolution=16",
        "intrinsic.visibility.levels=2",
    ];
    let sets: Vec<&str> = small.iter().flat_map(|set| ["--set", *set]).collect();
    let (scene, run) = (place.text("scene"), place.text(run));
    let steps = ["--stage", "all", "--geometry-steps", "60", "--intrinsic-steps", "20"];
    sgs(&[&["train", &scene, "-o", &run], &steps[..], &sets].concat()).ok();
}

/// Tests that the unit of a scene does not affect training. Units are millimeters and eight kilometers. Files keep the
/// scene's units.
#[test]
fn scene_units_do_not_change_training() {
    let place = Place::new(Room::default());
    let scene = place.path("scene");
    Room::default().write_materials(&scene);
    train_all(&place, "own");
    let (large, small) = (2_f64.powi(10), 2_f64.powi(-13));
    move_room(&scene, |v| large * v, |v| large * v);
    train_all(&place, "large");
    let metrics_of = |run: &str| sgs(&["eval", &place.text(run), "--json"]).ok().json();
    let of_large = metrics_of("large");
    move_room(&scene, |v| small / large * v, |v| small / large * v);
    train_all(&place, "small");
    let of_small = metrics_of("small");

    let splats = |run: &str| Splats::read_ply(&place.path(&format!("{run}/scene.ply"))).unwrap();
    let (a, b) = (splats("large"), splats("small"));
    let scaled = |means: &[[f32; 3]], by: f64| -> Vec<f32> {
        means.as_flattened().iter().map(|v| (f64::from(*v) * by) as f32).collect()
    };
    assert!(a.len() > 100);
    assert!(scaled(&a.means, small / large) == b.means.as_flattened());
    assert!(a.sh == b.sh && a.rotations == b.rotations && a.opacity_logits == b.opacity_logits);
    // Logarithms of scales are rounded between the stages, and Adam takes full steps for gradients near zero.
    let near = |a: &[f32], b: &[f32], by: f32| {
        let off = a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(off < by, "{off} of {by}");
    };
    near(&a.roughness.unwrap(), &b.roughness.unwrap(), 0.1);
    near(a.albedo.unwrap().as_flattened(), b.albedo.unwrap().as_flattened(), 0.1);
    let lights = |run: &str| read_lights(&place.path(&format!("{run}/lights.json"))).unwrap();
    let (a, b) = (lights("large"), lights("small"));
    for (a, b) in a.lights.iter().zip(&b.lights) {
        let by = (small / large) as f32;
        let size = b.position.iter().fold(0_f32, |most, v| most.max(v.abs()));
        near(&a.position.map(|v| v * by), &b.position, 1e-2 * size);
        assert_eq!(a.gain * by * by, b.gain);
        near(&a.lobes[0].amplitude, &b.lobes[0].amplitude, 1e-2 * a.lobes[0].amplitude[0]);
    }
    // Metrics equal those of the room in its own unit.
    let psnr = |metrics: &serde_json::Value, of: &str| metrics["mean"][of]["psnr"].as_f64().unwrap();
    let own = metrics_of_moved(&place, &scene, small);
    for of in ["nvs", "pbr"] {
        let all = [&of_large, &of_small].map(|m| psnr(m, of));
        assert!((all[0] - all[1]).abs() < 1e-3, "{of}: {all:?}");
        assert!((all[0] - psnr(&own, of)).abs() < 0.6, "{of}: {all:?} and {}", psnr(&own, of));
    }
    // Cameras of a file do not determine the scene's size.
    let (run, out) = (place.text("small"), place.text("out"));
    move_room(&scene, |v| small * v, |v| small * v);
    let cameras = place.text("scene/transforms.json");
    sgs(&["render", &run, "--cameras", &cameras, "-o", &out]).ok();
    let first = std::fs::read_dir(place.path("out")).unwrap().map(|e| e.unwrap().path());
    let first = first.filter(|p| p.extension().is_some_and(|e| e == "png")).min().unwrap();
    let image = image::open(&first).unwrap().to_rgb8();
    let mean = image.iter().map(|v| f64::from(*v)).sum::<f64>() / image.len() as f64 / 255.0;
    assert!(mean > 0.1, "the image is black: {mean}");
}

/// Returns metrics of the run "own" after scaling the room back to its own unit.
fn metrics_of_moved(place: &Place, scene: &Path, from: f64) -> serde_json::Value {
    move_room(scene, |v| v / from, |v| v / from);
    sgs(&["eval", &place.text("own"), "--json"]).ok().json()
}

#[test]
fn scenes_in_two_units_are_refused() {
    let place = Place::new(Room::default());
    let scene = place.path("scene");
    move_room(&scene, |v| v, |v| 1e-4 * v);
    let output = train(&place, &[]).ok().stderr;
    assert!(output.contains("of their area") && output.contains("same units"), "{output}");
    move_room(&scene, |v| v, |v| 1e4 * v);
    let output = train(&place, &[]).ok().stderr;
    assert!(output.lines().all(|line| !line.contains("WARN") || line.contains(" not run: ")), "{output}");
    // Points belong to another reconstruction.
    move_room(&scene, |v| v, |v| v + 1000.0);
    std::fs::remove_dir_all(place.path("run")).unwrap();
    train(&place, &[]).refused_with(42, &["no training view sees any", "same reconstruction", "same units"]);
    sgs(&["plan", &place.text("scene")]).refused_with(42, &["same units"]);
    assert!(!place.path("run").exists());
    move_room(&scene, |v| v, |v| 1000.0 * (v - 1000.0));
    let output = train(&place, &[]).ok().stderr;
    assert!(output.contains("too far for parallax"), "{output}");
}

#[test]
fn cameras_with_one_pose_are_warned_of() {
    let place = Place::new(Room::default());
    let file = place.path("scene/transforms.json");
    let mut value: serde_json::Value = serde_json::from_slice(&std::fs::read(&file).unwrap()).unwrap();
    let first = value["frames"][0]["transform_matrix"].clone();
    value["frames"][2]["transform_matrix"] = first.clone();
    write_json(&file, &value);
    let output = train(&place, &[]).ok().stderr;
    assert!(output.contains("1 of 6 training cameras have the pose of another one"), "{output}");
    value["frames"].as_array_mut().unwrap().iter_mut().for_each(|f| f["transform_matrix"] = first.clone());
    write_json(&file, &value);
    let output = train(&place, &[]).ok().stderr;
    assert!(output.contains("the 6 training cameras stand at one place") && output.contains("depth"), "{output}");
}

#[test]
fn insufficient_images_and_priors_are_warned_of() {
    let place = Place::new(Room::default());
    let image = place.path("scene/images/000.png");
    let mut cut = Image::new(32, 24, 4);
    cut.data.chunks_exact_mut(4).enumerate().for_each(|(i, p)| p.fill(if i % 4 == 0 { 0.0 } else { 1.0 }));
    write_png(&image, &cut).unwrap();
    let output = train(&place, &[]).ok().stderr;
    assert!(output.contains("000.png is transparent in 25 % of its pixels"), "{output}");
    assert!(!output.contains("no priors of") && !output.contains('\u{1b}') && !output.contains("sgs::"), "{output}");
    let output = sgs(&["plan", &place.text("scene"), "--stage", "all"]).ok().stderr;
    assert!(
        output.contains("no priors of normals or materials") && output.contains("docs/guide/priors.md"),
        "{output}"
    );
    // An evaluation does not warn about the start of a training.
    std::fs::remove_file(place.path("scene/points.ply")).unwrap();
    let output = train(&place, &["--set", "random_points=500"]).ok().stderr;
    assert!(output.contains("starting from 500 random points"), "{output}");
    let output = sgs(&["eval", &place.text("run")]).ok().stderr;
    assert!(!output.contains("random") && !output.contains("transparent"), "{output}");
}

#[test]
fn a_moved_scene_is_found_by_the_scene_option() {
    let place = Place::new(Room::default());
    train(&place, &[]).ok();
    std::fs::rename(place.path("scene"), place.path("moved")).unwrap();
    let (run, moved, page) = (place.text("run"), place.text("moved"), place.text("a.html"));
    for command in [vec!["eval", &run], vec!["report", &run, "-o", &page]] {
        sgs(&command).refused_with(1, &["no longer at", "/scene\"", "--scene DIR"]);
        sgs(&[&command[..], &["--scene", &moved]].concat()).ok();
    }
    // The error is reported before minutes of work.
    if std::fs::File::create("/proc/sgs.html").is_err() {
        sgs(&["report", &run, "-o", "/proc/a.html", "--scene", &moved]).refused(&["/proc/a.html", "cannot be written"]);
    }
}

#[test]
fn folders_of_photographs_are_refused_with_commands_for_poses() {
    let place = Place::new(Room::default());
    std::fs::create_dir(place.path("photos")).unwrap();
    std::fs::rename(place.path("scene/images"), place.path("photos/images")).unwrap();
    let photos = place.text("photos");
    let command = format!("sgs capture {photos}/images -o SCENE");
    let words = ["holds 8 photographs without cameras", &command, "VGGT", "demo_colmap.py --scene_dir"];
    sgs(&["train", &photos, "-o", &place.text("run")]).refused_with(42, &words);
    let inner = place.text("photos/images");
    sgs(&["train", &inner, "-o", &place.text("run")]).refused_with(42, &[&format!("sgs capture {inner} -o")]);
}

#[test]
fn points_that_do_not_fit_into_memory_are_thinned() {
    let place = Place::new(Room { size: [64, 48], spacing: 1, ..Room::default() });
    let plan = sgs(&["plan", &place.text("scene"), "--no-densify", "--json"]).ok().json();
    let (all, needed) = (plan["gaussians"].as_u64().unwrap(), plan["needs_bytes"].as_u64().unwrap());
    let budget = (needed / 4 * 3).to_string();
    let trained = train(&place, &["--json", "--memory-budget", &budget]).ok();
    let retained = trained.json()["gaussians"].as_u64().unwrap();
    assert!(retained < all && retained > all / 3, "{retained} of {all}");
    let output = format!("memory does not suffice for all {all} points; training starts from {retained} of them");
    assert!(trained.stderr.contains(&output), "{}", trained.stderr);
    place.resume("run").ok();
}
