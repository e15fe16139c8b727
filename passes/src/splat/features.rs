//! `blend_features`, `blend_features_bwd`, `features_bwd` and its form fused with Adam: wide features that are blended as
//! they are (semantics), at the pixels where somebody wants them.
//!
//! Feature maps are coarse and region masks are small, so a bit a pixel says where features are wanted, and kernels go
//! through the list of a tile's wanted pixels, lanes side by side: the cost follows their number. The weights are worked out
//! again, which is less than features cost themselves (20 operations a pair against 2 F). Features need no projection:
//! kernels read them from the Gaussians. Gradients of opacity and footprint are linear in those of the channels, so what
//! comes through features is left at the entries as moments of its own, and added where a splat's entries are summed.
//!
//! Cost, F features: an entry of a tile with wanted pixels is fetched once for every `2 x subgroup` of them (28 + 4 F
//! bytes, 2 F fewer with features in 16 bits); a pair takes 20 + 2 F operations, backward 45 + 4 F. Pixels write 4 F bytes;
//! backward reads twice that, and writes 4 (6 + F) bytes at entries that show. `features_bwd_adam` reads these, and 12 F
//! bytes a visible Gaussian, and writes 12 F. `features_pack` reads 4 F bytes a Gaussian and writes 2 F, once a step.

use super::{Entries, Screen, Visible};
use crate::Tuning;
use crate::kernel::{groups, splat_specs, stage};
use crate::scene::{Group, Handles};
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::features_bwd_adam as fused;
use sgs_shaders::features_pack as pack;
use sgs_shaders::long_tiles as long;
use sgs_shaders::{blend_features as forward, blend_features_bwd as backward, features_bwd as kernel};

/// Where features are wanted.
#[derive(Clone, Copy, Debug)]
pub struct Wanted {
    /// A bit a pixel, row by row ([`wanted_words`]).
    pub pixels: Buffer,
    /// Whether they lie close together, as in a region, or are few in each tile, as the samples of a coarse map.
    pub dense: bool,
}

impl Wanted {
    /// Wanted pixels that a lane has at a time, of which each takes 32 sums in registers. Narrow subgroups take more where
    /// there are more, since what is fetched and left for an entry is that for all of them.
    fn per_lane(&self, t: &Tuning) -> u32 {
        if self.dense { (32 / t.subgroup_size).max(2) } else { 2 }
    }
}

/// What the kernels that go through tiles bind alike.
macro_rules! of_tiles {
    ($kernel:ident, ($screen:ident, $gaussians:ident, $visible:ident, $entries:ident, $wanted:ident), $($more:tt)*) => {
        $kernel::Bindings {
            params: $screen.step.into(),
            tile_ranges: $entries.tile_ranges.into(),
            sorted_entries: $entries.sorted,
            entry_splats: $entries.splats.into(),
            splats: $visible.splats.into(),
            splat_ids: $visible.ids.into(),
            raw_features: $gaussians.looked_up_features().into(),
            packed_features: $gaussians.looked_up_features().into(),
            pixel_mask: $wanted.pixels.into(),
            $($more)*
        }
    };
}

/// And those that sum over the entries of a splat.
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

/// What the features' gradients leave at the entries.
#[derive(Clone, Copy, Debug)]
pub struct EntryFeatures {
    /// First entry of each visible splat.
    pub starts: Buffer,
    /// `[entries * (6 + features)]`: moments, then features; only where the flag is up.
    pub values: Buffer,
    /// `[entries]`
    pub flags: Buffer,
}

/// Pixels of a tile.
fn pixels(screen: &Screen) -> u32 {
    screen.tile[0] * screen.tile[1]
}

/// Words of a map of wanted pixels, a bit each, row by row.
pub fn wanted_words(pixels: u64) -> u64 {
    pixels.div_ceil(32)
}

