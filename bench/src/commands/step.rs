//! Training step and render, pass by pass, with their host cost: `engine-bench step`.

use super::ceiling::measure_ceiling;
use super::tiles::{ALL_TILES, LONGEST_TILE, TILE, TILE_PARTS, parts};
use crate::ceiling::Ceiling;
use crate::common::{Common, parse_size};
use crate::harness::{add_passes, spans};
use crate::micro::view::{Subject, overlap};
use crate::micro::{Context, densify};
use crate::report::Report;
use crate::stats::Summary;
use crate::trainer::{Run, Trainer, first_entry_capacity};
use crate::workload::{Priors, Synthetic, Workload, directory, synthetic};
use sgs_config::{ACCURACY_LEVELS, Settings, accuracy_named};
use sgs_engine::Device;
use sgs_engine::exec::PassTime;
use sgs_engine::graph::Plan;
use sgs_engine::graph::dump::{Track, html, trace};
use sgs_passes::Tuning;
use sgs_passes::cost::Counts;
use sgs_passes::pipeline::{Renderer, StepReport};
use sgs_passes::scene::Decoder;
use sgs_passes::splat::BackwardKernel;
use std::path::PathBuf;

/// End of the name of the fact with the composition of a plan; the kind of the plan precedes.
pub const SHAPE: &str = ": passes, groups, barriers";

/// Options of the command.
#[derive(clap::Args, Clone, Debug)]
pub struct Args {
    /// Number of Gaussians of the synthetic room; 20000 on a CPU, 1000000 elsewhere.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(100..=50_000_000))]
    pub gaussians: Option<u32>,
    /// View size of the synthetic room; 320x240 on a CPU, 1920x1080 elsewhere.
    #[arg(long, value_name = "WxH", value_parser = parse_size)]
    pub size: Option<[u32; 2]>,
    /// Scene directory, in place of the synthetic room.
    #[arg(long, value_name = "DIR", conflicts_with_all = ["gaussians", "size"])]
    pub scene: Option<PathBuf>,
    /// Stage whose step is measured.
    #[arg(long, value_enum, default_value = "geometry")]
    pub stage: Stage,
    /// PLY file with the geometry of the intrinsic stage; by default the scene's points.
    #[arg(long, value_name = "FILE.ply")]
    pub geometry: Option<PathBuf>,
    /// TOML file with settings of the intrinsic stage, as config.toml of a run.
    #[arg(long, value_name = "FILE.toml")]
    pub config: Option<PathBuf>,
    /// Run of the intrinsic stage, in place of scene, geometry and settings. Measures its current step, without the
    /// disabled components.
    #[arg(long, value_name = "DIR", conflicts_with_all = ["scene", "geometry", "config", "gaussians", "size"])]
    pub run: Option<PathBuf>,
    /// Number of steps to measure, in place of --repeats.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub steps: Option<u32>,
    /// Accumulate the statistics of densification, and measure densification itself.
    #[arg(long)]
    pub densify: bool,
    /// Include normals and depth, their losses, and normal priors.
    #[arg(long)]
    pub normals: bool,
    /// Include the semantic loss. The scene must have the priors.
    #[arg(long, requires = "scene")]
    pub semantics: bool,
    /// Include two pseudo-views and the correspondence of a region.
    #[arg(long, requires = "semantics")]
    pub pseudo: bool,
    /// Degree of the spherical harmonics.
    #[arg(long, value_name = "D", default_value_t = 3, value_parser = clap::value_parser!(u32).range(0..=3))]
    pub sh_degree: u32,
    /// Backward kernel of blending.
    #[arg(long, value_enum, default_value = "pixel")]
    pub backward: Backward,
    /// Accuracy level of the geometry stage, as of `sgs train`.
    #[arg(long, value_name = "NAME", value_parser = clap::builder::PossibleValuesParser::new(ACCURACY_LEVELS))]
    pub accuracy: Option<String>,
    /// Report the driver's statistics of each kernel, such as registers.
    #[arg(long)]
    pub kernels: bool,
    /// Write a Chrome trace of one step and one render.
    #[arg(long, value_name = "FILE.json")]
    pub trace: Option<PathBuf>,
    /// Write the plan of the step, with measured times, as an HTML page.
    #[arg(long, value_name = "FILE.html")]
    pub html: Option<PathBuf>,
}

