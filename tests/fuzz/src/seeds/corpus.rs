//! Initial inputs of the corpora, written by `sgs-fuzz --seeds`.
//!
//! Inputs that campaigns have found stay.

use super::binary::{self, exr, npy, splats};
use super::text::*;
use crate::corpus;
use ::image::ImageFormat;
use exr::prelude::{Blocks, Compression, Encoding, LineOrder, Vec2};
use safetensors::Dtype;
use safetensors::tensor::TensorView;
use sgs_provider::{Array, Kind, Message};
use sgs_run::{
    Export, ExportFormat, LightFile, SemanticHead, VisibilityFile, read_light_list, write_exchange, write_export,
};
use sgs_scene::{GltfCoding, Placement, PlyDialect, Splats, SpzVersion};
use std::collections::{BTreeMap, HashMap};
use std::path::Path;

type Files = Vec<(&'static str, &'static str, Vec<u8>)>;

/// Adds the initial inputs to the corpora in a directory.
///
/// # Errors
/// If a file cannot be read or written.
pub fn write_seeds(folder: &Path) -> std::io::Result<()> {
    let mut files = texts();
    files.extend(images());
    files.extend(models());
    files.extend(tensors());
    files.extend(provider_messages());
    std::fs::create_dir_all(folder)?;
    let mut targets: BTreeMap<&str, Vec<(String, Vec<u8>)>> = BTreeMap::new();
    for (target, name, bytes) in files {
        targets.entry(target).or_default().push((name.to_owned(), bytes));
    }
    targets.into_iter().try_for_each(|(target, inputs)| corpus::add(&corpus::packed(folder, target), inputs))
}

