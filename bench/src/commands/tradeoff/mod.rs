//! `engine-bench tradeoff`: what each choice that trades accuracy for speed costs and saves, on Gaussians that stay as they
//! are while it is measured.
//!
//! For each choice: time of a training step and of a frame on the device, device memory of a step, error of one picture
//! against the double-precision twin (which follows the definition of 3D Gaussian splatting), and error of the gradient of one
//! step against that of `exact`, which tests hold to finite differences of the twin. Choices are measured in rounds, one
//! after the other in each and in another order each time, so that what drifts on a shared machine meets all of them. A choice stands on the front if
//! nothing else is both faster and closer ([`front`]). Table, drawing and front go by the least time of all rounds: what others do on a
//! shared machine can only add to it.

mod choices;
mod front;
mod intrinsic;
mod lit;
mod plot;

use super::step::{Args as StepArgs, Stage};
use crate::common::{Common, parse_size};
use crate::harness::spans;
use crate::stats::Summary;
use crate::trainer::{Trainer, first_entry_capacity};
use crate::workload::{Priors, Synthetic, Workload, directory, synthetic, twin_camera, twin_gaussians};
use choices::{Choice, choices};
use front::{Standing, noise, standings};
use plot::Mark;
use sgs_engine::Device;
use sgs_passes::Tuning;
use sgs_passes::pipeline::Renderer;
use sgs_passes::reference::blend::render;
use sgs_passes::scene::{GaussianData, Gaussians, Group};
use sgs_passes::splat::{BackwardKernel, Channels};
use sgs_scene::Splats;
use sgs_train::gaussian_data;
use std::fmt::Write;
use std::path::PathBuf;

/// Options of the command.
#[derive(clap::Args, Clone, Debug)]
pub struct Args {
    /// A scene directory in place of the synthetic room.
    #[arg(long, value_name = "DIR", conflicts_with_all = ["gaussians", "size"])]
    pub scene: Option<PathBuf>,
    /// Whose choices.
    #[arg(long, value_enum, default_value = "geometry")]
    pub stage: Stage,
    /// Settings of the intrinsic stage that choices differ from, a TOML file as config.toml of a run.
    #[arg(long, value_name = "FILE.toml")]
    pub config: Option<PathBuf>,
    /// Steps of the intrinsic stage after which each choice is measured at the test views; not measured without.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub quality: Option<u32>,
    /// Trained Gaussians of the scene; without them its points, or those of the room, are trained first.
    #[arg(long, value_name = "FILE.ply", requires = "scene")]
    pub geometry: Option<PathBuf>,
    /// Steps of training before anything is measured, where no Gaussians are given.
    #[arg(long, value_name = "N", default_value_t = 100)]
    pub train: u32,
    /// Gaussians of the synthetic room; 20000 on a processor, 1000000 elsewhere.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(100..=50_000_000))]
    pub gaussians: Option<u32>,
    /// Size of its views; 320x240 on a processor, 1920x1080 elsewhere.
    #[arg(long, value_name = "WxH", value_parser = parse_size)]
    pub size: Option<[u32; 2]>,
    /// Only choices with this in their name, and `exact`.
    #[arg(long, value_name = "S")]
    pub filter: Option<String>,
    /// Rounds through all choices, with --repeats steps and frames of each.
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..))]
    pub rounds: u32,
    /// Draw time against error.
    #[arg(long, value_name = "FILE.svg")]
    pub svg: Option<PathBuf>,
    /// Write the table in Markdown.
    #[arg(long, value_name = "FILE.md")]
    pub table: Option<PathBuf>,
}

impl Args {
    /// Whether a choice is measured; `exact` always is.
    fn wants(&self, choice: &str) -> bool {
        choice == "exact" || self.filter.as_ref().is_none_or(|f| choice.contains(f.as_str()))
    }
}

