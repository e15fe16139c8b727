//! Files exchanged with other programs: round trips, other readers, damage.
//!
//! The other readers are the crates `ply-rs-bw` and `gltf`, and for glTF the program `assimp` where it is installed.
//! Continuous integration has it, from Debian's assimp-utils.

use base64::prelude::{BASE64_STANDARD, Engine as _};
use glam::{DVec3, Vec3};
use ply_rs_bw::parser::Parser;
use ply_rs_bw::ply::{DefaultElement, Property};
use proptest::prelude::*;
use serde_json::{Value, json};
use sgs_config::VisibilityKind;
use sgs_passes::transport::LightShape;
use sgs_run::{read_exchange, read_lights, read_splats, write_exchange, write_lights};
use sgs_scene::{ALBEDO_RANGE, Camera, GltfScene, PlyDialect, ROUGHNESS_RANGE, SH_C0, Splats, read_exr, write_exr};
use sgs_tests::Place;
use sgs_tests::cli::{Finished, sgs, sgs_after};
use sgs_tests::foreign::{lights as foreign_lights, sample};
use sgs_tests::rooms::{Room, transforms, write_json};
use sgs_tests::runs::{Parts, fabricate};
use std::path::Path;
use std::process::Command;

/// Creates a room with `a.ply`, lights and an environment map beside it.
fn place() -> Place {
    let place = Place::new(Room::default());
    sample(30).write_ply(&place.path("a.ply")).unwrap();
    write_lights(&place.path("a.lights.json"), &foreign_lights()).unwrap();
    let sky = sgs_scene::Image::from_data(8, 4, 3, (0..96).map(|i| i as f32 / 96.0).collect()).unwrap();
    write_exr(&place.path("a.environment.exr"), &sky, &["R", "G", "B"]).unwrap();
    place
}

fn export(place: &Place, from: &str, to: &str, more: &[&str]) -> Finished {
    let (from, to) = (place.text(from), place.text(to));
    let mut arguments = vec!["export", &from, "-o", &to];
    arguments.extend(more);
    sgs(&arguments)
}

#[test]
fn ranges_are_those_of_the_shaders() {
    let text = include_str!("../../../shaders-glsl/include/material.glsl");
    let number = |name: &str| -> f32 {
        let line = text.lines().find(|l| l.contains(&format!("const float {name} ="))).unwrap();
        line.rsplit('=').next().unwrap().trim().trim_end_matches(';').parse().unwrap()
    };
    assert_eq!(ALBEDO_RANGE, [number("ALBEDO_LOW"), number("ALBEDO_RANGE")]);
    assert_eq!(ROUGHNESS_RANGE, [number("ROUGHNESS_LOW"), number("ROUGHNESS_RANGE")]);
}

#[test]
fn every_format_round_trips() {
    let place = place();
    for (name, format) in [("b.glb", "glb"), ("b.gltf", "gltf"), ("b.ply", "ply")] {
        let answer = export(&place, "a.ply", name, &["--json", "--format", format]).ok().json();
        assert_eq!((answer["gaussians"].as_u64(), answer["lights"].as_u64()), (Some(30), Some(3)));
        assert_eq!(answer["left_out"], json!([]));
        export(&place, name, "c.ply", &[]).ok();
        // Gaussians, lights with all their lobes, and the environment map are restored bit for bit.
        for what in ["ply", "lights.json", "environment.exr"] {
            assert!(place.read(&format!("a.{what}")) == place.read(&format!("c.{what}")), "{format}: {what}");
        }
        for what in ["ply", "lights.json", "environment.exr"] {
            std::fs::remove_file(place.path(&format!("c.{what}"))).unwrap();
        }
    }
    assert!(place.path("b.bin").is_file());
    for (format, left) in [
        ("3dgs", vec!["materials", "semantic features", "light"]),
        ("gs-ir", vec!["semantic features"]),
        ("r3dg", vec!["metallic", "semantic features"]),
        ("sgs", vec!["metallic"]),
        ("mesh2splat", vec!["semantic features", "colors, in whose place albedo stands"]),
    ] {
        let answer = export(&place, "a.ply", "d.ply", &["--json", "--format", format]).ok().json();
        assert_eq!(answer["left_out"], json!(left), "{format}");
        let file = read_exchange(&place.path("d.ply")).unwrap();
        assert_eq!((file.format, file.splats.means), (format, sample(30).means));
        assert_eq!(file.lights.is_some(), format != "3dgs" || place.path("d.lights.json").is_file());
    }
    // The extension of the file name selects the format.
    export(&place, "a.ply", "e.GLB", &[]).ok();
    assert!(place.read("e.GLB").starts_with(b"glTF"));
}

