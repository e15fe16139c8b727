//! Training steps as the trainer submits them: schedule, replay, delayed report.
//!
//! The report is that of two steps before. Nothing else runs, so that the step alone is measured.

use crate::process::cpu_seconds;
use crate::workload::Workload;
use anyhow::Context;
use sgs_engine::exec::PassTime;
use sgs_engine::graph::Plan;
use sgs_engine::{Activity, Device};
use sgs_passes::Tuning;
use sgs_passes::pipeline::{GeometryOptions, GeometryStep, Status, StepReport};
use sgs_passes::scene::{GaussianData, Gaussians, Layout};
use sgs_passes::splat::{BackwardKernel, Channels};
use sgs_train::{Correspondence, FrameRendering, Schedule};
use std::sync::{Mutex, MutexGuard};
use std::time::Instant;

/// Replays in flight, as in training.
const IN_FLIGHT: u32 = 2;

/// Gaussians in training.
pub struct Trainer<'w> {
    device: Device,
    tuning: Tuning,
    workload: &'w Workload,
    /// Trained Gaussians.
    pub gaussians: Gaussians,
    status: Status,
    schedule: Schedule,
    exec: GeometryStep,
    options: GeometryOptions,
    /// Last finished step.
    step: u32,
}

/// Times of some steps.
#[derive(Clone, Debug, Default)]
pub struct Run {
    /// Reports, one per step.
    pub reports: Vec<StepReport>,
    /// Pass times, one entry per step; empty without timestamps.
    pub times: Vec<PassTime>,
    /// Milliseconds from one submission to the next, per step.
    pub wall: Vec<f64>,
    /// Milliseconds of host work per step: schedule, uniforms, submission, report.
    ///
    /// Excludes waiting for the device.
    pub host: Vec<f64>,
    /// Host seconds of a replay without its submission, and of the submission.
    pub replay: (f64, f64),
    /// CPU seconds of the whole process over all steps.
    pub cpu_seconds: Option<f64>,
    /// Whether memory in use, buffers and transfers did not change.
    pub unchanged: bool,
    /// Memory in use and device activity, before and after.
    pub memory: [(u64, Activity); 2],
}

impl<'w> Trainer<'w> {
    /// Prepares training with the device's default tuning.
    ///
    /// # Errors
    /// If memory runs out.
    pub fn new(
        device: &Device,
        workload: &'w Workload,
        backward: BackwardKernel,
        entry_capacity: u32,
    ) -> anyhow::Result<Self> {
        let tuning = Tuning::for_device(device.info());
        Trainer::with(device, workload, tuning, backward, false, entry_capacity)
    }

    /// Prepares training with other kernel sizes, accuracy or optimizer.
    ///
    /// `dense_adam`: Adam also updates Gaussians that a step did not see.
    ///
    /// # Errors
    /// If memory runs out.
    pub fn with(
        device: &Device,
        workload: &'w Workload,
        tuning: Tuning,
        backward: BackwardKernel,
        dense_adam: bool,
        entry_capacity: u32,
    ) -> anyhow::Result<Self> {
        let densify = workload.settings.geometry.densify.enabled();
        let count = workload.start.len() as u32;
        // Capacity for the new Gaussians of one densification.
        let capacity = if densify { count + count / 2 } else { count };
        let storage = tuning.accuracy.storage();
        let rule = &workload.settings.geometry.densify;
        let statistics = rule.statistic();
        let layout =
            Layout { model: workload.model, capacity, training: true, statistics: statistics.is_some(), storage };
        let gaussians = Gaussians::of(device, &layout)?;
        gaussians.upload(device, &workload.start)?;
        let masks = match &workload.correspondence {
            Some(c) => Some(locked(c)?.masks()),
            None => None,
        };
        let options = GeometryOptions {
            largest: workload.largest,
            entry_capacity,
            channels: Channels {
                colors: true,
                normals: workload.model.normals,
                depth: workload.model.normals || masks.is_some(),
            },
            statistics,
            mcmc: rule.mcmc(),
            dense_adam,
            backward,
            semantic_geometry: true,
            pseudo: masks,
            timestamps: false,
            frames_in_flight: IN_FLIGHT as usize,
        };
        let status = Status::new(device)?;
        let exec = build(device, &tuning, workload, &gaussians, &status, options)?;
        let schedule = Schedule::new(&workload.settings, workload.extent, workload.views.len());
        Ok(Trainer { device: device.clone(), tuning, workload, gaussians, status, schedule, exec, options, step: 0 })
    }

    /// Trains `steps` steps. Grows the tile entries after an overflow and starts again.
    ///
    /// # Errors
    /// If the device fails, or a step's numbers are not finite.
    pub fn run(&mut self, steps: u32) -> anyhow::Result<Run> {
        for _ in 0..16 {
            let first = self.step;
            let mut run = Run::default();
            if self.attempt(steps, &mut run)? {
                return Ok(run);
            }
            self.grow(&run)?;
            self.step = first;
        }
        anyhow::bail!("The tile entries overflow again and again.")
    }

