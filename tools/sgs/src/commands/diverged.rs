//! What becomes of a training that has diverged.

use serde_json::json;
use sgs_train::{OnDivergence, RollBack, RunDirectory, Settings, TrainError};

/// Whether it may return to the last good state once more.
pub fn may_roll_back(settings: &Settings, before: &[RollBack]) -> bool {
    settings.train.on_divergence == OnDivergence::RollBack
        && (before.len() as u64) < u64::from(settings.train.roll_backs)
}

/// Says that it has.
pub fn say_roll_back(error: &TrainError, roll_backs: &[RollBack]) {
    if let (TrainError::Diverged { step, reason }, Some(RollBack { to, rates, .. })) = (error, roll_backs.last()) {
        tracing::warn!("At step {step} {reason}; it goes on from step {to} with learning rates times {rates}.");
    }
}

/// Says in the run that a stage has diverged, and to whom it concerns how to go on from what is kept.
pub fn diverged(
    run: &RunDirectory,
    stage: &str,
    error: TrainError,
    kept: u32,
    before: &[RollBack],
    lower: &str,
) -> anyhow::Result<anyhow::Error> {
    let times = match before.len() {
        0 => String::new(),
        n => format!(" It had gone back {n} times before."),
    };
    let TrainError::Diverged { step, .. } = error else { return Ok(error.into()) };
    let reason = error.to_string();
    run.set_diverged(&json!({"stage": stage, "step": step, "kept": kept, "reason": reason, "roll_backs": before}))?;
    Ok(anyhow::anyhow!(
        "{reason}{times} The state after step {kept} is kept: go on from it with --resume and lower learning rates (as {lower})."
    ))
}