#[test]
fn edits_of_other_programs_override_stored_attributes() {
    let place = place();
    export(&place, "a.ply", "b.gltf", &[]).ok();
    let mut document: Value = serde_json::from_slice(&place.read("b.gltf")).unwrap();
    let scale = document["meshes"][0]["primitives"][0]["attributes"]["KHR_gaussian_splatting:SCALE"].as_u64().unwrap();
    let at = document["bufferViews"][scale as usize]["byteOffset"].as_u64().unwrap() as usize;
    let mut bytes = place.read("b.bin");
    bytes[at..at + 4].copy_from_slice(&2.0_f32.to_le_bytes());
    std::fs::write(place.path("b.bin"), bytes).unwrap();
    document["nodes"][1]["translation"] = json!([5, 6, 7]);
    std::fs::write(place.path("b.gltf"), document.to_string()).unwrap();
    let file = read_exchange(&place.path("b.gltf")).unwrap();
    let mut expected = sample(30);
    expected.log_scales[0][0] = 2.0_f32.ln();
    assert_eq!(file.splats, expected);
    assert_eq!(file.lights.unwrap().published().unwrap().lights[0].position, [5.0, 6.0, 7.0]);
}

#[test]
fn ply_crate_reads_every_value() {
    let place = place();
    let splats = sample(30);
    for dialect in PlyDialect::ALL {
        write_exchange(&place.path("o.ply"), &splats, Some(dialect), None, None).unwrap();
        let mut file = std::io::BufReader::new(std::fs::File::open(place.path("o.ply")).unwrap());
        let ply = Parser::<DefaultElement>::new().read_ply(&mut file).unwrap();
        let rows = &ply.payload["vertex"];
        assert_eq!(rows.len(), 30);
        for (i, row) in rows.iter().enumerate() {
            let of = |name: &str| match row.get(name) {
                Some(Property::Float(v)) => *v,
                other => panic!("{name}: {other:?}"),
            };
            assert_eq!([of("x"), of("y"), of("z")], splats.means[i]);
            assert_eq!([of("rot_0"), of("rot_1"), of("rot_2"), of("rot_3")], splats.rotations[i]);
            assert_eq!([of("nx"), of("ny"), of("nz")], splats.normals.as_ref().unwrap()[i]);
            assert_eq!((of("opacity"), of("scale_2")), (splats.opacity_logits[i], splats.log_scales[i][2]));
            if dialect == PlyDialect::GsIr {
                assert_eq!(of("normal_2"), splats.normals.as_ref().unwrap()[i][2]);
            }
            if dialect == PlyDialect::Mesh2Splat {
                let own = splats.metallic.as_ref().unwrap()[i];
                assert!((of("metallicFactor") - 1.0 / (1.0 + (-own).exp())).abs() < 1e-6);
            }
        }
    }
}