/// What is known of one choice.
#[derive(Clone, Debug)]
pub struct Point {
    /// Its name.
    pub name: String,
    /// The setting that makes it.
    pub setting: String,
    /// Milliseconds of a step on the device.
    pub step: Summary,
    /// Milliseconds of a frame on the device.
    pub frame: Summary,
    /// Device memory of a trainer, bytes.
    pub bytes: u64,
    /// Of one picture, largest and mean.
    pub largest: f64,
    /// Mean of the absolute differences.
    pub mean: f64,
    /// Decibels of the picture.
    pub psnr: f64,
    /// Length of the difference of gradients over that of the exact one, the worst of all groups.
    pub gradient: f64,
    /// Whether anything is both faster and closer.
    pub standing: Standing,
}

impl From<&Point> for Mark {
    fn from(p: &Point) -> Mark {
        Mark { name: p.name.clone(), time: p.step.least, error: p.mean, front: p.standing == Standing::Front }
    }
}

/// Runs the command.
///
/// # Errors
/// If the device fails, a file cannot be read or written, or `exact` is not.
pub fn run(common: &Common, a: &Args) -> anyhow::Result<()> {
    if a.stage == Stage::Intrinsic {
        return intrinsic::run(common, a);
    }
    anyhow::ensure!(
        a.quality.is_none() && a.config.is_none(),
        "--quality and --config are for --stage intrinsic; bench/accuracy-quality trains geometry with each level of accuracy."
    );
    let device = common.open_device()?;
    let mut report = common.report("tradeoff", &device);
    let mut workload = workload(&device, a)?;
    report.setting("scene", workload.name.clone());
    report.setting("size", format!("{}x{}", workload.largest[0], workload.largest[1]));
    report.setting("rounds", a.rounds);
    if a.geometry.is_none() {
        let capacity = first_entry_capacity(workload.start.len());
        let mut trainer = Trainer::new(&device, &workload, BackwardKernel::Pixel, capacity)?;
        trainer.run(a.train.max(1))?;
        workload.start = trainer.gaussians.download(&device)?;
        report.setting("trained", a.train);
    }
    report.setting("gaussians", workload.start.len());
    let (points, noise) = measure(common, a, &device, &workload)?;
    for p in &points {
        report.time(&format!("step, {}", p.name), "ms", p.step);
        report.time(&format!("frame, {}", p.name), "ms", p.frame);
        for (what, value) in [("largest error", p.largest), ("mean error", p.mean), ("gradient error", p.gradient)] {
            report.time(&format!("{what}, {}", p.name), "", Summary::of(&[value]));
        }
        report.fact(&format!("picture, {}, dB", p.name), p.psnr);
        report.fact(&format!("device memory of training, {}, MB", p.name), p.bytes as f64 / 1e6);
    }
    let front: Vec<&str> = points.iter().filter(|p| p.standing == Standing::Front).map(|p| p.name.as_str()).collect();
    report.fact("on the front", front.join(", "));
    report.fact("times differ by themselves, %", 100.0 * noise);
    report.check("the exact picture agrees with double precision");
    let table = table(&points);
    if let Some(path) = &a.table {
        sgs_scene::atomic_write(path, |f| std::io::Write::write_all(f, table.as_bytes()))?;
    }
    if let Some(path) = &a.svg {
        let title = format!("{}, {} Gaussians, {}", workload.name, workload.start.len(), device.info().name);
        let text = plot::svg(&points.iter().map(Mark::from).collect::<Vec<_>>(), &title, "mean error of a picture")?;
        sgs_scene::atomic_write(path, |f| std::io::Write::write_all(f, text.as_bytes()))?;
    }
    if common.json.as_deref().is_none_or(|p| p.as_os_str() != "-") {
        println!("{table}");
    }
    common.finish(&report, &device)
}

