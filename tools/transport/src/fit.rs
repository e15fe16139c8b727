//! Fit of emitters and enclosure to photographs.
//!
//! The radiance of a pixel is linear in the emitters' colors. The *response* of a pixel to an emitter is the radiance under
//! that emitter alone with color 1: direct light, bounced light, and 1 if the pixel shows the emitter. Non-negative least
//! squares give the colors. Deviations are those of display values, to first order; above [`ROBUST`] they weigh less. A
//! clipped value means only that the radiance is at least 1.
//!
//! The six faces of the enclosure stand for all surfaces that no view sees. Their albedo is fitted by Gauss-Newton steps,
//! in turn with the colors. It starts at the mean albedo of the surfels. A small weight keeps it there if no pixel depends on
//! it.

use crate::radiosity::{Color, FACES, Radiosity};
use rayon::prelude::*;
use sgs_scene::{linear_to_srgb, srgb_to_linear};
use std::f64::consts::PI;

/// Deviation in display values above which a pixel weighs less.
const ROBUST: f64 = 0.1;
/// Number of reweightings of the colors.
const REWEIGHTINGS: usize = 5;
/// Limits of the albedo of a face.
const ALBEDO: [f64; 2] = [0.02, 0.95];
/// Largest change of a face's albedo in a step.
const LARGEST_CHANGE: f64 = 0.2;
/// Weight of the initial albedo of the enclosure per compared pixel.
const PRIOR: f64 = 1e-5;
/// Change of the albedo by which derivatives are differenced.
const DIFFERENCE: f64 = 0.02;
/// Number of receivers from which a sample interpolates.
pub const NEAREST: usize = 8;

/// Pixels of the photographs that are compared.
#[derive(Clone, Debug, Default)]
pub struct Samples {
    /// Display values.
    pub targets: Vec<[f32; 3]>,
    /// Whether a value clips.
    pub clipped: Vec<[bool; 3]>,
    /// Diffuse reflectance.
    pub diffuse: Vec<Color>,
    /// Hemispherical reflectance of the specular lobe.
    pub specular: Vec<Color>,
    /// Nearest surfels of each sample, `[samples * NEAREST]`.
    pub neighbors: Vec<u32>,
    /// Their weights, which add up to 1.
    pub weights: Vec<f32>,
    /// Emitter that a sample shows, `shown_as` of [`Fitter::push`]; 0 for none.
    pub emitters: Vec<u32>,
}

impl Samples {
    /// Returns the number of samples.
    pub fn len(&self) -> usize {
        self.targets.len()
    }

    /// Interpolates values of the receivers at a sample's point.
    fn at(&self, sample: usize, values: &[Color]) -> Color {
        let range = sample * NEAREST..(sample + 1) * NEAREST;
        let mut sum = [0.0; 3];
        for (j, w) in self.neighbors[range.clone()].iter().zip(&self.weights[range]) {
            if let Some(value) = values.get(*j as usize) {
                [0, 1, 2].iter().for_each(|&c| sum[c] += f64::from(*w) * value[c]);
            }
        }
        sum
    }

    /// Returns the radiance that a sample reflects under irradiance of the receivers.
    fn reflected(&self, sample: usize, irradiance: &[Color]) -> Color {
        let (e, kd, ks) = (self.at(sample, irradiance), self.diffuse[sample], self.specular[sample]);
        [0, 1, 2].map(|c| (kd[c] + ks[c]) * e[c] / PI)
    }
}

/// Direct light of an emitter of color 1.
#[derive(Clone, Debug, Default)]
pub struct UnitLight {
    /// Irradiance of each receiver.
    pub receivers: Vec<f32>,
    /// Irradiance of each sample.
    pub samples: Vec<f32>,
}

/// Emitter under fit.
#[derive(Clone, Debug, Default)]
struct Column {
    unit: UnitLight,
    /// Number that [`Samples::emitters`] calls it by, 0 if no sample shows it.
    shown_as: u32,
    /// Response of each sample.
    response: Vec<Color>,
    color: Color,
}

/// Fit of emitters and enclosure.
#[derive(Clone)]
pub struct Fitter<'a> {
    radiosity: Radiosity<'a>,
    samples: &'a Samples,
    /// Linear values of the photographs.
    targets: Vec<Color>,
    /// Initial albedo of the enclosure.
    start: Color,
    /// Albedo of each face of the enclosure.
    enclosure: [Color; FACES],
    columns: Vec<Column>,
}

