//! The visibility field on a device against its reference: values, gradients of everything, and its Adam.

use sgs_engine::graph::{Buffer, Graph};
use sgs_passes::optim::{Adam, EPSILON, Rate, adam};
use sgs_passes::reference::rng::Pcg;
use sgs_passes::reference::visibility as twin;
use sgs_passes::shade::visibility::{
    BackwardOptions, Constant, Field, FieldConfig, Gradients, Moments, View, visibility, visibility_adam,
    visibility_bwd, visibility_encode,
};
use sgs_shaders::structs::{FieldStep, Step, Work};
use sgs_tests::{Gpu, Tolerance, assert_close};

fn bytes<T: bytemuck::NoUninit>(data: &[T]) -> Vec<u8> {
    bytemuck::cast_slice(data).to_vec()
}

/// A field, a picture and lights.
#[derive(Clone)]
struct Case {
    config: FieldConfig,
    tables: Vec<f32>,
    mlp: Vec<f32>,
    low: [f32; 3],
    high: [f32; 3],
    points: Vec<[f32; 3]>,
    coverage: Vec<f32>,
    lights: Vec<[f32; 3]>,
    step: FieldStep,
}

const SMALL: FieldConfig = FieldConfig { levels: 16, log2_table: 11, coarsest: 4, finest: 300 };

impl Case {
    /// Points within the box and around it, every eleventh pixel not shaded.
    fn random(config: FieldConfig, pixels: usize, lights: usize, seed: u32) -> Case {
        let mut rng = Pcg::new(seed);
        let (low, high) = ([-1.5, -1.0, 0.5], [1.5, 2.0, 2.5]);
        let mut within = |n: usize, beyond: f64| -> Vec<[f32; 3]> {
            let axis = |rng: &mut Pcg, k: usize| {
                let (l, h) = (f64::from(low[k]), f64::from(high[k]));
                rng.range(l - beyond * (h - l), h + beyond * (h - l)) as f32
            };
            (0..n).map(|_| [0, 1, 2].map(|k| axis(&mut rng, k))).collect()
        };
        let (points, lights) = (within(pixels, 0.05), within(lights, -0.05));
        let step = FieldStep {
            box_min: low,
            jitter: 0.03,
            box_max: high,
            box_inverse: [0, 1, 2].map(|k| 1.0 / (high[k] - low[k])),
            regularizer: 0.0,
            pixels: pixels as u32,
            lights: lights.len() as u32,
            seed: 5,
            ..Default::default()
        };
        Case {
            config,
            tables: (0..2 * config.entries()).map(|_| 0.7 * rng.normal() as f32).collect(),
            mlp: config.initial_weights(seed),
            low,
            high,
            points,
            coverage: (0..pixels).map(|i| if i % 11 == 7 { 9.9e-4 } else { 0.3 }).collect(),
            lights,
            step,
        }
    }

    fn twin(&self) -> twin::Field {
        twin::Field::new(&self.config, &self.tables, &self.mlp, self.low, self.high)
    }

    fn wide(v: [f32; 3]) -> [f64; 3] {
        v.map(f64::from)
    }

    fn declare(&self, g: &mut Graph, inputs: &mut Vec<(Buffer, Vec<u8>)>) -> (Field, View) {
        let mut given = |name: &str, data: Vec<u8>| {
            let buffer = g.input(name, data.len() as u64);
            inputs.push((buffer, data));
            buffer
        };
        let levels = given("levels", bytes(&self.config.table_levels()));
        let tables = given("tables", bytes(&self.tables));
        let mlp = given("mlp", bytes(&self.mlp));
        let points = given("points", bytes(&self.points));
        let coverage = given("coverage", bytes(&self.coverage));
        let lights = given("lights", bytes(&self.lights));
        let step = g.uniform("field", size_of::<FieldStep>() as u64);
        inputs.push((step, bytes(&[self.step])));
        let field = Field { config: self.config, step, levels, tables, mlp };
        (field, View { pixels: self.points.len() as u32, points, coverage, lights })
    }

    fn forward(&self, gpu: &Gpu, one: Option<u32>, split: bool) -> Vec<f32> {
        let (mut g, mut inputs) = (Graph::new("visibility"), Vec::new());
        let (field, view) = self.declare(&mut g, &mut inputs);
        let out = g.external("visibility", 4 * u64::from(view.pixels));
        visibility(&mut g, gpu.tuning(), &field, &view, one, split, out).unwrap();
        gpu.run(g, &inputs).get(out)
    }