/// The Gaussians with a copy of their features in 16 bits beside them, if the accuracy asks for it: what blending reads of them in
/// this graph from now on, in every view. The features themselves keep 32 bits, and gradients are those at the rounded ones.
///
/// # Errors
/// If the graph refuses the pass.
pub fn features_pack(g: &mut Graph, t: &Tuning, gaussians: &Handles) -> Result<Handles, GraphError> {
    if t.accuracy.feature_bits != 16 || !gaussians.model.has(Group::Semantics) {
        return Ok(*gaussians);
    }
    let words = u64::from(gaussians.capacity) * u64::from(Group::Semantics.width() / 2);
    let packed_features = g.transient("packed_features", 4 * words);
    let bindings = pack::Bindings {
        gaussians: gaussians.work.into(),
        raw_features: gaussians.group(Group::Semantics).into(),
        packed_features: packed_features.into(),
    };
    let specs = pack::Specs { workgroup: t.workgroup, features: Group::Semantics.width() };
    stage(g, "features_pack", &pack::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch(groups(words, t.workgroup))?;
    Ok(Handles { packed_features: Some(packed_features), ..*gaussians })
}

/// Blends features into `into` (`[pixels * features]`) at the wanted pixels of the view; elsewhere nothing is written.
///
/// # Errors
/// If the graph refuses the pass.
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
    let span = 2 * per_lane * t.subgroup_size;
    let specs = splat_specs!(forward, t, { subgroup: t.subgroup_size,
        per_lane,
        tile_width: screen.tile[0],
        tile_height: screen.tile[1],
        features: Group::Semantics.width(),
        feature_bits: gaussians.feature_bits(),
        span, });
    stage(g, "blend_features", &forward::KERNEL, bindings.entries(), specs.entries(), &[])
        .subgroup_size(Some(t.subgroup_size))
        .dispatch(groups(u64::from(screen.tiles()) * u64::from(pixels(screen).div_ceil(span)), 1))
}

/// Backward of [`blend_features`].
///
/// # Errors
/// If the graph refuses a pass.
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
    // Whole tiles. But where the rounds of an invocation are bounded, tiles of more entries than these allow are done part by
    // part. (An entry is fetched by one of the lanes, and then it may be tried: 9/8 rounds on eight lanes.)
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
        feature_bits: gaussians.feature_bits(),
        span,
        short, });
    let tiles = groups(u64::from(screen.tiles()), 1);
    let mut needed = None;
    for first in (0..pixels(screen)).step_by(span as usize) {
        let push = backward::Push { first };
        let mut pass =
            stage(g, "blend_features_bwd", &backward::KERNEL, [], specs.entries(), bytemuck::bytes_of(&push));
        for (name, slice) in bindings.entries() {
            // What the kernel adds to, it has written before: the flags say so.
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

/// Group counts of dispatches that only tiles of more than `short` entries need.
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

/// Gradients of the features, by Gaussian, added to what is there: the caller clears it, then the views of a step add up,
/// one pass after the other. [`crate::optim::adam()`] takes them, with [`crate::optim::Rate::Semantics`].
///
/// # Errors
/// If the graph refuses the pass.
pub fn features_bwd(
    g: &mut Graph,
    t: &Tuning,
    visible: &Visible,
    entries: &EntryFeatures,
    into: Buffer,
) -> Result<(), GraphError> {
    let bindings = of_splats!(kernel, (visible, entries), grad_features: into.into(),);
    let specs = kernel::Specs { workgroup: t.workgroup, features: Group::Semantics.width(), subgroup: t.subgroup_size };
    stage(g, "features_bwd", &kernel::KERNEL, bindings.entries(), specs.entries(), &[])
        .subgroup_size(Some(t.subgroup_size))
        .dispatch_indirect(visible.work.slice.buffer, visible.work.slice.offset)
}

/// What the fused form works on.
#[derive(Clone, Copy, Debug)]
pub struct FeatureAdam {
    /// Uniform `Step`.
    pub step: Buffer,
    /// A word that is not zero when the step must change nothing.
    pub flags: Buffer,
    /// The features' moments, pairs.
    pub moments: Buffer,
    /// A counter, increased by the number of gradients that were skipped because they are not finite.
    pub skipped: Buffer,
    /// For dense Adam: what the fused update of the other groups has marked; the rest is left to another pass.
    pub seen: Option<Buffer>,
}

/// Sums the gradients and moves the features.
///
/// # Errors
/// If the graph refuses the pass.
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
        parameters: gaussians.group(Group::Semantics).into(),
        moments: a.moments.into(),
        skipped: a.skipped.into(),
    );
    let specs = fused::Specs {
        workgroup: t.workgroup,
        features: Group::Semantics.width(),
        subgroup: t.subgroup_size,
        dense: a.seen.is_some(),
    };
    stage(g, "features_bwd_adam", &fused::KERNEL, bindings.entries(), specs.entries(), &[])
        .subgroup_size(Some(t.subgroup_size))
        .dispatch_indirect(visible.work.slice.buffer, visible.work.slice.offset)
}
