//! Extreme inputs of rendering and training, one line and one test each.
//!
//! docs/how/extremes.md lists the lines. Each line is rendered and compared with the double-precision reference at
//! pixels that are not doubtful. The extreme Gaussians must be visible there. Then three training steps run. Losses
//! stay finite, finite parameters stay finite, and no non-finite gradient is skipped.

use glam::{DMat3, DVec2, DVec3};
use sgs_passes::reference::blend::{Blended, render};
use sgs_passes::reference::project::{Camera, Gaussians};
use sgs_tests::Gpu;
use sgs_tests::scenes::{self, Rng};
use sgs_tests::whole::{BACKGROUND, channels_of, degree, rendered, steps_of};

/// Largest difference from the reference, relative to values above one.
const LARGEST: f64 = 5e-6;

/// Largest relative error of depths, their squares, and colors beyond ten.
///
/// Such values multiply the rounding errors of small weights.
const LARGEST_SHARE: f64 = 2e-5;

/// Smallest change of a color that makes a Gaussian visible.
const SEEN: f64 = 1e-3;

/// Scene, view and expected properties of a line.
struct Line {
    gaussians: Gaussians,
    camera: Camera,
    /// Expected visibility of each of the last Gaussians, which the line tests.
    ///
    /// Checked at pixels where the reference is not doubtful. Invisible Gaussians must not change the image, and
    /// training must not change them. Lines about other properties leave this empty. Any Gaussian must be visible
    /// there.
    seen: Vec<bool>,
    /// Pixels that are compared. The reference evaluates each splat at each pixel.
    compared: Compared,
    /// Factor on the usual bound of the difference from the reference.
    slack: f64,
}

#[derive(Clone, Copy, PartialEq)]
enum Compared {
    /// Pixels where the reference is not doubtful, at least half of them.
    Sure,
    /// All pixels, since rounding decides no depth order or threshold of the line.
    Everywhere,
}

fn line(gaussians: Gaussians) -> Line {
    Line { gaussians, camera: straight([48, 32], 60.0), seen: vec![], compared: Compared::Sure, slack: 1.0 }
}

/// Returns a camera at the origin that looks along z.
///
/// `width` is the horizontal field of view in degrees.
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
        radial: 0.0,
    }
}

/// Adds a Gaussian.
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

/// Returns ordinary visible Gaussians around the extreme ones.
fn ordinary() -> Gaussians {
    scenes::ordinary(40, 0, false, 11)
}

fn one(mean: [f64; 3], log_scale: [f64; 3], rotation: [f64; 4], logit: f64) -> Gaussians {
    let mut g = Gaussians::default();
    add(&mut g, mean, log_scale, rotation, logit, RED);
    g
}

/// Mean, log-scales, quaternion and opacity logit of one Gaussian.
type One = ([f64; 3], [f64; 3], [f64; 4], f64);

/// Adds visible and invisible Gaussians to ordinary ones.
fn among(seen: &[One], unseen: &[One]) -> Line {
    let mut g = ordinary();
    for (mean, scale, rotation, logit) in seen.iter().chain(unseen) {
        add(&mut g, *mean, *scale, *rotation, *logit, BLUE);
    }
    Line { seen: [vec![true; seen.len()], vec![false; unseen.len()]].concat(), ..line(g) }
}

/// Returns all Gaussians except number `i`.
fn without(g: &Gaussians, i: usize) -> Gaussians {
    let mut g = g.clone();
    let count = g.len();
    let groups = [&mut g.means, &mut g.log_scales, &mut g.rotations, &mut g.opacity_logits, &mut g.normals];
    for group in groups.into_iter().chain(&mut g.sh) {
        let width = group.len() / count;
        group.drain(width * i..width * (i + 1));
    }
    g
}

