//! Reference of the visibility field: value and gradients of one pair. A pair is a point and a light.

use crate::reference::stored::stored;
use crate::rng::{normal_from, random_bits};
use crate::shade::visibility::{FIELD_FEATURES, FIELD_WIDTH, FieldConfig};
use sgs_shaders::structs::FieldLevel;

const POINTS: u32 = 0x51a7;
const LIGHTS: u32 = 0xb0c3;

/// Field with its parameters.
#[derive(Clone, Debug)]
pub struct Field {
    /// Levels of the grid.
    pub levels: Vec<FieldLevel>,
    /// Tables, two features per entry.
    pub tables: Vec<f64>,
    /// Weights of the layers. Rows of the first layer (features, direction, distance), rows of the second layer, and
    /// the last layer.
    pub mlp: Vec<f64>,
    /// Lower corner of the box.
    pub low: [f32; 3],
    /// Upper corner of the box.
    pub high: [f32; 3],
    /// Inverse size of the box.
    pub inverse: [f32; 3],
    /// Displacement of points in the grids, as a fraction of the box. Nonzero only to measure the effect of rounding.
    pub slip: [f32; 3],
}

/// Rounds to a 16-bit operand.
pub(super) fn operand(x: f64) -> f64 {
    let most = half::f16::MAX.to_f64();
    half::f16::from_f64(x.clamp(-most, most)).to_f64()
}

/// Gradients of a field and of the lights.
#[derive(Clone, Debug)]
pub struct Gradients {
    /// Gradient of [`Field::tables`].
    pub tables: Vec<f64>,
    /// Gradient of [`Field::mlp`].
    pub mlp: Vec<f64>,
    /// Gradient of the lights' positions.
    pub lights: Vec<[f64; 3]>,
}

/// Intermediate values of a pair's evaluation, for the backward pass.
pub(super) struct Trace {
    /// Entry and weight by level and corner.
    corners: Vec<(usize, f64)>,
    pub(super) inputs: Vec<f64>,
    pub(super) first: Vec<f64>,
    pub(super) second: Vec<f64>,
    reach: f64,
    pub(super) logit: f64,
    value: f64,
    /// Derivative of the value by the logit.
    pub(super) slope: f64,
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

impl Field {
    /// Converts from the device's single-precision parameters.
    pub fn new(config: &FieldConfig, tables: &[f32], mlp: &[f32], low: [f32; 3], high: [f32; 3]) -> Field {
        let wide = |v: &[f32]| v.iter().map(|&x| f64::from(x)).collect();
        let inverse = [0, 1, 2].map(|k| 1.0 / (high[k] - low[k]));
        let levels = config.table_levels();
        Field { levels, tables: wide(tables), mlp: wide(mlp), low, high, inverse, slip: [0.0; 3] }
    }

    /// Returns the field with tables as looked up in `table_bits` bits.
    pub fn stored(mut self, table_bits: u32) -> Field {
        self.tables.iter_mut().for_each(|t| *t = stored(*t, table_bits));
        self
    }

    fn inputs(&self) -> usize {
        FIELD_FEATURES * self.levels.len() + 4
    }

    /// Returns a position in units of the box, clamped to the box.
    fn position(&self, world: [f64; 3]) -> [f64; 3] {
        let inside = |k: usize| world[k].clamp(f64::from(self.low[k]), f64::from(self.high[k]));
        [0, 1, 2].map(|k| inside(k) * f64::from(self.inverse[k]))
    }

