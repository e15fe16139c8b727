//! Extreme inputs of rendering and training, one line and one test each; docs/EXTREMES.md lists them.
//!
//! Every line is rendered and held to the double-precision twin where that is sure of itself, then trained for three steps:
//! losses stay finite, and so do parameters that were.

use glam::{DMat3, DVec2, DVec3};
use sgs_passes::reference::blend::render;
use sgs_passes::reference::project::{Camera, Gaussians};
use sgs_tests::Gpu;
use sgs_tests::scenes::{self, Rng};
use sgs_tests::whole::{BACKGROUND, degree, picture, steps};

/// Largest difference from the twin.
const LARGEST: f64 = 5e-6;

/// A scene, its view, and what is special about the line.
struct Line {
    gaussians: Gaussians,
    camera: Camera,
    /// Where the twin's picture is compared; it tries every splat at every pixel.
    twin: Twin,
}

#[derive(Clone, Copy, PartialEq)]
enum Twin {
    /// Where it is sure of itself, which must be at half of the pixels.
    Sure,
    /// At every pixel: the line's depths and thresholds leave nothing to rounding.
    Everywhere,
    /// Nowhere: what is asked for has no bound.
    No,
}

fn line(gaussians: Gaussians) -> Line {
    Line { gaussians, camera: straight([48, 32], 60.0), twin: Twin::Sure }
}

/// A camera at the origin that looks along z, so many degrees wide.
fn straight(size: [u32; 2], width: f64) -> Camera {
    let [w, h] = size.map(f64::from);
    let focal = 0.5 * w / (0.5 * width.to_radians()).tan();
    Camera {
        rotation: DMat3::IDENTITY,
        translation: DVec3::ZERO,
        focal: DVec2::splat(focal),
        center: DVec2::new(0.5 * w, 0.5 * h),
        size,
        near: f64::from(0.01_f32),
    }
}

/// One more Gaussian.
fn add(g: &mut Gaussians, mean: [f64; 3], log_scale: [f64; 3], rotation: [f64; 4], logit: f64, color: [f64; 3]) {
    g.means.extend(mean.map(single));
    g.log_scales.extend(log_scale.map(single));
    g.rotations.extend(rotation.map(single));
    g.opacity_logits.push(single(logit));
    g.sh[0].extend(color.map(single));
}

fn single(v: f64) -> f64 {
    f64::from(v as f32)
}

const UNIT: [f64; 4] = [1.0, 0.0, 0.0, 0.0];
const RED: [f64; 3] = [1.2, -0.8, -0.4];
const BLUE: [f64; 3] = [-0.6, -0.2, 1.1];

/// Something to see around what is extreme.
fn ordinary() -> Gaussians {
    scenes::ordinary(40, 0, false, 11)
}

fn one(mean: [f64; 3], log_scale: [f64; 3], rotation: [f64; 4], logit: f64) -> Gaussians {
    let mut g = Gaussians::default();
    add(&mut g, mean, log_scale, rotation, logit, RED);
    g
}

/// Mean, logarithms of scales, quaternion, logit of opacity.
type One = ([f64; 3], [f64; 3], [f64; 4], f64);

/// Ordinary ones with others among them.
fn among(others: &[One]) -> Line {
    let mut g = ordinary();
    for (mean, scale, rotation, logit) in others {
        add(&mut g, *mean, *scale, *rotation, *logit, BLUE);
    }
    line(g)
}

/// So many faint splats over the whole of a small picture; at equal depths, or one behind the other.
fn crowd(count: usize, ties: bool) -> Line {
    let mut g = Gaussians::default();
    let mut r = Rng::new(3);
    for i in 0..count {
        let z = if ties { 4.0 } else { 4.0 + i as f64 / count as f64 };
        let color = [r.between(-1.0, 1.0), r.between(-1.0, 1.0), r.between(-1.0, 1.0)];
        add(&mut g, [0.0, 0.0, z], [1.5; 3], UNIT, -3.0, color);
    }
    Line { camera: straight([8, 16], 60.0), twin: Twin::Everywhere, ..line(g) }
}