/// Places `count` faint splats in a small image.
///
/// Each lies at the center of a pixel and is visible there and at the four neighbors. Tens of thousands saturate the
/// image. No splat is near a threshold. `depth` maps the index of a splat to its depth.
fn many(count: usize, depth: impl Fn(usize) -> f64) -> Line {
    let mut g = Gaussians::default();
    let mut r = Rng::new(3);
    let camera = straight([8, 16], 60.0);
    for i in 0..count {
        let pixel = DVec2::new(r.between(0.0, 8.0), r.between(0.0, 16.0)).floor() + 0.5;
        let z = depth(i);
        let at = (pixel - camera.center) / camera.focal * z;
        let color = [r.between(-1.0, 1.0), r.between(-1.0, 1.0), r.between(-1.0, 1.0)];
        add(&mut g, [at.x, at.y, z], [-16.0; 3], UNIT, -3.5, color);
    }
    Line { camera, compared: Compared::Everywhere, ..line(g) }
}

/// Returns a depth that is unrelated to the index.
///
/// All depths differ, also in single precision.
fn shuffled(i: usize) -> f64 {
    4.0 + (i * 0x9e37_79b1 % (1 << 20)) as f64 / f64::from(1 << 20)
}

fn truth(gaussians: &Gaussians, camera: &Camera, depth: bool) -> Blended {
    render(gaussians, camera, degree(gaussians) as usize, depth, BACKGROUND)
}

/// Returns the Gaussians with random normals.
fn with_normals(mut g: Gaussians) -> Gaussians {
    let mut r = Rng::new(7);
    g.normals = (0..3 * g.len()).map(|_| single(r.between(-1.0, 1.0))).collect();
    g
}

/// Checks the expected visibility at pixels that are not doubtful.
fn check_visibility(line: &Line, truth_: &Blended) {
    let Line { gaussians: g, camera, seen, compared, .. } = line;
    let sure = |p: usize| *compared == Compared::Everywhere || !truth_.doubtful[p];
    let shown = |p: usize| sure(p) && truth_.transmittance[p] < 1.0 - SEEN;
    assert!(g.is_empty() || (0..truth_.doubtful.len()).any(shown), "nothing is seen");
    for (k, wanted) in seen.iter().enumerate() {
        let other = truth(&without(g, g.len() - seen.len() + k), camera, false);
        let pairs = truth_.image.iter().zip(&other.image).enumerate().filter(|(i, _)| sure(i / 3));
        let most = pairs.map(|(_, (a, b))| (a - b).abs()).fold(0.0, f64::max);
        assert!(if *wanted { most > SEEN } else { most == 0.0 }, "number {k} of those it is about changes {most}");
    }
}

fn compare(image: &[f32], truth: &Blended, compared: Compared, slack: f64) {
    let everywhere = compared == Compared::Everywhere;
    let sure = truth.doubtful.iter().filter(|d| !**d).count();
    assert!(everywhere || 2 * sure >= truth.doubtful.len(), "sure of {sure} of {} pixels", truth.doubtful.len());
    let channels = image.len() / truth.doubtful.len();
    for (p, pixel) in image.chunks_exact(channels).enumerate().filter(|(p, _)| everywhere || !truth.doubtful[*p]) {
        for (c, found) in pixel.iter().enumerate() {
            let expected = truth.image[channels * p + c];
            let off = (f64::from(*found) - expected).abs() / expected.abs().max(1.0);
            let most = if c >= 6 || expected.abs() > 10.0 { LARGEST_SHARE } else { LARGEST };
            assert!(off < slack * most, "channel {c} of pixel {p} is off by {off} of {expected}");
        }
    }
}

/// Compares and trains colors alone, then colors with normals and depths.
fn check(line: &Line) {
    let gpu = Gpu::new();
    check_visibility(line, &truth(&line.gaussians, &line.camera, false));
    check_channels(&gpu, line, &line.gaussians, false);
    check_channels(&gpu, line, &with_normals(line.gaussians.clone()), true);
}