fn texts() -> Files {
    let emitting = SPLATS_ASCII
        .replace("property float roughness\n", "property float roughness\nproperty float emitter\n")
        .replace(" 0 0 0 0\n1 0 1", " 0 0 0 0 3\n1 0 1")
        .replace(" 0.5 0 -1 2\n", " 0.5 0 -1 2 0\n");
    let all: &[(&str, &str, &str)] = &[
        ("transforms", "two.json", TRANSFORMS),
        ("transforms", "held_out.json", HELD_OUT),
        ("transforms", "measured.json", MEASURED),
        ("transforms_held_out", "two.json", HELD_OUT),
        ("cameras", "two.json", TRANSFORMS),
        ("cameras", "angle.json", HELD_OUT),
        ("blender", "two.json", BLENDER),
        ("interiorverse", "two.json", INTERIORVERSE),
        ("fipt_transforms", "two.json", FIPT_TRANSFORMS),
        ("fipt_cameras", "two.txt", FIPT_CAMERAS),
        ("fipt_matrices", "two.txt", FIPT_MATRICES),
        ("split", "two.json", SPLIT),
        ("split", "held_out.json", "{\"train\": [\"001\"], \"test\": [\"000\"]}"),
        ("priors", "opencv.json", PRIORS),
        ("priors", "none.json", "{}"),
        ("labels", "two.json", LABELS),
        ("colmap_cameras_txt", "three.txt", COLMAP_CAMERAS),
        ("colmap_cameras_txt", "models.txt", COLMAP_MODELS),
        ("colmap_cameras_txt", "fisheyes.txt", COLMAP_FISHEYES),
        ("colmap_images_txt", "two.txt", COLMAP_IMAGES),
        ("colmap_rigs_txt", "two.txt", COLMAP_RIGS),
        ("colmap_frames_txt", "one.txt", COLMAP_FRAMES),
        ("rgbd_pose", "one.txt", RGBD_POSE),
        ("rgbd_times", "two.txt", TUM_POSES),
        ("rgbd_images", "two.txt", TUM_IMAGES),
        ("rgbd_depths", "two.txt", TUM_DEPTHS),
        ("rgbd_intrinsics", "kinect.txt", KINECT_INTRINSICS),
        ("scannet_intrinsics", "color.txt", SCANNET_INTRINSICS),
        ("scannet_pose", "one.txt", RGBD_POSE),
        ("scannet_pose", "lost.txt", RGBD_LOST),
        ("colmap_points_txt", "three.txt", COLMAP_POINTS),
        ("splats_ply", "ascii.ply", SPLATS_ASCII),
        ("splats_ply", "emitters.ply", &emitting),
        ("points_ply", "ascii.ply", POINTS_ASCII),
        ("lights", "three.json", LIGHTS),
        ("lights", "types.json", TYPED_LIGHTS),
        ("emitters", "seven.json", EMITTERS),
        ("emitters", "known.json", KNOWN_EMITTERS),
        ("lights_beside", "three.json", LIGHTS),
        ("edit", "add.json", EDITS[0]),
        ("edit", "change.json", EDITS[1]),
        ("edit", "file.json", EDITS[2]),
        ("edit", "types.json", EDITS[3]),
        ("edit", "outside.json", EDITS[4]),
        ("true_lights", "sets.json", TRUE_LIGHTS),
        ("true_edit", "paint.json", TRUE_EDIT),
        ("settings", "some.toml", SETTINGS),
        (
            "settings",
            "accuracy.toml",
            "[accuracy]\n[noise]\n[memory]\nbudget = 1073741824\n[geometry.pseudo]\n[intrinsic]\nsteps = 5\n",
        ),
        ("settings", "auto.toml", "[geometry]\nsh_degree = \"auto\"\n"),
        ("run_settings", "some.toml", SETTINGS),
        ("metrics", "test.json", METRICS),
        ("training", "whole.json", TRAINING),
        ("run_cameras", "two.json", LEARNED_CAMERAS),
        ("profile", "passes.json", PROFILE),
        ("run_log", "two_stages.jsonl", LOG),
        ("page_request", "page.txt", "GET /live?images=3 HTTP/1.1\r\nHost: 127.0.0.1:8117\r\nAccept: */*\r\n\r\n"),
        (
            "page_request",
            "body.txt",
            "POST / HTTP/1.1\r\nHost: localhost:8117\r\nContent-Length: 99999999999999\r\n\r\n",
        ),
        ("bytes", "short.txt", "4G"),
        ("bytes", "long.txt", " 1.5 KiB"),
        ("provider_command", "words.txt", "python3 -m sgs_priors --set 'a b' \"c\\\"d\" e\\ f"),
    ];
    all.iter().map(|(target, name, text)| (*target, *name, text.as_bytes().to_vec())).collect()
}

fn images() -> Files {
    let tiled = Encoding {
        compression: Compression::PIZ,
        blocks: Blocks::Tiles(Vec2(4, 4)),
        line_order: LineOrder::Unspecified,
    };
    let as_is = |compression| Encoding { compression, blocks: Blocks::ScanLines, line_order: LineOrder::Increasing };
    let rgb = ["R", "G", "B"];
    let mut files = vec![
        ("photograph_png", "rgb.png", binary::png(8, 6)),
        ("photograph_png", "rgba.png", binary::rgba(5, 4)),
        ("photograph_png", "gray16.png", binary::gray16(4, 3)),
        ("photograph_png", "gray_alpha.png", binary::gray_alpha(4, 3)),
        ("photograph_jpeg", "rgb.jpg", binary::jpeg(16, 12)),
        ("photograph_jpeg", "gray.jpg", binary::jpeg_gray(9, 7)),
        ("map_png", "rgb.png", binary::png(8, 6)),
        ("map_png", "gray.png", binary::gray(8, 6)),
        ("map_png", "gray16.png", binary::gray16(8, 6)),
        ("map_png", "rgba.png", binary::rgba(4, 3)),
        ("environment", "sky.exr", binary::exr_sky()),
        ("environment", "alpha.exr", exr(4, 2, &["R", "G", "B", "A"], false)),
        ("map_exr", "rgb.exr", exr(8, 6, &rgb, true)),
        ("map_exr", "one.exr", exr(8, 6, &["Y"], false)),
        ("map_exr", "halves.exr", binary::exr_as(8, 6, &["R", "G", "B", "A"], as_is(Compression::ZIP1), true)),
        ("map_npy", "rgb.npy", npy("<f4", &[6, 8, 3], 4)),
        ("map_npy", "planar.npy", npy("<f2", &[3, 6, 8], 2)),
        ("map_npy", "plane.npy", npy("|u1", &[6, 8], 1)),
        ("map_npy", "whole.npy", npy("<i8", &[2, 3], 8)),
        ("map_npy", "double.npy", npy("<f8", &[2, 3, 3], 8)),
    ];
    let kinds = [
        ("zip.exr", as_is(Compression::ZIP16), false),
        ("rle.exr", as_is(Compression::RLE), true),
        ("piz.exr", as_is(Compression::PIZ), true),
        ("pxr24.exr", as_is(Compression::PXR24), false),
        ("b44.exr", as_is(Compression::B44), true),
        ("tiled.exr", tiled, true),
    ];
    for (name, encoding, halves) in kinds {
        files.push(("photograph_exr", name, binary::exr_as(8, 6, &rgb, encoding, halves)));
    }
    files
}