    /// Returns the entries and weights of a point. The position within a cell is computed in single precision, as in
    /// the kernel. At 4096 steps per axis, this uses up a coordinate's digits.
    fn corners(&self, world: [f64; 3]) -> Vec<(usize, f64)> {
        let inside = |k: usize| (world[k] as f32).clamp(self.low[k], self.high[k]);
        let x = [0, 1, 2].map(|k| ((inside(k) - self.low[k]) * self.inverse[k]).clamp(0.0, 1.0));
        let mut corners = Vec::new();
        for level in &self.levels {
            let at = [0, 1, 2].map(|k| x[k].mul_add(level.scale, 0.5) + self.slip[k] * level.scale);
            let last = level.resolution - 1;
            let low = at.map(|a| (a.floor() as u32).min(last));
            let part = at.map(|a| f64::from(a - a.floor()));
            for corner in 0..8 {
                let up = [0, 1, 2].map(|k| corner >> k & 1 == 1);
                let [i, j, k] = [0, 1, 2].map(|k| if up[k] { (low[k] + 1).min(last) } else { low[k] });
                let weight = (0..3).map(|k| if up[k] { part[k] } else { 1.0 - part[k] }).product();
                let entry = match level.mask {
                    0 => i + level.resolution * (j + level.resolution * k),
                    mask => (i ^ j.wrapping_mul(2_654_435_761) ^ k.wrapping_mul(805_459_861)) & mask,
                };
                corners.push(((level.offset + entry) as usize, weight));
            }
        }
        corners
    }

    /// Returns the first layer's product with the features of a point.
    pub fn point_share(&self, world: [f64; 3]) -> Vec<f64> {
        let inputs = self.inputs();
        let mut features = vec![0.0; inputs - 4];
        for (c, (entry, weight)) in self.corners(world).iter().enumerate() {
            for f in 0..FIELD_FEATURES {
                features[c / 8 * FIELD_FEATURES + f] += weight * self.tables[entry * FIELD_FEATURES + f];
            }
        }
        let row = |row: &[f64]| row.iter().zip(&features).map(|(w, x)| w * x).sum();
        self.mlp[..FIELD_WIDTH * inputs].chunks(inputs).map(row).collect()
    }

    fn trace(&self, point: [f64; 3], light: [f64; 3]) -> Trace {
        self.trace_with(point, light, |x| x)
    }

    /// Evaluates a pair, with `operand` applied to the operands of the second layer.
    pub(super) fn trace_with(&self, point: [f64; 3], light: [f64; 3], operand: impl Fn(f64) -> f64) -> Trace {
        let corners = self.corners(point);
        let mut inputs = vec![0.0; self.inputs()];
        for (c, (entry, weight)) in corners.iter().enumerate() {
            for f in 0..FIELD_FEATURES {
                inputs[c / 8 * FIELD_FEATURES + f] += weight * self.tables[entry * FIELD_FEATURES + f];
            }
        }
        let (x, p) = (self.position(point), self.position(light));
        let way = [0, 1, 2].map(|k| x[k] - p[k]);
        let reach = dot(way, way).sqrt();
        let features = inputs.len() - 4;
        for k in 0..3 {
            inputs[features + k] = way[k] / reach.max(1e-12);
        }
        inputs[features + 3] = reach;
        let layer = |weights: &[f64], x: &[f64]| -> Vec<f64> {
            weights.chunks(x.len()).map(|row| row.iter().zip(x).map(|(w, x)| w * x).sum()).collect()
        };
        let rectified = |v: &[f64]| v.iter().map(|z| z.max(0.0)).collect::<Vec<f64>>();
        let (one, rest) = self.mlp.split_at(FIELD_WIDTH * inputs.len());
        let (two, three) = rest.split_at(FIELD_WIDTH * FIELD_WIDTH);
        let first = rectified(&layer(one, &inputs));
        let operands = |v: &[f64]| v.iter().map(|x| operand(*x)).collect::<Vec<f64>>();
        let second = rectified(&layer(&operands(two), &operands(&first)));
        let logit = layer(three, &second)[0];
        let e = (-logit.abs()).exp();
        let slope = e / (1.0 + e).powi(2);
        Trace { corners, inputs, first, second, reach, logit, value: 1.0 / (1.0 + (-logit).exp()), slope }
    }