#[test]
fn gltf_crate_reads_the_values_of_extensions() {
    let place = place();
    export(&place, "a.ply", "o.glb", &[]).ok();
    let splats = sample(30);
    let bytes = place.read("o.glb");
    // The crate has no API for attributes of extensions, so the test reads their accessors.
    let gltf = gltf::Gltf::from_slice_without_validation(&bytes).unwrap();
    let blob = gltf.blob.as_deref().unwrap();
    let raw: Value = serde_json::from_slice(&gltf::binary::Glb::from_slice(&bytes).unwrap().json).unwrap();
    let primitive = gltf.meshes().next().unwrap().primitives().next().unwrap();
    assert_eq!(primitive.mode(), gltf::mesh::Mode::Points);
    let reader = primitive.reader(|_| Some(blob));
    assert!(reader.read_positions().unwrap().eq(splats.means.iter().copied()));
    let low = primitive.bounding_box().min;
    assert_eq!(low[0], splats.means.iter().map(|m| m[0]).fold(f32::INFINITY, f32::min));
    let of = |name: &str| {
        let at = raw["meshes"][0]["primitives"][0]["attributes"][name].as_u64().unwrap_or_else(|| panic!("{name}"));
        let accessor = gltf.accessors().nth(at as usize).unwrap();
        let wide = accessor.dimensions().multiplicity();
        let view = accessor.view().unwrap();
        let bytes = &blob[view.offset()..view.offset() + view.length()];
        let numbers = bytes.as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b));
        (wide, numbers.collect::<Vec<f32>>())
    };
    let near = |a: f32, b: f64| assert!((f64::from(a) - b).abs() <= 2e-7 * b.abs().max(1e-3), "{a} is not {b}");
    let logistic = |v: f32| 1.0 / (1.0 + (-f64::from(v)).exp());
    let (wide, scales) = of("KHR_gaussian_splatting:SCALE");
    assert_eq!(wide, 3);
    let logs = splats.log_scales.as_flattened();
    scales.iter().zip(logs).for_each(|(shown, stored)| near(*shown, f64::from(*stored).exp()));
    let (wide, opacity) = of("KHR_gaussian_splatting:OPACITY");
    assert_eq!(wide, 1);
    opacity.iter().zip(&splats.opacity_logits).for_each(|(shown, stored)| near(*shown, logistic(*stored)));
    let (wide, rotations) = of("KHR_gaussian_splatting:ROTATION");
    assert_eq!(wide, 4);
    for (q, stored) in rotations.as_chunks::<4>().0.iter().zip(&splats.rotations) {
        let length = stored.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>().sqrt();
        // glTF stores quaternions as xyzw, splats as wxyz.
        [(0, 1), (1, 2), (2, 3), (3, 0)].iter().for_each(|(a, b)| near(q[*a], f64::from(stored[*b]) / length));
    }
    let (_, coefficient) = of("KHR_gaussian_splatting:SH_DEGREE_3_COEF_6");
    assert_eq!(coefficient[..3], splats.sh[3][18..21]);
    assert_eq!(of("KHR_gaussian_splatting:SH_DEGREE_0_COEF_0").1, splats.sh[0]);
    let (wide, albedo) = of("_ALBEDO");
    assert_eq!(wide, 3);
    near(albedo[4], 0.01 + 0.98 * logistic(splats.albedo.as_ref().unwrap()[1][1]));
    assert_eq!(of("_NORMAL").1, splats.normals.as_ref().unwrap().as_flattened());

    let lights: Vec<_> = gltf.lights().unwrap().collect();
    assert_eq!(lights.len(), 3);
    let nodes: Vec<_> = gltf.nodes().filter(|n| n.light().is_some()).collect();
    for (i, (node, light)) in nodes.iter().zip(&foreign_lights().lights).enumerate() {
        assert_eq!(node.transform().decomposed().0, light.position);
        assert!(matches!(lights[i].kind(), gltf::khr_lights_punctual::Kind::Point));
        // Mean of a lobe over all directions, by the midpoint rule.
        let steps = 20_000;
        let mean = |s: f64| {
            let cos = |k: usize| (k as f64 + 0.5) / f64::from(steps) * 2.0 - 1.0;
            (0..steps as usize).map(|k| (s * (cos(k) - 1.0)).exp()).sum::<f64>() / f64::from(steps)
        };
        let sent = light.lobes.iter().map(|l| f64::from(l.amplitude[0]) * mean(f64::from(l.sharpness))).sum::<f64>();
        let expected = sent * f64::from(light.gain) / 81.0;
        let found = f64::from(lights[i].intensity() * lights[i].color()[0]);
        assert!((found - expected).abs() < 1e-4 * expected, "{found} {expected}");
    }
}

#[test]
fn assimp_opens_gltf_with_its_lights() {
    if Command::new("assimp").arg("version").output().is_err() {
        eprintln!("skipped: assimp is not installed (Debian: assimp-utils)");
        return;
    }
    let place = place();
    let info = |file: &str| {
        let output = Command::new("assimp").args(["info", &place.text(file)]).output().unwrap();
        let text = String::from_utf8_lossy(&output.stdout).into_owned();
        let number = |name: &str| {
            let line = text.lines().find(|l| l.starts_with(name)).unwrap_or_else(|| panic!("{file}: {text}"));
            line.split_whitespace().last().unwrap().parse::<usize>().unwrap()
        };
        (number("Vertices:"), number("Lights:"))
    };
    export(&place, "a.ply", "o.glb", &[]).ok();
    export(&place, "a.ply", "o.gltf", &[]).ok();
    assert_eq!((info("o.glb"), info("o.gltf")), ((30, 3), (30, 3)));
}

