//! Visibility field with 16-bit operands in its second layer. Matrix units take such operands.
//!
//! Kernels for matrix units and kernels that multiply the same tiles with ordinary instructions share one source. They
//! differ in three operations on tiles. The latter run here in every shape and at every subgroup size of devices. They
//! are tested against the reference that rounds alike and against the portable kernel. On a device with matrix units,
//! and with a compiler that supports them, the former run too. Elsewhere the tests print why they are skipped.

use sgs_engine::MatrixShape;
use sgs_passes::{Accuracy, Matrices, Tuning};
use sgs_tests::field::{Case, SMALL};
use sgs_tests::{Gpu, Tolerance, assert_close};

/// Rows, columns and depth of each shape.
const SHAPES: [[u32; 3]; 5] = [[8, 8, 8], [16, 16, 16], [16, 8, 16], [16, 8, 8], [32, 32, 16]];

fn by_pieces(own: Tuning, subgroup_size: u32, [rows, columns, depth]: [u32; 3], units: bool) -> Tuning {
    let matrices = Some(Matrices { shape: MatrixShape { rows, columns, depth }, units });
    let accuracy = Accuracy { visibility_bits: 16, ..own.accuracy };
    Tuning { subgroup_size, matrices, accuracy, ..own }
}

/// Creates a field whose layers after the first are larger.
fn scaled(pixels: usize, lights: usize, scale: f32) -> Case {
    let mut case = Case::random(SMALL, pixels, lights, 9);
    let first = 32 * case.config.inputs();
    case.mlp[first..].iter_mut().for_each(|w| *w *= scale);
    case
}

/// Returns the largest and the mean difference.
fn apart(a: &[f64], b: &[f32]) -> (f64, f64) {
    let off = || a.iter().zip(b).map(|(a, b)| (a - f64::from(*b)).abs());
    (off().fold(0.0, f64::max), off().sum::<f64>() / a.len() as f64)
}

/// Fails unless the kernel rounds like the reference. In few places, single precision moves a number of the first layer
/// across a rounding boundary. The mean difference therefore shows whether the kernel rounds alike.
fn rounds_as_the_reference(name: &str, case: &Case, one: Option<u32>, found: &[f32]) {
    let (exact, half) = (case.expected(one), case.expected_half(one));
    let single: Vec<f32> = half.iter().map(|v| *v as f32).collect();
    let (worst, mean) = apart(&half, found);
    let (most, rounding) = apart(&exact, &single);
    println!(
        "{name}: {worst:.1e} ({mean:.1e}) from the reference that rounds, which is {most:.1e} ({rounding:.1e}) from exact"
    );
    assert!(rounding > 0.0 && mean < 0.1 * rounding && worst < 0.5 * most, "{name}");
}

#[test]
fn matrix_tiles_of_every_shape_match() {
    let gpu = Gpu::new();
    // Tables of 16 bits are tested as well.
    for table_bits in [32, 16] {
        let case = Case { table_bits, ..scaled(100, 5, 4.0) };
        let with = |subgroup_size, shape| {
            case.forward_with(&gpu, by_pieces(gpu.tuning(), subgroup_size, shape, false), None, true)
        };
        let first = with(8, SHAPES[0]);
        rounds_as_the_reference("mean", &case, None, &first);
        // All shapes sum each element in the same order.
        let wider = [(32, SHAPES[1]), (64, SHAPES[2]), (16, SHAPES[4])];
        for (subgroup_size, shape) in SHAPES[1..].iter().map(|shape| (8, *shape)).chain(wider) {
            assert!(with(subgroup_size, shape) == first, "{subgroup_size} lanes, {shape:?}");
        }
    }
}

#[test]
fn operand_rounding_matches_reference() {
    let gpu = Gpu::new();
    let tuning = by_pieces(gpu.tuning(), 8, SHAPES[2], false);
    for scale in [1.0, 4.0] {
        let case = scaled(200, 6, scale);
        rounds_as_the_reference("mean", &case, None, &case.forward_with(&gpu, tuning, None, true));
        let found = case.forward_with(&gpu, tuning, Some(3), true);
        rounds_as_the_reference("one light", &case, Some(3), &found);
        // This bounds the error against the portable kernel. `half_operand_error_is_bounded` bounds it for the
        // reference.
        let portable: Vec<f64> = case.forward(&gpu, Some(3), true).into_iter().map(f64::from).collect();
        let bound = if scale > 1.0 { 1e-2 } else { 1e-3 };
        assert_close("portable", &portable, &found, Tolerance::new(bound, 0.0));
    }
}

