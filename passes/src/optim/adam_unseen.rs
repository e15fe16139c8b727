//! `adam_unseen`: Adam for Gaussians that the fused update of a step did not move.
//!
//! Where other views left them a gradient they follow it. Otherwise it is zero: their moments decay and carry them on for a
//! while, as in 3DGS (Kerbl et al. 2023), or, if Adam is sparse, they stay as they are. Gaussians with a gradient in the
//! group that is not finite are skipped in this group, and counted. Cost a scalar of what was not seen: 12 bytes read, 12
//! written, 4 more read for a gradient.

use crate::Tuning;
use crate::kernel::stage;
use crate::optim::Rate;
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::adam_unseen as kernel;

/// Gradients of a group, somewhere in rows by Gaussian.
#[derive(Clone, Copy, Debug)]
pub struct Rows {
    /// The rows.
    pub buffer: Buffer,
    /// Scalars of a row.
    pub stride: u32,
    /// Where in a row the group begins.
    pub first: u32,
}

/// A parameter group, and which of its Gaussians were seen.
#[derive(Clone, Copy, Debug)]
pub struct AdamUnseen {
    /// Uniform `Step`: learning rates and bias corrections.
    pub step: Buffer,
    /// A `Work`: the number of Gaussians.
    pub live: Buffer,
    /// A word that is not zero when the step must change nothing.
    pub flags: Buffer,
    /// A word a Gaussian: not zero if it was updated, or skipped, already.
    pub seen: Buffer,
    /// Scalars of a Gaussian.
    pub width: u32,
    /// The learning rate; not a constant one.
    pub rate: Rate,
    /// Parameters.
    pub parameters: Buffer,
    /// First and second moments.
    pub moments: Buffer,
    /// What other views left; without, all gradients are zero.
    pub gradients: Option<Rows>,
    /// Whether an exactly-zero gradient leaves its scalar and moments untouched.
    pub sparse: bool,
    /// A counter, increased by the number of skipped Gaussians.
    pub skipped: Buffer,
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
        gradients: a.gradients.map_or(a.seen, |r| r.buffer).into(),
        skipped: a.skipped.into(),
    };
    let specs = kernel::Specs {
        workgroup: t.workgroup,
        width: a.width,
        rate: a.rate.index(),
        stride: a.gradients.map_or(0, |r| r.stride),
        first: a.gradients.map_or(0, |r| r.first),
        sparse: a.sparse,
    };
    stage(g, name, &kernel::KERNEL, bindings.entries(), specs.entries(), &[]).dispatch_indirect(a.live, 0)
}
