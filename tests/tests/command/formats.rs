//! Splat files of every format: the same image after a round trip, transforms, refusals.
//!
//! USD is read by OpenUSD's own Python package (`pip install usd-core`) where `python3`, or the interpreter that
//! `SGS_TEST_USD_PYTHON` names, has it. Khronos' validator checks glTF where node and npm are installed.

use serde_json::{Value, json};
use sgs_config::VisibilityKind;
use sgs_run::read_exchange;
use sgs_scene::{Camera, Placement, SplatFile, SplatKind, Splats, read_exr};
use sgs_tests::Place;
use sgs_tests::cli::{Finished, sgs};
use sgs_tests::foreign::{lights as foreign_lights, sample};
use sgs_tests::rooms::{Room, transforms, write_json};
use sgs_tests::runs::{Parts, fabricate};
use std::path::{Path, PathBuf};
use std::process::Command;

/// Creates a room with `a.ply`, its lights, and a camera that sees it.
fn place() -> Place {
    let place = Place::new(Room::default());
    let mut splats = sample(400);
    // Opacities and harmonics of a trained scene.
    splats.opacity_logits.iter_mut().for_each(|v| *v *= 0.25);
    splats.log_scales.iter_mut().flatten().for_each(|v| *v -= 1.0);
    splats.write_ply(&place.path("a.ply")).unwrap();
    sgs_run::write_lights(&place.path("a.lights.json"), &foreign_lights()).unwrap();
    let mut camera = Camera::read_transforms(&place.path("scene/transforms.json")).unwrap().remove(0);
    camera.rotation = Default::default();
    camera.translation = [0.1, -0.05, 2.5].into();
    write_json(&place.path("cameras.json"), &transforms(&[camera]));
    place
}

fn export(place: &Place, from: &str, to: &str, more: &[&str]) -> Finished {
    let (from, to) = (place.text(from), place.text(to));
    let mut arguments = vec!["export", &from, "-o", &to];
    arguments.extend(more);
    sgs(&arguments)
}

/// Renders a file.
fn image(place: &Place, file: &str) -> Vec<f32> {
    let folder = format!("{}-image", file.replace('/', "-"));
    let (from, cameras, to) = (place.text(file), place.text("cameras.json"), place.text(&folder));
    sgs(&["render", &from, "--cameras", &cameras, "-o", &to, "--format", "exr", "--channels", "rgb"]).ok();
    read_exr(&Path::new(&to).join("000_rgb.exr")).unwrap().image.data
}

fn psnr(a: &[f32], b: &[f32]) -> f64 {
    assert_eq!(a.len(), b.len());
    let square: f64 = a.iter().zip(b).map(|(a, b)| f64::from(a - b).powi(2)).sum();
    -10.0 * (square / a.len() as f64).max(1e-12).log10()
}

/// Formats, file names, and the least PSNR of a round trip in dB.
///
/// docs/reference/exchange.md states them.
const BOUNDS: &[(&str, &str, f64)] = &[
    ("ply", "o.ply", 100.0),
    ("3dgs", "p.ply", 100.0),
    ("gltf", "o.gltf", 100.0),
    ("glb", "o.glb", 100.0),
    ("glb-spz", "s.glb", 45.0),
    ("gltf-spz", "s.gltf", 45.0),
    ("spz", "o.spz", 46.0),
    ("spz3", "o3.spz", 46.0),
    ("spz2", "o2.spz", 45.0),
    ("sog", "o.sog", 56.0),
    ("sog", "folder/meta.json", 56.0),
];

#[test]
fn every_format_renders_like_its_source() {
    let place = place();
    std::fs::create_dir(place.path("folder")).unwrap();
    let original = image(&place, "a.ply");
    let seen = original.iter().filter(|v| **v > 0.05).count();
    assert!(seen > original.len() / 4, "{seen} of {} numbers are not black", original.len());
    for (format, file, bound) in BOUNDS {
        export(&place, "a.ply", file, &["--format", format]).ok();
        let found = psnr(&image(&place, file), &original);
        println!("{format}: {found:.1} dB");
        assert!(found >= *bound, "{format}: {found} dB");
    }
}

