//! `blend_features`, `blend_features_bwd`, `features_bwd`: blending of wide features at selected pixels.
//!
//! Features (semantics) are blended without projection. `features_bwd_adam` fuses `features_bwd` with Adam. Feature
//! maps are coarse and region masks are small, so a bit per pixel selects the pixels. Kernels process the list of a
//! tile's selected pixels, lanes side by side: the cost follows their number. Weights are recomputed, which costs less
//! than the features (20 operations per pair against 2 F). Kernels read the features from the Gaussians. Gradients of
//! opacity and footprint are linear in those of the channels. Gradients through features are therefore stored at the
//! entries as separate moments, and added where a splat's entries are summed.
//!
//! Cost for F features: an entry of a tile with selected pixels is fetched once per `2 x subgroup` of them (28 + 4 F
//! bytes). A pair takes 20 + 2 F operations, backward 45 + 4 F. Pixels write 4 F bytes;
//! backward reads twice that, and writes 4 (6 + F) bytes at contributing entries. `features_bwd_adam` reads these, and
//! 12 F bytes per visible Gaussian, and writes 12 F.

use super::{Entries, Screen, Visible};
use crate::Tuning;
use crate::kernel::{groups, splat_specs, stage};
use crate::scene::{Group, Handles};
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::features_bwd_adam as fused;
use sgs_shaders::long_tiles as long;
use sgs_shaders::{blend_features as forward, blend_features_bwd as backward, features_bwd as kernel};

/// Selection of pixels at which features are blended.
#[derive(Clone, Copy, Debug)]
pub struct Wanted {
    /// One bit per pixel, row by row ([`wanted_words`]).
    pub pixels: Buffer,
    /// Whether selected pixels lie close together, as in a region. Otherwise each tile has few, as with samples of a
    /// coarse map.
    pub dense: bool,
}

impl Wanted {
    /// Returns the selected pixels that a lane processes at a time. Each takes 32 sums in registers. Narrow subgroups
    /// take more pixels in dense selections, since one fetch and one write of an entry serve all of them.
    fn per_lane(&self, t: &Tuning) -> u32 {
        if self.dense { (32 / t.subgroup_size).max(2) } else { 2 }
    }
}

/// Builds the bindings shared by kernels that process tiles.
macro_rules! of_tiles {
    ($kernel:ident, ($screen:ident, $gaussians:ident, $visible:ident, $entries:ident, $wanted:ident), $($more:tt)*) => {
        $kernel::Bindings {
            params: $screen.step.into(),
            tile_ranges: $entries.tile_ranges.into(),
            sorted_entries: $entries.sorted,
            entry_splats: $entries.splats.into(),
            splats: $visible.splats.into(),
            splat_ids: $visible.ids.into(),
            raw_features: $gaussians.semantics.into(),
            pixel_mask: $wanted.pixels.into(),
            $($more)*
        }
    };
}

/// Builds the bindings shared by kernels that sum over the entries of a splat.
macro_rules! of_splats {
    ($kernel:ident, ($visible:ident, $entries:ident), $($more:tt)*) => {
        $kernel::Bindings {
            visible: $visible.work.slice,
            splat_ids: $visible.ids.into(),
            entry_starts: $entries.starts.into(),
            tile_counts: $visible.tile_counts.into(),
            entry_features: $entries.values.into(),
            entry_flags: $entries.flags.into(),
            $($more)*
        }
    };
}

/// Gradients that came through features, by entry.
#[derive(Clone, Copy, Debug)]
pub struct EntryFeatures {
    /// First entry of each visible splat.
    pub starts: Buffer,
    /// `[entries * (6 + features)]`: moments, then features; valid only where the flag is set.
    pub values: Buffer,
    /// `[entries]` flags.
    pub flags: Buffer,
}

/// Returns the number of pixels of a tile.
fn pixels(screen: &Screen) -> u32 {
    screen.tile[0] * screen.tile[1]
}

/// Returns the number of words in a selection of pixels, one bit each, row by row.
pub fn wanted_words(pixels: u64) -> u64 {
    pixels.div_ceil(32)
}

