//! Images and training steps of random Gaussians against the reference. The reference is in double precision. Every
//! number is drawn log-uniformly, and failures are shrunk. Draws are the same in every run; `SGS_TEST_CASES` sets their
//! number.

use glam::{DMat3, DVec2, DVec3};
use proptest::prelude::*;
use proptest::strategy::ValueTree;
use proptest::test_runner::TestCaseError;
use sgs_passes::reference::blend::render;
use sgs_passes::reference::project::{Camera, Gaussians};
use sgs_passes::scene::Group;
use sgs_passes::splat::BackwardKernel;
use sgs_tests::drawn::runner;
use sgs_tests::drawn::scenes::{blurred, few, rounded, scene};
use sgs_tests::gradients::{CAMERA_NUMBERS, Case, changed_camera, parameters};
use sgs_tests::whole::{BACKGROUND, rendered, steps};
use sgs_tests::{Gpu, scenes};

/// Largest allowed color difference at conclusive pixels. The largest color is about 1.
const LARGEST: f64 = 2e-3;

#[test]
fn rendered_images_match_reference() {
    let gpu = Gpu::new();
    let (mut sure, mut all, mut seen, mut clear) = (0, 0, 0, 0);
    let result = runner(96).run(&scene(), |(g, camera)| {
        let (image, transmittance) = rendered(&gpu, &g, &camera).map_err(|e| TestCaseError::fail(e.to_string()))?;
        prop_assert!(image.iter().chain(&transmittance).all(|v| v.is_finite()));
        if blurred(&g, &camera) {
            return Ok(());
        }
        let truth = render(&g, &camera, 0, false, BACKGROUND);
        for (p, found) in image.chunks_exact(3).enumerate().filter(|(p, _)| !truth.doubtful[*p]) {
            for (c, found) in found.iter().enumerate() {
                let off = (f64::from(*found) - truth.image[3 * p + c]).abs();
                prop_assert!(off < LARGEST, "pixel {} is off by {}", p, off);
            }
        }
        Ok(())
    });
    result.unwrap_or_else(|e| panic!("{e}"));
    // Counts how much the draws give to compare.
    let mut draws = runner(96);
    for _ in 0..96 {
        let (g, camera) = scene().new_tree(&mut draws).unwrap().current();
        let truth = render(&g, &camera, 0, false, BACKGROUND);
        clear += u32::from(!blurred(&g, &camera));
        sure += truth.doubtful.iter().filter(|d| !**d).count();
        seen += truth.transmittance.iter().filter(|t| **t < 1.0).count();
        all += truth.doubtful.len();
    }
    assert!(clear > 48, "{clear} of 96 scenes are compared");
    assert!(sure > all * 9 / 10 && seen > all / 10, "of {all} pixels {sure} are sure and {seen} show anything");
}

const GROUPS: [Group; 8] = [
    Group::Means,
    Group::LogScales,
    Group::Rotations,
    Group::OpacityLogits,
    Group::Sh0,
    Group::Sh1,
    Group::Sh2,
    Group::Sh3,
];

/// Returns the step of a parameter that changes the image by a comparable amount. The step is a pixel for a mean, a
/// radian for a quaternion, and one otherwise.
fn unit(case: &Case, group: Group, i: usize) -> f64 {
    let g = &case.gaussians;
    let gaussian = i / group.width() as usize;
    match group {
        Group::Means => {
            let mean = DVec3::from_slice(&g.means[3 * gaussian..]);
            (case.camera.rotation * mean + case.camera.translation).z.max(case.camera.near) / case.camera.focal.x
        }
        Group::Rotations => g.rotations[4 * gaussian..][..4].iter().map(|x| x * x).sum::<f64>().sqrt(),
        _ => 1.0,
    }
}

/// Returns the reference's central differences by group, per [`unit`]. An entry is `None` where two step sizes disagree
/// because a threshold lies between them.
fn differences(case: &Case) -> Vec<Vec<Option<f64>>> {
    let difference = |group: Group, i: usize| {
        let unit = unit(case, group, i);
        let mut g = case.gaussians.clone();
        let x = parameters(&mut g, group)[i];
        let mut at = |step: f64| {
            let (up, down) = (x + step * unit, x - step * unit);
            let [up_, down_] = [up, down].map(|x| {
                parameters(&mut g, group)[i] = x;
                case.loss(&g, &case.camera)
            });
            (up_ - down_) / (up - down) * unit
        };
        let (coarse, fine) = (at(2e-5), at(5e-6));
        ((coarse - fine).abs() <= 1e-4 * (1.0 + fine.abs())).then_some(fine)
    };
    let all = |group: &Group| {
        let count = parameters(&mut case.gaussians.clone(), *group).len();
        (0..count).map(|i| difference(*group, i)).collect()
    };
    GROUPS.iter().map(all).chain([pose_differences(case)]).collect()
}

