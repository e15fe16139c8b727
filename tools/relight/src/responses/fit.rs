//! Weighted least squares of colors per Gaussian against images: conjugate gradients with a diagonal preconditioner.
//!
//! Images are linear in the colors, with the blending weights of the renderer. Errors count by the slope of the display encoding
//! under the lights of the run, so that the fit minimizes the error of display values.

use super::direction;
use glam::DVec3;
use rayon::prelude::*;
use sgs_passes::pipeline::WeightColumns;
use sgs_run::harmonics::{CONSTANT, basis};
use sgs_scene::linear_to_srgb;

/// Number of iterations.
const ITERATIONS: usize = 24;

/// Weights of the distance from the start over the diagonal, by band.
const DAMPING: [f32; 2] = [1e-3, 3e-2];

/// Weight of that distance over the mean of the diagonal.
///
/// It keeps Gaussians that hardly show at their start.
const FAINT: f32 = 1e-4;

/// Numbers of unknowns that are solved together.
const TOGETHER: usize = 16_000_000;

/// Parts of the views whose sums are added in a fixed order.
const PARTS: usize = 2;

/// View of the fit: a sparse matrix by Gaussian, and images.
pub(super) struct FitView {
    /// Gaussians that show.
    gaussians: Vec<u32>,
    /// Index of the first pair of each, then the number of pairs.
    starts: Vec<u32>,
    pixels: Vec<u32>,
    weights: Vec<f32>,
    /// First four harmonics in the direction of each Gaussian that shows.
    harmonics: Vec<[f32; 4]>,
    /// Linear images of each light.
    targets: Vec<Vec<f32>>,
    /// Squared weight of each number of an image.
    squares: Vec<f32>,
}

/// Returns the slope of the display encoding; relative errors count above white.
fn slope(light: f32) -> f32 {
    let v = light.clamp(0.003_130_8, 1.0);
    (1.055 / 2.4) * v.powf(1.0 / 2.4 - 1.0) / light.max(1.0)
}

/// Adds images by shares per channel.
fn mixed(images: &[Vec<f32>], shares: &[[f32; 3]]) -> Vec<f32> {
    let mut sum = vec![0.0; images.first().map_or(0, Vec::len)];
    for (image, share) in images.iter().zip(shares) {
        sum.iter_mut().zip(image).enumerate().for_each(|(i, (s, v))| *s += share[i % 3] * v);
    }
    sum
}

impl FitView {
    /// Creates a view. `shares`: color of each light in the run.
    pub(super) fn new(
        means: &[[f32; 3]],
        from: DVec3,
        columns: &WeightColumns,
        coverage: &[f32],
        targets: Vec<Vec<f32>>,
        shares: &[[f32; 3]],
    ) -> FitView {
        let squares = mixed(&targets, shares).into_iter().map(|v| slope(v).powi(2)).collect();
        let mut view = FitView {
            gaussians: Vec::new(),
            starts: vec![0],
            pixels: Vec::new(),
            weights: Vec::new(),
            harmonics: Vec::new(),
            targets,
            squares,
        };
        for (i, mean) in means.iter().enumerate() {
            for (pixel, weight) in columns.of(i) {
                view.pixels.push(pixel as u32);
                // The weights of a surface are over the opacity of the pixel.
                view.weights.push(weight * coverage[pixel]);
            }
            if view.pixels.len() as u32 > view.starts[view.starts.len() - 1] {
                view.gaussians.push(i as u32);
                view.starts.push(view.pixels.len() as u32);
                let values = basis(direction(mean, from));
                view.harmonics.push([0, 1, 2, 3].map(|k| values[k] as f32));
            }
        }
        view
    }

    /// Returns the number of pairs of pixel and Gaussian.
    pub(super) fn pairs(&self) -> usize {
        self.pixels.len()
    }

    /// Calls `each` with the place in the view, the Gaussian, its pixels and weights.
    fn each(&self, mut each: impl FnMut(usize, usize, &[u32], &[f32])) {
        for (at, &i) in self.gaussians.iter().enumerate() {
            let range = self.starts[at] as usize..self.starts[at + 1] as usize;
            each(at, i as usize, &self.pixels[range.clone()], &self.weights[range]);
        }
    }

