//! Images of light components and images after edits: effects of edits, and refusals.

use serde_json::json;
use sgs_run::read_lights;
use sgs_scene::{Image, Splats, linear_to_srgb, read_exr, write_exr, write_ids};
use sgs_tests::Place;
use sgs_tests::cli::{Finished, sgs};
use sgs_tests::rooms::Room;

/// Creates a room, and a run of a few steps in `run`.
fn place() -> Place {
    let place = Place::new(Room { priors: true, ..Room::default() });
    let mut a = vec!["train", "", "-o", "", "--geometry-steps", "20", "--no-densify", "--intrinsic-steps", "4"];
    let (scene, run) = (place.text("scene"), place.text("run"));
    (a[1], a[3]) = (&scene, &run);
    a.extend(["--stage", "all"]);
    for set in [
        "transport.surfels=0",
        "intrinsic.environment.resolution=16",
        "intrinsic.lights.grid=2",
        "intrinsic.visibility.levels=4",
        "intrinsic.visibility.log2_table=10",
        "intrinsic.visibility.finest=64",
    ] {
        a.extend(["--set", set]);
    }
    sgs(&a).ok();
    let mut cameras: serde_json::Value = serde_json::from_slice(&place.read("scene/transforms.json")).unwrap();
    cameras["frames"].as_array_mut().unwrap().truncate(1);
    std::fs::write(place.path("cameras.json"), cameras.to_string()).unwrap();
    place
}

/// Runs `sgs relight` with an edit; images go to the directory `into`.
fn relit(place: &Place, edit: serde_json::Value, into: &str, more: &[&str]) -> Finished {
    std::fs::write(place.path("edit.json"), edit.to_string()).unwrap();
    let (run, cameras) = (place.text("run"), place.text("cameras.json"));
    let (file, to) = (place.text("edit.json"), place.text(into));
    let mut a = vec!["relight", &run, "--edit", &file, "--cameras", &cameras, "-o", &to, "--format", "exr"];
    a.extend(more);
    sgs(&a)
}

fn rendered(place: &Place, file: &str) -> Image {
    read_exr(&place.path(file)).unwrap().image
}

/// Returns the largest difference, relative to the largest value of `b`.
fn apart(a: &Image, b: &Image) -> f32 {
    assert_eq!((a.width, a.height, a.channels), (b.width, b.height, b.channels));
    let largest = b.data.iter().fold(1e-6_f32, |m, v| m.max(v.abs()));
    a.data.iter().zip(&b.data).map(|(x, y)| (x - y).abs()).fold(0.0, f32::max) / largest
}

fn sum(images: &[Image]) -> Image {
    let mut all = images[0].clone();
    for image in &images[1..] {
        all.data.iter_mut().zip(&image.data).for_each(|(a, b)| *a += b);
    }
    all
}