    /// Adds bounds of the errors of the gradients of tables and of a light's position.
    ///
    /// `by_input` bounds the errors of the gradients of a pair's inputs.
    pub(super) fn add_input_bounds(&self, t: &Trace, by_input: &[f64], light: usize, into: &mut Gradients) {
        let inputs = t.inputs.len();
        for (c, (entry, weight)) in t.corners.iter().enumerate() {
            for f in 0..FIELD_FEATURES {
                into.tables[entry * FIELD_FEATURES + f] += weight * by_input[c / 8 * FIELD_FEATURES + f];
            }
        }
        let way = [0, 1, 2].map(|k| t.inputs[inputs - 4 + k].abs());
        let across = [0, 1, 2].map(|k| by_input[inputs - 4 + k]);
        for k in 0..3 {
            let turned = (across[k] + way[k] * dot(way, across)) / t.reach.max(1e-12);
            into.lights[light][k] += (turned + way[k] * by_input[inputs - 1]) * f64::from(self.inverse[k]);
        }
    }

    /// Returns how visible a light is from a point; both are in world space.
    pub fn visibility(&self, point: [f64; 3], light: [f64; 3]) -> f64 {
        self.trace(point, light).value
    }

    /// Returns the margin of a pair's ReLU inputs from zero, and the logit. The margin is relative to the magnitudes of
    /// the summands.
    pub fn margin(&self, point: [f64; 3], light: [f64; 3]) -> (f64, f64) {
        let t = self.trace(point, light);
        let (one, rest) = self.mlp.split_at(FIELD_WIDTH * t.inputs.len());
        let (two, three) = rest.split_at(FIELD_WIDTH * FIELD_WIDTH);
        // Sums of rows, and the magnitudes that bound the rounding error by then.
        let rows = |weights: &[f64], x: &[f64], sizes: &[f64]| -> Vec<(f64, f64)> {
            let of = |row: &[f64]| {
                let sum = row.iter().zip(x).map(|(w, x)| w * x).sum();
                (sum, row.iter().zip(sizes).map(|(w, s)| (w * s).abs()).sum())
            };
            weights.chunks(x.len()).map(of).collect()
        };
        let first = rows(one, &t.inputs, &t.inputs);
        let sizes: Vec<f64> = first.iter().map(|(z, size)| if *z > 0.0 { *size } else { 0.0 }).collect();
        let second = rows(two, &t.first, &sizes);
        let share = |(z, size): &(f64, f64)| if *size > 0.0 { z.abs() / size } else { 1.0 };
        let nearest = first.iter().chain(&second).map(share).fold(1.0, f64::min);
        let logit = three.iter().zip(&t.second).map(|(w, x)| w * x).sum();
        (nearest, logit)
    }

    /// Returns [`Field::visibility`] with 16-bit operands of the second layer. This matches cooperative matrices; sums
    /// are exact.
    pub fn visibility_half(&self, point: [f64; 3], light: [f64; 3]) -> f64 {
        self.trace_with(point, light, operand).value
    }

    /// Returns zero gradients.
    pub fn zeros(&self, lights: usize) -> Gradients {
        Gradients {
            tables: vec![0.0; self.tables.len()],
            mlp: vec![0.0; self.mlp.len()],
            lights: vec![[0.0; 3]; lights],
        }
    }

    /// Adds the gradients that follow from `gradient`, that of a pair's value.
    pub fn visibility_bwd(
        &self,
        point: [f64; 3],
        lights: &[[f64; 3]],
        light: usize,
        gradient: f64,
        into: &mut Gradients,
    ) {
        let t = self.trace(point, lights[light]);
        let (inputs, width) = (t.inputs.len(), FIELD_WIDTH);
        let (second_at, last_at) = (width * inputs, width * (inputs + width));
        let logit = gradient * t.slope;
        let mut first = vec![0.0; width];
        for o in 0..width {
            into.mlp[last_at + o] += logit * t.second[o];
            let g = if t.second[o] > 0.0 { logit * self.mlp[last_at + o] } else { 0.0 };
            for k in 0..width {
                into.mlp[second_at + o * width + k] += g * t.first[k];
                first[k] += g * self.mlp[second_at + o * width + k];
            }
        }
        let mut by_input = vec![0.0; inputs];
        for n in 0..width {
            let g = if t.first[n] > 0.0 { first[n] } else { 0.0 };
            for k in 0..inputs {
                into.mlp[n * inputs + k] += g * t.inputs[k];
                by_input[k] += g * self.mlp[n * inputs + k];
            }
        }
        self.add_inputs(&t, &by_input, lights, light, into);
    }

