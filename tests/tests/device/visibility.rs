//! Visibility field on the device against its reference: values and Adam.

use sgs_engine::graph::Graph;
use sgs_passes::Tuning;
use sgs_passes::optim::{Adam, EPSILON, Rate, adam};
use sgs_passes::shade::visibility::{
    Field, FieldConfig, Gradients, Moments, packed_tables, visibility_adam, visibility_encode,
};
use sgs_shaders::structs::{FieldStep, Step, Work};
use sgs_tests::field::{Case, Found, LossGradients, SMALL, jittered};
use sgs_tests::{Gpu, Tolerance, assert_close};

fn bytes<T: bytemuck::NoUninit>(data: &[T]) -> Vec<u8> {
    bytemuck::cast_slice(data).to_vec()
}

const VALUES: Tolerance = Tolerance::new(2e-6, 2e-5);

#[test]
fn visibility_values_match_reference() {
    let gpu = Gpu::new();
    for (config, pixels, lights) in [
        (SMALL, 1, 1),
        (SMALL, 300, 5),
        (FieldConfig::new(1, 8, 5, 5), 67, 3),
        (FieldConfig::new(5, 12, 16, 4096), 67, 3),
    ] {
        // Kernels of GPUs and of CPUs.
        for cpu in [Some(false), Some(true)] {
            let case = Case { cpu, ..Case::random(config, pixels, lights, 3) };
            let expected = case.expected(None);
            assert_close("mean", &expected, &case.forward(&gpu, None, true), VALUES);
            assert_close("mean, first layer recomputed", &expected, &case.forward(&gpu, None, false), VALUES);
            let last = Some(lights as u32 - 1);
            assert_close("one light", &case.expected(last), &case.forward(&gpu, last, true), VALUES);
        }
    }
}

#[test]
fn visibility_rows_match_reference() {
    let gpu = Gpu::new();
    let case = Case::random(SMALL, 100, 1, 4);
    for (first, count) in [(0, 100_usize), (24, 61), (93, 40)] {
        for (moved, cpu) in [(false, false), (true, false), (false, true), (true, true)] {
            let (mut g, mut inputs) = (Graph::new("visibility"), Vec::new());
            let (field, view) = case.declare(&mut g, &mut inputs);
            let tuning = Tuning { cpu, ..gpu.tuning() };
            let block = if cpu { 1 } else { tuning.subgroup_size as usize };
            let out = g.external("rows", 4 * 32 * count.next_multiple_of(block) as u64);
            let range = [first as u32, count as u32];
            visibility_encode(&mut g, tuning, "encode", &field, &view, range, moved, out).unwrap();
            let found = gpu.run(g, &inputs).get::<f32>(out);
            let field = case.reference();
            for pixel in first..(first + count).min(100) {
                let point = if moved { jittered(&case, pixel) } else { Case::wide(case.points[pixel]) };
                // Rows of a block lie side by side.
                let i = pixel - first;
                let row: Vec<f32> = (0..32).map(|n| found[(i / block * 32 + n) * block + i % block]).collect();
                // A jittered point depends on the device's logarithms and cosines.
                let tolerance = if moved { Tolerance::new(1e-3, 1e-3) } else { Tolerance::new(1e-5, 1e-5) };
                assert_close("row", &field.point_share(point), &row, tolerance);
            }
        }
    }
}

/// Tests 16-bit tables at every magnitude of halves and beyond. The reference rounds the tables as well.
#[test]
fn visibility_of_16_bit_tables_matches_reference() {
    let gpu = Gpu::new();
    let mut largest = 0.0_f64;
    for size in [1.0_f32, 1e-4, 1e-6, 30.0] {
        let mut case = Case::random(SMALL, 300, 5, 3);
        case.tables.iter_mut().for_each(|t| *t *= size);
        let exact = case.forward(&gpu, None, true);
        case.table_bits = 16;
        let (expected, found) = (case.expected(None), case.forward(&gpu, None, true));
        let tolerance = if size > 1.0 { Tolerance::new(1e-4, 1e-4) } else { VALUES };
        assert_close("mean", &expected, &found, tolerance);
        assert_close("mean, first layer recomputed", &expected, &case.forward(&gpu, None, false), tolerance);
        let off = exact.iter().zip(&found).map(|(a, b)| f64::from((a - b).abs())).fold(0.0, f64::max);
        println!("tables times {size}: {off:.2e}");
        if size <= 1.0 {
            largest = largest.max(off);
            assert!(off > 0.0 || size < 1e-4, "tables times {size}: nothing is rounded");
        }
    }
    // `Accuracy` guarantees this bound.
    assert!(largest > 1e-5 && largest < 1e-3, "{largest}");
    let mut wild = Case::random(SMALL, 64, 2, 3);
    wild.table_bits = 16;
    wild.tables.iter_mut().enumerate().for_each(|(i, t)| *t = [1e30, -70000.0, f32::INFINITY, 65504.0][i % 4]);
    assert!(wild.forward(&gpu, None, true).iter().all(|v| (0.0..=1.0).contains(v)));
}

