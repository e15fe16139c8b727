//! `normals` and `normals_bwd`: pixel normals from trainable Gaussian normals.
//!
//! The weights of a view are constants ([`super::weights`]). The normal of a pixel is the normalized weighted sum of
//! the Gaussians' normals, equal to that of [`super::gbuffer`] except for rounding. With s = Σ w n and N = s/|s|, the
//! gradient of N is orthogonal to N. The gradient of s is that gradient divided by |s|, and the gradient of each n is w
//! times that of s. Where |s| is below 0.001, so that normals cancel, the gradient is zero.
//!
//! Guarantees: both passes are gathers in a fixed order, bit-identical from run to run. Every Gaussian's gradient is
//! written. Cost per matrix entry: 20 bytes and 6 operations forward, 24 bytes and 8 operations backward. 16-bit
//! weights save 2 bytes.

use super::{Rows, Surfaces, Weights};
use crate::Tuning;
use crate::kernel::{groups, stage};
use crate::splat::Screen;
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::{normals as kernel, normals_bwd as backward};

/// Normals of pixels, with the data that the backward pass needs.
#[derive(Clone, Copy, Debug)]
pub struct LearnedNormals {
    /// Unit world-space normals or zero, `[pixels * 3]` floats.
    pub normals: Buffer,
    /// Inverse length before normalization, `[pixels]` floats. Zero where the pixel has no gradient.
    pub inverse_lengths: Buffer,
}

impl LearnedNormals {
    /// Returns the surfaces with their normals replaced by these.
    pub fn of(&self, seen: &Surfaces) -> Surfaces {
        Surfaces { normals: self.normals, ..*seen }
    }
}

/// Blends `gaussian_normals` (`[Gaussians * 3]` floats of any length).
///
/// # Errors
/// If the graph rejects the pass.
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

/// Backward pass of [`normals`]: writes `grad_normals` of all `gaussians`. The input is the gradient of unit normals.
/// Its component along the normals must be zero already.
///
/// # Errors
/// If the graph rejects the pass.
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
