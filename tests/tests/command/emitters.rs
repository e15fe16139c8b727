//! Emitters of a run in `sgs render`: images under all of them, and layers of one each. Also their lights in glTF files.

use exr::prelude::{ReadChannels, ReadLayers, read};
use serde_json::json;
use sgs_passes::transport::LightShape;
use sgs_run::{EmitterRow, LightList, ListedLight, read_emitters, read_exchange, write_emitters, write_exchange};
use sgs_scene::{Splats, read_exr};
use sgs_tests::cli::sgs;
use sgs_tests::emitting::{EMITTERS, fabricate_emitting};
use std::path::Path;

/// Returns names and linear values of the layers of an EXR file.
fn layers(path: &Path) -> Vec<(String, Vec<[f32; 3]>)> {
    let all = read().no_deep_data().largest_resolution_level().all_channels().all_layers().all_attributes();
    let file = all.from_file(path).unwrap();
    let of = |layer: &exr::image::Layer<_>| {
        let channels: &exr::image::AnyChannels<exr::image::FlatSamples> = &layer.channel_data;
        // In alphabetical order: B, G, R.
        let values: Vec<Vec<f32>> = channels.list.iter().map(|c| c.sample_data.values_as_f32().collect()).collect();
        assert_eq!(values.len(), 3);
        let pixels = (0..values[0].len()).map(|i| [values[2][i], values[1][i], values[0][i]]);
        (layer.attributes.layer_name.as_ref().unwrap().to_string(), pixels.collect())
    };
    file.layer_data.iter().map(of).collect()
}

#[test]
fn layers_of_emitters_add_up_to_the_image() {
    let folder = tempfile::tempdir().unwrap();
    fabricate_emitting(folder.path());
    let text = |name: &str| folder.path().join(name).display().to_string();
    let (run, out) = (text("run"), text("out"));
    sgs(&["render", &run, "-o", &out, "--channels", "pbr,albedo", "--lights", "--format", "exr"]).ok();
    let mut files: Vec<_> = std::fs::read_dir(&out).unwrap().map(|f| f.unwrap().path()).collect();
    files.sort();
    assert_eq!(files.len(), 6, "{files:?}");
    for stem in ["001", "005"] {
        let at = |name: &str| Path::new(&out).join(format!("{stem}_{name}.exr"));
        let (all, parts) = (read_exr(&at("pbr")).unwrap().image, layers(&at("lights")));
        let names: Vec<&str> = parts.iter().map(|(name, _)| name.as_str()).collect();
        assert_eq!(names, EMITTERS);
        let lit = |i: usize| parts[i].1.iter().flatten().any(|v| *v > 0.01);
        // The last emitter is off.
        assert_eq!([lit(0), lit(1), lit(2)], [true, true, false]);
        let largest = all.data.iter().copied().fold(0.0, f32::max);
        for (i, pixel) in all.data.chunks(3).enumerate() {
            for c in 0..3 {
                let sum: f32 = parts.iter().map(|(_, values)| values[i][c]).sum();
                assert!((pixel[c] - sum).abs() <= 1e-6 * largest + 1e-5 * pixel[c], "{} {sum}", pixel[c]);
            }
        }
    }
    // PNG files are for the other channels.
    sgs(&["render", &run, "-o", &out, "--channels", "lights", "--force"]).ok();
    assert!(Path::new(&out).join("001_lights.exr").is_file());
}

#[test]
fn what_emitters_cannot_show_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    fabricate_emitting(folder.path());
    let text = |name: &str| folder.path().join(name).display().to_string();
    let (run, out) = (text("run"), text("out"));
    let render = |more: &[&str]| sgs(&[&["render", &run, "-o", &out][..], more].concat());
    render(&["--channels", "visibility"]).refused_with(2, &["lit by emitters", "leave \"visibility\" out"]);
    let emitters = folder.path().join("run/emitters.json");
    let file = std::fs::read_to_string(&emitters).unwrap();
    std::fs::write(&emitters, file.replace("light 2", "燈")).unwrap();
    render(&["--lights"]).refused_with(2, &["The emitter \"燈\" cannot name a layer", "rename it"]);
    std::fs::write(&emitters, "{}").unwrap();
    render(&["--lights"]).refused(&["emitters.json"]);
    // Without emitters and lights.
    std::fs::remove_file(&emitters).unwrap();
    render(&["--lights"]).refused_with(2, &["has no lights; leave out --lights"]);
    std::fs::write(&emitters, file).unwrap();
    std::fs::rename(folder.path().join("scene"), folder.path().join("moved")).unwrap();
    render(&["--channels", "pbr"]).refused(&["scene", "--scene"]);
    assert!(!Path::new(&out).exists());
    render(&["--channels", "pbr", "--scene", &text("moved")]).ok();
}