fn compare(image: &[f32], gaussians: &Gaussians, camera: &Camera, twin: Twin) {
    let truth = render(gaussians, camera, degree(gaussians) as usize, false, BACKGROUND);
    let everywhere = twin == Twin::Everywhere;
    let sure = truth.doubtful.iter().filter(|d| !**d).count();
    assert!(everywhere || 2 * sure >= truth.doubtful.len(), "sure of {sure} of {} pixels", truth.doubtful.len());
    let mut largest = (0.0, 0);
    for (p, pixel) in image.chunks_exact(3).enumerate().filter(|(p, _)| everywhere || !truth.doubtful[*p]) {
        for (c, found) in pixel.iter().enumerate() {
            let off = (f64::from(*found) - truth.image[3 * p + c]).abs() / truth.image[3 * p + c].abs().max(1.0);
            // A NaN counts as larger.
            largest = if off <= largest.0 { largest } else { (off, p) };
        }
    }
    assert!(largest.0 < LARGEST, "pixel {} is off by {}", largest.1, largest.0);
}

fn check(line: &Line) {
    let gpu = Gpu::new();
    let Line { gaussians, camera, twin } = line;
    let (image, transmittance) = picture(&gpu, gaussians, camera).unwrap();
    assert!(image.iter().chain(&transmittance).all(|v| v.is_finite()), "the picture is not finite");
    assert!(transmittance.iter().all(|t| (0.0..=1.0).contains(t)), "a transmittance is no share");
    if *twin != Twin::No {
        compare(&image, gaussians, camera, *twin);
    }
    let before = scenes::data(gaussians);
    let (reports, after) = steps(&gpu, gaussians, camera, 3).unwrap();
    for report in &reports {
        assert!(report.losses.total.is_finite(), "{report:?}");
    }
    for (group, (old, new)) in before.groups.iter().zip(&after.groups).enumerate() {
        for (i, (old, new)) in old.iter().zip(new).enumerate() {
            assert!(new.is_finite() || !old.is_finite(), "number {i} of group {group} was {old} and became {new}");
        }
    }
}