    fn expected(&self, one: Option<u32>) -> Vec<f64> {
        let field = self.twin();
        let lights: Vec<[f32; 3]> = match one {
            Some(j) => vec![self.lights[j as usize]],
            None => self.lights.clone(),
        };
        let pixel = |(p, c): (&[f32; 3], &f32)| {
            let sum: f64 = lights.iter().map(|l| field.visibility(Self::wide(*p), Self::wide(*l))).sum();
            if *c < 1e-3 { 0.0 } else { sum / lights.len() as f64 }
        };
        self.points.iter().zip(&self.coverage).map(pixel).collect()
    }
}

fn jittered(case: &Case, pixel: usize) -> [f64; 3] {
    let by = twin::jitter(case.step.seed, 0, pixel as u32, f64::from(case.step.jitter));
    [0, 1, 2].map(|k| f64::from(case.points[pixel][k]) + by[k])
}

const VALUES: Tolerance = Tolerance::new(2e-6, 2e-5);

#[test]
fn values_are_the_references() {
    let gpu = Gpu::new();
    for (config, pixels, lights) in [
        (SMALL, 1, 1),
        (SMALL, 300, 5),
        (FieldConfig { levels: 1, log2_table: 8, coarsest: 5, finest: 5 }, 67, 3),
        (FieldConfig { levels: 5, log2_table: 12, coarsest: 16, finest: 4096 }, 67, 3),
    ] {
        let case = Case::random(config, pixels, lights, 3);
        let expected = case.expected(None);
        assert_close("mean", &expected, &case.forward(&gpu, None, true), VALUES);
        assert_close("mean, first layer anew", &expected, &case.forward(&gpu, None, false), VALUES);
        let last = Some(lights as u32 - 1);
        assert_close("one light", &case.expected(last), &case.forward(&gpu, last, true), VALUES);
    }
}

#[test]
fn rows_of_points_are_the_references() {
    let gpu = Gpu::new();
    let case = Case::random(SMALL, 100, 1, 4);
    for (first, count) in [(0, 100), (24, 61), (93, 40)] {
        for moved in [false, true] {
            let (mut g, mut inputs) = (Graph::new("visibility"), Vec::new());
            let (field, view) = case.declare(&mut g, &mut inputs);
            let out = g.external("rows", 4 * 32 * count as u64);
            let range = [first as u32, count as u32];
            visibility_encode(&mut g, gpu.tuning(), "encode", &field, &view, range, moved, out).unwrap();
            let found = gpu.run(g, &inputs).get::<f32>(out);
            let field = case.twin();
            for pixel in first..(first + count).min(100) {
                let point = if moved { jittered(&case, pixel) } else { Case::wide(case.points[pixel]) };
                let row = &found[(pixel - first) * 32..][..32];
                // Where a moved point lies depends on the device's logarithms and cosines.
                let tolerance = if moved { Tolerance::new(1e-3, 1e-3) } else { Tolerance::new(1e-5, 1e-5) };
                assert_close("row", &field.point_share(point), row, tolerance);
            }
        }
    }
}

/// At the light, beyond the box, with weights that saturate, and without anything to do.
#[test]
fn values_are_finite_at_the_edges() {
    let gpu = Gpu::new();
    let mut case = Case::random(SMALL, 64, 4, 6);
    case.points[0] = case.lights[0];
    case.points[1] = [1e6, -1e6, 1e30];
    case.points[2] = case.low;
    case.points[3] = case.high;
    case.lights[1] = [-100.0, 0.0, 0.0];
    case.lights[2] = case.high;
    assert_close("edges", &case.expected(None), &case.forward(&gpu, None, true), VALUES);
    case.mlp.iter_mut().for_each(|w| *w *= 300.0);
    let found = case.forward(&gpu, Some(0), true);
    assert!(found.iter().all(|v| (0.0..=1.0).contains(v)));
    assert_close("saturated", &case.expected(Some(0)), &found, Tolerance::new(2e-3, 0.0));
    case.tables.fill(1e30);
    assert!(case.forward(&gpu, None, true).iter().all(|v| (0.0..=1.0).contains(v) || v.is_nan()));
    let mut none = Case::random(SMALL, 64, 4, 6);
    none.coverage.fill(0.0);
    assert!(none.forward(&gpu, None, true).iter().all(|v| v.to_bits() == 0));
    none.step.pixels = 3;
    let found = none.forward(&gpu, None, true);
    assert!(found[..3].iter().all(|v| *v == 0.0) && found[3..].iter().all(|v| v.to_bits() == u32::MAX));
}

