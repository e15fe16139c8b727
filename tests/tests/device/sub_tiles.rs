//! Sub-tiles of blending: trying a splat only in the slots that it can touch changes no bit.

use sgs_passes::reference::project::Gaussians;
use sgs_passes::splat::BackwardKernel;
use sgs_tests::gbuffer::{Case as Surfaces, run};
use sgs_tests::gradients::Case;
use sgs_tests::whole::channels_of;
use sgs_tests::{Gpu, scenes};

/// Returns the columns of slots that a tile of the device can have.
fn widths() -> Vec<u32> {
    let t = Gpu::new().tuning();
    [2, 4, 8, 16].into_iter().filter(|w| *w <= t.tile[0] && t.subgroup_size / w <= t.tile[1]).collect()
}

/// Margin of the exponent of ordinary runs, and one that leaves every slot in.
const MARGINS: [f32; 2] = [0.05, 1e9];

/// The signs of zeros may differ: a sum of products with zero has the sign of its first one.
fn assert_same_bits(what: &str, a: &[f32], b: &[f32]) {
    assert_eq!(a.len(), b.len());
    let mut pairs = a.iter().zip(b).enumerate();
    if let Some((i, (a, b))) = pairs.find(|(_, (a, b))| a != b && a.to_bits() != b.to_bits()) {
        panic!("{what}: value {i} is {a} and {b}");
    }
}

fn views() -> Vec<(Gaussians, [u32; 2])> {
    let mut views = vec![(scenes::ordinary(400, 1, true, 3), [97, 61]), (scenes::large(40, 0, 2), [150, 131])];
    views.extend((1..4).map(|seed| (scenes::hard(seed), [160, 120])));
    views.push((scenes::ordinary(60, 0, false, 8), [17, 3]));
    views
}

#[test]
fn images_keep_their_bits() {
    for (scene, size) in views() {
        let camera = scenes::camera(size);
        let with = |on: bool, width: u32, margin: f32| {
            let gpu = Gpu::new().with_slots(on, width, margin);
            channels_of(&gpu, &scene, &camera, true).unwrap()
        };
        let (image, transmittance) = with(false, *widths().last().unwrap(), MARGINS[0]);
        assert!(transmittance.iter().any(|t| *t < 0.5), "nothing to see");
        for width in widths() {
            for (on, margin) in [(false, MARGINS[0]), (true, MARGINS[0]), (true, MARGINS[1])] {
                let (other, rest) = with(on, width, margin);
                assert_same_bits(&format!("image {size:?}, {width}, {on}"), &image, &other);
                assert_same_bits(&format!("transmittance {size:?}, {width}, {on}"), &transmittance, &rest);
            }
        }
    }
}

/// Compares several subgroups per tile with one.
#[test]
fn parts_of_tiles_keep_the_bits_of_images() {
    for (scene, size) in views() {
        let camera = scenes::camera(size);
        for width in widths() {
            for on in [false, true] {
                let with = |parts: u32| {
                    let gpu = Gpu::new().with_slots(on, width, MARGINS[0]).with_tile_parts(parts);
                    channels_of(&gpu, &scene, &camera, true).unwrap()
                };
                let (image, transmittance) = with(1);
                assert!(transmittance.iter().any(|t| *t < 0.5), "nothing to see");
                for parts in [2, 4, 8, 16] {
                    let (other, rest) = with(parts);
                    let what = format!("{size:?}, slots of {width} columns, {on}, {parts} parts");
                    assert_same_bits(&format!("image {what}"), &image, &other);
                    assert_same_bits(&format!("transmittance {what}"), &transmittance, &rest);
                }
            }
        }
    }
}

/// Compares one kernel with and without skipped slots. The order of a sum over pixels follows the slots, and compilers
/// may round sums differently in a kernel without branches.
#[test]
fn gradients_keep_their_bits() {
    let cases = [
        Case::new(scenes::with_semantics(scenes::ordinary(300, 0, true, 15), 6), [61, 43], true),
        Case::new(scenes::with_semantics(scenes::hard(2), 7), [80, 60], false),
        Case::new(scenes::large(20, 1, 5), [97, 71], false),
    ];
    for case in &cases {
        for which in [BackwardKernel::Pixel, BackwardKernel::Splat] {
            for width in widths() {
                let what = format!("{which:?}, slots of {width} columns");
                let with = |margin: f32| case.gpu_gradients(&Gpu::new().with_slots(true, width, margin), which);
                let [(few, few_pose), (all, all_pose)] = MARGINS.map(with);
                assert!(few[0].iter().any(|g| *g != 0.0));
                few.iter().zip(&all).for_each(|(few, all)| assert_same_bits(&what, few, all));
                assert_same_bits(&what, &few_pose, &all_pose);
            }
        }
    }
}

/// Compares one kernel with and without skipped slots.
///
/// Compilers may round differently in a kernel without branches.
#[test]
fn weights_keep_their_bits() {
    let scene = scenes::ordinary(300, 0, true, 9);
    let case = Surfaces::new(scene, scenes::camera([61, 37]), false, 2.0);
    for width in widths() {
        let with = |margin: f32| run(&Gpu::new().with_slots(true, width, margin), &case);
        let [few, all] = MARGINS.map(with);
        assert!(few.weights.iter().any(|w| *w > 0.1));
        assert!(few.row_starts == all.row_starts && few.columns == all.columns, "slots of {width} columns");
        assert_same_bits("weights", &few.weights, &all.weights);
    }
}

#[test]
#[should_panic(expected = "value 1 is 0.5 and")]
fn a_changed_bit_is_detected() {
    assert_same_bits("image", &[0.0, 0.5], &[0.0, f32::from_bits(0.5_f32.to_bits() + 1)]);
}
