//! `opacity_reset`: clamps opacities to at most 0.01 and clears their moments.
//!
//! Kerbl et al. 2023, section 5.2. Guarantees: NaN logits become that of 0.01 as well. Cost per Gaussian: 4 bytes read,
//! 12 written.

use crate::Tuning;
use crate::kernel::stage;
use crate::scene::{Handles, MomentHandles};
use sgs_engine::graph::{Graph, GraphError};
use sgs_shaders::opacity_reset;

/// Adds the pass.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn opacity_reset(
    g: &mut Graph,
    tuning: Tuning,
    gaussians: &Handles,
    moments: &MomentHandles,
) -> Result<(), GraphError> {
    let bindings = opacity_reset::Bindings {
        live: gaussians.work.into(),
        parameters: gaussians.parameters.into(),
        first_moments: moments.first.into(),
        second_moments: moments.second.into(),
    };
    let specs = opacity_reset::Specs {
        workgroup: tuning.workgroup,
        columns: gaussians.columns(),
        moment_columns: gaussians.model.columns(),
        compact: gaussians.compact(),
    };
    stage(g, "opacity_reset", &opacity_reset::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch_indirect(gaussians.work, 0)
}
