//! Gradients of the visibility field with 16-bit operands.
//!
//! Kernels without matrix units multiply the same tiles as those with units, see `visibility_matrices`. Their gradients
//! are compared with double precision. The bound follows from the rounding of each operand to eleven binary digits, by
//! pair: `Field::visibility_bwd_half_bound`. Sums of the mean difference show that operands are rounded, and how.

use sgs_passes::Matrices;
use sgs_passes::rng::random_bits;
use sgs_passes::shade::visibility::FieldConfig;
use sgs_tests::Gpu;
use sgs_tests::field::{Case, Found, LossGradients, SMALL, tiles};

/// Rows, columns and depth of each shape. Their columns divide the layer.
const SHAPES: [[u32; 3]; 5] = [[8, 8, 8], [16, 16, 16], [16, 8, 16], [16, 8, 8], [32, 32, 16]];

/// Single precision, as a fraction of the largest gradient of each kind.
const SINGLE: f64 = 2e-5;

fn on_tiles(case: Case, shape: [u32; 3]) -> Case {
    Case { cpu: Some(false), matrices: Some(tiles(shape)), ..case }
}

fn bits(found: &Found) -> Vec<u8> {
    let floats = |v: &[f32]| bytemuck::cast_slice::<f32, u8>(v).to_vec();
    [floats(&found.mlp), floats(&found.lights), bytemuck::cast_slice(&found.words).to_vec()].concat()
}

fn finite(found: &Found) -> bool {
    found.mlp.iter().chain(&found.tables).chain(&found.lights).all(|x| x.is_finite())
}

#[test]
fn gradients_of_every_shape_are_within_the_bound() {
    let gpu = Gpu::new();
    let one = FieldConfig::new(1, 8, 5, 5);
    let cases = [(SMALL, 37, 3, 0.0), (SMALL, 70, 3, 0.3), (one, 9, 2, 0.1), (SMALL, 40, 2, 0.0), (one, 64, 1, 0.3)];
    for (shape, (config, pixels, lights, regularizer)) in SHAPES.into_iter().zip(cases) {
        let mut case = on_tiles(Case::random(config, pixels, lights, 8), shape);
        case.step.regularizer = regularizer;
        let mut requested = LossGradients::random(&case, 1.0, 9);
        requested.options.regularized = regularizer > 0.0;
        case.check_rounded_gradients(&case.backward(&gpu, &requested), &requested, SINGLE);
    }
}

/// Tests that shapes of tiles and a second run give the same bits.
///
/// All shapes sum each element in the same order.
#[test]
fn gradients_are_independent_of_the_shape() {
    let gpu = Gpu::new();
    let mut case = Case::random(SMALL, 60, 3, 14);
    case.step.regularizer = 0.1;
    let requested = LossGradients::random(&case, 1.0, 15);
    let first = bits(&on_tiles(case.clone(), SHAPES[0]).backward(&gpu, &requested));
    for shape in [SHAPES[0], SHAPES[1], SHAPES[3]] {
        assert!(bits(&on_tiles(case.clone(), shape).backward(&gpu, &requested)) == first, "{shape:?}");
    }
}

/// Tests extreme points, gradients and weights.
#[test]
fn gradients_at_the_edges_are_within_the_bound() {
    let gpu = Gpu::new();
    let mut case = on_tiles(Case::random(SMALL, 48, 4, 16), SHAPES[2]);
    case.points[0] = case.lights[0];
    case.points[1] = [1e6, -1e6, 1e30];
    case.points[2] = case.low;
    case.points[3] = case.high;
    case.points[4] = [case.lights[0][0] + 1e-6, case.lights[0][1], case.lights[0][2]];
    case.lights[1] = [-100.0, 0.0, 0.9];
    case.lights[2] = case.high;
    for (gradient, weight) in [(1.0, 1.0), (1e-20, 1.0), (1e20, 1.0), (1.0, 3.0), (1.0, 0.05)] {
        let mut case = case.clone();
        case.mlp[32 * SMALL.inputs()..].iter_mut().for_each(|w| *w *= weight);
        let mut requested = LossGradients::random(&case, gradient, 17);
        requested.options.regularized = false;
        case.check_rounded_gradients(&case.backward(&gpu, &requested), &requested, SINGLE);
    }
    // Gradients of the pixels spread over thirty powers of ten; scales of lights differ from batch to batch.
    let mut requested = LossGradients::random(&case, 1.0, 17);
    requested.options.regularized = false;
    for (i, pixel) in requested.pixels.iter_mut().enumerate() {
        *pixel = pixel.map(|g| g * 10.0_f32.powi(-(i as i32 * 30 / 48)));
    }
    case.check_rounded_gradients(&case.backward(&gpu, &requested), &requested, SINGLE);
    for weight in [30.0, 1e4, 1e15] {
        let mut wild = case.clone();
        wild.mlp.iter_mut().for_each(|w| *w *= weight);
        assert!(finite(&wild.backward(&gpu, &requested)), "weights times {weight}");
    }
    let mut none = case.clone();
    none.coverage.fill(0.0);
    none.points.fill([f32::NAN; 3]);
    let found = none.backward(&gpu, &requested);
    let zero = |v: &[f32]| v.iter().all(|x| *x == 0.0);
    assert!(zero(&found.mlp) && zero(&found.lights) && found.words.iter().all(|w| *w == 0));
}