#[test]
fn edits_change_only_what_they_name() {
    let place = place();
    let cameras = place.text("cameras.json");
    let render = |more: &[&str]| {
        let (run, to) = (place.text("run"), place.text("all"));
        let mut a = vec!["render", &run, "--cameras", &cameras, "-o", &to, "--format", "exr"];
        a.extend(more);
        sgs(&a)
    };
    render(&["--lights", "--channels", "pbr,direct,env,diffuse,specular,albedo,roughness"]).ok();
    let of = |name: &str| rendered(&place, &format!("all/000_{name}.exr"));
    // Files are named after the requested channels; some channels have two names.
    let files = |requested: &str| render(&["--channels", requested, "--json"]).ok().json()["files"].to_string();
    for (requested, called) in [
        ("rgb,alpha,depth", &["000_rgb.exr", "000_alpha.exr", "000_depth.exr"][..]),
        ("normal", &["000_normal.exr"]),
        ("normals", &["000_normal.exr"]),
        ("metallic", &["metallic"]),
        ("environment", &["000_env.exr"]),
        ("lights", &["000_light_00.exr", "000_light_07.exr"]),
    ] {
        match requested {
            "metallic" => drop(render(&["--channels", requested]).refused(called)),
            _ => assert!(called.iter().all(|c| files(requested).contains(c)), "{requested}"),
        }
    }
    // Shaded images are the sums of their components.
    let lights: Vec<Image> = (0..8).map(|i| of(&format!("light_{i:02}"))).collect();
    assert!(lights.iter().all(|l| l.data.iter().any(|v| *v > 0.0)));
    let direct = of("direct");
    assert!(apart(&sum(&lights), &direct) < 1e-4, "{}", apart(&sum(&lights), &direct));
    assert!(apart(&sum(&lights[1..]), &direct) > 1e-3);
    assert!(apart(&sum(&[of("diffuse"), of("specular")]), &of("pbr")) < 1e-4);
    assert!(of("specular").data.iter().all(|v| *v >= -1e-6) && of("env").data.iter().any(|v| *v > 0.0));
    if place.path("run/visibility.safetensors").is_file() {
        render(&["--channels", "visibility"]).ok();
        assert!(of("visibility").data.iter().all(|v| (0.0..=1.0 + 1e-5).contains(v)));
    } else {
        render(&["--channels", "visibility"]).refused(&["visibility"]);
    }

    // An empty edit changes nothing.
    relit(&place, json!({}), "same", &[]).ok();
    let pbr = of("pbr");
    assert_eq!(rendered(&place, "same/000_relit.exr"), pbr);
    // A light that is off is missing from the sum. A light twice as bright is added once more.
    let edit = |change: serde_json::Value| json!({"lights": {"change": [change]}, "environment": {"off": true}});
    relit(&place, edit(json!({"light": 3, "on": false})), "off", &[]).ok();
    let without = [&lights[..3], &lights[4..]].concat();
    assert!(apart(&rendered(&place, "off/000_relit.exr"), &sum(&without)) < 1e-4);
    relit(&place, edit(json!({"light": 3, "intensity": 2, "color": [1, 0.5, 0.5]})), "color", &[]).ok();
    let colored = rendered(&place, "color/000_relit.exr");
    let red =
        |image: &Image| Image { channels: 1, data: image.data.iter().copied().step_by(3).collect(), ..image.clone() };
    let green = |image: &Image| Image {
        channels: 1,
        data: image.data.iter().copied().skip(1).step_by(3).collect(),
        ..image.clone()
    };
    assert!(apart(&red(&colored), &red(&sum(&[direct.clone(), lights[3].clone()]))) < 1e-4);
    assert!(apart(&green(&colored), &green(&direct)) < 1e-4);
    relit(&place, json!({"lights": {"only": [3]}, "environment": {"off": true}}), "only", &[]).ok();
    assert!(apart(&rendered(&place, "only/000_relit.exr"), &lights[3]) < 1e-4);
    // The same light, added in physical units, gives the same image.
    let file = read_lights(&place.path("run/lights.json")).unwrap();
    let lobes: Vec<serde_json::Value> = file.lights[3]
        .lobes
        .iter()
        .map(|l| json!({"axis": l.axis, "sharpness": l.sharpness, "amplitude": l.amplitude.map(|a| a * file.normalizer)}))
        .collect();
    let add = json!([{"position": file.lights[3].position, "lobes": lobes}]);
    relit(&place, json!({"lights": {"off": true, "add": add}, "environment": {"off": true}}), "added", &[]).ok();
    assert!(apart(&rendered(&place, "added/000_relit.exr"), &lights[3]) < 1e-4);
    // The image is linear in the environment map's scale, and a file replaces the map.
    let env = pbr.data.iter().zip(&direct.data).map(|(a, b)| a - b).collect();
    let env = Image { data: env, ..pbr.clone() };
    relit(&place, json!({"lights": {"off": true}, "environment": {"scale": 3}}), "env", &[]).ok();
    let thrice = Image { data: env.data.iter().map(|v| 3.0 * v).collect(), ..env.clone() };
    assert!(apart(&rendered(&place, "env/000_relit.exr"), &thrice) < 1e-3);
    write_exr(&place.path("dark.exr"), &Image::new(32, 16, 3), &["R", "G", "B"]).unwrap();
    relit(&place, json!({"environment": {"file": "dark.exr"}}), "dark", &[]).ok();
    assert!(apart(&rendered(&place, "dark/000_relit.exr"), &direct) < 1e-4);

    // The edit sets the material of every Gaussian.
    let set = json!({"albedo": [0.2, 0.4, 0.6], "roughness": 0.7, "metallic": 0.5});
    let everywhere = json!({"box": [[-9, -9, -9], [9, 9, 9]]});
    let edit = json!({"materials": [{"where": everywhere, "set": set}]});
    relit(&place, edit, "painted", &["--channels", "albedo,roughness,metallic"]).ok();
    for (name, expected) in [("albedo", vec![0.2, 0.4, 0.6]), ("roughness", vec![0.7]), ("metallic", vec![0.5])] {
        let found = rendered(&place, &format!("painted/000_{name}.exr"));
        let n = expected.len();
        for (p, expected_pixel) in found.data.chunks(n).zip(std::iter::repeat(&expected)) {
            let near = p.iter().zip(expected_pixel).all(|(a, b)| (a - b).abs() < 1e-3);
            assert!(near || p.iter().all(|v| *v == 0.0), "{name}: {p:?}");
        }
    }
    // An object far away changes nothing; an object that fills the view does.
    let insert = |at: f32| json!({"insert": [{"source": "run/scene.ply", "scale": 0.3, "translation": [0, 0, at]}]});
    relit(&place, insert(-500.0), "far", &[]).ok();
    assert!(apart(&rendered(&place, "far/000_relit.exr"), &pbr) < 1e-5);
    relit(&place, insert(0.3), "near", &[]).ok();
    assert!(apart(&rendered(&place, "near/000_relit.exr"), &pbr) > 0.01);

    // A PLY has materials, but no lights.
    let ply = place.text("run/scene.ply");
    let to = place.text("ply");
    let a = ["render", &ply, "--cameras", &cameras, "-o", &to, "--format", "exr", "--channels"];
    sgs(&[&a[..], &["albedo,roughness"]].concat()).ok();
    assert_eq!(rendered(&place, "ply/000_albedo.exr"), of("albedo"));
    sgs(&[&a[..], &["pbr"]].concat()).refused(&["neither lights nor an environment", "pbr"]);
    sgs(&[&a[..], &["albedo"], &["--lights"]].concat()).refused(&["no lights"]);

    // Errors name the invalid item.
    let refusal = |edit: serde_json::Value, words: &[&str]| {
        relit(&place, edit, "refused", &[]).refused(words);
    };
    refusal(json!({"lamps": []}), &["edit.json", "lamps"]);
    refusal(json!({"lights": {"only": [8]}}), &["light 8", "0 to 7"]);
    refusal(json!({"environment": {"file": "missing.exr"}}), &["missing.exr"]);
    let roughness = json!({"roughness": 0.5});
    refusal(json!({"materials": [{"where": {"gaussians": [999_999]}, "set": roughness}]}), &["Gaussian 999999"]);
    refusal(
        json!({"materials": [{"where": {"box": [[50, 50, 50], [51, 51, 51]]}, "set": roughness}]}),
        &["none", "box"],
    );
    refusal(json!({"materials": [{"where": {"class": "sofa"}, "set": roughness}]}), &["class"]);
    let region = json!({"view": "000", "id": 77});
    refusal(json!({"materials": [{"where": {"region": region}, "set": roughness}]}), &["region 77", "000"]);
    refusal(json!({"insert": [{"source": "missing.ply"}]}), &["missing.ply"]);
}

