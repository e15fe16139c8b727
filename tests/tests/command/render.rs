//! `sgs render` of a PLY of another program. Pixels are compared with the reference in double precision.

use glam::{DMat3, DVec2, DVec3};
use sgs_passes::reference::blend::{Blended, render};
use sgs_passes::reference::project::{Camera, Gaussians};
use sgs_scene::{Image, read_exr};
use sgs_tests::cli::sgs;
use sgs_tests::rooms::{transforms, write_json};
use sgs_tests::scenes;
use std::path::Path;

/// Writes a PLY like the original implementation of Gaussian splatting. The file is binary and every number a float.
/// Higher bands of spherical harmonics are stored as all red, then all green, then all blue coefficients. This writer
/// follows that description and is independent of the project's writer.
fn write_ply(path: &Path, g: &Gaussians) {
    let bands = g.sh.iter().rposition(|b| !b.is_empty()).unwrap_or(0);
    let rest = (bands + 1).pow(2) - 1;
    let mut names: Vec<String> = ["x", "y", "z", "nx", "ny", "nz"].map(String::from).to_vec();
    names.extend((0..3).map(|i| format!("f_dc_{i}")));
    names.extend((0..3 * rest).map(|i| format!("f_rest_{i}")));
    names.push("opacity".into());
    names.extend((0..3).map(|i| format!("scale_{i}")));
    names.extend((0..4).map(|i| format!("rot_{i}")));
    let mut bytes = format!("ply\nformat binary_little_endian 1.0\nelement vertex {}\n", g.len()).into_bytes();
    names.iter().for_each(|n| bytes.extend(format!("property float {n}\n").bytes()));
    bytes.extend(b"end_header\n");
    for i in 0..g.len() {
        let mut row = g.means[3 * i..3 * i + 3].to_vec();
        row.extend(if g.normals.is_empty() { &[0.0; 3] } else { &g.normals[3 * i..3 * i + 3] });
        row.extend(&g.sh[0][3 * i..3 * i + 3]);
        for color in 0..3 {
            for band in 1..=bands {
                let count = 2 * band + 1;
                row.extend((0..count).map(|k| g.sh[band][3 * (count * i + k) + color]));
            }
        }
        row.push(g.opacity_logits[i]);
        row.extend(&g.log_scales[3 * i..3 * i + 3]);
        row.extend(&g.rotations[4 * i..4 * i + 4]);
        assert_eq!(row.len(), names.len());
        bytes.extend(row.iter().flat_map(|v| (*v as f32).to_le_bytes()));
    }
    std::fs::write(path, bytes).unwrap();
}

/// Converts a camera of the reference to a camera of the file.
fn stored(name: &str, c: &Camera) -> sgs_scene::Camera {
    sgs_scene::Camera {
        name: name.into(),
        width: c.size[0],
        height: c.size[1],
        fx: c.focal.x,
        fy: c.focal.y,
        cx: c.center.x,
        cy: c.center.y,
        rotation: c.rotation,
        translation: c.translation,
        near: sgs_scene::NEAR,
    }
}

/// Removes the splats that the reader refuses: those with a zero quaternion.
fn without_zero_quaternions(mut g: Gaussians) -> Gaussians {
    let mut i = 0;
    while i < g.len() {
        if g.rotations[4 * i..4 * i + 4].iter().any(|v| *v != 0.0) {
            i += 1;
            continue;
        }
        g.means.drain(3 * i..3 * i + 3);
        g.log_scales.drain(3 * i..3 * i + 3);
        g.rotations.drain(4 * i..4 * i + 4);
        g.opacity_logits.remove(i);
        for band in 0..4 {
            let width = 3 * (2 * band + 1);
            if !g.sh[band].is_empty() {
                g.sh[band].drain(width * i..width * (i + 1));
            }
        }
    }
    g
}

/// Images that `sgs render` wrote for one camera.
struct Renderings {
    rgb: Image,
    alpha: Image,
    depth: Image,
    normal: Option<Image>,
}

/// Renders with `sgs render`; fails if any value is not finite.
fn rendered(g: &Gaussians, cameras: &[(&str, Camera)], background: [f64; 3]) -> Vec<Renderings> {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    write_ply(&folder.path().join("made elsewhere.ply"), g);
    let list: Vec<_> = cameras.iter().map(|(name, c)| stored(name, c)).collect();
    write_json(&folder.path().join("cameras.json"), &transforms(&list));
    let normals = !g.normals.is_empty();
    let channels = if normals { "rgb,alpha,depth,normal" } else { "rgb,alpha,depth" };
    let [r, green, b] = background;
    sgs(&[
        "render",
        &path("made elsewhere.ply"),
        "--cameras",
        &path("cameras.json"),
        "-o",
        &path("out"),
        "--channels",
        channels,
        "--format",
        "exr",
        "--background",
        &format!("{r},{green},{b}"),
    ])
    .ok();
    let read = |name: &str, channel: &str, c: &Camera| {
        let image = read_exr(&folder.path().join(format!("out/{name}_{channel}.exr"))).unwrap().image;
        assert_eq!([image.width, image.height], c.size);
        let bad = image.data.iter().filter(|v| !v.is_finite()).count();
        assert_eq!(bad, 0, "{name}_{channel} holds numbers that are not finite");
        image
    };
    cameras
        .iter()
        .map(|(name, c)| Renderings {
            rgb: read(name, "rgb", c),
            alpha: read(name, "alpha", c),
            depth: read(name, "depth", c),
            normal: normals.then(|| read(name, "normal", c)),
        })
        .collect()
}

