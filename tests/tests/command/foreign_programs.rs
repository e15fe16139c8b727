//! SPZ, SOG, `.splat` and compressed glTF, opened by programs of others.
//!
//! npm installs both programs where node and npm are there. PlayCanvas splat-transform has its own decoders of SPZ, SOG
//! and `.splat`. Niantic's SPZ library (`@adobe/spz`) also turns the axes of SPZ to those of glTF. Each program returns
//! all splats as numbers. Every number is compared with the source; the bound is half a step of the format.

use serde_json::Value;
use sgs_scene::Splats;
use sgs_tests::Place;
use sgs_tests::cli::sgs;
use sgs_tests::foreign::sample;
use sgs_tests::rooms::Room;
use std::collections::BTreeMap;
use std::f64::consts::SQRT_2;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

/// Packages of npm, their versions, and a file of each.
const PACKAGES: &[(&str, &str, &str)] = &[
    ("@playcanvas/splat-transform", "3.7.0", "bin/cli.mjs"),
    // Of Niantic and Adobe, compiled from Niantic's C++.
    ("@adobe/spz", "0.2.3", "dist/spz.js"),
];

/// Decodes SPZ, also inside glTF, with Niantic's library. Writes a PLY beside each file.
const DECODE_SPZ: &str = r#"
import createSpz from "@adobe/spz";
import fs from "node:fs";
import path from "node:path";
const spz = await createSpz();
const payload = (file) => {
    const bytes = fs.readFileSync(file), binary = bytes.toString("latin1", 0, 4) === "glTF";
    const length = binary ? bytes.readUInt32LE(12) : 0;
    const json = JSON.parse(binary ? bytes.subarray(20, 20 + length) : bytes);
    const splats = json.meshes[0].primitives[0].extensions.KHR_gaussian_splatting;
    const view = json.bufferViews[splats.extensions.KHR_gaussian_splatting_compression_spz_2.bufferView];
    const beside = () => fs.readFileSync(path.join(path.dirname(file), json.buffers[view.buffer].uri));
    return (binary ? bytes.subarray(28 + length) : beside()).subarray(view.byteOffset ?? 0).subarray(0, view.byteLength);
};
for (const file of process.argv.slice(1)) {
    // Right, up, back are the axes of SPZ; left, up, front are those of glTF.
    const [bytes, axes] = file.endsWith(".spz") ? [fs.readFileSync(file), "RUB"] : [payload(file), "LUF"];
    const cloud = spz.loadSpzFromBuffer(new Uint8Array(bytes), { to: spz.CoordinateSystem[axes] });
    const count = cloud.numPoints, wide = [0, 3, 8, 15][cloud.shDegree];
    const names = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2"];
    for (let i = 0; i < 3 * wide; i++) names.push(`f_rest_${i}`);
    names.push("opacity", "scale_0", "scale_1", "scale_2", "rot_1", "rot_2", "rot_3", "rot_0");
    const rows = [], three = (values, i) => values.slice(3 * i, 3 * i + 3);
    for (let i = 0; i < count; i++) {
        rows.push(...three(cloud.positions, i), ...three(cloud.colors, i));
        for (let c = 0; c < 3; c++) for (let k = 0; k < wide; k++) rows.push(cloud.sh[3 * (i * wide + k) + c]);
        rows.push(cloud.alphas[i], ...three(cloud.scales, i), ...cloud.rotations.slice(4 * i, 4 * i + 4));
    }
    const properties = names.map((name) => `property float ${name}\n`).join("");
    const head = `ply\nformat binary_little_endian 1.0\nelement vertex ${count}\n${properties}end_header\n`;
    fs.writeFileSync(`${file}.ply`, Buffer.concat([Buffer.from(head), Buffer.from(new Float32Array(rows).buffer)]));
}
"#;

/// Installs the programs below the target directory.
///
/// Returns `None` if node or npm is missing, npm does not install a package, or node is too old for splat-transform.
fn programs() -> Option<&'static Path> {
    static FOLDER: OnceLock<Option<PathBuf>> = OnceLock::new();
    let install = || {
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("splat-programs");
        let file = |(name, _, file): &(&str, &str, &str)| folder.join("node_modules").join(name).join(file);
        if !PACKAGES.iter().all(|package| file(package).is_file()) {
            std::fs::create_dir_all(&folder).ok()?;
            let mut npm = Command::new("npm");
            // The engine of PlayCanvas is a peer that the program does not load.
            npm.args(["install", "--no-audit", "--no-fund", "--ignore-scripts", "--legacy-peer-deps", "--prefix"]);
            npm.arg(&folder).args(PACKAGES.iter().map(|(name, version, _)| format!("{name}@{version}")));
            npm.output().ok().filter(|output| output.status.success())?;
        }
        let version = Command::new("node").arg(file(&PACKAGES[0])).arg("--version").output().ok()?;
        version.status.success().then_some(folder)
    };
    FOLDER.get_or_init(install).as_deref()
}