/// Blends features into `into` (`[pixels * features]`) at the selected pixels. Other pixels are not written.
///
/// # Errors
/// If the graph rejects the pass.
#[expect(clippy::too_many_arguments, reason = "declares a kernel")]
pub fn blend_features(
    g: &mut Graph,
    t: &Tuning,
    screen: &Screen,
    gaussians: &Handles,
    visible: &Visible,
    entries: &Entries,
    wanted: Wanted,
    into: Buffer,
) -> Result<(), GraphError> {
    let bindings = of_tiles!(forward, (screen, gaussians, visible, entries, wanted), feature_image: into.into(),);
    let per_lane = wanted.per_lane(t);
    // Two rounds of a workgroup share its list of selected pixels. Small views do not occupy a GPU that way.
    let round = per_lane * t.subgroup_size;
    let occupied = t.cpu || u64::from(screen.tiles()) * u64::from(pixels(screen)) >= u64::from(2 * round * t.workers);
    let span = if occupied { 2 * round } else { round };
    let specs = splat_specs!(forward, t, { subgroup: t.subgroup_size,
        per_lane,
        tile_width: screen.tile[0],
        tile_height: screen.tile[1],
        features: Group::Semantics.width(),
        sub_tiles: t.sub_tiles,
        slot_margin: t.slot_margin,
        span, });
    stage(g, "blend_features", &forward::KERNEL, bindings.entries(), specs.entries(), &[])
        .subgroup_size(Some(t.subgroup_size))
        .dispatch(groups(u64::from(screen.tiles()) * u64::from(pixels(screen).div_ceil(span)), 1))
}

/// Runs the backward pass of [`blend_features`].
///
/// # Errors
/// If the graph rejects a pass.
#[expect(clippy::too_many_arguments, reason = "declares a kernel")]
pub fn blend_features_bwd(
    g: &mut Graph,
    t: &Tuning,
    screen: &Screen,
    gaussians: &Handles,
    visible: &Visible,
    entries: &Entries,
    wanted: Wanted,
    image: Buffer,
    gradient: Buffer,
) -> Result<EntryFeatures, GraphError> {
    let features = Group::Semantics.width();
    let values = g.transient("entry_features", 4 * u64::from(6 + features) * u64::from(entries.capacity));
    let flags = g.transient("entry_flags", 4 * u64::from(entries.capacity));
    g.fill("clear_entry_flags", flags, 0)?;
    let bindings = of_tiles!(backward, (screen, gaussians, visible, entries, wanted),
        feature_image: image.into(),
        grad_features: gradient.into(),
        entry_features: values.into(),
        entry_flags: flags.into(),
    );
    // Tiles are processed whole. If the rounds of an invocation are bounded, tiles with more entries than the bound
    // allows are split over several passes. (A lane fetches an entry and may then test it: 9/8 rounds with eight
    // lanes.)
    let per_lane = wanted.per_lane(t);
    let at_once = per_lane * t.subgroup_size;
    let parts = pixels(screen).div_ceil(at_once);
    let bounded = t.rounds < u32::MAX;
    let span = if bounded { 2 * at_once } else { pixels(screen) };
    let short = if bounded { t.rounds / 10 * 9 / parts * t.subgroup_size / (t.subgroup_size + 1) } else { u32::MAX };
    let specs = splat_specs!(backward, t, { subgroup: t.subgroup_size,
        per_lane,
        tile_width: screen.tile[0],
        tile_height: screen.tile[1],
        features,
        sub_tiles: t.sub_tiles,
        slot_margin: t.slot_margin,
        span,
        short, });
    let tiles = groups(u64::from(screen.tiles()), 1);
    let mut needed = None;
    for first in (0..pixels(screen)).step_by(span as usize) {
        let push = backward::Push { first };
        let mut pass =
            stage(g, "blend_features_bwd", &backward::KERNEL, [], specs.entries(), bytemuck::bytes_of(&push));
        for (name, slice) in bindings.entries() {
            // The kernel adds only to values that it has written before, as the flags record.
            let discard = first == 0 && name == "entry_features";
            pass = if discard { pass.bind_discard(name, slice) } else { pass.bind(name, slice) };
        }
        let pass = pass.subgroup_size(Some(t.subgroup_size));
        match needed {
            None => pass.dispatch(tiles)?,
            Some(arguments) => pass.dispatch_indirect(arguments, 0)?,
        }
        if span < pixels(screen) && needed.is_none() {
            needed = Some(long_tiles(g, t, entries, screen.tiles(), short, tiles)?);
        }
    }
    Ok(EntryFeatures { starts: entries.starts, values, flags })
}

