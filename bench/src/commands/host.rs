//! Host's time of a step, with a driver that runs no kernels: `engine-bench host`.
//!
//! The command starts itself again with the null driver ([`sgs_null_driver`]) as the only one. There submissions are done
//! at once, so that the trainers' own loops never wait. The reports of steps, which kernels would write, are written
//! between the measured times. Counts of calls are those of the driver.

use crate::common::{Common, parse_size};
use crate::report::Report;
use crate::stats::{Summary, percentile};
use crate::workload::{LitScene, plain};
use anyhow::{Context, ensure};
use bytemuck::Pod;
use sgs_config::{Backward, OwnPrior, Settings};
use sgs_engine::exec::HostTimes;
use sgs_engine::{Device, DeviceBuffer};
use sgs_null_driver::Counter;
use sgs_shaders::structs::{IntrinsicReport, StepReport};
use sgs_train::{Geometry, Intrinsic};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

/// Options of the command.
#[derive(clap::Args, Clone, Debug)]
pub struct Args {
    /// View size of the synthetic room. The host's work does not depend on it.
    #[arg(long, value_name = "WxH", value_parser = parse_size, default_value = "64x48")]
    pub size: [u32; 2],
    /// Number of measured steps of each stage.
    #[arg(long, value_name = "N", default_value_t = 2000, value_parser = clap::value_parser!(u32).range(1..))]
    pub steps: u32,
    /// Library of the null driver; by default the one that was built with this program.
    #[arg(long, value_name = "FILE")]
    pub driver: Option<PathBuf>,
    /// File of the driver's counts: this process has the null driver.
    #[arg(long, value_name = "FILE", hide = true)]
    pub counts: Option<PathBuf>,
}

/// Steps before the measured ones. Each view then has a recording in each slot.
const WARM: u32 = 200;

/// Runs the command.
///
/// # Errors
/// If the driver is missing, a stage fails, or a count cannot be read.
pub fn run(common: &Common, a: &Args) -> anyhow::Result<()> {
    match &a.counts {
        Some(counts) => measure(common, a, counts),
        None => with_driver(a),
    }
}

/// Starts this program again, with the null driver.
fn with_driver(a: &Args) -> anyhow::Result<()> {
    let program = std::env::current_exe()?;
    let library = match &a.driver {
        Some(file) => file.canonicalize().with_context(|| format!("\"{}\"", file.display()))?,
        None => built_with(&program).context(
            "There is no library of the null driver beside the program; build it with cargo build -p sgs-null-driver, or name it \
             with --driver.",
        )?,
    };
    let folder = tempfile::tempdir()?;
    let [manifest, counts] = ["null.json", "counts"].map(|name| folder.path().join(name));
    std::fs::write(&manifest, sgs_null_driver::manifest(&library))?;
    std::fs::write(&counts, [0; sgs_null_driver::BYTES])?;
    let mut command = Command::new(&program);
    command.args(std::env::args_os().skip(1)).arg("--counts").arg(&counts);
    command.env(sgs_null_driver::FILE_VARIABLE, &counts);
    // Loaders before 1.3.207 know the second name only.
    command.env("VK_DRIVER_FILES", &manifest).env("VK_ICD_FILENAMES", &manifest).env_remove("VK_ADD_DRIVER_FILES");
    let status = command.status()?;
    if !status.success() {
        std::process::exit(status.code().unwrap_or(1));
    }
    Ok(())
}

/// Finds the library that Cargo built with the program.
fn built_with(program: &Path) -> Option<PathBuf> {
    let name = format!("{}sgs_null_driver{}", std::env::consts::DLL_PREFIX, std::env::consts::DLL_SUFFIX);
    let folder = program.parent()?;
    // As a dependency it lies in `deps`.
    [folder.join("deps").join(&name), folder.join(&name)].into_iter().find(|file| file.is_file())
}

/// Times and counts of measured steps.
struct Measured {
    /// Microseconds of each step, with the evaluation of an earlier report.
    steps: Vec<f64>,
    /// Calls in the measured steps, and before them.
    calls: [u64; Counter::ALL.len()],
    before: [u64; Counter::ALL.len()],
}

/// Observes the loop of a trainer.
struct Watch<'a> {
    counts: &'a Path,
    reports: DeviceBuffer,
    /// Number of the step that begins, from 1.
    step: u32,
    begun: Option<Instant>,
    measured: Measured,
    failed: Option<anyhow::Error>,
}