/// Returns the largest difference at conclusive pixels and the PSNR. The PSNR is that of color over all pixels.
fn difference(p: &Renderings, truth: &Blended) -> (f64, f64) {
    let channels = 5 + if p.normal.is_some() { 3 } else { 0 };
    let (mut largest, mut square) = (0.0_f64, 0.0);
    for (at, doubtful) in truth.doubtful.iter().enumerate() {
        let expected = &truth.image[at * channels..(at + 1) * channels];
        let mut worst = 0.0_f64;
        for c in 0..3 {
            let d = f64::from(p.rgb.data[3 * at + c]) - expected[c];
            square += d * d;
            worst = worst.max(d.abs());
        }
        worst = worst.max((f64::from(p.alpha.data[at]) - (1.0 - truth.transmittance[at])).abs());
        if let Some(normal) = &p.normal {
            for c in 0..3 {
                worst = worst.max((f64::from(normal.data[3 * at + c]) - expected[3 + c]).abs());
            }
        }
        let depth = expected[channels - 2];
        worst = worst.max((f64::from(p.depth.data[at]) - depth).abs() / depth.abs().max(1.0));
        if !doubtful {
            largest = largest.max(worst);
        }
    }
    let mean = square / (3 * truth.doubtful.len()) as f64;
    (largest, -10.0 * mean.log10())
}

/// Returns cameras of several sizes, one upside down. No principal point is central.
fn cameras() -> Vec<(&'static str, Camera)> {
    let ahead = scenes::camera([160, 120]);
    let aside = Camera {
        rotation: DMat3::from_euler(glam::EulerRot::XYZ, -0.1, 0.35, std::f64::consts::PI),
        translation: DVec3::new(-0.4, 0.3, 0.9),
        focal: DVec2::new(70.0, 95.0),
        center: DVec2::new(20.5, 71.25),
        size: [97, 61],
        near: 0.01,
        radial: 0.0,
    };
    let outside = Camera { center: DVec2::new(-30.0, 12.0), size: [33, 130], ..ahead };
    vec![("ahead", ahead), ("aside", aside), ("outside", outside)]
}

#[test]
fn imported_hard_splats_match_reference() {
    let background = [0.2, 0.5, 0.8];
    for (seed, normals) in [(1, true), (2, false)] {
        let mut g = without_zero_quaternions(scenes::hard(seed));
        if normals {
            let mut r = scenes::Rng::new(99);
            g.normals = (0..3 * g.len()).map(|_| f64::from(r.between(-2.0, 2.0) as f32)).collect();
        }
        let cameras = cameras();
        for ((name, camera), images) in cameras.iter().zip(rendered(&g, &cameras, background)) {
            let truth = render(&g, camera, 3, true, background);
            let (largest, psnr) = difference(&images, &truth);
            let doubtful = truth.doubtful.iter().filter(|d| **d).count();
            let seen = truth.transmittance.iter().filter(|t| **t < 0.9).count();
            println!(
                "{seed} {name}: largest {largest:.2e}, PSNR {psnr:.1}, {doubtful} doubtful of {}",
                truth.doubtful.len()
            );
            assert!(2 * doubtful < truth.doubtful.len() && 5 * seen > truth.doubtful.len(), "{name} shows too little");
            assert!(largest < 2e-3, "{seed} {name}: largest difference {largest}");
            assert!(psnr > 65.0, "{seed} {name}: PSNR {psnr}");
        }
    }
}

/// Tests that the comparison detects a splat that is moved by 0.05.
#[test]
fn a_planted_error_is_caught() {
    let g = scenes::ordinary(40, 1, false, 3);
    let cameras = [("a", scenes::camera([32, 24]))];
    let images = rendered(&g, &cameras, [0.0; 3]);
    let truth = render(&g, &cameras[0].1, 1, true, [0.0; 3]);
    assert!(difference(&images[0], &truth).0 < 2e-3);
    let mut moved = g.clone();
    moved.means[0] += 0.05;
    assert!(difference(&images[0], &render(&moved, &cameras[0].1, 1, true, [0.0; 3])).0 > 2e-3);
}

