//! `loss_sum`: sum of all losses' workgroup sums, in a fixed order, into the record of the step.
//!
//! Guarantees: results are bit-identical between runs on a device. Cost: 8 bytes per workgroup of the photometric loss,
//! 16 of the geometry losses; one workgroup.

use super::GeometrySums;
use crate::Tuning;
use crate::kernel::stage;
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::loss_sum;

/// Adds the pass that writes `stats` (a `LossStats`). `photometric`: sums and number of workgroups.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn loss_sum(
    g: &mut Graph,
    tuning: Tuning,
    step: Buffer,
    photometric: (Buffer, u32),
    geometry: Option<GeometrySums>,
    stats: Buffer,
) -> Result<(), GraphError> {
    let bindings = loss_sum::Bindings {
        params: step.into(),
        photometric_sums: photometric.0.into(),
        geometry_sums: geometry.map_or(photometric.0, |g| g.sums).into(),
        stats: stats.into(),
    };
    let specs = loss_sum::Specs {
        workgroup: tuning.workgroup,
        geometry: geometry.is_some(),
        depth: geometry.is_some_and(|g| g.depth),
    };
    let push = loss_sum::Push { photometric_count: photometric.1, geometry_count: geometry.map_or(0, |g| g.count) };
    stage(g, "loss_sum", &loss_sum::KERNEL, bindings.entries(), specs.entries(), bytemuck::bytes_of(&push))
        .dispatch([1, 1, 1])
}
