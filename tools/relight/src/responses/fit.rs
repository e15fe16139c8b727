//! Weighted least squares of colors per Gaussian against images: conjugate gradients with a diagonal preconditioner.
//!
//! Images are linear in the colors, with the blending weights of the renderer. Errors of a light count by the slopes of the
//! display encoding in images that visitors see it in, so that the fit minimizes the error of display values: with all lights
//! of the run, without the brightest other light, and alone. A dim light is seen in darker images than a bright one, where
//! small errors show. So each light has weights of its own.

use super::direction;
use glam::DVec3;
use rayon::prelude::*;
use sgs_passes::pipeline::WeightColumns;
use sgs_run::harmonics::{CONSTANT, basis};
use sgs_scene::linear_to_srgb;
use std::ops::Range;

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

/// Numbers of weights of lights that are solved together.
const TOGETHER_WEIGHTS: usize = 128_000_000;

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
}

/// Linear values at a pixel of images in which a light shows.
#[derive(Clone, Copy, Debug)]
pub(super) struct Shown {
    /// With all lights of the run.
    all: f32,
    /// Without the other light that is the brightest at the pixel.
    darker: f32,
    /// Of the light alone.
    alone: f32,
}

/// Returns the squared slope of the display encoding; relative errors count above white.
fn squared_slope(light: f32) -> f32 {
    let v = light.clamp(0.003_130_8, 1.0);
    let slope = (1.055 / 2.4) * v.powf(1.0 / 2.4 - 1.0) / light.max(1.0);
    slope * slope
}

