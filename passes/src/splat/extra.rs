//! `project_bwd_features`: what a view whose features alone are compared leaves for the Gaussians' places, shapes and
//! opacities.
//!
//! Such views add up, one pass after the other, in rows by Gaussian that begin as zeros, and the fused update of the
//! training view ([`super::project_bwd_adam`]) takes them into account; Gaussians that it does not move are left to
//! [`crate::optim::adam_unseen()`]. One buffer for all groups, since the fused update binds nearly as many as every device
//! allows. Where one gradient of a Gaussian is not finite none is, so that all its groups are skipped alike.
//!
//! Cost a visible splat: a flag an entry, 24 bytes more where it is up; where any is, 44 bytes of parameters and 44 of
//! gradients read, 44 written, about 300 operations.

use super::{EntryFeatures, Screen, Visible};
use crate::Tuning;
use crate::kernel::{splat_specs, stage};
use crate::optim::Rows;
use crate::scene::{Group, Handles};
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::project_bwd_features as kernel;

/// Gradients that other views of a step left.
#[derive(Clone, Copy, Debug)]
pub struct ExtraGradients {
    /// `[Gaussians * 11]`: mean (3), log scale (3), rotation (4), opacity logit.
    pub buffer: Buffer,
}

impl ExtraGradients {
    /// Scalars of a Gaussian.
    pub const WIDTH: u32 = 11;

    /// Room for `capacity` Gaussians, cleared.
    ///
    /// # Errors
    /// If the graph refuses the pass.
    pub fn cleared(g: &mut Graph, capacity: u32) -> Result<ExtraGradients, GraphError> {
        let buffer = g.transient("extra_gradients", 4 * u64::from(Self::WIDTH) * u64::from(capacity));
        g.fill("clear_extra_gradients", buffer, 0)?;
        Ok(ExtraGradients { buffer })
    }

    /// Those of one group; features alone move no others than means, log scales, rotations and opacity logits.
    pub fn of(&self, group: Group) -> Option<Rows> {
        let first = match group {
            Group::Means => 0,
            Group::LogScales => 3,
            Group::Rotations => 6,
            Group::OpacityLogits => 10,
            _ => return None,
        };
        Some(Rows { buffer: self.buffer, stride: Self::WIDTH, first })
    }
}

/// Sums what came through features over the entries of each visible splat, takes it back through projection, and adds it
/// to `into`. The features' own gradients are [`super::features_bwd`]'s.
///
/// # Errors
/// If the graph refuses the pass.
pub fn project_bwd_features(
    g: &mut Graph,
    t: &Tuning,
    screen: &Screen,
    gaussians: &Handles,
    visible: &Visible,
    entries: &EntryFeatures,
    into: &ExtraGradients,
) -> Result<(), GraphError> {
    let bindings = kernel::Bindings {
        params: screen.step.into(),
        visible: visible.work.slice,
        splat_ids: visible.ids.into(),
        entry_starts: entries.starts.into(),
        tile_counts: visible.tile_counts.into(),
        entry_features: entries.values.into(),
        entry_flags: entries.flags.into(),
        means: gaussians.group(Group::Means).into(),
        log_scales: gaussians.group(Group::LogScales).into(),
        rotations: gaussians.group(Group::Rotations).into(),
        opacity_logits: gaussians.group(Group::OpacityLogits).into(),
        extra: into.buffer.into(),
    };
    let specs = splat_specs!(kernel, t, { workgroup: t.workgroup, features: Group::Semantics.width(), });
    stage(g, "project_bwd_features", &kernel::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch_indirect(visible.work.slice.buffer, visible.work.slice.offset)
}
