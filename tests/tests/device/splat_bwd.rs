//! Gradients of the whole render against central differences of the reference. The render consists of projection,
//! harmonics and blending.

use sgs_passes::Accuracy;
use sgs_passes::reference::project::Camera;
use sgs_passes::scene::Group;
use sgs_passes::splat::BackwardKernel;
use sgs_tests::gradients::{CAMERA_NUMBERS, Case, changed_camera, parameters};
use sgs_tests::{Gpu, finite_difference, scenes};

/// Returns the central difference at the smaller of two step sizes. Returns `None` where the two disagree because a
/// threshold lies between.
fn difference(case: &Case, group: Group, i: usize) -> Option<f64> {
    let mut g = case.gaussians.clone();
    let mut at = |h: f64| {
        let mut x = [parameters(&mut g, group)[i]];
        finite_difference(&mut x, 0, h, |x| {
            let mut moved = case.gaussians.clone();
            parameters(&mut moved, group)[i] = x[0];
            case.loss(&moved, &case.camera)
        })
    };
    let (coarse, fine) = (at(2e-6), at(5e-7));
    ((coarse - fine).abs() <= 1e-3 * (1.0 + fine.abs())).then_some(fine)
}

/// Tolerances of gradients: relative to the gradient, relative to the largest of its group, and absolute.
const TOLERANCE: [f64; 3] = [1e-3, 5e-5, 1e-6];

pub(crate) fn check(gpu: &Gpu, case: &Case, which: BackwardKernel) {
    let [relative, share, absolute] = TOLERANCE;
    let (groups, pose) = case.gpu_gradients(gpu, which);
    let (mut compared, mut skipped) = (0, 0);
    for group in Group::ALL {
        let found = &groups[group as usize];
        let scale = found.iter().fold(0.0_f64, |m, v| m.max(f64::from(v.abs())));
        for (i, value) in found.iter().enumerate() {
            let Some(expected) = difference(case, group, i) else {
                skipped += 1;
                continue;
            };
            compared += 1;
            let tolerance = relative * expected.abs() + share * scale + absolute;
            assert!(
                (f64::from(*value) - expected).abs() <= tolerance,
                "{which:?} {}[{i}]: {value} instead of {expected} (largest of the group {scale})",
                group.name()
            );
        }
    }
    assert!(skipped * 5 < compared, "{skipped} of {compared} lie at thresholds");
    let scale = pose.iter().fold(0.0_f64, |m, v| m.max(f64::from(v.abs())));
    for i in 0..CAMERA_NUMBERS {
        let mut x = [0.0];
        let by = |case: &Case, d: f64| case.loss(&case.gaussians, &changed_camera(&case.camera, i, d));
        let coarse = finite_difference(&mut x, 0, 2e-6, |x| by(case, x[0]));
        let fine = finite_difference(&mut x, 0, 5e-7, |x| by(case, x[0]));
        if (coarse - fine).abs() > 1e-3 * (1.0 + fine.abs()) {
            continue;
        }
        let error = (f64::from(pose[i]) - fine).abs();
        assert!(error <= relative * fine.abs() + share * scale, "{which:?} pose[{i}]: {} instead of {fine}", pose[i]);
    }
}

/// Returns the backward kernels that the device can run.
fn kernels(gpu: &Gpu) -> Vec<BackwardKernel> {
    let all = [BackwardKernel::Pixel, BackwardKernel::Splat, BackwardKernel::Bucket, BackwardKernel::Atomic];
    all.into_iter().filter(|k| k.runs_on(gpu.device().info())).collect()
}

#[test]
fn gradients_of_all_kernels_match_reference() {
    let gpu = Gpu::new();
    for which in kernels(&gpu) {
        check(&gpu, &Case::new(scenes::ordinary(12, 3, true, 5), [24, 19], true), which);
        check(&gpu, &Case::new(scenes::ordinary(20, 1, false, 6), [33, 9], false), which);
        check(&gpu, &Case::new(scenes::ordinary(6, 0, false, 8), [1, 1], false), which);
    }
}

