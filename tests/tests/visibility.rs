//! The visibility field on a device against its reference: values, gradients of everything, and its Adam.

use sgs_engine::graph::{Buffer, Graph};
use sgs_passes::reference::rng::Pcg;
use sgs_passes::reference::visibility as twin;
use sgs_passes::shade::visibility::{Field, FieldConfig, View, visibility, visibility_encode};
use sgs_shaders::structs::FieldStep;
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