/// The comparison would notice a weight that is not used, and an entry.
#[test]
#[should_panic(expected = "mean: element")]
fn a_wrong_entry_is_noticed() {
    let gpu = Gpu::new();
    let case = Case::random(SMALL, 64, 2, 3);
    let mut other = case.clone();
    other.tables.iter_mut().skip(1).step_by(2).for_each(|t| *t *= 1.01);
    assert_close("mean", &other.expected(None), &case.forward(&gpu, None, true), VALUES);
}

/// What a backward pass left.
struct Found {
    mlp: Vec<f32>,
    lights: Vec<f32>,
    tables: Vec<f32>,
    /// Of the tables, as they are.
    words: Vec<u32>,
    touched: Vec<u32>,
    /// What they were multiplied by.
    scale: f32,
}

/// What the loss asks: gradients of pixels, radiance of lights.
struct Asked {
    pixels: Vec<[f32; 3]>,
    lights: Vec<[f32; 3]>,
    options: BackwardOptions,
}

impl Asked {
    fn random(case: &Case, scale: f64, seed: u32) -> Asked {
        let mut rng = Pcg::new(seed);
        let mut colors = |n: usize, low: f64| -> Vec<[f32; 3]> {
            (0..n).map(|_| [0; 3].map(|_| (scale.sqrt() * rng.range(low, 1.0)) as f32)).collect()
        };
        let (pixels, lights) = (colors(case.points.len(), -1.0), colors(case.lights.len(), 0.0));
        Asked { pixels, lights, options: BackwardOptions::default() }
    }

    fn by_visibility(&self, pixel: usize, light: usize) -> f64 {
        (0..3).map(|k| f64::from(self.pixels[pixel][k]) * f64::from(self.lights[light][k])).sum()
    }
}

fn whole(words: &[u32], inverse: f32) -> f32 {
    let value = (u64::from(words[0]) | u64::from(words[1]) << 32) as i64;
    (value as f64 * f64::from(inverse)) as f32
}

impl Case {
    fn backward(&self, gpu: &Gpu, asked: &Asked) -> Found {
        let (mut g, mut inputs) = (Graph::new("visibility_bwd"), Vec::new());
        let (field, view) = self.declare(&mut g, &mut inputs);
        let mut given = |name: &str, data: Vec<u8>| {
            let buffer = g.external(name, data.len() as u64);
            inputs.push((buffer, data));
            buffer
        };
        let constant = Constant {
            radiance: given("radiance", bytes(&asked.lights)),
            radiance_gradient: given("radiance_gradient", bytes(&asked.pixels)),
        };
        let entries = self.config.entries() as usize;
        let tables = given("table_gradients", vec![0; 16 * entries]);
        let touched = given("touched", vec![0; 4 * entries.div_ceil(32)]);
        let most = self.lights.len() as u32 + 2;
        let into = Gradients {
            mlp: g.external("mlp_gradient", 4 * self.config.weights() as u64),
            lights: g.external("light_gradients", 12 * u64::from(most)),
            tables,
            touched,
            scale: g.external("scale", 8),
        };
        visibility_bwd(&mut g, gpu.tuning(), &field, &view, most, &constant, &asked.options, &into).unwrap();
        let out = gpu.run(g, &inputs);
        let scale = out.get::<f32>(into.scale);
        assert_eq!(scale[0] * scale[1], 1.0);
        let words = out.get::<u32>(tables);
        let mut lights = out.get::<f32>(into.lights);
        assert!(lights[3 * self.lights.len()..].iter().all(|x| *x == 0.0), "lights that are not there have gradients");
        lights.truncate(3 * self.lights.len());
        Found {
            mlp: out.get(into.mlp),
            lights,
            tables: words.chunks(2).map(|w| whole(w, scale[1])).collect(),
            words,
            touched: out.get(touched),
            scale: scale[0],
        }
    }

    /// The same by the reference.
    fn expected_gradients(&self, asked: &Asked) -> twin::Gradients {
        let field = self.twin();
        let lights: Vec<[f64; 3]> = self.lights.iter().map(|l| Case::wide(*l)).collect();
        let mut into = field.zeros(lights.len());
        for i in (0..self.points.len()).filter(|i| self.coverage[*i] >= 1e-3) {
            let point = Case::wide(self.points[i]);
            for j in 0..lights.len() {
                let mut gradient = asked.by_visibility(i, j);
                if asked.options.regularized {
                    let by = twin::jitter(self.step.seed, 1, j as u32, f64::from(self.step.jitter));
                    let moved = [0, 1, 2].map(|k| lights[j][k] + by[k]);
                    let other = field.visibility(jittered(self, i), moved);
                    let sign = (field.visibility(point, lights[j]) - other).signum();
                    gradient += f64::from(self.step.regularizer) * sign;
                }
                field.visibility_bwd(point, &lights, j, gradient, &mut into);
            }
        }
        into
    }

