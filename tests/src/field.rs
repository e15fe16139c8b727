//! Visibility field with an image and lights, for the device and the reference.

use crate::{Gpu, Tolerance, assert_close};
use sgs_engine::MatrixShape;
use sgs_engine::graph::{Buffer, Graph};
use sgs_passes::reference::rng::Pcg;
use sgs_passes::reference::visibility as reference;
use sgs_passes::shade::visibility::{
    BackwardOptions, Constant, Field, FieldConfig, Gradients, View, packed_tables, visibility, visibility_bwd,
};
use sgs_passes::{Accuracy, Matrices, Tuning};
use sgs_shaders::structs::FieldStep;

fn bytes<T: bytemuck::NoUninit>(data: &[T]) -> Vec<u8> {
    bytemuck::cast_slice(data).to_vec()
}

/// Visibility field, image and lights.
#[derive(Clone)]
pub struct Case {
    /// Shape of the field.
    pub config: FieldConfig,
    /// Hash tables: two features per entry.
    pub tables: Vec<f32>,
    /// Weights of the network.
    pub mlp: Vec<f32>,
    /// Lower corner of the box.
    pub low: [f32; 3],
    /// Upper corner of the box.
    pub high: [f32; 3],
    /// Point of each pixel.
    pub points: Vec<[f32; 3]>,
    /// Coverage of each pixel.
    pub coverage: Vec<f32>,
    /// Positions of the lights.
    pub lights: Vec<[f32; 3]>,
    /// Parameters that change from step to step.
    pub step: FieldStep,
    /// Bits of a table feature when the field is evaluated: 16 or 32.
    pub table_bits: u32,
    /// Whether the kernels of CPUs run; `None` for those of the device.
    pub cpu: Option<bool>,
    /// Compute units of the device, instead of its own. They decide how the backward pass splits its work.
    pub units: Option<u32>,
    /// Tiling of layers with 16-bit operands; `None` for kernels in 32 bits.
    pub matrices: Option<Matrices>,
}

/// Returns tiles of rows, columns and depth for ordinary instructions.
pub fn tiles([rows, columns, depth]: [u32; 3]) -> Matrices {
    Matrices { shape: MatrixShape { rows, columns, depth }, units: false }
}

/// Configuration with sixteen small levels, most of them hashed.
pub const SMALL: FieldConfig = FieldConfig::new(16, 11, 4, 300);