#[test]
fn splat_files_render_like_band_zero_of_their_source() {
    let place = place();
    let mut flat = Splats::read_ply(&place.path("a.ply")).unwrap();
    (1..4).for_each(|band| flat.sh[band].clear());
    flat.write_ply(&place.path("flat.ply")).unwrap();
    export(&place, "a.ply", "o.splat", &[]).ok();
    let found = psnr(&image(&place, "o.splat"), &image(&place, "flat.ply"));
    println!("splat: {found:.1} dB");
    assert!(found >= 53.0, "{found} dB");
}

#[test]
fn recorded_transforms_are_undone() {
    let place = place();
    std::fs::create_dir(place.path("folder")).unwrap();
    let original = image(&place, "a.ply");
    for (format, file, bound) in BOUNDS {
        let answer =
            export(&place, "a.ply", file, &["--format", format, "--up", "z", "--scale", "2", "--json"]).ok().json();
        assert_eq!(answer["transform"]["scale"], 2.0, "{answer}");
        let records = !matches!(*format, "spz2" | "spz3");
        let left_out = answer["left_out"].as_array().unwrap();
        assert_eq!(left_out.iter().any(|what| what == "the transform from the scene"), !records, "{format}: {answer}");
        if !records {
            continue;
        }
        let path = place.path(file);
        let kind = SplatKind::of(&path).unwrap();
        if kind != SplatKind::Gltf {
            // In the file, the scene is turned and twice as large.
            let turned = SplatFile::read(&path, kind).unwrap().0.splats;
            let reach = |s: &Splats| s.means.as_flattened().iter().fold(0.0_f32, |a, b| a.max(b.abs()));
            assert!((reach(&turned) - 2.0 * reach(&sample(400))).abs() < 0.01, "{format}");
            assert_eq!(SplatFile::read(&path, kind).unwrap().0.transform.unwrap().scale, 2.0);
        }
        let found = psnr(&image(&place, file), &original);
        println!("{format} turned: {found:.1} dB");
        assert!(found >= bound.min(100.0), "{format}: {found} dB");
    }
    // The lights of a glTF return, too.
    let lights = read_exchange(&place.path("o.glb")).unwrap().lights.unwrap().published().unwrap();
    for (found, expected) in lights.lights.iter().zip(&foreign_lights().lights) {
        assert_eq!(found.position, expected.position);
    }
}

#[test]
fn gltf_is_upright_for_other_programs() {
    let place = place();
    export(&place, "a.ply", "u.glb", &["--up", "z", "--scale", "2"]).ok();
    let bytes = std::fs::read(place.path("u.glb")).unwrap();
    let gltf = gltf::Gltf::from_slice_without_validation(&bytes).unwrap();
    let root = gltf.default_scene().unwrap_or_else(|| gltf.scenes().next().unwrap()).nodes().next().unwrap();
    let (_, [x, y, z, w], scale) = root.transform().decomposed();
    // A quarter turn about x takes z to y.
    let half = 0.5_f32.sqrt();
    assert!([x + half, y, z, w - half].iter().all(|v| v.abs() < 1e-6), "{:?}", [x, y, z, w]);
    assert_eq!((scale, root.children().count()), ([2.0; 3], 4));
    // What the extension's schema requires of a primitive.
    let raw: serde_json::Value = serde_json::from_slice(&gltf::binary::Glb::from_slice(&bytes).unwrap().json).unwrap();
    let extension = &raw["meshes"][0]["primitives"][0]["extensions"]["KHR_gaussian_splatting"];
    for (name, value) in extension.as_object().unwrap() {
        let known = match name.as_str() {
            "kernel" => value == "ellipse",
            "colorSpace" => value == "srgb_rec709_display" || value == "lin_rec709_display",
            "projection" => value == "perspective",
            "sortingMethod" => value == "cameraDistance",
            _ => false,
        };
        assert!(known, "{name}: {value}");
    }
    assert!(extension["kernel"].is_string() && extension["colorSpace"].is_string());
}

