//! Choices of the geometry stage.
//!
//! The Gaussians stay fixed during the measurement. Measured for each choice: device time of a training step and of a
//! frame, device memory of a step, image error, and gradient error. The image (with features as further channels, if
//! any) is compared with the double-precision reference, which follows the definition of 3D Gaussian splatting. The
//! gradient of one step is compared with that of `exact`, which tests check against finite differences of the
//! reference.

use super::again::Figures;
use super::choices::{Choice, of_geometry};
use super::error::{self, finite};
use super::front::{Place, Ratio, Standing, standings};
use super::plot::Mark;
use super::quality::{self, Quality};
use super::record::record;
use super::{Args, Presentation, StepArgs};
use crate::common::Common;
use crate::harness::spans;
use crate::report::{Report, standing};
use crate::stats::Summary;
use crate::trainer::{Trainer, first_entry_capacity};
use crate::workload::{Priors, Synthetic, Workload, directory, reference_camera, reference_gaussians, synthetic};
use anyhow::Context;
use sgs_config::{Backward, Settings};
use sgs_engine::Device;
use sgs_passes::Tuning;
use sgs_passes::pipeline::{RenderedImage, Renderer};
use sgs_passes::reference::blend::render;
use sgs_passes::scene::{GaussianData, Gaussians, Group};
use sgs_passes::splat::{BackwardKernel, Channels};
use sgs_run::gaussian_data;
use sgs_scene::{Scene, Splats};
use std::fmt::Write;
use std::sync::Arc;

/// Measurements of one choice.
#[derive(Clone, Debug)]
pub struct Point {
    /// Choice that was measured.
    pub choice: Choice,
    /// Milliseconds of a step on the device.
    pub step: Summary,
    /// Milliseconds of a frame on the device.
    pub frame: Summary,
    /// Ratios of step and frame to those of `exact`.
    pub of_exact: [Ratio; 2],
    /// Device memory of a trainer in bytes.
    pub bytes: u64,
    /// Largest absolute image error.
    pub largest: f64,
    /// Mean absolute image error.
    pub mean: f64,
    /// PSNR of the image, dB.
    pub psnr: f64,
    /// Largest relative gradient error over all parameter groups.
    pub gradient: f64,
    /// Standing among all choices.
    pub standing: Standing,
    /// Quality after training with the choice.
    pub quality: Option<Quality>,
}

impl From<&Point> for Mark {
    fn from(p: &Point) -> Mark {
        Mark { name: p.choice.name.clone(), time: p.of_exact[0].value, error: p.mean, standing: p.standing }
    }
}

/// Runs the command for the geometry stage.
///
/// # Errors
/// As for all stages.
pub fn run(common: &Common, a: &Args) -> anyhow::Result<()> {
    let device = common.open_device()?;
    let mut report = common.report("tradeoff", &device);
    let mut workload = workload(&device, a)?;
    report.setting("scene", workload.name.clone());
    report.setting("size", format!("{}x{}", workload.largest[0], workload.largest[1]));
    report.setting("semantics", a.semantics);
    record(&mut report, a, &workload.settings)?;
    if a.geometry.is_none() {
        let capacity = first_entry_capacity(workload.start.len());
        let mut trainer = Trainer::new(&device, &workload, BackwardKernel::Pixel, capacity)?;
        trainer.run(a.train.max(1))?;
        workload.start = trainer.gaussians.download(&device)?;
        report.setting("trained", a.train);
    }
    report.setting("gaussians", workload.start.len());
    let points = measure(common, a, &device, &workload)?;
    if let Some(steps) = a.quality {
        report.fact("steps of a training of its own", steps);
    }
    put(&mut report, &points);
    report.check("the exact image agrees with double precision");
    presentation(&report, &points).leave(common, a)?;
    common.finish(&report, &device)
}