#[test]
fn report_shows_each_emitter_alone_and_switched_off() {
    let folder = tempfile::tempdir().unwrap();
    fabricate_emitting(folder.path());
    let text = |name: &str| folder.path().join(name).display().to_string();
    let (run, page) = (text("run"), text("page.html"));
    sgs(&["report", &run, "-o", &page, "--views", "1"]).ok();
    let html = std::fs::read_to_string(&page).unwrap();
    assert!(html.contains("id=\"emitters\"") && html.contains("<figcaption>all emitters"));
    for name in EMITTERS {
        for text in [format!("<figcaption>{name} alone"), format!("<figcaption>without {name}")] {
            assert_eq!(html.matches(&text).count(), 1, "{text}");
        }
    }
    assert!(html.contains("<th>light 2 (off)</th><td>point</td><td>0.0 %</td>"));
    std::fs::remove_file(folder.path().join("run/emitters.json")).unwrap();
    sgs(&["report", &run, "-o", &page, "--views", "1"]).ok();
    assert!(!std::fs::read_to_string(&page).unwrap().contains("id=\"emitters\""));
}

/// Returns an emitter that is on.
fn emitter(name: &str, color: [f32; 3], shape: LightShape) -> EmitterRow {
    EmitterRow { name: name.into(), on: true, color, shape }
}

#[test]
fn emitters_are_punctual_lights_of_gltf_and_come_back() {
    let folder = tempfile::tempdir().unwrap();
    fabricate_emitting(folder.path());
    let text = |name: &str| folder.path().join(name).display().to_string();
    let path = folder.path().join("run/emitters.json");
    let mut file = read_emitters(&path).unwrap();
    let (position, axis) = ([0.1, 0.2, 0.3], [1.0, -2.0, 2.0]);
    file.emitters.extend([
        emitter("spot", [4.0, 2.0, 1.0], LightShape::Spot { position, axis, inner_angle: 0.25, outer_angle: 0.5 }),
        emitter("sun", [3.0, 3.0, 6.0], LightShape::Directional { direction: axis, angular_radius: 0.005 }),
        emitter("panel", [1.0; 3], LightShape::Disk { center: position, normal: axis, radius: 0.2 }),
        emitter("lobe", [2.0; 3], LightShape::Lobe { position, axis, sharpness: 4.0 }),
    ]);
    write_emitters(&path, &file).unwrap();
    for name in ["a.glb", "a.gltf"] {
        let answer = sgs(&["export", &text("run"), "-o", &text(name), "--json"]).ok().json();
        let left_out =
            ["emitters of Gaussians", "rectangle \"window 1\"", "point \"light 2\", which is off", "disk \"panel\""];
        assert_eq!((&answer["left_out"], answer["lights"].as_u64()), (&json!(left_out), Some(4)));
        // Another reader.
        let bytes = std::fs::read(folder.path().join(name)).unwrap();
        let gltf = gltf::Gltf::from_slice_without_validation(&bytes).unwrap();
        let nodes: Vec<_> = gltf.nodes().filter(|n| n.light().is_some()).collect();
        let lights: Vec<_> = nodes.iter().map(|n| n.light().unwrap()).collect();
        let names: Vec<_> = lights.iter().map(|l| l.name().unwrap()).collect();
        assert_eq!(names, ["light 1", "spot", "sun", "lobe"]);
        use gltf::khr_lights_punctual::Kind;
        let [point, spot, sun, lobe] = [0, 1, 2, 3].map(|i: usize| lights[i].kind());
        assert!(matches!((point, sun, lobe), (Kind::Point, Kind::Directional, Kind::Point)));
        let Kind::Spot { inner_cone_angle, outer_cone_angle } = spot else { panic!("a spot") };
        assert_eq!((inner_cone_angle, outer_cone_angle), (0.25, 0.5));
        // A sphere of radius 0.1 and radiance 12, 9, 6.
        let near = |a: f32, b: f32| assert!((a - b).abs() < 1e-5 * b, "{a} {b}");
        near(lights[0].intensity(), 12.0 * std::f32::consts::PI * 0.01);
        near(lights[0].color()[2], 0.5);
        assert_eq!((lights[1].intensity(), lights[1].color()), (4.0, [1.0, 0.5, 0.25]));
        assert_eq!((lights[2].intensity(), lights[2].color()), (6.0, [0.5, 0.5, 1.0]));
        for node in &nodes[1..3] {
            let matrix = node.transform().matrix();
            let along = [0, 1, 2].map(|k| -matrix[2][k]);
            axis.iter().zip(along).for_each(|(a, b)| assert!((a / 3.0 - b).abs() < 1e-6, "{along:?}"));
        }
        // Names, shapes and colors are restored bit for bit.
        let back = read_exchange(&folder.path().join(name)).unwrap().lights.unwrap().emitters();
        let punctual = |e: &&EmitterRow| names.contains(&e.name.as_str());
        assert_eq!(back, file.emitters.iter().filter(punctual).cloned().collect::<Vec<_>>());
    }
    // Lights of all types stand beside a PLY file.
    sgs(&["export", &text("a.glb"), "-o", &text("b.ply")]).ok();
    let lights = std::fs::read_to_string(folder.path().join("b.lights.json")).unwrap();
    assert!(lights.contains("sgs-lights-2") && lights.contains("\"directional\""), "{lights}");
    sgs(&["relight", &text("b.ply"), "--cameras", &text("scene/transforms.json"), "-o", &text("o")]).refused(&[
        "b.lights.json",
        "light 2 is directional",
        "transport stage",
    ]);
}