/// Tests the distortion that training learns, at its limits, too. Some splats lie beyond the limits of slopes.
#[test]
fn gradients_of_distorted_splats_match_reference() {
    let gpu = Gpu::new();
    for (seed, radial) in [0.03_f32, 0.1, -0.1].into_iter().enumerate() {
        let mut g = scenes::ordinary(16, 1, true, seed as u64);
        for i in 0..4 {
            g.means[3 * i] += [-4.0, 4.0][i % 2];
            g.log_scales[3 * i] += 1.5;
        }
        let camera = Camera { radial: radial.into(), ..scenes::camera([24, 19]) };
        for which in kernels(&gpu) {
            check(&gpu, &Case::seen(g.clone(), camera, true), which);
        }
    }
}

/// Tests that gradients omit exactly the terms that the render omits for speed.
#[test]
fn gradients_at_other_accuracies_match_reference() {
    let gpu = Gpu::new();
    let exact = Accuracy::EXACT;
    for accuracy in [
        Accuracy { transmittance_min: 0.3, keep_last: true, ..exact },
        Accuracy { transmittance_min: 0.3, ..exact },
        Accuracy { alpha_min: 1.0 / 16.0, ..exact },
        Accuracy { depth_bits: 24, ..exact },
        Accuracy { color_bits: 16, ..exact },
        Accuracy::BALANCED,
        Accuracy::FAST,
    ] {
        let mut case = Case::new(scenes::ordinary(20, 1, false, 6), [33, 9], false);
        case.accuracy = accuracy;
        for which in kernels(&gpu) {
            check(&gpu, &case, which);
        }
        let g = scenes::with_semantics(scenes::ordinary(9, 0, true, 5), 6);
        check(&gpu, &Case { accuracy, ..Case::new(g, [21, 18], true) }, BackwardKernel::Pixel);
    }
}

/// Tests the 2D Mip filter on small, flat and larger splats.
#[test]
fn gradients_of_filtered_opacities_match_reference() {
    let gpu = Gpu::new();
    let mut g = scenes::ordinary(15, 1, true, 5);
    for i in 0..15 {
        let scales = &mut g.log_scales[3 * i..3 * i + 3];
        match i % 3 {
            0 => scales.iter_mut().for_each(|s| *s -= 0.8),
            1 => scales[i % 2] = -5.5,
            _ => {}
        }
    }
    let plain = Case::new(g.clone(), [24, 19], true);
    g.mip = true;
    let case = Case::new(g.clone(), [24, 19], true);
    for which in kernels(&gpu) {
        check(&gpu, &case, which);
    }
    let opacities = |case: &Case| case.gpu_gradients(&gpu, BackwardKernel::Pixel).0[Group::LogScales as usize].clone();
    assert_ne!(opacities(&case), opacities(&plain), "the filter changes nothing");
    check(&gpu, &Case::new(scenes::with_semantics(g, 6), [21, 18], true), BackwardKernel::Pixel);
}

#[test]
fn gradients_with_semantic_features_match_reference() {
    let gpu = Gpu::new();
    let g = scenes::with_semantics(scenes::ordinary(9, 0, true, 5), 6);
    check(&gpu, &Case::new(g, [21, 18], true), BackwardKernel::Pixel);
}

/// Tests several subgroups per tile, with and without skipped slots.
#[test]
fn gradients_with_parts_of_tiles_match_reference() {
    for (parts, sub_tiles) in [(2, false), (4, true), (8, true)] {
        let gpu = Gpu::new().with_slots(sub_tiles, 4, 0.05).with_tile_parts(parts);
        for which in [BackwardKernel::Pixel, BackwardKernel::Bucket] {
            check(&gpu, &Case::new(scenes::ordinary(12, 1, true, 5), [24, 19], true), which);
        }
    }
}

/// Tests slots of every shape, also where the tuning leaves sub-tiles out.
#[test]
fn gradients_with_sub_tiles_match_reference() {
    for width in [4, 8] {
        let gpu = Gpu::new().with_slots(true, width, 0.05);
        for which in kernels(&gpu) {
            check(&gpu, &Case::new(scenes::ordinary(12, 1, true, 5), [24, 19], true), which);
        }
        let g = scenes::with_semantics(scenes::ordinary(9, 0, true, 5), 6);
        check(&gpu, &Case::new(g, [21, 18], true), BackwardKernel::Pixel);
    }
}