/// Writes the measurements of the choices to a report.
fn put(report: &mut Report, points: &[Point]) {
    for p in points {
        let name = &p.choice.name;
        for (what, time, of_exact) in [("step", p.step, p.of_exact[0]), ("frame", p.frame, p.of_exact[1])] {
            report.choice(what, name, time, of_exact.into());
        }
        for (what, value) in [("largest error", p.largest), ("mean error", p.mean), ("gradient error", p.gradient)] {
            report.time(&format!("{what}, {name}"), "", Summary::of(&[value]));
        }
        report.fact(&format!("image, {name}, dB"), p.psnr);
        report.time(&format!("device memory of training, {name}"), "MB", Summary::of(&[p.bytes as f64 / 1e6]));
        report.fact(&format!("{}{name}", standing::PREFIX), p.standing.label());
        if let Some(q) = p.quality {
            report.fact(&format!("images after training, {name}, dB"), q.psnr);
            if let Some(degrees) = q.normals {
                report.fact(&format!("normals after training, {name}, degrees"), degrees);
            }
        }
    }
    let front: Vec<&str> =
        points.iter().filter(|p| p.standing == Standing::Front).map(|p| p.choice.name.as_str()).collect();
    report.fact("on the front", front.join(", "));
}

/// Restores measurements from a report and ranks them by the current rules.
///
/// # Errors
/// If the report lacks a figure.
pub fn again(report: &Report, choices: Vec<Choice>) -> anyhow::Result<Vec<Point>> {
    let point = |choice: Choice| -> anyhow::Result<Point> {
        let of = Figures { report, choice: &choice.name };
        let normals = || of.fact("normals after training", "degrees");
        let quality = |psnr| Quality { psnr, normals: normals() };
        Ok(Point {
            step: of.summary("step")?,
            frame: of.summary("frame")?,
            of_exact: [of.ratio("step")?, of.ratio("frame")?],
            bytes: of.bytes()?,
            largest: of.number("largest error")?,
            mean: of.number("mean error")?,
            psnr: of.fact("image", "dB").context("An image has no PSNR.")?,
            gradient: of.number("gradient error")?,
            standing: Standing::default(),
            quality: of.fact("images after training", "dB").map(quality),
            choice,
        })
    };
    let mut points = choices.into_iter().map(point).collect::<anyhow::Result<Vec<_>>>()?;
    mark(&mut points);
    Ok(points)
}

/// Builds the presentation of a report.
pub fn presentation(report: &Report, points: &[Point]) -> Presentation {
    let setting = |name| report.setting_text(name).unwrap_or_default();
    Presentation {
        table: table(points),
        marks: points.iter().map(Mark::from).collect(),
        title: format!("{}, {} Gaussians, {}", setting("scene"), setting("gaussians"), report.device.name),
        errors: "mean error of an image",
    }
}

fn workload(device: &Device, a: &Args) -> anyhow::Result<Workload> {
    let Some(path) = &a.scene else {
        let (gaussians, size) = StepArgs::sizes(device, a.gaussians, a.size);
        return synthetic(device, &Synthetic { gaussians, size, normals: false, densify: false, sh_degree: 3 });
    };
    let priors = Priors { semantics: a.semantics, ..Priors::default() };
    let mut workload = directory(device, path, priors, false, 3)?;
    if let Some(file) = &a.geometry {
        let splats = Splats::read_ply(file)?;
        anyhow::ensure!(
            !a.semantics || splats.semantic.is_some(),
            "\"{}\" has no semantic features: without --geometry some are trained first.",
            file.display()
        );
        workload.start = gaussian_data(&splats, workload.model);
    }
    Ok(workload)
}

/// Returns the settings that choices of the geometry stage differ from.
///
/// The backward kernel is fixed. Automatic selection could give each choice another kernel.
fn base_settings() -> Settings {
    let mut base = Settings::default();
    base.geometry.backward = Backward::Pixel;
    base
}