    fn check_gradients(&self, gpu: &Gpu, asked: &Asked, share: f64) -> Found {
        let found = self.backward(gpu, asked);
        let expected = self.expected_gradients(asked);
        let close = |what: &str, expected: &[f64], found: &[f32]| {
            let largest = expected.iter().fold(0.0_f64, |a, e| a.max(e.abs()));
            assert_close(what, expected, found, Tolerance::new(share * largest, 1e-3));
        };
        close("layers", &expected.mlp, &found.mlp);
        close("tables", &expected.tables, &found.tables);
        if asked.options.places {
            close("lights", expected.lights.as_flattened(), &found.lights);
        }
        for (entry, g) in expected.tables.chunks(2).enumerate() {
            let touched = found.touched[entry / 32] >> (entry % 32) & 1 == 1;
            let zero = found.words[4 * entry..][..4].iter().all(|w| *w == 0);
            assert!(touched || zero, "entry {entry} was changed, but is not said to be");
            assert!(touched || g.iter().all(|x| x.abs() < 1e-6), "entry {entry} should have been touched");
        }
        found
    }
}

#[test]
fn gradients_are_the_references() {
    let gpu = Gpu::new();
    let one = FieldConfig { levels: 1, log2_table: 8, coarsest: 5, finest: 5 };
    for (config, pixels, lights, regularizer) in [(SMALL, 37, 3, 0.0), (SMALL, 300, 5, 0.3), (one, 9, 2, 0.1)] {
        let mut case = Case::random(config, pixels, lights, 8);
        case.step.regularizer = regularizer;
        let mut asked = Asked::random(&case, 1.0, 9);
        asked.options.regularized = regularizer > 0.0;
        case.check_gradients(&gpu, &asked, 1e-5);
    }
}

/// What [`visibility_adam`] leaves: tables, their moments, layers, their moments, words of gradients and of bits.
type Stepped = (Vec<u32>, Vec<u32>, Vec<u32>, Vec<u32>, Vec<u32>, Vec<u32>);