/// Returns the JSON of a glTF file.
fn document(path: &Path) -> Value {
    let bytes = std::fs::read(path).unwrap();
    let json =
        if bytes.starts_with(b"glTF") { gltf::binary::Glb::from_slice(&bytes).unwrap().json } else { (&bytes).into() };
    serde_json::from_slice(&json).unwrap()
}

const SPLATTING: &str = "KHR_gaussian_splatting";
const COMPRESSION: &str = "KHR_gaussian_splatting_compression_spz_2";

/// Returns the attributes of splats of a degree and the types of their accessors.
fn defined_attributes(degree: usize) -> Vec<(String, &'static str)> {
    let own = [("ROTATION", "VEC4"), ("SCALE", "VEC3"), ("OPACITY", "SCALAR")];
    let own = own.into_iter().map(|(name, kind)| (format!("{SPLATTING}:{name}"), kind));
    let bands = (0..=degree).flat_map(|d| (0..2 * d + 1).map(move |n| format!("{SPLATTING}:SH_DEGREE_{d}_COEF_{n}")));
    own.chain(bands.map(|name| (name, "VEC3"))).chain([("POSITION".to_owned(), "VEC3")]).collect()
}

/// Checks what the schemas and texts of both splat extensions require of a file.
fn check_extensions(path: &Path, degree: usize, compressed: bool) {
    let file = document(path);
    let at = path.display();
    let listed = |list: &str| file[list].as_array().cloned().unwrap_or_default();
    assert!(listed("extensionsUsed").contains(&json!(SPLATTING)), "{at}");
    for list in ["extensionsUsed", "extensionsRequired"] {
        assert_eq!(listed(list).contains(&json!(COMPRESSION)), compressed, "{at}: {list}");
    }
    let primitive = &file["meshes"][0]["primitives"][0];
    assert_eq!(primitive["mode"], 0, "{at}");
    let extension = &primitive["extensions"][SPLATTING];
    assert!(extension["kernel"].is_string() && extension["colorSpace"].is_string(), "{at}");
    let attributes = primitive["attributes"].as_object().unwrap();
    let accessor = |name: &str| &file["accessors"][attributes[name].as_u64().unwrap() as usize];
    let count = accessor("POSITION")["count"].as_u64().unwrap();
    for (name, kind) in defined_attributes(degree) {
        let found = accessor(&name);
        assert_eq!((&found["type"], &found["componentType"]), (&json!(kind), &json!(5126)), "{at}: {name}");
        assert_eq!(found["count"], count, "{at}: {name}");
        assert_eq!(found.get("bufferView").is_none(), compressed, "{at}: {name}");
    }
    let known = defined_attributes(degree);
    let others = attributes.keys().filter(|name| !known.iter().any(|(known, _)| known == *name));
    others.for_each(|name| assert!(name == "COLOR_0" || name.starts_with('_'), "{at}: {name}"));
    let Some(payload) = extension["extensions"].get(COMPRESSION) else {
        assert!(!compressed, "{at}");
        return;
    };
    let properties: Vec<&String> = payload.as_object().unwrap().keys().collect();
    assert_eq!(properties, ["bufferView"], "{at}");
    let view = &file["bufferViews"][payload["bufferView"].as_u64().unwrap() as usize];
    assert!(compressed && view["byteLength"].as_u64().unwrap() > 16 && view.get("target").is_none(), "{at}");
}

/// Prints the issues of glTF files, as Khronos' validator finds them.
const VALIDATE: &str = r#"
const validator = require("gltf-validator"), fs = require("fs"), path = require("path");
const read = (file) => new Uint8Array(fs.readFileSync(file));
const one = (file) => validator.validateBytes(read(file), {
    uri: file, maxIssues: 0, writeTimestamp: false,
    externalResourceFunction: async (uri) => read(path.join(path.dirname(file), decodeURIComponent(uri))),
});
Promise.all(process.argv.slice(1).map(one)).then((all) => console.log(JSON.stringify(all.map((report) => report.issues.messages))));
"#;