/// Stage whose step is measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Stage {
    /// Geometry and appearance.
    Geometry,
    /// Materials, lights and shadows on fixed geometry.
    Intrinsic,
}

/// Backward kernel of blending, by the assignment of its lanes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Backward {
    /// One pixel per lane.
    Pixel,
    /// One splat per lane.
    Splat,
    /// Splats of a bucket of entries per lane.
    Bucket,
    /// One pixel per lane; atomic sums.
    Atomic,
}

impl From<Backward> for BackwardKernel {
    fn from(b: Backward) -> Self {
        match b {
            Backward::Pixel => BackwardKernel::Pixel,
            Backward::Splat => BackwardKernel::Splat,
            Backward::Bucket => BackwardKernel::Bucket,
            Backward::Atomic => BackwardKernel::Atomic,
        }
    }
}

impl Args {
    /// Returns sizes that suit a device: small on a CPU, and large enough to fill a GPU.
    pub fn sizes(device: &Device, gaussians: Option<u32>, size: Option<[u32; 2]>) -> (u32, [u32; 2]) {
        let cpu = device.info().kind == "cpu";
        let gaussians = gaussians.unwrap_or(if cpu { 20_000 } else { 1_000_000 });
        (gaussians, size.unwrap_or(if cpu { [320, 240] } else { [1920, 1080] }))
    }

    /// Returns the tuning of training, and adds its accuracy level to the report.
    ///
    /// # Errors
    /// If the level does not exist.
    fn tuning(&self, device: &Device, report: &mut Report) -> anyhow::Result<Tuning> {
        let Some(level) = &self.accuracy else { return Ok(Tuning::for_device(device.info())) };
        report.setting("accuracy", level.clone());
        Ok(Settings::from_table(accuracy_named(level)?)?.tuning(device.info()))
    }

    /// Loads or creates the scene, and adds its sizes to the report.
    ///
    /// # Errors
    /// If the scene cannot be read or created.
    pub fn workload(&self, device: &Device, report: &mut Report) -> anyhow::Result<Workload> {
        let workload = match &self.scene {
            Some(path) => directory(
                device,
                path,
                Priors { normals: self.normals, semantics: self.semantics, pseudo: self.pseudo },
                self.densify,
                self.sh_degree,
            )?,
            None => {
                let (gaussians, size) = Args::sizes(device, self.gaussians, self.size);
                let room = Synthetic {
                    gaussians,
                    size,
                    normals: self.normals,
                    densify: self.densify,
                    sh_degree: self.sh_degree,
                };
                synthetic(device, &room)?
            }
        };
        report.setting("scene", workload.name.clone());
        report.setting("gaussians", workload.start.len());
        report.setting("size", format!("{}x{}", workload.largest[0], workload.largest[1]));
        report.setting("views", workload.views.len());
        report.setting("degree", self.sh_degree);
        report.setting("normals", self.normals);
        report.setting("semantics", self.semantics);
        report.setting("pseudo", self.pseudo);
        report.setting("densify", self.densify);
        report.setting("backward", format!("{:?}", self.backward).to_lowercase());
        Ok(workload)
    }
}