/// Returns the step of one of the [`CAMERA_NUMBERS`], comparable to [`unit`]. The step is a pixel at the nearest Gaussian,
/// or a radian; for the lens it is a pixel, at a corner for radial distortion.
fn pose_unit(case: &Case, i: usize) -> f64 {
    let nearest = (0..case.gaussians.len()).map(|k| unit(case, Group::Means, 3 * k)).fold(f64::INFINITY, f64::min);
    let far = case.gaussians.means.iter().fold(0.0_f64, |m, x| m.max(x.abs()));
    match i {
        0..9 => (nearest / far).min(1.0),
        9..12 => nearest,
        15.. => 2.0 / f64::from(case.camera.size[0]).hypot(f64::from(case.camera.size[1])),
        _ => 1.0 / case.camera.focal[0].max(case.camera.focal[1]),
    }
}

/// Returns central differences of the reference per pose parameter. Steps are in [`pose_unit`]s.
fn pose_differences(case: &Case) -> Vec<Option<f64>> {
    let difference = |i: usize| {
        let unit = pose_unit(case, i);
        let at = |step: f64| {
            let by = |change: f64| case.loss(&case.gaussians, &changed_camera(&case.camera, i, change));
            (by(step * unit) - by(-step * unit)) / (2.0 * step)
        };
        let (coarse, fine) = (at(2e-5), at(5e-6));
        ((coarse - fine).abs() <= 1e-4 * (1.0 + fine.abs())).then_some(fine)
    };
    (0..CAMERA_NUMBERS).map(difference).collect()
}

/// Returns the case as single precision might round it; `way` selects the rounding.
fn after_rounding(case: &Case, way: u64) -> Case {
    Case { gaussians: rounded(&case.gaussians, &case.camera, way), ..case.clone() }
}

/// Compares the gradients of a scene of a few Gaussians. Returns how many numbers were compared and how many lie at
/// thresholds.
fn check_gradients(gpu: &Gpu, g: &Gaussians, camera: &Camera) -> Result<[usize; 2], TestCaseError> {
    let mut case = Case::seen(g.clone(), *camera, false);
    let truth = case.reference(g, camera);
    for (p, _) in truth.doubtful.iter().enumerate().filter(|(_, d)| **d) {
        case.image[3 * p..3 * p + 3].fill(0.0);
        case.transmittance[p] = 0.0;
    }
    let seen: f64 = truth.transmittance.iter().map(|t| 1.0 - t).sum();
    let (found, pose) = case.gpu_gradients(gpu, BackwardKernel::Bucket);
    compare(&case, seen, &found, &pose)?;
    let (found, pose) = case.gpu_gradients(gpu, BackwardKernel::Pixel);
    compare(&case, seen, &found, &pose)
}

/// Compares gradients with the reference's differences; returns the same counts. `seen` is the sum of the opacities of
/// all pixels.
fn compare(case: &Case, seen: f64, found: &[Vec<f32>], pose: &[f32]) -> Result<[usize; 2], TestCaseError> {
    prop_assert!(found.iter().flatten().chain(pose).all(|v| v.is_finite()));
    let expected = differences(case);
    let others: Vec<_> = (0..4).map(|way| differences(&after_rounding(case, way))).collect();
    let (mut compared, mut skipped) = (0, 0);
    let groups = GROUPS.iter().map(|group| (group.name(), &found[*group as usize]));
    for (k, (name, found)) in groups.map(|(name, found)| (name, &found[..])).chain([("pose", pose)]).enumerate() {
        for (i, found) in found.iter().enumerate() {
            // Parameters that rounding may move across a threshold are not compared.
            let moved: Option<Vec<f64>> = others.iter().map(|other| other[k][i]).collect();
            let (Some(fine), Some(moved)) = (expected[k][i], moved) else {
                skipped += 1;
                continue;
            };
            compared += 1;
            let rounding = moved.iter().map(|other| (other - fine).abs()).fold(0.0, f64::max);
            let slack = 2e-3 * fine.abs() + 1e-4 * seen + 1e-6 + 4.0 * rounding;
            let unit = if k < GROUPS.len() { unit(case, GROUPS[k], i) } else { pose_unit(case, i) };
            let found = f64::from(*found) * unit;
            prop_assert!((found - fine).abs() <= slack, "{}[{}] is {} and not {}, to {}", name, i, found, fine, slack);
        }
    }
    Ok([compared, skipped])
}

