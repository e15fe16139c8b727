//! Layers of the networks, and their evaluation.

use ndarray::{Array2, ArrayView2};
use rayon::prelude::*;

/// Network whose features are compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LpipsNet {
    /// VGG of 16 layers (Simonyan and Zisserman 2015).
    Vgg,
    /// AlexNet (Krizhevsky 2014).
    Alex,
}

/// Position of a convolution in the published network, and its shape.
pub(super) struct Shape {
    /// Number of the layer in the file.
    pub at: usize,
    pub outputs: usize,
    pub inputs: usize,
    pub width: usize,
    stride: usize,
    /// Width of the zero padding.
    around: usize,
    /// Width of the max pooling before the convolution, with stride 2.
    pool: Option<usize>,
    /// Whether features are compared after the convolution.
    compared: bool,
}

const fn shape(at: usize, outputs: usize, inputs: usize, pool: Option<usize>, compared: bool) -> Shape {
    Shape { at, outputs, inputs, width: 3, stride: 1, around: 1, pool, compared }
}

const VGG: [Shape; 13] = [
    shape(0, 64, 3, None, false),
    shape(2, 64, 64, None, true),
    shape(5, 128, 64, Some(2), false),
    shape(7, 128, 128, None, true),
    shape(10, 256, 128, Some(2), false),
    shape(12, 256, 256, None, false),
    shape(14, 256, 256, None, true),
    shape(17, 512, 256, Some(2), false),
    shape(19, 512, 512, None, false),
    shape(21, 512, 512, None, true),
    shape(24, 512, 512, Some(2), false),
    shape(26, 512, 512, None, false),
    shape(28, 512, 512, None, true),
];

const ALEX: [Shape; 5] = [
    Shape { width: 11, stride: 4, around: 2, ..shape(0, 64, 3, None, true) },
    Shape { width: 5, around: 2, ..shape(3, 192, 64, Some(3), true) },
    shape(6, 384, 192, Some(3), true),
    shape(8, 256, 384, None, true),
    shape(10, 256, 256, None, true),
];

impl LpipsNet {
    /// All networks.
    pub const ALL: [LpipsNet; 2] = [LpipsNet::Vgg, LpipsNet::Alex];

    /// Returns the name of the network in files.
    pub fn name(self) -> &'static str {
        match self {
            LpipsNet::Vgg => "vgg",
            LpipsNet::Alex => "alex",
        }
    }

    /// Returns the least image width and height in pixels. The last stage then has at least one pixel.
    pub fn least(self) -> u32 {
        match self {
            LpipsNet::Vgg => 16,
            LpipsNet::Alex => 31,
        }
    }

    /// Returns the convolutions, in order.
    pub(super) fn shapes(self) -> &'static [Shape] {
        match self {
            LpipsNet::Vgg => &VGG,
            LpipsNet::Alex => &ALEX,
        }
    }

    /// Returns the number of channels of each of the five stages.
    pub(super) fn stages(self) -> impl Iterator<Item = usize> {
        self.shapes().iter().filter(|s| s.compared).map(|s| s.outputs)
    }

    /// Returns the steps of the network with these weights, in order.
    pub(super) fn steps(self, convolutions: Vec<Numbers>) -> Vec<Step> {
        let mut steps = Vec::new();
        for (shape, numbers) in self.shapes().iter().zip(convolutions) {
            steps.extend(shape.pool.map(|width| Step::Pool { width }));
            steps.push(Step::Convolve(Convolution { shape, numbers }));
            if shape.compared {
                steps.push(Step::Compare);
            }
        }
        steps
    }
}

/// Weights (outputs, inputs, rows, columns) and a bias for each output.
pub(super) struct Numbers {
    pub weights: Vec<f32>,
    pub biases: Vec<f32>,
}

/// Step of a network.
pub(super) enum Step {
    /// Convolution with ReLU.
    Convolve(Convolution),
    /// Max pooling with stride 2.
    Pool { width: usize },
    /// Comparison of the features of both images.
    Compare,
}

/// Feature map, stored channel by channel and row by row.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Map {
    pub channels: usize,
    pub width: usize,
    pub height: usize,
    pub data: Vec<f32>,
}

impl Map {
    /// Applies max pooling of `width` × `width` with stride 2, without padding.
    pub fn pooled(&self, width: usize) -> Map {
        let half = |n: usize| (n - width) / 2 + 1;
        let (w, h) = (half(self.width), half(self.height));
        let channel = |from: &[f32]| {
            let at = |x: usize, y: usize| {
                let rows = (0..width).flat_map(|dy| &from[(2 * y + dy) * self.width + 2 * x..][..width]);
                rows.fold(f32::NEG_INFINITY, |m, v| m.max(*v))
            };
            (0..h).flat_map(|y| (0..w).map(move |x| (x, y))).map(|(x, y)| at(x, y)).collect::<Vec<f32>>()
        };
        let data: Vec<Vec<f32>> = self.data.par_chunks(self.width * self.height).map(channel).collect();
        Map { channels: self.channels, width: w, height: h, data: data.concat() }
    }
}