/// Runs the command.
///
/// # Errors
/// If the device fails, or a result is wrong.
pub fn run(common: &Common, a: &Args) -> anyhow::Result<()> {
    if a.stage == Stage::Intrinsic || a.run.is_some() {
        return super::intrinsic::run(common, a);
    }
    let device = open(common, a)?;
    let mut report = common.report("step", &device);
    let steps = a.steps.unwrap_or(common.repeats);
    report.repeats = steps;
    let ceiling = measure_ceiling(&common.open_device()?)?;
    report.ceiling = Some(ceiling);
    let workload = a.workload(&device, &mut report)?;

    let capacity = first_entry_capacity(workload.start.len());
    let tuning = a.tuning(&device, &mut report)?;
    let mut trainer = Trainer::with(&device, &workload, tuning, a.backward.into(), false, capacity)?;
    // Once through all views, so that no later step grows the entry capacity.
    trainer.run(common.warmup.max(workload.views.len() as u32))?;
    let plain = trainer.run(steps)?;
    host(&mut report, &plain)?;
    trainer.set_timestamps(true)?;
    trainer.run(common.warmup.clamp(1, 3))?;
    let timed = trainer.run(steps)?;
    let plan = trainer.plan();
    let counts = counts(&device, &workload, &trainer, &timed, &mut report)?;
    add_passes(&mut report, &plan, &timed.times, &counts, &ceiling);
    report.value("step on the device, timestamps on", "ms", Summary::of(&spans(&timed.times)).scaled(1e-6));
    shape(&mut report, "step", &plan);
    if let Some(parts) = parts(&plan) {
        report.fact(TILE_PARTS, parts);
    }
    memory(&mut report, &device, &workload, &mut trainer, tuning)?;
    losses(&mut report, &plain, &timed)?;
    let render = render(&device, common, &workload, &trainer, &mut report, &ceiling, &counts)?;
    if a.densify {
        let context = Context {
            device: &device,
            tuning: Tuning::for_device(device.info()),
            warmup: common.warmup,
            repeats: common.repeats,
            ceiling,
            elements: 0,
            workload: &workload,
            dump: None,
        };
        densify::one(&context, &mut report)?;
    }
    super::compile::measure(&device, &mut report, common.repeats)?;
    if a.kernels {
        kernels(&device, &mut report)?;
    }
    if let Some(path) = &a.html {
        let page = html(&plan, &timed.times);
        sgs_scene::atomic_write(path, |f| std::io::Write::write_all(f, page.as_bytes()))?;
    }
    if let Some(path) = &a.trace {
        let replay = timed.reports.len() / 2;
        let tracks = [
            Track { name: &plan.name, times: &timed.times, replay },
            Track { name: "render", times: &render, replay: 0 },
        ];
        let text = trace(&tracks);
        sgs_scene::atomic_write(path, |f| std::io::Write::write_all(f, text.as_bytes()))?;
    }
    common.finish(&report, &device)
}

/// Opens the device. Refuses `--kernels` at once if the driver has no statistics.
///
/// # Errors
/// If there is no such device, or its driver reports no statistics of kernels.
pub(super) fn open(common: &Common, a: &Args) -> anyhow::Result<Device> {
    let device = common.open_with_statistics(a.kernels)?;
    if a.kernels && device.kernel_statistics()?.is_none() {
        anyhow::bail!("{} reports no statistics of kernels; leave --kernels out.", device.info().name);
    }
    Ok(device)
}

/// Adds the driver's statistics of all compiled kernels, except zeros.
///
/// # Errors
/// If the driver fails.
pub(super) fn kernels(device: &Device, report: &mut Report) -> anyhow::Result<()> {
    for kernel in device.kernel_statistics()?.unwrap_or_default() {
        let numbers = kernel.statistics.iter().filter(|s| s.value != 0.0);
        let text: Vec<String> = numbers.map(|s| format!("{} {}", s.name, s.value)).collect();
        let p = &kernel.pipeline;
        report.fact(
            &format!("kernel {}, {} lanes a workgroup", p.kernel, p.workgroup.iter().product::<u32>()),
            text.join(", "),
        );
    }
    Ok(())
}