    /// Trains; returns false with the reports from the overflow on if tile entries overflowed.
    fn attempt(&mut self, steps: u32, run: &mut Run) -> anyhow::Result<bool> {
        self.exec.executor().take_times();
        // Fills the pipeline first: from then on each step waits for an earlier one.
        for step in self.step + 1..=self.step + IN_FLIGHT {
            self.submit(step)?;
        }
        let (first, last) = (self.step + IN_FLIGHT, self.step + IN_FLIGHT + steps);
        let cpu = cpu_seconds();
        run.memory[0] = self.memory();
        let replayed = self.exec.executor().host_times();
        for step in first + 1..=last {
            let begin = Instant::now();
            let before = self.exec.executor().host_times();
            self.submit(step)?;
            // The trainer reads a report as soon as it is guaranteed to be complete.
            let report = self.status.report(step - IN_FLIGHT)?;
            let waited = self.exec.executor().host_times().wait_time - before.wait_time;
            let wall = begin.elapsed();
            run.wall.push(wall.as_secs_f64() * 1e3);
            run.host.push(wall.saturating_sub(waited).as_secs_f64() * 1e3);
            run.reports.push(report);
            if report.flags != 0 {
                return self.overflowed(step, run);
            }
        }
        run.memory[1] = self.memory();
        run.replay = self.exec.executor().host_times().since(&replayed);
        run.cpu_seconds = cpu.zip(cpu_seconds()).map(|(a, b)| b - a);
        self.exec.finish()?;
        for step in last + 1 - IN_FLIGHT..=last {
            run.reports.push(self.status.report(step)?);
        }
        if run.reports.iter().any(|r| r.flags != 0) {
            return self.overflowed(last, run);
        }
        for (step, report) in (first + 1 - IN_FLIGHT..).zip(&run.reports) {
            let sound = report.step == step && report.losses.total.is_finite() && report.visible > 0;
            anyhow::ensure!(sound, "Step {step} went wrong: {report:?}.");
            anyhow::ensure!(report.skipped == 0, "In step {step} {} gradients were not finite.", report.skipped);
        }
        let filling = IN_FLIGHT as usize;
        run.reports.drain(..filling);
        run.unchanged = run.memory[0] == run.memory[1];
        run.times = self.exec.executor().take_times();
        for time in &mut run.times {
            time.start.drain(..filling.min(time.start.len()));
            time.nanoseconds.drain(..filling.min(time.nanoseconds.len()));
        }
        self.step = last;
        Ok(true)
    }

    fn overflowed(&mut self, submitted: u32, run: &mut Run) -> anyhow::Result<bool> {
        self.exec.finish()?;
        run.reports = (submitted + 1 - IN_FLIGHT..=submitted)
            .map(|step| self.status.report(step))
            .chain(run.reports.iter().map(|r| Ok(*r)))
            .collect::<Result<_, _>>()?;
        Ok(false)
    }

    /// Grows the entry capacity to the largest requirement of a run.
    fn grow(&mut self, run: &Run) -> anyhow::Result<()> {
        let required = run.reports.iter().map(|r| r.entries).max().unwrap_or(0);
        // Grows as in training. The warm-up sees every view, so no overflow disturbs the measurement.
        self.options.entry_capacity = required.saturating_add(required / 8);
        self.rebuild()?;
        Ok(self.status.clear_flags(&self.device)?)
    }

    /// Returns the loss gradient of the given Gaussians in the first view, by group.
    ///
    /// One step updates the Gaussians. Adam's first moments are a tenth of the gradient.
    ///
    /// # Errors
    /// If the device fails, or the tile entries overflow repeatedly.
    pub fn gradients(&mut self, data: &GaussianData) -> anyhow::Result<GaussianData> {
        for _ in 0..16 {
            self.gaussians.upload(&self.device, data)?;
            self.submit(1)?;
            self.exec.finish()?;
            let report = self.status.report(1)?;
            if report.flags != 0 {
                self.grow(&Run { reports: vec![report], ..Run::default() })?;
                continue;
            }
            let (mut moments, _) = self.gaussians.download_optimizer(&self.device)?;
            for group in &mut moments.groups {
                *group = group.chunks_exact(2).map(|m| 10.0 * m[0]).collect();
            }
            return Ok(moments);
        }
        anyhow::bail!("The tile entries overflow again and again.")
    }