/// Tests edge cases: points at a light and outside the bounds, saturated weights, and no pixels.
#[test]
fn values_are_finite_at_the_edges() {
    let gpu = Gpu::new();
    [Some(false), Some(true)].into_iter().for_each(|cpu| finite_at_the_edges(&gpu, cpu));
}

fn finite_at_the_edges(gpu: &Gpu, cpu: Option<bool>) {
    let mut case = Case { cpu, ..Case::random(SMALL, 64, 4, 6) };
    case.points[0] = case.lights[0];
    case.points[1] = [1e6, -1e6, 1e30];
    case.points[2] = case.low;
    case.points[3] = case.high;
    case.lights[1] = [-100.0, 0.0, 0.0];
    case.lights[2] = case.high;
    assert_close("edges", &case.expected(None), &case.forward(gpu, None, true), VALUES);
    let mut huge = case.clone();
    huge.tables.iter_mut().enumerate().for_each(|(i, t)| *t = if i % 3 == 0 { -1e30 } else { 1e30 });
    assert!(huge.forward(gpu, None, true).iter().all(|v| (0.0..=1.0).contains(v)));
    case.mlp.iter_mut().for_each(|w| *w *= 300.0);
    let found = case.forward(gpu, Some(0), true);
    assert!(found.iter().all(|v| (0.0..=1.0).contains(v)));
    assert_close("saturated", &case.expected(Some(0)), &found, Tolerance::new(2e-3, 0.0));
    // With layers 300 times as large as initial ones, tables of 1e30 overflow. Infinities of both signs have no sum;
    // every result that is a number is a share.
    case.tables.fill(1e30);
    assert!(case.forward(gpu, None, true).iter().all(|v| (0.0..=1.0).contains(v) || v.is_nan()));
    let mut none = Case { cpu, ..Case::random(SMALL, 64, 4, 6) };
    none.coverage.fill(0.0);
    assert!(none.forward(gpu, None, true).iter().all(|v| v.to_bits() == 0));
    none.step.pixels = 3;
    let found = none.forward(gpu, None, true);
    assert!(found[..3].iter().all(|v| *v == 0.0) && found[3..].iter().all(|v| v.to_bits() == u32::MAX));
}

/// Tests the error of 16-bit operands in the second layer. Cooperative matrices take such operands. Layers are initial
/// ones, larger ones, and ones so large that visibility is 0 or 1.
#[test]
fn half_operand_error_is_bounded() {
    for (scale, most, usual) in [(1.0_f32, 2e-4, 3e-5), (4.0, 2e-3, 1e-4), (1e5, 1.0, 0.1)] {
        let mut case = Case::random(SMALL, 500, 6, 9);
        let (inputs, width) = (case.config.inputs(), 32);
        case.mlp[width * inputs..].iter_mut().for_each(|w| *w *= scale);
        let field = case.reference();
        let (mut worst, mut sum, mut wrong) = (0.0_f64, 0.0, 0);
        for point in &case.points {
            for light in &case.lights {
                let (point, light) = (Case::wide(*point), Case::wide(*light));
                let (exact, half) = (field.visibility(point, light), field.visibility_half(point, light));
                let off = (half - exact).abs();
                assert!((0.0..=1.0).contains(&half));
                (worst, sum) = (worst.max(off), sum + off);
                wrong += usize::from((half > 0.5) != (exact > 0.5));
            }
        }
        let mean = sum / 3000.0;
        println!(
            "layers times {scale}: off by {worst:.2e} at most, {mean:.2e} in the mean, {wrong} of 3000 on another side"
        );
        // Visibilities of 0 and 1 are equal in both.
        assert!((worst > 0.0) == (scale < 100.0) && worst <= most && mean < usual, "{worst} {mean}");
        assert!(wrong < 30, "{wrong} of 3000 are on another side");
    }
}