/// Returns a glTF of another program: quantized, rotated, with embedded bytes.
fn foreign() -> Value {
    let mut bytes: Vec<u8> = Vec::new();
    [1.0_f32, 0.0, 0.0, 0.0, 2.0, 0.0].iter().for_each(|v| bytes.extend(v.to_le_bytes()));
    for q in [[0_i16, 0, 0, 32767], [32767, 0, 0, 0]] {
        q.iter().for_each(|v| bytes.extend(v.to_le_bytes()));
    }
    [0.5_f32, 0.25, 0.125, 1.0, 1.0, 1.0].iter().for_each(|v| bytes.extend(v.to_le_bytes()));
    bytes.extend([255, 51, 0, 0]);
    [0.5_f32, -0.5, 0.0, 1.0, 1.0, 1.0].iter().for_each(|v| bytes.extend(v.to_le_bytes()));
    let text = BASE64_STANDARD.encode(&bytes);
    let splat = |name: &str| format!("KHR_gaussian_splatting:{name}");
    json!({
        "asset": {"version": "2.0"},
        "extensionsUsed": ["KHR_gaussian_splatting", "KHR_lights_punctual"],
        "extensionsRequired": ["KHR_gaussian_splatting"],
        "scene": 0,
        "scenes": [{"nodes": [0, 2, 3]}],
        "nodes": [
            // Node 0 rotates by a quarter turn about z and scales by 2. Node 1 translates.
            {"rotation": [0, 0, 0.5_f64.sqrt(), 0.5_f64.sqrt()], "scale": [2, 2, 2], "children": [1]},
            {"mesh": 0, "translation": [0, 0, 1]},
            {"translation": [1, 2, 3], "extensions": {"KHR_lights_punctual": {"light": 0}}},
            {"extensions": {"KHR_lights_punctual": {"light": 1}}},
        ],
        "meshes": [{"primitives": [{"mode": 0, "attributes": {
            "POSITION": 0, splat("ROTATION"): 1, splat("SCALE"): 2, splat("OPACITY"): 3, splat("SH_DEGREE_0_COEF_0"): 4
        }, "extensions": {"KHR_gaussian_splatting": {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"}}}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 2, "type": "VEC3"},
            {"bufferView": 0, "byteOffset": 24, "componentType": 5122, "normalized": true, "count": 2, "type": "VEC4"},
            {"bufferView": 0, "byteOffset": 40, "componentType": 5126, "count": 2, "type": "VEC3"},
            {"bufferView": 0, "byteOffset": 64, "componentType": 5121, "normalized": true, "count": 2, "type": "SCALAR"},
            {"bufferView": 0, "byteOffset": 68, "componentType": 5126, "count": 2, "type": "VEC3"},
        ],
        "bufferViews": [{"buffer": 0, "byteLength": bytes.len()}],
        "buffers": [{"byteLength": bytes.len(), "uri": format!("data:application/octet-stream;base64,{text}")}],
        "extensions": {"KHR_lights_punctual": {"lights": [
            {"type": "point", "color": [1, 0.5, 0], "intensity": 40}, {"type": "directional"}
        ]}},
    })
}

#[test]
fn foreign_gltf_is_read_in_place() {
    let place = Place::new(Room::default());
    let path = place.path("f.gltf");
    std::fs::write(&path, foreign().to_string()).unwrap();
    let file = read_exchange(&path).unwrap();
    let near = |a: &[f32], b: &[f32]| {
        assert!(a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-4), "{a:?} is not {b:?}");
    };
    let s = &file.splats;
    near(s.means.as_flattened(), &[0.0, 2.0, 2.0, -4.0, 0.0, 2.0]);
    near(&s.log_scales[0], &[0.0, 0.5_f32.ln(), 0.25_f32.ln()]);
    let h = 0.5_f32.sqrt();
    near(&s.rotations[0], &[h, 0.0, 0.0, h]);
    near(&s.rotations[1], &[0.0, h, h, 0.0]);
    assert!(s.opacity_logits[0] > 10.0);
    near(&s.opacity_logits[1..], &[-(4.0_f32.ln())]);
    near(&s.sh[0], &[0.5, -0.5, 0.0, 1.0, 1.0, 1.0]);
    let emitters = file.lights.unwrap().emitters();
    let shapes: Vec<LightShape> = emitters.iter().map(|e| e.shape).collect();
    let sun = LightShape::Directional { direction: [0.0, 0.0, -1.0], angular_radius: 0.0 };
    assert_eq!(shapes, [LightShape::Point { position: [1.0, 2.0, 3.0] }, sun]);
    assert_eq!((emitters[0].color, emitters[1].color), ([40.0, 20.0, 0.0], [1.0; 3]));
    let mut other = foreign();
    other["extensions"]["KHR_lights_punctual"]["lights"][1]["type"] = json!("area");
    std::fs::write(&path, other.to_string()).unwrap();
    assert_eq!(GltfScene::read(&path).unwrap().left_out, ["1 lights of unknown kinds"]);
}

#[test]
fn invalid_gltf_is_refused_with_one_sentence() {
    let place = place();
    let refused = |change: &dyn Fn(&mut Value), words: &[&str]| {
        let mut document = foreign();
        change(&mut document);
        std::fs::write(place.path("f.gltf"), document.to_string()).unwrap();
        // 4 GB of address space suffice, including the program's own libraries, whatever sizes the file declares.
        let (from, to) = (place.text("f.gltf"), place.text("g.ply"));
        sgs_after("ulimit -v 4000000", &["export", &from, "-o", &to]).refused(words);
        assert!(!place.path("g.ply").exists());
    };
    let attribute = |name: &str| format!("KHR_gaussian_splatting:{name}");
    refused(&|d| d["asset"]["version"] = json!("1.0"), &["f.gltf", "glTF 1.0"]);
    refused(&|d| d["extensionsRequired"] = json!(["EXT_other"]), &["EXT_other"]);
    refused(&|d| d["meshes"][0]["primitives"][0]["extensions"] = json!({}), &["holds no splats"]);
    refused(&|d| d["meshes"][0]["primitives"][0]["mode"] = json!(4), &["no points"]);
    refused(&|d| d["nodes"][0]["scale"] = json!([1, 2, 1]), &["node 1", "unevenly"]);
    refused(&|d| d["nodes"][0]["children"] = json!([0]), &["node 0 is reached twice"]);
    refused(&|d| d["nodes"][0]["children"] = json!([99]), &["no node 99"]);
    refused(&|d| d["accessors"][0]["count"] = json!(4_000_000_000_u64), &["bytes are used twice"]);
    refused(&|d| d["accessors"][0]["count"] = json!(u64::MAX), &["f.gltf"]);
    refused(&|d| d["accessors"][2]["count"] = json!(3), &["SCALE has 3 elements, but POSITION 2"]);
    refused(&|d| d["accessors"][0]["byteOffset"] = json!(900), &["POSITION", "leave the buffer view"]);
    refused(&|d| d["accessors"][1]["componentType"] = json!(5125), &["ROTATION", "type 5125"]);
    refused(&|d| d["accessors"][1]["type"] = json!("MAT4"), &["ROTATION", "MAT4"]);
    refused(&|d| d["accessors"][3]["sparse"] = json!({}), &["OPACITY", "sparse"]);
    refused(&|d| d["bufferViews"][0]["byteStride"] = json!(0), &["leave the buffer view"]);
    refused(&|d| d["bufferViews"][0]["byteLength"] = json!(u64::MAX), &["leaves the buffer"]);
    refused(&|d| d["buffers"][0]["uri"] = json!("../../etc/passwd"), &["not beside the file"]);
    refused(&|d| d["buffers"][0]["uri"] = json!("none.bin"), &["none.bin"]);
    refused(&|d| d["buffers"][0]["uri"] = json!("data:;base64,****"), &["no base64"]);
    refused(&|d| d["extensions"]["KHR_lights_punctual"]["lights"][0]["intensity"] = json!(-1), &["light"]);
    refused(
        &|d| {
            let object = d["meshes"][0]["primitives"][0]["attributes"].as_object_mut().unwrap();
            object.remove(&attribute("SCALE"));
        },
        &["SCALE", "which splats need"],
    );
    refused(
        &|d| d["meshes"][0]["primitives"][0]["extensions"]["KHR_gaussian_splatting"]["kernel"] = json!("box"),
        &["kernel is \"box\""],
    );
    std::fs::write(place.path("f.glb"), b"glTF").unwrap();
    export(&place, "f.glb", "g.ply", &[]).refused(&["f.glb", "header is cut off"]);
    std::fs::write(place.path("f.gltf"), "{").unwrap();
    export(&place, "f.gltf", "g.ply", &[]).refused(&["f.gltf", "no glTF"]);

    export(&place, "a.ply", "g.xyz", &[]).refused(&["g.xyz", ".glb"]);
    export(&place, "a.ply", "g.ply", &["--format", "glb"]).refused(&["does not end in .glb"]);
    let bare = Splats { albedo: None, ..sample(2) };
    bare.write_ply(&place.path("bare.ply")).unwrap();
    export(&place, "bare.ply", "g.ply", &["--format", "gs-ir"]).refused(&["no materials", "gs-ir"]);
    Splats::default().write_ply(&place.path("none.ply")).unwrap();
    export(&place, "none.ply", "g.glb", &[]).refused(&["no way to say so"]);
    std::fs::write(place.path("a.lights.json"), "{}").unwrap();
    export(&place, "a.ply", "g.ply", &[]).refused(&["a.lights.json"]);
    for file in ["g.ply", "g.glb", "g.xyz"] {
        assert!(!place.path(file).exists(), "{file}");
    }
    assert_eq!(export(&place, "a.ply", "g.ply", &["--format", "xyz"]).status, Some(2));
}

#[test]
fn exported_files_render_like_the_run() {
    let place = place();
    fabricate(&place.path("run"), Parts { visibility: VisibilityKind::Traced, ..Parts::ALL });
    export(&place, "run", "r.ply", &[]).ok();
    export(&place, "run", "r.glb", &[]).ok();
    let camera = Camera { translation: [0.1, -0.05, 0.2].into(), rotation: Default::default(), ..camera(&place) };
    write_json(&place.path("cameras.json"), &transforms(&[camera]));
    let cameras = place.text("cameras.json");
    for (command, last, more) in [
        ("render", "direct", &["--channels", "rgb,pbr,visibility,direct"][..]),
        ("relight", "direct", &["--channels", "relit,direct"]),
        ("relight", "open", &["--channels", "direct", "--visibility", "none"]),
    ] {
        let rendered = |source: &str| {
            let (from, to) = (place.text(source), place.text(&format!("{source}-{last}")));
            let mut arguments = vec![command, &from, "--cameras", &cameras, "-o", &to, "--format", "exr"];
            arguments.extend(more);
            sgs(&arguments).ok();
            read_exr(&Path::new(&to).join("000_direct.exr")).unwrap().image
        };
        let [run, ply, glb] = ["run", "r.ply", "r.glb"].map(rendered);
        let lit = run.data.iter().filter(|v| **v > 0.01).count();
        assert!(lit > run.data.len() / 4, "{command}: {lit} of {} numbers are lit", run.data.len());
        assert_eq!(ply.data, run.data, "{command}");
        assert_eq!(glb.data, run.data, "{command}");
    }
    // Shadows are present, in files as in the run.
    let of = |file: &str| read_exr(&place.path(file)).unwrap().image.data.iter().map(|v| f64::from(*v)).sum::<f64>();
    let [shadow, open] = ["direct", "open"].map(|d| of(&format!("r.ply-{d}/000_direct.exr")));
    assert!(shadow < 0.9 * open, "{shadow} {open}");

    std::fs::remove_file(place.path("r.lights.json")).unwrap();
    std::fs::remove_file(place.path("r.environment.exr")).unwrap();
    let (from, to) = (place.text("r.ply"), place.text("dark"));
    sgs(&["render", &from, "--cameras", &cameras, "-o", &to, "--channels", "pbr"]).refused(&["neither lights"]);
}

/// Returns the first camera of the room.
fn camera(place: &Place) -> Camera {
    Camera::read_transforms(&place.path("scene/transforms.json")).unwrap().remove(0)
}

#[test]
fn lights_from_files_illuminate_facing_surfaces() {
    let place = place();
    std::fs::remove_file(place.path("a.environment.exr")).unwrap();
    let (from, cameras) = (place.text("a.ply"), place.text("scene/transforms.json"));
    let to = place.text("o");
    let a = ["render", &from, "--cameras", &cameras, "-o", &to, "--format", "exr"];
    sgs(&[&a[..], &["--channels", "alpha,normal,depth,direct,visibility"]].concat()).ok();
    let light_table = foreign_lights();
    let mut views = [0, 0];
    let [mut checked, mut bright] = [0, 0];
    for camera in Camera::read_transforms(Path::new(&cameras)).unwrap() {
        let of = |what: &str| read_exr(&Path::new(&to).join(format!("{}_{what}.exr", camera.name))).unwrap().image;
        let [alpha, normal, depth, direct, seen] = ["alpha", "normal", "depth", "direct", "visibility"].map(of);
        for (p, n) in normal.data.as_chunks::<3>().0.iter().enumerate() {
            let (x, y) = (p as u32 % normal.width, p as u32 / normal.width);
            let z = f64::from(depth.data[p] / alpha.data[p]);
            let pixel = |at: u32, c: f64, f: f64| (f64::from(at) + 0.5 - c) / f * z;
            let view = DVec3::new(pixel(x, camera.cx, camera.fx), pixel(y, camera.cy, camera.fy), z);
            let place = camera.rotation.transpose() * (view - camera.translation);
            let normal = Vec3::from(*n).as_dvec3().normalize();
            let facing = light_table.lights.iter().map(|l| {
                let to = Vec3::from(l.position).as_dvec3() - place;
                to.normalize().dot(normal)
            });
            let facing = facing.fold(-1.0, f64::max);
            let lit = direct.data[3 * p] > 0.0;
            // Surfaces that face away from all lights are unlit. Others are lit where their visibility is above zero.
            if facing < -0.01 {
                assert!(!lit, "{} {x} {y}: {facing}", camera.name);
            } else if facing > 0.01 {
                assert_eq!(lit, seen.data[p] > 0.0, "{} {x} {y}: {facing}", camera.name);
            }
            checked += usize::from(facing.abs() > 0.01);
            bright += usize::from(lit);
        }
        let lit = direct.data.iter().any(|v| *v > 0.0);
        views[usize::from(lit)] += 1;
    }
    // Some views see only surfaces that face away from the lights.
    assert!(views[0] > 0 && views[1] > 0, "{views:?}");
    assert!(checked > 6000 && bright > 30, "{checked} {bright}");
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 150, failure_persistence: None, ..ProptestConfig::default() })]

    /// Reads or refuses truncated and garbled files of every kind, without a panic.
    #[test]
    fn damaged_files_break_nothing(
        kind in 0..8_usize,
        keep in 0.0..1.2_f64,
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..12),
        early in any::<bool>(),
    ) {
        let folder = tempfile::tempdir().unwrap();
        let name = if kind < 6 { "a.ply" } else if kind == 6 { "a.glb" } else { "a.gltf" };
        let path = folder.path().join(name);
        let splats = sample(3);
        write_exchange(&path, &splats, PlyDialect::ALL.get(kind).copied(), Some(&foreign_lights().into()), None).unwrap();
        let mut bytes = std::fs::read(&path).unwrap();
        let whole = bytes.len();
        bytes.truncate((whole as f64 * keep) as usize);
        // Damage the beginning, where sizes are declared, or any place.
        let reach = if early { bytes.len().min(1200) } else { bytes.len() };
        if reach > 0 {
            changes.iter().for_each(|(at, value)| bytes[at.index(reach)] = *value);
        }
        std::fs::write(&path, &bytes).unwrap();
        match read_splats(&path) {
            Ok(read) => prop_assert!(read.check().is_ok()),
            Err(error) => prop_assert!(error.to_string().len() < 2000 && !bytes.is_empty() || bytes.len() < whole),
        }
        let _ = read_exchange(&path);
    }
}

#[test]
fn fallback_color_is_linear() {
    let place = place();
    export(&place, "a.ply", "o.glb", &[]).ok();
    let bytes = place.read("o.glb");
    let gltf = gltf::Gltf::from_slice_without_validation(&bytes).unwrap();
    let primitive = gltf.meshes().next().unwrap().primitives().next().unwrap();
    let blob = gltf.blob.as_deref().unwrap();
    let reader = primitive.reader(|_| Some(blob));
    let colors: Vec<[f32; 4]> = reader.read_colors(0).unwrap().into_rgba_f32().collect();
    let splats = sample(30);
    let expected = sgs_scene::srgb_to_linear((0.5 + SH_C0 * splats.sh[0][5]).clamp(0.0, 1.0));
    assert!((colors[1][2] - expected).abs() < 1e-6);
    assert!(read_lights(&place.path("a.lights.json")).is_ok());
}
