//! Benchmark of `photometric` and `photometric_bwd` against their reference.
//!
//! The loss is checked over the whole view, the gradient in windows. The gradient at a pixel depends on pixels at
//! most ten away, so the slow reference processes windows only.

use super::Context;
use crate::harness::{Rig, add_passes, bytes};
use crate::report::Report;
use sgs_engine::graph::Graph;
use sgs_passes::cost::Counts;
use sgs_passes::loss::{Photometric, loss_sum, photometric, photometric_bwd};
use sgs_passes::reference::photometric as reference;
use sgs_passes::reference::photometric::Shape;
use sgs_passes::reference::rng::Pcg;
use sgs_shaders::structs::{LossStats, Step};

const WEIGHTS: [f32; 2] = [0.8, 0.2];

/// Reach of a pixel's gradient: twice the radius of the SSIM window.
const REACH: usize = 10;

/// Side of the windows in which the gradient is compared, including their margins.
const WINDOW: usize = 72;

/// Measures the forward and backward pass and the sum of the loss.
pub fn both(c: &Context<'_>, report: &mut Report) -> anyhow::Result<()> {
    let [width, height] = c.workload.largest.map(|s| s as usize);
    let shape = Shape { width, height, channels: 3 };
    let (image, targets) = random_image(shape);
    let mut g = Graph::new("photometric");
    let floats = 4 * image.len() as u64;
    let step = g.uniform("step", size_of::<Step>() as u64);
    let (image_buffer, target_buffer) = (g.input("image", floats), g.input("targets", 4 * targets.len() as u64));
    let grad_image = g.external("grad_image", floats);
    let stats = g.external("stats", size_of::<LossStats>() as u64);
    let loss =
        Photometric { step, image: image_buffer, targets: target_buffer, channels: 3, largest: c.workload.largest };
    let partials = photometric(&mut g, c.tuning, &loss)?;
    photometric_bwd(&mut g, c.tuning, &loss, &partials, grad_image)?;
    loss_sum(&mut g, c.tuning, step, (partials.sums, partials.count), None, stats)?;
    let mut values = Step { weight_l1: WEIGHTS[0], weight_dssim: WEIGHTS[1], ..Default::default() };
    values.camera.size = c.workload.largest;
    let inputs = vec![(step, bytes(&[values])), (image_buffer, bytes(&image)), (target_buffer, bytes(&targets))];
    let mut rig = Rig::new(c.device, g, inputs, true)?;
    let (times, _) = rig.measure(c.warmup, c.repeats)?;
    let counts = Counts { pixels: shape.pixels() as f64, ..Default::default() };
    add_passes(report, rig.plan(), &times, &counts, &c.ceiling);

    let found: Vec<f32> = rig.get(grad_image)?;
    let stats: LossStats = rig.get(stats)?[0];
    let n = 3.0 * shape.pixels() as f64;
    let l1 = image.iter().enumerate().map(|(i, &x)| (f64::from(x) - reference::unpack(targets[i / 3], i % 3)).abs());
    let l1 = l1.sum::<f64>() / n;
    anyhow::ensure!((l1 - f64::from(stats.l1)).abs() < 1e-5 * l1, "L1 is {}, but should be {l1}.", stats.l1);
    let mut compared = 0;
    for corner in windows(shape) {
        let worst = compare_window(&image, &targets, &found, shape, corner, &mut compared);
        anyhow::ensure!(worst < 1.0, "The photometric gradient is off by {worst:.2} times its tolerance.");
    }
    report.check(format!("photometric: L1 over all, the gradient at {compared} pixels, are those of the reference"));
    Ok(())
}

/// Returns the upper left corners of windows: at the image's corners, where padding matters, and in its middle.
fn windows(s: Shape) -> Vec<[usize; 2]> {
    let far = [s.width.saturating_sub(WINDOW), s.height.saturating_sub(WINDOW)];
    let mut all = vec![[0, 0], far, [far[0], 0], [far[0] / 2, far[1] / 2]];
    all.dedup();
    all
}

