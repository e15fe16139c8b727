//! `sgs priors`: a provider runs over a scene's photographs and writes files that training reads.

use sgs_provider::{Provider, ProviderImage, ProviderOptions};
use sgs_scene::{DepthMeaning, GroundTruth, GroundTruthKind, Image, Scene, SceneOptions, read_exr, write_npy_f32};
use sgs_synth::{SceneName, SynthOptions};
use sgs_tests::cli::{Finished, sgs, signal, start, until, wait};
use sgs_tests::priors::provider;
use sgs_tests::rooms::Room;
use sgs_tests::{Place, files};
use std::path::{Path, PathBuf};

/// Creates a room with ground truth of normals and depth, without priors.
fn room() -> Place {
    let place = Place::new(Room { views: 5, truth: true, ..Room::default() });
    // The stand-in reads neither tiled nor PIZ-compressed files, which the room has.
    for path in files(&place.path("scene/gt/normal")).keys() {
        let image = read_exr(path).unwrap().image;
        let shape = [image.height, image.width, 3].map(|n| n as usize);
        write_npy_f32(&path.with_extension("npy"), &shape, &image.data).unwrap();
    }
    place
}

fn priors(place: &Place, how: &str, more: &[&str]) -> Finished {
    let (scene, provider) = (place.text("scene"), provider(how));
    let mut arguments = vec!["priors", &scene, "--provider", &provider, "--json"];
    arguments.extend(more);
    sgs(&arguments)
}

/// Returns the options of a stand-in that serves the place's own scene.
fn stand_in(place: &Place, options: &str) -> String {
    format!("'stand-in={}' {options}", place.text("scene"))
}

fn open(place: &Place) -> Scene {
    Scene::open(&place.path("scene"), &SceneOptions::default()).unwrap()
}

/// Returns the numbers of files written and kept.
fn counts(finished: Finished) -> (usize, u64) {
    let json = finished.ok().json();
    (json["written"].as_array().unwrap().len(), json["kept"].as_u64().unwrap())
}

#[track_caller]
fn assert_near(a: &Image, b: &Image, most: f32) {
    assert_eq!((a.width, a.height, a.channels), (b.width, b.height, b.channels));
    let worst = a.data.iter().zip(&b.data).map(|(x, y)| (x - y).abs()).fold(0.0, f32::max);
    assert!(worst <= most, "differs by {worst}, at most {most} was expected");
}

/// Compares the normal priors of views with the ground truth.
#[track_caller]
fn assert_normals(place: &Place, views: &[usize], most: f32) {
    let scene = open(place);
    for &view in views {
        let truth = GroundTruth::of(&scene).load(GroundTruthKind::Normal, view).unwrap().unwrap();
        assert_near(&scene.normal_prior(view).unwrap().unwrap(), &truth, most);
    }
}

#[test]
fn normal_priors_of_every_frame_match_ground_truth() {
    for frame in ["world", "camera-opencv", "camera-opengl", "camera-stablenormal"] {
        let place = room();
        let how = stand_in(&place, &format!("--noise 0 --frame {frame}"));
        assert_eq!(counts(priors(&place, &how, &[])), (4, 0));
        let json = String::from_utf8(place.read("scene/priors/priors.json")).unwrap();
        assert!(json.contains(&format!("\"frame\": \"{frame}\"")), "{json}");
        assert_normals(&place, &[0, 2, 3, 4], 2e-3);
        assert!(open(&place).normal_prior(1).unwrap().is_none(), "view 1 is a test view");
    }
    // The comparison detects noise.
    let place = room();
    priors(&place, &stand_in(&place, "--noise 0.05"), &[]).ok();
    let result = std::panic::catch_unwind(|| assert_normals(&place, &[0], 2e-3));
    assert!(result.is_err(), "noise was not noticed");
    sgs(&place.arguments("run", 3, &["--no-densify"])).ok();
    let log = String::from_utf8(place.read("run/log.jsonl")).unwrap();
    assert!(log.lines().count() > 0);
    let plan = sgs(&["plan", &place.text("scene")]).ok();
    assert!(plan.stdout.contains("the scene has normal priors"), "{}", plan.stdout);
}