/// Returns the mean counts over the measured steps.
///
/// Pixels per entry are counted on the host in about three of the views.
fn counts(
    device: &Device,
    workload: &Workload,
    trainer: &Trainer<'_>,
    run: &Run,
    report: &mut Report,
) -> anyhow::Result<Counts> {
    let mean = |f: &dyn Fn(&StepReport) -> u32| {
        run.reports.iter().map(|r| f64::from(f(r))).sum::<f64>() / run.reports.len().max(1) as f64
    };
    let data = trainer.gaussians.download(device)?;
    let tuning = Tuning::for_device(device.info());
    let (mut tried, mut showing, mut entries) = (0.0, 0.0, 0.0);
    // Of one view, that with the longest tile.
    let (mut longest, mut all_tiles) = (0.0, 0.0);
    for (camera, _) in workload.views.iter().step_by(workload.views.len().div_ceil(3)) {
        let (model, channels) = (workload.model, trainer.options().channels);
        let o = overlap(&Subject { device, tuning, model, data: &data, camera: *camera, channels })?;
        tried += o.tried * o.entries;
        showing += o.showing * o.entries;
        entries += o.entries;
        if o.longest > longest {
            (longest, all_tiles) = (o.longest, o.entries);
        }
    }
    let pixels = workload.views.iter().map(|(c, _)| f64::from(c.size[0]) * f64::from(c.size[1])).sum::<f64>();
    let samples = workload.semantics.as_deref().map_or(0.0, |(data, _)| {
        let all: u32 = data.views.iter().map(|v| v.size[0] * v.size[1]).sum();
        f64::from(all) / data.views.len().max(1) as f64
    });
    let counts = Counts {
        gaussians: mean(&|r| r.gaussians),
        visible: mean(&|r| r.visible),
        entries: mean(&|r| r.entries),
        pixels: pixels / workload.views.len().max(1) as f64,
        pairs: mean(&|r| r.entries) * tried / f64::max(entries, 1.0),
        width: f64::from(workload.model.width()),
        samples,
        wanted: f64::min(4.0 * samples, pixels / workload.views.len().max(1) as f64),
        ..Default::default()
    };
    let tile = f64::from(tuning.tile[0] * tuning.tile[1]);
    report.fact(ALL_TILES, all_tiles);
    report.fact(LONGEST_TILE, longest);
    report.fact("visible, entries in a step", format!("{:.0}, {:.0}", counts.visible, counts.entries));
    report.fact(
        TILE,
        format!(
            "{}x{}; {:.1} %, {:.1} %",
            tuning.tile[0],
            tuning.tile[1],
            100.0 * tried / entries.max(1.0) / tile,
            100.0 * showing / entries.max(1.0) / tile
        ),
    );
    Ok(counts)
}

/// Adds host times without timestamps, and checks the steady state.
fn host(report: &mut Report, run: &Run) -> anyhow::Result<()> {
    let wall = Summary::of(&run.wall);
    let host = Summary::of(&run.host);
    report.time("step by the host's clock", "ms", wall);
    report.value("the host's own work in a step", "ms", host);
    if let Some(seconds) = run.cpu_seconds {
        report.fact("processor seconds of a step, all threads", seconds / run.reports.len().max(1) as f64);
    }
    report.fact("the host's share of a step", host.median / wall.median);
    let (rest, submitting) = run.replay;
    report.fact("host, a replay without its submission, us", rest * 1e6);
    report.fact("host, the submission of a replay, us", submitting * 1e6);
    let [(before, was), (after, is)] = run.memory;
    anyhow::ensure!(
        run.unchanged,
        "{} steps changed the memory in use from {before} to {after} bytes, with {} buffers made, {} uploads and {} \
         downloads.",
        run.reports.len(),
        is.made - was.made,
        is.uploads - was.uploads,
        is.downloads - was.downloads
    );
    report.check(format!(
        "over {} steps no buffer was made or freed, nothing uploaded or downloaded, {before} bytes in use throughout",
        run.reports.len()
    ));
    Ok(())
}

/// Adds the composition of a plan.
pub(super) fn shape(report: &mut Report, what: &str, plan: &Plan) {
    let passes: usize = plan.groups.iter().map(|g| g.passes.len()).sum();
    let barriers = plan.groups.iter().filter(|g| g.barrier.is_some()).count();
    report.fact(&format!("{what}{SHAPE}"), format!("{passes}, {}, {barriers}", plan.groups.len()));
    report.fact(
        &format!("{what}: arena, and without sharing memory, MB"),
        format!("{:.2}, {:.2}", plan.arena_bytes as f64 / 1e6, plan.arena_unaliased_bytes as f64 / 1e6),
    );
}

