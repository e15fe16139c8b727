//! Errors of `sgs`: one clear sentence and an exit status, never a panic.

use glam::DVec3;
use serde_json::json;
use sgs_scene::{Image, Splats, write_exr, write_png};
use sgs_tests::cli::{Finished, sgs, sgs_with, sgs_with_closed_stdout};
use sgs_tests::rooms::{Room, transforms, write_json};
use std::path::Path;

/// Folder with a room in `scene`, and helpers to run the program on it.
struct Place(sgs_tests::Place);

impl std::ops::Deref for Place {
    type Target = sgs_tests::Place;

    fn deref(&self) -> &sgs_tests::Place {
        &self.0
    }
}

impl Place {
    fn new(room: Room) -> Place {
        Place(sgs_tests::Place::new(room))
    }

    fn train(&self, more: &[&str]) -> Finished {
        let (scene, run) = (self.text("scene"), self.text("run"));
        let mut arguments = vec!["train", &scene, "-o", &run, "--geometry-steps", "2"];
        arguments.extend(more);
        if !more.contains(&"--resume") {
            arguments.push("--force");
        }
        sgs(&arguments)
    }

    /// Writes three splats to `a.ply`, whose bytes the caller may damage.
    fn ply(&self, change: impl FnOnce(&mut Vec<u8>)) -> String {
        let splats = Splats {
            means: vec![[0.0, 0.0, 2.0], [0.1, 0.0, 2.0], [0.0, 0.2, 2.5]],
            log_scales: vec![[-2.0; 3]; 3],
            rotations: vec![[1.0, 0.0, 0.0, 0.0]; 3],
            opacity_logits: vec![0.0; 3],
            sh: [vec![0.5; 9], Vec::new(), Vec::new(), Vec::new()],
            ..Default::default()
        };
        splats.write_ply(&self.path("a.ply")).unwrap();
        let mut bytes = std::fs::read(self.path("a.ply")).unwrap();
        change(&mut bytes);
        std::fs::write(self.path("a.ply"), bytes).unwrap();
        self.text("a.ply")
    }

    fn render(&self, source: &str, more: &[&str]) -> Finished {
        let (cameras, out) = (self.text("scene/transforms.json"), self.text("out"));
        let mut arguments = vec!["render", source, "--cameras", &cameras, "-o", &out];
        arguments.extend(more);
        sgs(&arguments)
    }
}

fn rename(bytes: &mut Vec<u8>, from: &str, to: &str) {
    let at = bytes.windows(from.len()).position(|w| w == from.as_bytes()).unwrap();
    bytes.splice(at..at + from.len(), to.bytes());
}

