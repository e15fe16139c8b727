//! `material_sum`: what the losses of materials came to, in a record of the step.
//!
//! Promises the same bits from run to run on a device. Cost: 4 bytes a workgroup of `compose`, 8 of `edge_aware`; one
//! workgroup. The photometric losses of the three pictures have records of their own ([`super::loss_sum`]).

use super::{CrossView, EdgeSums, MsgLoss, Saturated};
use crate::Tuning;
use crate::kernel::stage;
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::material_sum as kernel;

/// The losses that there are.
#[derive(Clone, Copy, Debug, Default)]
pub struct MaterialLosses {
    /// Pixels of the composed picture that are cut off.
    pub saturated: Option<Saturated>,
    /// Smoothness.
    pub edge: Option<EdgeSums>,
    /// Gradients against those of the priors.
    pub msg: Option<MsgLoss>,
    /// A region's albedo in several views.
    pub cross_view: Option<CrossView>,
    /// Albedo against estimates under other light; the first ones that there are.
    pub relight: [Option<MsgLoss>; 2],
    /// The same of roughness, which counts with `roughness_share` of what albedo does.
    pub relight_roughness: [Option<MsgLoss>; 2],
    /// See there.
    pub roughness_share: f32,
    /// Albedo of a region against the view's own prior.
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
    // What is absent is bound to something that the specialized kernel never touches.
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
        views: of.cross_view.map_or(0, |c| c.pictures),
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