/// Tests that a kernel without rounding is detected.
#[test]
#[should_panic(expected = "the portable kernel")]
fn operands_that_are_not_rounded_are_noticed() {
    let gpu = Gpu::new();
    let case = scaled(200, 6, 4.0);
    rounds_as_the_reference("the portable kernel", &case, None, &case.forward(&gpu, None, true));
}

/// Tests edge cases: points at a light and outside the bounds, layers beyond the range of 16 bits, and no pixels.
#[test]
fn values_are_finite_at_the_edges() {
    let gpu = Gpu::new();
    // The tile has columns without a pixel.
    let tuning = by_pieces(gpu.tuning(), 8, SHAPES[1], false);
    let mut case = Case::random(SMALL, 67, 4, 6);
    case.points[0] = case.lights[0];
    case.points[1] = [1e6, -1e6, 1e30];
    case.lights[1] = [-100.0, 0.0, 0.0];
    assert_close(
        "edges",
        &case.expected_half(None),
        &case.forward_with(&gpu, tuning, None, true),
        Tolerance::new(1e-4, 0.0),
    );
    for scale in [300.0, 1e7] {
        case.mlp.iter_mut().for_each(|w| *w *= scale);
        let found = case.forward_with(&gpu, tuning, Some(0), true);
        assert!(found.iter().all(|v| (0.0..=1.0).contains(v)), "layers times {scale}");
    }
    let mut none = Case::random(SMALL, 67, 4, 6);
    none.coverage.fill(0.0);
    none.step.pixels = 3;
    let found = none.forward_with(&gpu, tuning, None, true);
    assert!(found[..3].iter().all(|v| *v == 0.0) && found[3..].iter().all(|v| v.to_bits() == u32::MAX));
}

/// Tests that the portable kernel runs without matrix units. It runs where 16 bits are allowed but units are missing,
/// and where units exist but 32 bits are requested. Results are equal bit for bit.
#[test]
fn portable_kernel_runs_without_matrix_units() {
    let gpu = Gpu::new();
    let case = scaled(100, 5, 4.0);
    let own = gpu.tuning();
    let portable = case.forward_with(&gpu, Tuning { matrices: None, ..own }, None, true);
    let requested = Tuning { matrices: None, ..by_pieces(own, own.subgroup_size, SHAPES[1], false) };
    assert!(requested.field_matrices().is_none() && case.forward_with(&gpu, requested, None, true) == portable);
    let exact = by_pieces(own, own.subgroup_size, SHAPES[1], false).with(Accuracy::EXACT);
    assert!(exact.field_matrices().is_none() && case.forward_with(&gpu, exact, None, true) == portable);
    // Matrix units are used only if this build has kernels for them.
    let units = by_pieces(own, own.subgroup_size, SHAPES[1], true);
    assert_eq!(units.field_matrices().is_some(), Matrices::compiled());
    match Matrices::for_device(gpu.device().info()) {
        Ok(m) => assert!(Matrices::compiled() && own.matrices == Some(m)),
        Err(why) => {
            println!("no matrix units here: {why}");
            assert!(own.matrices.is_none() && own.with(Accuracy::FAST).field_matrices().is_none());
        }
    }
}

/// Tests matrix units of the device. The test requires a device with units and a build whose compiler supports them.
#[test]
fn matrix_units_match_ordinary_instructions() {
    let gpu = Gpu::new();
    let own = match Matrices::for_device(gpu.device().info()) {
        Ok(m) => Tuning { matrices: Some(m), ..gpu.tuning() },
        Err(why) => {
            println!("skipped: {why}");
            return;
        }
    };
    for info in gpu.device().info().matrices.clone() {
        let shape = [info.rows, info.columns, info.depth];
        if 32 % shape[0] != 0 || 32 % shape[2] != 0 || own.subgroup_size % shape[1] != 0 {
            continue;
        }
        let case = scaled(200, 6, 4.0);
        let [units, plain] = [true, false]
            .map(|units| case.forward_with(&gpu, by_pieces(own, own.subgroup_size, shape, units), None, true));
        rounds_as_the_reference("on units", &case, None, &units);
        let plain: Vec<f64> = plain.into_iter().map(f64::from).collect();
        assert_close("on units", &plain, &units, Tolerance::new(2e-5, 0.0));
    }
}