/// Tests that geometry is not trained further once a run has materials.
#[test]
fn geometry_is_not_resumed_under_materials() {
    let place = place();
    let (scene, run) = (place.text("scene"), place.text("run"));
    let painted = place.read("run/scene.ply");
    let words = ["has got to materials", "--stage intrinsic"];
    sgs(&["train", &scene, "-o", &run, "--resume"]).refused(&words);
    sgs(&["train", &scene, "-o", &run, "--resume", "--stage", "all"]).ok();
    assert!(place.read("run/scene.ply") == painted);
    // The splats alone show that they have materials.
    std::fs::remove_file(place.path("run/checkpoint/intrinsic.safetensors")).unwrap();
    sgs(&["train", &scene, "-o", &run, "--resume", "--stage", "geometry"]).refused(&words);
    assert!(place.read("run/scene.ply") == painted);
}

/// Tests metrics of edits that change the materials of an instance. They are measured under the learned light, and
/// under the true light if it is known.
#[test]
fn material_edits_of_an_instance_are_measured() {
    let place = place();
    let run = place.text("run");
    let (train, test) = Room::default().split();
    std::fs::create_dir_all(place.path("scene/priors/masks")).unwrap();
    for stem in &train {
        let ids = vec![5; 32 * 24];
        write_ids(&place.path(&format!("scene/priors/masks/{stem}.png")), 32, 24, &ids).unwrap();
    }
    // Ground truth of the edit in the first test view: every Gaussian is painted with slightly different values.
    let mut cameras: serde_json::Value = serde_json::from_slice(&place.read("scene/transforms.json")).unwrap();
    let stem = |frame: &serde_json::Value| frame["file_path"].as_str().unwrap().contains(&test[0]);
    cameras["frames"].as_array_mut().unwrap().retain(stem);
    std::fs::write(place.path("cameras.json"), cameras.to_string()).unwrap();
    let everywhere = json!({"box": [[-9, -9, -9], [9, 9, 9]]});
    let set = json!({"albedo": [0.7, 0.055, 0.02], "roughness": 0.4});
    let (file, to) = (format!("truth/{}_relit.exr", test[0]), place.path("scene/gt/relit/chair"));
    relit(&place, json!({"materials": [{"where": everywhere, "set": set}]}), "truth", &[]).ok();
    std::fs::create_dir_all(&to).unwrap();
    std::fs::copy(place.path(&file), to.join(format!("{}.exr", test[0]))).unwrap();
    let measured = |id: u16| {
        let painted = json!({"instance_id": id, "new_base_color_linear": [0.7, 0.05, 0.02], "new_roughness": 0.4,
            "new_metallic": 0.0});
        std::fs::write(place.path("scene/gt/relit/chair.json"), painted.to_string()).unwrap();
        sgs(&["eval", &run, "--json"]).ok().json()["mean"]["relit"].clone()
    };
    let found = measured(5);
    assert!(found["chair_learned_light"]["psnr"].as_f64().unwrap() > 30.0, "{found}");
    assert!(found["chair"]["reason"].as_str().unwrap().contains("training images"), "{found}");
    let light = json!({"on": true, "position": [0, 0, 0], "point_light_intensity_equivalent": [1, 1, 1]});
    std::fs::write(place.path("scene/gt/lights.json"), json!({"training": [light]}).to_string()).unwrap();
    let found = measured(5);
    let psnr = |name: &str| found[name]["psnr"].as_f64().unwrap();
    assert!(psnr("chair_learned_light") > 30.0 && psnr("chair") < 30.0, "{found}");
    let found = measured(6);
    assert_eq!(found, json!({"chair": {"reason": "No Gaussian belongs to instance 6 of priors/masks."}}));
    std::fs::write(place.path("scene/gt/relit/chair.json"), "{").unwrap();
    sgs(&["eval", &run]).refused(&["chair.json"]);
}