fn kernel(backward: Backward) -> BackwardKernel {
    match backward {
        Backward::Auto | Backward::Pixel => BackwardKernel::Pixel,
        Backward::Splat => BackwardKernel::Splat,
        Backward::Bucket => BackwardKernel::Bucket,
        Backward::Atomic => BackwardKernel::Atomic,
    }
}

/// Choice that is ready to be timed.
struct Subject<'w> {
    /// Measurements of the choice.
    point: Point,
    trainer: Trainer<'w>,
    renderer: Renderer,
    /// Times of steps and of frames. `ratios`: ratio to `exact` in each round.
    times: [Vec<f64>; 2],
    ratios: [Vec<f64>; 2],
}

impl Subject<'_> {
    /// Times some steps and as many frames; returns the sum of each.
    fn take(
        &mut self,
        device: &Device,
        workload: &Workload,
        gaussians: &Gaussians,
        steps: u32,
    ) -> anyhow::Result<[f64; 2]> {
        let (degree, background) = (workload.model.sh_degree, workload.settings.geometry.background);
        self.trainer.gaussians.upload(device, &workload.start)?;
        self.trainer.run(2)?;
        let trained = spans(&self.trainer.run(steps)?.times);
        self.renderer.executor().take_times();
        for i in 0..steps as usize {
            let (camera, _) = workload.views[i % workload.views.len()];
            self.renderer.render(gaussians, &camera, degree, background)?;
        }
        let all = [trained, spans(&self.renderer.executor().take_times())];
        let sums = [all[0].iter().sum(), all[1].iter().sum()];
        self.times.iter_mut().zip(all).for_each(|(times, taken)| times.extend(taken));
        Ok(sums)
    }
}