/// Tests that the comparison detects table entries that are off by 1 %.
#[test]
#[should_panic(expected = "mean: element")]
fn a_wrong_entry_is_noticed() {
    let gpu = Gpu::new();
    let case = Case::random(SMALL, 64, 2, 3);
    let mut other = case.clone();
    other.tables.iter_mut().skip(1).step_by(2).for_each(|t| *t *= 1.01);
    assert_close("mean", &other.expected(None), &case.forward(&gpu, None, true), VALUES);
}

/// Results of [`visibility_adam`]. They are tables, their moments, layers, their moments, words of gradients and of
/// bits.
type Stepped = (Vec<u32>, Vec<u32>, Vec<u32>, Vec<u32>, Vec<u32>, Vec<u32>);

/// Runs one step with the gradients of `found`, from nonzero moments.
fn step_sparse(case: &Case, gpu: &Gpu, found: &Found, scale: [f32; 2], flag: u32) -> Stepped {
    // An invocation updates the entries of a word, or one entry; results are equal bit for bit.
    let of = |subgroup_size| {
        let tuning = Tuning { subgroup_size, ..gpu.tuning() };
        step_sparse_with(case, gpu, tuning, found, (scale, flag))
    };
    let (by_word, by_entry) = (of(8), of(32));
    assert!(by_word == by_entry);
    by_word
}

fn step_sparse_with(case: &Case, gpu: &Gpu, tuning: Tuning, found: &Found, (scale, flag): ([f32; 2], u32)) -> Stepped {
    let (mut g, mut inputs) = (Graph::new("visibility_adam"), Vec::new());
    let mut provided = |g: &mut Graph, name: &str, data: Vec<u8>| {
        let buffer = g.external(name, data.len() as u64);
        inputs.push((buffer, data));
        buffer
    };
    let gradients = Gradients {
        mlp: provided(&mut g, "mlp_gradient", bytes(&found.mlp)),
        lights: provided(&mut g, "lights", vec![0; 4]),
        tables: provided(&mut g, "table_gradients", bytes(&found.words)),
        touched: provided(&mut g, "touched", bytes(&found.touched)),
        scale: provided(&mut g, "scale", bytes(&scale)),
    };
    let moments = Moments {
        tables: provided(&mut g, "table_moments", bytes(&moments_of(case.tables.len()))),
        mlp: provided(&mut g, "mlp_moments", bytes(&moments_of(case.mlp.len()))),
        flags: provided(&mut g, "flags", bytes(&[0, flag])),
        flag_words: 2,
        skipped: provided(&mut g, "skipped", vec![0; 4]),
    };
    let tables = provided(&mut g, "tables", bytes(&case.tables));
    let mlp = provided(&mut g, "mlp", bytes(&case.mlp));
    let packed = (case.table_bits == 16).then(|| provided(&mut g, "packed", bytes(&packed_tables(&case.tables))));
    let step = g.uniform("field", size_of::<FieldStep>() as u64);
    inputs.push((step, bytes(&[case.step])));
    let field = Field { config: case.config, step, levels: tables, tables, packed, mlp };
    visibility_adam(&mut g, tuning, &field, &gradients, &moments).unwrap();
    let out = gpu.run(g, &inputs);
    if let Some(packed) = packed {
        // After every step, the copy equals the rounded tables.
        assert!(out.get::<u32>(packed) == packed_tables(&out.get::<f32>(tables)), "the copy is another");
    }
    (
        out.get(tables),
        out.get(moments.tables),
        out.get(mlp),
        out.get(moments.mlp),
        out.get(gradients.tables),
        out.get(gradients.touched),
    )
}

fn moments_of(scalars: usize) -> Vec<[f32; 2]> {
    (0..scalars).map(|i| [(i as f32).sin() * 1e-3, 1e-5 * (1 + i % 7) as f32]).collect()
}