#[test]
fn render_gradients_match_reference() {
    let gpu = Gpu::new();
    let counts = std::cell::Cell::new([0, 0, 0]);
    let result = runner(64).run(&few(), |(g, camera)| {
        if !blurred(&g, &camera) {
            let [compared, skipped] = check_gradients(&gpu, &g, &camera)?;
            let [scenes, a, b] = counts.get();
            counts.set([scenes + 1, a + compared, b + skipped]);
        }
        Ok(())
    });
    result.unwrap_or_else(|e| panic!("{e}"));
    let [scenes, compared, skipped] = counts.get();
    println!("{scenes} scenes, {compared} numbers compared, {skipped} at thresholds");
    assert!(scenes > 30 && compared > 500 && skipped * 4 < compared, "{:?}", counts.get());
}

/// Tests that a gradient 2 % too large and a lost gradient are detected.
#[test]
fn checks_of_gradients_can_fail() {
    let gpu = Gpu::new();
    let (g, camera) = (scenes::ordinary(4, 3, false, 5), scenes::camera([12, 9]));
    let case = Case::seen(g, camera, false);
    let (found, pose) = case.gpu_gradients(&gpu, BackwardKernel::Pixel);
    assert!(compare(&case, 1.0, &found, &pose).is_ok_and(|[compared, _]| compared > 200));
    for group in GROUPS.map(|g| g as usize) {
        let most = found[group].iter().fold(0.0_f32, |m, x| m.max(x.abs()));
        let at = found[group].iter().position(|x| x.abs() == most).unwrap();
        for factor in [0.0, 1.02] {
            let mut wrong = found.clone();
            wrong[group][at] *= factor;
            assert!(compare(&case, 1.0, &wrong, &pose).is_err(), "{group} times {factor}");
        }
    }
    let mut wrong = pose.clone();
    wrong[5] *= 1.02;
    assert!(compare(&case, 1.0, &found, &wrong).is_err());
    for i in 12..CAMERA_NUMBERS {
        let mut wrong = pose.clone();
        wrong[i] *= 1.1;
        assert!(compare(&case, 1.0, &found, &wrong).is_err(), "number {i} of the camera");
    }
}

#[test]
fn steps_leave_finite_parameters() {
    let gpu = Gpu::new();
    let result = runner(32).run(&scene(), |(g, camera)| {
        let (reports, after) = steps(&gpu, &g, &camera, 2).map_err(|e| TestCaseError::fail(e.to_string()))?;
        prop_assert!(reports.iter().all(|r| r.losses.total.is_finite() && r.skipped == 0), "{:?}", reports);
        let before = scenes::data(&g);
        for (old, new) in before.groups.iter().zip(&after.groups) {
            prop_assert!(new.iter().all(|v| v.is_finite()), "{:?} became {:?}", old, new);
        }
        Ok(())
    });
    result.unwrap_or_else(|e| panic!("{e}"));
}

/// Tests that a failure is found and shrunk to at most two Gaussians.
#[test]
fn failures_are_found_and_shrunk() {
    let result = runner(96).run(&scene(), |(g, camera)| {
        let visible = render(&g, &camera, 0, false, BACKGROUND).transmittance.iter().any(|t| *t < 0.5);
        prop_assert!(!visible);
        Ok(())
    });
    let Err(proptest::test_runner::TestError::Fail(_, (g, _))) = result else { panic!("nothing was found") };
    assert!(g.len() <= 2, "{} Gaussians are left", g.len());
}

/// Tests an anisotropic Gaussian of condition number 1e17. A draw once found it: the reference's own determinant had
/// lost its digits.
#[test]
fn gaussian_of_condition_1e17_is_rendered_in_place() {
    let turn = DMat3::from_cols_array_2d(&[
        [0.8718962073326111, 0.48969075083732605, 0.0],
        [-0.48969075083732605, 0.8718962073326111, 0.0],
        [0.0, 0.0, 1.0],
    ]);
    let camera = Camera {
        rotation: turn,
        translation: DVec3::new(0.0012339723762124777, 0.001756026060320437, 0.006774841342121363),
        focal: DVec2::splat(1833.41845703125),
        center: DVec2::new(16.0, 1.0),
        size: [32, 2],
        near: f64::from(0.01_f32),
        radial: 0.0,
    };
    let mut g = Gaussians {
        means: vec![-0.0019358055433258414, -0.0009268075809814036, 0.007066803984344006],
        log_scales: vec![-16.352781295776367, 7.535415172576904, -18.89691162109375],
        rotations: vec![1.0, 1.0, 103.1412582397461, 1.0],
        opacity_logits: vec![0.0],
        ..Default::default()
    };
    g.sh[0] = vec![0.0; 3];
    let (image, _) = rendered(&Gpu::new(), &g, &camera).unwrap();
    let truth = render(&g, &camera, 0, false, BACKGROUND);
    let off = image.iter().zip(&truth.image).map(|(a, b)| (f64::from(*a) - b).abs()).fold(0.0, f64::max);
    assert!(off < LARGEST && truth.doubtful.iter().filter(|d| **d).count() < 8, "{off}");
    assert!(truth.transmittance.iter().any(|t| *t < 0.6), "nothing is seen of it");
}
