//! Summary of a stage in `training.json`. Also the lines of `log.jsonl` that describe no step.

use crate::decision::Decision;
use crate::divergence::RollBack;
use crate::idle::IdleLoss;
use crate::stage::RoomFit;
use serde::Serialize;
use sgs_passes::pipeline::DensifyStats;
use sgs_run::StageKind;

/// Summary of a finished stage.
#[derive(Clone, Debug, Serialize)]
pub struct StageSummary {
    /// Number of steps.
    pub steps: u32,
    /// Step that training resumed after; 0 for a training from the start. `seconds` counts from there.
    pub resumed_from: u32,
    /// Seconds of training, without preparation.
    pub seconds: f64,
    /// Steps per second.
    pub steps_per_second: f64,
    /// Number of Gaussians, where the stage changes it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gaussians: Option<u32>,
    /// Peak device memory in bytes.
    pub peak_device_bytes: u64,
    /// Name of the device.
    pub device: String,
    /// Rollbacks after divergence.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub roll_backs: Vec<RollBack>,
    /// Highest band of spherical harmonics, where the stage trains them.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sh_degree: Option<u32>,
    /// PSNR and emitters, where the stage fits a room.
    #[serde(flatten, skip_serializing_if = "Option::is_none")]
    pub room: Option<RoomFit>,
    /// Decisions of automatic model selection.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub decisions: Vec<Decision>,
    /// Losses that have a weight and did not run.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub warnings: Vec<IdleLoss>,
}

/// Decision in `log.jsonl`. Lines of the geometry stage have no `stage`.
#[derive(Serialize)]
pub(super) struct DecisionLine<'a> {
    #[serde(skip_serializing_if = "Option::is_none")]
    stage: Option<&'static str>,
    step: u32,
    decision: &'a Decision,
}

impl<'a> DecisionLine<'a> {
    pub fn new(stage: StageKind, decision: &'a Decision) -> DecisionLine<'a> {
        DecisionLine { stage: (stage != StageKind::Geometry).then(|| stage.name()), step: decision.step, decision }
    }
}

/// Densification in `log.jsonl`.
#[derive(Serialize)]
pub(super) struct DensifyLine {
    step: u32,
    densified: DensifyCounts,
}

/// Counts of Gaussians. Of the pruned ones, `invalid` had values that are not finite, and `weightless` too little
/// blending weight.
#[derive(Serialize)]
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

impl DensifyLine {
    pub fn new(step: u32, stats: &DensifyStats) -> DensifyLine {
        let DensifyStats { before, after, pruned, invalid, weightless, cloned, split, refused } = *stats;
        let densified = DensifyCounts { before, pruned, invalid, weightless, cloned, split, refused, after };
        DensifyLine { step, densified }
    }
}
