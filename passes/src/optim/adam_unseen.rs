//! `adam_unseen`: Adam for Gaussians that the fused update of a step did not move.
//!
//! Gaussians with gradients from other views follow them. Otherwise the gradient is zero. Dense Adam lets their moments
//! decay and continues to move them, as in 3DGS (Kerbl et al. 2023); sparse Adam leaves them unchanged. If a gradient of a
//! Gaussian is not finite, its place, shape and opacity are skipped, and it is counted. Semantic features are a pass of
//! their own, and only dense Adam moves them.
//!
//! Cost per column of an unseen Gaussian: 48 bytes read, 48 written if anything moves. Per feature: 12 read, 12 written.

use crate::Tuning;
use crate::kernel::{splat_specs, stage};
use crate::scene::{Group, Handles, MomentHandles};
use crate::splat::ExtraGradients;
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::{adam_unseen as kernel, adam_unseen_features as rows};

/// Inputs, and a record of the Gaussians that were updated.
#[derive(Clone, Copy, Debug)]
pub struct AdamUnseen {
    /// Uniform `Step`: learning rates and bias corrections.
    pub step: Buffer,
    /// Flag word. If it is not zero, the step changes nothing.
    pub flags: Buffer,
    /// One word per Gaussian: not zero if it was already updated or skipped.
    pub seen: Buffer,
    /// Gradients from other views. Without them all gradients are zero.
    pub extra: Option<ExtraGradients>,
    /// Whether a zero gradient leaves its scalar and moments unchanged.
    pub sparse: bool,
    /// Whether the regularizers of opacity and scale add gradients.
    ///
    /// Densification by Markov chain Monte Carlo needs them.
    pub regularize: bool,
    /// Counter of skipped Gaussians.
    pub skipped: Buffer,
}

/// Adds the Adam pass of all groups but the semantic features.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn adam_unseen(
    g: &mut Graph,
    t: &Tuning,
    gaussians: &Handles,
    moments: &MomentHandles,
    a: &AdamUnseen,
) -> Result<(), GraphError> {
    let bindings = kernel::Bindings {
        params: a.step.into(),
        live: gaussians.work.into(),
        flags: a.flags.into(),
        seen: a.seen.into(),
        extra: a.extra.map_or(a.seen, |e| e.buffer).into(),
        parameters: gaussians.parameters.into(),
        first_moments: moments.first.into(),
        second_moments: moments.second.into(),
        skipped: a.skipped.into(),
    };
    let specs = splat_specs!(kernel, t, { workgroup: t.workgroup,
        columns: gaussians.columns(),
        moment_columns: gaussians.model.columns(),
        compact: gaussians.compact(),
        extra: a.extra.is_some(),
        sparse: a.sparse,
        regularize: a.regularize,
        has_normals: gaussians.model.normals, });
    stage(g, "adam_unseen", &kernel::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch_indirect(gaussians.work, 0)
}

/// Adds the pass of dense Adam for features of Gaussians that a step did not see.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn adam_unseen_features(
    g: &mut Graph,
    t: &Tuning,
    gaussians: &Handles,
    moments: &MomentHandles,
    a: &AdamUnseen,
) -> Result<(), GraphError> {
    let bindings = rows::Bindings {
        params: a.step.into(),
        live: gaussians.work.into(),
        flags: a.flags.into(),
        seen: a.seen.into(),
        features: gaussians.semantics.into(),
        moments: moments.semantics.into(),
    };
    let specs = rows::Specs { workgroup: t.workgroup, width: Group::Semantics.width() };
    stage(g, "adam_unseen_features", &rows::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch_indirect(gaussians.work, 0)
}