fn workload(device: &Device, a: &Args) -> anyhow::Result<Workload> {
    let Some(path) = &a.scene else {
        let (gaussians, size) = StepArgs::sizes(device, a.gaussians, a.size);
        return synthetic(device, &Synthetic { gaussians, size, normals: false, densify: false, sh_degree: 3 });
    };
    let mut workload = directory(device, path, Priors::default(), false, 3)?;
    if let Some(file) = &a.geometry {
        let splats = Splats::read_ply(file)?;
        workload.start = gaussian_data(&splats, workload.model);
    }
    Ok(workload)
}

/// One choice, ready to be timed.
struct Subject<'w> {
    /// What is known of it so far.
    point: Point,
    trainer: Trainer<'w>,
    renderer: Renderer,
    steps: Vec<f64>,
    frames: Vec<f64>,
}

fn measure(common: &Common, a: &Args, device: &Device, workload: &Workload) -> anyhow::Result<(Vec<Point>, f64)> {
    let all = choices(Tuning::for_device(device.info()));
    let wanted = |c: &Choice| a.wants(&c.name) && c.backward.runs_on(device.info());
    let gaussians = Gaussians::new(device, workload.model, workload.start.len() as u32, false)?;
    gaussians.upload(device, &workload.start)?;
    let (degree, background) = (workload.model.sh_degree, workload.settings.geometry.background);
    let camera = workload.views[0].0;
    let truth = render(
        &twin_gaussians(&workload.start),
        &twin_camera(&camera),
        degree as usize,
        false,
        background.map(f64::from),
    );
    let mut subjects = Vec::new();
    let mut exact: Option<GaussianData> = None;
    for choice in all.into_iter().filter(wanted) {
        let before = device.memory_use().0;
        let capacity = first_entry_capacity(workload.start.len());
        let mut trainer = Trainer::with(device, workload, choice.tuning, choice.backward, choice.dense_adam, capacity)?;
        let gradient = trainer.gradients(&workload.start)?;
        trainer.gaussians.upload(device, &workload.start)?;
        // Every view once, so that none finds too little room later.
        trainer.run(common.warmup.max(workload.views.len() as u32))?;
        trainer.set_timestamps(true)?;
        let bytes = device.memory_use().0 - before;
        let mut renderer = Renderer::new(device, choice.tuning, &gaussians, workload.largest, Channels::default())?;
        let picture = renderer.render(&gaussians, &camera, degree, background)?;
        let (largest, mean, psnr) = differences(&picture.image, &truth.image);
        if choice.name == "exact" {
            anyhow::ensure!(psnr > 55.0, "The exact picture is {psnr:.1} dB off double precision.");
        }
        let gradient_error = exact.as_ref().map_or(0.0, |e| difference(e, &gradient));
        exact.get_or_insert(gradient);
        let point = Point {
            name: choice.name,
            setting: choice.setting,
            step: Summary::default(),
            frame: Summary::default(),
            bytes,
            largest,
            mean,
            psnr,
            gradient: gradient_error,
            standing: Standing::default(),
        };
        subjects.push(Subject { point, trainer, renderer, steps: Vec::new(), frames: Vec::new() });
    }
    // Every round begins elsewhere, every other one runs backwards: whoever is first in a round is often slower.
    let count = subjects.len();
    for round in 0..a.rounds as usize {
        for i in 0..count {
            let i = (i + round / 2 * 5) % count;
            let s = &mut subjects[if round % 2 == 0 { i } else { count - 1 - i }];
            s.trainer.gaussians.upload(device, &workload.start)?;
            s.trainer.run(2)?;
            let run = s.trainer.run(common.repeats)?;
            s.steps.extend(spans(&run.times));
            s.renderer.executor().take_times();
            for i in 0..common.repeats as usize {
                let (camera, _) = workload.views[i % workload.views.len()];
                s.renderer.render(&gaussians, &camera, degree, background)?;
            }
            s.frames.extend(spans(&s.renderer.executor().take_times()));
        }
    }
    let noise = noise(subjects.iter().map(|s| s.steps.as_slice()));
    let mut points = Vec::new();
    for s in subjects {
        let (step, frame) = (Summary::of(&s.steps).scaled(1e-6), Summary::of(&s.frames).scaled(1e-6));
        anyhow::ensure!(step.samples > 0, "The device has no timestamps.");
        points.push(Point { step, frame, ..s.point });
    }
    mark(&mut points, noise);
    Ok((points, noise))
}