/// Returns the largest error in a window, as a multiple of the tolerance.
fn compare_window(
    image: &[f32],
    targets: &[u32],
    found: &[f32],
    shape: Shape,
    corner: [usize; 2],
    compared: &mut usize,
) -> f64 {
    let size = [WINDOW.min(shape.width), WINDOW.min(shape.height)];
    let part = Shape { width: size[0], height: size[1], channels: 3 };
    let at = |x: usize, y: usize| (corner[1] + y) * shape.width + corner[0] + x;
    let (mut wide, mut packed) = (Vec::new(), Vec::new());
    for y in 0..size[1] {
        for x in 0..size[0] {
            wide.extend(image[3 * at(x, y)..][..3].iter().map(|&v| f64::from(v)));
            packed.push(targets[at(x, y)]);
        }
    }
    let expected = reference::photometric_bwd(&wide, &packed, part, f64::from(WEIGHTS[0]), f64::from(WEIGHTS[1]));
    // The loss is a mean, and the window has fewer pixels.
    let scale = part.pixels() as f64 / shape.pixels() as f64;
    let n = 3.0 * shape.pixels() as f64;
    let clear = |k: usize, axis: usize, whole: usize| {
        let low = corner[axis] == 0 || k >= REACH;
        let high = corner[axis] + size[axis] == whole || k + REACH < size[axis];
        low && high
    };
    let mut worst = 0.0_f64;
    for y in (0..size[1]).filter(|&y| clear(y, 1, shape.height)) {
        for x in (0..size[0]).filter(|&x| clear(x, 0, shape.width)) {
            *compared += 1;
            for c in 0..3 {
                let e = scale * expected[3 * (y * size[0] + x) + c];
                let d = (f64::from(found[3 * at(x, y) + c]) - e).abs() / (2e-4 / n + 2e-4 * e.abs());
                worst = if d.is_nan() { f64::INFINITY } else { worst.max(d) };
            }
        }
    }
    worst
}

/// Returns a photograph with large and small structures, and a similar render.
///
/// Order: render, photograph.
fn random_image(s: Shape) -> (Vec<f32>, Vec<u32>) {
    let mut rng = Pcg::new(8);
    let (mut image, mut targets) = (Vec::new(), Vec::new());
    for p in 0..s.pixels() {
        let (x, y) = ((p % s.width) as f64, (p / s.width) as f64);
        let wave = 0.5 + 0.3 * (0.31 * x).sin() + 0.2 * (0.17 * y + 0.1 * x).cos();
        let byte = |v: f64| (255.0 * v.clamp(0.0, 1.0)) as u32;
        let packed = (0..3).map(|c| byte(wave + 0.1 * rng.uniform()) << (8 * c)).sum::<u32>() | 0xff00_0000;
        targets.push(packed);
        image.extend((0..3).map(|c| (reference::unpack(packed, c) + rng.range(-0.1, 0.1)) as f32));
    }
    (image, targets)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn windowed_gradient_matches_the_whole_and_detects_errors() {
        let shape = Shape { width: 100, height: 90, channels: 3 };
        let (image, targets) = random_image(shape);
        let wide: Vec<f64> = image.iter().map(|&v| f64::from(v)).collect();
        let whole = reference::photometric_bwd(&wide, &targets, shape, f64::from(WEIGHTS[0]), f64::from(WEIGHTS[1]));
        let mut found: Vec<f32> = whole.iter().map(|&v| v as f32).collect();
        let mut compared = 0;
        for corner in windows(shape) {
            assert!(compare_window(&image, &targets, &found, shape, corner, &mut compared) < 1.0);
        }
        assert!(compared > 10_000);
        found[3 * (45 * 100 + 50)] *= 1.01;
        let middle = windows(shape)[3];
        assert!(compare_window(&image, &targets, &found, shape, middle, &mut compared) > 1.0);
    }
}