fn measure(common: &Common, a: &Args, device: &Device, workload: &Workload) -> anyhow::Result<Vec<Point>> {
    let base = base_settings();
    let gaussians = Gaussians::new(device, workload.model, workload.start.len() as u32, false)?;
    gaussians.upload(device, &workload.start)?;
    let (degree, background) = (workload.model.sh_degree, workload.settings.geometry.background);
    let camera = workload.views[0].0;
    let truth = render(
        &reference_gaussians(&workload.start),
        &reference_camera(&camera),
        degree as usize,
        false,
        background.map(f64::from),
    );
    // All choices share one decoder, which every step updates. Gradients must be those of the initial decoder.
    let decoder = match workload.semantics.as_deref() {
        Some((_, decoder)) => Some((decoder, decoder.download(device)?)),
        None => None,
    };
    let mut subjects = Vec::new();
    let mut exact: Option<GaussianData> = None;
    for choice in of_geometry(&Tuning::for_device(device.info()))? {
        let settings = choice.settings(&base)?;
        let (tuning, backward) = (settings.tuning(device.info()), kernel(settings.geometry.backward));
        if !a.wants(&choice.name) || !backward.runs_on(device.info()) {
            continue;
        }
        let before = device.memory_use().0;
        let capacity = first_entry_capacity(workload.start.len());
        let dense_adam = settings.geometry.dense_adam;
        let mut trainer = Trainer::with(device, workload, tuning, backward, dense_adam, capacity)?;
        if let Some((decoder, parameters)) = &decoder {
            decoder.upload(device, parameters)?;
        }
        let gradient = trainer.gradients(&workload.start)?;
        trainer.gaussians.upload(device, &workload.start)?;
        // Every view once, so that no later step grows the entry capacity.
        trainer.run(common.warmup.max(workload.views.len() as u32))?;
        trainer.set_timestamps(true)?;
        let bytes = device.memory_use().0 - before;
        let channels = Channels::default();
        let mut renderer = Renderer::with_features(device, tuning, &gaussians, workload.largest, channels)?;
        let rendered = renderer.render(&gaussians, &camera, degree, background)?;
        let image = with_features(device, &renderer, rendered)?;
        let e =
            error::image_error(&image, &truth.image).with_context(|| format!("The image of \"{}\"", choice.name))?;
        if choice.name == "exact" {
            anyhow::ensure!(e.psnr > 55.0, "The exact image is {:.1} dB off double precision.", e.psnr);
        }
        let mean = finite(&choice.name, "mean error", e.mean)?;
        let off = match &exact {
            Some(exact) => difference(exact, &gradient),
            None => difference(&gradient, &gradient),
        };
        let off = off.with_context(|| format!("The gradient of \"{}\"", choice.name))?;
        let gradient_error = choice.checked_gradient(finite(&choice.name, "gradient error", off)?)?;
        exact.get_or_insert(gradient);
        let point = Point {
            choice,
            step: Summary::default(),
            frame: Summary::default(),
            of_exact: [Ratio::EXACT; 2],
            bytes,
            largest: e.largest,
            mean,
            psnr: e.psnr,
            gradient: gradient_error,
            standing: Standing::default(),
            quality: None,
        };
        subjects.push(Subject { point, trainer, renderer, times: Default::default(), ratios: Default::default() });
    }
    // Each round starts at another choice, and every other round runs backwards. `exact` is measured between all
    // others. The number of steps is a multiple of the number of views, so that all choices see the same views.
    let steps = common.repeats.next_multiple_of(workload.views.len().max(1) as u32);
    let (exact, others) = subjects.split_at_mut(1);
    let count = others.len();
    for round in 0..a.rounds as usize {
        let mut before = exact[0].take(device, workload, &gaussians, steps)?;
        for i in 0..count {
            let i = (i + round / 2 * 5) % count;
            let s = &mut others[if round % 2 == 0 { i } else { count - 1 - i }];
            let own = s.take(device, workload, &gaussians, steps)?;
            let after = exact[0].take(device, workload, &gaussians, steps)?;
            for k in 0..2 {
                s.ratios[k].push(2.0 * own[k] / (before[k] + after[k]));
            }
            before = after;
        }
    }
    let mut points = Vec::new();
    for (i, s) in subjects.into_iter().enumerate() {
        let [step, frame] = s.times.map(|times| Summary::of(&times).scaled(1e-6));
        anyhow::ensure!(step.samples > 0, "The device has no timestamps.");
        let of_exact = if i == 0 { [Ratio::EXACT; 2] } else { s.ratios.map(|rounds| Ratio::of(&rounds)) };
        for (what, ratio) in ["time of a step", "time of a frame"].into_iter().zip(of_exact) {
            finite(&s.point.choice.name, what, ratio.value + ratio.off)?;
        }
        points.push(Point { step, frame, of_exact, ..s.point });
    }
    mark(&mut points);
    if let (Some(steps), Some(path)) = (a.quality, &a.scene) {
        let scene = Arc::new(Scene::open(path, &workload.settings.scene_options())?);
        for point in &mut points {
            let trained = quality::trained(device, &scene, &point.choice.settings(&base)?, steps, a.semantics)?;
            finite(&point.choice.name, "error after training", trained.psnr + trained.normals.unwrap_or(0.0))?;
            point.quality = Some(trained);
        }
    }
    Ok(points)
}

/// Returns the channels of the reference: colors, then features if any.
fn with_features(device: &Device, renderer: &Renderer, rendered: RenderedImage) -> anyhow::Result<Vec<f32>> {
    let Some(buffer) = renderer.features() else { return Ok(rendered.image) };
    let wide = Group::Semantics.width() as usize;
    let pixels = rendered.image.chunks_exact(rendered.channels as usize);
    let features = device.download_as::<f32>(buffer, wide * pixels.len())?;
    Ok(pixels.zip(features.chunks_exact(wide)).flat_map(|(color, own)| color.iter().chain(own)).copied().collect())
}

/// Returns the largest relative gradient error over all groups.
fn difference(exact: &GaussianData, other: &GaussianData) -> anyhow::Result<f64> {
    let mut worst = 0.0_f64;
    for g in Group::ALL {
        worst = worst.max(error::of_gradient(exact.group(g), other.group(g))?);
    }
    Ok(worst)
}

