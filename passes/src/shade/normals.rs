//! `normals` and `normals_bwd`: normals of pixels from those of Gaussians, where these are learned, and the way back.
//!
//! The weights of a view are constants ([`super::weights`]): the normal of a pixel is their sum over the Gaussians' normals,
//! made unit, as [`super::gbuffer`] has it but for rounding. With s = Σ w n and N = s/|s| what is asked of N, which is across it,
//! is asked of s divided by |s|, and of each n times its w. Where |s| is below a thousandth, so that normals cancel, nothing is.
//!
//! Promises: both are gathers in a fixed order, the same bits from run to run; every Gaussian's gradient is written. Cost: 20
//! bytes and 6 operations an entry of the matrix forward, 24 and 8 back; 2 bytes fewer with weights of 16 bits.

use super::{Rows, Surfaces, Weights};
use crate::Tuning;
use crate::kernel::{groups, stage};
use crate::splat::Screen;
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::{normals as kernel, normals_bwd as backward};

/// Normals of pixels that can be gone back through.
#[derive(Clone, Copy, Debug)]
pub struct LearnedNormals {
    /// `[pixels * 3]` floats, world, unit, or zero.
    pub normals: Buffer,
    /// `[pixels]` floats: one over the length before, zero where nothing is to be learned.
    pub inverse_lengths: Buffer,
}

impl LearnedNormals {
    /// The surfaces with these normals in place of theirs.
    pub fn of(&self, seen: &Surfaces) -> Surfaces {
        Surfaces { normals: self.normals, ..*seen }
    }
}

/// Blends `gaussian_normals` (`[Gaussians * 3]` floats of any length).
///
/// # Errors
/// If the graph refuses the pass.
pub fn normals(
    g: &mut Graph,
    t: &Tuning,
    screen: &Screen,
    gaussian_normals: Buffer,
    weights: impl Into<Rows>,
) -> Result<LearnedNormals, GraphError> {
    let weights = weights.into();
    let into = LearnedNormals {
        normals: g.transient("learned_normals", 12 * screen.pixels()),
        inverse_lengths: g.transient("inverse_lengths", 4 * screen.pixels()),
    };
    let bindings = kernel::Bindings {
        params: screen.step.into(),
        row_starts: weights.row_starts.into(),
        columns: weights.columns.into(),
        weights: weights.weights.into(),
        gaussian_normals: gaussian_normals.into(),
        normals: into.normals.into(),
        inverse_lengths: into.inverse_lengths.into(),
    };
    let specs = kernel::Specs { workgroup: t.workgroup, weight_bits: weights.bits };
    stage(g, "normals", &kernel::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch(groups(screen.pixels(), t.workgroup))?;
    Ok(into)
}

/// Backward of [`normals`]: writes `grad_normals` of all `gaussians` from the gradient of unit normals, of which the part along
/// them must be zero already.
///
/// # Errors
/// If the graph refuses the pass.
pub fn normals_bwd(
    g: &mut Graph,
    t: &Tuning,
    learned: &LearnedNormals,
    weights: &Weights,
    gaussians: u32,
    normals_gradient: Buffer,
    grad_normals: Buffer,
) -> Result<(), GraphError> {
    let bindings = backward::Bindings {
        column_starts: weights.column_starts.into(),
        rows: weights.rows.into(),
        row_weights: weights.row_weights.into(),
        normals_gradient: normals_gradient.into(),
        inverse_lengths: learned.inverse_lengths.into(),
        grad_normals: grad_normals.into(),
    };
    let specs = backward::Specs { workgroup: t.workgroup, weight_bits: weights.bits };
    stage(g, "normals_bwd", &backward::KERNEL, bindings.entries(), specs.entries(), &[])
        .subgroup_size(Some(t.subgroup_size))
        .dispatch(groups(8 * u64::from(gaussians), t.workgroup))
}
