//! `sgs ablate --stage intrinsic|all`: material variants on shared geometry.

use serde_json::Value;
use sgs_scene::Splats;
use sgs_tests::Place;
use sgs_tests::cli::{Finished, sgs, signal, start, until, wait};
use sgs_tests::rooms::Room;
use std::time::SystemTime;

const SMALL: [&str; 5] = [
    "intrinsic.environment.resolution=16",
    "intrinsic.lights.grid=2",
    "intrinsic.visibility.levels=4",
    "intrinsic.visibility.log2_table=10",
    "intrinsic.visibility.finest=64",
];

fn room() -> Place {
    let room = Room { priors: true, truth: true, ..Room::default() };
    let place = Place::new(room);
    room.write_materials(&place.path("scene"));
    place
}

fn arguments(place: &Place, out: &str, more: &[&str]) -> Vec<String> {
    let (scene, out) = (place.text("scene"), place.text(out));
    let fixed = ["ablate", &scene, "-o", &out, "--seed", "5", "--no-densify", "-q", "--geometry-steps", "3"];
    let sets = SMALL.iter().flat_map(|s| ["--set", s]);
    fixed.into_iter().chain(sets).chain(more.iter().copied()).map(str::to_owned).collect()
}

fn ablate(place: &Place, more: &[&str]) -> Finished {
    sgs(&arguments(place, "table", more))
}

fn json(place: &Place, name: &str) -> Value {
    serde_json::from_slice(&place.read(name)).unwrap()
}

fn written(place: &Place, name: &str) -> SystemTime {
    place.path(name).metadata().unwrap().modified().unwrap()
}

fn names(table: &Value) -> Vec<&str> {
    table["variants"].as_array().unwrap().iter().map(|v| v["name"].as_str().unwrap()).collect()
}

/// Returns the geometry of a run.
fn geometry(place: &Place, run: &str) -> Splats {
    let splats = Splats::read_ply(&place.path(&format!("{run}/scene.ply"))).unwrap();
    Splats { albedo: None, roughness: None, metallic: None, ..splats }
}

#[test]
fn material_variants_share_geometry() {
    let place = room();
    let some = ["--stage", "intrinsic", "--intrinsic-steps", "3", "--seeds", "1", "--only", "full,no_lights,no_priors"];
    let table = ablate(&place, &some).ok().stdout;
    assert_eq!(table.as_bytes(), place.read("table/ablation.md"));
    assert!(table.contains("after 3 steps and 3 of materials, on "), "{table}");
    for expected in ["| full: everything | 1 |", "| no_lights: without point lights | 1 |", "shaded PSNR"] {
        assert!(table.contains(expected), "{expected} is missing:\n{table}");
    }
    let table = json(&place, "table/ablation.json");
    assert_eq!(names(&table), ["full", "no_lights", "no_priors"]);
    assert_eq!((&table["steps"], &table["intrinsic_steps"], &table["start"]), (&3.into(), &3.into(), &Value::Null));
    for row in table["variants"].as_array().unwrap() {
        let known = |key: &str| row["mean"][key].is_f64();
        assert!(known("psnr") && known("pbr_psnr") && known("intrinsic_seconds_per_step"), "{row}");
        assert!(row["runs"][0]["device"].as_str().is_some_and(|d| d != "an unknown device"));
    }
    let value = |i: usize| table["variants"][i]["mean"]["pbr_psnr"].as_f64().unwrap();
    assert!(value(0) != value(1) && value(0) != value(2), "what is left out makes no difference");
    // The variants share the geometry and train their own materials.
    let common = geometry(&place, "table/geometry_seed5");
    for name in ["full", "no_lights", "no_priors"] {
        let own = geometry(&place, &format!("table/{name}_seed5"));
        assert!((&own.means, &own.sh) == (&common.means, &common.sh), "{name}");
    }
    assert!(place.read("table/full_seed5/scene.ply") != place.read("table/no_priors_seed5/scene.ply"));

    // Finished runs are not repeated unless their settings changed.
    let files = ["table/geometry_seed5/scene.ply", "table/full_seed5/lights.json", "table/no_lights_seed5/scene.ply"];
    let times = files.map(|f| written(&place, f));
    ablate(&place, &some).ok();
    assert!(files.map(|f| written(&place, f)) == times && json(&place, "table/ablation.json") == table);
    ablate(
        &place,
        &[&some[..6], &["--only", "full,no_lights", "--force", "--set", "intrinsic.losses.dssim=0.5"]].concat(),
    )
    .ok();
    let after = files.map(|f| written(&place, f));
    assert!(after[0] == times[0] && after[1] > times[1] && after[2] > times[2], "{after:?} {times:?}");
}

