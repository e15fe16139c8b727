//! The geometry stage of `sgs train`: Gaussians into a run directory.

use super::diverged::{diverged, may_roll_back, say_roll_back};
use crate::common::Common;
use crate::ui::Bar;
use crate::watch::Watch;
use sgs_engine::Device;
use sgs_engine::graph::dump::{Track, html, trace};
use sgs_engine::graph::exec::PassTime;
use sgs_passes::pipeline::DensifyStats;
use sgs_scene::Scene;
use sgs_train::{
    Decision, Geometry, IdleLoss, OnDivergence, Progress, RollBack, RunDirectory, Settings, StepLog, TrainError,
};
use std::io::Write;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

/// Steps at the end whose passes are timed for `profile.json`.
const TIMED: u32 = 4;

/// How training ended.
pub enum Ended {
    /// With all steps.
    Done(Summary),
    /// Because somebody wanted it to, after this step.
    Stopped(u32),
}

/// What `training.json` holds.
#[derive(serde::Serialize)]
pub struct Summary {
    pub steps: u32,
    /// The step that this part of the training began after; seconds are those of this part.
    resumed_from: u32,
    pub seconds: f64,
    steps_per_second: f64,
    pub gaussians: u32,
    peak_device_bytes: u64,
    device: String,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    roll_backs: Vec<RollBack>,
    /// The highest band of spherical harmonics.
    sh_degree: u32,
    /// What was decided about the model, and why.
    decisions: Vec<Decision>,
    /// Losses that have a weight and did not run.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    warnings: Vec<IdleLoss>,
}

/// A line of `log.jsonl` between those of steps.
#[derive(serde::Serialize)]
struct DecisionLog<'a> {
    step: u32,
    decision: &'a Decision,
}

/// A line of `log.jsonl` about a densification: how many there were, went, came and are. Of those that went, `invalid` had numbers that are
/// not finite and `weightless` too little weight in pictures.
#[derive(serde::Serialize)]
struct DensifyLog {
    step: u32,
    densified: DensifyCounts,
}

#[derive(serde::Serialize)]
struct DensifyCounts {
    before: u32,
    pruned: u32,
    invalid: u32,
    weightless: u32,
    cloned: u32,
    split: u32,
    refused: u32,
    after: u32,
}

impl From<&DensifyStats> for DensifyCounts {
    fn from(s: &DensifyStats) -> DensifyCounts {
        let DensifyStats { before, after, pruned, invalid, weightless, cloned, split, refused } = *s;
        DensifyCounts { before, pruned, invalid, weightless, cloned, split, refused, after }
    }
}