/// Installs Khronos' validator below the target directory.
///
/// Returns `None` if node or npm is missing, or npm installs nothing.
fn validator() -> Option<PathBuf> {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("gltf-validator");
    if !folder.join("node_modules/gltf-validator").is_dir() {
        std::fs::create_dir_all(&folder).ok()?;
        let mut npm = Command::new("npm");
        npm.args([
            "install",
            "--no-audit",
            "--no-fund",
            "--ignore-scripts",
            "gltf-validator@2.0.0-dev.3.10",
            "--prefix",
        ]);
        npm.arg(&folder).output().ok().filter(|output| output.status.success())?;
    }
    let version = Command::new("node").arg("--version").output().ok()?;
    version.status.success().then_some(folder)
}

#[test]
fn gltf_is_valid_to_khronos() {
    let place = place();
    fabricate(&place.path("run"), Parts { visibility: VisibilityKind::Traced, ..Parts::ALL });
    let splats = Splats::read_ply(&place.path("a.ply")).unwrap();
    let mut files = Vec::new();
    for degree in 0..4 {
        let mut lower = splats.clone();
        (degree + 1..4).for_each(|band| lower.sh[band].clear());
        let (source, bare) = (format!("d{degree}.ply"), degree == 2);
        if bare {
            (lower.normals, lower.albedo, lower.roughness, lower.metallic) = (None, None, None, None);
        }
        lower.write_ply(&place.path(&source)).unwrap();
        for format in ["glb", "gltf", "glb-spz", "gltf-spz"] {
            let file = format!("{degree}-{format}.{}", &format[..if format.starts_with("glb") { 3 } else { 4 }]);
            export(&place, &source, &file, &["--format", format, "--up", "z", "--scale", "0.5"]).ok();
            check_extensions(&place.path(&file), degree, format.ends_with("spz"));
            files.push(file);
        }
    }
    for (source, file, format) in
        [("a.ply", "a.glb", "glb"), ("run", "run.glb", "glb"), ("run", "run-spz.glb", "glb-spz")]
    {
        export(&place, source, file, &["--format", format]).ok();
        files.push(file.to_owned());
    }
    let Some(folder) = validator() else {
        println!("left out: node or npm is missing, or npm installs no gltf-validator");
        return;
    };
    // A file whose positions leave the bounds of their accessor.
    let mut wrong = document(&place.path("0-gltf.gltf"));
    wrong["accessors"][0]["max"][0] = json!(-100.0);
    std::fs::write(place.path("wrong.gltf"), wrong.to_string()).unwrap();
    files.push("wrong.gltf".to_owned());
    let paths = files.iter().map(|file| place.text(file));
    let output = Command::new("node").args(["-e", VALIDATE, "--"]).args(paths).current_dir(&folder).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let reports: Vec<Vec<Value>> = serde_json::from_slice(&output.stdout).unwrap();
    let problems = |issues: &[Value]| -> Vec<Value> {
        // The validator knows neither extension, and so not the attributes that the ratified one defines.
        let known = defined_attributes(3);
        let unknown = |issue: &Value| {
            let name = issue["pointer"].as_str().and_then(|at| at.rsplit('/').next()).unwrap_or_default();
            issue["code"] == "MESH_PRIMITIVE_INVALID_ATTRIBUTE" && known.iter().any(|(known, _)| known == name)
        };
        // Severities 0 and 1 are errors and warnings.
        let severe = issues.iter().filter(|issue| issue["severity"].as_u64() < Some(2));
        severe.filter(|issue| !unknown(issue)).cloned().collect()
    };
    assert_eq!(reports.len(), files.len());
    for (file, issues) in files.iter().zip(&reports) {
        assert_eq!(problems(issues).is_empty(), file != "wrong.gltf", "{file}: {:?}", problems(issues));
    }
}