fn models() -> Files {
    let own = ["albedo_0", "albedo_1", "albedo_2", "roughness", "metallic", "semantic_0", "semantic_1"];
    let r3dg = ["base_color_0", "base_color_1", "base_color_2", "roughness"];
    let gs_ir = ["normal_0", "normal_1", "normal_2", "albedo_0", "albedo_1", "albedo_2", "roughness", "metallic"];
    let points = "ply\nformat binary_little_endian 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\n\
                  property float nx\nproperty float ny\nproperty float nz\nproperty float red\nproperty float green\n\
                  property float blue\nend_header\n";
    let numbers = (0..18).flat_map(|i| (0.05 * i as f32).to_le_bytes());
    let mut files = vec![
        ("splats_ply", "own.ply", splats(1, false, &own)),
        ("splats_ply", "plain.ply", splats(3, false, &[])),
        ("splats_ply", "r3dg.ply", splats(0, true, &r3dg)),
        ("splats_ply", "gs_ir.ply", splats(2, false, &gs_ir)),
        ("splats_ply", "mesh2splat.ply", splats(0, false, &["metallicFactor", "roughnessFactor"])),
        ("points_ply", "binary.ply", points.bytes().chain(numbers).collect()),
        ("colmap_cameras_bin", "three.bin", binary::colmap_cameras()),
        ("colmap_images_bin", "two.bin", binary::colmap_images()),
        ("colmap_rigs_bin", "two.bin", binary::colmap_rigs()),
        ("colmap_frames_bin", "one.bin", binary::colmap_frames()),
        ("exif", "turned.bin", binary::exif()),
        ("upright_tiff", "rgb.tif", binary::photograph(ImageFormat::Tiff)),
        ("upright_webp", "rgb.webp", binary::photograph(ImageFormat::WebP)),
        ("colmap_points_bin", "two.bin", binary::colmap_points()),
    ];
    for (name, bytes) in binary::colmap_wide_cameras() {
        files.push(("colmap_cameras_bin", name, bytes));
    }
    // Files that this project writes.
    let folder = crate::Place::new();
    let ply = folder.put("own.ply", &splats(1, false, &own));
    let read = Splats::read_ply(&ply).expect("splats are whole");
    let lights: LightFile = serde_json::from_str(LIGHTS).expect("lights are whole");
    let lights = lights.into();
    let glb = folder.path("scene.glb");
    write_exchange(&glb, &read, None, Some(&lights), None).expect("glTF is written");
    files.push(("gltf", "own.glb", std::fs::read(&glb).expect("it is there")));
    let typed = read_light_list(&folder.put("lights.json", TYPED_LIGHTS.as_bytes())).expect("lights are whole");
    write_exchange(&glb, &read, None, Some(&typed), None).expect("glTF is written");
    files.push(("gltf", "types.glb", std::fs::read(&glb).expect("it is there")));
    let gltf = folder.path("scene.gltf");
    write_exchange(&gltf, &read, None, None, None).expect("glTF is written");
    files.push(("gltf", "beside.gltf", std::fs::read(&gltf).expect("it is there")));
    files.extend(packed(&read, &folder));
    files
}

