//! Growth of a step's time and memory with Gaussians and pixels: `engine-bench scaling`.

use super::step::Args as StepArgs;
use crate::common::{Common, parse_size};
use crate::harness::spans;
use crate::report::Report;
use crate::stats::Summary;
use crate::trainer::{Trainer, first_entry_capacity};
use crate::workload::{Synthetic, synthetic};
use sgs_engine::Device;
use sgs_passes::splat::BackwardKernel;

/// Options of the command.
#[derive(clap::Args, Clone, Debug)]
pub struct Args {
    /// Number of Gaussians in the middle of the range; 20000 on a CPU, 1000000 elsewhere.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(400..=12_500_000))]
    pub gaussians: Option<u32>,
    /// View size in the middle of the range; 320x240 on a CPU, 1920x1080 elsewhere.
    #[arg(long, value_name = "WxH", value_parser = parse_size)]
    pub size: Option<[u32; 2]>,
    /// Include normals and depth, their losses, and normal priors.
    #[arg(long)]
    pub normals: bool,
}

/// Measurement at one size.
#[derive(Clone, Copy)]
struct Point {
    gaussians: f64,
    pixels: f64,
    milliseconds: f64,
    bytes: f64,
}

/// Runs the command.
///
/// # Errors
/// If the device fails, or training goes wrong.
pub fn run(common: &Common, a: &Args) -> anyhow::Result<()> {
    let device = common.open_device()?;
    let mut report = common.report("scaling", &device);
    let (gaussians, size) = StepArgs::sizes(&device, a.gaussians, a.size);
    report.setting("gaussians", gaussians);
    report.setting("size", format!("{}x{}", size[0], size[1]));
    report.setting("normals", a.normals);
    let room = |gaussians: u32, size: [u32; 2]| Synthetic {
        gaussians,
        size,
        normals: a.normals,
        densify: false,
        sh_degree: 3,
    };
    let mut by_gaussians = Vec::new();
    for n in [gaussians / 4, gaussians / 2, gaussians, 2 * gaussians] {
        by_gaussians.push(point(common, &device, &mut report, &room(n, size))?);
    }
    let mut by_pixels = Vec::new();
    for percent in [50, 71, 141, 200] {
        let size = size.map(|s| (s * percent / 100).max(8));
        by_pixels.push(point(common, &device, &mut report, &room(gaussians, size))?);
    }
    by_pixels.push(by_gaussians[2]);
    let slope = |points: &[Point], x: &dyn Fn(&Point) -> f64, y: &dyn Fn(&Point) -> f64| {
        line(&points.iter().map(|p| (x(p), y(p))).collect::<Vec<_>>())
    };
    let (n, p) = (|q: &Point| q.gaussians, |q: &Point| q.pixels);
    let (t, b) = (|q: &Point| q.milliseconds, |q: &Point| q.bytes);
    let rows = [
        ("1000 further Gaussians: us", slope(&by_gaussians, &n, &t) * 1e6),
        ("a further Gaussian: bytes", slope(&by_gaussians, &n, &b)),
        ("1000 further pixels: us", slope(&by_pixels, &p, &t) * 1e6),
        ("a further pixel: bytes, photographs left out", slope(&by_pixels, &p, &b)),
    ];
    for (name, value) in rows {
        report.fact(name, value);
    }
    report.check("at every size losses and gradients were finite and nothing overflowed");
    common.finish(&report, &device)
}

/// Trains at one size.
fn point(common: &Common, device: &Device, report: &mut Report, room: &Synthetic) -> anyhow::Result<Point> {
    let workload = synthetic(device, room)?;
    let photographs = workload.targets.bytes() + workload.normals.as_ref().map_or(0, |n| n.bytes());
    let capacity = first_entry_capacity(workload.start.len());
    let mut trainer = Trainer::new(device, &workload, BackwardKernel::Pixel, capacity)?;
    trainer.run(common.warmup.max(workload.views.len() as u32))?;
    let plain = trainer.run(common.repeats)?;
    trainer.set_timestamps(true)?;
    trainer.run(1)?;
    let timed = trainer.run(common.repeats)?;
    let bytes = plain.memory[1].0 - photographs;
    let name = format!("{} Gaussians, {}x{}", room.gaussians, room.size[0], room.size[1]);
    let mut samples = spans(&timed.times);
    if samples.is_empty() {
        samples = plain.wall.iter().map(|ms| ms * 1e6).collect();
    }
    let step = Summary::of(&samples).scaled(1e-6);
    report.time(&format!("step, {name}"), "ms", step);
    report.value(&format!("step by the host's clock, {name}"), "ms", Summary::of(&plain.wall));
    report.fact(&format!("device memory but photographs, {name}, MB"), bytes as f64 / 1e6);
    Ok(Point {
        gaussians: f64::from(room.gaussians),
        pixels: f64::from(room.size[0]) * f64::from(room.size[1]),
        milliseconds: step.median,
        bytes: bytes as f64,
    })
}

/// Returns the slope of the least-squares line.
fn line(points: &[(f64, f64)]) -> f64 {
    let n = points.len().max(1) as f64;
    let mean = |f: &dyn Fn(&(f64, f64)) -> f64| points.iter().map(f).sum::<f64>() / n;
    let (x, y) = (mean(&|p| p.0), mean(&|p| p.1));
    let across: f64 = points.iter().map(|p| (p.0 - x).powi(2)).sum();
    points.iter().map(|p| (p.0 - x) * (p.1 - y)).sum::<f64>() / across.max(f64::MIN_POSITIVE)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slope_of_a_noisy_line_is_recovered() {
        let noisy: Vec<_> = (0..100).map(|i| (f64::from(i), 3.0 * f64::from(i) + f64::from(i % 2))).collect();
        assert!((line(&noisy) - 3.0).abs() < 1e-2);
        assert_eq!(line(&[(1.0, 1.0)]), 0.0);
    }
}
