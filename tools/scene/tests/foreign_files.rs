//! Splat files that another program wrote.
//!
//! `minimal.*` are fixtures of PlayCanvas splat-transform (foreign/LICENSE.txt): four splats on a grid, of scale 0.1 and
//! opacity 0.9, dark or bright in red and green. In the SPZ files of versions 3 and 4, z points back.
//! `wave.*` are what splat-transform 2.7.1 made of `wave.ply`, 24 splats of degree 1.

use sgs_scene::{GltfScene, SplatFile, Splats, read_ksplat, read_sog, read_splat, read_spz};
use std::path::PathBuf;

fn path(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/foreign").join(name)
}

fn check(name: &str, file: &SplatFile, color_step: f32, back: f32) -> Splats {
    let splats = &file.splats;
    splats.check().unwrap();
    assert_eq!((splats.len(), file.transform, &file.left_out), (4, None, &Vec::new()), "{name}");
    let near = |a: f32, b: f32, step: f32| assert!((a - b).abs() <= step, "{name}: {a} is not {b}");
    let corners = [[-1.0, -1.0], [0.0, -1.0], [-1.0, 0.0], [0.0, 0.0]];
    for (mean, [x, z]) in splats.means.iter().zip(corners) {
        assert_eq!(*mean, [x, 0.0, back * z], "{name}");
    }
    splats.log_scales.as_flattened().iter().for_each(|v| near(*v, 0.1_f32.ln(), 0.04));
    splats.opacity_logits.iter().for_each(|v| near(1.0 / (1.0 + (-v).exp()), 0.9, 0.002));
    // Red grows from column to column, green from row to row, and blue is one half.
    for (i, color) in splats.sh[0].as_chunks::<3>().0.iter().enumerate() {
        let sign = |high: usize| if high == 1 { 1.0 } else { -1.0 };
        let [red, green] = [sign(i % 2), sign(i / 2)];
        near(color[0], red * color[0].abs(), 0.0);
        near(color[1], green * color[1].abs(), 0.0);
        assert!(color[0].abs() > 0.3 && color[1].abs() > 0.3, "{name}: {color:?}");
        near(color[2], 0.0, color_step);
    }
    splats.clone()
}

#[test]
fn spz_of_every_version_is_read() {
    let read = |name: &str, back: f32| check(name, &read_spz(&path(name)).unwrap(), 0.02, back);
    assert_eq!(read("minimal-raw.spz", 1.0), read("minimal-v2.spz", 1.0));
    let [v3, v4] = ["minimal-v3.spz", "minimal-v4.spz"].map(|name| read(name, -1.0));
    assert_eq!(v3.means, v4.means);
}

#[test]
fn splat_files_are_read() {
    check("minimal.splat", &read_splat(&path("minimal.splat")).unwrap(), 0.01, 1.0);
}

#[test]
fn ksplat_files_are_read() {
    check("minimal.ksplat", &read_ksplat(&path("minimal.ksplat")).unwrap(), 0.01, 1.0);
}

/// Compares splats with those of `wave.ply` in any order. `turn` maps a mean of the PLY to the file; the signs are those
/// of the three coefficients of band 1, and `q` is the quaternion (w, x, y, z) of the turn.
fn compare(name: &str, found: &Splats, turn: [f32; 3], signs: [f32; 3], q: [f32; 4]) {
    let expected = Splats::read_ply(&path("wave.ply")).unwrap();
    found.check().unwrap();
    assert_eq!((found.len(), found.sh_degree()), (24, 1), "{name}");
    let near = |a: f32, b: f32, step: f32| assert!((a - b).abs() <= step, "{name}: {a} is not {b}");
    let opacity = |logit: f32| 1.0 / (1.0 + (-logit).exp());
    for i in 0..24 {
        let mean: [f32; 3] = std::array::from_fn(|k| turn[k] * expected.means[i][k]);
        let away = |j: usize| -> f32 { mean.iter().zip(found.means[j]).map(|(a, b)| (a - b).powi(2)).sum() };
        let j = (0..24).min_by(|a, b| away(*a).total_cmp(&away(*b))).unwrap();
        assert!(away(j).sqrt() < 1e-3, "{name}: {mean:?} {:?}", found.means[j]);
        (0..3).for_each(|k| near(found.log_scales[j][k], expected.log_scales[i][k], 0.04));
        near(opacity(found.opacity_logits[j]), opacity(expected.opacity_logits[i]), 0.004);
        (0..3).for_each(|k| near(found.sh[0][3 * j + k], expected.sh[0][3 * i + k], 0.02));
        // Palettes and few bits make harmonics coarse.
        (0..9).for_each(|k| near(found.sh[1][9 * j + k], signs[k / 3] * expected.sh[1][9 * i + k], 0.05));
        let [w, x, y, z] = expected.rotations[i];
        let [a, b, c, d] = q;
        let turned = [
            a * w - b * x - c * y - d * z,
            a * x + b * w + c * z - d * y,
            a * y - b * z + c * w + d * x,
            a * z + b * y - c * x + d * w,
        ];
        // Half a turn about a local axis leaves the ellipsoid as it is.
        let [w, x, y, z] = turned;
        let same = [[w, x, y, z], [-x, w, z, -y], [-y, -z, w, x], [-z, y, -x, w]];
        let dot = |q: &[f32; 4]| q.iter().zip(found.rotations[j]).map(|(a, b)| a * b).sum::<f32>().abs();
        assert!(same.iter().any(|q| dot(q) > 0.9999), "{name}: {turned:?} {:?}", found.rotations[j]);
    }
}

#[test]
fn sog_of_another_program_is_read() {
    let file = read_sog(&path("wave.sog")).unwrap();
    compare("wave.sog", &file.splats, [1.0; 3], [1.0; 3], [1.0, 0.0, 0.0, 0.0]);
}

#[test]
fn harmonics_of_another_program_turn_with_its_axes() {
    // SPZ has y up and z back.
    let file = read_spz(&path("wave.spz")).unwrap();
    compare("wave.spz", &file.splats, [1.0, -1.0, -1.0], [-1.0, -1.0, 1.0], [0.0, 1.0, 0.0, 0.0]);
    // The program turns glTF by half a turn about z.
    let scene = GltfScene::read(&path("wave.glb")).unwrap();
    let splats = scene.in_place().unwrap();
    compare("wave.glb", splats, [-1.0, -1.0, 1.0], [-1.0, 1.0, -1.0], [0.0, 0.0, 0.0, 1.0]);
}