#[test]
fn compressed_gltf_keeps_materials_and_light() {
    let place = place();
    export(&place, "a.ply", "s.glb", &["--format", "glb-spz"]).ok();
    let [source, packed] = ["a.ply", "s.glb"].map(|file| read_exchange(&place.path(file)).unwrap());
    let near = |a: &[f32], b: &[f32], step: f32| {
        assert!(a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() <= step));
    };
    let (a, b) = (&source.splats, &packed.splats);
    near(a.means.as_flattened(), b.means.as_flattened(), 1e-5);
    assert_eq!((&a.normals, &a.semantic), (&b.normals, &b.semantic));
    near(a.albedo.as_ref().unwrap().as_flattened(), b.albedo.as_ref().unwrap().as_flattened(), 1e-3);
    near(a.roughness.as_ref().unwrap(), b.roughness.as_ref().unwrap(), 1e-3);
    near(a.metallic.as_ref().unwrap(), b.metallic.as_ref().unwrap(), 1e-3);
    assert_eq!(source.lights.unwrap().published().unwrap().lights, packed.lights.unwrap().published().unwrap().lights);
    // The payload is an SPZ file in the axes of SPZ, half a turn about y from those of glTF.
    let bytes = std::fs::read(place.path("s.glb")).unwrap();
    let blob = gltf::binary::Glb::from_slice(&bytes).unwrap().bin.unwrap().into_owned();
    let file = document(&place.path("s.glb"));
    let view = file["bufferViews"].as_array().unwrap().last().unwrap();
    let [from, length] = ["byteOffset", "byteLength"].map(|name| view[name].as_u64().unwrap() as usize);
    std::fs::write(place.path("payload.spz"), &blob[from..from + length]).unwrap();
    let spz = sgs_scene::read_spz(&place.path("payload.spz")).unwrap().splats;
    let turn = Placement { rotation: [0.0, 0.0, 1.0, 0.0], ..Placement::NONE };
    let expected = sgs_run::placed(a.clone(), &turn);
    near(spz.means.as_flattened(), expected.means.as_flattened(), 1e-5);
    (1..4).for_each(|band| {
        near(&spz.sh[band], &expected.sh[band].iter().map(|v| v.clamp(-1.0, 127.0 / 128.0)).collect::<Vec<_>>(), 0.01)
    });
    let whole = std::fs::metadata({
        export(&place, "a.ply", "o.glb", &[]).ok();
        place.path("o.glb")
    })
    .unwrap()
    .len();
    println!("glTF of {whole} bytes, compressed {}", bytes.len());
    assert!((bytes.len() as u64) < whole / 2, "{} of {whole}", bytes.len());
}

#[test]
fn damaged_compressed_gltf_is_refused() {
    let place = place();
    export(&place, "a.ply", "s.gltf", &["--format", "gltf-spz"]).ok();
    let refused = |change: &dyn Fn(&mut Value), words: &[&str]| {
        let mut file = document(&place.path("s.gltf"));
        change(&mut file);
        std::fs::write(place.path("t.gltf"), file.to_string()).unwrap();
        std::fs::copy(place.path("s.bin"), place.path("t.bin")).unwrap();
        export(&place, "t.gltf", "g.ply", &[]).refused(words);
    };
    fn extension(file: &mut Value) -> &mut Value {
        &mut file["meshes"][0]["primitives"][0]["extensions"][SPLATTING]["extensions"]
    }
    refused(&|d| extension(d)[COMPRESSION] = json!({}), &["t.gltf", COMPRESSION, "bufferView"]);
    refused(&|d| extension(d)[COMPRESSION]["bufferView"] = json!(99), &["buffer view 99 is not there"]);
    refused(&|d| extension(d)[COMPRESSION]["bufferView"] = json!(0), &["compressed splats", "NGSP"]);
    refused(&|d| extension(d)["EXT_other"] = json!({}), &["EXT_other"]);
    refused(&|d| d["accessors"][0]["count"] = json!(3), &["400 compressed splats", "POSITION has 3"]);
    refused(
        &|d| {
            let length = d["buffers"][0]["byteLength"].as_u64().unwrap();
            let payload = d["bufferViews"].as_array().unwrap().last().unwrap()["byteLength"].as_u64().unwrap();
            let copies = vec![d["meshes"][0]["primitives"][0].clone(); (length / payload + 1) as usize];
            d["meshes"][0]["primitives"] = json!(copies);
        },
        &["bytes are used twice"],
    );
    // The earlier name of the extension is read.
    let mut file = document(&place.path("s.gltf"));
    let payload = extension(&mut file)[COMPRESSION].take();
    *extension(&mut file) = json!({"KHR_gaussian_splatting_compression_spz": payload});
    file["extensionsRequired"] = json!([SPLATTING, "KHR_gaussian_splatting_compression_spz"]);
    std::fs::write(place.path("s.gltf"), file.to_string()).unwrap();
    assert_eq!(read_exchange(&place.path("s.gltf")).unwrap().splats.len(), 400);
}