    /// Returns the images of colors: `[pixel][column]`.
    fn project(&self, x: &[f32], terms: usize, columns: usize) -> Vec<f32> {
        let mut image = vec![0.0; self.squares.len() / 3 * columns];
        let mut color = vec![0.0; columns];
        self.each(|at, i, pixels, weights| {
            color.fill(0.0);
            for k in 0..terms {
                let row = &x[(i * terms + k) * columns..][..columns];
                color.iter_mut().zip(row).for_each(|(c, v)| *c += self.harmonics[at][k] * v);
            }
            for (pixel, weight) in pixels.iter().zip(weights) {
                let row = &mut image[*pixel as usize * columns..][..columns];
                row.iter_mut().zip(&color).for_each(|(v, c)| *v += weight * c);
            }
        });
        image
    }

    /// Adds the transposed product of a weighted image to `out`.
    ///
    /// The image is `[pixel][column]`.
    fn back(&self, mut image: Vec<f32>, terms: usize, columns: usize, out: &mut [f32]) {
        for (row, squares) in image.chunks_exact_mut(columns).zip(self.squares.chunks_exact(3)) {
            row.iter_mut().enumerate().for_each(|(c, v)| *v *= squares[c % 3]);
        }
        let mut sum = vec![0.0; columns];
        self.each(|at, i, pixels, weights| {
            sum.fill(0.0);
            for (pixel, weight) in pixels.iter().zip(weights) {
                let row = &image[*pixel as usize * columns..][..columns];
                sum.iter_mut().zip(row).for_each(|(s, v)| *s += weight * v);
            }
            for k in 0..terms {
                let row = &mut out[(i * terms + k) * columns..][..columns];
                row.iter_mut().zip(&sum).for_each(|(o, s)| *o += self.harmonics[at][k] * s);
            }
        });
    }

    /// Returns the images of some lights as `[pixel][column]`.
    fn targets(&self, lights: std::ops::Range<usize>) -> Vec<f32> {
        let columns = 3 * lights.len();
        let mut all = vec![0.0; self.squares.len() / 3 * columns];
        for (l, target) in self.targets[lights].iter().enumerate() {
            for (row, pixel) in all.chunks_exact_mut(columns).zip(target.chunks_exact(3)) {
                row[3 * l..3 * l + 3].copy_from_slice(pixel);
            }
        }
        all
    }
}

/// Views and unknowns of a fit.
pub(super) struct Fit {
    albedo: Vec<[f32; 3]>,
    views: Vec<FitView>,
    /// Functions per Gaussian.
    terms: usize,
    /// Diagonal of the normal equations, `[Gaussian][term][channel]`.
    diagonal: Vec<f32>,
    /// Weighted blended albedo, `[Gaussian][channel]`.
    reflected: Vec<f32>,
}

impl Fit {
    pub(super) fn new(albedo: Vec<[f32; 3]>, views: Vec<FitView>, terms: usize) -> Fit {
        let mut fit = Fit { albedo, views, terms, diagonal: Vec::new(), reflected: Vec::new() };
        let numbers = 3 * terms * fit.albedo.len();
        fit.diagonal = fit.sum(numbers, |view, out| {
            view.each(|at, i, pixels, weights| {
                let mut sum = [0.0; 3];
                for (pixel, weight) in pixels.iter().zip(weights) {
                    let squares = &view.squares[3 * *pixel as usize..][..3];
                    (0..3).for_each(|c| sum[c] += weight * weight * squares[c]);
                }
                for k in 0..terms {
                    (0..3).for_each(|c| out[3 * (i * terms + k) + c] += view.harmonics[at][k].powi(2) * sum[c]);
                }
            });
        });
        // As colors of band 0, whose harmonic is a constant.
        let plain: Vec<f32> = fit.albedo.iter().flatten().map(|v| v / CONSTANT as f32).collect();
        fit.reflected = fit.sum(3 * fit.albedo.len(), |view, out| {
            view.back(view.project(&plain, 1, 3), 1, 3, out);
        });
        fit
    }

    /// Returns the number of views.
    pub(super) fn views(&self) -> usize {
        self.views.len()
    }

    /// Sums what all views add to numbers, in a fixed order.
    fn sum(&self, numbers: usize, add: impl Fn(&FitView, &mut [f32]) + Sync) -> Vec<f32> {
        let part = |part: usize| {
            let mut out = vec![0.0; numbers];
            self.views.iter().skip(part).step_by(PARTS).for_each(|view| add(view, &mut out));
            out
        };
        let mut parts: Vec<Vec<f32>> = (0..PARTS).into_par_iter().map(part).collect();
        let mut all = parts.pop().unwrap_or_default();
        for part in parts {
            all.iter_mut().zip(part).for_each(|(a, v)| *a += v);
        }
        all
    }

