//! `project`, `project_bwd` and its form fused with Adam: projection of Gaussians to splats.
//!
//! Cost per Gaussian of N: 48 bytes read and one bit written, which is read again. Cost per visible one: the 48 bytes
//! again and the columns of harmonics read (16 bytes for every four of their 3 (d+1)² numbers), 36 + 4 C written (4 fewer
//! with 16-bit colors). Backward, fused: the gradients of its entries read once (4 (6 + C) bytes each), 48 bytes read and
//! 48 written per column of parameters and moments: 720 each with all bands.

use super::{Channels, EntryFeatures, ExtraGradients, Screen, Statistic};
use crate::Tuning;
use crate::kernel::{groups, splat_specs, stage};
use crate::prim::{Count, Overflow, Records, ScanShape, SortShape, exclusive_scan, work};
use crate::scene::{Group, Handles};
use sgs_engine::graph::{Buffer, Graph, GraphError, Slice};
use sgs_shaders::structs::Work;
use sgs_shaders::{pose_sum, project as kernel, project_bwd as bwd, project_bwd_adam as fused, project_count};

/// Visible splats of a view, compacted.
#[derive(Clone, Copy, Debug)]
pub struct Visible {
    /// Count and dispatch sizes, for the group sizes of later passes.
    pub work: Records,
    /// Gaussian of each splat.
    pub ids: Buffer,
    /// Depths as sortable bits.
    pub depth_keys: Buffer,
    /// Footprints.
    pub splats: Buffer,
    /// `[V * words]`: channels, one word each; a 16-bit color takes two words.
    pub features: Buffer,
    /// Number of tiles of each splat.
    pub tile_counts: Buffer,
    /// Largest number of splats.
    pub capacity: u32,
    /// Channels of the features.
    pub channels: Channels,
    /// Bits of a color channel, 32 or 16 ([`crate::Accuracy::color_bits`]).
    pub color_bits: u32,
}

impl Visible {
    /// Returns the words of a splat's channels.
    pub fn words(channels: Channels, color_bits: u32) -> u32 {
        channels.count() - u32::from(color_bits == 16)
    }
}

/// Projects the Gaussians of a step. The first pass decides which are visible; later passes read its bits.
///
/// # Errors
/// If the graph rejects a pass.
pub fn project(
    g: &mut Graph,
    t: &Tuning,
    screen: &Screen,
    gaussians: &Handles,
    channels: Channels,
) -> Result<Visible, GraphError> {
    let n = u64::from(gaussians.capacity);
    let blocks = n.div_ceil(u64::from(t.workgroup));
    debug_assert!(t.workgroup.is_multiple_of(32), "workgroups write whole words of bits");
    let visible_bits = g.transient("visible_bits", blocks * u64::from(t.workgroup / 8));
    let block_counts = g.transient("block_counts", 4 * blocks);
    let block_offsets = g.transient("block_offsets", 4 * blocks);
    let total = g.transient("visible_total", 4);
    let bindings = project_count::Bindings {
        params: screen.step.into(),
        gaussians: gaussians.work.into(),
        parameters: gaussians.parameters.into(),
        visible_bits: visible_bits.into(),
        block_counts: block_counts.into(),
    };
    let specs = splat_specs!(project_count, t, { workgroup: t.workgroup, subgroup: t.subgroup_size,
        columns: gaussians.columns(),
        moment_columns: gaussians.model.columns(),
        compact: gaussians.compact(),
        mip_filter: gaussians.model.mip,
        distorted: t.distorted, });
    stage(g, "project_count", &project_count::KERNEL, bindings.entries(), specs.entries(), &[])
        .subgroup_size(Some(t.subgroup_size))
        .dispatch(groups(n, t.workgroup))?;
    exclusive_scan(g, *t, "project_scan", block_counts, None, block_offsets, total, Count::Host(blocks as u32))?;
    // The capacity holds all Gaussians, so this count never sets the flag.
    let works = g.transient("visible", 64);
    let flag = g.transient("visible_flag", 4);
    let wanted = g.transient("visible_wanted", 4);
    g.fill("clear_visible_flag", flag, 0)?;
    let overflow = Overflow { capacity: gaussians.capacity, flags: flag.into(), flag: 1, wanted: wanted.into() };
    let visible_work = work(g, "visible", total, overflow, works, group_sizes(t))?;
    let c = channels.count();
    let color_bits = if channels.colors { t.accuracy.color_bits } else { 32 };
    let words = Visible::words(channels, color_bits);
    let visible = Visible {
        work: visible_work,
        ids: g.transient("splat_ids", 4 * n),
        depth_keys: g.transient("depth_keys", 4 * n),
        splats: g.transient("splats", size_of::<sgs_shaders::structs::Splat>() as u64 * n),
        features: g.transient("features", 4 * u64::from(words) * n),
        tile_counts: g.transient("tile_counts", 4 * n),
        capacity: gaussians.capacity,
        channels,
        color_bits,
    };
    let bindings = kernel::Bindings {
        params: screen.step.into(),
        gaussians: gaussians.work.into(),
        parameters: gaussians.parameters.into(),
        visible_bits: visible_bits.into(),
        block_offsets: block_offsets.into(),
        splat_ids: visible.ids.into(),
        depth_keys: visible.depth_keys.into(),
        splats: visible.splats.into(),
        features: visible.features.into(),
        tile_counts: visible.tile_counts.into(),
    };
    let specs = splat_specs!(kernel, t, { workgroup: t.workgroup,
        columns: gaussians.columns(),
        moment_columns: gaussians.model.columns(),
        compact: gaussians.compact(),
        mip_filter: gaussians.model.mip,
        distorted: t.distorted,
        subgroup: t.subgroup_size,
        large_tiles: t.large_tiles,
        sh_degree: if channels.colors { gaussians.model.sh_degree } else { 0 },
        channels: c,
        has_colors: channels.colors,
        has_normals: channels.normals,
        has_depth: channels.depth,
        depth_bits: t.accuracy.depth_bits,
        color_bits,
        tile_width: screen.tile[0],
        tile_height: screen.tile[1], });
    stage(g, "project", &kernel::KERNEL, bindings.entries(), specs.entries(), &[])
        .subgroup_size(Some(t.subgroup_size))
        .dispatch(groups(n, t.workgroup))?;
    Ok(visible)
}

