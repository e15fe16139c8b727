//! Gradients of a pair of the visibility field with 16-bit operands.
//!
//! Bounds of their rounding errors follow. The operands are those of the kernels on matrices. Scales by powers of two change no digits, so that the reference has
//! none; it rounds to eleven binary digits of any magnitude.

use super::visibility::{Field, Gradients, operand};
use crate::shade::visibility::FIELD_WIDTH;

/// Largest relative error of an operand in the range of 16 bits.
const UNIT: f64 = 1.0 / 2048.0;

/// Largest error of an operand below that range.
const LEAST: f64 = 1.0 / 33_554_432.0;

/// Relative error of two rounded factors, and of three.
const TWO: f64 = (1.0 + UNIT) * (1.0 + UNIT) - 1.0;
const THREE: f64 = (1.0 + UNIT) * (1.0 + UNIT) * (1.0 + UNIT) - 1.0;

/// Rounds to eleven binary digits, ties to even.
fn digits(x: f64) -> f64 {
    if x == 0.0 || !x.is_finite() {
        return x;
    }
    let unit = 2.0_f64.powi(x.abs().log2().floor() as i32 - 10);
    (x / unit).round_ties_even() * unit
}

/// Returns the largest error of a 16-bit operand that is not scaled.
fn error(x: f64) -> f64 {
    (UNIT * x.abs()).max(LEAST)
}

/// Second layer of a pair without rounding, and bounds of the errors by rounding.
struct Second {
    /// Sums before the rectifier.
    sums: Vec<f64>,
    /// Bounds of their errors.
    errors: Vec<f64>,
    /// Bound of the logit's error.
    logit: f64,
}

impl Field {
    /// Returns the weights of the first layer, the second and the last.
    fn layers(&self, inputs: usize) -> [&[f64]; 3] {
        let (one, rest) = self.mlp.split_at(FIELD_WIDTH * inputs);
        let (two, three) = rest.split_at(FIELD_WIDTH * FIELD_WIDTH);
        [one, two, three]
    }

    fn second_errors(&self, two: &[f64], last: &[f64], first: &[f64]) -> Second {
        let products = |row: &[f64]| row.iter().zip(first).map(|(w, x)| w * x).sum::<f64>();
        let of = |(w, x): (&f64, &f64)| error(*w) * x.abs() + (w.abs() + error(*w)) * error(*x);
        let sums = two.chunks(FIELD_WIDTH).map(products).collect();
        let errors: Vec<f64> = two.chunks(FIELD_WIDTH).map(|row| row.iter().zip(first).map(of).sum()).collect();
        let logit = last.iter().zip(&errors).map(|(w, e)| w.abs() * e).sum();
        Second { sums, errors, logit }
    }

    /// Returns a pair's logit, and a bound of its error with 16-bit operands.
    pub fn logit_half_bound(&self, point: [f64; 3], light: [f64; 3]) -> [f64; 2] {
        let t = self.trace_with(point, light, |x| x);
        let [_, two, last] = self.layers(t.inputs.len());
        [t.logit, self.second_errors(two, last, &t.first).logit]
    }

    /// Adds the gradients of [`Field::visibility_bwd`] with 16-bit operands.
    pub fn visibility_bwd_half(
        &self,
        point: [f64; 3],
        lights: &[[f64; 3]],
        light: usize,
        gradient: f64,
        into: &mut Gradients,
    ) {
        let t = self.trace_with(point, lights[light], operand);
        let (inputs, width) = (t.inputs.len(), FIELD_WIDTH);
        let (second_at, last_at) = (width * inputs, width * (inputs + width));
        let [one, two, last] = self.layers(inputs);
        let slope = gradient * t.slope;
        let hidden: Vec<f64> = t.first.iter().map(|x| digits(slope * operand(*x))).collect();
        // Gradient of the first layer's outputs, over the slope.
        let mut first = vec![0.0; width];
        for o in (0..width).filter(|o| t.second[*o] > 0.0) {
            for k in 0..width {
                into.mlp[second_at + o * width + k] += last[o] * hidden[k];
                into.mlp[last_at + o] += two[o * width + k] * hidden[k];
                first[k] += digits(two[o * width + k] * last[o]);
            }
        }
        let mut by_input = vec![0.0; inputs];
        for n in (0..width).filter(|n| t.first[*n] > 0.0) {
            for k in 0..inputs {
                let x = t.inputs[k];
                let of_pair = k >= inputs - 4;
                into.mlp[n * inputs + k] +=
                    if of_pair { digits(first[n]) * digits(slope * x) } else { slope * first[n] * x };
                by_input[k] += slope * first[n] * one[n * inputs + k];
            }
        }
        self.add_inputs(&t, &by_input, lights, light, into);
    }