/// Tests that colors outside the range of a display are not clamped.
#[test]
fn values_are_not_clamped() {
    let mut g = scenes::ordinary(1, 0, false, 1);
    g.means = vec![0.0, 0.0, 2.0];
    g.log_scales = vec![1.0; 3];
    g.opacity_logits = vec![20.0];
    g.sh[0] = vec![30.0, 0.0, -30.0];
    let camera = Camera {
        rotation: DMat3::IDENTITY,
        translation: DVec3::ZERO,
        focal: DVec2::splat(20.0),
        center: DVec2::new(10.0, 8.0),
        size: [20, 16],
        near: 0.01,
        radial: 0.0,
    };
    let p = &rendered(&g, &[("a", camera)], [0.0, 2.0, -1.0])[0];
    let middle = 3 * (8 * 20 + 10);
    let found = [0, 1, 2].map(|c| f64::from(p.rgb.data[middle + c]));
    // Opacity is limited to 0.99.
    let red = 0.99 * (0.5 + 30.0 * 0.282_094_791_773_878_1);
    for (f, e) in found.into_iter().zip([red, 0.99 * 0.5 + 0.02, -0.01]) {
        assert!((f - e).abs() < 1e-3 * e.abs().max(1.0), "{found:?}");
    }
}

#[test]
fn one_splat_covers_the_whole_image() {
    let size = [640, 480];
    let camera = scenes::camera(size);
    let mut g = scenes::ordinary(1, 3, false, 5);
    g.means = vec![0.3, -0.2, 3.0];
    g.log_scales = vec![0.5_f32, 1.0, 0.25].into_iter().map(f64::from).collect();
    g.opacity_logits = vec![1.5];
    let background = [1.0, 0.25, 0.0];
    let p = &rendered(&g, &[("a", camera)], background)[0];
    let truth = render(&g, &camera, 3, true, background);
    let (largest, psnr) = difference(p, &truth);
    println!("largest {largest:.2e}, PSNR {psnr:.1}");
    assert!(truth.transmittance.iter().all(|t| *t < 0.999), "the splat was to cover everything");
    assert!(largest < 2e-3 && psnr > 65.0, "largest {largest}, PSNR {psnr}");
}

/// Tests that many white splats on white stay white and show only in their tile.
#[test]
fn many_tiny_splats_in_one_tile() {
    render_many_splats(50_000, true);
    render_many_splats(1_000_000, false);
}

fn render_many_splats(count: usize, compared_with_reference: bool) {
    let size = [96, 64];
    let camera = Camera {
        rotation: DMat3::IDENTITY,
        translation: DVec3::ZERO,
        focal: DVec2::splat(80.0),
        center: DVec2::new(48.0, 32.0),
        size,
        near: 0.01,
        radial: 0.0,
    };
    let mut r = scenes::Rng::new(17);
    let mut g = Gaussians::default();
    for _ in 0..count {
        // Centers lie at pixels 36 to 44 on both axes, inside the tile from 32 to 48.
        let z = r.between(2.0, 40.0);
        let at = DVec2::new(r.between(36.0, 44.0), r.between(36.0, 44.0));
        let slope = (at - camera.center) / camera.focal;
        g.means.extend([slope.x * z, slope.y * z, z].map(|v| f64::from(v as f32)));
        g.log_scales.extend([-9.0; 3]);
        g.rotations.extend([1.0, 0.0, 0.0, 0.0]);
        g.opacity_logits.push(f64::from(r.between(-4.5, -1.0) as f32));
        g.sh[0].extend([0.5 / f64::from(0.282_094_8_f32); 3]);
    }
    let p = &rendered(&g, &[("a", camera)], [1.0; 3])[0];
    for (at, color) in p.rgb.data.chunks_exact(3).enumerate() {
        let [x, y] = [at % 96, at / 96];
        assert!(color.iter().all(|v| (v - 1.0).abs() < 1e-4), "{x}, {y}: {color:?}");
        let inside = (32..48).contains(&x) && (32..48).contains(&y);
        assert!(inside || p.alpha.data[at] == 0.0, "{x}, {y} lies outside, but shows {}", p.alpha.data[at]);
    }
    assert!(p.alpha.data[40 * 96 + 40] > 0.99, "the crowd is transparent");
    if compared_with_reference {
        let truth = render(&g, &camera, 0, true, [1.0; 3]);
        // Every pixel has splats at a threshold, so the weight of a single splat may differ.
        for (at, t) in truth.transmittance.iter().enumerate() {
            let d = (f64::from(p.alpha.data[at]) - (1.0 - t)).abs();
            assert!(d < 5e-3, "{at}: alpha differs by {d}");
            let depth = truth.image[5 * at + 3];
            let d = (f64::from(p.depth.data[at]) - depth).abs();
            assert!(d < 5e-3 * depth.max(1.0), "{at}: depth {depth} differs by {d}");
        }
    }
}
