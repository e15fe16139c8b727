//! Gradients of the visibility field on the device against its reference.

use sgs_passes::shade::visibility::FieldConfig;
use sgs_tests::field::{Case, Found, LossGradients, SMALL};
use sgs_tests::{Gpu, Tolerance, assert_close};

fn bytes<T: bytemuck::NoUninit>(data: &[T]) -> Vec<u8> {
    bytemuck::cast_slice(data).to_vec()
}

/// Kernels of GPUs and of CPUs.
const BOTH: [Option<bool>; 2] = [Some(false), Some(true)];

#[test]
fn visibility_gradients_match_reference() {
    let gpu = Gpu::new();
    let one = FieldConfig::new(1, 8, 5, 5);
    let cases = [(SMALL, 37, 3, 0.0), (SMALL, 300, 5, 0.3), (one, 9, 2, 0.1), (SMALL, 64, 1, 0.3)];
    for (cpu, (config, pixels, lights, regularizer)) in BOTH.into_iter().flat_map(|b| cases.map(|c| (b, c))) {
        let mut case = Case { cpu, ..Case::random(config, pixels, lights, 8) };
        case.step.regularizer = regularizer;
        let mut requested = LossGradients::random(&case, 1.0, 9);
        requested.options.regularized = regularizer > 0.0;
        case.check_gradients(&gpu, &requested, 1e-5);
    }
}

/// Tests gradients with 16-bit tables against those at the rounded tables. Points include edge cases.
#[test]
fn gradients_of_16_bit_tables_match_reference() {
    let gpu = Gpu::new();
    for (regularizer, size) in [(0.0, 1.0), (0.3, 1.0), (0.0, 1e-4)] {
        let mut case = Case::random(SMALL, 120, 4, 8);
        case.table_bits = 16;
        case.tables.iter_mut().for_each(|t| *t *= size);
        case.points[0] = case.lights[0];
        case.points[1] = [1e6, -1e6, 1e30];
        case.step.regularizer = regularizer;
        let mut requested = LossGradients::random(&case, 1.0, 9);
        requested.options.regularized = regularizer > 0.0;
        case.check_gradients(&gpu, &requested, 2e-5);
    }
}

/// Tests that a second run gives the same bits. Runs with another order of pixels give the same table gradients,
/// because their sums do not depend on the order.
#[test]
fn visibility_gradients_are_deterministic() {
    let gpu = Gpu::new();
    BOTH.into_iter().for_each(|cpu| is_deterministic(&gpu, Case { cpu, ..Case::random(SMALL, 150, 3, 14) }));
}

fn is_deterministic(gpu: &Gpu, mut case: Case) {
    case.step.regularizer = 0.1;
    let requested = LossGradients::random(&case, 1.0, 15);
    let (a, b) = (case.backward(gpu, &requested), case.backward(gpu, &requested));
    assert!(bytes(&a.mlp) == bytes(&b.mlp) && bytes(&a.lights) == bytes(&b.lights));
    assert!(a.words == b.words && a.touched == b.touched);
    // In reverse order, other workgroups process the pixels. The random draw of each pixel is off.
    let mut requested = requested;
    requested.options.regularized = false;
    let a = case.backward(gpu, &requested);
    case.points.reverse();
    case.coverage.reverse();
    requested.pixels.reverse();
    let b = case.backward(gpu, &requested);
    assert!(a.words == b.words && a.touched == b.touched && a.scale == b.scale);
    assert!(
        bytes(&a.mlp) != bytes(&b.mlp),
        "layers are summed in order, so an equal sum shows that nothing was reversed"
    );
}

/// Tests edge cases: gradients are finite, and match the reference where it is meaningful. Points lie at a light and
/// outside the bounds, weights saturate, and gradients are huge and tiny.
#[test]
fn visibility_gradients_match_reference_at_the_edges() {
    let gpu = Gpu::new();
    BOTH.into_iter().for_each(|cpu| at_the_edges(&gpu, Case { cpu, ..Case::random(SMALL, 48, 4, 16) }));
}

fn at_the_edges(gpu: &Gpu, mut case: Case) {
    case.points[0] = case.lights[0];
    case.points[1] = [1e6, -1e6, 1e30];
    case.points[2] = case.low;
    case.points[3] = case.high;
    case.points[4] = [case.lights[0][0] + 1e-6, case.lights[0][1], case.lights[0][2]];
    case.lights[1] = [-100.0, 0.0, 0.9];
    case.lights[2] = case.high;
    for scale in [1.0, 1e-20, 1e20] {
        let mut requested = LossGradients::random(&case, scale, 17);
        requested.options.regularized = false;
        case.check_gradients(gpu, &requested, 2e-5);
    }
    let requested = LossGradients::random(&case, 1.0, 17);
    let all = |f: &Found| f.mlp.iter().chain(&f.tables).chain(&f.lights).all(|x| x.is_finite());
    for weight in [30.0, 1e4, 1e15] {
        let mut wild = case.clone();
        wild.mlp.iter_mut().for_each(|w| *w *= weight);
        assert!(all(&wild.backward(gpu, &requested)), "weights times {weight}");
    }
    let mut none = case.clone();
    none.coverage.fill(0.0);
    none.points.fill([f32::NAN; 3]);
    let found = none.backward(gpu, &requested);
    let zero = |v: &[f32]| v.iter().all(|x| *x == 0.0);
    assert!(zero(&found.mlp) && zero(&found.lights) && found.words.iter().chain(&found.touched).all(|w| *w == 0));
}