/// Returns compressed splats that this and another program wrote.
fn packed(splats: &Splats, folder: &crate::Place) -> Files {
    let turned = Placement { scale: 2.0, rotation: [0.5, 0.5, 0.5, 0.5], translation: [1.0, 0.0, 0.0] };
    let formats = [
        ("spz", "own.spz", ExportFormat::Spz(SpzVersion::V4)),
        ("spz", "own2.spz", ExportFormat::Spz(SpzVersion::V2)),
        ("dot_splat", "own.splat", ExportFormat::Splat),
        ("sog", "own.sog", ExportFormat::Sog),
        ("sog_meta", "meta.json", ExportFormat::Sog),
        ("splats_ply", "turned.ply", ExportFormat::Ply(PlyDialect::Own)),
        ("gltf", "turned.glb", ExportFormat::Gltf(GltfCoding::Floats)),
        ("gltf", "spz.glb", ExportFormat::Gltf(GltfCoding::Spz)),
    ];
    let own = formats.map(|(target, name, format)| {
        let path = folder.path(name);
        let export = Export { splats, format, lights: None, environment: None, transform: Some(&turned) };
        write_export(&path, &export).expect("splats are written");
        (target, name, std::fs::read(&path).expect("it is there"))
    });
    let foreign: [(&str, &str, &[u8]); 6] = [
        ("spz", "raw.spz", include_bytes!("../../../../tools/scene/tests/foreign/minimal-raw.spz")),
        ("spz", "v2.spz", include_bytes!("../../../../tools/scene/tests/foreign/minimal-v2.spz")),
        ("spz", "v3.spz", include_bytes!("../../../../tools/scene/tests/foreign/minimal-v3.spz")),
        ("spz", "v4.spz", include_bytes!("../../../../tools/scene/tests/foreign/minimal-v4.spz")),
        ("dot_splat", "minimal.splat", include_bytes!("../../../../tools/scene/tests/foreign/minimal.splat")),
        ("ksplat", "minimal.ksplat", include_bytes!("../../../../tools/scene/tests/foreign/minimal.ksplat")),
    ];
    own.into_iter().chain(foreign.map(|(target, name, bytes)| (target, name, bytes.to_vec()))).collect()
}

/// Returns a safetensors file of constant floats and 32-bit words.
///
/// Every word is 1.
fn tensor_file(tensors: &[(&str, Vec<usize>, f32)], words: &[(&str, usize)], meta: &[(&str, &str)]) -> Vec<u8> {
    let floats = tensors.iter().map(|(name, shape, v)| (*name, shape.clone(), v.to_bits(), Dtype::F32));
    let all: Vec<_> = floats.chain(words.iter().map(|(name, count)| (*name, vec![*count], 1, Dtype::U32))).collect();
    let data: Vec<Vec<u8>> =
        all.iter().map(|(_, shape, bits, _)| bits.to_le_bytes().repeat(shape.iter().product())).collect();
    let views = all.iter().zip(&data).map(|((name, shape, _, kind), data)| {
        ((*name).to_owned(), TensorView::new(*kind, shape.clone(), data).expect("shapes fit"))
    });
    let meta: HashMap<String, String> = meta.iter().map(|(k, v)| ((*k).to_owned(), (*v).to_owned())).collect();
    safetensors::serialize(views, Some(meta)).expect("tensors are written")
}