/// Converts a file to a PLY beside it with splat-transform.
fn transform(folder: &Path, place: &Place, file: &str) {
    let (name, _, program) = PACKAGES[0];
    let program = folder.join("node_modules").join(name).join(program);
    let (from, to) = (place.text(file), place.text(&format!("{file}.ply")));
    let output = Command::new("node").arg(program).args(["--quiet", "--overwrite", &from, &to]).output().unwrap();
    assert!(output.status.success(), "{file}: {}", String::from_utf8_lossy(&output.stderr));
}

/// Rule by which a format stores a number.
enum Rule {
    /// Nearest multiple of a step. Step 0 keeps the number.
    Step(f64),
    /// 16 bits of a range of this width, after `sign(v) ln(1 + |v|)`.
    Logarithm(f64),
    /// Nearest of these numbers.
    Codebook(Vec<f64>),
}

impl Rule {
    /// Returns the largest error of a number.
    fn bound(&self, v: f64) -> f64 {
        match self {
            Rule::Step(step) => 0.5 * step,
            Rule::Logarithm(width) => (1.0 + v.abs()) * (0.5 * width / 65_535.0).exp_m1(),
            Rule::Codebook(all) => {
                let near = all.iter().map(|c| (c - v).abs()).fold(f64::INFINITY, f64::min);
                let [low, high] = [all.iter().copied().fold(v, f64::min), all.iter().copied().fold(v, f64::max)];
                // 256 numbers that follow the density of the values: twice the spacing of even ones.
                assert!(near <= (high - low) / 128.0, "no entry of the codebook is near {v}: {near}");
                near
            }
        }
    }
}

/// Way in which a format stores a rotation.
enum Rotation {
    /// Three components in steps. The fourth follows from the length 1: w, or the largest if `w` is false.
    Three { step: f64, w: bool },
    /// Four components in bytes `128 + 128 v`.
    Bytes,
}

/// Rules of a format.
struct Rules {
    positions: [Rule; 3],
    scales: Rule,
    colors: Rule,
    harmonics: Rule,
    rotation: Rotation,
    /// Whether splats keep their order.
    ordered: bool,
}

impl Rules {
    /// Returns the rules of SPZ for positions below 8.
    ///
    /// These have 20 fractional bits.
    fn spz(version: u32) -> Rules {
        let step = if version == 2 { 1.0 / 127.5 } else { 1.0 / (511.0 * SQRT_2) };
        Rules {
            positions: [(); 3].map(|()| Rule::Step(0.5_f64.powi(20))),
            scales: Rule::Step(1.0 / 16.0),
            colors: Rule::Step(1.0 / (255.0 * 0.15)),
            harmonics: Rule::Step(1.0 / 128.0),
            rotation: Rotation::Three { step, w: version == 2 },
            ordered: true,
        }
    }

    fn dot_splat() -> Rules {
        Rules {
            positions: [(); 3].map(|()| Rule::Step(0.0)),
            scales: Rule::Step(0.0),
            colors: Rule::Step(1.0 / (255.0 * f64::from(sgs_scene::SH_C0))),
            harmonics: Rule::Step(0.0),
            rotation: Rotation::Bytes,
            ordered: true,
        }
    }

    /// Returns the rules of SOG with the ranges and codebooks of a `meta.json`.
    fn sog(meta: &Path) -> Rules {
        let meta: Value = serde_json::from_slice(&std::fs::read(meta).unwrap()).unwrap();
        let numbers = |v: &Value| -> Vec<f64> { v.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect() };
        let [low, high] = ["mins", "maxs"].map(|end| numbers(&meta["means"][end]));
        let codebook = |name: &str| Rule::Codebook(numbers(&meta[name]["codebook"]));
        Rules {
            positions: [0, 1, 2].map(|k| Rule::Logarithm(high[k] - low[k])),
            scales: codebook("scales"),
            colors: codebook("sh0"),
            harmonics: if meta["shN"].is_null() { Rule::Step(0.0) } else { codebook("shN") },
            rotation: Rotation::Three { step: SQRT_2 / 255.0, w: false },
            ordered: false,
        }
    }
}