impl<'a> Fitter<'a> {
    /// Starts without emitters. `start` is the albedo of all faces of the enclosure.
    pub fn new(radiosity: Radiosity<'a>, samples: &'a Samples, start: [f32; 3]) -> Fitter<'a> {
        let linear = |t: &[f32; 3]| t.map(|v| f64::from(srgb_to_linear(v.clamp(0.0, 1.0))));
        let start = start.map(f64::from);
        let targets = samples.targets.iter().map(linear).collect();
        Fitter { radiosity, samples, targets, start, enclosure: [start; FACES], columns: Vec::new() }
    }

    /// Returns the color of each emitter.
    pub fn colors(&self) -> Vec<[f32; 3]> {
        self.columns.iter().map(|c| c.color.map(|v| v as f32)).collect()
    }

    /// Returns the albedo of each face of the enclosure.
    pub fn enclosure(&self) -> [[f32; 3]; FACES] {
        self.enclosure.map(|face| face.map(|a| a as f32))
    }

    /// Adds an emitter, dark at first. `shown_as`: its number in [`Samples::emitters`], 0 if no sample shows it.
    pub fn push(&mut self, unit: UnitLight, shown_as: u32) {
        let reflectance = self.radiosity.reflectance(&self.enclosure);
        let response = self.response(&unit, shown_as, &reflectance);
        self.columns.push(Column { unit, shown_as, response, color: [0.0; 3] });
    }

    /// Replaces the light of an emitter. Its color stays.
    pub fn replace(&mut self, emitter: usize, unit: UnitLight) {
        let reflectance = self.radiosity.reflectance(&self.enclosure);
        let response = self.response(&unit, self.columns[emitter].shown_as, &reflectance);
        (self.columns[emitter].unit, self.columns[emitter].response) = (unit, response);
    }

    /// Returns the response of each sample to an emitter.
    fn response(&self, unit: &UnitLight, shown_as: u32, reflectance: &[Color]) -> Vec<Color> {
        let direct: Vec<Color> = unit.receivers.iter().map(|v| [f64::from(*v); 3]).collect();
        let bounced = self.radiosity.bounced(&direct, reflectance);
        let of = |i: usize| {
            let own = if shown_as > 0 && self.samples.emitters[i] == shown_as { 1.0 } else { 0.0 };
            let (reflected, direct) = (self.samples.reflected(i, &bounced), f64::from(unit.samples[i]) / PI);
            [0, 1, 2].map(|c| own + self.samples.diffuse[i][c] * direct + reflected[c])
        };
        (0..self.samples.len()).map(of).collect()
    }

    /// Returns the radiance of a sample under all emitters.
    fn predicted(&self, sample: usize) -> Color {
        let mut sum = [0.0; 3];
        for column in &self.columns {
            [0, 1, 2].iter().for_each(|&c| sum[c] += column.response[sample][c] * column.color[c]);
        }
        sum
    }

    /// Fits the colors of all emitters under the current enclosure.
    pub fn fit_colors(&mut self) {
        for _ in 0..REWEIGHTINGS {
            let weights = self.weights();
            for channel in 0..3 {
                self.least_squares(&weights, channel);
            }
        }
    }

    /// Returns the weight of each sample's deviation of linear values.
    ///
    /// It holds the slope of the display curve and the robust weight. It is 0 for a clipped value whose radiance is at least 1.
    fn weights(&self) -> Vec<Color> {
        let of = |i: usize| {
            let (value, target) = (self.predicted(i), self.targets[i]);
            [0, 1, 2].map(|c| {
                if self.samples.clipped[i][c] && value[c] >= target[c] {
                    return 0.0;
                }
                let slope = slope(target[c]);
                let deviation = slope * (value[c] - target[c]).abs() / ROBUST;
                slope / (1.0 + deviation * deviation).powf(0.25)
            })
        };
        (0..self.samples.len()).into_par_iter().map(of).collect()
    }

    /// Minimizes the weighted squares of a channel over colors of at least 0.
    ///
    /// By coordinate descent on the normal equations.
    fn least_squares(&mut self, weights: &[Color], channel: usize) {
        let n = self.columns.len();
        let squares: Vec<f64> = weights.iter().map(|w| w[channel] * w[channel]).collect();
        let of = |column: &Column| column.response.iter().map(|r| r[channel]).collect::<Vec<f64>>();
        let all: Vec<Vec<f64>> = self.columns.iter().map(of).collect();
        let product = |a: &[f64], b: &[f64]| a.iter().zip(b).zip(&squares).map(|((a, b), w)| a * b * w).sum::<f64>();
        let gram: Vec<Vec<f64>> = all.par_iter().map(|a| all.iter().map(|b| product(a, b)).collect()).collect();
        let targets: Vec<f64> = self.targets.iter().map(|t| t[channel]).collect();
        let right: Vec<f64> = all.iter().map(|a| product(a, &targets)).collect();
        let ridge = 1e-9 * (0..n).map(|i| gram[i][i]).sum::<f64>() / n.max(1) as f64;
        let mut x: Vec<f64> = self.columns.iter().map(|c| c.color[channel]).collect();
        for _ in 0..2000 {
            let mut change: f64 = 0.0;
            for i in 0..n {
                let scale = gram[i][i] + ridge;
                if scale <= 0.0 {
                    continue;
                }
                let slope = right[i] - gram[i].iter().zip(&x).map(|(g, x)| g * x).sum::<f64>();
                let next = (x[i] + slope / scale).max(0.0);
                change = change.max((next - x[i]).abs() * scale.sqrt());
                x[i] = next;
            }
            if change < 1e-9 * right.iter().fold(0.0_f64, |m, r| m.max(r.abs())).sqrt() {
                break;
            }
        }
        self.columns.iter_mut().zip(x).for_each(|(column, x)| column.color[channel] = x);
    }

    /// Takes a damped Gauss-Newton step of the faces' albedo.
    ///
    /// Colors stay; responses are updated.
    pub fn refine_enclosure(&mut self) {
        let receivers = self.radiosity.surfels.len() + self.radiosity.faces.len();
        let mut direct = vec![[0.0; 3]; receivers];
        for column in &self.columns {
            for (sum, v) in direct.iter_mut().zip(&column.unit.receivers) {
                [0, 1, 2].iter().for_each(|&c| sum[c] += column.color[c] * f64::from(*v));
            }
        }
        let bounced =
            |enclosure: &[Color; FACES]| self.radiosity.bounced(&direct, &self.radiosity.reflectance(enclosure));
        let now = bounced(&self.enclosure);
        let slopes: Vec<Vec<Color>> = (0..FACES)
            .map(|face| {
                let mut moved = self.enclosure;
                moved[face] = moved[face].map(|a| a + DIFFERENCE);
                let difference = |(a, b): (&Color, &Color)| [0, 1, 2].map(|c| (a[c] - b[c]) / DIFFERENCE);
                let by: Vec<Color> = bounced(&moved).iter().zip(&now).map(difference).collect();
                (0..self.samples.len()).map(|i| self.samples.reflected(i, &by)).collect()
            })
            .collect();
        let weights = self.weights();
        let predicted: Vec<Color> = (0..self.samples.len()).map(|i| self.predicted(i)).collect();
        for channel in 0..3 {
            let mut gram = [[0.0; FACES]; FACES];
            let mut right = [0.0; FACES];
            for i in (0..self.samples.len()).filter(|i| !self.samples.clipped[*i][channel]) {
                let square = weights[i][channel] * weights[i][channel];
                let deviation = self.targets[i][channel] - predicted[i][channel];
                for a in 0..FACES {
                    let by = square * slopes[a][i][channel];
                    right[a] += by * deviation;
                    (0..FACES).for_each(|b| gram[a][b] += by * slopes[b][i][channel]);
                }
            }
            let prior = PRIOR * self.samples.len() as f64;
            let damping = 0.05 * (0..FACES).map(|a| gram[a][a]).sum::<f64>() / FACES as f64 + 1e-12;
            for a in 0..FACES {
                gram[a][a] += damping + prior;
                right[a] += prior * (self.start[channel] - self.enclosure[a][channel]);
            }
            for (face, change) in self.enclosure.iter_mut().zip(solve(gram, right)) {
                let change = change.clamp(-LARGEST_CHANGE, LARGEST_CHANGE);
                face[channel] = (face[channel] + change).clamp(ALBEDO[0], ALBEDO[1]);
            }
        }
        let reflectance = self.radiosity.reflectance(&self.enclosure);
        let responses: Vec<Vec<Color>> =
            self.columns.iter().map(|c| self.response(&c.unit, c.shown_as, &reflectance)).collect();
        self.columns.iter_mut().zip(responses).for_each(|(column, response)| column.response = response);
    }

    /// Returns the mean squared deviation of display values.
    ///
    /// A clipped value counts only if the radiance is below it.
    pub fn error(&self) -> f64 {
        let of = |i: usize| {
            let (value, target) = (self.predicted(i), self.samples.targets[i]);
            let deviation = |c: usize| f64::from(linear_to_srgb((value[c] as f32).clamp(0.0, 1.0)) - target[c]);
            [0, 1, 2].map(|c| if self.samples.clipped[i][c] { deviation(c).min(0.0) } else { deviation(c) }.powi(2))
        };
        let sum: f64 =
            (0..self.samples.len()).into_par_iter().map(|i| of(i).iter().sum::<f64>()).collect::<Vec<_>>().iter().sum();
        sum / (3.0 * self.samples.len().max(1) as f64)
    }

    /// Returns [`Fitter::error`] as PSNR in dB.
    pub fn psnr(&self) -> f64 {
        -10.0 * self.error().max(1e-12).log10()
    }

    /// Returns the PSNR of the best uniform light: one irradiance everywhere, and emitters that are seen but light nothing.
    pub fn uniform_psnr(&self) -> f64 {
        let all = 0..self.samples.len();
        let reflected = |i: usize| [0, 1, 2].map(|c| (self.samples.diffuse[i][c] + self.samples.specular[i][c]) / PI);
        let shown = |number: u32| move |i: usize| [if self.samples.emitters[i] == number { 1.0 } else { 0.0 }; 3];
        let column = |response: Vec<Color>| Column { response, ..Column::default() };
        let mut columns = vec![column(all.clone().map(reflected).collect())];
        let numbers = self.columns.iter().map(|c| c.shown_as).filter(|number| *number > 0);
        columns.extend(numbers.map(|number| column(all.clone().map(shown(number)).collect())));
        let mut uniform = Fitter { columns, targets: self.targets.clone(), ..*self };
        uniform.fit_colors();
        uniform.psnr()
    }
}

