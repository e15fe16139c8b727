//! USD files, read by OpenUSD's Python package (`pip install usd-core`).
//!
//! `SGS_TEST_USD_PYTHON` names an interpreter that has the package; otherwise it is `python3`.

use sgs_scene::{Placement, Splats, UsdLight, UsdShape, write_usd};
use std::path::Path;
use std::process::Command;

/// Opens a file and prints what it finds, one value a line.
const READ: &str = r#"
import sys
from pxr import Usd, UsdGeom, UsdLux
stage = Usd.Stage.Open(sys.argv[1])
prim = stage.GetDefaultPrim().GetChild("Splats")
known = set(Usd.SchemaRegistry().FindConcretePrimDefinition("ParticleField3DGaussianSplat").GetPropertyNames())
assert prim.GetTypeName() == "ParticleField3DGaussianSplat"
assert all(a.GetName() in known or a.GetName().startswith("primvars:") for a in prim.GetAuthoredAttributes())
flat = lambda v: [c for row in v for c in (row if hasattr(row, "__len__") else [row])]
show = lambda name, values: print(name, *[repr(float(v)) for v in values])
get = lambda name: prim.GetAttribute(name).Get()
show("means", flat(get("positions")))
show("scales", flat(get("scales")))
show("opacities", get("opacities"))
show("rotations", flat([[q.GetReal(), *q.GetImaginary()] for q in get("orientations")]))
show("sh", flat(get("radiance:sphericalHarmonicsCoefficients")))
print("degree", get("radiance:sphericalHarmonicsDegree"))
for name in ("albedo", "roughness", "metallic", "normal"):
    primvar = UsdGeom.PrimvarsAPI(prim).GetPrimvar(name)
    assert primvar.GetInterpolation() == "vertex", name
    show(name, flat(primvar.Get()))
assert UsdGeom.GetStageUpAxis(stage) == "Y"
for light in (p for p in stage.Traverse() if p.HasAPI(UsdLux.LightAPI)):
    place = UsdGeom.Xformable(light).ComputeLocalToWorldTransform(Usd.TimeCode.Default())
    along = place.TransformDir((0, 0, -1)).GetNormalized()
    print("light", light.GetTypeName(), *[round(v, 5) + 0.0 for v in (*place.ExtractTranslation(), *along)])
"#;

fn sample() -> Splats {
    let wave = |k: usize, step: f64| (0..k).map(|i| (step * i as f64).sin() as f32).collect::<Vec<f32>>();
    let n = 7;
    Splats {
        means: wave(3 * n, 1.7).as_chunks::<3>().0.to_vec(),
        log_scales: wave(3 * n, 2.3).as_chunks::<3>().0.to_vec(),
        rotations: wave(4 * n, 0.9).as_chunks::<4>().0.to_vec(),
        opacity_logits: wave(n, 3.1),
        sh: std::array::from_fn(|d| if d <= 2 { wave(n * 3 * (2 * d + 1), 1.1 + d as f64) } else { Vec::new() }),
        normals: Some(wave(3 * n, 0.3).as_chunks::<3>().0.to_vec()),
        albedo: Some(wave(3 * n, 0.4).as_chunks::<3>().0.to_vec()),
        roughness: Some(wave(n, 0.5)),
        metallic: Some(wave(n, 0.6)),
        ..Splats::default()
    }
}