/// Tests tables of 16 bits, sampled pairs, and lights shared by several subgroups.
#[test]
fn sampled_and_split_gradients_are_within_the_bound() {
    let gpu = Gpu::new();
    let pixels = 6 * gpu.tuning().subgroup_size as usize - 3;
    for (sample, units, table_bits) in [(1, 48, 16), (3, 1, 32)] {
        let case = Case { units: Some(units), table_bits, ..Case::random(SMALL, pixels, 5, 8) };
        let case = on_tiles(case, SHAPES[1]);
        let mut requested = LossGradients::random(&case, 1.0, 9);
        requested.options.regularized = false;
        requested.options.sample = sample;
        // Groups of eight pixels draw the same lights.
        let is_drawn =
            |i: usize, j: usize| random_bits(case.step.seed ^ 0x3c6e, i as u32 / 8, j as u32).is_multiple_of(sample);
        let weighted =
            |i: usize, j: usize| if is_drawn(i, j) { f64::from(sample) * requested.by_visibility(i, j) } else { 0.0 };
        case.rounded_gradients(false, weighted).check(&case.backward(&gpu, &requested), SINGLE);
    }
}

/// Tests that a kernel without rounding is detected.
#[test]
#[should_panic(expected = "layers: ")]
fn gradients_that_are_not_rounded_are_noticed() {
    let gpu = Gpu::new();
    let case = Case { cpu: Some(false), ..Case::random(SMALL, 37, 3, 8) };
    let mut requested = LossGradients::random(&case, 1.0, 9);
    requested.options.regularized = false;
    case.check_rounded_gradients(&case.backward(&gpu, &requested), &requested, SINGLE);
}

/// Tests that a wrong gradient is detected.
#[test]
#[should_panic(expected = "layers 1160: ")]
fn a_wrong_gradient_is_noticed() {
    let gpu = Gpu::new();
    let case = on_tiles(Case::random(SMALL, 37, 3, 8), SHAPES[1]);
    let mut requested = LossGradients::random(&case, 1.0, 9);
    requested.options.regularized = false;
    let mut found = case.backward(&gpu, &requested);
    let largest = found.mlp.iter().fold(0.0_f32, |m, x| m.max(x.abs()));
    found.mlp[32 * SMALL.inputs() + 8] += 0.1 * largest;
    case.check_rounded_gradients(&found, &requested, SINGLE);
}

/// Tests matrix units of the device against ordinary instructions.
#[test]
fn gradients_on_matrix_units_are_within_the_bound() {
    let gpu = Gpu::new();
    let matrices = match Matrices::for_device(gpu.device().info()) {
        Ok(m) => m,
        Err(why) => {
            println!("skipped: {why}");
            return;
        }
    };
    let mut case = Case { matrices: Some(matrices), cpu: Some(false), ..Case::random(SMALL, 300, 5, 8) };
    case.step.regularizer = 0.3;
    let requested = LossGradients::random(&case, 1.0, 9);
    let found = case.backward(&gpu, &requested);
    case.check_rounded_gradients(&found, &requested, SINGLE);
    assert!(bits(&found) == bits(&case.backward(&gpu, &requested)), "a second run differs");
}

/// Tests kernels for matrix units on the emulator, bit for bit.
///
/// They sum each element in the order of those without units there. The test requires a build whose compiler knows the
/// extension.
#[test]
fn kernels_for_units_match_on_the_emulator() {
    if !Matrices::compiled() || std::env::var_os("SGS_TEST_EMULATE").is_none() {
        println!("skipped: needs a compiler that knows GL_KHR_cooperative_matrix, and SGS_TEST_EMULATE");
        return;
    }
    let gpu = Gpu::new();
    for shape in SHAPES {
        let mut case = on_tiles(Case::random(SMALL, 70, 3, 8), shape);
        case.step.regularizer = 0.3;
        let requested = LossGradients::random(&case, 1.0, 9);
        let units = Case { matrices: Some(Matrices { units: true, ..tiles(shape) }), ..case.clone() };
        assert!(bits(&case.backward(&gpu, &requested)) == bits(&units.backward(&gpu, &requested)), "{shape:?}");
        assert!(case.forward(&gpu, None, true) == units.forward(&gpu, None, true), "{shape:?}");
    }
}