#[test]
fn scenes_that_cannot_be_trained_on_are_refused() {
    let place = Place::new(Room::default());
    let none = place.text("none");
    sgs(&["train", &none, "-o", &place.text("run")]).refused(&[&none, "does not exist"]);
    std::fs::create_dir(place.path("empty")).unwrap();
    sgs(&["train", &place.text("empty"), "-o", &place.text("run")]).refused(&["holds no scene", "transforms.json"]);
    sgs(&["plan", &none]).refused(&["does not exist"]);
    assert!(!place.path("run").exists(), "a refused scene leaves no run");

    // Camera whose size differs from that of its image.
    let scene = place.path("scene");
    let other = Image::new(31, 24, 3);
    let image = scene.join("images/002.png");
    let original = std::fs::read(&image).unwrap();
    write_png(&image, &other).unwrap();
    place.train(&[]).refused(&["002.png", "31×24", "32×24"]);

    // Image with a valid header and truncated pixels.
    std::fs::write(&image, &original[..original.len() / 2]).unwrap();
    place.train(&[]).refused(&["002.png", "cannot be read as PNG"]);
    std::fs::write(&image, &original).unwrap();

    // Pose with a number that is valid JSON but not a valid position.
    let text = std::fs::read_to_string(scene.join("transforms.json")).unwrap();
    let mut value: serde_json::Value = serde_json::from_str(&text).unwrap();
    value["frames"][3]["transform_matrix"][0][3] = json!(1e300);
    write_json(&scene.join("transforms.json"), &value);
    place.train(&[]).refused(&["transforms.json", "frame 3"]);
    std::fs::write(scene.join("transforms.json"), text.replacen("[[", "[[NaN,", 1)).unwrap();
    place.train(&[]).refused(&["transforms.json", "line 1"]);
    value["frames"][3]["transform_matrix"][0] = json!([0.0, 0.0, 0.0, 0.0]);
    write_json(&scene.join("transforms.json"), &value);
    place.train(&[]).refused(&["transforms.json", "frame 3", "rigid"]);
    std::fs::write(scene.join("transforms.json"), &text).unwrap();

    // No training view remains, by the split and by the default.
    let split = std::fs::read(scene.join("split.json")).unwrap();
    write_json(&scene.join("split.json"), &json!({"train": [], "test": ["000"]}));
    place.train(&[]).refused(&["no training view"]);
    write_json(&scene.join("split.json"), &json!({"train": ["000", "nobody"]}));
    place.train(&[]).refused(&["nobody"]);
    std::fs::remove_file(scene.join("split.json")).unwrap();
    let mut one: serde_json::Value = serde_json::from_str(&text).unwrap();
    one["frames"].as_array_mut().unwrap().truncate(1);
    write_json(&scene.join("transforms.json"), &one);
    place.train(&[]).refused(&["no training view is left", "every 8th"]);
    std::fs::write(scene.join("split.json"), split).unwrap();
    std::fs::write(scene.join("transforms.json"), &text).unwrap();
    place.train(&["--views", "0"]).refused(&["at least one training view"]);
    place.train(&["--scale", "1.5"]).refused(&["scale", "1.5"]);

    // Damaged point clouds.
    let points = std::fs::read_to_string(scene.join("points.ply")).unwrap();
    std::fs::write(scene.join("points.ply"), &points[..points.len() - 40]).unwrap();
    place.train(&[]).refused(&["points.ply", "vertex"]);
    std::fs::write(scene.join("points.ply"), points.replace("property float y\n", "property float q\n")).unwrap();
    place.train(&[]).refused(&["points.ply", "no property \"y\""]);
    std::fs::write(scene.join("points.ply"), &points).unwrap();

    // No frame has its image.
    std::fs::remove_dir_all(scene.join("images")).unwrap();
    place.train(&[]).refused(&["none of the 8 frames has its image", "000.png"]);
    assert!(!place.path("run").exists(), "refused images and points leave no run");
}

#[test]
fn damaged_linear_images_are_refused() {
    let place = Place::new(Room::default());
    let scene = place.path("scene");
    let mut value = transforms(&Room::default().cameras());
    value["frames"][2]["file_path"] = json!("images/002.exr");
    write_json(&scene.join("transforms.json"), &value);
    let path = scene.join("images/002.exr");
    let mut image = Image::new(32, 24, 3);
    image.data.iter_mut().enumerate().for_each(|(i, v)| *v = (i % 17) as f32 / 9.0);
    write_exr(&path, &image, &["R", "G", "B"]).unwrap();
    place.train(&[]).ok();
    let whole = std::fs::read(&path).unwrap();
    std::fs::write(&path, &whole[..whole.len() * 2 / 3]).unwrap();
    place.train(&[]).refused(&["002.exr", "cannot be read as EXR"]);
    std::fs::write(&path, b"not an image").unwrap();
    place.train(&[]).refused(&["002.exr", "cannot be read as EXR"]);
    image.data[100] = f32::NAN;
    write_exr(&path, &image, &["R", "G", "B"]).unwrap();
    place.train(&[]).refused(&["002.exr", "not"]);
}