#[test]
fn ablation_accepts_existing_geometry() {
    let place = room();
    let scene = place.text("scene");
    for (run, steps) in [("a", "2"), ("b", "4")] {
        sgs(&["train", &scene, "-o", &place.text(run), "-q", "--no-densify", "--geometry-steps", steps]).ok();
    }
    let on = |run: &str| {
        let file = place.text(&format!("{run}/scene.ply"));
        let some =
            ["--stage", "intrinsic", "--intrinsic-steps", "2", "--only", "full", "--seeds", "1", "--force", "--start"];
        let table = ablate(&place, &[&some[..], &[&file]].concat()).ok().stdout;
        assert!(table.contains(&format!("after 2 of materials on {file}, on ")), "{table}");
        assert!(geometry(&place, "table/full_seed5").means == geometry(&place, run).means);
        let table = json(&place, "table/ablation.json");
        assert_eq!((table["start"].as_str(), &table["steps"]), (Some(file.as_str()), &Value::Null));
    };
    on("a");
    let first = written(&place, "table/full_seed5/scene.ply");
    on("a");
    assert!(written(&place, "table/full_seed5/scene.ply") == first, "it was trained twice");
    // Other geometry retrains the materials.
    on("b");
    assert!(!place.path("table/geometry_seed5").exists());
}

#[test]
fn ablation_of_both_stages_resumes() {
    let place = room();
    let more = ["--stage", "all", "--intrinsic-steps", "40", "--only", "rgb,no_visibility", "--seeds", "1"];
    let more = [&more[..], &["--set", "train.checkpoint_interval=4"]].concat();
    let long = arguments(&place, "table", &more);
    let rgb = more.iter().map(|m| if m.starts_with("rgb") { "rgb" } else { m }).collect::<Vec<_>>();
    sgs(&arguments(&place, "table", &rgb)).ok();
    assert_eq!(names(&json(&place, "table/ablation.json")), ["rgb"]);
    let mut child = start(&long);
    let reached =
        until(&mut child, || place.path("table/no_visibility_seed5/checkpoint/intrinsic.safetensors").is_file());
    signal(&child, "INT");
    let stopped = wait(child);
    assert!(reached && stopped.status == Some(130), "{stopped:?}");
    assert!(stopped.stderr.contains("stopped in") && stopped.stderr.contains("no_visibility_seed5"), "{stopped:?}");
    assert_eq!(names(&json(&place, "table/ablation.json")), ["rgb"], "what is done is in the table");
    let formed = written(&place, "table/normal_seed5/scene.ply");
    sgs(&long).ok();
    let table = json(&place, "table/ablation.json");
    assert_eq!(names(&table), ["rgb", "no_visibility"]);
    let timed = [0, 1].map(|i| table["variants"][i]["mean"]["intrinsic_seconds_per_step"].is_f64());
    assert_eq!(timed, [true, false], "what was interrupted has no time of its own");
    // Materials use the geometry variant with the most priors, even if its row was not requested.
    assert!(geometry(&place, "table/no_visibility_seed5").means == geometry(&place, "table/normal_seed5").means);
    assert!(written(&place, "table/normal_seed5/scene.ply") == formed);
    assert!(geometry(&place, "table/rgb_seed5").means != geometry(&place, "table/normal_seed5").means);
    // An uninterrupted run gives the same result.
    let alone = more.iter().map(|m| if m.starts_with("rgb") { "no_visibility" } else { m }).collect::<Vec<_>>();
    sgs(&arguments(&place, "again", &alone)).ok();
    for file in ["scene.ply", "lights.json"] {
        let of = |table: &str| place.read(&format!("{table}/no_visibility_seed5/{file}"));
        assert!(of("table") == of("again"), "{file}");
    }
}

#[test]
fn invalid_material_variants_are_refused() {
    let place = room();
    let intrinsic = |more: &[&str]| ablate(&place, &[&["--stage", "intrinsic"], more].concat());
    intrinsic(&["--only", "rgb"]).refused(&["no variant \"rgb\"", "there are full, gray_start, no_lights"]);
    intrinsic(&["--only", "no_own_prior", "--intrinsic-steps", "20"])
        .refused(&["would differ from no other", "it begins at step 1000 of 20"]);
    intrinsic(&["--only", "no_relight"]).refused(&["would differ from no other", "no provider of materials is asked"]);
    let off = ["--only", "no_lights", "--set", "intrinsic.lights.grid=0"];
    intrinsic(&off).refused(&["\"no_lights\" would differ from no other", "leave it out anyway"]);
    intrinsic(&["--start", "nothing.ply"]).refused(&["no file \"nothing.ply\""]);
    ablate(&place, &["--start", &place.text("scene/x.ply")]).refused(&["--start", "--stage intrinsic"]);
    assert!(!place.path("table").exists(), "a refused table leaves nothing");
    // Without material priors, `no_priors` equals `full`.
    std::fs::remove_dir_all(place.path("scene/priors")).unwrap();
    intrinsic(&["--only", "no_priors"]).refused(&["would differ from no other", "no priors of materials"]);
}
