//! The intrinsic stage of `sgs train`: materials, lights and shadows into a run directory that has geometry.

use super::diverged::{diverged, may_roll_back, say_roll_back};
use super::geometry::write_profile;
use crate::common::Common;
use crate::ui::Bar;
use crate::watch::Watch;
use anyhow::bail;
use sgs_engine::Device;
use sgs_engine::graph::dump::html;
use sgs_scene::Scene;
use sgs_train::{
    Decision, IdleLoss, Intrinsic, IntrinsicLog, OnDivergence, RollBack, RunDirectory, Settings, TrainError,
    read_splats,
};
use std::io::Write;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

/// Steps at the end whose passes are timed.
const TIMED: u32 = 4;

/// What `training.json` holds of the stage.
#[derive(serde::Serialize)]
pub struct IntrinsicSummary {
    pub steps: u32,
    resumed_from: u32,
    pub seconds: f64,
    steps_per_second: f64,
    peak_device_bytes: u64,
    device: String,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    roll_backs: Vec<RollBack>,
    /// What was decided about the model, and why.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    decisions: Vec<Decision>,
    /// Losses that have a weight and did not run.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    warnings: Vec<IdleLoss>,
}

/// A line of `log.jsonl` between those of steps.
#[derive(serde::Serialize)]
struct DecisionLog<'a> {
    stage: &'static str,
    step: u32,
    decision: &'a Decision,
}

/// How it ended.
pub enum IntrinsicEnded {
    /// With all steps.
    Done(IntrinsicSummary),
    /// Because somebody wanted it to, after this step.
    Stopped(u32),
}

