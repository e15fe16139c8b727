//! Property tests of visibility fields against the double-precision reference.
//!
//! All sizes are drawn log-uniformly. Visibility of lights and gradients of tables, layers and positions are compared.
//! Failures are shrunk. Every run draws the same cases; `SGS_TEST_CASES` sets their number.
//!
//! Bounds of single precision are measured. They follow from the magnitudes of the summands, and from the sensitivity of
//! the reference to perturbations of tables and weights by a few units in the last place.

use proptest::prelude::*;
use sgs_passes::reference::rng::Pcg;
use sgs_passes::reference::visibility as reference;
use sgs_passes::shade::visibility::FieldConfig;
use sgs_tests::Gpu;
use sgs_tests::drawn::{runner, signed, spread};
use sgs_tests::field::{Case, LossGradients};

/// Relative perturbation of tables and weights.
const MOVE: f64 = 5e-7;

/// Perturbation of points in the grid, as a share of the box.
const SLIP: f32 = 1e-7;

/// Number of perturbed fields.
const DRAWS: u32 = 4;

/// Margin of a ReLU input, relative to its terms. Below it, rounding may decide about the gradient.
const MARGIN: f64 = 1e-5;

/// Draws a coordinate of a point or a light, as a share of the box.
fn place() -> impl Strategy<Value = f64> {
    prop_oneof![
        6 => 0.0..1.0,
        2 => spread(-7.0, -0.3),
        2 => spread(-7.0, -0.3).prop_map(|x| 1.0 - x),
        1 => signed(-3.0, 6.0),
        1 => prop_oneof![Just(0.0), Just(0.5), Just(1.0)],
    ]
}

#[derive(Clone, Debug)]
struct Drawn {
    levels: u32,
    log2_table: u32,
    coarsest: u32,
    growth: f64,
    tables: f64,
    layers: [f64; 3],
    center: [f64; 3],
    size: [f64; 3],
    points: Vec<[f64; 3]>,
    lights: Vec<[f64; 3]>,
    /// Distance of a point near the first light, as a share of the box.
    near: Option<f64>,
    loss_scale: f64,
    half: bool,
    seed: u32,
}

prop_compose! {
    fn drawn()(
        // Each number of levels has its own kernel.
        levels in prop::sample::select(vec![1_u32, 5, 16]),
        log2_table in 8..10_u32,
        coarsest in 2..17_u32,
        growth in 1.0..2.0_f64,
        tables in spread(-8.0, 3.0),
        layers in [spread(-2.0, 1.0), spread(-2.0, 1.0), spread(-2.0, 1.0)],
        center in [signed(-3.0, 3.0), signed(-3.0, 3.0), signed(-3.0, 3.0)],
        size in [spread(-3.0, 3.0), spread(-3.0, 3.0), spread(-3.0, 3.0)],
        points in prop::collection::vec([place(), place(), place()], 1..40),
        lights in prop::collection::vec([place(), place(), place()], 1..5),
        near in prop::option::of(spread(-9.0, -2.0)),
        loss_scale in spread(-12.0, 12.0),
        half in prop::bool::weighted(0.25),
        seed in 0..1_000_000_u32,
    ) -> Drawn {
        Drawn {
            levels,
            log2_table,
            coarsest,
            growth,
            tables,
            layers,
            center,
            size,
            points,
            lights,
            near,
            loss_scale,
            half,
            seed,
        }
    }
}

impl Drawn {
    fn case(&self) -> Case {
        let finest = (f64::from(self.coarsest) * self.growth.powi(self.levels as i32 - 1)).min(4096.0) as u32;
        let config = FieldConfig::new(self.levels, self.log2_table, self.coarsest, finest.max(self.coarsest));
        let mut case = Case::random(config, 1, 1, self.seed);
        let mut rng = Pcg::new(self.seed);
        case.tables = (0..2 * config.entries()).map(|_| (self.tables * rng.normal()) as f32).collect();
        let (first, second) = (32 * config.inputs(), 32 * 32);
        for (i, w) in case.mlp.iter_mut().enumerate() {
            let layer = usize::from(i >= first) + usize::from(i >= first + second);
            *w = (f64::from(*w) * self.layers[layer]) as f32;
        }
        let low = [0, 1, 2].map(|k| (self.center[k] - 0.5 * self.size[k]) as f32);
        // Boxes are never thinner than rounding of positions allows.
        let high = [0, 1, 2].map(|k| (f64::from(low[k]) + self.size[k].max(1e-3 * self.center[k].abs())) as f32);
        let at = |way: &[f64; 3]| [0, 1, 2].map(|k| (f64::from(low[k]) + way[k] * f64::from(high[k] - low[k])) as f32);
        case.points = self.points.iter().map(at).collect();
        case.lights = self.lights.iter().map(at).collect();
        if let Some(near) = self.near {
            let mut way = self.lights[0];
            way[0] += near;
            case.points[0] = at(&way);
        }
        case.coverage = (0..self.points.len()).map(|i| if i % 11 == 7 { 9.9e-4 } else { 0.3 }).collect();
        (case.low, case.high) = (low, high);
        case.table_bits = if self.half { 16 } else { 32 };
        case.step.box_min = low;
        case.step.box_max = high;
        case.step.box_inverse = [0, 1, 2].map(|k| 1.0 / (high[k] - low[k]));
        case.step.pixels = case.points.len() as u32;
        case.step.lights = case.lights.len() as u32;
        case
    }