fn tensors() -> Files {
    let folder = crate::Place::new();
    let decoder = vec![0.01; 512 * 33];
    let data = (0..2 * 512).map(|i| (i % 7) as f32).collect();
    let text = sgs_scene::TextEmbeddings { labels: vec!["wall".into(), "floor".into()], channels: 512, data };
    let head = folder.path("head");
    SemanticHead { decoder, text, temperature: 0.1 }.save(&head).expect("a head is written");
    let field = folder.path("field");
    let config = sgs_passes::shade::visibility::FieldConfig::new(2, 8, 2, 8);
    let (tables, mlp) = (config.initial_tables(1), config.initial_weights(1));
    let made = VisibilityFile { config, low: [-1.0; 3], high: [1.0; 3], tables, mlp };
    made.save(&field).expect("a field is written");
    let read = |path| std::fs::read(path).expect("it is there");
    // AlexNet's shapes without data, which the target's repair fills with zeros; the last head is missing.
    let alex = [("0", [64, 3, 11, 11]), ("3", [192, 64, 5, 5]), ("6", [384, 192, 3, 3])];
    let mut header = serde_json::json!({"__metadata__": {"format": "sgs-lpips-1", "net": "alex"}});
    let mut at = 0;
    for (number, shape) in alex {
        for (name, shape) in [("weight", shape.to_vec()), ("bias", vec![shape[0]])] {
            let end = at + 4 * shape.iter().product::<usize>();
            header[format!("features.{number}.{name}")] =
                serde_json::json!({"dtype": "F32", "shape": shape, "data_offsets": [at, end]});
            at = end;
        }
    }
    let header = header.to_string();
    let mut lpips = (header.len() as u64).to_le_bytes().to_vec();
    lpips.extend(header.bytes());
    let watch = "0 0 0 0 0 3fe0000000000000 3fd0000000000000 1 ffffffffffffffff 0 0 0 3fe0000000000000";
    let roll_backs = "[{\"step\":30,\"to\":20,\"rates\":0.5}]";
    let meta =
        [("format", "sgs-geometry-1"), ("step", "40"), ("capacity", "8"), ("watch", watch), ("roll_backs", roll_backs)];
    let mut groups = Vec::new();
    for (name, width) in [("means", 3), ("log_scales", 3), ("rotations", 4), ("opacity_logits", 1), ("sh0", 3)] {
        groups.push((name, vec![2, width], 0.5));
    }
    let mut state = groups.clone();
    let moments: Vec<String> = groups.iter().map(|(name, _, _)| format!("{name}_moments")).collect();
    for (name, (_, shape, _)) in moments.iter().zip(&groups) {
        state.push((name.as_str(), vec![shape[0], shape[1], 2], 0.0));
    }
    state.push(("statistics", vec![2, 4], 0.0));
    let state = tensor_file(&state, &[], &meta);
    let decisions = "[{\"step\":0,\"what\":\"lights\",\"on\":true,\"reason\":\"lights gain 0.5 dB\",\"setting\":\"intrinsic.lights.count\"},\
                     {\"step\":20,\"what\":\"update_interval\",\"on\":false,\"reason\":\"8 steps\",\"measured\":0.01,\"requested\":0.02,\"setting\":\"x\"}]";
    let meta = [
        ("format", "sgs-intrinsic-1"),
        ("step", "40"),
        ("splats", "2"),
        ("watch", watch),
        ("roll_backs", roll_backs),
        ("decisions", decisions),
        ("lobes", "6"),
        ("levels", "4"),
        ("texels", "16"),
        ("update_interval", "8 20 20"),
        ("last_error", "0.015625"),
    ];
    let mut materials: Vec<(&str, Vec<usize>, f32)> = Vec::new();
    for (name, moments, count) in [
        ("albedo", "albedo_moments", 6),
        ("roughness", "roughness_moments", 2),
        ("environment", "environment_moments", 18),
    ] {
        materials.push((name, vec![count], 0.5));
        materials.push((moments, vec![2 * count], 0.0));
    }
    materials.extend([("light_gains", vec![1], 1.0), ("environment_gathered", vec![18], 0.0)]);
    materials.extend([("environment_after_32", vec![18], 0.5), ("environment_after_36", vec![18], 0.5)]);
    vec![
        ("head", "two.safetensors", read(head)),
        ("visibility", "small.safetensors", read(field)),
        ("lpips", "alex.safetensors", lpips),
        ("checkpoint", "plain.safetensors", state),
        (
            "intrinsic_checkpoint",
            "automatic.safetensors",
            tensor_file(&materials, &[("relit_queried_at", 2), ("relit_estimates0", 4)], &meta),
        ),
        (
            "transport_checkpoint",
            "room.safetensors",
            tensor_file(
                &[],
                &[("emitters", 2)],
                &[("format", "sgs-transport-1"), ("step", "1"), ("psnr", "27.25"), ("file", EMITTERS)],
            ),
        ),
    ]
}