/// Convolution with its weights.
pub(super) struct Convolution {
    shape: &'static Shape,
    numbers: Numbers,
}

/// Number of values that are laid out at a time. Large enough for an efficient product, small enough for caches.
const LAID_OUT: usize = 1 << 19;

impl Convolution {
    /// Applies the convolution, bias and ReLU.
    pub fn apply(&self, from: &Map) -> Map {
        let s = self.shape;
        let after = |n: usize| (n + 2 * s.around - s.width) / s.stride + 1;
        let (w, h) = (after(from.width), after(from.height));
        let depth = s.inputs * s.width * s.width;
        let some = (LAID_OUT / depth).clamp(64, 4096);
        let weights = ArrayView2::from_shape((s.outputs, depth), &self.numbers.weights)
            .expect("invariant: the file has been checked");
        let places = w * h;
        let starts: Vec<usize> = (0..places).step_by(some).collect();
        let parts: Vec<Array2<f32>> = starts
            .par_iter()
            .map(|&start| weights.dot(&self.laid_out(from, start..places.min(start + some), w)))
            .collect();
        let mut data = Vec::with_capacity(s.outputs * places);
        for (c, bias) in self.numbers.biases.iter().enumerate() {
            for part in &parts {
                data.extend(part.row(c).iter().map(|v| (v + bias).max(0.0)));
            }
        }
        Map { channels: s.outputs, width: w, height: h, data }
    }

    /// Lays out the neighborhoods of some output pixels as columns of a matrix. `w`: width of the output.
    fn laid_out(&self, from: &Map, places: std::ops::Range<usize>, w: usize) -> Array2<f32> {
        let s = self.shape;
        let mut out = Array2::zeros((s.inputs * s.width * s.width, places.len()));
        for (k, mut row) in out.rows_mut().into_iter().enumerate() {
            let (channel, dy, dx) = (k / (s.width * s.width), k / s.width % s.width, k % s.width);
            let plane = &from.data[channel * from.width * from.height..][..from.width * from.height];
            for (value, place) in row.iter_mut().zip(places.clone()) {
                // Coordinates beyond the upper and left border wrap around to large values, which fail the check as
                // well.
                let y = (place / w * s.stride + dy).wrapping_sub(s.around);
                let x = (place % w * s.stride + dx).wrapping_sub(s.around);
                if y < from.height && x < from.width {
                    *value = plane[y * from.width + x];
                }
            }
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn convolution_matches_its_definition() {
        static SHAPE: Shape = Shape { width: 5, stride: 2, around: 1, ..shape(0, 3, 2, None, false) };
        let number = |i: usize| ((i * 37 + 11) % 23) as f32 / 23.0 - 0.5;
        let numbers = Numbers { weights: (0..150).map(number).collect(), biases: vec![0.1, -0.2, 0.3] };
        let from = Map { channels: 2, width: 9, height: 6, data: (0..108).map(|i| number(i * 5)).collect() };
        let found = Convolution { shape: &SHAPE, numbers }.apply(&from);
        assert_eq!((found.channels, found.width, found.height), (3, 4, 2));
        for (i, value) in found.data.iter().enumerate() {
            let (o, y, x) = (i / 8, i / 4 % 2, i % 4);
            let mut sum = [0.1, -0.2, 0.3][o];
            for (k, weight) in (0..50).map(|k| (k, number(o * 50 + k))) {
                let (c, at_y, at_x) = (k / 25, (2 * y + k / 5 % 5) as i64 - 1, (2 * x + k % 5) as i64 - 1);
                if (0..6).contains(&at_y) && (0..9).contains(&at_x) {
                    sum += weight * from.data[c * 54 + at_y as usize * 9 + at_x as usize];
                }
            }
            assert!((value - sum.max(0.0)).abs() < 1e-5, "{i}: {value} {sum}");
        }
        assert!(found.data.contains(&0.0) && found.data.iter().any(|v| *v > 0.1));
    }

    #[test]
    fn pooling_ignores_incomplete_windows() {
        let from = Map { channels: 1, width: 5, height: 4, data: (0..20).map(|i| (i * 7 % 20) as f32).collect() };
        let found = from.pooled(3);
        assert_eq!((found.width, found.height), (2, 1));
        let largest = |x: usize| (0..9).map(|k| from.data[k / 3 * 5 + x + k % 3]).fold(0.0, f32::max);
        assert_eq!(found.data, [largest(0), largest(2)]);
        assert_eq!(from.pooled(2).data.len(), 4);
    }

    #[test]
    fn smallest_image_leaves_one_pixel() {
        for net in LpipsNet::ALL {
            let left = |n: u32| {
                let after = |n: Option<usize>, s: &Shape| {
                    let n = s.pool.map_or(n, |p| n?.checked_sub(p).map(|n| n / 2 + 1))?;
                    (n + 2 * s.around).checked_sub(s.width).map(|n| n / s.stride + 1)
                };
                net.shapes().iter().fold(Some(n as usize), after)
            };
            assert_eq!(left(net.least()), Some(1), "{net:?}");
            assert!(left(net.least() - 1).is_none_or(|n| n == 0), "{net:?}");
        }
    }
}