impl Case {
    /// Draws points within the box and around it; every eleventh pixel is not shaded.
    pub fn random(config: FieldConfig, pixels: usize, lights: usize, seed: u32) -> Case {
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
            table_bits: 32,
            cpu: None,
            units: None,
            matrices: None,
        }
    }

    /// Returns the kernel sizes.
    pub fn tuning(&self, gpu: &Gpu) -> Tuning {
        let own = gpu.tuning();
        let own = Tuning { cpu: self.cpu.unwrap_or(own.cpu), units: self.units.unwrap_or(own.units), ..own };
        let Some(matrices) = self.matrices else { return own };
        Tuning { matrices: Some(matrices), accuracy: Accuracy { visibility_bits: 16, ..own.accuracy }, ..own }
    }

    /// Returns the field of the reference.
    pub fn reference(&self) -> reference::Field {
        reference::Field::new(&self.config, &self.tables, &self.mlp, self.low, self.high).stored(self.table_bits)
    }

    /// Converts to double precision.
    pub fn wide(v: [f32; 3]) -> [f64; 3] {
        v.map(f64::from)
    }

    /// Declares the field in a graph and adds the contents of its buffers to `inputs`.
    pub fn declare(&self, g: &mut Graph, inputs: &mut Vec<(Buffer, Vec<u8>)>) -> (Field, View) {
        let mut provided = |name: &str, data: Vec<u8>| {
            let buffer = g.input(name, data.len() as u64);
            inputs.push((buffer, data));
            buffer
        };
        let levels = provided("levels", bytes(&self.config.table_levels()));
        let tables = provided("tables", bytes(&self.tables));
        let mlp = provided("mlp", bytes(&self.mlp));
        let points = provided("points", bytes(&self.points));
        let coverage = provided("coverage", bytes(&self.coverage));
        let lights = provided("lights", bytes(&self.lights));
        let packed = (self.table_bits == 16).then(|| provided("packed", bytes(&packed_tables(&self.tables))));
        let step = g.uniform("field", size_of::<FieldStep>() as u64);
        inputs.push((step, bytes(&[self.step])));
        let field = Field { config: self.config, step, levels, tables, packed, mlp };
        (field, View { pixels: self.points.len() as u32, points, coverage, lights })
    }

    /// Computes on the device the mean visibility, or the visibility of one light.
    pub fn forward(&self, gpu: &Gpu, one: Option<u32>, split: bool) -> Vec<f32> {
        self.forward_with(gpu, self.tuning(gpu), one, split)
    }

    /// Same as [`Case::forward`], with other kernel sizes or accuracy.
    pub fn forward_with(&self, gpu: &Gpu, tuning: Tuning, one: Option<u32>, split: bool) -> Vec<f32> {
        let (mut g, mut inputs) = (Graph::new("visibility"), Vec::new());
        let (field, view) = self.declare(&mut g, &mut inputs);
        let out = g.external("visibility", 4 * u64::from(view.pixels));
        visibility(&mut g, tuning, &field, &view, one, split, out).unwrap();
        gpu.run(g, &inputs).get(out)
    }

    /// Computes the same with the reference.
    pub fn expected(&self, one: Option<u32>) -> Vec<f64> {
        let field = self.reference();
        self.expected_of(one, |point, light| field.visibility(point, light))
    }

    /// Computes the same with the reference whose second layer has 16-bit operands.
    pub fn expected_half(&self, one: Option<u32>) -> Vec<f64> {
        let field = self.reference();
        self.expected_of(one, |point, light| field.visibility_half(point, light))
    }

    fn expected_of(&self, one: Option<u32>, visibility: impl Fn([f64; 3], [f64; 3]) -> f64) -> Vec<f64> {
        let lights: Vec<[f32; 3]> = match one {
            Some(j) => vec![self.lights[j as usize]],
            None => self.lights.clone(),
        };
        let pixel = |(p, c): (&[f32; 3], &f32)| {
            let sum: f64 = lights.iter().map(|l| visibility(Self::wide(*p), Self::wide(*l))).sum();
            if *c < 1e-3 { 0.0 } else { sum / lights.len() as f64 }
        };
        self.points.iter().zip(&self.coverage).map(pixel).collect()
    }
}

/// Returns a pixel's point with the jitter of the smoothness loss.
pub fn jittered(case: &Case, pixel: usize) -> [f64; 3] {
    let by = reference::jitter(case.step.seed, 0, pixel as u32, f64::from(case.step.jitter));
    [0, 1, 2].map(|k| f64::from(case.points[pixel][k]) + by[k])
}

/// Results of a backward pass.
pub struct Found {
    /// Gradients of the network's weights.
    pub mlp: Vec<f32>,
    /// Gradients of the light positions.
    pub lights: Vec<f32>,
    /// Gradients of the tables.
    pub tables: Vec<f32>,
    /// Gradients of the tables in fixed point, two words each.
    pub words: Vec<u32>,
    /// One bit per table entry: whether its gradient was written.
    pub touched: Vec<u32>,
    /// Factor of the fixed-point gradients.
    pub scale: f32,
}

/// Gradient of the loss for each pixel, and radiance of each light.
pub struct LossGradients {
    /// Gradient of the loss with respect to the radiance of each pixel.
    pub pixels: Vec<[f32; 3]>,
    /// Radiance of each light.
    pub lights: Vec<[f32; 3]>,
    /// Options of the backward pass.
    pub options: BackwardOptions,
}

impl LossGradients {
    /// Draws numbers up to the square root of `scale`.
    pub fn random(case: &Case, scale: f64, seed: u32) -> LossGradients {
        let mut rng = Pcg::new(seed);
        let mut colors = |n: usize, low: f64| -> Vec<[f32; 3]> {
            (0..n).map(|_| [0; 3].map(|_| (scale.sqrt() * rng.range(low, 1.0)) as f32)).collect()
        };
        let (pixels, lights) = (colors(case.points.len(), -1.0), colors(case.lights.len(), 0.0));
        LossGradients { pixels, lights, options: BackwardOptions::default() }
    }