    fn losses(&self, case: &Case) -> LossGradients {
        let mut losses = LossGradients::random(case, self.loss_scale, self.seed);
        losses.options.regularized = false;
        losses
    }
}

/// Returns a randomly perturbed copy of the field.
fn moved(field: &reference::Field, rng: &mut Pcg) -> reference::Field {
    let mut other = field.clone();
    for x in other.tables.iter_mut().chain(&mut other.mlp) {
        *x *= 1.0 + MOVE * rng.range(-1.0, 1.0);
    }
    // Sums and products of positions may be rounded separately.
    other.slip = [(); 3].map(|()| if rng.uniform() < 0.5 { -SLIP } else { SLIP });
    other
}

/// Fails unless the visibility of lights matches the reference.
fn check_values(gpu: &Gpu, case: &Case, planted: f64) -> Result<(), TestCaseError> {
    let field = case.reference();
    let mut rng = Pcg::new(1);
    let others: Vec<reference::Field> = (0..DRAWS).map(|_| moved(&field, &mut rng)).collect();
    for (j, light) in case.lights.iter().enumerate() {
        let found = [true, false].map(|split| case.forward(gpu, Some(j as u32), split));
        for (i, point) in case.points.iter().enumerate() {
            let (point, light) = (Case::wide(*point), Case::wide(*light));
            let shaded = case.coverage[i] >= 1e-3;
            let v = if shaded { field.visibility(point, light) } else { 0.0 };
            let off = |other: &reference::Field| (other.visibility(point, light) - v).abs();
            // Near zero or one, the exponential loses digits.
            let slack = if shaded { 4.0 * others.iter().map(off).fold(0.0, f64::max) } else { 0.0 };
            let t = slack + 4e-7 * v * (1.0 + (1.0 - v) * v.max(1e-300).ln().abs()) + 1e-37;
            for found in &found {
                let is = f64::from(found[i]) * planted;
                prop_assert!((is - v).abs() <= t, "pixel {}, light {}: {} is not {}, to {}", i, j, is, v, t);
            }
        }
    }
    Ok(())
}

/// Concatenates gradients of layers, tables and positions.
fn row(g: &reference::Gradients) -> Vec<f64> {
    [g.mlp.as_slice(), &g.tables, g.lights.as_flattened()].concat()
}