/// Adds memory in total and per Gaussian.
///
/// The slope comes from the same scene with half of the Gaussians.
fn memory(
    report: &mut Report,
    device: &Device,
    workload: &Workload,
    trainer: &mut Trainer<'_>,
    tuning: Tuning,
) -> anyhow::Result<()> {
    let count = workload.start.len();
    let (used, _) = device.memory_use();
    let sizes = workload.inputs().sizes();
    let semantics = sizes.semantics.map_or(0, |s| s.bytes() + Decoder::TRAINING_BYTES);
    let targets = sizes.targets + sizes.normals.unwrap_or(0) + semantics;
    let training = used - targets;
    report
        .fact("device memory, of it photographs, MB", format!("{:.2}, {:.2}", used as f64 / 1e6, targets as f64 / 1e6));
    report.fact("device memory but photographs, bytes a Gaussian", training as f64 / count as f64);
    let entries = trainer.options().entry_capacity;
    let backward = trainer.options().backward;
    let cost = |part: usize| -> anyhow::Result<u64> {
        let less = Workload { start: part_of(workload, count / part), ..shallow(workload) };
        let before = device.memory_use().0;
        let _trainer = Trainer::with(device, &less, tuning, backward, false, entries / part as u32)?;
        Ok(device.memory_use().0 - before)
    };
    let (all, half) = (cost(1)?, cost(2)?);
    report.fact("device memory, bytes each further Gaussian", (all - half) as f64 / (count - count / 2) as f64);
    report.fact(
        "of these, parameters, moments and statistics",
        trainer.gaussians.bytes() as f64 / f64::from(trainer.gaussians.capacity),
    );
    report.fact("room for tile entries", entries);
    Ok(())
}

/// Returns the first `count` Gaussians.
fn part_of(w: &Workload, count: usize) -> sgs_passes::scene::GaussianData {
    let mut data = w.start.clone();
    for group in w.model.groups() {
        data.groups[group as usize].truncate(count * group.width() as usize);
    }
    data
}

/// Returns the same views without Gaussians.
fn shallow(w: &Workload) -> Workload {
    Workload {
        name: w.name.clone(),
        start: Default::default(),
        targets: w.targets.clone(),
        normals: w.normals.clone(),
        semantics: w.semantics.clone(),
        correspondence: w.correspondence.clone(),
        views: w.views.clone(),
        settings: w.settings.clone(),
        ..*w
    }
}

/// Checks that training reduces the loss: an incorrect step may be fast.
fn losses(report: &mut Report, first: &Run, last: &Run) -> anyhow::Result<()> {
    let mean = |run: &Run| {
        run.reports.iter().map(|r| f64::from(r.losses.total)).sum::<f64>() / run.reports.len().max(1) as f64
    };
    let (before, after) = (mean(first), mean(last));
    report.fact("loss, mean of the first and the last steps", format!("{before:.4}, {after:.4}"));
    // Views differ, so the loss over few steps may rise by chance, but not by much.
    let enough = if first.reports.len() >= 10 { 1.0 } else { 1.2 };
    anyhow::ensure!(after <= enough * before, "Training makes the loss grow from {before} to {after}.");
    report.check("every step reported finite losses and gradients, no overflow, and the loss went down");
    Ok(())
}

/// Renders the trained Gaussians. Adds each pass, and the total with readback of the image.
fn render(
    device: &Device,
    common: &Common,
    workload: &Workload,
    trainer: &Trainer<'_>,
    report: &mut Report,
    ceiling: &Ceiling,
    counts: &Counts,
) -> anyhow::Result<Vec<PassTime>> {
    let tuning = Tuning::for_device(device.info());
    let gaussians = &trainer.gaussians;
    let channels = trainer.options().channels;
    let mut renderer = Renderer::new(device, tuning, gaussians, workload.largest, channels)?;
    let mut wall = Vec::new();
    let degree = workload.model.sh_degree;
    let background = workload.settings.geometry.background;
    for i in 0..common.warmup.max(1) + report.repeats {
        let (camera, _) = workload.views[i as usize % workload.views.len()];
        let begin = std::time::Instant::now();
        let rendered = renderer.render(gaussians, &camera, degree, background)?;
        if i < common.warmup.max(1) {
            renderer.executor().take_times();
        } else {
            wall.push(begin.elapsed().as_secs_f64() * 1e3);
        }
        let finite = rendered.image.iter().chain(&rendered.transmittance).all(|v| v.is_finite());
        anyhow::ensure!(finite, "A rendered image holds numbers that are not finite.");
    }
    let times = renderer.executor().take_times();
    let plan = renderer.executor().plan().clone();
    add_passes(report, &plan, &times, counts, ceiling);
    report.time("render by the host's clock, read back", "ms", Summary::of(&wall));
    report.value("render on the device", "ms", Summary::of(&spans(&times)).scaled(1e-6));
    shape(report, "render", &plan);
    Ok(times)
}
