//! `engine-bench step --stage intrinsic`: a whole step of the intrinsic stage, pass by pass, through the trainer itself.

use super::ceiling::Ceiling;
use super::step::Args;
use crate::common::Common;
use crate::harness::{add_passes, spans};
use crate::process::cpu_seconds;
use crate::stats::Summary;
use anyhow::{Context, bail};
use sgs_engine::graph::dump::{Track, html, trace};
use sgs_passes::cost::Counts;
use sgs_scene::{Scene, Splats};
use sgs_train::{Intrinsic, Settings};
use std::path::Path;
use std::time::Instant;

/// Runs the command.
///
/// # Errors
/// If the device fails, or what is measured is not what it should be.
pub fn run(common: &Common, a: &Args) -> anyhow::Result<()> {
    let device = common.open_device()?;
    let mut report = common.report("step", &device);
    let steps = a.steps.unwrap_or(common.repeats);
    report.repeats = steps;
    let ceiling = Ceiling::measure(&common.open_device()?)?;
    report.ceiling = Some(ceiling);
    let mut settings = settings(a)?;
    // Steps that compare with pseudo-views are other graphs: the plain one is measured.
    (settings.intrinsic.losses.cross_view, settings.intrinsic.losses.relight) = (0.0, 0.0);
    let folder = tempfile::tempdir()?;
    let path = match (&a.scene, &a.run) {
        (Some(path), _) => path.clone(),
        (None, Some(_)) => settings.scene.clone(),
        (None, None) => {
            let path = folder.path().join("room");
            let (_, [width, height]) = Args::sizes(&device, a.gaussians, a.size);
            let options = sgs_synth::SynthOptions {
                views: 4,
                width: width as usize,
                height: height as usize,
                ..Default::default()
            };
            sgs_synth::generate(&path, &options, &|_, _| {})?;
            path
        }
    };
    settings.scene.clone_from(&path);
    let scene = Scene::open(&path, &settings.scene_options())?;
    let splats = match (&a.geometry, &a.run) {
        (Some(file), _) => Splats::read_ply(file)?,
        (None, Some(run)) => Splats::read_ply(&run.join("scene.ply"))?,
        (None, None) => opaque(Splats::from_points(&scene.points, 0)?),
    };
    let mut training = Intrinsic::new(&device, &scene, &settings, &splats)?;
    if let Some(run) = &a.run {
        training.restore(&run.join("checkpoint").join("intrinsic.safetensors"))?;
        report.setting("run", run.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned()));
    }
    let camera = &scene.views[scene.split.train[0]].camera;
    let pixels = f64::from(camera.width) * f64::from(camera.height);
    report.setting("stage", "intrinsic");
    report.setting("scene", path.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned()));
    report.setting("gaussians", splats.len());
    report.setting("size", format!("{}x{}", camera.width, camera.height));
    report.setting("lights", settings.intrinsic.lights.grid.pow(3));
    report.setting("environment", settings.intrinsic.environment.resolution);
    report.setting("visibility", format!("{:?}", settings.intrinsic.visibility.kind).to_lowercase());

    report.setting("cull error", settings.intrinsic.cull_error);
    if let Some(lights) = training.lights()? {
        report.setting("lights that are on", lights.lights.iter().filter(|l| l.gain != 0.0).count());
    }

    let mut done = training.step();
    let mut losses = Vec::new();
    let mut train = |training: &mut Intrinsic, count: u32, each: bool| -> anyhow::Result<Vec<f64>> {
        let mut wall = Vec::new();
        let stride = if each { 1 } else { count };
        for _ in (0..count).step_by(stride as usize) {
            let begin = Instant::now();
            done += stride;
            training.train(done, |r| losses.push(r.shaded), || true)?;
            wall.push(begin.elapsed().as_secs_f64() * 1e3 / f64::from(stride));
        }
        Ok(wall)
    };
    train(&mut training, common.warmup.max(scene.split.train.len() as u32), false)?;
    let (used, made) = (device.memory_use().0, cpu_seconds());
    let wall = train(&mut training, steps, true)?;
    let cpu = cpu_seconds().zip(made).map(|(after, before)| after - before);
    let after = device.memory_use().0;
    anyhow::ensure!(used == after, "{steps} steps changed the memory in use from {used} to {after} bytes.");
    report.time("step by the host's clock", "ms", Summary::of(&wall));
    if let Some(seconds) = cpu {
        report.fact("processor seconds of a step, all threads", seconds / f64::from(steps));
    }
    training.set_timestamps(true)?;
    train(&mut training, common.warmup.clamp(1, 3), false)?;
    training.take_times();
    train(&mut training, steps, false)?;
    let times = training.take_times();
    let counts = Counts {
        gaussians: splats.len() as f64,
        pixels,
        lights: f64::from(settings.intrinsic.lights.grid.pow(3)),
        weights: training.surface_weights()?,
        ..Default::default()
    };
    let plan = training.executor()?.executor().plan().clone();
    add_passes(&mut report, &plan, &times, &counts, &ceiling);
    report.value("step on the device, timestamps on", "ms", Summary::of(&spans(&times)).scaled(1e-6));
    super::step::shape(&mut report, "step", &plan);
    report.fact("device memory, MB", used as f64 / 1e6);
    report.fact("of it what views see of the geometry, MB", training.surface_bytes() as f64 / 1e6);
    anyhow::ensure!(losses.iter().all(|l| l.is_finite()), "a loss is not finite");
    report.check(format!("over {steps} steps no buffer was made or freed, and every step reported finite losses"));
    if let Some(path) = &a.html {
        let page = html(&plan, &times);
        sgs_scene::atomic_write(path, |f| std::io::Write::write_all(f, page.as_bytes()))?;
    }
    if let Some(path) = &a.trace {
        let text = trace(&[Track { name: &plan.name, times: &times, replay: steps as usize / 2 }]);
        sgs_scene::atomic_write(path, |f| std::io::Write::write_all(f, text.as_bytes()))?;
    }
    common.finish(&report, &device)
}

/// Settings of the run, or from `--config`, if one is given.
fn settings(a: &Args) -> anyhow::Result<Settings> {
    let of_run = a.run.as_ref().map(|run| run.join("config.toml"));
    let Some(path) = a.config.as_ref().or(of_run.as_ref()) else { return Ok(Settings::default()) };
    read(path).with_context(|| format!("\"{}\"", path.display()))
}

fn read(path: &Path) -> anyhow::Result<Settings> {
    let table = std::fs::read_to_string(path)?.parse()?;
    let settings = Settings::from_table(table)?;
    if !settings.intrinsic.lights.enabled && !settings.intrinsic.environment.enabled {
        bail!("there is nothing that gives light");
    }
    Ok(settings)
}

/// Points as surfaces that hide what is behind them.
fn opaque(mut splats: Splats) -> Splats {
    splats.opacity_logits.iter_mut().for_each(|o| *o = 4.0);
    splats
}