/// Returns the linear image of the first view.
fn image(folder: &Path, name: &str) -> Vec<f32> {
    read_exr(&folder.join(name).join("001_relit.exr")).unwrap().image.data
}

#[test]
fn lights_of_gltf_files_join_the_emitters() {
    let folder = tempfile::tempdir().unwrap();
    fabricate_emitting(folder.path());
    let text = |name: &str| folder.path().join(name).display().to_string();
    let relit = |name: &str, edit: serde_json::Value| {
        let file = folder.path().join(format!("{name}.json"));
        std::fs::write(&file, edit.to_string()).unwrap();
        let file = file.display().to_string();
        sgs(&["relight", &text("run"), "--edit", &file, "-o", &text(name), "--format", "exr"]).ok();
        image(folder.path(), name)
    };
    // A file with a light and nothing else. Its node shines along -Z.
    let alone = json!({
        "asset": {"version": "2.0"}, "extensionsUsed": ["KHR_lights_punctual"],
        "scene": 0, "scenes": [{"nodes": [0]}],
        "nodes": [{"translation": [0.25, 0, 0.5], "extensions": {"KHR_lights_punctual": {"light": 0}}}],
        "extensions": {"KHR_lights_punctual": {"lights": [
            {"type": "spot", "color": [1, 0.5, 0.25], "intensity": 4, "spot": {"outerConeAngle": 0.75}}
        ]}},
    });
    std::fs::write(folder.path().join("light.gltf"), alone.to_string()).unwrap();
    let from_file = relit("file", json!({"emitters": {"off": true, "file": "light.gltf"}}));
    let shape =
        LightShape::Spot { position: [0.25, 0.0, 0.5], axis: [0.0, 0.0, -1.0], inner_angle: 0.0, outer_angle: 0.75 };
    let added = relit("add", json!({"emitters": {"off": true, "add": [{"shape": shape, "color": [4, 2, 1]}]}}));
    assert!(from_file == added && added.iter().any(|v| *v > 0.01));

    // An inserted file brings its lights along, with its placement.
    let mut chair = Splats { ..sgs_tests::foreign::sample(12) };
    chair.means.iter_mut().flatten().for_each(|x| *x *= 0.02);
    chair.write_ply(&folder.path().join("chair.ply")).unwrap();
    let light = r#"{"type": "point", "position": [0, 0.25, 0], "color": [2, 1, 0.5]}"#;
    let light: ListedLight = serde_json::from_str(light).unwrap();
    let list = LightList { normalizer: 1.0, lights: vec![light] };
    write_exchange(&folder.path().join("chair.glb"), &chair, None, Some(&list), None).unwrap();
    let insert =
        |source: &str| json!([{"source": source, "scale": 2, "rotation": [1, 0, 0, 1], "translation": [0, 0, 0.25]}]);
    let inserted = relit("insert", json!({"emitters": {"off": true}, "insert": insert("chair.glb")}));
    let point = json!({"shape": {"type": "point", "position": [-0.5, 0, 0.25]}, "color": [8, 4, 2]});
    let beside = json!({"emitters": {"off": true, "add": [point]}, "insert": insert("chair.ply")});
    let largest = inserted.iter().copied().fold(0.0, f32::max);
    let apart = inserted.iter().zip(relit("beside", beside)).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(largest > 0.01 && apart < 1e-4 * largest, "{apart} of {largest}");
}

#[test]
fn spots_of_gltf_light_the_published_model() {
    let folder = tempfile::tempdir().unwrap();
    fabricate_emitting(folder.path());
    let text = |name: &str| folder.path().join(name).display().to_string();
    let mut splats = Splats::read_ply(&folder.path().join("run/scene.ply")).unwrap();
    splats.emitters = None;
    let types = r#"[
        {"type": "spot", "position": [0, 0, 0], "axis": [0, 0, 1], "inner_angle": 10, "outer_angle": 60, "color": [4, 4, 4]},
        {"type": "directional", "direction": [0, 1, 0], "angular_radius": 0, "color": [9, 9, 9]}]"#;
    let list = LightList { normalizer: 1.0, lights: serde_json::from_str(types).unwrap() };
    write_exchange(&folder.path().join("a.glb"), &splats, None, Some(&list), None).unwrap();
    let cameras = text("scene/transforms.json");
    sgs(&["relight", &text("a.glb"), "--cameras", &cameras, "-o", &text("o"), "--format", "exr"]).ok();
    let lit = image(folder.path(), "o");
    assert!(lit.iter().any(|v| *v > 0.01) && lit.iter().all(|v| v.is_finite()));
}
