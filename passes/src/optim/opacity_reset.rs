//! `opacity_reset`: clamps opacities to at most 0.01 and clears their moments.
//!
//! Kerbl et al. 2023, section 5.2. Guarantees: NaN logits become that of 0.01 as well. Cost per Gaussian: 4 bytes read,
//! 12 written.

use crate::Tuning;
use crate::kernel::stage;
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::opacity_reset;

/// Adds the pass. `live`: number of Gaussians, a `Work`.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn opacity_reset(
    g: &mut Graph,
    tuning: Tuning,
    live: Buffer,
    opacity_logits: Buffer,
    moments: Buffer,
) -> Result<(), GraphError> {
    let bindings = opacity_reset::Bindings {
        live: live.into(),
        opacity_logits: opacity_logits.into(),
        opacity_logits_moments: moments.into(),
    };
    let specs = opacity_reset::Specs { workgroup: tuning.workgroup };
    stage(g, "opacity_reset", &opacity_reset::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch_indirect(live, 0)
}
