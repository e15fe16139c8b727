//! LPIPS: image distance by a network that was trained on human judgments.
//!
//! Zhang et al. 2018, "The Unreasonable Effectiveness of Deep Features as a Perceptual Metric", version 0.1, for the
//! networks VGG (16 layers) and AlexNet. Runs on the CPU, with matrix products of the crate `ndarray`. Weights are read
//! from a file that the user provides: `tools/priors/sgs_priors/lpips_weights.py` converts published weights. The
//! repository has none.

mod file;
mod layers;

pub use layers::LpipsNet;

use super::{MetricError, check};
use layers::{Map, Step};
use serde::Serialize;
use sgs_scene::Image;
use std::path::Path;

/// Mean of each channel over the networks' training images, in -1 to 1. Inputs are shifted by the mean and divided by
/// [`SPREAD`], the standard deviation.
const SHIFT: [f32; 3] = [-0.030, -0.088, -0.188];
const SPREAD: [f32; 3] = [0.458, 0.448, 0.450];
/// Addend to the length of features that avoids division by zero.
const LEAST: f64 = 1e-10;

/// Network inputs for black and white.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LpipsRange {
    /// 0 and 1, as in the evaluations of 3DGS and of the paper's tables.
    #[default]
    Plain,
    /// -1 and 1, the range that the metric is defined for.
    Signed,
}

/// Description of an LPIPS variant in files.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct LpipsAbout {
    /// Name of the network.
    pub net: &'static str,
    /// Version of the weights.
    pub version: &'static str,
    /// Network inputs for black and white.
    pub range: [i8; 2],
}

/// Network with its weights.
pub struct Lpips {
    net: LpipsNet,
    range: LpipsRange,
    steps: Vec<Step>,
    /// Weights of the channels' differences, by stage.
    heads: Vec<Vec<f32>>,
}

impl Lpips {
    /// Reads weights from a file.
    ///
    /// # Errors
    /// If the file does not exist, or does not hold the weights.
    pub fn load(path: &Path, range: LpipsRange) -> Result<Lpips, MetricError> {
        let file = file::Weights::load(path)?;
        let steps = file.net.steps(file.convolutions);
        Ok(Lpips { net: file.net, range, steps, heads: file.heads })
    }

    /// Returns the description of the variant.
    pub fn about(&self) -> LpipsAbout {
        let range = if self.range == LpipsRange::Signed { [-1, 1] } else { [0, 1] };
        LpipsAbout { net: self.net.name(), version: "0.1", range }
    }

    /// Returns the distance of display-referred images of three channels in `[0, 1]`. 0 for equal images. Masked pixels
    /// of `a` are replaced by those of `b`.
    ///
    /// # Errors
    /// If the images differ in size, do not have three channels, or are too small for the network.
    pub fn distance(&self, a: &Image, b: &Image, mask: Option<&Image>) -> Result<f64, MetricError> {
        Ok(self.stages(a, b, mask)?.iter().sum())
    }

    /// Returns the terms of [`Lpips::distance`], one for each of the five stages.
    ///
    /// # Errors
    /// As [`Lpips::distance`].
    pub fn stages(&self, a: &Image, b: &Image, mask: Option<&Image>) -> Result<Vec<f64>, MetricError> {
        const MEASURE: &str = "lpips";
        check(MEASURE, a, b, mask)?;
        let size = (a.width, a.height, a.channels);
        if a.channels != 3 {
            return Err(MetricError::Size { measure: MEASURE, a: size, b: (a.width, a.height, 3) });
        }
        if mask.is_some_and(|m| m.data.iter().all(|v| *v <= 0.5)) {
            return Err(MetricError::Empty { measure: MEASURE });
        }
        let least = self.net.least();
        if a.width.min(a.height) < least {
            return Err(MetricError::Small { measure: MEASURE, size: (a.width, a.height), least });
        }
        let (mut x, mut y) = (self.seen(a, Some(b).zip(mask)), self.seen(b, None));
        let mut heads = self.heads.iter();
        let mut parts = Vec::new();
        for step in &self.steps {
            match step {
                Step::Convolve(c) => (x, y) = (c.apply(&x), c.apply(&y)),
                Step::Pool { width } => (x, y) = (x.pooled(*width), y.pooled(*width)),
                Step::Compare => parts.extend(heads.next().map(|head| apart(&x, &y, head))),
            }
        }
        Ok(parts)
    }

    /// Converts an image to the network's input. Pixels outside the mask are taken from the other image.
    fn seen(&self, image: &Image, other: Option<(&Image, &Image)>) -> Map {
        let pixels = (image.width * image.height) as usize;
        let value = |p: usize, c: usize| {
            let from = match other {
                Some((other, mask)) if mask.data[p] <= 0.5 => other,
                _ => image,
            };
            let v = from.data[3 * p + c].clamp(0.0, 1.0);
            let v = if self.range == LpipsRange::Signed { 2.0 * v - 1.0 } else { v };
            (v - SHIFT[c]) / SPREAD[c]
        };
        let data = (0..3).flat_map(|c| (0..pixels).map(move |p| (p, c))).map(|(p, c)| value(p, c)).collect();
        Map { channels: 3, width: image.width as usize, height: image.height as usize, data }
    }
}

/// Returns the mean over pixels of the weighted squared differences of features. Features are scaled to unit length at
/// each pixel.
fn apart(x: &Map, y: &Map, head: &[f32]) -> f64 {
    let places = x.width * x.height;
    let length = |m: &Map, p: usize| {
        (0..m.channels).map(|c| f64::from(m.data[c * places + p]).powi(2)).sum::<f64>().sqrt() + LEAST
    };
    let at = |p: usize| {
        let (lx, ly) = (length(x, p), length(y, p));
        let difference = |c: usize| f64::from(x.data[c * places + p]) / lx - f64::from(y.data[c * places + p]) / ly;
        head.iter().enumerate().map(|(c, w)| f64::from(*w) * difference(c).powi(2)).sum::<f64>()
    };
    (0..places).map(at).sum::<f64>() / places as f64
}