fn mark(points: &mut [Point]) {
    let place = |p: &Point| Place { kind: p.choice.kind, time: p.of_exact[0], error: p.mean };
    let all: Vec<Place> = points.iter().map(place).collect();
    points.iter_mut().zip(standings(&all)).for_each(|(p, standing)| p.standing = standing);
}

fn table(points: &[Point]) -> String {
    let trained = points.iter().any(|p| p.quality.is_some());
    let mut heads = vec![
        "choice",
        "setting",
        "step, of exact",
        "frame, of exact",
        "memory, of exact",
        "largest error",
        "mean error",
        "image, dB",
        "gradient error",
        "front",
    ];
    if trained {
        heads.extend(["images after training, dB", "normals, °"]);
    }
    let mut out = format!("| {} |\n|{}\n", heads.join(" | "), "---|".repeat(heads.len()));
    let Some(exact) = points.first() else { return out };
    for p in points {
        let mut cells = vec![
            p.choice.name.clone(),
            p.choice.setting.clone(),
            p.of_exact[0].to_string(),
            p.of_exact[1].to_string(),
            format!("{:.3}", p.bytes as f64 / exact.bytes as f64),
            format!("{:.1e}", p.largest),
            format!("{:.1e}", p.mean),
            format!("{:.1}", p.psnr),
            format!("{:.1e}", p.gradient),
            p.standing.to_string(),
        ];
        if trained {
            let cell = |v: Option<f64>| v.map_or(String::new(), |v| format!("{v:.2}"));
            cells.push(cell(p.quality.map(|q| q.psnr)));
            cells.push(cell(p.quality.and_then(|q| q.normals)));
        }
        let _ = writeln!(out, "| {} |", cells.join(" | "));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::super::again::{assert_round_trip, report};
    use super::super::choices::Kind;
    use super::super::plot;
    use super::*;

    fn point(name: &str, ms: f64, mean: f64) -> Point {
        Point {
            choice: Choice::new(name, &[], Kind::Accuracy).unwrap(),
            step: Summary::of(&[ms]),
            frame: Summary::of(&[ms]),
            of_exact: [Ratio { value: ms / 10.0, off: 0.01, rounds: 8 }; 2],
            bytes: 1,
            largest: mean,
            mean,
            psnr: 0.0,
            gradient: 0.0,
            standing: Standing::default(),
            quality: None,
        }
    }

    #[test]
    fn gradient_error_is_the_largest_over_groups() {
        let mut a = GaussianData::default();
        a.groups[Group::Means as usize] = vec![3.0, 4.0];
        a.groups[Group::Sh0 as usize] = vec![1.0];
        let mut b = a.clone();
        assert_eq!(difference(&a, &b).unwrap(), 0.0);
        b.groups[Group::Means as usize] = vec![3.0, 4.5];
        assert!((difference(&a, &b).unwrap() - 0.1).abs() < 1e-12);
        // A later group with a smaller error does not hide a non-finite one.
        b.groups[Group::Means as usize] = vec![3.0, f32::NAN];
        assert_eq!(difference(&a, &b).unwrap(), f64::INFINITY);
        b.groups[Group::Means as usize] = vec![3.0];
        assert!(difference(&a, &b).is_err());
    }

    #[test]
    fn front_is_plotted() {
        let mut points = vec![point("exact", 10.0, 0.0), point("fast", 5.0, 1e-2)];
        let drawn = |points: &mut [Point]| {
            mark(points);
            let marks: Vec<Mark> = points.iter().map(Mark::from).collect();
            plot::svg(&marks, "a title", "errors").unwrap()
        };
        let text = drawn(&mut points);
        assert!(text.starts_with("<svg") && text.contains("fast") && text.contains("a title"));
        let of = |text: &str| {
            let document = roxmltree::Document::parse(text).unwrap();
            let nodes = document.descendants().filter(|n| n.attribute("r") == Some("5"));
            let filled = nodes.clone().filter(|n| n.attribute("fill") == Some("#0000FF")).count();
            (nodes.count(), filled, text.matches("#808080").count())
        };
        assert_eq!(of(&text), (2, 2, 0));
        // An equivalent choice is a gray cross with a gray name, and removes nothing from the front.
        points.push(point("another way", 4.0, 0.0));
        points[2].choice.kind = Kind::Same;
        assert_eq!(of(&drawn(&mut points)), (2, 2, 3));
        assert!(table(&points).lines().last().unwrap().ends_with("| as exact |"));
        points[2].choice.kind = Kind::Accuracy;
        assert_eq!(of(&drawn(&mut points)), (3, 1, 0));
    }

    #[test]
    fn report_round_trips_to_the_same_presentation() {
        let choices = of_geometry(&Tuning::for_subgroups(8)).unwrap();
        for trained in [false, true] {
            let some = |(i, choice): (usize, Choice)| {
                let (x, exact) = (i as f64, i == 0);
                let ratio = |rounds: &[f64]| if exact { Ratio::EXACT } else { Ratio::of(rounds) };
                Point {
                    choice,
                    of_exact: [ratio(&[0.8 + 0.03 * x, 0.81, 0.7]), ratio(&[0.903, 1.0 - 0.01 * x])],
                    bytes: 123_456_789 + i as u64,
                    largest: 1e-3 * x,
                    psnr: 99.96 - x,
                    gradient: 1e-2 * x,
                    quality: trained.then_some(Quality { psnr: 30.0 + x, normals: (i % 3 > 0).then_some(7.123) }),
                    ..point("", 1.0, 1e-5 * (x - 4.0).abs())
                }
            };
            let mut points: Vec<Point> = choices.clone().into_iter().enumerate().map(some).collect();
            mark(&mut points);
            let mut report = report(&[("scene", "room".into()), ("gaussians", 17.into()), ("semantics", true.into())]);
            put(&mut report, &points);
            let presentation = presentation(&report, &points);
            assert!(
                presentation.title == "room, 17 Gaussians, a" && presentation.table.contains("| within noise |"),
                "{}",
                presentation.table
            );
            assert!(
                presentation.table.contains("| yes |") && presentation.table.contains("| as exact |"),
                "{}",
                presentation.table
            );
            assert_round_trip(&report, &presentation);
        }
    }

    /// Names of adjacent points are in the vertical order of the points.
    #[test]
    fn names_have_the_order_of_their_points() {
        let mark =
            |name: &str, error: f64| Mark { name: name.to_owned(), time: 1.0, error, standing: Standing::Beaten };
        let text = plot::svg(&[mark("exact", 1e-4), mark("lower", 1e-2), mark("upper", 1.2e-2)], "", "").unwrap();
        let document = roxmltree::Document::parse(&text).unwrap();
        let at = |name: &str| {
            let node = document.descendants().find(|n| n.has_tag_name("text") && n.text().map(str::trim) == Some(name));
            node.unwrap().attribute("y").unwrap().parse::<f64>().unwrap()
        };
        assert!(at("upper") + 11.0 < at("lower"), "{} and {}", at("upper"), at("lower"));
        // A name that would overlap the next mark moves below it.
        let marks = [mark("exact", 1e-4), Mark { time: 1.005, ..mark("beside", 1e-4) }];
        let text = plot::svg(&marks, "", "").unwrap();
        let document = roxmltree::Document::parse(&text).unwrap();
        let node = |name: &str| document.descendants().find(|n| n.text().map(str::trim) == Some(name)).unwrap();
        let y = |name: &str| node(name).attribute("y").unwrap().parse::<f64>().unwrap();
        assert!(y("exact") > y("beside") + 11.0, "{} and {}", y("exact"), y("beside"));
    }
}