/// Trains into a run directory, from its checkpoint on if it is resumed, until done or `stop` is raised. Of geometry that has `just_trained`
/// the faintest splats may go where memory was promised that does not suffice for all. Somebody may watch.
pub fn intrinsic_into(
    common: &Common,
    device: &Device,
    scene: &Scene,
    settings: &Settings,
    output: &Path,
    start: Option<&Path>,
    resuming: bool,
    just_trained: bool,
    stop: &AtomicBool,
    mut watch: Option<&mut Watch>,
) -> anyhow::Result<IntrinsicEnded> {
    let geometry = output.join("scene.ply");
    let from = match start {
        Some(file) if !resuming => file,
        _ => geometry.as_path(),
    };
    if !from.is_file() {
        bail!(
            "\"{}\" holds no geometry: train it first with --stage geometry or all, or give it with --start.",
            from.display()
        );
    }
    let mut splats = read_splats(from)?;
    // The stage begins afresh or from its checkpoint, never from what an earlier one came to.
    (splats.albedo, splats.roughness, splats.metallic) = (None, None, None);
    let all = splats.len();
    let mut training = match just_trained && !resuming {
        true => Intrinsic::within(device, scene, settings, &mut splats)?,
        false => Intrinsic::new(device, scene, settings, &splats)?,
    };
    IdleLoss::warnings(training.idle_losses()).iter().for_each(|warning| tracing::warn!("{warning}"));
    let run = RunDirectory::create(output)?;
    if resuming {
        training.restore(&run.intrinsic_checkpoint())?;
    } else {
        run.forget_intrinsic()?;
        // Resuming needs nothing but the run.
        if start.is_some() || splats.len() < all {
            splats.write_ply(&geometry)?;
        }
    }
    run.write_settings(training.settings())?;
    let watched = settings.train.on_divergence != OnDivergence::GoOn;
    let kept = run.intrinsic_kept();
    // What a training that has diverged goes on from is good; where another was stopped, a kill may have come between.
    if run.has_diverged() && training.step() > 0 {
        kept.saved()?;
        kept.vouched_for()?;
    } else if watched && training.is_proposed() {
        kept.saved()?;
    }
    run.forget_diverged()?;
    let steps = settings.intrinsic.steps;
    let mut log = run.intrinsic_log(training.step())?;
    let mut bar = Bar::new(common, "materials", u64::from(steps), u64::from(training.step()));
    let started = Instant::now();
    let first = training.step();
    let interval = match settings.intrinsic.checkpoint_interval {
        0 => steps.max(1),
        n => n,
    };
    let mut failure = None;
    let mut told = if resuming { training.decisions().len() } else { 0 };
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
        let runs = training.logged_losses();
        let heard = |r: &sgs_passes::pipeline::IntrinsicReport| {
            if r.step.is_multiple_of(10) || r.step == 1 || r.step == steps {
                let line = serde_json::to_string(&IntrinsicLog::of(r, &runs, rates)).unwrap_or_default();
                if let Err(e) = writeln!(log, "{line}") {
                    failure.get_or_insert(e);
                }
            }
            let said = || format!("picture {:.4}, albedo {:.4}", r.shaded, r.albedo);
            bar.set(u64::from(r.step), said);
            if let Some(teller) = &teller {
                teller.step("materials", r.step, steps, |text| text.push_str(&said()));
            }
        };
        let due = || watch.as_ref().is_some_and(|w| w.is_due());
        match training.train(next, heard, || !stop.load(Ordering::SeqCst) && !due()) {
            Err(error @ TrainError::Diverged { step, .. }) if watched => {
                let before = training.roll_backs().to_vec();
                if training.vouched_for() {
                    kept.vouched_for()?;
                }
                // Two would not fit into memory.
                drop(training);
                training = Intrinsic::new(device, scene, settings, &splats)?;
                if let Some(good) = kept.go_back()? {
                    training.restore(good)?;
                }
                if !may_roll_back(settings, &before) {
                    training.save(&run.intrinsic_checkpoint())?;
                    training.write(&run)?;
                    let lower = format!("--set intrinsic.rates.lights={:.5}", settings.intrinsic.rates.lights * 0.1);
                    kept.forget()?;
                    return Err(diverged(&run, "intrinsic", error, training.step(), &before, &lower)?);
                }
                training.roll_back(&before, step);
                say_roll_back(&error, training.roll_backs());
                log = run.intrinsic_log(training.step())?;
                // What is decided again is said again: its lines are gone.
                told = training.decisions().len();
                continue;
            }
            other => other?,
        }
        let over = training.step() == steps;
        if let Some(watch) = watch.as_deref_mut().filter(|w| w.is_due() || over && w.shows_end()) {
            watch.intrinsic(&training);
        }
        for decision in training.decisions().iter().skip(told) {
            let line = serde_json::to_string(&DecisionLog { stage: "intrinsic", step: decision.step, decision })
                .unwrap_or_default();
            if let Err(e) = writeln!(log, "{line}") {
                failure.get_or_insert(e);
            }
            bar.say(&decision.to_string());
        }
        told = training.decisions().len();
        let step = training.step();
        if step > 0 && step % interval == 0 || step == steps || stop.load(Ordering::SeqCst) {
            if watched && training.vouched_for() {
                kept.vouched_for()?;
            }
            // Nobody goes back to where it was stopped by hand: the result would depend on it.
            let proposed = watched && step % interval == 0 && training.propose();
            training.save(&run.intrinsic_checkpoint())?;
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
        return Ok(IntrinsicEnded::Stopped(training.step()));
    }
    training.write(&run)?;
    let times = training.take_times();
    if !times.is_empty() {
        write_profile(&run, "profile-intrinsic.json", "intrinsic step", &times)?;
        let page = html(training.executor()?.executor().plan(), &times);
        sgs_scene::atomic_write(&run.path("graph-intrinsic.html"), |f| f.write_all(page.as_bytes()))?;
    }
    let seconds = started.elapsed().as_secs_f64();
    let summary = IntrinsicSummary {
        steps,
        resumed_from: first,
        seconds,
        steps_per_second: f64::from(steps - first) / seconds.max(1e-9),
        peak_device_bytes: device.memory_use().1,
        device: device.info().name.clone(),
        roll_backs: training.roll_backs().to_vec(),
        decisions: training.decisions().to_vec(),
        warnings: training.idle_losses().to_vec(),
    };
    run.add_intrinsic_summary(&summary)?;
    kept.forget()?;
    Ok(IntrinsicEnded::Done(summary))
}