fn message(text: &serde_json::Value, arrays: &[(&str, Kind, &[usize])]) -> Vec<u8> {
    let array = |kind: Kind, shape: &[usize]| {
        let bytes = shape.iter().product::<usize>() * kind.size();
        Array { kind, shape: shape.to_vec(), bytes: vec![0; bytes] }
    };
    let arrays = arrays.iter().map(|(name, kind, shape)| ((*name).to_owned(), array(*kind, shape)));
    Message { text: text.clone(), arrays: arrays.collect::<BTreeMap<_, _>>() }.encode().expect("a message is written")
}

/// Returns messages of well-behaved providers.
fn provider_messages() -> Files {
    use serde_json::json;
    let hello = json!({"kind": "hello", "version": 1, "name": "a stand-in", "offers": {
        "masks": {}, "regions": {"ids": "scene", "max_side": 8}, "normals": {"image": "linear"}, "semantics": {"channels": 4},
        "text": {"channels": 4}, "classes": {}, "materials": {"maps": ["albedo", "roughness", "metallic"]}, "depth": {}}});
    let answer = |extra: serde_json::Value| {
        let mut text = json!({"kind": "answer", "to": 1});
        for (name, value) in extra.as_object().into_iter().flatten() {
            text[name.as_str()] = value.clone();
        }
        text
    };
    let materials =
        [("albedo", Kind::F32, &[9, 12, 3][..]), ("roughness", Kind::F32, &[9, 12]), ("metallic", Kind::F32, &[9, 12])];
    let answers = [
        message(&answer(json!({})), &[("masks", Kind::Bool, &[3, 9, 12])]),
        message(&answer(json!({})), &[("regions", Kind::U16, &[6, 8])]),
        message(&answer(json!({"frame": "world"})), &[("normals", Kind::F32, &[9, 12, 3])]),
        message(&answer(json!({})), &[("features", Kind::F16, &[2, 3, 4])]),
        message(&answer(json!({"names": ["wall", "floor"]})), &[("embeddings", Kind::F32, &[2, 4])]),
        message(&answer(json!({"names": ["wall", "lamp"]})), &[]),
        message(&answer(json!({"color": "srgb"})), &materials),
        message(
            &answer(json!({"meaning": "scale"})),
            &[("depth", Kind::F32, &[9, 12]), ("confidence", Kind::F32, &[9, 12])],
        ),
    ];
    let names = [
        "masks.bin",
        "regions.bin",
        "normals.bin",
        "semantics.bin",
        "text.bin",
        "classes.bin",
        "materials.bin",
        "depth.bin",
    ];
    let hello = message(&hello, &[]);
    let framed = |payload: &[u8]| {
        let mut out = b"SGSP".to_vec();
        out.extend((payload.len() as u64).to_le_bytes());
        out.extend(payload);
        out
    };
    let mut files: Files = vec![("provider_message", "hello.bin", hello.clone())];
    for (i, (name, payload)) in names.into_iter().zip(answers).enumerate() {
        files.push(("provider_message", name, payload.clone()));
        let mut stream = vec![i as u8];
        stream.extend(framed(&hello));
        stream.extend(framed(&payload));
        files.push(("provider_talk", name, stream));
    }
    let refused = message(&json!({"kind": "error", "to": 1, "text": "no\nmemory"}), &[]);
    let mut stream = vec![2];
    stream.extend(framed(&hello));
    stream.extend(framed(&refused));
    files.push(("provider_talk", "refused.bin", stream));
    files
}
