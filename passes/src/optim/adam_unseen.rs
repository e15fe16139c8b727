//! `adam_unseen`: Adam for Gaussians that the fused update of a step did not move.
//!
//! Gaussians with gradients from other views follow them. Otherwise the gradient is zero. Dense Adam lets their moments
//! decay and continues to move them, as in 3DGS (Kerbl et al. 2023); sparse Adam leaves them unchanged. A Gaussian with
//! a non-finite gradient in the group is skipped in this group and counted. Cost per scalar of an unseen Gaussian: 12
//! bytes read, 12 written, and 4 more read for a gradient.

use crate::Tuning;
use crate::kernel::stage;
use crate::optim::Rate;
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::adam_unseen as kernel;

/// Gradients of a group, stored in rows by Gaussian.
#[derive(Clone, Copy, Debug)]
pub struct Rows {
    /// Buffer of the rows.
    pub buffer: Buffer,
    /// Scalars per row.
    pub stride: u32,
    /// Position of the group's first scalar in a row.
    pub first: u32,
}

/// Inputs for a parameter group, and a record of its updated Gaussians.
#[derive(Clone, Copy, Debug)]
pub struct AdamUnseen {
    /// Uniform `Step`: learning rates and bias corrections.
    pub step: Buffer,
    /// Number of Gaussians, a `Work`.
    pub live: Buffer,
    /// Flag word. If it is not zero, the step changes nothing.
    pub flags: Buffer,
    /// One word per Gaussian: not zero if it was already updated or skipped.
    pub seen: Buffer,
    /// Scalars per Gaussian.
    pub width: u32,
    /// Learning rate of the group, which must not be constant.
    pub rate: Rate,
    /// Parameters.
    pub parameters: Buffer,
    /// First and second moments.
    pub moments: Buffer,
    /// Gradients from other views. Without them all gradients are zero.
    pub gradients: Option<Rows>,
    /// Whether a zero gradient leaves its scalar and moments unchanged.
    pub sparse: bool,
    /// Counter of skipped Gaussians.
    pub skipped: Buffer,
}

/// Adds the Adam pass of a parameter group.
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
