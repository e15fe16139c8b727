//! `sgs robustness`: cases of noise over seeds, their table, and resumes.

use serde_json::Value;
use sgs_scene::{Noise, Scene, SceneOptions};
use sgs_tests::Place;
use sgs_tests::cli::{Finished, sgs, signal, start, until, wait};
use sgs_tests::meaning::Meaning;
use sgs_tests::rooms::Room;

fn room() -> Room {
    Room { priors: true, truth: true, ..Room::default() }
}

fn arguments(place: &Place, out: &str, steps: &str, more: &[&str]) -> Vec<String> {
    let (scene, out) = (place.text("scene"), place.text(out));
    let fixed = ["robustness", &scene, "-o", &out, "--seed", "5", "--no-densify", "-q", "--geometry-steps", steps];
    fixed.iter().chain(more).map(|s| (*s).to_owned()).collect()
}

fn robustness(place: &Place, more: &[&str]) -> Finished {
    sgs(&arguments(place, "table", "3", more))
}

fn json(place: &Place, name: &str) -> Value {
    serde_json::from_slice(&place.read(name)).unwrap()
}

/// Removes the timings from a table.
fn timeless(mut table: Value) -> Value {
    for row in table["variants"].as_array_mut().unwrap() {
        let [mean, deviation] = ["mean", "deviation"].map(|k| row[k].take());
        for (k, mut part) in [("mean", mean), ("deviation", deviation)] {
            part.as_object_mut().unwrap().remove("seconds_per_step");
            row[k] = part;
        }
        row["runs"].as_array_mut().unwrap().iter_mut().for_each(|run| {
            run.as_object_mut().unwrap().remove("seconds_per_step");
        });
    }
    table
}

#[test]
fn noise_does_not_change_held_out_data() {
    let place = Place::new(room());
    Meaning::default().write(&room(), &place.path("scene"));
    let scene = Scene::open(&place.path("scene"), &SceneOptions::default()).unwrap();
    let some = Noise { positions: 0.1, normals: 10.0, semantics: 0.5, rotations: 2.0, translations: 0.1, seed: 3 };
    let other = scene.disturbed(&some);
    assert_eq!(scene.disturbed(&Noise::default()).views, scene.views);
    assert_eq!((other.extent(), &other.split), (scene.extent(), &scene.split));
    assert_eq!(other.points.colors, scene.points.colors);
    assert_ne!(other.points.positions, scene.points.positions);
    for (i, (a, b)) in scene.views.iter().zip(&other.views).enumerate() {
        let held_out = scene.split.test.contains(&i);
        assert_eq!(a.camera == b.camera, held_out, "{i}");
        assert_eq!((a.camera.fx, a.camera.width, &a.image_path), (b.camera.fx, b.camera.width, &b.image_path));
    }
    let view = scene.split.train[0];
    assert_ne!(scene.normal_prior(view).unwrap(), other.normal_prior(view).unwrap());
    assert_ne!(scene.semantic_prior(view).unwrap(), other.semantic_prior(view).unwrap());
    let again = scene.disturbed(&some);
    assert_eq!(again.normal_prior(view).unwrap(), other.normal_prior(view).unwrap());
    assert_eq!(again.semantic_prior(view).unwrap(), other.semantic_prior(view).unwrap());
}

#[test]
fn table_matches_separate_trainings_and_survives_interruption() {
    let place = Place::new(room());
    let more = ["--only", "clean,normals", "--stage", "geometry", "--seeds", "2", "--set", "noise.normals=25"];
    let more = [&more[..], &["--set", "train.checkpoint_interval=10"]].concat();
    let output = sgs(&arguments(&place, "table", "60", &more)).ok().stdout;
    assert_eq!(output.as_bytes(), place.read("table/robustness.md"));
    assert!(
        output.contains("| clean: everything as it is | 2 |")
            && output.contains("| normals: normal priors turned by 25° | 2 |")
    );
    let table = json(&place, "table/robustness.json");
    let [clean, noisy] = [0, 1].map(|i| table["variants"][i]["mean"]["normal_mae_deg"].as_f64().unwrap());
    assert!(noisy > clean, "{noisy} {clean}");
    assert!(table["variants"][1]["deviation"]["psnr"].as_f64().unwrap() > 0.0);
    assert_eq!(table["variants"][1]["runs"][1]["seed"], 6);
    // One case is trained separately with the same noise.
    let alone = ["--geometry-steps", "60", "--no-densify", "--seed", "6", "--set", "noise.normals=25"];
    sgs(&[&["train", &place.text("scene"), "-o", &place.text("alone"), "-q"], &alone[..]].concat()).ok();
    assert!(place.read("table/normals_seed6/scene.ply") == place.read("alone/scene.ply"));
    assert!(place.read("table/clean_seed6/scene.ply") != place.read("alone/scene.ply"));

    // The series is interrupted in the second case and continued.
    let long = arguments(&place, "again", "60", &more);
    let mut child = start(&long);
    let reached = until(&mut child, || place.logged("again/normals_seed5").last().is_some_and(|s| *s >= 20));
    signal(&child, "INT");
    let stopped = wait(child);
    assert!(reached && stopped.status == Some(130), "{stopped:?}");
    assert!(stopped.stderr.contains("stopped in") && stopped.stderr.contains("normals_seed5"), "{stopped:?}");
    assert_eq!(json(&place, "again/robustness.json")["variants"].as_array().unwrap().len(), 1);
    sgs(&long).ok();
    assert_eq!(timeless(json(&place, "again/robustness.json")), timeless(table));
}

