//! `blend_buckets`: blending that leaves checkpoints for the backward pass over buckets, `blend_bwd_bucket`.
//!
//! Each tile's entries are cut into buckets of the same number of entries. Backward, each bucket has a subgroup of its
//! own, so the parallelism is that of the entries and not of the tiles. The checkpoint of a bucket is the state of the
//! tile's pixels before it: transmittance, and the sums of the channels. They give the debt before the bucket once
//! the loss has its gradients: the debt of the pixel less these sums times the gradient.
//!
//! Cost, forward: as `blend`, and 4 (1 + C) bytes per pixel and bucket, except for the first of a tile. Backward reads
//! them again, and 4 (1 + C) bytes per pixel and bucket of debts and gradients. A pixel that has not stopped
//! takes about 30 + 2 C multiply-adds and one exponential per entry; two shuffles and 4 + C words of shared
//! memory serve two entries.

use super::{Blended, Entries, Screen, Visible, parts};
use crate::Tuning;
use crate::kernel::{groups, splat_specs, stage};
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::blend_buckets as kernel;

/// Splats that a lane of `blend_bwd_bucket` owns. Two halve the shuffles and reads of shared memory per pair.
pub(super) const OWN: u32 = 2;

/// State of the pixels before each bucket of a view.
#[derive(Clone, Copy, Debug)]
pub struct Buckets {
    /// Entries of a bucket.
    pub entries: u32,
    /// Largest number of slots for buckets.
    pub slots: u32,
    /// Columns and rows of a part of a tile.
    pub part: [u32; 2],
    /// Tile of each slot, or `u32::MAX`, once for each part of a tile.
    ///
    /// Marked if the part's pixels had stopped.
    pub tiles: Buffer,
    /// Transmittance and channel sums by bucket, a plane of pixels each. See `buckets.glsl`.
    pub checkpoints: Buffer,
}

/// Returns the entries of a bucket.
///
/// Few tiles get small buckets, so that they fill the device. Otherwise large buckets halve the memory.
fn bucket_entries(t: &Tuning, screen: &Screen) -> u32 {
    let entries = if screen.tiles() <= 4 * t.workers { 64 } else { 128 };
    entries.max(OWN * t.subgroup_size)
}

/// Blends a view as [`super::blend`] does, and writes the checkpoints. They need no capacity of their own: all
/// entries together bound the buckets.
///
/// # Errors
/// If the graph rejects a pass.
pub fn blend_buckets(
    g: &mut Graph,
    t: &Tuning,
    screen: &Screen,
    visible: &Visible,
    entries: &Entries,
    into: &Blended,
) -> Result<Buckets, GraphError> {
    let channels = visible.channels.count();
    let bucket = bucket_entries(t, screen);
    let full = entries.capacity / bucket;
    let slots = full + screen.tiles();
    let part = parts::part(t, screen);
    let count = u64::from(parts::count(screen, part));
    let tiles = g.transient("bucket_tiles", 4 * count * u64::from(slots));
    let pixels = u64::from(screen.tile[0] * screen.tile[1]);
    let checkpoints = g.transient("checkpoints", 4 * u64::from(1 + channels) * pixels * u64::from(full.max(1)));
    g.fill("clear_bucket_tiles", tiles, u32::MAX)?;
    let bindings = kernel::Bindings {
        params: screen.step.into(),
        tile_ranges: entries.tile_ranges.into(),
        sorted_entries: entries.sorted,
        entry_splats: entries.splats.into(),
        splats: visible.splats.into(),
        features: visible.features.into(),
        image: into.image.into(),
        transmittance: into.transmittance.into(),
        checkpoints: checkpoints.into(),
        bucket_tiles: tiles.into(),
    };
    let specs = splat_specs!(kernel, t, { subgroup: t.subgroup_size,
        per_lane: parts::per_lane(t, part),
        part_width: part[0],
        part_height: part[1],
        tile_width: screen.tile[0],
        tile_height: screen.tile[1],
        sub_tiles: t.sub_tiles,
        slot_margin: t.slot_margin,
        slot_width: t.slot_width,
        channels,
        has_colors: visible.channels.colors,
        color_bits: visible.color_bits,
        bucket, });
    stage(g, "blend_buckets", &kernel::KERNEL, bindings.entries(), specs.entries(), &[])
        .subgroup_size(Some(t.subgroup_size))
        .dispatch(groups(u64::from(screen.tiles()) * count, 1))?;
    Ok(Buckets { entries: bucket, slots, part, tiles, checkpoints })
}