    fn submit(&mut self, step: u32) -> anyhow::Result<()> {
        let view = self.schedule.view(step);
        let (camera, offset) = self.workload.views[view];
        let mut values = self.schedule.step(step, &camera, offset);
        if let Some((data, _)) = self.workload.semantics.as_deref() {
            data.views[view].fill(&mut values);
        }
        let Some(c) = &self.workload.correspondence else {
            self.exec.submit(&values)?;
            return Ok(());
        };
        let state = FrameRendering {
            sh_degree: values.sh_degree,
            background: values.background,
            largest: self.options.largest,
            entries: self.options.entry_capacity,
        };
        let (mut c, seed) = (locked(c)?, self.workload.settings.seed);
        let pseudo = c.steps(&self.device, &self.gaussians, &state, seed, view, &mut values)?;
        self.exec
            .submit_views(&values, &pseudo.context("The step has no pseudo-views: the workload has no regions.")?)?;
        Ok(())
    }

    fn rebuild(&mut self) -> anyhow::Result<()> {
        self.exec = build(&self.device, &self.tuning, self.workload, &self.gaussians, &self.status, self.options)?;
        Ok(())
    }

    /// Enables or disables timestamps.
    ///
    /// # Errors
    /// If memory runs out.
    pub fn set_timestamps(&mut self, on: bool) -> anyhow::Result<()> {
        self.options.timestamps = on;
        self.rebuild()
    }

    fn memory(&self) -> (u64, Activity) {
        (self.device.memory_use().0, self.device.activity())
    }

    /// Returns the plan of the step.
    pub fn plan(&mut self) -> std::sync::Arc<Plan> {
        self.exec.executor().plan().clone()
    }

    /// Returns the options of the step.
    pub fn options(&self) -> &GeometryOptions {
        &self.options
    }
}

fn build(
    device: &Device,
    tuning: &Tuning,
    workload: &Workload,
    gaussians: &Gaussians,
    status: &Status,
    options: GeometryOptions,
) -> anyhow::Result<GeometryStep> {
    let guard = match &workload.correspondence {
        Some(c) => Some(locked(c)?),
        None => None,
    };
    let mut inputs = workload.inputs();
    if let Some(c) = guard.as_deref() {
        c.bind(&mut inputs);
    }
    Ok(GeometryStep::new(device, tuning, gaussians, &inputs, status, options)?)
}

fn locked(c: &Mutex<Correspondence>) -> anyhow::Result<MutexGuard<'_, Correspondence>> {
    c.lock().map_err(|_| anyhow::anyhow!("A measurement has panicked."))
}

/// Returns the initial capacity of tile entries, as in training.
pub fn first_entry_capacity(gaussians: usize) -> u32 {
    u32::try_from(gaussians).unwrap_or(u32::MAX).clamp(1 << 14, 1 << 26)
}

#[cfg(test)]
mod tests {
    use super::*;
    use sgs_config::{Settings, accuracy_named};
    use sgs_engine::{DeviceOptions, Location};
    use sgs_passes::scene::Model;

    /// Returns a workload of Gaussians of degree 3, without views.
    fn workload(device: &Device, gaussians: usize, densify: bool) -> Workload {
        let model = Model { sh_degree: 3, ..Model::default() };
        let mut start = GaussianData::default();
        for group in model.groups() {
            start.groups[group as usize] = vec![0.5; gaussians * group.width() as usize];
        }
        let mut settings = Settings::default();
        if !densify {
            settings.geometry.densify.until = 0.0;
        }
        let largest = [32, 24];
        Workload {
            name: "none".to_owned(),
            model,
            start,
            targets: device.buffer("targets", 4 * 32 * 24, Location::Device).unwrap(),
            normals: None,
            semantics: None,
            correspondence: None,
            views: Vec::new(),
            largest,
            extent: 1.0,
            settings,
        }
    }

    /// Returns the bytes of state that a trainer allocates per further Gaussian.
    ///
    /// The state is parameters, moments and statistics.
    fn state(device: &Device, level: &str, densify: bool) -> f64 {
        let tuning = Settings::from_table(accuracy_named(level).unwrap()).unwrap().tuning(device.info());
        // Whole blocks of 32, also with the capacity for new Gaussians.
        let [(few, less), (many, more)] = [640, 1280].map(|gaussians| {
            let workload = workload(device, gaussians, densify);
            let trainer = Trainer::with(device, &workload, tuning, BackwardKernel::Pixel, false, 1 << 14).unwrap();
            (trainer.gaussians.capacity, trainer.gaussians.bytes())
        });
        (more - less) as f64 / f64::from(many - few)
    }

    #[test]
    fn state_of_a_gaussian_takes_the_documented_bytes() {
        let select = std::env::var("SGS_TEST_DEVICE").ok();
        let device = Device::open(&DeviceOptions { select, ..Default::default() }).unwrap();
        for (level, densify, bytes) in
            [("exact", false, 720.0), ("exact", true, 736.0), ("compact", false, 384.0), ("compact", true, 400.0)]
        {
            assert_eq!(state(&device, level, densify), bytes, "{level}, densification {densify}");
        }
    }
}