/// Runs one step of a dense Adam that skips zeros.
fn step_dense(case: &Case, gpu: &Gpu, parameters: &[f32], gradient: &[f32]) -> (Vec<u32>, Vec<u32>) {
    let mut g = Graph::new("adam");
    let words = 4 * parameters.len() as u64;
    let a = Adam {
        step: g.uniform("step", size_of::<Step>() as u64),
        live: g.input("live", size_of::<Work>() as u64),
        flags: g.input("flags", 4),
        flag_words: 1,
        width: 1,
        capacity: parameters.len() as u64,
        rate: Rate::Constant(case.step.rate),
        skip_zero: true,
        epsilon: EPSILON,
        gradients: g.input("gradients", words),
        parameters: g.external("parameters", words),
        moments: g.external("moments", 2 * words),
        skipped: g.external("skipped", 4),
    };
    adam(&mut g, gpu.tuning(), "adam", &a).unwrap();
    let (correction1, correction2) = (case.step.correction1, case.step.correction2);
    let inputs = [
        (a.step, bytes(&[Step { correction1, correction2, ..Default::default() }])),
        (a.live, bytes(&[Work { x: 1, y: 1, z: 1, count: parameters.len() as u32 }])),
        (a.flags, vec![0; 4]),
        (a.gradients, bytes(gradient)),
        (a.parameters, bytes(parameters)),
        (a.moments, bytes(&moments_of(parameters.len()))),
        (a.skipped, vec![0; 4]),
    ];
    let out = gpu.run(g, &inputs);
    (out.get(a.parameters), out.get(a.moments))
}

/// Tests that a 16-bit copy does not affect the step, for numbers of every size. The copy itself is checked as well.
#[test]
fn copy_of_tables_in_16_bits_is_updated() {
    let gpu = Gpu::new();
    let mut case = Case::random(SMALL, 30, 2, 12);
    case.step = FieldStep { rate: 4e-3, correction1: 2.5, correction2: 300.0, ..case.step };
    let sizes = [1.0, 1e-3, 1e-5, 1e5, 3e-8];
    case.tables.iter_mut().enumerate().for_each(|(i, t)| *t *= sizes[i % sizes.len()]);
    let mut requested = LossGradients::random(&case, 1.0, 13);
    requested.options.regularized = false;
    let found = case.backward(&gpu, &requested);
    let scale = [found.scale, 1.0 / found.scale];
    for flag in [0, 4] {
        case.table_bits = 32;
        let plain = step_sparse(&case, &gpu, &found, scale, flag);
        case.table_bits = 16;
        assert!(step_sparse(&case, &gpu, &found, scale, flag) == plain, "flag {flag}");
    }
}

/// Tests that sparse Adam equals dense Adam that skips zeros, bit for bit. The step zeroes the gradients. With a raised
/// flag, it only zeroes the gradients.
#[test]
fn sparse_adam_is_dense_adam_that_skips_zeros() {
    let gpu = Gpu::new();
    let mut case = Case::random(SMALL, 30, 2, 12);
    case.step = FieldStep { rate: 4e-3, correction1: 2.5, correction2: 300.0, ..case.step };
    let mut requested = LossGradients::random(&case, 1.0, 13);
    requested.options.regularized = false;
    let mut found = case.backward(&gpu, &requested);
    found.mlp[5] = 0.0;
    let scale = [found.scale, 1.0 / found.scale];
    let (tables, moments, mlp, mlp_moments, words, touched) = step_sparse(&case, &gpu, &found, scale, 0);
    assert!(words.iter().chain(&touched).all(|w| *w == 0));
    // The conversion to floating point matches the kernel's.
    let float = |w: &[u32]| {
        let value = (u64::from(w[0]) | u64::from(w[1]) << 32) as i64;
        let (size, sign) = (value.unsigned_abs(), if value < 0 { -1.0 } else { 1.0 });
        sign * 4_294_967_296.0_f32.mul_add((size >> 32) as f32, size as u32 as f32) * scale[1]
    };
    let gradient: Vec<f32> = found.words.chunks(2).map(float).collect();
    let moved = gradient.iter().filter(|g| **g != 0.0).count();
    assert!(moved > 500 && moved < gradient.len() / 2, "{moved} of {}", gradient.len());
    assert!(step_dense(&case, &gpu, &case.tables, &gradient) == (tables, moments), "tables differ");
    assert!(step_dense(&case, &gpu, &case.mlp, &found.mlp) == (mlp, mlp_moments), "layers differ");
    let (tables, moments, mlp, mlp_moments, words, touched) = step_sparse(&case, &gpu, &found, scale, 1 << 31);
    assert!(words.iter().chain(&touched).all(|w| *w == 0));
    let same = |a: &[u32], b: Vec<u8>| bytes(a) == b;
    assert!(same(&tables, bytes(&case.tables)) && same(&moments, bytes(&moments_of(case.tables.len()))));
    assert!(same(&mlp, bytes(&case.mlp)) && same(&mlp_moments, bytes(&moments_of(case.mlp.len()))));
}