/// Tests sampling of pairs, weighted by the inverse share. A draw takes some pairs, and the mean over draws equals the
/// full gradient. The regularizer at jittered positions is tested alone as well.
#[test]
fn sampled_pairs_are_unbiased() {
    let gpu = Gpu::new();
    for (scale, regularizer) in [(1.0, 0.0), (0.0, 0.3)] {
        let mut case = Case::random(FieldConfig::new(1, 8, 5, 5), 160, 6, 18);
        case.step.regularizer = regularizer;
        let mut requested = LossGradients::random(&case, scale, 19);
        requested.options.regularized = regularizer > 0.0;
        let draws = 60;
        let [mut all, mut mean] = [0, 1].map(|_| vec![0.0_f64; case.mlp.len()]);
        let mut first = [vec![], vec![]];
        for seed in 0..draws {
            // The jitter changes with the seed.
            case.step.seed = seed;
            let found = [1, 3].map(|sample| {
                requested.options.sample = sample;
                case.backward(&gpu, &requested).mlp.iter().map(|x| f64::from(*x)).collect::<Vec<f64>>()
            });
            for (sum, found) in [&mut all, &mut mean].into_iter().zip(&found) {
                sum.iter_mut().zip(found).for_each(|(m, f)| *m += f / f64::from(draws));
            }
            first = if seed == 0 { found } else { first };
        }
        let norm = |v: &mut dyn Iterator<Item = f64>| v.map(|x| x * x).sum::<f64>().sqrt();
        let size = norm(&mut all.iter().copied());
        let away = |a: &[f64], b: &[f64]| norm(&mut a.iter().zip(b).map(|(a, b)| a - b)) / size;
        let (one, many) = (away(&first[1], &first[0]), away(&mean, &all));
        assert!(size > 0.0 && one > 0.05, "one draw {one} of {size}");
        assert!(many < 3.0 * one / f64::from(draws).sqrt(), "regularizer {regularizer}: {one}, mean of {draws} {many}");
    }
}

/// Tests that both kernels sample the same pairs; the test above shows that they are the right ones. Groups of pixels
/// visit different lights in one of the kernels, and all pixels of a subgroup the same ones in the other.
#[test]
fn both_kernels_sample_the_same_pairs() {
    let gpu = Gpu::new();
    let mut case = Case::random(SMALL, 150, 6, 18);
    case.step.regularizer = 0.3;
    let mut requested = LossGradients::random(&case, 1.0, 19);
    requested.options.sample = 3;
    same_gradients(&gpu, &case, &requested);
}

fn same_gradients(gpu: &Gpu, case: &Case, requested: &LossGradients) {
    let [a, b] = BOTH.map(|cpu| Case { cpu, ..case.clone() }.backward(gpu, requested));
    let wide = |v: &[f32]| v.iter().map(|x| f64::from(*x)).collect::<Vec<f64>>();
    for (what, a, b) in [("layers", &a.mlp, &b.mlp), ("tables", &a.tables, &b.tables), ("lights", &a.lights, &b.lights)]
    {
        let largest = a.iter().fold(0.0_f64, |m, x| m.max(f64::from(x.abs())));
        assert!(largest > 0.0);
        assert_close(what, &wide(a), b, Tolerance::new(1e-5 * largest, 1e-3));
    }
}

/// Tests that subgroups may share the lights of a batch of pixels. With one unit a subgroup visits them all, with two every
/// second light, with many one light.
#[test]
fn split_lights_match_reference() {
    let gpu = Gpu::new();
    let pixels = 40 * gpu.tuning().subgroup_size as usize - 3;
    for units in [1, 2, 48] {
        let mut case = Case { cpu: Some(false), units: Some(units), ..Case::random(SMALL, pixels, 5, 8) };
        case.step.regularizer = 0.3;
        let mut requested = LossGradients::random(&case, 1.0, 9);
        case.check_gradients(&gpu, &requested, 1e-5);
        requested.options.sample = 2;
        same_gradients(&gpu, &case, &requested);
    }
}

/// Tests that the comparison detects an entry's gradient that is off by 1 %.
#[test]
#[should_panic(expected = "tables: element")]
fn a_wrong_gradient_is_noticed() {
    let gpu = Gpu::new();
    let case = Case::random(SMALL, 37, 3, 8);
    let mut requested = LossGradients::random(&case, 1.0, 9);
    requested.options.regularized = false;
    let mut expected = case.expected_gradients(&requested.options, |i, j| requested.by_visibility(i, j));
    let largest =
        (0..expected.tables.len()).max_by(|a, b| expected.tables[*a].abs().total_cmp(&expected.tables[*b].abs()));
    expected.tables[largest.unwrap()] *= 1.01;
    case.backward(&gpu, &requested).check(&expected, true, 1e-5);
}