#[test]
fn invalid_settings_are_refused() {
    let place = Place::new(Room::default());
    let set = |pair: &str| place.train(&["--set", pair]);
    set("geometry.rates.mean=0.1").refused(&["geometry.rates.mean", "did you mean \"geometry.rates.means\"?"]);
    set("stepz=3").refused(&["\"stepz\" is not a setting", "geometry.steps"]);
    set("geometry.steps=many").refused(&["geometry.steps is \"many\"", "whole number"]);
    set("geometry.steps=-3").refused(&["geometry.steps is -3"]);
    set("geometry.normals=perhaps").refused(&["geometry.normals", "true or false"]);
    set("geometry.background=[0,1]").refused(&["geometry.background", "3 numbers"]);
    set("geometry.losses.dssim=nan").refused(&["geometry.losses.dssim is NaN"]);
    set("geometry.rates.means=[-1,0]").refused(&["geometry.rates.means is -1"]);
    set("geometry.sh_degree=4").refused(&["geometry.sh_degree is 4", "0 to 3"]);
    set("geometry.densify.interval=0").refused(&["geometry.densify.interval is 0"]);
    set("geometry.densify.until=1.5").refused(&["geometry.densify.until is 1.5"]);
    set("geometry.steps.more=3").refused(&["geometry.steps"]);
    set("exposure=-1").refused(&["exposure is -1"]);
    set("exposure=nan").refused(&["exposure is NaN"]);
    set("nothing").refused(&["KEY=VALUE"]);
    set("=3").refused(&["no key"]);
    place.train(&["--seed", "18446744073709551615"]).refused(&["seed is 18446744073709551615"]);

    let config = place.text("config.toml");
    let with = |text: &str| {
        std::fs::write(&config, text).unwrap();
        place.train(&["--config", &config])
    };
    with("[geometry]\nstep = 3\n").refused(&["geometry.step", "did you mean \"geometry.steps\"?"]);
    with("[geometry\n").refused(&[&config]);
    with("seed = \"seven\"\n").refused(&["seed is \"seven\"", "whole number"]);
    place.train(&["--config", &place.text("none.toml")]).refused(&["none.toml"]);
    assert!(!place.path("run").exists(), "refused settings leave no run");
}

#[test]
fn ply_files_that_are_no_splats_are_refused() {
    let place = Place::new(Room::default());
    let whole = place.ply(|_| {});
    place.render(&whole, &[]).ok();
    let cut = place.ply(|b| b.truncate(b.len() - 7));
    place.render(&cut, &[]).refused(&["a.ply", "promises 3 vertices"]);
    for name in ["opacity", "rot_2", "f_dc_1", "scale_0"] {
        let lacking = place.ply(|b| rename(b, &format!("property float {name}\n"), "property float other\n"));
        place.render(&lacking, &[]).refused(&["a.ply", &format!("no property \"{name}\"")]);
    }
    let nan = place.ply(|b| {
        let end = b.len();
        b[end - 4..].copy_from_slice(&f32::NAN.to_le_bytes());
    });
    place.render(&nan, &[]).refused(&["a.ply", "vertex 2", "rot_3"]);
    let text = place.ply(|b| *b = b"solid".to_vec());
    place.render(&text, &[]).refused(&["a.ply", "ply"]);
    place.render(&place.text("none.ply"), &[]).refused(&["none.ply", "does not exist"]);
    place.render(&place.text("scene"), &[]).refused(&["is not a run directory"]);
}

#[test]
fn ply_without_splats_renders_empty_image() {
    let place = Place::new(Room::default());
    Splats { sh: [Vec::new(), Vec::new(), Vec::new(), Vec::new()], ..Default::default() }
        .write_ply(&place.path("b.ply"))
        .unwrap();
    let finished = place
        .render(&place.text("b.ply"), &["--format", "exr", "--background", "0.25,0.5,4", "--channels", "rgb,alpha"]);
    finished.ok();
    let rgb = sgs_scene::read_exr(&place.path("out/000_rgb.exr")).unwrap().image;
    assert!(rgb.data.chunks_exact(3).all(|p| p == [0.25, 0.5, 4.0]), "{:?}", &rgb.data[..3]);
    let alpha = sgs_scene::read_exr(&place.path("out/000_alpha.exr")).unwrap().image;
    assert!(alpha.data.iter().all(|v| *v == 0.0));
}