impl<'a> Watch<'a> {
    fn new(counts: &'a Path, reports: &DeviceBuffer) -> Watch<'a> {
        let measured = Measured { steps: Vec::new(), calls: Default::default(), before: Default::default() };
        Watch { counts, reports: reports.clone(), step: 0, begun: None, measured, failed: None }
    }

    /// Ends the time of a step and begins that of the next one. Writes its report in place of the device.
    fn next<R: Pod>(&mut self, report: impl FnOnce(u32) -> R) -> bool {
        let ended = Instant::now();
        self.step += 1;
        if let Some(begun) = self.begun.take() {
            self.measured.steps.push((ended - begun).as_secs_f64() * 1e6);
        }
        let report = report(self.step);
        let bytes = size_of::<R>() as u64;
        let ring = self.reports.bytes() / bytes;
        let written = self.reports.write(u64::from(self.step) % ring * bytes, bytemuck::bytes_of(&report));
        if let Err(error) = written {
            self.failed = Some(error.into());
            return false;
        }
        if self.step == WARM + 1 {
            match sgs_null_driver::read(self.counts) {
                Ok(counts) => self.measured.before = counts,
                Err(error) => self.failed = Some(error.into()),
            }
        }
        if self.step > WARM {
            self.begun = Some(Instant::now());
        }
        self.failed.is_none()
    }

    /// Ends the last step.
    fn finish(mut self) -> anyhow::Result<Measured> {
        if let Some(error) = self.failed {
            return Err(error);
        }
        if let Some(begun) = self.begun {
            self.measured.steps.push(begun.elapsed().as_secs_f64() * 1e6);
        }
        let after = sgs_null_driver::read(self.counts)?;
        for (i, call) in self.measured.calls.iter_mut().enumerate() {
            *call = after[i] - self.measured.before[i];
        }
        Ok(self.measured)
    }
}

/// Measures both stages with the null driver.
fn measure(common: &Common, a: &Args, counts: &Path) -> anyhow::Result<()> {
    let device = common.open_device()?;
    ensure!(device.info().name == "null driver", "the loader has opened {}, not the null driver", device.info().name);
    let mut report = common.report("host", &device);
    report.repeats = a.steps;
    report.warmup = WARM;
    report.setting("size", format!("{}x{}", a.size[0], a.size[1]));
    let mut settings = Settings::default();
    let steps = WARM + a.steps;
    (settings.geometry.steps, settings.intrinsic.steps) = (2 * steps, 2 * steps);
    settings.geometry.backward = Backward::Pixel;
    settings.geometry.densify.until = 0.0;
    // By default training compares regions and lights from later steps on. From the first step on, all command buffers
    // are recorded before the measured steps.
    (settings.geometry.correspondence_from, settings.intrinsic.relight_from) = (1, 1);
    let lit = LitScene::open(None, None, a.size, &mut settings)?;
    report.setting("views", lit.scene.split.train.len());
    // Most steps of training are plain: no pseudo-views, no other lights, and one graph.
    let mut plain = plain(&settings);
    plain.geometry.losses.correspondence = 0.0;
    plain.intrinsic.losses.own_prior = OwnPrior::Weight(0.0);
    let run = Run { device: &device, lit: &lit, steps, counts };
    geometry(&mut report, "geometry", &run, &plain)?;
    geometry(&mut report, "geometry with pseudo-views", &run, &settings)?;
    intrinsic(&mut report, "intrinsic", &run, &plain)?;
    intrinsic(&mut report, "intrinsic with steps of all kinds", &run, &settings)?;
    report.check(format!(
        "over {} steps of each stage no command was recorded, no descriptor written, no memory allocated",
        a.steps
    ));
    common.finish(&report, &device)
}

/// Device, scene and steps of the measurements.
struct Run<'a> {
    device: &'a Device,
    lit: &'a LitScene,
    steps: u32,
    counts: &'a Path,
}

fn geometry(report: &mut Report, name: &str, run: &Run<'_>, settings: &Settings) -> anyhow::Result<()> {
    let mut training = Geometry::new(run.device, &run.lit.scene, settings, Some(&run.lit.splats))?;
    let mut watch = Watch::new(run.counts, training.reports());
    let good = |step| {
        let mut report = StepReport { step, gaussians: 1, visible: 1, entries: 1, ..Default::default() };
        (report.losses.total, report.losses.l1) = (0.1, 0.1);
        report
    };
    training.train(run.steps, |_| (), || watch.next(good))?;
    let measured = watch.finish()?;
    let times = training.executor()?.host_times();
    add(report, name, &measured, &times)
}

fn intrinsic(report: &mut Report, name: &str, run: &Run<'_>, settings: &Settings) -> anyhow::Result<()> {
    let mut training = Intrinsic::new(run.device, &run.lit.scene, settings, &run.lit.splats)?;
    let mut watch = Watch::new(run.counts, training.reports());
    let good = |step| IntrinsicReport { step, shaded: 0.1, shaded_l1: 0.1, ..Default::default() };
    training.train(run.steps, |_| (), || watch.next(good))?;
    let measured = watch.finish()?;
    let times = training.host_times();
    add(report, name, &measured, &times)
}

/// Adds the times and counts of a stage. Refuses steps that are not in the steady state.
fn add(report: &mut Report, stage: &str, measured: &Measured, times: &HostTimes) -> anyhow::Result<()> {
    let steps = measured.steps.len() as f64;
    report.time(&format!("{stage}: host's time of a step"), "us", Summary::of(&measured.steps));
    report.fact(&format!("{stage}: 99th percentile, us"), percentile(&measured.steps, 0.99));
    let replays = times.replays.max(1) as f64;
    let submitting = times.submit_time.as_secs_f64() * 1e6 / replays;
    let working = times.work_time.as_secs_f64() * 1e6 / replays;
    report.fact(
        &format!("{stage}: mean of a replay without its submission, recordings included, us"),
        working - submitting,
    );
    report.fact(&format!("{stage}: mean of a submission, us"), submitting);
    let of = |counter: Counter| measured.calls[counter as usize];
    let per_step = |counter: Counter| of(counter) as f64 / steps;
    report.fact(&format!("{stage}: submissions per step"), per_step(Counter::Submits));
    report.fact(&format!("{stage}: waits per step"), per_step(Counter::Waits));
    for (name, counter) in [
        ("recorded command buffers", Counter::Recordings),
        ("recorded commands", Counter::Commands),
        ("written descriptors", Counter::Descriptors),
        ("allocations of device memory", Counter::Allocations),
        ("created objects", Counter::Objects),
        ("transferred bytes", Counter::TransferBytes),
    ] {
        report.fact(&format!("{stage}: {name} before the measured steps"), measured.before[counter as usize]);
        report.fact(&format!("{stage}: {name}"), of(counter));
        ensure!(of(counter) == 0, "{stage}: {} {name} in {steps} steps of the steady state", of(counter));
    }
    Ok(())
}