fn check_channels(gpu: &Gpu, line: &Line, gaussians: &Gaussians, depth: bool) {
    let Line { camera, seen, compared, slack, .. } = line;
    let (image, transmittance) = channels_of(gpu, gaussians, camera, depth).unwrap();
    assert!(image.iter().chain(&transmittance).all(|v| v.is_finite()), "the image is not finite");
    assert!(transmittance.iter().all(|t| (0.0..=1.0).contains(t)), "a transmittance is no share");
    compare(&image, &truth(gaussians, camera, depth), *compared, *slack);
    let before = scenes::data(gaussians);
    let (reports, after) = steps_of(gpu, gaussians, camera, depth, 3).unwrap();
    for report in &reports {
        let l = &report.losses;
        assert!(l.total.is_finite() && report.skipped == 0, "{report:?}");
        assert!(!depth || gaussians.is_empty() || l.normal > 0.0 && l.depth_variance > 0.0, "{report:?}");
    }
    let moves = |i: usize| gaussians.len() - i > seen.len() || seen[i + seen.len() - gaussians.len()];
    for (group, (old, new)) in before.groups.iter().zip(&after.groups).enumerate() {
        for (i, (old, new)) in old.iter().zip(new).enumerate() {
            let still = moves(i / (before.groups[group].len() / gaussians.len())) || old.to_bits() == new.to_bits();
            assert!(still && (new.is_finite() || !old.is_finite()), "{i} of group {group} was {old} and became {new}");
        }
    }
}