    /// Returns the gradient of the loss with respect to the visibility of a pair.
    pub fn by_visibility(&self, pixel: usize, light: usize) -> f64 {
        (0..3).map(|k| f64::from(self.pixels[pixel][k]) * f64::from(self.lights[light][k])).sum()
    }
}

/// Converts a 64-bit integer in two words to a float, scaled by a factor.
pub fn whole(words: &[u32], inverse: f32) -> f32 {
    let value = (u64::from(words[0]) | u64::from(words[1]) << 32) as i64;
    (value as f64 * f64::from(inverse)) as f32
}

impl Case {
    /// Computes gradients on the device.
    pub fn backward(&self, gpu: &Gpu, requested: &LossGradients) -> Found {
        let (mut g, mut inputs) = (Graph::new("visibility_bwd"), Vec::new());
        let (field, view) = self.declare(&mut g, &mut inputs);
        let mut provided = |name: &str, data: Vec<u8>| {
            let buffer = g.external(name, data.len() as u64);
            inputs.push((buffer, data));
            buffer
        };
        let constant = Constant {
            radiance: provided("radiance", bytes(&requested.lights)),
            radiance_gradient: provided("radiance_gradient", bytes(&requested.pixels)),
        };
        let entries = self.config.entries() as usize;
        let tables = provided("table_gradients", vec![0; 16 * entries]);
        let touched = provided("touched", vec![0; 4 * entries.div_ceil(32)]);
        let most = self.lights.len() as u32 + 2;
        let into = Gradients {
            mlp: g.external("mlp_gradient", 4 * self.config.weights() as u64),
            lights: g.external("light_gradients", 12 * u64::from(most)),
            tables,
            touched,
            scale: g.external("scale", 8),
        };
        visibility_bwd(&mut g, self.tuning(gpu), &field, &view, most, &constant, &requested.options, &into).unwrap();
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

    /// Computes the same gradients with the reference.
    pub fn expected_gradients(
        &self,
        options: &BackwardOptions,
        by_visibility: impl Fn(usize, usize) -> f64,
    ) -> reference::Gradients {
        let field = self.reference();
        let lights: Vec<[f64; 3]> = self.lights.iter().map(|l| Case::wide(*l)).collect();
        let mut into = field.zeros(lights.len());
        for i in (0..self.points.len()).filter(|i| self.coverage[*i] >= 1e-3) {
            let point = Case::wide(self.points[i]);
            for j in 0..lights.len() {
                let mut gradient = by_visibility(i, j);
                if options.regularized {
                    let by = reference::jitter(self.step.seed, 1, j as u32, f64::from(self.step.jitter));
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

    /// Fails unless the gradients of device and reference agree.
    ///
    /// `share`: tolerance as a fraction of the largest gradient of each kind.
    pub fn check_gradients(&self, gpu: &Gpu, requested: &LossGradients, share: f64) -> Found {
        let found = self.backward(gpu, requested);
        let expected = self.expected_gradients(&requested.options, |i, j| requested.by_visibility(i, j));
        found.check(&expected, requested.options.places, share);
        found
    }
}

impl Found {
    /// Fails unless the gradients match the reference.
    ///
    /// `share`: tolerance as a fraction of the largest gradient of each kind.
    pub fn check(&self, expected: &reference::Gradients, places: bool, share: f64) {
        let close = |what: &str, expected: &[f64], found: &[f32]| {
            let largest = expected.iter().fold(0.0_f64, |a, e| a.max(e.abs()));
            assert_close(what, expected, found, Tolerance::new(share * largest, 1e-3));
        };
        close("layers", &expected.mlp, &self.mlp);
        close("tables", &expected.tables, &self.tables);
        if places {
            close("lights", expected.lights.as_flattened(), &self.lights);
        }
        for (entry, g) in expected.tables.chunks(2).enumerate() {
            let touched = self.touched[entry / 32] >> (entry % 32) & 1 == 1;
            let zero = self.words[4 * entry..][..4].iter().all(|w| *w == 0);
            assert!(touched || zero, "entry {entry} was changed, but is not said to be");
            assert!(touched || g.iter().all(|x| x.abs() < 1e-6), "entry {entry} should have been touched");
        }
    }
}