/// Largest and mean difference, and decibels, of all pixels.
fn differences(image: &[f32], truth: &[f64]) -> (f64, f64, f64) {
    let differences = image.iter().zip(truth).map(|(a, b)| (f64::from(*a) - b).abs());
    let (mut largest, mut sum, mut square) = (0.0_f64, 0.0, 0.0);
    for d in differences {
        largest = largest.max(d);
        sum += d;
        square += d * d;
    }
    let n = truth.len().max(1) as f64;
    (largest, sum / n, -10.0 * (square / n).max(1e-30).log10())
}

/// Relative difference of gradients, the worst of all groups.
fn difference(exact: &GaussianData, other: &GaussianData) -> f64 {
    Group::ALL.into_iter().fold(0.0, |worst: f64, g| {
        let (a, b) = (exact.group(g), other.group(g));
        let square = |f: &dyn Fn((&f32, &f32)) -> f64| a.iter().zip(b).map(f).sum::<f64>();
        let size = square(&|(x, _)| f64::from(*x).powi(2));
        if size == 0.0 {
            return worst;
        }
        worst.max((square(&|(x, y)| (f64::from(*x) - f64::from(*y)).powi(2)) / size).sqrt())
    })
}

fn mark(points: &mut [Point], noise: f64) {
    let all: Vec<(f64, f64)> = points.iter().map(|p| (p.step.least, p.mean)).collect();
    points.iter_mut().zip(standings(&all, noise)).for_each(|(p, standing)| p.standing = standing);
}

fn table(points: &[Point]) -> String {
    let mut out = String::from(
        "| choice | setting | step, of exact | frame, of exact | memory, of exact | largest error | mean error | picture, dB | gradient error | front |\n|---|---|---|---|---|---|---|---|---|---|\n",
    );
    let Some(exact) = points.first() else { return out };
    for p in points {
        let _ = writeln!(
            out,
            "| {} | {} | {:.3} | {:.3} | {:.3} | {:.1e} | {:.1e} | {:.1} | {:.1e} | {} |",
            p.name,
            p.setting,
            p.step.least / exact.step.least,
            p.frame.least / exact.frame.least,
            p.bytes as f64 / exact.bytes as f64,
            p.largest,
            p.mean,
            p.psnr,
            p.gradient,
            p.standing
        );
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point(name: &str, ms: f64, mean: f64) -> Point {
        Point {
            name: name.to_owned(),
            setting: String::new(),
            step: Summary::of(&[ms]),
            frame: Summary::of(&[ms]),
            bytes: 1,
            largest: mean,
            mean,
            psnr: 0.0,
            gradient: 0.0,
            standing: Standing::default(),
        }
    }

    #[test]
    fn gradients_differ_by_their_worst_group() {
        let mut a = GaussianData::default();
        a.groups[Group::Means as usize] = vec![3.0, 4.0];
        a.groups[Group::Sh0 as usize] = vec![1.0];
        let mut b = a.clone();
        assert_eq!(difference(&a, &b), 0.0);
        b.groups[Group::Means as usize] = vec![3.0, 4.5];
        assert!((difference(&a, &b) - 0.1).abs() < 1e-12);
    }

    #[test]
    fn the_picture_of_the_front_is_drawn() {
        let mut points = [point("exact", 10.0, 0.0), point("fast", 5.0, 1e-2)];
        mark(&mut points, 0.01);
        let marks: Vec<Mark> = points.iter().map(Mark::from).collect();
        let text = plot::svg(&marks, "a title", "errors").unwrap();
        assert!(text.starts_with("<svg") && text.contains("fast") && text.contains("a title"));
        roxmltree::Document::parse(&text).unwrap();
    }
}