    /// Returns the colors of all lights. Calls `on_report` with the number of finished lights.
    pub(super) fn solve(&self, lights: usize, mut on_report: impl FnMut(usize)) -> Vec<Vec<f32>> {
        let each = 3 * self.terms * self.albedo.len();
        let together = (TOGETHER / each.max(1)).clamp(1, lights.max(1));
        let mut found = Vec::new();
        for first in (0..lights).step_by(together) {
            let range = first..(first + together).min(lights);
            let columns = 3 * range.len();
            let x = self.solve_some(range.clone());
            for l in 0..range.len() {
                found.push(x.chunks_exact(columns).flat_map(|row| row[3 * l..3 * l + 3].iter().copied()).collect());
            }
            on_report(range.end);
        }
        found
    }

    /// Returns colors of the albedo under the mean light of each Gaussian.
    fn start(&self, lights: std::ops::Range<usize>) -> Vec<f32> {
        let columns = 3 * lights.len();
        let received = self.sum(columns * self.albedo.len(), |view, out| {
            view.back(view.targets(lights.clone()), 1, columns, out);
        });
        // Gaussians that hardly show take the mean light of all.
        let mut mean = vec![[0.0_f64; 2]; columns];
        for (row, reflected) in received.chunks_exact(columns).zip(self.reflected.chunks_exact(3)) {
            for c in 0..columns {
                mean[c][0] += f64::from(row[c]);
                mean[c][1] += f64::from(reflected[c % 3]);
            }
        }
        let count = self.albedo.len().max(1) as f64;
        let mut x = vec![0.0; self.terms * received.len()];
        for (i, albedo) in self.albedo.iter().enumerate() {
            for c in 0..columns {
                let [light, reflected] = mean[c];
                let faint = 1e-3 * reflected / count;
                let all = light / reflected.max(1e-30);
                let own = (f64::from(received[i * columns + c]) + faint * all)
                    / (f64::from(self.reflected[3 * i + c % 3]) + faint).max(1e-30);
                x[i * self.terms * columns + c] = (own * f64::from(albedo[c % 3]) / CONSTANT) as f32;
            }
        }
        x
    }

    /// Solves the normal equations of some lights.
    fn solve_some(&self, lights: std::ops::Range<usize>) -> Vec<f32> {
        let (terms, columns) = (self.terms, 3 * lights.len());
        let mean = self.diagonal.iter().sum::<f32>() / self.diagonal.len().max(1) as f32;
        // Weight of the distance from the start, and the diagonal with it, by row and channel.
        let damping: Vec<f32> = (0..self.diagonal.len())
            .map(|n| {
                let (row, c) = (n / 3, n % 3);
                let flat = self.diagonal[3 * (row / terms * terms) + c];
                (DAMPING[usize::from(row % terms > 0)] * flat + FAINT * mean).max(1e-20)
            })
            .collect();
        let at = |n: usize| n / columns * 3 + n % columns % 3;
        let mut x = self.start(lights.clone());
        let mut rest = self.sum(x.len(), |view, out| {
            let mut image = view.targets(lights.clone());
            image.iter_mut().zip(view.project(&x, terms, columns)).for_each(|(t, v)| *t -= v);
            view.back(image, terms, columns, out);
        });
        let scaled = |rest: &[f32]| -> Vec<f32> {
            rest.iter().enumerate().map(|(n, r)| r / (self.diagonal[at(n)] + damping[at(n)])).collect()
        };
        let dots = |a: &[f32], b: &[f32]| {
            let mut sums = vec![0.0_f64; columns];
            for (a, b) in a.chunks_exact(columns).zip(b.chunks_exact(columns)) {
                (0..columns).for_each(|c| sums[c] += f64::from(a[c]) * f64::from(b[c]));
            }
            sums
        };
        let mut toward = scaled(&rest);
        let mut before = dots(&rest, &toward);
        for _ in 0..ITERATIONS {
            let mut product = self.sum(x.len(), |view, out| {
                view.back(view.project(&toward, terms, columns), terms, columns, out);
            });
            product.iter_mut().zip(&toward).enumerate().for_each(|(n, (p, t))| *p += damping[at(n)] * t);
            let curved = dots(&toward, &product);
            let ratio = |a: f64, b: f64| if b > 0.0 { (a / b) as f32 } else { 0.0 };
            let step: Vec<f32> = before.iter().zip(&curved).map(|(a, b)| ratio(*a, *b)).collect();
            for n in 0..x.len() {
                x[n] += step[n % columns] * toward[n];
                rest[n] -= step[n % columns] * product[n];
            }
            let next = scaled(&rest);
            let after = dots(&rest, &next);
            let keep: Vec<f32> = after.iter().zip(&before).map(|(a, b)| ratio(*a, *b)).collect();
            toward.iter_mut().zip(next).enumerate().for_each(|(n, (t, z))| *t = z + keep[n % columns] * *t);
            before = after;
        }
        x
    }