/// Tests that a relit scene is baked to spherical harmonics. Geometry stays the same, and colors reproduce the relit
/// images.
#[test]
fn baked_scene_matches_relit_images() {
    let place = place();
    let (run, cameras, to) = (place.text("run"), place.text("cameras.json"), place.text("images"));
    // The light is bright and red, unlike the photographs.
    let lights = json!({"change": [{"light": 3, "intensity": 3, "color": [1, 0.2, 0.1]}]});
    std::fs::write(place.path("edit.json"), json!({"lights": lights, "environment": {"scale": 0.2}}).to_string())
        .unwrap();
    let edit = place.text("edit.json");
    let bake = |file: &str, more: &[&str]| {
        let file = place.text(file);
        let a = ["relight", &run, "--edit", &edit, "--bake", &file, "--json"];
        sgs(&[&a[..], more].concat())
    };
    let output = bake("baked.ply", &["--cameras", &cameras, "-o", &to, "--format", "exr"]).ok().json();
    let psnr = |output: &serde_json::Value, key: &str| output["bake"][key].as_f64().unwrap();
    assert!(place.path("images/000_relit.exr").is_file() && output["bake"]["views"] == 18, "{output}");
    // Colors trained on the relit images match these better than colors from the Gaussians alone.
    let alone = bake("alone.ply", &["--bake-steps", "0"]).ok().json();
    println!("{output}, {alone}");
    assert!(psnr(&output, "psnr") > 30.0 && psnr(&output, "psnr_cameras") > 30.0, "{output}");
    assert!(psnr(&output, "psnr") > psnr(&alone, "psnr") + 2.0, "{output} {alone}");
    // Geometry stays the same bit for bit, and materials are removed.
    let read = |file: &str| Splats::read_ply(&place.path(file)).unwrap();
    let (before, after) = (read("run/scene.ply"), read("baked.ply"));
    assert!(before.means == after.means && before.rotations == after.rotations && before.normals == after.normals);
    assert!(before.log_scales == after.log_scales && before.opacity_logits == after.opacity_logits);
    assert!(after.albedo.is_none() && after.roughness.is_none() && after.sh_degree() == before.sh_degree());
    assert!(after.sh[0] != before.sh[0] && after.sh[1].iter().any(|v| *v != 0.0));
    // `sgs render` shows the colors at the reported PSNR.
    sgs(&["render", &place.text("baked.ply"), "--cameras", &cameras, "-o", &to, "--format", "exr"]).ok();
    let (ours, theirs) = (rendered(&place, "images/000_rgb.exr"), rendered(&place, "images/000_relit.exr"));
    let displayed = theirs.data.iter().map(|v| linear_to_srgb(v.clamp(0.0, 1.0)));
    let square: f64 = ours.data.iter().zip(displayed).map(|(a, b)| f64::from(a.clamp(0.0, 1.0) - b).powi(2)).sum();
    let displayed = -10.0 * (square / ours.data.len() as f64).log10();
    assert!((displayed - psnr(&output, "psnr_cameras")).abs() < 0.5, "{displayed}: {output}");
    // A second bake gives the same file. `--bake-degree` sets the number of bands.
    bake("again.ply", &[]).ok();
    assert!(place.read("again.ply") == place.read("baked.ply"));
    bake("flat.ply", &["--bake-degree", "0", "--bake-steps", "30"]).ok();
    assert_eq!(read("flat.ply").sh_degree(), 0);
    // A PLY has no training views.
    let ply = place.text("run/scene.ply");
    let (out, short) = (place.text("other.ply"), ["--bake-steps", "3"]);
    sgs(&["relight", &ply, "--bake", &out]).refused(&["no training views", "--cameras"]);
    let dark =
        sgs(&[&["relight", &ply, "--bake", &out, "--cameras", &cameras, "--json"], &short[..]].concat()).ok().json();
    assert_eq!(dark["bake"]["views"], 1);
    bake("baked.txt", &[]).refused(&["baked.txt", ".ply"]);
    bake("missing/baked.ply", &[]).refused(&["missing", "no directory"]);
    assert_eq!(sgs(&["relight", &run]).status, Some(2));
}