/// Tests every case at its default noise, with materials. All cases give different splats.
///
/// Cases of poses are measured after alignment, too, and so is the case that they are compared with.
#[test]
fn every_case_differs_and_has_materials() {
    let place = Place::new(room());
    Meaning::default().write(&room(), &place.path("scene"));
    let mut more = vec!["--seeds", "1", "--intrinsic-steps", "2"];
    for set in [
        "geometry.losses.correspondence=0",
        "intrinsic.environment.resolution=16",
        "intrinsic.lights.grid=2",
        "intrinsic.visibility.levels=4",
        "intrinsic.visibility.log2_table=10",
        "intrinsic.visibility.finest=64",
    ] {
        more.extend(["--set", set]);
    }
    let table = robustness(&place, &[&more[..], &["--json"]].concat()).ok().json();
    let names = ["clean", "positions", "normals", "semantics", "poses", "learned_poses"];
    let rows = table["variants"].as_array().unwrap();
    assert_eq!(rows.iter().map(|r| r["name"].as_str().unwrap()).collect::<Vec<_>>(), names);
    assert_eq!((&table["steps"], &table["intrinsic_steps"]), (&Value::from(3), &Value::from(2)));
    let means = |name: &str| place.read(&format!("table/{name}_seed5/scene.ply"));
    for (i, name) in names.into_iter().enumerate() {
        assert!(rows[i]["mean"]["pbr_psnr"].as_f64().unwrap() > 3.0, "{name}");
        names.into_iter().filter(|other| *other != name).for_each(|other| assert!(means(name) != means(other)));
        let config = String::from_utf8(place.read(&format!("table/{name}_seed5/config.toml"))).unwrap();
        assert_eq!(config.contains("cameras = [0.5, 0.005]"), name.ends_with("poses"), "{name}");
        assert_eq!(config.contains("views = [0.001, 0.0, 0.0, 0.0]"), name == "learned_poses", "{name}");
        let measured = json(&place, &format!("table/{name}_seed5/metrics.json"));
        for key in ["psnr_aligned", "ssim_aligned"] {
            let expected = measured.pointer(&format!("/test/mean/nvs/{key}"));
            assert_eq!(rows[i]["mean"].get(key), expected, "{name}");
            assert_eq!(expected.is_some(), name == "clean" || name.ends_with("poses"), "{name}");
        }
    }
    // A second run trains nothing again.
    let files =
        || names.map(|n| place.path(&format!("table/{n}_seed5/scene.ply")).metadata().unwrap().modified().unwrap());
    let before = files();
    assert_eq!(robustness(&place, &[&more[..], &["--json"]].concat()).ok().json(), table);
    assert_eq!(files(), before);
    let text = String::from_utf8(place.read("table/robustness.md")).unwrap();
    assert!(text.contains("after 3 steps and 2 of materials") && text.contains("shaded PSNR"), "{text}");
    assert!(text.contains("| PSNR, dB ↑ | PSNR, aligned, dB ↑ | SSIM ↑ | SSIM, aligned ↑ |"), "{text}");
    let row = |name: &str| text.lines().find(|l| l.starts_with(&format!("| {name}: "))).unwrap();
    assert!(row("positions").contains(" | – | ") && !row("poses").contains('–'), "{text}");
    assert!(row("learned_poses").contains("turned by 0.5°, 0.5 % of the extent off, and learned | 1 |"), "{text}");
}

#[test]
fn invalid_cases_and_noise_are_refused() {
    let place = Place::new(Room::default());
    robustness(&place, &["--only", "clean,noise"]).refused(&["no case \"noise\"", "clean, positions, normals"]);
    robustness(&place, &["--only", "normals"]).refused(&["\"normals\" would differ from no other", "priors/normal"]);
    robustness(&place, &["--only", "learned_poses", "--set", "geometry.rates.views=[1e-3, 0, 0, 0]"])
        .refused(&["\"learned_poses\" would differ from no other", "learns cameras in every case"]);
    robustness(&place, &["--stage", "intrinsic"]).refused(&["--stage is geometry, transport or all"]);
    robustness(&place, &["--set", "noise.postions=0.1"])
        .refused(&["noise.postions", "did you mean \"noise.positions\"?"]);
    robustness(&place, &["--set", "noise.semantics=1.5"]).refused(&["noise.semantics is 1.5, but must be 0 to 1."]);
    robustness(&place, &["--set", "noise.cameras=[-1, 0]"])
        .refused(&["noise.cameras is [-1, 0], but must be two numbers, 0 to 180"]);
    robustness(&place, &["--set", "noise.normals=nan"]).refused(&["noise.normals is NaN"]);
    robustness(&place, &["--lpips", "none.safetensors"]).refused(&["none.safetensors", "there is no such file"]);
    assert!(!place.path("table").exists());
}
