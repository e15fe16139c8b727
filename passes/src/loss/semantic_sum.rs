//! `semantic_sum`: sum of the semantic losses, added to the record of [`super::loss_sum`].
//!
//! Guarantees: results are bit-identical between runs on a device. Cost: 12 bytes per workgroup of the semantic loss, 4
//! of each pseudo-view's; one workgroup.

use super::correspondence::{Correspondence, Regions};
use super::semantic::SemanticSums;
use crate::Tuning;
use crate::kernel::stage;
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::semantic_sum as kernel;

/// Adds the pass that adds to `stats` (a `LossStats`). Without losses it adds no pass.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn semantic_sum(
    g: &mut Graph,
    tuning: Tuning,
    step: Buffer,
    semantic: Option<&SemanticSums>,
    correspondence: Option<(&Correspondence, &Regions)>,
    stats: Buffer,
) -> Result<(), GraphError> {
    // Absent inputs are bound to a buffer that specialized kernels never read.
    let Some(any) = semantic.map(|s| s.sums).or(correspondence.map(|c| c.0.sums)) else { return Ok(()) };
    let bindings = kernel::Bindings {
        params: step.into(),
        semantic_sums: semantic.map_or(any, |s| s.sums).into(),
        pair_sums: correspondence.map_or(any, |c| c.0.sums).into(),
        regions: correspondence.map_or(any, |c| c.1.buffer).into(),
        stats: stats.into(),
    };
    let pairs = correspondence.map_or(0, |c| c.1.pairs);
    let specs = kernel::Specs { workgroup: tuning.workgroup, semantic: semantic.is_some(), pairs };
    let push = kernel::Push {
        semantic_count: semantic.map_or(0, |s| s.count),
        pair_count: correspondence.map_or(0, |c| c.0.count),
        pair_pitch: correspondence.map_or(0, |c| c.0.pitch),
    };
    stage(g, "semantic_sum", &kernel::KERNEL, bindings.entries(), specs.entries(), bytemuck::bytes_of(&push))
        .dispatch([1, 1, 1])
}