#[test]
fn formats_name_what_they_do_not_hold() {
    let place = place();
    let left_out = |file: &str, more: &[&str]| {
        let answer = export(&place, "a.ply", file, &[&["--json"], more].concat()).ok().json();
        let names = answer["left_out"].as_array().unwrap().iter().map(|v| v.as_str().unwrap().to_owned());
        names.collect::<Vec<_>>().join(", ")
    };
    assert_eq!(left_out("o.spz", &[]), "normals, materials, semantic features, light");
    assert_eq!(left_out("o.sog", &[]), "normals, materials, semantic features, light");
    assert_eq!(
        left_out("o.splat", &["--up", "y"]),
        "harmonics above band 0, normals, materials, semantic features, light, the transform from the scene"
    );
    assert_eq!(left_out("o.usda", &[]), "semantic features");
    let printed = export(&place, "a.ply", "o.spz", &[]).ok().stderr.clone();
    assert!(printed.contains("the format does not hold: normals, materials"), "{printed}");
    let text = std::fs::read_to_string(place.path("a.ply").with_file_name("o.usda")).unwrap();
    assert!(text.contains("primvars:albedo") && text.contains("SphereLight"));
    let header = std::fs::read(place.path("a.ply")).unwrap();
    assert!(header.windows(36).any(|w| w == b"comment SplatRenderMode: default\nele"));
}