/// Declares a test for each line, and the list of all.
macro_rules! lines {
    ($($name:ident: $what:literal, $line:expr;)*) => {
        $(#[test] fn $name() { check(&$line); })*
        const LINES: &[(&str, &str)] = &[$((stringify!($name), $what)),*];
    };
}

lines! {
    no_gaussians: "no Gaussian at all", line(Gaussians::default());
    one_gaussian: "one Gaussian", line(one([0.1, 0.0, 3.0], [-1.0; 3], UNIT, 1.0));
    a_million_in_a_tile: "2^20 Gaussians in one tile", many(1 << 20, shuffled);
    a_million_ties: "2^20 Gaussians at one depth, in one tile", many(1 << 20, |_| 4.0);
    scales_down_to_nothing: "scales of e^-16 and e^-80", among(&[
        ([0.1, 0.1, 2.0], [-16.0; 3], UNIT, 3.0), ([-0.2, 0.1, 2.0], [-80.0; 3], UNIT, 3.0)], &[]);
    scales_beyond_the_room: "scales of e^16 and e^80", among(&[
        ([0.1, 0.1, 5.0], [16.0; 3], UNIT, -3.0), ([-0.2, 0.1, 9.0], [80.0; 3], UNIT, -2.0)], &[]);
    one_long_axis: "scales of e^16, e^-16 and e^-16 in one Gaussian", among(&[
        ([0.1, 0.1, 4.0], [16.0, -16.0, -16.0], [0.9, 0.1, 0.3, -0.2], 1.0)], &[]);
    condition_of_1e12: "covariances of condition 1e12", among(&[
        ([0.0, 0.0, 3.0], [0.0, -13.8, -13.8], [0.8, 0.1, 0.5, -0.3], 2.0),
        ([0.2, 0.1, 2.0], [-1.0, -1.0, -14.8], [0.2, 0.7, -0.5, 0.3], 2.0)], &[]);
    scales_that_are_no_numbers: "scales that are NaN or infinite", among(&[], &[
        ([0.0, 0.0, 3.0], [f64::NAN; 3], UNIT, 2.0), ([0.0, 0.0, 3.0], [-2.0, f64::NAN, -2.0], UNIT, 2.0),
        ([0.0, 0.0, 3.0], [f64::INFINITY, 0.0, 0.0], UNIT, -2.0), ([0.0, 0.2, 3.0], [f64::NEG_INFINITY; 3], UNIT, 2.0)]);
    opacities_at_both_ends: "opacities of logit 30 and -30, and 1e30", among(
        &[([0.0, 0.0, 2.0], [-2.0; 3], UNIT, 30.0), ([-0.3, 0.0, 2.0], [-2.0; 3], UNIT, 1e30)],
        &[([0.3, 0.0, 2.0], [-2.0; 3], UNIT, -30.0), ([-0.3, 0.2, 2.0], [-2.0; 3], UNIT, -1e30)]);
    opacities_that_are_no_numbers: "opacities that are NaN or infinite", among(&[], &[
        ([0.0, 0.0, 2.0], [-2.0; 3], UNIT, f64::NAN), ([0.3, 0.0, 2.0], [-2.0; 3], UNIT, f64::INFINITY),
        ([0.3, 0.0, 2.0], [-2.0; 3], UNIT, f64::NEG_INFINITY)]);
    quaternions_without_direction: "quaternions of zero, 1e-30 and 1e18", among(&[
        ([0.0, 0.0, 2.0], [-2.0, -1.0, -3.0], [0.0; 4], 1.0), ([0.3, 0.0, 2.0], [-2.0, -1.0, -3.0], [3e-30, 1e-30, 0.0, 2e-30], 1.0),
        ([-0.3, 0.0, 2.0], [-2.0, -1.0, -3.0], [3e18, 1e18, 0.0, 2e18], 1.0)], &[]);
    quaternions_that_are_no_numbers: "quaternions with NaN and infinity", among(&[
        ([0.0, 0.0, 2.0], [-2.0, -1.0, -3.0], [f64::NAN, 0.0, 0.0, 1.0], 1.0),
        ([0.3, 0.0, 2.0], [-2.0, -1.0, -3.0], [f64::INFINITY, 1.0, 0.0, 0.0], 1.0)], &[]);
    positions_far_away: "positions at 1e6 and 1e30", among(
        &[([4e5, -2e5, 1e6], [8.0; 3], UNIT, 1.0), ([-4e5, 2e5, 1e6], [12.0; 3], UNIT, 1.0), ([2e29, 3e29, 1e30], [8.0; 3], UNIT, 1.0)],
        &[([1e6, -1e6, 1e6], [10.0; 3], UNIT, 1.0), ([1e30, 0.0, 1e30], [8.0; 3], UNIT, 1.0), ([0.0, 0.0, -1e30], [8.0; 3], UNIT, 1.0)]);
    positions_at_the_camera: "positions at the camera, at the near plane and just behind", among(
        &[([0.0, 0.0, 0.01], [-6.0; 3], UNIT, -1.0), ([0.001, 0.0, 0.0100001], [-6.0; 3], UNIT, -1.0)],
        &[([0.0; 3], [-2.0; 3], UNIT, 1.0), ([0.0, 0.0, -1e-6], [-2.0; 3], UNIT, 1.0)]);
    positions_that_are_no_numbers: "positions that are NaN or infinite", among(&[], &[
        ([f64::NAN, 0.0, 2.0], [-2.0; 3], UNIT, 1.0), ([0.0, 0.0, f64::NAN], [-2.0; 3], UNIT, 1.0),
        ([0.0, f64::INFINITY, 2.0], [-2.0; 3], UNIT, 1.0), ([0.0, 0.0, f64::INFINITY], [-2.0; 3], UNIT, 1.0)]);
    colors_without_bound: "colors of 1e30, -1e30, NaN and infinity", {
        let mut g = ordinary();
        for (i, c) in [1e30, -1e30, f64::NAN, f64::INFINITY].into_iter().enumerate() {
            add(&mut g, [4.0 * i as f64 - 6.0, 0.0, 20.0], [-1.0; 3], UNIT, 1.0, [c; 3]);
        }
        Line { seen: vec![true; 4], ..line(g) }
    };
    image_of_1_by_1: "an image of 1 x 1", Line { camera: straight([1, 1], 60.0), ..line(ordinary()) };
    image_of_17_by_3: "an image of 17 x 3", Line { camera: straight([17, 3], 60.0), ..line(ordinary()) };
    image_of_8192_by_1: "an image of 8192 x 1", Line { camera: straight([8192, 1], 60.0), ..line(ordinary()) };
    image_of_1_by_8192: "an image of 1 x 8192", Line {
        camera: Camera { focal: DVec2::splat(5000.0), ..straight([1, 8192], 60.0) }, ..line(ordinary()) };
    a_view_of_one_degree: "a field of view of 1 degree", Line { camera: straight([48, 32], 1.0), ..line(ordinary()) };
    a_view_of_170_degrees: "a field of view of 170 degrees", Line { camera: straight([48, 32], 170.0), ..line(ordinary()) };
    a_center_far_outside: "a principal point outside of the image", {
        let mut camera = straight([48, 32], 60.0);
        camera.center = DVec2::new(-100.0, 300.0);
        // Move the Gaussians into the camera's view.
        let away = (DVec2::new(24.0, 16.0) - camera.center) / camera.focal;
        let mut g = ordinary();
        for mean in g.means.chunks_exact_mut(3) {
            (mean[0], mean[1]) = (single(mean[0] + away.x * mean[2]), single(mean[1] + away.y * mean[2]));
        }
        // Rounding is larger, since image positions are differences of hundreds of pixels.
        Line { camera, slack: 4.0, ..line(g) }
    };
}

/// An image of 4096 x 4096 exceeds the smallest guaranteed Vulkan binding.
///
/// Rendering succeeds or fails with one sentence. If it fails, the largest image that fits still renders.
#[test]
fn image_of_4096_by_4096() {
    let gpu = Gpu::new();
    let g = ordinary();
    let tried = |side: u32| {
        let camera = straight([side; 2], 60.0);
        rendered(&gpu, &g, &camera).map(|(image, _)| {
            let truth = render(&g, &camera, 0, false, BACKGROUND);
            let sure: Vec<usize> = (0..truth.doubtful.len()).filter(|p| !truth.doubtful[*p]).step_by(97).collect();
            assert!(sure.len() > truth.doubtful.len() / 200, "sure of {}", sure.len());
            for at in sure.iter().flat_map(|p| 3 * p..3 * p + 3) {
                let off = (f64::from(image[at]) - truth.image[at]).abs() / truth.image[at].abs().max(1.0);
                assert!(off < LARGEST, "number {at} is off by {off}");
            }
        })
    };
    let Err(error) = tried(4096) else { return };
    let text = error.to_string();
    assert!(text.len() < 300 && text.contains("bytes"), "{text}");
    let most = (gpu.device().info().max_storage_range / 12).isqrt() as u32;
    tried(most).unwrap();
    assert!(rendered(&gpu, &g, &straight([most + 1; 2], 60.0)).is_err());
}

/// docs/how/extremes.md lists every line of this file.
#[test]
fn the_documentation_lists_every_line() {
    let text = include_str!("../../../docs/how/extremes.md");
    let others = [("image_of_4096_by_4096", "an image of 4096 x 4096")];
    let (text, _) = text.split_once("## Hazards").expect("hazards come behind");
    let rows: Vec<&str> = text.lines().filter(|l| l.contains("| `extremes::")).collect();
    for (name, what) in LINES.iter().chain(&others) {
        let row = format!("| {what} | `extremes::{name}` |");
        assert!(rows.contains(&row.as_str()), "docs/how/extremes.md lacks\n{row}");
    }
    assert_eq!(rows.len(), LINES.len() + others.len(), "docs/how/extremes.md has a line too many");
}

/// Many faint Gaussians saturate an image, and their order is visible.
///
/// Saturation needs tens of thousands.
#[test]
fn many_faint_gaussians_blend_in_order() {
    let of = |count: usize, depth: &dyn Fn(usize) -> f64| {
        truth(&many(count, depth).gaussians, &many(1, depth).camera, false)
    };
    let in_order = |i: usize| 4.0 + i as f64 / f64::from(1 << 20);
    let [some, all] = [14, 16].map(|bits| of(1 << bits, &in_order));
    assert!(some.transmittance.iter().all(|t| *t > 2e-4) && all.transmittance.iter().all(|t| *t < 1.1e-4));
    let other = of(1 << 16, &shuffled);
    let off = all.image.iter().zip(&other.image).filter(|(a, b)| (**a - **b).abs() > SEEN).count();
    assert!(off > all.image.len() / 2, "{off}");
}

#[test]
#[should_panic(expected = "is off by")]
fn wrong_image_is_detected() {
    let Line { mut gaussians, camera, .. } = line(ordinary());
    let (image, _) = rendered(&Gpu::new(), &gaussians, &camera).unwrap();
    gaussians.means[0] += 0.05;
    compare(&image, &truth(&gaussians, &camera, false), Compared::Sure, 1.0);
}