/// Derivative of the display value by the linear value.
fn slope(linear: f64) -> f64 {
    if linear < 0.003_130_8 { 12.92 } else { 1.055 / 2.4 * linear.powf(1.0 / 2.4 - 1.0) }
}

/// Solves a symmetric positive definite system by elimination.
fn solve(mut m: [[f64; FACES]; FACES], mut b: [f64; FACES]) -> [f64; FACES] {
    for i in 0..FACES {
        for j in i + 1..FACES {
            let by = m[j][i] / m[i][i];
            let row = m[i];
            m[j].iter_mut().zip(row).for_each(|(v, r)| *v -= by * r);
            b[j] -= by * b[i];
        }
    }
    for i in (0..FACES).rev() {
        let known: f64 = (i + 1..FACES).map(|j| m[i][j] * b[j]).sum();
        b[i] = (b[i] - known) / m[i][i];
    }
    b
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::radiosity::tests::targets;

    #[test]
    fn colors_and_albedo_of_the_enclosure_are_recovered() {
        let (surfels, rays) = (60, 16);
        let faces: Vec<u8> = (0..120).map(|i| (i % FACES) as u8).collect();
        let receivers = surfels + faces.len();
        let targets = targets(receivers, rays);
        let reflectances: Vec<Color> = (0..surfels).map(|i| [0.3 + 0.4 * (i % 3) as f64 / 2.0; 3]).collect();
        let room = Radiosity { targets: &targets, rays, surfels: &reflectances, faces: &faces, sheen: 0.0 };
        // Each light reaches a third of the receivers. Only bounced light reaches the others, so that a larger albedo and a
        // larger color differ.
        let lit = |k: usize, i: usize| (i + k).is_multiple_of(3);
        let unit = |k: usize, i: usize| if lit(k, i) { ((i * 7 + k * 13) % 11) as f32 / 11.0 } else { 0.0 };
        let light = |k: usize| UnitLight {
            receivers: (0..receivers).map(|i| unit(k, i)).collect(),
            samples: (0..surfels).map(|i| unit(k, i)).collect(),
        };
        let mut samples = Samples {
            targets: vec![[0.0; 3]; surfels],
            clipped: vec![[false; 3]; surfels],
            diffuse: reflectances.clone(),
            specular: vec![[0.04; 3]; surfels],
            neighbors: (0..surfels).flat_map(|i| [i as u32; NEAREST]).collect(),
            weights: vec![1.0 / NEAREST as f32; surfels * NEAREST],
            emitters: vec![0; surfels],
        };
        let (truth, albedo) = ([0.3, 0.0, 0.2], 0.7_f32);
        let of_truth = samples.clone();
        let mut known = Fitter::new(room, &of_truth, [albedo; 3]);
        (0..3).for_each(|k| known.push(light(k), 0));
        known.columns.iter_mut().zip(truth).for_each(|(column, color)| column.color = [color; 3]);
        for i in 0..surfels {
            samples.targets[i] = known.predicted(i).map(|v| linear_to_srgb(v as f32));
        }
        let mut fitter = Fitter::new(room, &samples, [0.6; 3]);
        (0..3).for_each(|k| fitter.push(light(k), 0));
        let rounds = |fitter: &mut Fitter<'_>| {
            for _ in 0..20 {
                fitter.fit_colors();
                fitter.refine_enclosure();
            }
            fitter.fit_colors();
        };
        rounds(&mut fitter);
        assert!(fitter.psnr() > 55.0, "{} {:?}", fitter.psnr(), fitter.colors());
        for (color, truth) in fitter.colors().iter().zip(truth) {
            assert!((f64::from(color[1]) - truth).abs() < 0.02, "{:?}", fitter.colors());
        }
        let mean = fitter.enclosure().iter().map(|f| f[0]).sum::<f32>() / 6.0;
        assert!((mean - albedo).abs() < 0.05, "{:?}", fitter.enclosure());
        // Further rounds come closer, on each face.
        rounds(&mut fitter);
        assert!(fitter.psnr() > 60.0, "{}", fitter.psnr());
        assert!(fitter.enclosure().iter().all(|f| (f[1] - albedo).abs() < 0.05), "{:?}", fitter.enclosure());
    }

    #[test]
    fn clipped_pixels_bound_from_below_only() {
        let targets = targets(7, 4);
        let room =
            Radiosity { targets: &targets, rays: 4, surfels: &[[0.0; 3]], faces: &[0, 1, 2, 3, 4, 5], sheen: 0.0 };
        let light = UnitLight { receivers: vec![0.0; 7], samples: vec![PI as f32, 3.0 * PI as f32] };
        let samples = Samples {
            targets: vec![[linear_to_srgb(0.5); 3], [1.0; 3]],
            clipped: vec![[false; 3], [true; 3]],
            diffuse: vec![[1.0; 3]; 2],
            specular: vec![[0.0; 3]; 2],
            neighbors: vec![0; 2 * NEAREST],
            weights: vec![0.125; 2 * NEAREST],
            emitters: vec![0; 2],
        };
        let mut fitter = Fitter::new(room, &samples, [0.5; 3]);
        fitter.push(light, 0);
        fitter.fit_colors();
        // The clipped pixel has 1.5 there, which its photograph allows.
        assert!((fitter.colors()[0][0] - 0.5).abs() < 1e-3 && fitter.error() < 1e-6, "{:?}", fitter.colors());
    }

    #[test]
    fn sample_that_shows_an_emitter_has_its_radiance() {
        let targets = targets(7, 4);
        let room =
            Radiosity { targets: &targets, rays: 4, surfels: &[[0.0; 3]], faces: &[0, 1, 2, 3, 4, 5], sheen: 0.0 };
        let light = UnitLight { receivers: vec![0.0; 7], samples: vec![0.1, 0.0] };
        let samples = Samples {
            targets: vec![[0.02; 3], [1.0; 3]],
            clipped: vec![[false; 3], [true; 3]],
            diffuse: vec![[0.01; 3]; 2],
            specular: vec![[0.0; 3]; 2],
            neighbors: vec![0; 2 * NEAREST],
            weights: vec![0.125; 2 * NEAREST],
            emitters: vec![0, 1],
        };
        let mut fitter = Fitter::new(room, &samples, [0.5; 3]);
        fitter.push(light.clone(), 1);
        fitter.fit_colors();
        // Its clipped pixel requires at least 1.
        assert!(fitter.colors()[0][0] >= 0.99, "{:?}", fitter.colors());
        fitter.replace(0, UnitLight { samples: vec![0.0; 2], ..light });
        assert!(fitter.predicted(0) == [0.0; 3] && fitter.predicted(1)[0] >= 0.99);
    }
}