/// Trains into a run directory, from its checkpoint on if it is resumed, until done or `stop` is raised; leaves all that
/// a run holds. `what`: the name of the progress. Somebody may watch.
pub fn train_into(
    common: &Common,
    device: &Device,
    scene: &Scene,
    settings: &Settings,
    output: &Path,
    resuming: bool,
    stop: &AtomicBool,
    what: &str,
    mut watch: Option<&mut Watch>,
) -> anyhow::Result<Ended> {
    let mut training = Geometry::new(device, scene, settings, None)?;
    if stop.load(Ordering::SeqCst) {
        return Ok(Ended::Stopped(0));
    }
    IdleLoss::warnings(training.idle_losses()).iter().for_each(|warning| tracing::warn!("{warning}"));
    // What was refused or stopped so far leaves nothing behind.
    let run = RunDirectory::create(output)?;
    if !resuming {
        run.forget()?;
    } else if run.checkpoint().is_file() {
        training.restore(&run.checkpoint())?;
    }
    run.write_settings(training.settings())?;
    let watched = settings.train.on_divergence != OnDivergence::GoOn;
    let kept = run.kept();
    // What a training that has diverged goes on from is good; where another was stopped, a kill may have come between.
    if run.has_diverged() && training.step() > 0 {
        kept.saved()?;
        kept.vouched_for()?;
    } else if watched && training.is_proposed() {
        kept.saved()?;
    }
    run.forget_diverged()?;
    let steps = settings.geometry.steps;
    let mut log = run.log(training.step())?;
    let mut bar = Bar::new(common, what, u64::from(steps), u64::from(training.step()));
    let started = Instant::now();
    let first = training.step();
    let interval = match settings.geometry.checkpoint_interval {
        0 => steps,
        n => n,
    };
    let mut failure = None;
    let teller = watch.as_ref().map(|w| w.teller());
    while training.step() < steps && !stop.load(Ordering::SeqCst) {
        let mut next = ((training.step() / interval + 1) * interval).min(steps);
        let timed = steps.saturating_sub(TIMED);
        if training.step() < timed {
            next = next.min(timed);
        } else {
            training.set_timestamps(true)?;
        }
        let rates = training.roll_backs().last().map_or(1.0, |r| r.rates);
        let heard = |p: &Progress| {
            let mut write = |line: serde_json::Result<String>| {
                if let Err(e) = writeln!(log, "{}", line.unwrap_or_default()) {
                    failure.get_or_insert(e);
                }
            };
            if let Progress::Decided(decision) = p {
                write(serde_json::to_string(&DecisionLog { step: decision.step, decision }));
                bar.say(&decision.to_string());
            }
            if let Progress::Densified { step, stats } = p {
                write(serde_json::to_string(&DensifyLog { step: *step, densified: stats.into() }));
            }
            if let Progress::Step(r) = p {
                if r.step % 10 == 0 || r.step == 1 || r.step == steps {
                    write(serde_json::to_string(&StepLog { rates, ..StepLog::from(r) }));
                }
                let said = || format!("loss {:.4}, {} Gaussians", r.losses.total, r.gaussians);
                bar.set(u64::from(r.step), said);
                if let Some(teller) = &teller {
                    teller.step("geometry", r.step, steps, |text| text.push_str(&said()));
                }
            }
        };
        let due = || watch.as_ref().is_some_and(|w| w.is_due());
        match training.train(next, heard, || !stop.load(Ordering::SeqCst) && !due()) {
            Err(error @ TrainError::Diverged { step, .. }) if watched => {
                let (chosen, before) = (training.settings().clone(), training.roll_backs().to_vec());
                if training.vouched_for() {
                    kept.vouched_for()?;
                }
                // Two would not fit into memory.
                drop(training);
                training = Geometry::new(device, scene, &chosen, None)?;
                if let Some(good) = kept.go_back()? {
                    training.restore(good)?;
                }
                if !may_roll_back(settings, &before) {
                    training.save(&run.checkpoint())?;
                    training.splats()?.write_ply(&run.path("scene.ply"))?;
                    if let Some(head) = training.head()? {
                        head.save(&run.semantics())?;
                    }
                    let factor = settings.geometry.rate_factor() * 0.1;
                    let lower = format!("--set geometry.rates.factor={factor:.3}");
                    kept.forget()?;
                    return Err(diverged(&run, "geometry", error, training.step(), &before, &lower)?);
                }
                training.roll_back(&before, step);
                say_roll_back(&error, training.roll_backs());
                log = run.log(training.step())?;
                continue;
            }
            other => other?,
        }
        let over = training.step() == steps;
        if let Some(watch) = watch.as_deref_mut().filter(|w| w.is_due() || over && w.shows_end()) {
            watch.geometry(&training);
        }
        // What was chosen by measurement belongs to the run.
        run.write_settings(training.settings())?;
        let step = training.step();
        if step > 0 && step % interval == 0 || step == steps || stop.load(Ordering::SeqCst) {
            if watched && training.vouched_for() {
                kept.vouched_for()?;
            }
            // Nobody goes back to where it was stopped by hand: the result would depend on it.
            let proposed = watched && step % interval == 0 && training.propose();
            training.save(&run.checkpoint())?;
            if proposed {
                kept.saved()?;
            }
        }
    }
    bar.finish();
    if let Some(e) = failure {
        tracing::warn!("log.jsonl could not be written: {e}");
    }
    if training.step() < steps {
        return Ok(Ended::Stopped(training.step()));
    }
    training.splats()?.write_ply(&run.path("scene.ply"))?;
    if let Some(head) = training.head()? {
        head.save(&run.semantics())?;
    }
    let times = training.take_times();
    write_profile(&run, "profile.json", "geometry step", &times)?;
    let page = html(training.executor()?.plan(), &times);
    sgs_scene::atomic_write(&run.path("graph.html"), |f| f.write_all(page.as_bytes()))?;
    let seconds = started.elapsed().as_secs_f64();
    let summary = Summary {
        steps,
        resumed_from: first,
        seconds,
        steps_per_second: f64::from(steps - first) / seconds.max(1e-9),
        gaussians: training.gaussians().count(device)?,
        peak_device_bytes: device.memory_use().1,
        device: device.info().name.clone(),
        roll_backs: training.roll_backs().to_vec(),
        sh_degree: training.gaussians().model.sh_degree,
        decisions: training.decisions().to_vec(),
        warnings: training.idle_losses().to_vec(),
    };
    run.write_json("training.json", &summary)?;
    kept.forget()?;
    Ok(Ended::Done(summary))
}

/// The last step as a Chrome trace.
pub fn write_profile(run: &RunDirectory, file: &str, name: &str, times: &[PassTime]) -> anyhow::Result<()> {
    let replay = times.iter().map(|t| t.start.len()).min().unwrap_or(0).saturating_sub(1);
    let text = trace(&[Track { name, times, replay }]);
    Ok(sgs_scene::atomic_write(&run.path(file), |f| f.write_all(text.as_bytes()))?)
}