/// Tests splats of so many tiles that all lanes sum their entries.
#[test]
fn gradients_of_large_splats_match_reference() {
    let gpu = Gpu::new();
    // More than one full-screen splat per subgroup, and tiles across and down beyond the lanes of narrow subgroups.
    let large = Case::new(scenes::large(5, 0, 3), [210, 163], true);
    let [across, down] = [0, 1].map(|k| large.camera.size[k].div_ceil(gpu.tuning().tile[k]));
    println!("{} tiles, {} are large", across * down, gpu.tuning().large_tiles);
    for which in kernels(&gpu) {
        check(&gpu, &large, which);
    }
    let g = scenes::with_semantics(scenes::large(2, 0, 4), 6);
    check(&gpu, &Case::new(g, [137, 141], false), BackwardKernel::Pixel);
}

/// Tests the sums of large splats at splats of no tile to a few.
#[test]
fn gradients_summed_by_all_lanes_match_reference() {
    let gpu = Gpu::new().with_large_tiles(0);
    for which in kernels(&gpu) {
        check(&gpu, &Case::new(scenes::ordinary(12, 3, true, 5), [24, 19], true), which);
        check(&gpu, &Case::new(scenes::ordinary(20, 1, false, 6), [33, 9], false), which);
    }
    let g = scenes::with_semantics(scenes::ordinary(9, 0, true, 5), 6);
    for which in kernels(&gpu) {
        check(&gpu, &Case::new(g.clone(), [21, 18], true), which);
    }
}

/// Tests features that may not move geometry. All other gradients equal those without features bit for bit. Gradients
/// of the features equal those with moving geometry.
#[test]
fn features_that_do_not_move_geometry_leave_its_gradients_unchanged() {
    let gpu = Gpu::new();
    let mut wide = Case::new(scenes::with_semantics(scenes::ordinary(40, 0, true, 15), 6), [30, 21], true);
    let (moving, _) = wide.gpu_gradients(&gpu, BackwardKernel::Pixel);
    wide.features_move = false;
    let (still, _) = wide.gpu_gradients(&gpu, BackwardKernel::Pixel);
    wide.gaussians.semantics.clear();
    wide.features.clear();
    let (plain, _) = wide.gpu_gradients(&gpu, BackwardKernel::Pixel);
    for group in Group::ALL.into_iter().filter(|g| *g != Group::Semantics) {
        assert_eq!(still[group as usize], plain[group as usize], "{}", group.name());
    }
    assert_eq!(still[Group::Semantics as usize], moving[Group::Semantics as usize]);
    assert_ne!(moving[Group::OpacityLogits as usize], still[Group::OpacityLogits as usize]);
}

#[test]
fn backward_kernels_agree_on_many_gaussians_bit_for_bit() {
    let gpu = Gpu::new();
    let case = Case::new(scenes::ordinary(800, 0, false, 9), [48, 40], false);
    let (pixel, _) = case.gpu_gradients(&gpu, BackwardKernel::Pixel);
    for which in kernels(&gpu) {
        let (other, _) = case.gpu_gradients(&gpu, which);
        agree(&pixel, &other, which);
        // Results with atomics do not repeat bit for bit, but agree.
        if which == BackwardKernel::Atomic {
            continue;
        }
        let (again, _) = case.gpu_gradients(&gpu, which);
        for group in Group::ALL {
            let (a, b) = (&other[group as usize], &again[group as usize]);
            let same = a.iter().zip(b).all(|(x, y)| x.to_bits() == y.to_bits());
            assert!(same, "{} is not repeated by {which:?}", group.name());
        }
    }
}

fn agree(pixel: &[Vec<f32>], other: &[Vec<f32>], which: BackwardKernel) {
    for group in Group::ALL {
        let (a, c) = (&pixel[group as usize], &other[group as usize]);
        let scale = a.iter().fold(0.0_f32, |m, v| m.max(v.abs()));
        for (i, (x, y)) in a.iter().zip(c).enumerate() {
            assert!((x - y).abs() <= 1e-3 * x.abs() + 1e-4 * scale, "{which:?} {}[{i}]: {x} and {y}", group.name());
        }
    }
}

#[test]
fn hard_splats_have_finite_gradients() {
    let gpu = Gpu::new();
    for which in kernels(&gpu) {
        let case = Case::new(scenes::hard(2), [80, 60], false);
        let (groups, pose) = case.gpu_gradients(&gpu, which);
        assert!(groups.iter().flatten().chain(&pose).all(|v| v.is_finite()));
    }
}