    /// Returns the mean PSNR of display values under lights of these colors.
    pub(super) fn psnr(&self, values: &[Vec<f32>], shares: &[[f32; 3]]) -> f64 {
        let total = mixed(values, shares);
        let psnr = |view: &FitView| {
            let (ours, theirs) = (view.project(&total, self.terms, 3), mixed(&view.targets, shares));
            let shown = |v: f32| f64::from(linear_to_srgb(v.clamp(0.0, 1.0)));
            let square: f64 = ours.iter().zip(&theirs).map(|(a, b)| (shown(*a) - shown(*b)).powi(2)).sum();
            -10.0 * (square / ours.len().max(1) as f64).max(1e-12).log10()
        };
        let all: Vec<f64> = self.views.par_iter().map(psnr).collect();
        all.iter().sum::<f64>() / all.len().max(1) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two Gaussians over two pixels in front of a camera, seen twice.
    fn fit(truth: &[[f32; 3]; 2]) -> Fit {
        let means = [[0.0, 0.0, 1.0], [0.0, 0.0, 2.0], [9.0, 9.0, 9.0]];
        let view = |weights: [f32; 3]| {
            let columns = WeightColumns { starts: vec![0, 2, 3, 3], pixels: vec![0, 1, 1], weights: weights.to_vec() };
            let pixel = |a: f32, b: f32| [0, 1, 2].map(|c| a * truth[0][c] + b * truth[1][c]);
            let image = [pixel(weights[0], 0.0), pixel(weights[1], weights[2])].concat();
            FitView::new(&means, DVec3::ZERO, &columns, &[1.0; 2], vec![image], &[[1.0; 3]])
        };
        Fit::new(vec![[0.5; 3]; 3], vec![view([0.9, 0.5, 0.4]), view([0.6, 0.2, 0.7])], 1)
    }

    #[test]
    fn colors_that_explain_the_images_are_found() {
        let truth = [[0.8, 0.2, 0.01], [0.1, 0.5, 2.0]];
        let fit = fit(&truth);
        let found = fit.solve(1, |_| ()).remove(0);
        for (i, color) in truth.iter().enumerate() {
            for c in 0..3 {
                let shown = found[3 * i + c] * CONSTANT as f32;
                assert!((shown - color[c]).abs() < 0.01 * color[c].max(0.1), "{shown} {}", color[c]);
            }
        }
        assert!(fit.psnr(std::slice::from_ref(&found), &[[1.0; 3]]) > 50.0);
        // A wrong color is noticed.
        let wrong: Vec<f32> = found.iter().map(|v| 1.2 * v).collect();
        assert!(fit.psnr(&[wrong], &[[1.0; 3]]) < 30.0);
        // A Gaussian that no view shows takes the mean light.
        assert!(found[6..9].iter().all(|v| *v > 0.0 && v.is_finite()));
    }

    #[test]
    fn transposed_product_is_that_of_the_projection() {
        let fit = fit(&[[0.3; 3], [0.6; 3]]);
        let view = &fit.views[0];
        let (x, image) = ([0.4, -1.0, 2.0, 0.3, 0.9, -0.2, 0.0, 0.0, 0.0], [0.2, 0.7, -0.5, 1.5, 0.1, 0.6]);
        let ahead = view.project(&x, 1, 3);
        let mut out = vec![0.0; 9];
        view.back(image.to_vec(), 1, 3, &mut out);
        let one: f32 = ahead.iter().zip(&image).zip(&view.squares).map(|((a, b), s)| a * b * s).sum();
        let two: f32 = x.iter().zip(&out).map(|(a, b)| a * b).sum();
        assert!((one - two).abs() < 1e-5 * one.abs().max(1.0), "{one} {two}");
    }
}