#[test]
fn invalid_renders_are_refused() {
    let place = Place::new(Room::default());
    let ply = place.ply(|_| {});
    place.render(&ply, &["--background", "1,2"]).refused(&["--background", "three numbers"]);
    place.render(&ply, &["--background", "1,2,3,4"]).refused(&["--background", "three numbers"]);
    place.render(&ply, &["--background", "1,nan,0"]).refused(&["--background", "finite"]);
    place.render(&ply, &["--channels", "rgb,normal"]).refused(&["holds no normals", "--channels"]);
    let cameras = place.path("scene/transforms.json");
    let text = std::fs::read_to_string(&cameras).unwrap();
    write_json(&cameras, &json!({"frames": []}));
    place.render(&ply, &[]).refused(&["transforms.json", "empty"]);
    write_json(&cameras, &json!({"w": 3}));
    place.render(&ply, &[]).refused(&["transforms.json", "frames"]);
    let mut value: serde_json::Value = serde_json::from_str(&text).unwrap();
    value["frames"][1]["fl_x"] = json!(-5.0);
    write_json(&cameras, &value);
    place.render(&ply, &[]).refused(&["frame 1", "focal"]);
    let mut value: serde_json::Value = serde_json::from_str(&text).unwrap();
    value["frames"][1]["file_path"] = value["frames"][0]["file_path"].clone();
    write_json(&cameras, &value);
    place.render(&ply, &[]).refused(&["\"000\" was used before"]);
    std::fs::remove_file(&cameras).unwrap();
    place.render(&ply, &[]).refused(&["transforms.json"]);
    std::fs::write(&cameras, text).unwrap();

    let (out, run) = (place.text("out.ksplat"), place.text("scene"));
    sgs(&["export", &ply, "-o", &out]).refused(&["out.ksplat", ".ply"]);
    sgs(&["export", &run, "-o", &place.text("b.ply")]).refused(&["not a run directory"]);
    sgs(&["export", &ply, "-o", &place.text("none/b.ply")]).refused(&["none/b.ply"]);
    std::fs::write(place.path("out_is_a_file"), "").unwrap();
    let file = place.text("out_is_a_file");
    sgs(&["render", &ply, "--cameras", &place.text("scene/transforms.json"), "-o", &file]).refused(&["out_is_a_file"]);
    sgs(&["eval", &place.text("scene")]).refused(&["not a run directory"]);
    sgs(&["synth", &place.text("s"), "--scene", "castle"]).refused(&["castle", "livingroom"]);
}

#[test]
fn devices_that_do_not_exist_are_refused() {
    let place = Place::new(Room::default());
    let ply = place.ply(|_| {});
    place.render(&ply, &["--device", "no such device"]).refused(&[
        "No Vulkan device matches",
        "no such device",
        "found",
    ]);
    place.train(&["--device", "77"]).refused(&["77"]);
    let listed = sgs(&["devices", "--json"]).ok().json();
    assert!(!listed.as_array().unwrap().is_empty());
    for device in listed.as_array().unwrap() {
        assert!(device["name"].is_string() && device["missing"].is_array());
    }
}

#[test]
fn devices_are_selected_by_uuid_and_by_the_variables_of_a_scheduler() {
    let place = Place::new(Room::default());
    let ply = place.ply(|_| {});
    let listed = sgs(&["devices", "--json"]).ok().json();
    let chosen: Vec<_> = listed.as_array().unwrap().iter().filter(|d| d["auto"].is_string()).collect();
    assert_eq!(chosen.len(), 1, "{listed}");
    let uuid = chosen[0]["uuid"].as_str().unwrap();
    assert!(uuid.len() == 36 && uuid.matches('-').count() == 4, "{uuid}");
    for device in [format!("uuid:{uuid}"), format!("uuid:{}", uuid.replace('-', "").to_uppercase()), "auto".to_owned()]
    {
        place.render(&ply, &["--device", &device, "--force"]).ok();
    }
    place
        .render(&ply, &["--device", "uuid:ffff", "--force"])
        .refused_with(2, &["No Vulkan device matches", "uuid:ffff"]);
    place.render(&ply, &["--device", "pci:ff:1f.7", "--force"]).refused_with(2, &["pci:ff:1f.7"]);
    // No device of these tests is NVIDIA's or AMD's, so their variables mean nothing.
    if listed.as_array().unwrap().iter().all(|d| d["kind"] == "cpu") {
        let hidden = [("CUDA_VISIBLE_DEVICES", "7"), ("ROCR_VISIBLE_DEVICES", ""), ("SLURM_JOB_GPUS", "3")];
        assert_eq!(sgs_with(&["devices", "--json"], &hidden).ok().json(), listed);
    }
}