/// Tests the interface and the code of kernels for matrix units. The interface equals that of the kernels without
/// units.
#[test]
fn matrix_unit_kernels_have_the_expected_interface_and_types() {
    let forward = ["visibility", "lights_field", "lights_split_field", "lights_train_field"];
    // One product, with two loads and a store. Backward it is called three times, beside two products of other operands
    // whose sums are stored at the end.
    let forward = forward.map(|name| (name, [1, 2, 1]));
    let backward = ["visibility_bwd", "visibility_lights_bwd"].map(|name| (name, [3, 6, 3]));
    let names: Vec<_> = forward.into_iter().chain(backward).collect();
    for (name, operations) in names.iter().copied() {
        let listed = sgs_shaders::OPTIONAL.iter().find(|o| o.name == format!("{name}_cooperative")).unwrap();
        assert_eq!(listed.extension, "GL_KHR_cooperative_matrix");
        let halves = sgs_shaders::ALL.iter().find(|k| k.name == format!("{name}_halves")).unwrap();
        let Some(units) = listed.kernel else {
            println!("skipped: this build's compiler does not know {}", listed.extension);
            continue;
        };
        assert_eq!(format!("{:?}", units.bindings), format!("{:?}", halves.bindings), "{name}");
        assert_eq!(format!("{:?}", units.specs), format!("{:?}", halves.specs), "{name}");
        assert_eq!(units.push_bytes, halves.push_bytes);
        check_units(name, units.spirv.words(), operations);
    }
    assert_eq!(sgs_shaders::OPTIONAL.len(), names.len());
}

/// Returns opcode and operands of each instruction of a module.
fn instructions(words: &[u32]) -> Vec<(u32, &[u32])> {
    let (mut rest, mut found) = (&words[5..], vec![]);
    while let Some(head) = rest.first() {
        let (one, more) = rest.split_at((head >> 16) as usize);
        found.push((head & 0xffff, &one[1..]));
        rest = more;
    }
    found
}

/// Fails unless a module multiplies cooperative matrices of the expected types. Operands have 16 bits and sums 32 bits;
/// sizes are specialization constants.
fn check_units(name: &str, words: &[u32], operations: [usize; 3]) {
    let all = instructions(words);
    let of = |opcode: u32| all.iter().filter(move |(o, _)| *o == opcode).map(|(_, i)| *i);
    // OpCapability Float16, CooperativeMatrixKHR.
    let capabilities: Vec<u32> = of(17).map(|i| i[0]).collect();
    assert!(capabilities.contains(&9) && capabilities.contains(&6022), "{name}: {capabilities:?}");
    // Constants map ids to specialization constants, float widths and values.
    let spec = |id: u32| of(71).find(|i| i[0] == id && i[1] == 1).map(|i| i[2]);
    let bits = |id: u32| of(22).find(|i| i[0] == id).map(|i| i[1]);
    let value = |id: u32| of(43).find(|i| i[1] == id).map(|i| i[2]);
    // OpTypeCooperativeMatrixKHR: component, scope, rows, columns, use.
    let mut types: Vec<_> = of(4456).map(|i| (value(i[5]), bits(i[1]), value(i[2]), spec(i[3]), spec(i[4]))).collect();
    types.sort();
    let [rows, columns, depth, subgroup] = [35, 36, 37, 3].map(Some);
    let expected = [
        (Some(0), Some(16), subgroup, rows, depth),
        (Some(1), Some(16), subgroup, depth, columns),
        (Some(2), Some(32), subgroup, rows, columns),
    ];
    assert_eq!(types, expected, "{name}");
    // OpCooperativeMatrixMulAddKHR, loads and stores.
    assert_eq!([4459, 4457, 4458].map(|o| of(o).count()), operations, "{name}");
}
