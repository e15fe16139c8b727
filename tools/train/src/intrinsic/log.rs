//! Lines of the intrinsic stage in `log.jsonl`.

use crate::stage::StepFigures;
use serde::Serialize;
use sgs_passes::pipeline::IntrinsicReport;
use sgs_run::StageKind;
use std::fmt;

/// Line of `log.jsonl` of the intrinsic stage.
/// A loss that does not run has no key. A loss that does not run in every step has the value of the last step that ran
/// it.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct IntrinsicLog {
    /// Stage: `intrinsic`, or `transport` under the lights of a room.
    pub stage: StageKind,
    /// The step.
    pub step: u32,
    /// Weighted loss of the shaded image.
    pub shaded: f32,
    /// Mean absolute difference of the shaded image.
    pub l1: f32,
    /// SSIM of the shaded image.
    pub ssim: f32,
    /// Weighted photometric loss of albedo against the prior.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub albedo: Option<f32>,
    /// Weighted photometric loss of roughness against the prior.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub roughness: Option<f32>,
    /// Weighted photometric loss of metallic against the prior.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub metallic: Option<f32>,
    /// Multi-scale gradient loss of albedo against the prior.
    /// This loss and all that follow are before their weights.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub albedo_gradients: Option<f32>,
    /// Multi-scale gradient loss of roughness against the prior.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub roughness_gradients: Option<f32>,
    /// Edge-aware smoothness of albedo.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub albedo_smooth: Option<f32>,
    /// Edge-aware smoothness of roughness.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub roughness_smooth: Option<f32>,
    /// Smoothness of the environment map.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub environment_smooth: Option<f32>,
    /// Nearness of lights to surfaces.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub light_position: Option<f32>,
    /// Amplitudes of lights.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub light_value: Option<f32>,
    /// Change of visibility under a jitter of points and lights.
    /// The value is the mean over pixels and lights.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub visibility_jitter: Option<f32>,
    /// L_cross_semantic.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cross_view: Option<f32>,
    /// L_relight.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub relight: Option<f32>,
    /// Albedo of a region against the view's own prior.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub own_prior: Option<f32>,
    /// Number of gradients skipped because they were not finite.
    /// Counts since the start or the last restore.
    pub skipped: u32,
    /// Factor of the rollbacks on learning rates; absent without rollbacks.
    #[serde(skip_serializing_if = "is_one")]
    pub rates: f64,
}

/// Losses of the intrinsic stage that run in each step; for the last one its weight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LoggedLosses {
    /// Albedo against the prior.
    pub albedo: bool,
    /// Roughness against the prior.
    pub roughness: bool,
    /// Metallic against the prior.
    pub metallic: bool,
    /// Gradients of albedo.
    pub albedo_gradients: bool,
    /// Gradients of roughness.
    pub roughness_gradients: bool,
    /// Smoothness of albedo.
    pub albedo_smooth: bool,
    /// Smoothness of roughness.
    pub roughness_smooth: bool,
    /// Smoothness of the environment map.
    pub environment_smooth: bool,
    /// Nearness of lights to surfaces.
    pub light_position: bool,
    /// Amplitudes of lights.
    pub light_value: bool,
    /// Weight of the visibility field's jitter; 0 if this loss does not run.
    pub visibility_jitter: f32,
}

impl IntrinsicLog {
    /// Makes the line of a step.
    ///
    /// `stage`: the stage that the line belongs to, and the number of its steps before these.
    pub fn of((stage, before): (StageKind, u32), r: &IntrinsicReport, runs: &LoggedLosses, rates: f64) -> IntrinsicLog {
        let m = &r.materials;
        let seen = |value: f32| (value >= 0.0).then_some(value);
        IntrinsicLog {
            stage,
            step: before + r.step,
            shaded: r.shaded,
            l1: r.shaded_l1,
            ssim: r.shaded_ssim,
            albedo: runs.albedo.then_some(r.albedo),
            roughness: runs.roughness.then_some(r.roughness),
            metallic: runs.metallic.then_some(r.metallic),
            albedo_gradients: runs.albedo_gradients.then_some(m.albedo_msg),
            roughness_gradients: runs.roughness_gradients.then_some(m.roughness_msg),
            albedo_smooth: runs.albedo_smooth.then_some(m.albedo_edge),
            roughness_smooth: runs.roughness_smooth.then_some(m.roughness_edge),
            environment_smooth: runs.environment_smooth.then_some(r.environment_smooth),
            light_position: runs.light_position.then_some(r.light_position),
            light_value: runs.light_value.then_some(r.light_value),
            visibility_jitter: (runs.visibility_jitter > 0.0).then(|| r.visibility_jitter / runs.visibility_jitter),
            cross_view: seen(r.recent_cross_view),
            relight: seen(r.recent_relight),
            own_prior: seen(r.recent_own_prior),
            skipped: r.skipped,
            rates,
        }
    }
}

fn is_one(rates: &f64) -> bool {
    *rates == 1.0
}

/// Figures of a step.
pub(super) struct Figures<'a> {
    /// Stage, and the number of its steps before these.
    pub of: (StageKind, u32),
    pub report: &'a IntrinsicReport,
    pub losses: &'a LoggedLosses,
    pub gaussians: u32,
}

impl fmt::Display for Figures<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "loss {:.4}, albedo {:.4}", self.report.shaded, self.report.albedo)
    }
}

impl StepFigures for Figures<'_> {
    fn step(&self) -> u32 {
        self.of.1 + self.report.step
    }

    fn loss(&self) -> f32 {
        self.report.shaded
    }

    fn gaussians(&self) -> u32 {
        self.gaussians
    }

    fn log_line(&self, rates: f64) -> serde_json::Result<String> {
        serde_json::to_string(&IntrinsicLog::of(self.of, self.report, self.losses, rates))
    }
}
