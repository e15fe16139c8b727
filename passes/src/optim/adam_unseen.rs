//! `adam_unseen`: the rest of dense Adam, for Gaussians that the step did not see.
//!
//! Their gradient is zero, so their moments decay and carry them on for a while, as in 3DGS (Kerbl et al. 2023). Left
//! out by default: what is not seen stays as it is. Cost a scalar of what is not seen: 12 bytes read, 12 written.

use crate::Tuning;
use crate::kernel::stage;
use crate::optim::Rate;
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::adam_unseen as kernel;

/// A parameter group, and which of its Gaussians were seen.
#[derive(Clone, Copy, Debug)]
pub struct AdamUnseen {
    /// Uniform `Step`: learning rates and bias corrections.
    pub step: Buffer,
    /// A `Work`: the number of Gaussians.
    pub live: Buffer,
    /// A word that is not zero when the step must change nothing.
    pub flags: Buffer,
    /// A word a Gaussian: not zero if it was updated already.
    pub seen: Buffer,
    /// Scalars of a Gaussian.
    pub width: u32,
    /// The learning rate; not a constant one.
    pub rate: Rate,
    /// Parameters.
    pub parameters: Buffer,
    /// First and second moments.
    pub moments: Buffer,
}

/// Adds the pass.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn adam_unseen(g: &mut Graph, t: &Tuning, name: &str, a: &AdamUnseen) -> Result<(), GraphError> {
    let bindings = kernel::Bindings {
        params: a.step.into(),
        live: a.live.into(),
        flags: a.flags.into(),
        seen: a.seen.into(),
        parameters: a.parameters.into(),
        moments: a.moments.into(),
    };
    let specs = kernel::Specs { workgroup: t.workgroup, width: a.width, rate: a.rate.index() };
    stage(g, name, &kernel::KERNEL, bindings.entries(), specs.entries(), &[]).dispatch_indirect(a.live, 0)
}