#[test]
fn normal_priors_of_two_frames_are_loaded_in_one() {
    let place = room();
    assert_eq!(counts(priors(&place, &stand_in(&place, "--noise 0 --frame camera-opengl"), &[])), (4, 0));
    let before = files(&place.path("scene/priors"));
    let how = stand_in(&place, "--noise 0 --frame world");
    assert_eq!(counts(priors(&place, &how, &["--views", "all"])), (1, 4));
    assert_normals(&place, &[0, 1, 2, 3, 4], 2e-3);
    // Existing files are untouched, and one new file was written.
    let after = files(&place.path("scene/priors"));
    assert!(before.iter().all(|(path, bytes)| after.get(path) == Some(bytes)) && after.len() == before.len() + 1);
}

/// Synthesizes a room with blocks and a sphere, without priors: three training views and one test view.
fn synthesized_box(place: &Place, [width, height]: [usize; 2], samples_per_pixel: usize) -> PathBuf {
    let scene = place.path("box");
    let options = SynthOptions {
        scene: SceneName::Box,
        views: 3,
        test_views: 1,
        width,
        height,
        samples_per_pixel,
        relit: false,
        ..SynthOptions::default()
    };
    sgs_synth::generate(&scene, &options, &|_, _| {}).unwrap();
    std::fs::remove_dir_all(scene.join("priors")).unwrap();
    scene
}

#[test]
fn every_kind_of_prior_matches_ground_truth() {
    let place = room();
    let scene = synthesized_box(&place, [40, 32], 4);
    let path = scene.display().to_string();
    let fill = |options: &str, more: &[&str]| {
        let provider = provider(&format!("'stand-in={path}' {options}"));
        let mut arguments = vec!["priors", &path, "--provider", &provider, "--json", "--views", "all"];
        arguments.extend(more);
        counts(sgs(&arguments))
    };
    // Six kinds for four views, names and embeddings.
    assert_eq!(fill("--noise 0", &[]), (26, 0));
    let opened = Scene::open(&scene, &SceneOptions::default()).unwrap();
    let embeddings = opened.text_embeddings().unwrap().unwrap();
    for view in 0..4 {
        let truth = |kind| GroundTruth::of(&opened).load(kind, view).unwrap().unwrap();
        assert_near(&opened.normal_prior(view).unwrap().unwrap(), &truth(GroundTruthKind::Normal), 2e-3);
        // In 8 bits of sRGB, linear light is off by up to one hundredth.
        assert_near(&opened.albedo_prior(view).unwrap().unwrap().image, &truth(GroundTruthKind::Albedo), 0.01);
        let roughness = opened.roughness_prior(view).unwrap().unwrap().image;
        assert_near(&roughness, &truth(GroundTruthKind::Roughness), 0.003);
        let metallic = opened.metallic_prior(view).unwrap().unwrap().image;
        assert_near(&metallic, &truth(GroundTruthKind::Metallic), 0.003);
        let regions = opened.region_prior(view).unwrap().unwrap();
        let features = opened.semantic_prior(view).unwrap().unwrap();
        assert_eq!((features.width, features.height, features.channels), (5, 4, 512));
        for (cell, feature) in features.data.chunks(512).enumerate() {
            let dot = |e: &[f32]| e.iter().zip(feature).map(|(a, b)| a * b.to_f32()).sum::<f32>();
            let scores: Vec<f32> = embeddings.data.chunks(512).map(dot).collect();
            let best = (0..scores.len()).max_by(|a, b| scores[*a].total_cmp(&scores[*b])).unwrap();
            assert!((scores[best] - 1.0).abs() < 0.01);
            // The stand-in takes the class at the center of a cell and numbers regions from 1.
            let (x, y) = (cell % 5 * 8 + 4, cell / 5 * 8 + 4);
            assert_eq!(usize::from(regions.ids[y * 40 + x]), best + 1, "view {view}, cell {cell}");
        }
    }
    assert_masks(&opened, &provider(&format!("'stand-in={path}' --noise 0")));
    // A second run writes nothing. Then one file is missing, and then one kind is written in another encoding.
    assert_eq!(fill("--noise 0", &[]), (0, 26));
    std::fs::remove_file(scene.join("priors/masks/002.png")).unwrap();
    assert_eq!(fill("--noise 0", &["--only", "masks,albedo"]), (1, 7));
    assert_eq!(fill("--noise 0 --color linear", &["--only", "albedo", "--force"]), (4, 0));
    assert!(scene.join("priors/albedo/000.exr").is_file() && !scene.join("priors/albedo/000.png").exists());
    let truth = GroundTruth::of(&opened).load(GroundTruthKind::Albedo, 0).unwrap().unwrap();
    assert_near(&opened.albedo_prior(0).unwrap().unwrap().image, &truth, 1e-3);
    assert_eq!(fill("", &["--only", "semantic", "--labels", "wall, ghost"]), (2, 4));
    assert_eq!(opened.text_embeddings().unwrap().unwrap().labels, ["wall", "ghost"]);
    assert!(files(&scene.join("priors")).keys().all(|p| !p.display().to_string().ends_with(".tmp")));
    let run = place.text("run");
    sgs(&["train", &path, "-o", &run, "--geometry-steps", "2", "--no-densify"]).ok();
}