#[test]
fn openusd_reads_every_number() {
    let python = std::env::var("SGS_TEST_USD_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let probe = "from pxr import UsdVol; UsdVol.ParticleField3DGaussianSplat";
    if !Command::new(&python).args(["-c", probe]).output().is_ok_and(|o| o.status.success()) {
        println!("left out: {python} has no OpenUSD of version 26.03 or later (pip install usd-core)");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let map = folder.path().join("a.environment.exr");
    let image = sgs_scene::Image::from_data(4, 2, 3, vec![0.5; 24]).unwrap();
    sgs_scene::write_exr(&map, &image, &["R", "G", "B"]).unwrap();
    let light = |name: &str, shape| UsdLight { name: name.to_owned(), shape, color: [4.0, 2.0, 0.0] };
    let (position, axis) = ([1.0, 2.0, 3.0], [0.0, 0.0, 2.0]);
    let lights = [
        light("lamp", UsdShape::Sphere { center: position, radius: 0.1, point: true }), // language: quoted
        light("the \"spot\"", UsdShape::Spot { position, axis, radius: 0.01, inner_angle: 0.2, outer_angle: 0.4 }),
        light("sun", UsdShape::Directional { direction: axis, angular_radius: 0.005 }),
        light("", UsdShape::Disk { center: position, normal: axis, radius: 1.0 }),
        light("pane", UsdShape::Rectangle { corner: [0.0; 3], edge_u: [2.0, 0.0, 0.0], edge_v: [0.0, 4.0, 0.0] }),
    ];
    // Twice as large, and y becomes z.
    let half = std::f64::consts::FRAC_1_SQRT_2;
    let transform = Placement { scale: 2.0, rotation: [half, half, 0.0, 0.0], translation: [0.0, 0.0, 1.0] };
    for name in ["a.usda", "a.usdz"] {
        let path = folder.path().join(name);
        write_usd(&path, &sample(), &lights, Some(&map), Some(&transform)).unwrap();
        check(&python, &path);
    }
}

fn check(python: &str, path: &Path) {
    let output = Command::new(python).args(["-c", READ]).arg(path).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8(output.stdout).unwrap();
    let line = |name: &str| text.lines().find_map(|l| l.strip_prefix(name)?.strip_prefix(' ')).unwrap();
    let near = |name: &str, expected: Vec<f64>| {
        let found: Vec<f64> = line(name).split(' ').map(|v| v.parse().unwrap()).collect();
        assert_eq!(found.len(), expected.len(), "{name}");
        assert!(found.iter().zip(&expected).all(|(a, b)| (a - b).abs() < 1e-6), "{name}: {found:?} {expected:?}");
    };
    let s = sample();
    let all = |v: &[f32]| v.iter().map(|v| f64::from(*v)).collect::<Vec<f64>>();
    let logistic = |v: &f32| 1.0 / (1.0 + (-f64::from(*v)).exp());
    near("means", all(s.means.as_flattened()));
    near("scales", all(s.log_scales.as_flattened()).iter().map(|v| v.exp()).collect());
    near("opacities", s.opacity_logits.iter().map(logistic).collect());
    let unit = |q: &[f32; 4]| {
        let length = q.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>().sqrt();
        q.map(|v| f64::from(v) / length)
    };
    near("rotations", s.rotations.iter().flat_map(unit).collect());
    let row =
        |i: usize| [&s.sh[0][3 * i..3 * i + 3], &s.sh[1][9 * i..9 * i + 9], &s.sh[2][15 * i..15 * i + 15]].concat();
    near("sh", all(&(0..s.len()).flat_map(row).collect::<Vec<f32>>()));
    assert_eq!(line("degree"), "2");
    near("normal", all(s.normals.unwrap().as_flattened()));
    near("albedo", s.albedo.unwrap().as_flattened().iter().map(|v| 0.01 + 0.98 * logistic(v)).collect());
    near("roughness", s.roughness.unwrap().iter().map(|v| 0.09 + 0.9 * logistic(v)).collect());
    near("metallic", s.metallic.unwrap().iter().map(logistic).collect());
    let lights: Vec<&str> = text.lines().filter_map(|l| l.strip_prefix("light ")).collect();
    // (1, 2, 3) is turned to (1, -3, 2), doubled, and raised by 1. Axis z becomes -y.
    assert_eq!(
        lights,
        [
            "SphereLight 2.0 -6.0 5.0 0.0 1.0 0.0",
            "SphereLight 2.0 -6.0 5.0 0.0 -1.0 0.0",
            "DistantLight 0.0 0.0 1.0 0.0 -1.0 0.0",
            "DiskLight 2.0 -6.0 5.0 0.0 -1.0 0.0",
            "RectLight 2.0 0.0 5.0 0.0 -1.0 0.0",
            "DomeLight 0.0 0.0 1.0 0.0 -1.0 0.0",
        ],
        "{}",
        path.display()
    );
}