/// One step with gradients as they were found, from moments that are not zero.
fn step_sparse(case: &Case, gpu: &Gpu, found: &Found, scale: [f32; 2], flag: u32) -> Stepped {
    let (mut g, mut inputs) = (Graph::new("visibility_adam"), Vec::new());
    let mut given = |g: &mut Graph, name: &str, data: Vec<u8>| {
        let buffer = g.external(name, data.len() as u64);
        inputs.push((buffer, data));
        buffer
    };
    let gradients = Gradients {
        mlp: given(&mut g, "mlp_gradient", bytes(&found.mlp)),
        lights: given(&mut g, "lights", vec![0; 4]),
        tables: given(&mut g, "table_gradients", bytes(&found.words)),
        touched: given(&mut g, "touched", bytes(&found.touched)),
        scale: given(&mut g, "scale", bytes(&scale)),
    };
    let moments = Moments {
        tables: given(&mut g, "table_moments", bytes(&moments_of(case.tables.len()))),
        mlp: given(&mut g, "mlp_moments", bytes(&moments_of(case.mlp.len()))),
        flags: given(&mut g, "flags", bytes(&[0, flag])),
        flag_words: 2,
        skipped: given(&mut g, "skipped", vec![0; 4]),
    };
    let tables = given(&mut g, "tables", bytes(&case.tables));
    let mlp = given(&mut g, "mlp", bytes(&case.mlp));
    let step = g.uniform("field", size_of::<FieldStep>() as u64);
    inputs.push((step, bytes(&[case.step])));
    let field = Field { config: case.config, step, levels: tables, tables, mlp };
    visibility_adam(&mut g, gpu.tuning(), &field, &gradients, &moments).unwrap();
    let out = gpu.run(g, &inputs);
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

/// The same with a dense Adam that skips zeros.
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

/// Tables and layers move as a dense Adam that skips zeros would move them, bit for bit; gradients are zero afterwards; a raised
/// flag holds everything but clears as well.
#[test]
fn sparse_adam_is_dense_adam_that_skips_zeros() {
    let gpu = Gpu::new();
    let mut case = Case::random(SMALL, 30, 2, 12);
    case.step = FieldStep { rate: 4e-3, correction1: 2.5, correction2: 300.0, ..case.step };
    let mut asked = Asked::random(&case, 1.0, 13);
    asked.options.regularized = false;
    let mut found = case.backward(&gpu, &asked);
    found.mlp[5] = 0.0;
    let scale = [found.scale, 1.0 / found.scale];
    let (tables, moments, mlp, mlp_moments, words, touched) = step_sparse(&case, &gpu, &found, scale, 0);
    assert!(words.iter().chain(&touched).all(|w| *w == 0));
    // As the kernel makes floats of whole numbers.
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

/// Two runs, and runs with another number of workgroups where only tables are compared: their sums have no order.
#[test]
fn gradients_are_the_same_bits() {
    let gpu = Gpu::new();
    let mut case = Case::random(SMALL, 150, 3, 14);
    case.step.regularizer = 0.1;
    let asked = Asked::random(&case, 1.0, 15);
    let (a, b) = (case.backward(&gpu, &asked), case.backward(&gpu, &asked));
    assert!(bytes(&a.mlp) == bytes(&b.mlp) && bytes(&a.lights) == bytes(&b.lights));
    assert!(a.words == b.words && a.touched == b.touched);
    // The same pixels in the other order: other workgroups have them, in another order. Without the draw of each pixel.
    let mut asked = asked;
    asked.options.regularized = false;
    let a = case.backward(&gpu, &asked);
    case.points.reverse();
    case.coverage.reverse();
    asked.pixels.reverse();
    let b = case.backward(&gpu, &asked);
    assert!(a.words == b.words && a.touched == b.touched && a.scale == b.scale);
    assert!(
        bytes(&a.mlp) != bytes(&b.mlp),
        "layers are summed in order, so an equal sum shows that nothing was reversed"
    );
}

/// At the light, beyond the box, saturated, with huge and tiny gradients: finite, and the reference's where that means something.
#[test]
fn gradients_at_the_edges() {
    let gpu = Gpu::new();
    let mut case = Case::random(SMALL, 48, 4, 16);
    case.points[0] = case.lights[0];
    case.points[1] = [1e6, -1e6, 1e30];
    case.points[2] = case.low;
    case.points[3] = case.high;
    case.points[4] = [case.lights[0][0] + 1e-6, case.lights[0][1], case.lights[0][2]];
    case.lights[1] = [-100.0, 0.0, 0.9];
    case.lights[2] = case.high;
    for scale in [1.0, 1e-20, 1e20] {
        let mut asked = Asked::random(&case, scale, 17);
        asked.options.regularized = false;
        case.check_gradients(&gpu, &asked, 2e-5);
    }
    let asked = Asked::random(&case, 1.0, 17);
    let all = |f: &Found| f.mlp.iter().chain(&f.tables).chain(&f.lights).all(|x| x.is_finite());
    for weight in [30.0, 1e4, 1e15] {
        let mut wild = case.clone();
        wild.mlp.iter_mut().for_each(|w| *w *= weight);
        assert!(all(&wild.backward(&gpu, &asked)), "weights times {weight}");
    }
    let mut none = case.clone();
    none.coverage.fill(0.0);
    none.points.fill([f32::NAN; 3]);
    let found = none.backward(&gpu, &asked);
    let zero = |v: &[f32]| v.iter().all(|x| *x == 0.0);
    assert!(zero(&found.mlp) && zero(&found.lights) && found.words.iter().chain(&found.touched).all(|w| *w == 0));
}

/// A share of the pairs, counted for as many: some of them in each draw, and the mean over draws is the whole.
#[test]
fn sampled_pairs_are_unbiased() {
    let gpu = Gpu::new();
    let mut case = Case::random(FieldConfig { levels: 1, log2_table: 8, coarsest: 5, finest: 5 }, 160, 6, 18);
    let mut asked = Asked::random(&case, 1.0, 19);
    asked.options.regularized = false;
    let all = case.backward(&gpu, &asked).mlp;
    asked.options.sample = 3;
    let draws = 60;
    let mut mean = vec![0.0_f64; all.len()];
    let mut first = Vec::new();
    for seed in 0..draws {
        case.step.seed = seed;
        let found = case.backward(&gpu, &asked).mlp;
        mean.iter_mut().zip(&found).for_each(|(m, f)| *m += f64::from(*f) / f64::from(draws));
        first = if seed == 0 { found } else { first };
    }
    let norm = |v: &mut dyn Iterator<Item = f64>| v.map(|x| x * x).sum::<f64>().sqrt();
    let size = norm(&mut all.iter().map(|x| f64::from(*x)));
    let away = |v: &[f64]| norm(&mut v.iter().zip(&all).map(|(a, b)| a - f64::from(*b))) / size;
    let one = away(&first.iter().map(|x| f64::from(*x)).collect::<Vec<f64>>());
    let many = away(&mean);
    assert!(one > 0.05 && many < 3.0 * one / f64::from(draws).sqrt(), "one draw {one}, mean of {draws} {many}");
}
