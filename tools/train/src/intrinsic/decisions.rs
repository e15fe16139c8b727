//! Decisions that follow from data, settings and memory before the first step.

use super::Intrinsic;
use super::consistency::{CONSISTENCY_INTERVAL, StepKind};
use crate::decision::Decision;
use crate::error::Result;
use sgs_config::{IntrinsicSettings, Metallic, Settings};
use sgs_engine::Device;
use sgs_scene::{Scene, Splats};

fn of(what: &str, on: bool, reason: String, setting: &str) -> Decision {
    let (what, setting) = (what.to_owned(), setting.to_owned());
    Decision { step: 0, what, on, reason, measured: None, requested: None, setting }
}

/// Adds the decisions that need no measurement.
/// `answers`: whether metallic priors exist; `regions`: whether regions exist; `kinds`: which kinds of steps will occur.
pub(super) fn add(
    decisions: &mut Vec<Decision>,
    s: &IntrinsicSettings,
    answers: bool,
    regions: bool,
    kinds: [bool; StepKind::ALL.len()],
) {
    if !decisions.iter().any(|d| d.what == "metallic") {
        let (on, reason) = match (s.metallic, answers) {
            (Metallic::Off, _) => (false, "switched off"),
            (Metallic::On, _) => (true, "asked for"),
            (Metallic::Auto, true) => (true, "the scene has metallic priors"),
            (Metallic::Auto, false) => (false, "no prior of metallic says anything, or its loss weighs nothing"),
        };
        decisions.push(of("metallic", on, reason.to_owned(), "intrinsic.metallic"));
    }
    let compared = |kind: StepKind, weight: f32, from: u32, else_missing: &str| {
        let on = kinds[kind as usize];
        let reason = match (on, weight > 0.0, regions) {
            (true, ..) => format!("once in {CONSISTENCY_INTERVAL} steps from step {from} on"),
            (_, false, _) => "its loss weighs nothing".to_owned(),
            _ if from > s.steps => format!("there is none before step {from}, and training ends at {}", s.steps),
            (.., false) => "there are no regions".to_owned(),
            (.., true) => else_missing.to_owned(),
        };
        (on, reason)
    };
    let none = "there is no step for it";
    let (on, reason) = compared(StepKind::CrossView, s.losses.cross_view, 1, none);
    decisions.push(of("albedo between views", on, reason, "intrinsic.losses.cross_view"));
    let none = "there are neither albedo priors nor a provider";
    let weight = s.relight_weight() + s.own_prior_weight();
    let (on, reason) = compared(StepKind::Relight, weight, s.relight_from, none);
    decisions.push(of("albedo under other lights", on, reason, "intrinsic.losses.relight"));
}

/// Returns the lowest and the highest gain.
fn range(log_gains: &[[f32; 3]]) -> (f32, f32) {
    let gains = log_gains.iter().flatten().map(|g| g.exp());
    gains.fold((1.0_f32, 1.0_f32), |(low, high), g| (low.min(g), high.max(g)))
}

/// Makes the decision about the gains of roughness priors.
pub(super) fn equal_priors(log_gains: &[[f32; 3]]) -> Decision {
    let (low, high) = range(log_gains);
    let reason = format!("views of roughness priors differ by gains of {low:.2} to {high:.2}");
    of("corrected roughness priors", true, reason, "intrinsic.losses.roughness")
}

/// Makes the decision about the light and the gains of albedo priors.
pub(super) fn corrected_priors(residue: f64, log_gains: &[[f32; 3]]) -> Decision {
    let (low, high) = range(log_gains);
    let reason = format!(
        "albedo priors retain the light of their photographs to the power {residue:.2}, and their views differ by gains of {low:.2} to {high:.2}"
    );
    of("corrected albedo priors", true, reason, "intrinsic.losses.albedo")
}

/// Makes the decision that surfaces of views are not stored.
pub(super) fn without_surfaces(s: &IntrinsicSettings, bytes: u64) -> Decision {
    let (why, setting) = match s.surface_bytes {
        0 => ("memory is short", "memory.budget"),
        _ => ("it is more than was allowed", "intrinsic.surface_bytes"),
    };
    let reason = format!("{why}: it takes {bytes} bytes, and is recomputed in each step");
    of("what views see of the geometry", false, reason, setting)
}

impl Intrinsic {
    /// Prepares training like [`Intrinsic::new`], with fewer splats if memory is short.
    /// This applies only to an explicit `memory.budget`. The faintest splats are removed, with a decision that records
    /// this. If no number of splats fits, returns the error with the figures of all splats.
    ///
    /// # Errors
    /// If data cannot be read, or memory runs out.
    pub fn within(device: &Device, scene: &Scene, settings: &Settings, splats: &mut Splats) -> Result<Intrinsic> {
        let refused = match Intrinsic::new(device, scene, settings, splats) {
            Err(e) if e.is_out_of_memory() && settings.memory.budget > 0 => e,
            other => return other,
        };
        let all = splats.len();
        let mut keep = all;
        while keep > 1 {
            keep -= keep.div_ceil(8);
            let some = splats.strongest(keep);
            match Intrinsic::new(device, scene, settings, &some) {
                Err(e) if e.is_out_of_memory() => {}
                Err(e) => return Err(e),
                Ok(mut training) => {
                    *splats = some;
                    training.decisions.push(fewer_splats(keep, all, settings.memory.budget));
                    return Ok(training);
                }
            }
        }
        Err(refused)
    }
}

/// Makes the decision that memory does not suffice for all splats.
fn fewer_splats(keep: usize, all: usize, budget: u64) -> Decision {
    let mib = budget as f64 / f64::from(1 << 20);
    let reason = format!("materials and lights of all do not fit into {mib:.1} MiB; {keep} of {all} splats are left");
    Decision::of_memory(0, "the faintest splats", reason)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn initial_decisions_state_their_reasons() {
        let mut s = IntrinsicSettings { steps: 100, relight_from: 200, ..Default::default() };
        let decided = |s: &IntrinsicSettings, answers, regions, kinds| {
            let mut all = Vec::new();
            add(&mut all, s, answers, regions, kinds);
            all.iter().map(ToString::to_string).collect::<Vec<_>>()
        };
        let [metallic, cross, relight] = &decided(&s, true, true, [true, true, false])[..] else {
            panic!("three are said")
        };
        assert_eq!(metallic, "metallic kept: the scene has metallic priors (intrinsic.metallic)");
        assert!(cross.starts_with("albedo between views kept: once in 3 steps from step 1 on"), "{cross}");
        assert!(relight.contains("left out: there is none before step 200, and training ends at 100"), "{relight}");
        (s.metallic, s.losses.cross_view, s.relight_from) = (Metallic::Off, 0.0, 1);
        let [metallic, cross, relight] = &decided(&s, false, false, [true, false, false])[..] else {
            panic!("three are said")
        };
        assert!(metallic.contains("left out: switched off") && cross.contains("weighs nothing"), "{metallic} {cross}");
        assert!(relight.contains("there are no regions"), "{relight}");
        // A measured decision is not added a second time.
        let mut all = vec![of("metallic", false, "measured".into(), "intrinsic.automatic.parts")];
        add(&mut all, &s, true, true, [true; 3]);
        assert_eq!(all.iter().filter(|d| d.what == "metallic").count(), 1);
    }
}