/// Comparison of the splats of a file with their source.
struct Comparison<'a> {
    name: &'a str,
    /// Largest errors.
    worst: BTreeMap<&'static str, f64>,
}

impl Comparison<'_> {
    fn near(&mut self, what: &'static str, expected: f64, found: f64, bound: f64) {
        let error = (expected - found).abs();
        // The programs compute with 32-bit floats.
        let rounding = 2.0 * f64::from(f32::EPSILON) * expected.abs().max(1.0);
        let name = self.name;
        assert!(error <= bound + rounding, "{name}: {what} is {found}, not {expected}: {error:e} above {bound:e}");
        let worst = self.worst.entry(what).or_default();
        *worst = worst.max(error);
    }

    fn rotation(&mut self, rule: &Rotation, expected: [f32; 4], found: [f32; 4]) {
        let [expected, mut found] = [expected, found].map(|q| q.map(f64::from));
        let length = |q: [f64; 4]| q.iter().map(|v| v * v).sum::<f64>().sqrt();
        let unit = expected.map(|v| v / length(expected));
        if unit.iter().zip(found).map(|(a, b)| a * b).sum::<f64>() < 0.0 {
            found = found.map(|v| -v);
        }
        match rule {
            Rotation::Three { step, w } => {
                let larger = |a: &usize, b: &usize| unit[*a].abs().total_cmp(&unit[*b].abs());
                let derived = if *w { 0 } else { (0..4).max_by(larger).unwrap() };
                for k in (0..4).filter(|k| *k != derived) {
                    self.near("rotation", unit[k], found[k], 0.5 * step);
                }
                // The other three are off by `off`, and the squares of all four add up to 1.
                let off = 3_f64.sqrt() * 0.5 * step;
                let [a, b] = [unit[derived], found[derived]].map(|v| v * v.abs());
                self.near("signed square of the derived component", a, b, (2.0 + off) * off);
            }
            Rotation::Bytes => {
                // The program reads a byte b as 2b/255 - 1. Apart from a common factor, which the length 1 removes, a
                // component is off by half a step of rounding and half a step between the maps, and the vector of four
                // by twice their sum.
                let length = length(found);
                (0..4).for_each(|k| self.near("rotation", unit[k], found[k] / length, 2.0 / 127.5));
            }
        }
    }

    /// Compares all splats. Every splat of the file belongs to one of the source.
    fn splats(&mut self, rules: &Rules, expected: &Splats, found: &Splats) {
        let (n, degree) = (expected.len(), expected.sh_degree());
        assert_eq!((found.len(), found.sh_degree()), (n, degree), "{}", self.name);
        let mut free = vec![true; n];
        for i in 0..n {
            let away =
                |j: usize| -> f32 { expected.means[i].iter().zip(found.means[j]).map(|(a, b)| (a - b).powi(2)).sum() };
            let nearest = || (0..n).min_by(|a, b| away(*a).total_cmp(&away(*b))).unwrap();
            let j = if rules.ordered { i } else { nearest() };
            assert!(std::mem::replace(&mut free[j], false), "{}: splat {j} belongs to two", self.name);
            for k in 0..3 {
                let [a, b] = [expected.means[i][k], found.means[j][k]].map(f64::from);
                self.near("position", a, b, rules.positions[k].bound(a));
                let [a, b] = [expected.log_scales[i][k], found.log_scales[j][k]].map(f64::from);
                self.near("scale", a, b, rules.scales.bound(a));
            }
            let [a, b] =
                [expected.opacity_logits[i], found.opacity_logits[j]].map(|v| 1.0 / (1.0 + (-f64::from(v)).exp()));
            self.near("opacity", a, b, 0.5 / 255.0);
            self.rotation(&rules.rotation, expected.rotations[i], found.rotations[j]);
            for band in 0..=degree {
                let wide = 3 * (2 * band + 1);
                let (what, rule) = if band == 0 { ("color", &rules.colors) } else { ("harmonic", &rules.harmonics) };
                for k in 0..wide {
                    let [a, b] = [expected.sh[band][i * wide + k], found.sh[band][j * wide + k]].map(f64::from);
                    self.near(what, a, b, rule.bound(a));
                }
            }
        }
    }
}

