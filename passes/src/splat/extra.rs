//! `project_bwd_features`: projection backward pass for views whose losses read only features.
//!
//! Propagates gradients from features to the Gaussians' positions, shapes and opacities. The passes of such views add,
//! one after the other, to rows by Gaussian that begin as zeros. The fused update of the training view
//! ([`super::project_bwd_adam`]) reads the rows; [`crate::optim::adam_unseen()`] processes the Gaussians that it does
//! not move. If one gradient of a Gaussian is not finite, all of them become non-finite, so that all are skipped alike.
//!
//! Cost per visible splat: one flag per entry, and 24 bytes more per entry whose flag is set. If any is set, 44 bytes
//! of parameters and 44 of gradients read, 44 written, about 300 operations.

use super::{EntryFeatures, Screen, Visible};
use crate::Tuning;
use crate::kernel::{splat_specs, stage};
use crate::scene::{Group, Handles};
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::project_bwd_features as kernel;

/// Gradients from other views of a step.
#[derive(Clone, Copy, Debug)]
pub struct ExtraGradients {
    /// `[Gaussians * 11]`: mean (3), log scale (3), rotation (4), opacity logit.
    pub buffer: Buffer,
}

impl ExtraGradients {
    /// Scalars per Gaussian.
    pub const WIDTH: u32 = 11;

    /// Declares the buffer for `capacity` Gaussians and clears it.
    ///
    /// # Errors
    /// If the graph rejects the pass.
    pub fn cleared(g: &mut Graph, capacity: u32) -> Result<ExtraGradients, GraphError> {
        let buffer = g.transient("extra_gradients", 4 * u64::from(Self::WIDTH) * u64::from(capacity));
        g.fill("clear_extra_gradients", buffer, 0)?;
        Ok(ExtraGradients { buffer })
    }
}

/// Adds the gradients that came through features to `into`. Sums them over the entries of each visible splat and
/// propagates them through projection. [`super::features_bwd`] computes the gradients of the features themselves.
///
/// # Errors
/// If the graph rejects the pass.
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
        parameters: gaussians.parameters.into(),
        extra: into.buffer.into(),
    };
    let specs = splat_specs!(kernel, t, { workgroup: t.workgroup,
        columns: gaussians.columns(),
        moment_columns: gaussians.model.columns(),
        compact: gaussians.compact(),
        mip_filter: gaussians.model.mip,
        distorted: t.distorted,
        subgroup: t.subgroup_size,
        large_tiles: t.large_tiles,
        features: Group::Semantics.width(), });
    stage(g, "project_bwd_features", &kernel::KERNEL, bindings.entries(), specs.entries(), &[])
        .subgroup_size(Some(t.subgroup_size))
        .dispatch_indirect(visible.work.slice.buffer, visible.work.slice.offset)
}