#[test]
fn damaged_files_are_refused_with_one_sentence() {
    let place = place();
    let refused = |file: &str, bytes: &[u8], words: &[&str]| {
        std::fs::write(place.path(file), bytes).unwrap();
        export(&place, file, "g.ply", &[]).refused_with(42, words);
        assert!(!place.path("g.ply").exists());
    };
    refused("f.spz", b"NGSP\x09\0\0\0\0\0\0\0\0\0\0\0", &["f.spz", "version 9"]);
    refused("f.spz", b"\x1f\x8bxxxxxxxxxxxxxxxx", &["f.spz", "gzip"]);
    refused("f.splat", &[1; 40], &["f.splat", "40 bytes"]);
    refused("f.ksplat", &[0, 1, 0, 0], &["f.ksplat", "4 bytes"]);
    refused("f.sog", b"PK\x03\x04", &["f.sog", "zip"]);
    refused("meta.json", br#"{"version": 1, "means": {}, "quats": {}}"#, &["meta.json", "version 1"]);
    refused("f.ply", b"ply\nformat ascii 1.0\ncomment SgsTransform: 0\nelement vertex 0\nend_header\n", &["8 numbers"]);
    export(&place, "a.ply", "g.xyz", &[]).refused_with(2, &["g.xyz", ".usdz"]);
    export(&place, "a.ply", "g.spz", &["--scale", "0"]).refused_with(2, &["--scale is 0"]);
    export(&place, "a.ply", "g.spz", &["--scale", "1e6"]).ok();
    assert_eq!(export(&place, "a.ply", "g.spz", &["--up", "w"]).status, Some(2));
}

/// Reads a USD file with OpenUSD and writes the splats as a PLY; prints the types of the lights.
const READ_USD: &str = r#"
import sys, math
from pxr import Usd, UsdGeom, UsdLux, UsdVol, UsdUtils
stage = Usd.Stage.Open(sys.argv[1])
prim = stage.GetDefaultPrim().GetChild("Splats")
assert prim.GetTypeName() == "ParticleField3DGaussianSplat" and UsdVol.ParticleField3DGaussianSplat(prim), prim
names = set(Usd.SchemaRegistry().FindConcretePrimDefinition(prim.GetTypeName()).GetPropertyNames())
own = [a.GetName() for a in prim.GetAuthoredAttributes()]
assert all(n in names or n.startswith("primvars:") for n in own), own
get = lambda n: prim.GetAttribute(n).Get()
means, turns, scales, opacities = get("positions"), get("orientations"), get("scales"), get("opacities")
degree, sh = get("radiance:sphericalHarmonicsDegree"), get("radiance:sphericalHarmonicsCoefficients")
count, wide = len(means), (degree + 1) ** 2
assert len(turns) == len(scales) == len(opacities) == count and len(sh) == count * wide
primvars = UsdGeom.PrimvarsAPI(prim)
for name in ("albedo", "roughness", "metallic", "normal"):
    primvar = primvars.GetPrimvar(name)
    assert len(primvar.Get()) == count and primvar.GetInterpolation() == "vertex", name
up = UsdGeom.Xformable(stage.GetDefaultPrim()).ComputeLocalToWorldTransform(Usd.TimeCode.Default()).TransformDir((0, 0, 1))
assert UsdGeom.GetStageUpAxis(stage) == "Y" and abs(up[1] - 2) < 1e-6, up
rest = 3 * (wide - 1)
head = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2"] + [f"f_rest_{i}" for i in range(rest)]
head += ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
with open(sys.argv[2], "w") as out:
    out.write(f"ply\nformat ascii 1.0\nelement vertex {count}\n" + "".join(f"property double {n}\n" for n in head) + "end_header\n")
    for i in range(count):
        c = sh[i * wide:(i + 1) * wide]
        row = [*means[i], *c[0]] + [c[k][channel] for channel in range(3) for k in range(1, wide)]
        p = min(max(opacities[i], 1e-7), 1 - 1e-7)
        row += [math.log(p / (1 - p))] + [math.log(v) for v in scales[i]]
        row += [turns[i].GetReal(), *turns[i].GetImaginary()]
        out.write(" ".join(repr(float(v)) for v in row) + "\n")
print(" ".join(p.GetTypeName() for p in stage.Traverse() if p.HasAPI(UsdLux.LightAPI)))
"#;

#[test]
fn usd_is_read_by_openusd() {
    let python = std::env::var("SGS_TEST_USD_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    if !Command::new(&python)
        .args(["-c", "from pxr import UsdVol; UsdVol.ParticleField3DGaussianSplat"])
        .output()
        .is_ok_and(|o| o.status.success())
    {
        println!("left out: {python} has no OpenUSD of version 26.03 or later (pip install usd-core)");
        return;
    }
    let place = place();
    let sky = sgs_scene::Image::from_data(8, 4, 3, (0..96).map(|i| i as f32 / 96.0).collect()).unwrap();
    sgs_scene::write_exr(&place.path("a.environment.exr"), &sky, &["R", "G", "B"]).unwrap();
    let original = image(&place, "a.ply");
    for file in ["o.usda", "o.usdz"] {
        export(&place, "a.ply", file, &["--up", "z", "--scale", "2"]).ok();
        let ply = format!("{file}.ply");
        let output =
            Command::new(&python).args(["-c", READ_USD, &place.text(file), &place.text(&ply)]).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let lights = String::from_utf8(output.stdout).unwrap();
        assert_eq!(lights.trim(), "SphereLight SphereLight SphereLight DomeLight", "{file}");
        let found = psnr(&image(&place, &ply), &original);
        println!("{file}: {found:.1} dB");
        assert!(found >= 80.0, "{file}: {found} dB");
    }
}
