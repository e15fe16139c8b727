//! `material_sum`: sum of the material losses into a record of the step.
//!
//! Guarantees: results are bit-identical between runs on a device. Cost: 4 bytes per workgroup of `compose`, 8 of
//! `edge_aware`; one workgroup. The photometric losses of the three images have their own records
//! ([`super::loss_sum`]).

use super::{CrossView, EdgeSums, MsgLoss, Saturated};
use crate::Tuning;
use crate::kernel::stage;
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::material_sum as kernel;

/// Material losses of a step.
#[derive(Clone, Copy, Debug, Default)]
pub struct MaterialLosses {
    /// Counts of composed pixels clipped at white.
    pub saturated: Option<Saturated>,
    /// Edge-aware smoothness.
    pub edge: Option<EdgeSums>,
    /// Multi-scale gradient loss against the priors.
    pub msg: Option<MsgLoss>,
    /// Cross-view loss of a region's albedo.
    pub cross_view: Option<CrossView>,
    /// Albedo losses against estimates under other lights. Present ones come first.
    pub relight: [Option<MsgLoss>; 2],
    /// Roughness losses against the same estimates, weighted by `roughness_share`.
    pub relight_roughness: [Option<MsgLoss>; 2],
    /// Weight of roughness relative to albedo.
    pub roughness_share: f32,
    /// Loss of a region's albedo against the view's own prior.
    pub own_prior: Option<MsgLoss>,
}

/// Adds the pass that writes `stats` (a `MaterialStats`). `weights`: uniform `MaterialWeights`.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn material_sum(
    g: &mut Graph,
    tuning: Tuning,
    step: Buffer,
    weights: Buffer,
    of: &MaterialLosses,
    stats: Buffer,
) -> Result<(), GraphError> {
    // Absent inputs are bound to a buffer that the specialized kernel never reads.
    let results_of = |all: &[Option<MsgLoss>]| all.iter().flatten().map(|r| r.result).collect::<Vec<Buffer>>();
    let (results, gray) = (results_of(&of.relight), results_of(&of.relight_roughness));
    let parts = [
        of.saturated.map(|s| s.sums),
        of.edge.map(|e| e.sums),
        of.msg.map(|m| m.result),
        of.cross_view.map(|c| c.regions),
        results.first().copied(),
        of.own_prior.map(|o| o.result),
    ];
    let Some(any) = parts.iter().flatten().next().copied() else { return g.fill("material_sum", stats, 0) };
    let [compose_sums, edge_sums, msg, regions, relight_first, own] = parts.map(|p| p.unwrap_or(any).into());
    let bindings = kernel::Bindings {
        params: step.into(),
        loss_weights: weights.into(),
        compose_sums,
        edge_sums,
        msg,
        regions,
        relight_first,
        relight_second: results.get(1).copied().unwrap_or(any).into(),
        roughness_first: gray.first().copied().unwrap_or(any).into(),
        roughness_second: gray.get(1).copied().unwrap_or(any).into(),
        own,
        stats: stats.into(),
    };
    let specs = kernel::Specs {
        workgroup: tuning.workgroup,
        msg: of.msg.is_some(),
        views: of.cross_view.map_or(0, |c| c.images),
        estimates: results.len() as u32,
        gray_estimates: gray.len() as u32,
        own_prior: of.own_prior.is_some(),
    };
    let push = kernel::Push {
        compose_count: of.saturated.map_or(0, |s| s.count),
        edge_count: of.edge.map_or(0, |e| e.count),
        roughness_share: of.roughness_share,
    };
    stage(g, "material_sum", &kernel::KERNEL, bindings.entries(), specs.entries(), bytemuck::bytes_of(&push))
        .dispatch([1, 1, 1])
}