fn compare(name: &str, rules: &Rules, expected: &Splats, file: &Path) {
    let mut comparison = Comparison { name, worst: BTreeMap::new() };
    comparison.splats(rules, expected, &Splats::read_ply(file).unwrap());
    println!("{name}: {:.7?}", comparison.worst);
}

/// Degrees of the harmonics and the factors of `--scale`.
///
/// With a factor, SPZ of version 4 and SOG record a transform that other programs have to skip.
const CASES: [(usize, f32); 4] = [(0, 1.0), (1, 2.0), (2, 1.0), (3, 1.0)];

/// Writes `a.ply`, 400 splats of a degree. Returns them, and as `--scale` changes them.
fn source(place: &Place, degree: usize, scale: f32) -> [Splats; 2] {
    let mut splats = sample(400);
    // Opacities of a trained scene: far from the ends, where a byte says little about a logit.
    splats.opacity_logits.iter_mut().for_each(|v| *v *= 0.25);
    (splats.normals, splats.albedo, splats.roughness) = (None, None, None);
    (splats.metallic, splats.semantic) = (None, None);
    (degree + 1..4).for_each(|band| splats.sh[band].clear());
    splats.write_ply(&place.path("a.ply")).unwrap();
    let mut scaled = splats.clone();
    scaled.means.iter_mut().flatten().for_each(|v| *v *= scale);
    scaled.log_scales.iter_mut().flatten().for_each(|v| *v += scale.ln());
    [splats, scaled]
}

fn export(place: &Place, file: &str, format: &str, scale: f32) {
    let scale = scale.to_string();
    sgs(&["export", &place.text("a.ply"), "-o", &place.text(file), "--format", format, "--scale", &scale]).ok();
}

#[test]
fn splat_transform_reads_every_number_of_spz_sog_and_splat() {
    let Some(folder) = programs() else {
        println!("left out: node or npm is missing, or npm installs no splat-transform");
        return;
    };
    let place = Place::new(Room::default());
    std::fs::create_dir(place.path("folder")).unwrap();
    for (degree, scale) in CASES {
        let [_, scaled] = source(&place, degree, scale);
        let mut flat = scaled.clone();
        (1..4).for_each(|band| flat.sh[band].clear());
        let check = |format: &str, file: &str, expected: &Splats| {
            export(&place, file, format, scale);
            transform(folder, &place, file);
            let rules = match format {
                "sog" => Rules::sog(&place.path("folder/meta.json")),
                "splat" => Rules::dot_splat(),
                "spz2" => Rules::spz(2),
                _ => Rules::spz(4),
            };
            let ply = place.path(&format!("{file}.ply"));
            compare(&format!("{file} of degree {degree}"), &rules, expected, &ply);
        };
        check("spz", "a.spz", &scaled);
        check("spz3", "a3.spz", &scaled);
        check("spz2", "a2.spz", &scaled);
        check("splat", "a.splat", &flat);
        // The archive has the codebooks of the directory.
        check("sog", "folder/meta.json", &scaled);
        check("sog", "a.sog", &scaled);
    }
}

#[test]
fn niantic_library_reads_every_number_of_spz_and_compressed_gltf() {
    let Some(folder) = programs() else {
        println!("left out: node or npm is missing, or npm installs no @adobe/spz");
        return;
    };
    let place = Place::new(Room::default());
    for (degree, scale) in CASES {
        let [splats, scaled] = source(&place, degree, scale);
        // In glTF, a node above the splats holds the scale.
        let files = [
            ("spz", "a.spz", Rules::spz(4), &scaled),
            ("spz3", "a3.spz", Rules::spz(3), &scaled),
            ("spz2", "a2.spz", Rules::spz(2), &scaled),
            ("glb-spz", "a.glb", Rules::spz(2), &splats),
            ("gltf-spz", "a.gltf", Rules::spz(2), &splats),
        ];
        files.iter().for_each(|(format, file, ..)| export(&place, file, format, scale));
        let mut node = Command::new("node");
        node.args(["--input-type=module", "-e", DECODE_SPZ, "--"]).args(files.iter().map(|file| place.text(file.1)));
        let output = node.current_dir(folder).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        for (_, file, rules, expected) in &files {
            compare(&format!("{file} of degree {degree}"), rules, expected, &place.path(&format!("{file}.ply")));
        }
    }
}