/// Returns the mean squared slope of the images that show a light.
fn mean_of_images(shown: Shown) -> f32 {
    (squared_slope(shown.all) + squared_slope(shown.darker) + squared_slope(shown.alone)) / 3.0
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
    /// Creates a view.
    pub(super) fn new(
        means: &[[f32; 3]],
        from: DVec3,
        columns: &WeightColumns,
        coverage: &[f32],
        targets: Vec<Vec<f32>>,
    ) -> FitView {
        let mut view = FitView {
            gaussians: Vec::new(),
            starts: vec![0],
            pixels: Vec::new(),
            weights: Vec::new(),
            harmonics: Vec::new(),
            targets,
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

    /// Returns the numbers of an image.
    fn numbers(&self) -> usize {
        self.targets.first().map_or(0, Vec::len)
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
        let mut image = vec![0.0; self.numbers() / 3 * columns];
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
    /// The image and its squared weights are `[pixel][column]`.
    fn back(&self, mut image: Vec<f32>, squares: &[f32], terms: usize, columns: usize, out: &mut [f32]) {
        image.iter_mut().zip(squares).for_each(|(v, square)| *v *= square);
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
    fn targets(&self, lights: Range<usize>) -> Vec<f32> {
        let columns = 3 * lights.len();
        let mut all = vec![0.0; self.numbers() / 3 * columns];
        for (l, target) in self.targets[lights].iter().enumerate() {
            for (row, pixel) in all.chunks_exact_mut(columns).zip(target.chunks_exact(3)) {
                row[3 * l..3 * l + 3].copy_from_slice(pixel);
            }
        }
        all
    }

    /// Returns the squared weights of some lights as `[pixel][column]`. `shares`: color of each light in the run.
    fn squares(&self, lights: Range<usize>, shares: &[[f32; 3]], weigh: fn(Shown) -> f32) -> Vec<f32> {
        let columns = 3 * lights.len();
        let mut squares = vec![0.0; self.numbers() / 3 * columns];
        let mut values = vec![0.0; shares.len()];
        for i in 0..self.numbers() {
            let (pixel, c) = (i / 3, i % 3);
            values.iter_mut().zip(&self.targets).zip(shares).for_each(|((v, t), share)| *v = share[c] * t[i]);
            let total: f32 = values.iter().sum();
            // The brightest light at the pixel, and the brightest other one.
            let mut most = [(usize::MAX, 0.0_f32); 2];
            for (l, &v) in values.iter().enumerate() {
                if v > most[0].1 {
                    most = [(l, v), most[0]];
                } else if v > most[1].1 {
                    most[1] = (l, v);
                }
            }
            for l in lights.clone() {
                // A light that is off in the run is switched on beside the others.
                let off = shares[l] == [0.0; 3];
                let alone = if off { self.targets[l][i] } else { values[l] };
                let all = if off { total + alone } else { total };
                let other = if most[0].0 == l { most[1].1 } else { most[0].1 };
                let shown = Shown { all, darker: all - other, alone };
                squares[pixel * columns + 3 * (l - lights.start) + c] = weigh(shown);
            }
        }
        squares
    }
}

/// Lights that are solved together.
struct Group {
    lights: Range<usize>,
    /// Squared weights of each view, `[pixel][column]`.
    squares: Vec<Vec<f32>>,
    /// Diagonal of the normal equations, `[Gaussian][term][column]`.
    diagonal: Vec<f32>,
    /// Weighted blended albedo, `[Gaussian][column]`.
    reflected: Vec<f32>,
}

/// Views and unknowns of a fit.
pub(super) struct Fit {
    albedo: Vec<[f32; 3]>,
    views: Vec<FitView>,
    /// Functions per Gaussian.
    terms: usize,
    /// Color of each light in the run; 0 if it is off.
    shares: Vec<[f32; 3]>,
    /// Squared weight of the error of a light at a pixel.
    weigh: fn(Shown) -> f32,
}

impl Fit {
    pub(super) fn new(albedo: Vec<[f32; 3]>, views: Vec<FitView>, terms: usize, shares: Vec<[f32; 3]>) -> Fit {
        Fit { albedo, views, terms, shares, weigh: mean_of_images }
    }

    /// Returns the number of views.
    pub(super) fn views(&self) -> usize {
        self.views.len()
    }

    /// Sums what all views add to numbers, in a fixed order.
    fn sum(&self, numbers: usize, add: impl Fn(usize, &FitView, &mut [f32]) + Sync) -> Vec<f32> {
        let part = |part: usize| {
            let mut out = vec![0.0; numbers];
            self.views.iter().enumerate().skip(part).step_by(PARTS).for_each(|(v, view)| add(v, view, &mut out));
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
    pub(super) fn solve(&self, mut on_report: impl FnMut(usize)) -> Vec<Vec<f32>> {
        let lights = self.shares.len();
        let each = 3 * self.terms * self.albedo.len();
        let weights: usize = self.views.iter().map(FitView::numbers).sum();
        let together = (TOGETHER / each.max(1)).min(TOGETHER_WEIGHTS / weights.max(1)).clamp(1, lights.max(1));
        let mut found = Vec::new();
        for first in (0..lights).step_by(together) {
            let group = self.group(first..(first + together).min(lights));
            let columns = 3 * group.lights.len();
            let x = self.solve_group(&group);
            for l in 0..group.lights.len() {
                found.push(x.chunks_exact(columns).flat_map(|row| row[3 * l..3 * l + 3].iter().copied()).collect());
            }
            on_report(group.lights.end);
        }
        found
    }

    /// Weighs the errors of some lights.
    fn group(&self, lights: Range<usize>) -> Group {
        let (terms, columns) = (self.terms, 3 * lights.len());
        let squares = |view: &FitView| view.squares(lights.clone(), &self.shares, self.weigh);
        let squares: Vec<Vec<f32>> = self.views.par_iter().map(squares).collect();
        let diagonal = self.sum(columns * terms * self.albedo.len(), |v, view, out| {
            let mut sum = vec![0.0; columns];
            view.each(|at, i, pixels, weights| {
                sum.fill(0.0);
                for (pixel, weight) in pixels.iter().zip(weights) {
                    let row = &squares[v][*pixel as usize * columns..][..columns];
                    sum.iter_mut().zip(row).for_each(|(s, square)| *s += weight * weight * square);
                }
                for k in 0..terms {
                    let row = &mut out[(i * terms + k) * columns..][..columns];
                    row.iter_mut().zip(&sum).for_each(|(o, s)| *o += view.harmonics[at][k].powi(2) * s);
                }
            });
        });
        // As colors of band 0, whose harmonic is a constant.
        let plain: Vec<f32> = self.albedo.iter().flatten().map(|v| v / CONSTANT as f32).collect();
        let reflected = self.sum(columns * self.albedo.len(), |v, view, out| {
            let image = view.project(&plain, 1, 3);
            let image = image.chunks_exact(3).flat_map(|pixel| pixel.iter().copied().cycle().take(columns)).collect();
            view.back(image, &squares[v], 1, columns, out);
        });
        Group { lights, squares, diagonal, reflected }
    }

    /// Returns colors of the albedo under the mean light of each Gaussian.
    fn start(&self, group: &Group) -> Vec<f32> {
        let columns = 3 * group.lights.len();
        let received = self.sum(columns * self.albedo.len(), |v, view, out| {
            view.back(view.targets(group.lights.clone()), &group.squares[v], 1, columns, out);
        });
        // Gaussians that hardly show take the mean light of all.
        let mut mean = vec![[0.0_f64; 2]; columns];
        for (row, reflected) in received.chunks_exact(columns).zip(group.reflected.chunks_exact(columns)) {
            for c in 0..columns {
                mean[c][0] += f64::from(row[c]);
                mean[c][1] += f64::from(reflected[c]);
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
                    / (f64::from(group.reflected[i * columns + c]) + faint).max(1e-30);
                x[i * self.terms * columns + c] = (own * f64::from(albedo[c % 3]) / CONSTANT) as f32;
            }
        }
        x
    }

    /// Solves the normal equations of some lights.
    fn solve_group(&self, group: &Group) -> Vec<f32> {
        let (terms, columns) = (self.terms, 3 * group.lights.len());
        let Group { diagonal, squares, .. } = group;
        // What counts as faint follows from the weights of each light.
        let numbers = (diagonal.len() / columns * 3).max(1) as f32;
        let of_light = |l: usize| diagonal.chunks_exact(columns).flat_map(|row| &row[3 * l..3 * l + 3]).sum::<f32>();
        let mean: Vec<f32> = (0..group.lights.len()).map(|l| of_light(l) / numbers).collect();
        // Weight of the distance from the start, and the diagonal with it.
        let damping: Vec<f32> = (0..diagonal.len())
            .map(|n| {
                let (row, c) = (n / columns, n % columns);
                let flat = diagonal[row / terms * terms * columns + c];
                (DAMPING[usize::from(row % terms > 0)] * flat + FAINT * mean[c / 3]).max(1e-20)
            })
            .collect();
        let mut x = self.start(group);
        let mut rest = self.sum(x.len(), |v, view, out| {
            let mut image = view.targets(group.lights.clone());
            image.iter_mut().zip(view.project(&x, terms, columns)).for_each(|(t, v)| *t -= v);
            view.back(image, &squares[v], terms, columns, out);
        });
        let scaled = |rest: &[f32]| -> Vec<f32> {
            rest.iter().zip(diagonal).zip(&damping).map(|((r, d), damping)| r / (d + damping)).collect()
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
            let mut product = self.sum(x.len(), |v, view, out| {
                view.back(view.project(&toward, terms, columns), &squares[v], terms, columns, out);
            });
            product.iter_mut().zip(&toward).zip(&damping).for_each(|((p, t), damping)| *p += damping * t);
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

    /// Returns the mean PSNR of display values under the lights of the run.
    pub(super) fn psnr(&self, values: &[Vec<f32>]) -> f64 {
        self.psnr_under(values, &self.shares)
    }

    /// Returns the lowest mean PSNR of display values with one light of the run off; `None` if fewer than two are on.
    pub(super) fn psnr_one_off(&self, values: &[Vec<f32>]) -> Option<f64> {
        let on: Vec<usize> = (0..self.shares.len()).filter(|l| self.shares[*l] != [0.0; 3]).collect();
        if on.len() < 2 {
            return None;
        }
        let without = |l: usize| {
            let mut shares = self.shares.clone();
            shares[l] = [0.0; 3];
            self.psnr_under(values, &shares)
        };
        on.into_iter().map(without).min_by(f64::total_cmp)
    }

    fn psnr_under(&self, values: &[Vec<f32>], shares: &[[f32; 3]]) -> f64 {
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
            FitView::new(&means, DVec3::ZERO, &columns, &[1.0; 2], vec![image])
        };
        Fit::new(vec![[0.5; 3]; 3], vec![view([0.9, 0.5, 0.4]), view([0.6, 0.2, 0.7])], 1, vec![[1.0; 3]])
    }

    #[test]
    fn colors_that_explain_the_images_are_found() {
        let truth = [[0.8, 0.2, 0.01], [0.1, 0.5, 2.0]];
        let fit = fit(&truth);
        let found = fit.solve(|_| ()).remove(0);
        for (i, color) in truth.iter().enumerate() {
            for c in 0..3 {
                let shown = found[3 * i + c] * CONSTANT as f32;
                assert!((shown - color[c]).abs() < 0.01 * color[c].max(0.1), "{shown} {}", color[c]);
            }
        }
        assert!(fit.psnr(std::slice::from_ref(&found)) > 50.0);
        assert_eq!(fit.psnr_one_off(std::slice::from_ref(&found)), None);
        // A wrong color is noticed.
        let wrong: Vec<f32> = found.iter().map(|v| 1.2 * v).collect();
        assert!(fit.psnr(&[wrong]) < 30.0);
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
        let squares = view.squares(0..1, &fit.shares, fit.weigh);
        view.back(image.to_vec(), &squares, 1, 3, &mut out);
        let one: f32 = ahead.iter().zip(&image).zip(&squares).map(|((a, b), s)| a * b * s).sum();
        let two: f32 = x.iter().zip(&out).map(|(a, b)| a * b).sum();
        assert!((one - two).abs() < 1e-5 * one.abs().max(1.0), "{one} {two}");
    }

    /// Weighs errors by what visitors see: the images with a light, not the light itself.
    #[test]
    fn weights_follow_the_images_that_show_a_light() {
        let means = [[0.0, 0.0, 1.0]];
        let columns = WeightColumns { starts: vec![0, 1], pixels: vec![0], weights: vec![1.0] };
        let images = [0.5, 0.25, 0.125, 4.0].map(|v| vec![v; 3]).to_vec();
        let view = FitView::new(&means, DVec3::ZERO, &columns, &[1.0], images);
        // The last light is off.
        let shares = [[1.0; 3], [1.0; 3], [2.0, 2.0, 4.0], [0.0; 3]];
        let of = |weigh: fn(Shown) -> f32| view.squares(0..4, &shares, weigh);
        assert_eq!(of(|s| s.all), [1.0, 1.0, 1.25, 1.0, 1.0, 1.25, 1.0, 1.0, 1.25, 5.0, 5.0, 5.25]);
        assert_eq!(of(|s| s.alone), [0.5, 0.5, 0.5, 0.25, 0.25, 0.25, 0.25, 0.25, 0.5, 4.0, 4.0, 4.0]);
        assert_eq!(of(|s| s.darker), [0.75, 0.75, 0.75, 0.5, 0.5, 0.75, 0.5, 0.5, 0.75, 4.5, 4.5, 4.75]);
        // A part of the lights has the same weights.
        assert_eq!(view.squares(1..3, &shares, |s| s.darker), of(|s| s.darker)[3..9]);
    }

    /// Compares with weights by the image under all lights.
    ///
    /// There, a dim light is seen beside a bright one.
    #[test]
    fn dim_lights_are_exact_with_the_bright_light_off() {
        // Wide overlapping Gaussians cannot follow every pixel.
        let (pixels, gaussians) = (240, 24);
        let weight = |i: usize, p: usize| {
            let away = (p as f32 + 0.5) / pixels as f32 - (i as f32 + 0.5) / gaussians as f32;
            (-0.5 * (away * 30.0).powi(2)).exp()
        };
        let means: Vec<[f32; 3]> = (0..gaussians).map(|i| [i as f32, 0.0, 9.0]).collect();
        let mut columns = WeightColumns { starts: vec![0], pixels: Vec::new(), weights: Vec::new() };
        for i in 0..gaussians {
            for p in (0..pixels).filter(|p| weight(i, *p) > 1e-3) {
                columns.pixels.push(p as u32);
                columns.weights.push(weight(i, p) / (0..gaussians).map(|k| weight(k, p)).sum::<f32>());
            }
            columns.starts.push(columns.pixels.len() as u32);
        }
        // The bright light has an edge of a shadow, and the dim one has one beside it. No Gaussian follows either.
        let bright = |p: usize| if p < 120 { 0.8 } else { 0.002 };
        let dim = |p: usize| if p < 125 { 0.01 } else { 0.06 };
        let image = |of: &dyn Fn(usize) -> f32| (0..pixels).flat_map(|p| [of(p); 3]).collect::<Vec<f32>>();
        let fit = |weigh: fn(Shown) -> f32| {
            let images = vec![image(&bright), image(&dim)];
            let view = FitView::new(&means, DVec3::ZERO, &columns, &vec![1.0; pixels], images);
            let fit = Fit { weigh, ..Fit::new(vec![[0.5; 3]; gaussians], vec![view], 1, vec![[1.0; 3]; 2]) };
            let found = fit.solve(|_| ());
            assert!(fit.psnr_one_off(&found).unwrap() <= fit.psnr_under(&found, &[[0.0; 3], [1.0; 3]]));
            (fit.psnr(&found), fit.psnr_under(&found, &[[0.0; 3], [1.0; 3]]))
        };
        let (before, after) = (fit(|shown| squared_slope(shown.all)), fit(mean_of_images));
        println!("all lights: {:.2} dB, before {:.2} dB", after.0, before.0);
        println!("bright light off: {:.2} dB, before {:.2} dB", after.1, before.1);
        assert!(after.1 > before.1 + 4.0 && after.0 > before.0 - 1.2, "{before:?} {after:?}");
    }
}