/// Fails unless gradients match the reference.
///
/// Returns the number of compared gradients. Scales the `planted`-th by 1.01, if set.
fn check_gradients(
    gpu: &Gpu,
    case: &Case,
    losses: &LossGradients,
    planted: Option<usize>,
) -> Result<usize, TestCaseError> {
    let mut case = case.clone();
    let field = case.reference();
    let lights: Vec<[f64; 3]> = case.lights.iter().map(|l| Case::wide(*l)).collect();
    // Pixels whose gradients depend on rounding or exceed single precision get no coverage.
    for (i, point) in case.points.iter().enumerate() {
        let sure = |l: &[f64; 3]| {
            let (margin, logit) = field.margin(Case::wide(*point), *l);
            margin > MARGIN && logit.abs() < 60.0
        };
        if !lights.iter().all(sure) {
            case.coverage[i] = 0.0;
        }
    }
    let found = case.backward(gpu, losses);
    let mut rng = Pcg::new(2);
    let fields: Vec<reference::Field> = (0..DRAWS).map(|_| moved(&field, &mut rng)).collect();
    let mut sum = row(&field.zeros(lights.len()));
    // Magnitudes of the summands, and bounds of their errors.
    let (mut size, mut off) = (sum.clone(), sum.clone());
    for i in (0..case.points.len()).filter(|i| case.coverage[*i] >= 1e-3) {
        let point = Case::wide(case.points[i]);
        for j in 0..lights.len() {
            let of = |field: &reference::Field| {
                let mut into = field.zeros(lights.len());
                field.visibility_bwd(point, &lights, j, losses.by_visibility(i, j), &mut into);
                row(&into)
            };
            let pair = of(&field);
            let mut most = vec![0.0_f64; pair.len()];
            for other in &fields {
                for (m, (a, b)) in most.iter_mut().zip(of(other).iter().zip(&pair)) {
                    *m = m.max((a - b).abs());
                }
            }
            // The loss gradient of a pair is a sum of three terms, which may cancel.
            let pixel_gradient = |c: usize| f64::from(losses.pixels[i][c]) * f64::from(losses.lights[j][c]);
            let all: f64 = (0..3).map(|c| pixel_gradient(c).abs()).sum();
            let canceled = 1e-7 * all / losses.by_visibility(i, j).abs().max(1e-300);
            for k in 0..pair.len() {
                sum[k] += pair[k];
                size[k] += pair[k].abs();
                off[k] += most[k] + canceled * pair[k].abs();
            }
        }
    }
    let is: Vec<f32> = [found.mlp.as_slice(), &found.tables, &found.lights].concat();
    prop_assert_eq!(is.len(), sum.len());
    let tables = found.mlp.len()..found.mlp.len() + found.tables.len();
    // Table gradients are sums of integers, and each summand is rounded.
    let quantum = 8.0 * (case.points.len() as f64) / f64::from(found.scale);
    let largest = sum.iter().fold(0.0_f64, |m, x| m.max(x.abs()));
    for (k, x) in is.iter().enumerate() {
        let x = f64::from(*x) * if planted == Some(k) { 1.01 } else { 1.0 };
        let t =
            8.0 * off[k] + 2e-5 * size[k] + if tables.contains(&k) { quantum } else { 0.0 } + 1e-14 * largest + 1e-36;
        prop_assert!((x - sum[k]).abs() <= t, "number {}: {} is not {}, to {}", k, x, sum[k], t);
    }
    Ok(size.iter().filter(|s| **s > 0.0).count())
}

#[test]
fn field_visibility_matches_reference() {
    let gpu = Gpu::new();
    runner(48).run(&drawn(), |d| check_values(&gpu, &d.case(), 1.0)).unwrap_or_else(|e| panic!("{e}"));
}

#[test]
fn field_gradients_match_reference() {
    let gpu = Gpu::new();
    // Kernels of GPUs take long to compile for a CPU, and run there, too.
    for (cpu, cases) in [(gpu.tuning().cpu, 48), (false, 12)] {
        gradients_match(&gpu, cpu, cases);
    }
}

fn gradients_match(gpu: &Gpu, cpu: bool, cases: u32) {
    let compared = std::cell::Cell::new((0, 0));
    let all = runner(cases).run(&drawn(), |d| {
        let case = Case { cpu: Some(cpu), ..d.case() };
        let losses = d.losses(&case);
        let n = check_gradients(gpu, &case, &losses, None)?;
        compared.set((compared.get().0 + 1, compared.get().1 + n));
        Ok(())
    });
    all.unwrap_or_else(|e| panic!("{e}"));
    let (cases, numbers) = compared.get();
    println!("{cases} fields, {numbers} gradients that are not zero");
    assert!(numbers > 500 * cases, "{numbers} of {cases} fields");
}

/// Checks that planted errors of 0.1 % in values and 1 % in gradients fail.
///
/// The largest gradient of each kind is scaled.
#[test]
fn checks_of_fields_can_fail() {
    let gpu = Gpu::new();
    let case = Case::random(FieldConfig::new(5, 8, 4, 40), 9, 2, 3);
    assert!(check_values(&gpu, &case, 1.0).is_ok() && check_values(&gpu, &case, 1.001).is_err());
    let mut losses = LossGradients::random(&case, 1.0, 9);
    losses.options.regularized = false;
    assert!(check_gradients(&gpu, &case, &losses, None).is_ok());
    let expected = case.expected_gradients(&losses.options, |i, j| losses.by_visibility(i, j));
    let largest = |v: &[f64]| (0..v.len()).max_by(|a, b| v[*a].abs().total_cmp(&v[*b].abs())).unwrap_or(0);
    let (mlp, tables) = (expected.mlp.len(), expected.tables.len());
    let lights = largest(expected.lights.as_flattened());
    for k in [largest(&expected.mlp), mlp + largest(&expected.tables), mlp + tables + lights] {
        assert!(check_gradients(&gpu, &case, &losses, Some(k)).is_err(), "number {k}");
    }
}
