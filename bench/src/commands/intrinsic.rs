//! Step of the intrinsic stage, pass by pass: `engine-bench step --stage intrinsic`.
//!
//! The trainer itself submits the steps.

use super::ceiling::measure_ceiling;
use super::step::Args;
use crate::common::Common;
use crate::harness::{add_passes, spans};
use crate::process::cpu_seconds;
use crate::report::Report;
use crate::stats::Summary;
use crate::workload::{LitScene, lit_settings, plain};
use sgs_engine::graph::dump::{Track, html, trace};
use sgs_train::Intrinsic;
use std::time::Instant;

/// Runs the command.
///
/// # Errors
/// If the device fails, or a result is wrong.
pub fn run(common: &Common, a: &Args) -> anyhow::Result<()> {
    let device = super::step::open(common, a)?;
    let mut report = common.report("step", &device);
    let steps = a.steps.unwrap_or(common.repeats);
    report.repeats = steps;
    let ceiling = measure_ceiling(&common.open_device()?)?;
    report.ceiling = Some(ceiling);
    let of_run = |file: &str| a.run.as_ref().map(|run| run.join(file));
    let mut settings = plain(&lit_settings(a.config.clone().or(of_run("config.toml")).as_deref())?);
    let path = a.scene.clone().or_else(|| a.run.as_ref().map(|_| settings.scene.clone()));
    let geometry = a.geometry.clone().or(of_run("scene.ply"));
    let (_, size) = Args::sizes(&device, a.gaussians, a.size);
    let lit = LitScene::open(path.as_deref(), geometry.as_deref(), size, &mut settings)?;
    let (scene, splats) = (&lit.scene, &lit.splats);
    let mut training = Intrinsic::new(&device, scene, &settings, splats)?;
    if let Some(run) = &a.run {
        training.restore(&run.join("checkpoint").join("intrinsic.safetensors"))?;
        report.setting("run", run.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned()));
    }
    report.setting("stage", "intrinsic");
    report.setting("scene", lit.name());
    report.setting("gaussians", splats.len());
    report.setting("size", format!("{}x{}", lit.camera().width, lit.camera().height));
    modeled(&mut report, &training)?;

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
    let before = training.host_times();
    let wall = train(&mut training, steps, true)?;
    let (rest, submitting) = training.host_times().since(&before);
    let cpu = cpu_seconds().zip(made).map(|(after, before)| after - before);
    let after = device.memory_use().0;
    anyhow::ensure!(used == after, "{steps} steps changed the memory in use from {used} to {after} bytes.");
    report.time("step by the host's clock", "ms", Summary::of(&wall));
    report.fact("host, a replay without its submission, us", rest * 1e6);
    report.fact("host, the submission of a replay, us", submitting * 1e6);
    if let Some(seconds) = cpu {
        report.fact("processor seconds of a step, all threads", seconds / f64::from(steps));
    }
    training.set_timestamps(true)?;
    train(&mut training, common.warmup.clamp(1, 3), false)?;
    training.take_times();
    train(&mut training, steps, false)?;
    let times = training.take_times();
    let counts = training.counts()?;
    let plan = training.executor()?.executor().plan().clone();
    add_passes(&mut report, &plan, &times, &counts, &ceiling);
    report.value("step on the device, timestamps on", "ms", Summary::of(&spans(&times)).scaled(1e-6));
    super::step::shape(&mut report, "step", &plan);
    report.fact("device memory, MB", used as f64 / 1e6);
    report.fact("of it what views see of the geometry, MB", training.surface_bytes() as f64 / 1e6);
    anyhow::ensure!(losses.iter().all(|l| l.is_finite()), "a loss is not finite");
    report.check(format!("over {steps} steps no buffer was made or freed, and every step reported finite losses"));
    if a.kernels {
        super::step::kernels(&device, &mut report)?;
    }
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

/// Adds the current size of the model; settings are upper bounds.
fn modeled(report: &mut Report, training: &Intrinsic) -> anyhow::Result<()> {
    let (options, required) = (training.options(), training.required());
    match &options.lights {
        Some((model, _)) => {
            report.setting("lights", model.lights);
            report.setting("lights that are on", training.counts()?.lights);
            report.setting("lobes", model.lobes);
        }
        None => report.setting("lights", "none"),
    }
    match training.environment_size() {
        Some(size) => {
            report.setting("environment", size);
            report.setting("environment moves every", options.environment_every);
        }
        None => report.setting("environment", "none"),
    }
    report.setting("visibility", format!("{:?}", required.visibility.kind).to_lowercase());
    if let Some(field) = &options.visibility {
        report.setting("levels of the field", field.levels);
    }
    report.setting("cull error", required.cull_error);
    Ok(())
}