/// Backward inputs by entry: positions of each splat's entries, and gradients from blending.
#[derive(Clone, Copy, Debug)]
pub struct EntryGradients {
    /// First entry of each visible splat.
    pub starts: Buffer,
    /// `[entries * (6 + channels + weights + statistic)]`. If `reduced` is set, visible splats replace the entries.
    pub gradients: Buffer,
    /// Gradients through features, if these move opacities and footprints.
    pub features: Option<EntryFeatures>,
    /// Whether the gradients contain the sum of weights.
    pub weights: bool,
    /// Losses in the densification statistic. Unless it is the total, the gradients contain two moments of its own.
    pub statistic: Statistic,
    /// Whether the entries of each splat are already summed.
    pub reduced: bool,
}

impl EntryGradients {
    /// Returns the number of features whose moments are added.
    pub(crate) fn feature_width(&self) -> u32 {
        if self.features.is_some() { Group::Semantics.width() } else { 0 }
    }
}

/// Gradients of a step. Passes write those of visible Gaussians only, so the caller clears them first.
#[derive(Clone, Copy, Debug)]
pub struct Gradients {
    /// All groups but the features, in the columns of the parameters.
    ///
    /// See [`Model::from_columns`](crate::scene::Model::from_columns).
    pub parameters: Buffer,
    /// Screen-space gradient of each visible splat, in pixels.
    pub means2d: Buffer,
    /// Optional gradient of world-to-camera: nine values of the rotation by rows, three of the translation.
    pub pose: Option<Buffer>,
}

/// Builds specialization constants of a kernel that includes `splat_sum.glsl`.
macro_rules! backward_specs {
    ($kernel:ident, $t:expr, $gaussians:expr, $visible:expr, $entries:expr, { $($field:tt)* }) => {
        $crate::kernel::splat_specs!($kernel, $t, {
            workgroup: $t.workgroup,
            columns: $gaussians.columns(),
            moment_columns: $gaussians.model.columns(),
            compact: $gaussians.compact(),
            mip_filter: $gaussians.model.mip,
            distorted: $t.distorted,
            subgroup: $t.subgroup_size,
            large_tiles: $t.large_tiles,
            sh_degree: $gaussians.model.sh_degree,
            channels: $visible.channels.count(),
            has_normals: $visible.channels.normals,
            has_depth: $visible.channels.depth,
            weights: u32::from($entries.weights),
            statistic: $entries.statistic.spec(),
            reduced: $entries.reduced,
            features: $entries.feature_width(),
            color_bits: $visible.color_bits,
            $($field)*
        })
    };
}
pub(crate) use backward_specs;

