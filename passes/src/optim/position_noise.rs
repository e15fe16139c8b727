//! `position_noise`: noise on the means of Gaussians after a step of Adam.
//!
//! Kheradmand et al. 2024, section 3.2. A mean moves by normal numbers times the covariance, `Step::noise`, and
//! 1 / (1 + exp(100 (opacity - 0.005))), if that is at least 1e-10. Guarantees: if the flag is set, or a number is not finite, nothing changes. The noise depends
//! only on the step's seed and the Gaussian's index. Cost per Gaussian: 16 bytes read; per Gaussian with an opacity below 0.23,
//! 32 bytes more, and 16 written.

use crate::Tuning;
use crate::kernel::{splat_specs, stage};
use crate::scene::Handles;
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::position_noise as kernel;

/// Adds the pass. `step` is the uniform of the step, `flags` its flag word.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn position_noise(
    g: &mut Graph,
    t: &Tuning,
    step: Buffer,
    gaussians: &Handles,
    flags: Buffer,
) -> Result<(), GraphError> {
    let bindings = kernel::Bindings {
        params: step.into(),
        live: gaussians.work.into(),
        flags: flags.into(),
        parameters: gaussians.parameters.into(),
    };
    let specs = splat_specs!(kernel, t, { workgroup: t.workgroup,
        columns: gaussians.columns(),
        moment_columns: gaussians.model.columns(),
        compact: gaussians.compact(), });
    stage(g, "position_noise", &kernel::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch_indirect(gaussians.work, 0)
}