#[test]
fn doctor_shows_driver_files_and_what_is_wrong_with_them() {
    let place = Place::new(Room::default());
    let report = sgs(&["devices", "--doctor", "--json"]).ok().json();
    let drivers = report["drivers"].as_array().unwrap();
    assert!(drivers.iter().any(|d| d["problem"].is_null() && d["library"].is_string()), "{report}");
    assert!(report["devices"].as_array().unwrap().iter().any(|d| d["missing"].as_array().unwrap().is_empty()));
    let text = sgs(&["devices", "--doctor"]).ok().stdout;
    assert!(
        text.contains("Vulkan loader: opened") && text.contains("   accepted") && text.contains("   can run"),
        "{text}"
    );
    // A driver whose library is missing, and no other.
    let file = place.text("broken.json");
    std::fs::write(&file, r#"{"ICD": {"library_path": "./missing.so", "api_version": "1.3.0"}}"#).unwrap();
    let broken = sgs_with(&["devices", "--doctor"], &[("VK_DRIVER_FILES", &file), ("VK_ICD_FILENAMES", &file)]);
    assert_eq!(broken.status, Some(1), "{broken:?}");
    for word in ["rejected: its library cannot be loaded", "missing.so", "variable VK_DRIVER_FILES", "advice: "] {
        assert!(broken.stdout.contains(word), "{word}: {broken:?}");
    }
    assert!(broken.stderr.contains("no device can run SGS"), "{broken:?}");
    broken.assert_no_panic();
}

#[test]
fn wrong_usage_exits_with_2() {
    for arguments in [
        &["frobnicate"][..],
        &["train"],
        &["train", "scene"],
        &["train", "scene", "-o", "run", "--geometry-steps", "x"],
        &["train", "scene", "-o", "run", "--stage", "nonsense"],
        &["render", "a.ply", "--cameras", "c"],
        &["render", "a.ply", "--cameras", "c", "-o", "out", "--channels", "smell"],
        &["render", "a.ply", "--cameras", "c", "-o", "out", "--background", "red"],
        &["synth", "out", "--size", "big"],
    ] {
        let finished = sgs(arguments);
        assert_eq!(finished.status, Some(2), "{finished:?}");
        assert_eq!(finished.stdout, "");
        assert!(!finished.stderr.is_empty());
        finished.assert_no_panic();
    }
    for arguments in [&["--help"][..], &["--version"], &["train", "--help"]] {
        assert!(!sgs(arguments).ok().stdout.is_empty());
    }
}

/// Closes the pipe early, as in `sgs devices | head`.
#[test]
fn closed_pipe_exits_silently() {
    let finished = sgs_with_closed_stdout(&["devices"]);
    assert_eq!((finished.status, finished.stderr.as_str()), (Some(141), ""));
    finished.assert_no_panic();
}

/// `--json` writes the result of a command as one JSON value.
///
/// The value goes to standard output or to the named file.
#[test]
fn json_is_valid_and_complete() {
    let place = Place::new(Room { priors: true, truth: true, ..Room::default() });
    let (scene, run) = (place.text("scene"), place.text("run"));
    let plan = sgs(&["plan", &scene, "--json"]).ok().json();
    assert_eq!(plan["views"], 6);
    assert!(plan["gaussians"].as_u64().unwrap() > 100 && plan["passes"].as_u64().unwrap() > 10, "{plan}");
    let trained = place.train(&["--json"]).ok().json();
    assert_eq!(trained["steps"], 2);
    // Times differ between evaluations.
    let timeless = |mut metrics: serde_json::Value| {
        metrics["mean"].as_object_mut().unwrap().remove("fps");
        metrics
    };
    let eval = timeless(sgs(&["--json", "eval", &run]).ok().json());
    assert_eq!(eval["views"].as_array().unwrap().len(), 2);
    // `--json FILE`, as documented, and with an equals sign.
    for (name, joined) in [("m.json", false), ("n.json", true)] {
        let file = place.text(name);
        let option = if joined { vec![format!("--json={file}")] } else { vec!["--json".to_owned(), file.clone()] };
        let mut arguments = vec!["eval".to_owned(), run.clone()];
        arguments.extend(option);
        assert!(sgs(&arguments).ok().stdout.contains("PSNR"), "the table is for people");
        let written: serde_json::Value = serde_json::from_str(&std::fs::read_to_string(&file).unwrap()).unwrap();
        assert_eq!(timeless(written), eval);
    }
    let exported = sgs(&["export", &run, "-o", &place.text("b.ply"), "--json"]).ok().json();
    assert_eq!(exported["gaussians"], trained["gaussians"]);
    let rendered = place.render(&run, &["--json", "--channels", "rgb,depth,normal"]).ok().json();
    let files = rendered["files"].as_array().unwrap();
    assert_eq!(files.len(), 3 * 8);
    assert!(files.iter().all(|f| Path::new(f.as_str().unwrap()).is_file()));
}

/// An exported run renders bit-identically to the run.
#[test]
fn an_export_renders_as_the_run_does() {
    let place = Place::new(Room::default());
    place.train(&[]).ok();
    let run = place.text("run");
    sgs(&["export", &run, "-o", &place.text("b.ply")]).ok();
    let rgb = |source: &str| {
        place.render(source, &["--format", "exr"]).ok();
        std::fs::read(place.path("out/003_rgb.exr")).unwrap()
    };
    let (a, b) = (rgb(&run), rgb(&place.text("b.ply")));
    assert!(a == b, "the images differ");
    let image = sgs_scene::read_exr(&place.path("out/003_rgb.exr")).unwrap().image;
    let mean: DVec3 = image.data.chunks_exact(3).map(|p| DVec3::new(p[0].into(), p[1].into(), p[2].into())).sum();
    assert!(mean.length() > 1.0, "the image is black");
}

/// A run resumes with the settings file that it was started with.
///
/// Settings that the file leaves automatic do not conflict with the selected values.
#[test]
fn run_resumes_with_its_settings_file() {
    let place = Place::new(Room::default());
    let file = place.text("settings.toml");
    std::fs::write(&file, "seed = 3\n").unwrap();
    place.train(&["--config", &file]).ok();
    place.train(&["--config", &file, "--resume"]).ok();
    std::fs::write(&file, "seed = 4\n").unwrap();
    place.train(&["--config", &file, "--resume"]).refused(&["seed = 3", "not 4"]);
}

#[test]
fn a_plan_is_written_in_every_format() {
    let place = Place::new(Room::default());
    let scene = place.text("scene");
    let plain = sgs(&["plan", &scene]).ok();
    let text = sgs(&["plan", &scene, "--graph"]).ok();
    assert!(text.stdout.starts_with(plain.stdout.trim_end()), "{}", text.stdout);
    assert!(text.stdout.contains("\nplan geometry_step "), "{}", text.stdout);
    assert_eq!(sgs(&["plan", &scene, "--graph", "json"]).ok().json()["name"], "geometry_step");
    let page = sgs(&["plan", &scene, "--graph", "html"]).ok().stdout;
    assert!(page.starts_with("<!DOCTYPE html>") && page.trim_end().ends_with("</html>"));
    for (file, begins) in [("a.dot", "digraph"), ("a.html", "<!DOCTYPE html>"), ("a.json", "{"), ("a.txt", "plan ")] {
        let path = place.text(file);
        let output = sgs(&["plan", &scene, "-o", &path]).ok().stdout;
        assert!(output.contains(&path), "{output}");
        assert!(std::fs::read_to_string(&path).unwrap().starts_with(begins), "{file}");
    }
    // The requested format overrides that of the file name.
    let path = place.text("b.html");
    sgs(&["plan", &scene, "--graph", "dot", "-o", &path]).ok();
    assert!(std::fs::read_to_string(&path).unwrap().starts_with("digraph"));
    sgs(&["plan", &scene, "-o", &place.text("a.xyz")]).refused(&["a.xyz", "--graph"]);
    assert_eq!(sgs(&["plan", &scene, "--graph", "pdf"]).status, Some(2));
}