    /// Adds bounds of the rounding errors of [`Field::visibility_bwd_half`].
    ///
    /// The errors are the differences from [`Field::visibility_bwd`].
    /// `uncertain`: largest error of `gradient`. Sums of the second layer within their error of zero may have either
    /// gradient of the rectifier.
    pub fn visibility_bwd_half_bound(
        &self,
        point: [f64; 3],
        lights: &[[f64; 3]],
        light: usize,
        [gradient, uncertain]: [f64; 2],
        into: &mut Gradients,
    ) {
        let t = self.trace_with(point, lights[light], |x| x);
        let (inputs, width) = (t.inputs.len(), FIELD_WIDTH);
        let (second_at, last_at) = (width * inputs, width * (inputs + width));
        let [one, two, last] = self.layers(inputs);
        let second = self.second_errors(two, last, &t.first);
        // The logarithm of the squashing function's slope changes by at most the logit's error.
        let slope = (gradient * t.slope).abs();
        let largest = (slope + uncertain * t.slope) * second.logit.exp();
        let off = largest - slope;
        let scaled = two.iter().enumerate().map(|(i, w)| (w * last[i / width]).abs()).fold(0.0, f64::max) * LEAST;
        let [mut first, mut first_off] = [0, 1].map(|_| vec![0.0; width]);
        for o in 0..width {
            let (sum, on) = (second.sums[o], second.sums[o] > second.errors[o]);
            let flips = sum.abs() <= second.errors[o];
            if !on && !flips {
                continue;
            }
            // What a flip adds or omits, otherwise what the slope's error changes.
            let change = if flips { largest } else { off };
            into.mlp[last_at + o] += change * sum.abs();
            for k in 0..width {
                let (w, hidden) = (two[o * width + k].abs(), t.first[k]);
                let rounded = largest * (THREE * hidden + LEAST);
                into.mlp[second_at + o * width + k] += last[o].abs() * (change * hidden + rounded);
                into.mlp[last_at + o] += w * rounded;
                let back = two[o * width + k] * last[o];
                first[k] += if sum > 0.0 { back } else { 0.0 };
                first_off[k] += if flips { back.abs() } else { 0.0 } + UNIT * back.abs() + scaled;
            }
        }
        let mut by_input = vec![0.0; inputs];
        for n in (0..width).filter(|n| t.first[*n] > 0.0) {
            let error = off * first[n].abs() + largest * first_off[n];
            let rounded = TWO * largest * (first[n].abs() + first_off[n]);
            for k in 0..inputs {
                let of_pair = k >= inputs - 4;
                into.mlp[n * inputs + k] += (error + if of_pair { rounded } else { 0.0 }) * t.inputs[k].abs();
                by_input[k] += error * one[n * inputs + k].abs();
            }
        }
        self.add_input_bounds(&t, &by_input, light, into);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::Pcg;
    use crate::shade::visibility::FieldConfig;

    #[test]
    fn digits_match_half_precision() {
        let mut rng = Pcg::new(3);
        for _ in 0..1000 {
            let x = rng.range(-2.0, 2.0);
            assert_eq!(digits(x) * 1024.0, operand(x * 1024.0));
        }
        assert_eq!([digits(0.0), digits(1.0), digits(-3e-30)].map(|x| x == 0.0), [true, false, false]);
    }

    #[test]
    fn rounded_gradients_are_within_their_bound() {
        let config = FieldConfig::new(4, 6, 4, 40);
        let mut rng = Pcg::new(4);
        let tables: Vec<f32> = (0..2 * config.entries()).map(|_| rng.normal() as f32).collect();
        for scale in [1.0, 4.0, 1e-4] {
            let mlp: Vec<f32> = config.initial_weights(5).iter().map(|w| scale * w).collect();
            let field = Field::new(&config, &tables, &mlp, [-1.0; 3], [1.0; 3]);
            let mut place = || [0; 3].map(|_| rng.range(-1.0, 1.0));
            let lights = [place(), place()];
            let [mut exact, mut half, mut bound] = [0; 3].map(|_| field.zeros(2));
            for i in 0..60 {
                let (point, light) = (place(), i % 2);
                field.visibility_bwd(point, &lights, light, -0.7, &mut exact);
                field.visibility_bwd_half(point, &lights, light, -0.7, &mut half);
                field.visibility_bwd_half_bound(point, &lights, light, [-0.7, 0.0], &mut bound);
            }
            let row = |g: &Gradients| [g.mlp.as_slice(), &g.tables, g.lights.as_flattened()].concat();
            let (exact, half, bound) = (row(&exact), row(&half), row(&bound));
            let sum = |v: &[f64]| v.iter().map(|x| x.abs()).sum::<f64>();
            let off: Vec<f64> = exact.iter().zip(&half).map(|(a, b)| a - b).collect();
            assert!(sum(&off) > 1e-5 * sum(&exact), "weights times {scale}: nothing was rounded");
            // The errors of logits and of small operands grow beyond the gradients with other weights.
            assert!(scale != 1.0 || sum(&bound) < 0.2 * sum(&exact), "{} of {}", sum(&bound), sum(&exact));
            for (off, bound) in off.iter().zip(&bound) {
                assert!(off.abs() <= 1.0001 * bound + 1e-14, "weights times {scale}: {off} exceeds {bound}");
            }
        }
    }
}
