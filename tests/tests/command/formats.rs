//! Splat files of every format: the same image after a round trip, transforms, refusals.
//!
//! USD is read by OpenUSD's own Python package (`pip install usd-core`) where `python3`, or the interpreter that
//! `SGS_TEST_USD_PYTHON` names, has it.

use sgs_run::read_exchange;
use sgs_scene::{Camera, SplatFile, SplatKind, Splats, read_exr};
use sgs_tests::Place;
use sgs_tests::cli::{Finished, sgs};
use sgs_tests::foreign::{lights as foreign_lights, sample};
use sgs_tests::rooms::{Room, transforms, write_json};
use std::path::Path;
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