/// Requests masks of the thing at the center of view 0. Compares them with the region maps. Frames are view 0, view 1,
/// and view 2 of which only the camera is sent.
#[track_caller]
fn assert_masks(scene: &Scene, command: &str) {
    let mut provider = Provider::start(&ProviderOptions::new(command)).unwrap();
    let images: Vec<Image> = (0..3).map(|i| scene.load_image(i).unwrap()).collect();
    let rendered = |i: usize| {
        let camera = &scene.views[i].camera;
        let view = (i < 2).then_some(camera.name.as_str());
        ProviderImage { view, camera: Some(camera), ..ProviderImage::srgb(&images[i]) }
    };
    let masks = provider.masks(&[rendered(0), rendered(1), rendered(2)], Some([20.5, 16.5])).unwrap();
    let ids: Vec<Vec<u16>> = (0..3).map(|i| scene.region_prior(i).unwrap().unwrap().ids).collect();
    let thing = ids[0][16 * 40 + 20];
    for (frame, most) in [(0, 0), (1, 0), (2, 40 * 32 / 8)] {
        let wrong = masks.frames[frame].iter().zip(&ids[frame]).filter(|(m, id)| **m != (**id == thing)).count();
        assert!(wrong <= most, "{wrong} pixels of frame {frame} are wrong");
    }
    let there = masks.frames[2].iter().filter(|m| **m).count();
    assert!((20..40 * 32 - 20).contains(&there), "{there} pixels say nothing");
    // Images without a name or a camera carry only their colors.
    let plain = provider.masks(&[0, 0, 0].map(|i| ProviderImage::srgb(&images[i])), Some([20.5, 16.5])).unwrap();
    assert!(plain.frames[0][16 * 40 + 20] && plain.frames[1] == plain.frames[0]);
}

