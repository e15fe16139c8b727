//! Lines of the geometry stage in `log.jsonl`.

use crate::stage::StepFigures;
use serde::Serialize;
use sgs_passes::pipeline::StepReport;
use std::fmt;

/// Line of `log.jsonl`.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct StepLog {
    /// The step.
    pub step: u32,
    /// Weighted sum of all losses.
    pub loss: f32,
    /// Mean absolute difference.
    pub l1: f32,
    /// SSIM.
    pub ssim: f32,
    /// One minus the cosine to the normal prior.
    pub normal: f32,
    /// Relative difference from prior depths.
    pub depth: f32,
    /// One minus the cosine to the semantic prior.
    pub semantic: f32,
    /// Cross-entropy of the classes.
    pub semantic_class: f32,
    /// Distance of a region's features between views.
    pub correspondence: f32,
    /// Cross-entropy of the region's class in the pseudo-views.
    pub correspondence_class: f32,
    /// Number of Gaussians.
    pub gaussians: u32,
    /// Number of Gaussians that are visible in the view.
    pub visible: u32,
    /// Number of tile entries.
    pub entries: u32,
    /// Number of splats skipped since the start. Their gradients were not finite.
    pub skipped: u32,
    /// Factor of the rollbacks on learning rates. Absent without rollbacks.
    #[serde(skip_serializing_if = "is_one")]
    pub rates: f64,
}

impl From<&StepReport> for StepLog {
    fn from(r: &StepReport) -> StepLog {
        StepLog {
            step: r.step,
            loss: r.losses.total,
            l1: r.losses.l1,
            ssim: r.losses.ssim,
            normal: r.losses.normal,
            depth: r.losses.depth,
            semantic: r.losses.semantic,
            semantic_class: r.losses.semantic_class,
            correspondence: r.losses.correspondence,
            correspondence_class: r.losses.correspondence_class,
            gaussians: r.gaussians,
            visible: r.visible,
            entries: r.entries,
            skipped: r.skipped,
            rates: 1.0,
        }
    }
}

fn is_one(rates: &f64) -> bool {
    *rates == 1.0
}

impl fmt::Display for Figures<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "loss {:.4}, {} Gaussians", self.0.losses.total, self.0.gaussians)
    }
}

/// Figures of a step.
pub(super) struct Figures<'a>(pub &'a StepReport);

impl StepFigures for Figures<'_> {
    fn step(&self) -> u32 {
        self.0.step
    }

    fn loss(&self) -> f32 {
        self.0.losses.total
    }

    fn gaussians(&self) -> u32 {
        self.0.gaussians
    }

    fn log_line(&self, rates: f64) -> serde_json::Result<String> {
        serde_json::to_string(&StepLog { rates, ..StepLog::from(self.0) })
    }
}