/// Runs the backward pass of [`project`] and writes every gradient.
///
/// # Errors
/// If the graph rejects a pass.
pub fn project_bwd(
    g: &mut Graph,
    t: &Tuning,
    screen: &Screen,
    gaussians: &Handles,
    visible: &Visible,
    entries: &EntryGradients,
    into: &Gradients,
) -> Result<(), GraphError> {
    let parts = u64::from(visible.capacity).div_ceil(u64::from(t.workgroup));
    let partials = g.transient("pose_partials", 48 * if into.pose.is_some() { parts } else { 1 });
    let bindings = bwd::Bindings {
        params: screen.step.into(),
        visible: visible.work.slice,
        splat_ids: visible.ids.into(),
        entry_starts: entries.starts.into(),
        tile_counts: visible.tile_counts.into(),
        features: visible.features.into(),
        entry_gradients: entries.gradients.into(),
        entry_features: entries.features.map_or(entries.gradients, |f| f.values).into(),
        entry_flags: entries.features.map_or(visible.ids, |f| f.flags).into(),
        parameters: gaussians.parameters.into(),
        gradients: into.parameters.into(),
        grad_means2d: into.means2d.into(),
        pose_partials: partials.into(),
    };
    let specs = backward_specs!(bwd, t, gaussians, visible, entries, { pose: into.pose.is_some(), });
    stage(g, "project_bwd", &bwd::KERNEL, bindings.entries(), specs.entries(), &[])
        .subgroup_size(Some(t.subgroup_size))
        .dispatch_indirect(visible.work.slice.buffer, visible.work.slice.offset)?;
    if let Some(pose) = into.pose {
        let bindings = pose_sum::Bindings {
            visible: visible.work.slice,
            pose_partials: partials.into(),
            pose_gradient: pose.into(),
        };
        let push = pose_sum::Push { per_group: t.workgroup };
        let specs = pose_sum::Specs::default();
        let push = bytemuck::bytes_of(&push);
        stage(g, "pose_sum", &pose_sum::KERNEL, bindings.entries(), specs.entries(), push).dispatch([1, 1, 1])?;
    }
    Ok(())
}

/// Inputs of the fused form besides the gradients.
#[derive(Clone, Copy, Debug)]
pub struct FusedAdam {
    /// Flag word. If it is not zero, the step changes nothing.
    pub flags: Buffer,
    /// Counter of splats with non-finite gradients.
    pub skipped: Buffer,
    /// Whether the pass accumulates densification statistics.
    pub statistics: bool,
    /// Word of each Gaussian that is set if it was updated. [`crate::optim::adam_unseen()`] reads it; the caller clears
    /// it.
    pub seen: Option<Buffer>,
    /// Gradients from other views, added before Adam. With them `seen` is also set where a gradient was not finite.
    /// Otherwise the other views alone would move Gaussians that were skipped.
    pub extra: Option<ExtraGradients>,
    /// Whether the regularizers of opacity and scale add gradients.
    ///
    /// Densification by Markov chain Monte Carlo needs them.
    pub regularize: bool,
}

/// Runs the backward pass of [`project`] and Adam in one pass.
///
/// # Errors
/// If the graph rejects the pass.
pub fn project_bwd_adam(
    g: &mut Graph,
    t: &Tuning,
    screen: &Screen,
    gaussians: &Handles,
    visible: &Visible,
    entries: &EntryGradients,
    adam: &FusedAdam,
) -> Result<(), GraphError> {
    let (Some(moments), Some(statistics)) = (gaussians.moments, gaussians.statistics) else {
        unreachable!("invariant: training declares moments and statistics");
    };
    let seen = adam.seen.unwrap_or_else(|| g.transient("seen", 4));
    if adam.regularize {
        // The kernel has no binding left for this record. The last record of the visible splats is unused.
        let (work, bytes) = (visible.work.slice, size_of::<Work>() as u64);
        g.copy("copy_live", gaussians.work, Slice { offset: work.offset + 3 * bytes, bytes, ..work })?;
    }
    let bindings = fused::Bindings {
        params: screen.step.into(),
        visible: visible.work.slice,
        flags: adam.flags.into(),
        splat_ids: visible.ids.into(),
        entry_starts: entries.starts.into(),
        tile_counts: visible.tile_counts.into(),
        features: visible.features.into(),
        entry_gradients: entries.gradients.into(),
        entry_features: entries.features.map_or(entries.gradients, |f| f.values).into(),
        entry_flags: entries.features.map_or(visible.ids, |f| f.flags).into(),
        extra: adam.extra.map_or(visible.ids, |e| e.buffer).into(),
        parameters: gaussians.parameters.into(),
        first_moments: moments.first.into(),
        second_moments: moments.second.into(),
        statistics: statistics.into(),
        skipped: adam.skipped.into(),
        seen: seen.into(),
    };
    let specs = backward_specs!(fused, t, gaussians, visible, entries, { statistics: adam.statistics, mark_seen: adam.seen.is_some(), extra: adam.extra.is_some(), regularize: adam.regularize, });
    stage(g, "project_bwd_adam", &fused::KERNEL, bindings.entries(), specs.entries(), &[])
        .subgroup_size(Some(t.subgroup_size))
        .dispatch_indirect(visible.work.slice.buffer, visible.work.slice.offset)
}

/// Returns the group sizes of later dispatches of a count. The ordinary group size comes first.
pub(crate) fn group_sizes(t: &Tuning) -> [u32; 4] {
    let mut sizes = [t.workgroup, ScanShape::from(*t).block(), SortShape::from(*t).block(), 0];
    for i in 1..3 {
        if sizes[..i].contains(&sizes[i]) {
            sizes[i] = 0;
        }
    }
    sizes
}