/// Adds the pass that computes group counts of the additional dispatches. Only tiles of more than `short` entries need
/// these.
fn long_tiles(
    g: &mut Graph,
    t: &Tuning,
    entries: &Entries,
    tiles: u32,
    short: u32,
    groups: [u32; 3],
) -> Result<Buffer, GraphError> {
    let arguments = g.transient("long_tiles", 12);
    let bindings = long::Bindings { tile_ranges: entries.tile_ranges.into(), arguments: arguments.into() };
    let specs = long::Specs { workgroup: t.workgroup, short };
    let push = long::Push { tiles, groups };
    stage(g, "long_tiles", &long::KERNEL, bindings.entries(), specs.entries(), bytemuck::bytes_of(&push))
        .dispatch([1, 1, 1])?;
    Ok(arguments)
}

/// Adds the gradients of the features, by Gaussian, to `into`. The caller clears it first; then the views of a step add
/// to it, one pass after the other. [`crate::optim::adam()`] uses them with [`crate::optim::Rate::Semantics`].
///
/// # Errors
/// If the graph rejects the pass.
pub fn features_bwd(
    g: &mut Graph,
    t: &Tuning,
    visible: &Visible,
    entries: &EntryFeatures,
    into: Buffer,
) -> Result<(), GraphError> {
    let bindings = of_splats!(kernel, (visible, entries), grad_features: into.into(),);
    let specs = kernel::Specs {
        workgroup: t.workgroup,
        features: Group::Semantics.width(),
        subgroup: t.subgroup_size,
        large_tiles: t.large_tiles,
    };
    stage(g, "features_bwd", &kernel::KERNEL, bindings.entries(), specs.entries(), &[])
        .subgroup_size(Some(t.subgroup_size))
        .dispatch_indirect(visible.work.slice.buffer, visible.work.slice.offset)
}

/// Inputs of the pass that is fused with Adam.
#[derive(Clone, Copy, Debug)]
pub struct FeatureAdam {
    /// Uniform `Step`.
    pub step: Buffer,
    /// Flag word. If it is not zero, the step changes nothing.
    pub flags: Buffer,
    /// Pairs of first and second moments of the features.
    pub moments: Buffer,
    /// Counter of gradients skipped because they are not finite.
    pub skipped: Buffer,
    /// For dense Adam: the marks of the other groups' fused update. Another pass processes the unmarked Gaussians.
    pub seen: Option<Buffer>,
}

/// Sums the gradients and updates the features.
///
/// # Errors
/// If the graph rejects the pass.
pub fn features_bwd_adam(
    g: &mut Graph,
    t: &Tuning,
    gaussians: &Handles,
    visible: &Visible,
    entries: &EntryFeatures,
    a: &FeatureAdam,
) -> Result<(), GraphError> {
    let bindings = of_splats!(fused, (visible, entries),
        params: a.step.into(),
        flags: a.flags.into(),
        seen: a.seen.unwrap_or(visible.ids).into(),
        parameters: gaussians.semantics.into(),
        moments: a.moments.into(),
        skipped: a.skipped.into(),
    );
    let specs = fused::Specs {
        workgroup: t.workgroup,
        features: Group::Semantics.width(),
        subgroup: t.subgroup_size,
        large_tiles: t.large_tiles,
        dense: a.seen.is_some(),
    };
    stage(g, "features_bwd_adam", &fused::KERNEL, bindings.entries(), specs.entries(), &[])
        .subgroup_size(Some(t.subgroup_size))
        .dispatch_indirect(visible.work.slice.buffer, visible.work.slice.offset)
}