/// A test for each line, and the list of all.
macro_rules! lines {
    ($($name:ident: $what:literal, $line:expr;)*) => {
        $(#[test] fn $name() { check(&$line); })*
        const LINES: &[(&str, &str)] = &[$((stringify!($name), $what)),*];
    };
}

lines! {
    no_gaussians: "no Gaussian at all", line(Gaussians::default());
    one_gaussian: "one Gaussian", line(one([0.1, 0.0, 3.0], [-1.0; 3], UNIT, 1.0));
    a_million_in_a_tile: "2^20 Gaussians in one tile", crowd(1 << 20, false);
    a_million_ties: "2^20 Gaussians at one depth, in one tile", crowd(1 << 20, true);
    scales_down_to_nothing: "scales of e^-16 and e^-80", among(&[
        ([0.1, 0.1, 2.0], [-16.0; 3], UNIT, 3.0), ([-0.2, 0.1, 2.0], [-80.0; 3], UNIT, 3.0)]);
    scales_beyond_the_room: "scales of e^16 and e^80", among(&[
        ([0.1, 0.1, 5.0], [16.0; 3], UNIT, -3.0), ([-0.2, 0.1, 9.0], [80.0; 3], UNIT, -2.0)]);
    one_long_axis: "scales of e^16, e^-16 and e^-16 in one Gaussian", among(&[
        ([0.1, 0.1, 4.0], [16.0, -16.0, -16.0], [0.9, 0.1, 0.3, -0.2], 1.0)]);
    condition_of_1e12: "covariances of condition 1e12", among(&[
        ([0.0, 0.0, 3.0], [0.0, -13.8, -13.8], [0.8, 0.1, 0.5, -0.3], 2.0),
        ([0.2, 0.1, 2.0], [-1.0, -1.0, -14.8], [0.2, 0.7, -0.5, 0.3], 2.0)]);
    scales_that_are_no_numbers: "scales that are NaN or infinite", among(&[
        ([0.0, 0.0, 3.0], [f64::NAN; 3], UNIT, 2.0), ([0.0, 0.0, 3.0], [f64::INFINITY, 0.0, 0.0], UNIT, -2.0),
        ([0.0, 0.2, 3.0], [f64::NEG_INFINITY; 3], UNIT, 2.0)]);
    opacities_at_both_ends: "opacities of logit 30 and -30, and 1e30", among(&[
        ([0.0, 0.0, 2.0], [-2.0; 3], UNIT, 30.0), ([0.3, 0.0, 2.0], [-2.0; 3], UNIT, -30.0),
        ([-0.3, 0.0, 2.0], [-2.0; 3], UNIT, 1e30), ([-0.3, 0.2, 2.0], [-2.0; 3], UNIT, -1e30)]);
    opacities_that_are_no_numbers: "opacities that are NaN or infinite", among(&[
        ([0.0, 0.0, 2.0], [-2.0; 3], UNIT, f64::NAN), ([0.3, 0.0, 2.0], [-2.0; 3], UNIT, f64::INFINITY),
        ([0.3, 0.0, 2.0], [-2.0; 3], UNIT, f64::NEG_INFINITY)]);
    quaternions_without_direction: "quaternions of zero, 1e-30 and 1e18", among(&[
        ([0.0, 0.0, 2.0], [-2.0, -1.0, -3.0], [0.0; 4], 1.0), ([0.3, 0.0, 2.0], [-2.0, -1.0, -3.0], [3e-30, 1e-30, 0.0, 2e-30], 1.0),
        ([-0.3, 0.0, 2.0], [-2.0, -1.0, -3.0], [3e18, 1e18, 0.0, 2e18], 1.0)]);
    quaternions_that_are_no_numbers: "quaternions with NaN and infinity", among(&[
        ([0.0, 0.0, 2.0], [-2.0, -1.0, -3.0], [f64::NAN, 0.0, 0.0, 1.0], 1.0),
        ([0.3, 0.0, 2.0], [-2.0, -1.0, -3.0], [f64::INFINITY, 1.0, 0.0, 0.0], 1.0)]);
    positions_far_away: "positions at 1e6 and 1e30", among(&[
        ([1e6, -1e6, 1e6], [10.0; 3], UNIT, 1.0), ([0.0, 0.0, 1e6], [12.0; 3], UNIT, 1.0), ([1e30, 0.0, 1e30], [8.0; 3], UNIT, 1.0)]);
    positions_at_the_camera: "positions at the camera, at the near plane and just behind", among(&[
        ([0.0; 3], [-2.0; 3], UNIT, 1.0), ([0.0, 0.0, 0.01], [-6.0; 3], UNIT, -1.0), ([0.001, 0.0, 0.0100001], [-6.0; 3], UNIT, -1.0),
        ([0.0, 0.0, -1e-6], [-2.0; 3], UNIT, 1.0)]);
    positions_that_are_no_numbers: "positions that are NaN or infinite", among(&[
        ([f64::NAN, 0.0, 2.0], [-2.0; 3], UNIT, 1.0), ([0.0, 0.0, f64::NAN], [-2.0; 3], UNIT, 1.0),
        ([0.0, f64::INFINITY, 2.0], [-2.0; 3], UNIT, 1.0), ([0.0, 0.0, f64::INFINITY], [-2.0; 3], UNIT, 1.0)]);
    colors_without_bound: "colors of 1e30, -1e30, NaN and infinity", {
        let mut g = ordinary();
        for (i, c) in [1e30, -1e30, f64::NAN, f64::INFINITY].into_iter().enumerate() {
            add(&mut g, [0.2 * i as f64 - 0.3, 0.0, 20.0], [-1.0; 3], UNIT, 1.0, [c; 3]);
        }
        Line { twin: Twin::No, ..line(g) }
    };
    a_picture_of_one_pixel: "a picture of 1 x 1", Line { camera: straight([1, 1], 60.0), ..line(ordinary()) };
    a_picture_of_17_by_3: "a picture of 17 x 3", Line { camera: straight([17, 3], 60.0), ..line(ordinary()) };
    a_picture_of_8192_by_1: "a picture of 8192 x 1", Line { camera: straight([8192, 1], 60.0), ..line(ordinary()) };
    a_picture_of_1_by_8192: "a picture of 1 x 8192", Line {
        camera: Camera { focal: DVec2::splat(5000.0), ..straight([1, 8192], 60.0) }, ..line(ordinary()) };
    a_view_of_one_degree: "a field of view of 1 degree", Line { camera: straight([48, 32], 1.0), ..line(ordinary()) };
    a_view_of_170_degrees: "a field of view of 170 degrees", Line { camera: straight([48, 32], 170.0), ..line(ordinary()) };
    a_center_far_outside: "a principal point outside of the picture", {
        let mut camera = straight([48, 32], 60.0);
        camera.center = DVec2::new(-100.0, 300.0);
        Line { camera, ..line(ordinary()) }
    };
}

/// 4096 x 4096 is more than the smallest binding that Vulkan promises: a picture, or one sentence.
#[test]
fn a_picture_of_4096_by_4096() {
    let gpu = Gpu::new();
    let camera = straight([4096, 4096], 60.0);
    let g = ordinary();
    match picture(&gpu, &g, &camera) {
        Ok((image, _)) => {
            let truth = render(&g, &camera, 0, false, BACKGROUND);
            let sure = (0..truth.doubtful.len()).filter(|p| !truth.doubtful[*p]).step_by(97);
            for p in sure {
                let off = (f64::from(image[3 * p]) - truth.image[3 * p]).abs();
                assert!(off < LARGEST, "pixel {p} is off by {off}");
            }
        }
        Err(error) => {
            let text = error.to_string();
            assert!(text.len() < 300 && text.contains("bytes"), "{text}");
        }
    }
}

/// The list in the documentation is the list of this file.
#[test]
fn the_documentation_lists_every_line() {
    let text = include_str!("../../docs/EXTREMES.md");
    let others = [("a_picture_of_4096_by_4096", "a picture of 4096 x 4096")];
    let rows: Vec<&str> = text.lines().filter(|l| l.contains("| `extremes::")).collect();
    for (name, what) in LINES.iter().chain(&others) {
        let row = format!("| {what} | `extremes::{name}` |");
        assert!(rows.contains(&row.as_str()), "docs/EXTREMES.md lacks\n{row}");
    }
    assert_eq!(rows.len(), LINES.len() + others.len(), "docs/EXTREMES.md has a line too many");
}

/// Of training: file, test, what is special.
const TRAININGS: &[(&str, &str, &str)] = &[
    (
        "divergence",
        "wild_rates_end_in_a_sentence_and_lower_ones_go_on",
        "learning rates a hundred times too high, stopped and resumed with lower ones",
    ),
    (
        "divergence",
        "it_goes_back_repeats_and_resumes",
        "the same, gone back from: twice with the same bits, and after kills",
    ),
    ("divergence", "what_was_good_until_late_is_kept", "rates of positions that grow until it diverges"),
    ("divergence", "wild_materials_are_noticed_and_gone_back_from", "the same of materials and lights"),
    (
        "divergence",
        "what_trains_is_left_alone",
        "rates a thousand times too low and ten times too high, poses, points and priors that are wrong, resets after resets",
    ),
    ("long", "geometry_with_every_loss", "1000 steps of geometry with every loss on; 100 000 with `SGS_TEST_LONG=1`"),
    ("long", "materials_with_every_loss", "600 steps of materials with every loss on; 100 000 with `SGS_TEST_LONG=1`"),
];

/// The same of trainings, whose tests are those of other files.
#[test]
fn the_documentation_lists_every_training() {
    let text = include_str!("../../docs/EXTREMES.md");
    for (file, name, what) in TRAININGS {
        let row = format!("| {what} | `{file}::{name}` |");
        assert!(text.lines().any(|l| l == row), "docs/EXTREMES.md lacks\n{row}");
        let source = if *file == "long" { include_str!("long.rs") } else { include_str!("divergence.rs") };
        assert!(source.contains(&format!("fn {name}()")), "there is no {file}::{name}");
    }
    let rows = text.lines().filter(|l| l.contains("| `divergence::") || l.contains("| `long::")).count();
    assert_eq!(rows, TRAININGS.len(), "docs/EXTREMES.md has a training too many");
}

#[test]
#[should_panic(expected = "is off by")]
fn a_wrong_picture_is_noticed() {
    let Line { mut gaussians, camera, .. } = line(ordinary());
    let (image, _) = picture(&Gpu::new(), &gaussians, &camera).unwrap();
    gaussians.means[0] += 0.05;
    compare(&image, &gaussians, &camera, Twin::Sure);
}