    /// Adds the gradients of tables and of a light's position.
    ///
    /// `by_input`: gradients of a pair's inputs.
    pub(super) fn add_inputs(
        &self,
        t: &Trace,
        by_input: &[f64],
        lights: &[[f64; 3]],
        light: usize,
        into: &mut Gradients,
    ) {
        let inputs = t.inputs.len();
        for (c, (entry, weight)) in t.corners.iter().enumerate() {
            for f in 0..FIELD_FEATURES {
                into.tables[entry * FIELD_FEATURES + f] += weight * by_input[c / 8 * FIELD_FEATURES + f];
            }
        }
        // A light that is clamped to the box, or coincides with the point, has no gradient.
        let axis = |v: &[f64]| [v[inputs - 4], v[inputs - 3], v[inputs - 2]];
        let (way, across) = (axis(&t.inputs), axis(by_input));
        for k in 0..3 {
            let (low, high) = (f64::from(self.low[k]), f64::from(self.high[k]));
            if t.reach > 1e-12 && lights[light][k] > low && lights[light][k] < high {
                let turned = (across[k] - way[k] * dot(way, across)) / t.reach;
                into.lights[light][k] -= (turned + way[k] * by_input[inputs - 1]) * f64::from(self.inverse[k]);
            }
        }
    }
}

/// Returns the displacement for the smoothness term of a point or a light. `kind` is 0 for a point and 1 for a light.
pub fn jitter(seed: u32, kind: usize, index: u32, deviation: f64) -> [f64; 3] {
    let seed = seed ^ [POINTS, LIGHTS][kind];
    let bits = |i: u32| random_bits(seed, index, i);
    let [[a, b], [c, _]] = [normal_from(bits(0), bits(1)), normal_from(bits(2), bits(3))];
    [a, b, c].map(|x| deviation * x)
}

#[cfg(test)]
mod tests {
    use super::super::difference;
    use super::*;
    use crate::rng::Pcg;

    #[test]
    fn gradients_match_finite_differences() {
        let config = FieldConfig::new(3, 8, 4, 40);
        let mut rng = Pcg::new(1);
        let tables: Vec<f32> = (0..2 * config.entries()).map(|_| rng.normal() as f32).collect();
        let mut field = Field::new(&config, &tables, &config.initial_weights(7), [-1.0, -2.0, 0.0], [2.0, 2.0, 3.0]);
        let (point, light) = ([0.3, -0.4, 1.0], [1.1, 0.7, 2.0]);
        let mut found = field.zeros(1);
        field.visibility_bwd(point, &[light], 0, 1.0, &mut found);
        let close = |a: f64, b: f64| assert!((a - b).abs() < 1e-8 + 1e-5 * b.abs(), "{a} is not {b}");
        let mut mlp = field.mlp.clone();
        for i in 0..mlp.len() {
            let d = difference(&mut mlp, i, |w| Field { mlp: w.to_vec(), ..field.clone() }.visibility(point, light));
            close(found.mlp[i], d);
        }
        let touched: Vec<usize> = (0..found.tables.len()).filter(|i| found.tables[*i] != 0.0).collect();
        assert!(touched.len() > 20);
        for i in touched {
            let old = field.tables[i];
            field.tables[i] = old + 1e-5;
            let up = field.visibility(point, light);
            field.tables[i] = old - 1e-5;
            let down = field.visibility(point, light);
            field.tables[i] = old;
            close(found.tables[i], (up - down) / 2e-5);
        }
        let mut p = light;
        for k in 0..3 {
            let d = difference(&mut p, k, |p| field.visibility(point, [p[0], p[1], p[2]]));
            close(found.lights[0][k], d);
        }
    }
}