/// Tests depths of every meaning against ground truth.
///
/// The factor and shift are those that the meaning leaves open.
#[test]
fn depth_priors_of_every_meaning_match_ground_truth() {
    let place = room();
    for path in files(&place.path("scene/gt/depth")).keys() {
        let image = read_exr(path).unwrap().image;
        write_npy_f32(&path.with_extension("npy"), &[image.height as usize, image.width as usize], &image.data)
            .unwrap();
    }
    let fill = |meaning: &str, more: &[&str]| {
        let how = stand_in(&place, &format!("--noise 0.25 --depth {meaning}"));
        priors(&place, &how, &[&["--only", "depth", "--quiet"], more].concat())
    };
    let exact = |meaning: &str, more: &[&str]| {
        let how = stand_in(&place, &format!("--noise 0 --depth {meaning}"));
        counts(priors(&place, &how, &[&["--only", "depth"], more].concat()))
    };
    for (meaning, expected) in [
        ("metric", DepthMeaning::Metric),
        ("scale", DepthMeaning::Scale),
        ("inverse-scale-shift", DepthMeaning::InverseScaleShift),
    ] {
        // Depth and confidence of four views.
        assert_eq!(exact(meaning, &["--force"]), (8, 0));
        let scene = open(&place);
        assert_eq!(scene.depth_meaning(), expected);
        assert!(scene.depth_prior(1).unwrap().is_none(), "view 1 is a test view");
        let mut factors = Vec::new();
        for view in [0, 2, 3, 4] {
            let truth = GroundTruth::of(&scene).load(GroundTruthKind::Depth, view).unwrap().unwrap();
            let found = scene.depth_prior(view).unwrap().unwrap();
            assert!(found.valid.data.iter().all(|v| *v == 1.0));
            let of = |at: usize| match expected {
                DepthMeaning::InverseScaleShift => 1.0 / truth.data[at],
                _ => truth.data[at],
            };
            // The factor and shift of two pixels hold for all.
            let far = (0..truth.data.len()).max_by(|a, b| of(*a).total_cmp(&of(*b))).unwrap();
            let (a, b) = (&found.image.data[0], &found.image.data[far]);
            let factor = match expected {
                DepthMeaning::InverseScaleShift => (b - a) / (of(far) - of(0)),
                _ => a / of(0),
            };
            let shift = a - factor * of(0);
            for (at, value) in found.image.data.iter().enumerate() {
                assert!((value - factor * of(at) - shift).abs() < 1e-4, "{meaning}, view {view}, pixel {at}");
            }
            factors.push(factor);
        }
        let same = factors.iter().all(|f| (f - factors[0]).abs() < 1e-5);
        assert_eq!(same, expected == DepthMeaning::Metric, "{meaning}: {factors:?}");
    }
    // Other meanings do not fit what is there, unless all of it is replaced.
    fill("scale", &["--views", "all"]).refused(&["inverse-scale-shift depths", "are scale", "--force"]);
    assert_eq!(exact("inverse-scale-shift", &["--views", "all"]), (2, 4));
    fill("scale", &["--force"]).refused(&["inverse-scale-shift depths", "are scale"]);
    fill("scale", &["--views", "all", "--force"]).ok();
    assert_eq!(open(&place).depth_meaning(), DepthMeaning::Scale);
    // Confidence of the stand-in is 1 / (1 + noise).
    let confident = open(&place).depth_prior(1).unwrap().unwrap().valid.data;
    assert!(confident.iter().all(|v| (v - 0.8).abs() < 0.01), "{:?}", confident[0]);
    // A unit that a person wrote for metric depths stays, and belongs to no other meaning.
    std::fs::write(place.path("scene/priors/priors.json"), r#"{"depth": {"meaning": "metric", "unit": 0.5}}"#).unwrap();
    assert_eq!(exact("metric", &["--force", "--views", "all"]), (10, 0));
    let settings = String::from_utf8(place.read("scene/priors/priors.json")).unwrap();
    assert!(settings.contains("0.5"), "{settings}");
    assert_eq!(exact("scale", &["--force", "--views", "all"]), (10, 0));
    let settings = String::from_utf8(place.read("scene/priors/priors.json")).unwrap();
    assert!(settings.contains("scale") && !settings.contains("0.5"), "{settings}");
}

/// Names the synthesized depths of a scene as those of a sensor.
fn name_sensor(scene: &Path) {
    let path = scene.join("transforms.json");
    let mut listing: serde_json::Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    listing["depth_unit_scale_factor"] = 1.0.into();
    for frame in listing["frames"].as_array_mut().unwrap() {
        let stem = Path::new(frame["file_path"].as_str().unwrap()).file_stem().unwrap().to_str().unwrap().to_owned();
        let file = ["npy", "exr"].map(|e| format!("gt/depth/{stem}.{e}")).into_iter().find(|f| scene.join(f).is_file());
        frame["depth_file_path"] = file.unwrap().into();
    }
    std::fs::write(&path, listing.to_string()).unwrap();
}

/// Tests normals of sensor depth in a room with blocks and a sphere.
#[test]
fn normals_from_depth_match_ground_truth() {
    let place = room();
    let scene = synthesized_box(&place, [160, 120], 1);
    let path = scene.display().to_string();
    sgs(&["priors", &path, "--normals-from-depth", "--quiet"])
        .refused(&["has no depth in its 3 views", "priors/depth"]);
    name_sensor(&scene);
    let compute = |more: &[&str]| counts(sgs(&[&["priors", &path, "--normals-from-depth", "--json"], more].concat()));
    assert_eq!(compute(&[]), (3, 0));
    assert_eq!(compute(&["--views", "all"]), (1, 3));
    let text = std::fs::read_to_string(scene.join("priors/priors.json")).unwrap();
    assert!(text.contains("camera-opencv"), "{text}");
    let errors = || {
        let opened = Scene::open(&scene, &SceneOptions::default()).unwrap();
        let (mut sum, mut known, mut all) = (0.0, 0, 0);
        for view in 0..4 {
            let truth = GroundTruth::of(&opened).load(GroundTruthKind::Normal, view).unwrap().unwrap();
            let found = opened.normal_prior(view).unwrap().unwrap();
            for (a, b) in found.data.as_chunks::<3>().0.iter().zip(truth.data.as_chunks::<3>().0) {
                let [a, b] = [a, b].map(|v| glam::Vec3::from(*v).as_dvec3());
                if b.length() > 0.5 {
                    all += 1;
                    if a.length() > 0.5 {
                        known += 1;
                        sum += a.dot(b).clamp(-1.0, 1.0).acos().to_degrees();
                    }
                }
            }
        }
        (sum / f64::from(known), f64::from(known) / f64::from(all))
    };
    let (error, share) = errors();
    println!("normals from depth: {error:.2} degrees off on {:.1} % of the pixels", 100.0 * share);
    assert!(error < 1.5 && share > 0.9, "{error} {share}");
    // A larger step reaches over more edges.
    let two = ["priors", &path, "--normals-from-depth", "2", "--json", "--views", "all", "--force"];
    assert_eq!(counts(sgs(&two)).0, 4);
    let wide = errors();
    println!("with a step of 2: {:.2} degrees, {:.1} %", wide.0, 100.0 * wide.1);
    assert!(wide.1 < share);
    sgs(&["priors", &path, "--normals-from-depth", "0"]).refused_with(2, &["--normals-from-depth is 0"]);
    assert_eq!(sgs(&["priors", &path]).status, Some(2));
    // Training reads them.
    let run = place.text("run");
    sgs(&["train", &path, "-o", &run, "--stage", "geometry", "--geometry-steps", "2", "--no-densify"]).ok();
    let log = String::from_utf8(place.read("run/log.jsonl")).unwrap();
    let steps = log.lines().map(|line| serde_json::from_str::<serde_json::Value>(line).unwrap());
    let losses: Vec<f64> = steps.filter_map(|step| step["normal"].as_f64()).collect();
    assert!(losses.len() == 2 && losses.iter().all(|loss| *loss > 0.0), "{log}");
    // Inverse depths with a shift have no normals.
    std::fs::create_dir_all(scene.join("priors/depth")).unwrap();
    std::fs::copy(scene.join("gt/depth/000.exr"), scene.join("priors/depth/000.exr")).unwrap();
    let settings = r#"{"normal": {"frame": "world"}, "depth": {"meaning": "inverse-scale-shift"}}"#;
    std::fs::write(scene.join("priors/priors.json"), settings).unwrap();
    sgs(&["priors", &path, "--normals-from-depth", "--force", "--quiet"]).refused(&["unknown shift have no normals"]);
    // The frame of existing normals is kept.
    std::fs::remove_dir_all(scene.join("priors/depth")).unwrap();
    std::fs::write(scene.join("priors/priors.json"), r#"{"normal": {"frame": "world"}}"#).unwrap();
    assert_eq!(compute(&["--views", "all", "--force"]).0, 4);
    let again = errors();
    assert!((again.0 - error).abs() < 0.01 && (again.1 - share).abs() < 1e-9, "{again:?}");
}

#[test]
fn region_ids_of_single_images_are_distinct() {
    let place = room();
    let ids = |view: usize| open(&place).region_prior(view).unwrap().map(|r| r.ids[0]);
    assert_eq!(counts(priors(&place, "misbehave=nothing", &["--only", "masks"])), (4, 0));
    let mut first: Vec<u16> = [0, 2, 3, 4].into_iter().filter_map(ids).collect();
    assert_eq!(first, [1, 2, 3, 4]);
    // New ids start above the existing ones.
    assert_eq!(counts(priors(&place, "misbehave=nothing", &["--only", "masks", "--views", "all"])), (1, 4));
    first.extend(ids(1));
    assert_eq!(first, [1, 2, 3, 4, 5]);
    // With `--force`, all ids are free again.
    let again = &["--only", "masks", "--views", "all", "--force"];
    assert_eq!(counts(priors(&place, "misbehave=nothing", again)), (5, 0));
    assert_eq!((0..5).filter_map(ids).collect::<Vec<_>>(), [1, 2, 3, 4, 5]);
}

#[test]
fn smaller_answers_and_unknown_pixels_are_stored() {
    let place = room();
    // The provider requests linear images of at most 16 columns.
    assert_eq!(counts(priors(&place, "misbehave=linear", &["--only", "normal"])), (4, 0));
    let stored = read_exr(&place.path("scene/priors/normal/000.exr")).unwrap().image;
    assert_eq!((stored.width, stored.height), (16, 12));
    let loaded = open(&place).normal_prior(0).unwrap().unwrap();
    assert_eq!((loaded.width, loaded.height), (32, 24));
    // One albedo value is NaN, so one pixel is unknown.
    assert_eq!(counts(priors(&place, "misbehave=nan", &["--only", "albedo"])), (4, 0));
    let albedo = open(&place).albedo_prior(0).unwrap().unwrap();
    assert_eq!((albedo.valid.data[0], albedo.valid.data.iter().sum::<f32>()), (0.0, 767.0));
}

#[test]
fn failed_prior_extraction_reports_one_error_and_leaves_no_files() {
    let place = room();
    let refused = |how: &str, more: &[&str], words: &[&str]| {
        priors(&place, how, more).refused(words);
        assert!(files(&place.path("scene/priors")).is_empty(), "{how} left files");
    };
    refused("misbehave=exit", &[], &["ended with status 3 before it answered", "CUDA out of memory"]);
    refused("misbehave=wrong-shape", &["--only", "normal"], &["has the shape [3, 32, 24], but must have [24, 32, 3]"]);
    refused(
        "misbehave=hang",
        &["--answer-seconds", "0.5", "--only", "normal"],
        &["gave no answer to normals within 0.5 s"],
    );
    refused("misbehave=few-offers", &["--only", "normal"], &["cannot make the prior \"normal\"; it offers text"]);
    refused("misbehave=cannot-load", &[], &["there are no weights at /nowhere"]);
    refused("misbehave=nothing", &["--answer-seconds", "0"], &["--answer-seconds is 0, but must be"]);
    refused("'stand-in=/nowhere'", &[], &["cannot answer the greeting: FileNotFoundError"]);
    let command = sgs(&["priors", &place.text("scene"), "--provider", "/nowhere/at-all"]);
    command.refused(&["the provider \"/nowhere/at-all\" cannot be started"]);
    let wrong = priors(&place, "misbehave=nothing", &["--only", "normal,beauty"]);
    assert_eq!(wrong.status, Some(2));
    assert!(
        wrong.stderr.contains("\"beauty\" is no kind of prior; there are normal, depth, semantic"),
        "{}",
        wrong.stderr
    );
}

#[test]
fn interrupted_prior_extraction_resumes() {
    let place = room();
    let (scene, provider) = (place.text("scene"), provider("misbehave=slow"));
    let arguments = ["priors", &scene, "--provider", &provider, "--only", "normal", "--views", "all"];
    let mut child = start(&arguments);
    assert!(until(&mut child, || place.path("scene/priors/normal/000.exr").is_file()));
    signal(&child, "INT");
    let finished = wait(child);
    assert_eq!(finished.status, Some(130), "{}", finished.stderr);
    assert!(finished.stderr.contains("the same command goes on"), "{}", finished.stderr);
    let there = files(&place.path("scene/priors/normal")).len();
    assert!((1..5).contains(&there), "{there} files");
    open(&place);
    let finished = sgs(&arguments).ok();
    assert!(finished.stderr.contains(&format!("wrote {} files, kept {there}", 5 - there)), "{}", finished.stderr);
}

/// Tests that files as `vggt` writes them are read back exactly.
#[test]
fn cameras_and_points_written_by_python_are_read_exactly() {
    let place = Place::new(Room { views: 5, ..Room::default() });
    let cameras = Room { views: 5, ..Room::default() }.cameras();
    let views: Vec<_> = cameras
        .iter()
        .map(|c| {
            let row = |i: usize| [c.rotation.row(i).x, c.rotation.row(i).y, c.rotation.row(i).z, c.translation[i]];
            serde_json::json!({
                "name": format!("{}.png", c.name), "width": c.width, "height": c.height, "fx": c.fx, "fy": c.fy,
                "cx": c.cx, "cy": c.cy, "world_to_camera": [row(0), row(1), row(2)],
            })
        })
        .collect();
    let code = "import json, sys\nsys.path.insert(0, sys.argv[1])\nfrom sgs_priors import colmap\n\
                colmap.write(sys.argv[2], json.loads(sys.argv[3]), [(1, -2, 3.5, 255, 0, 51), (0, 1e-9, 2, 1, 2, 3)])";
    let package = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tools/priors");
    std::fs::remove_file(place.path("scene/transforms.json")).unwrap();
    let status = std::process::Command::new("python3")
        .args(["-B", "-c", code])
        .arg(package)
        .args([place.text("scene"), serde_json::Value::from(views).to_string()])
        .status();
    assert!(status.unwrap().success());
    let scene = open(&place);
    assert_eq!((scene.views.len(), scene.points.len()), (5, 2));
    assert_eq!(scene.points.positions[0], [1.0, -2.0, 3.5]);
    for (view, camera) in scene.views.iter().zip(&cameras) {
        assert_eq!(view.camera.name, camera.name);
        assert!(view.camera.rotation.abs_diff_eq(camera.rotation, 1e-9));
        assert!(view.camera.translation.abs_diff_eq(camera.translation, 1e-9));
        assert!((view.camera.fx - camera.fx).abs() < 1e-9 && (view.camera.cy - camera.cy).abs() < 1e-9);
    }
}
