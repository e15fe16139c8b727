//! `intersect`, `tile_ranges`: sorted entries of every tile, from visible splats.
//!
//! Splats are sorted by depth once (V pairs). Then one entry per touched tile is written in that order and sorted
//! stably by tile id alone. That is E pairs of as few bits as the number of tiles needs. Cost per entry: 8 bytes
//! written, and 24 for each pass of the sort.

use super::project::group_sizes;
use super::{Screen, Visible};
use crate::Tuning;
use crate::kernel::{splat_specs, stage};
use crate::prim::{Count, Overflow, Records, exclusive_scan, radix_sort, work};
use sgs_engine::graph::{Buffer, Graph, GraphError, Slice};
use sgs_shaders::{intersect as kernel, tile_ranges};

/// Entries (one per splat and tile), sorted by tile and depth.
#[derive(Clone, Copy, Debug)]
pub struct Entries {
    /// Count and dispatch size; zero after an overflow.
    pub work: Records,
    /// Number of required entries, even if they exceed the capacity.
    pub wanted: Buffer,
    /// Entry indices, sorted.
    pub sorted: Slice,
    /// Splat of each entry.
    pub splats: Buffer,
    /// First entry of each splat.
    pub starts: Buffer,
    /// First index into `sorted` and one past the last, for each tile.
    pub tile_ranges: Buffer,
    /// Largest number of entries.
    pub capacity: u32,
}

/// Creates the entries. Sets bit 0 of `flags` if they exceed the capacity.
///
/// # Errors
/// If the graph rejects a pass.
pub fn intersect(
    g: &mut Graph,
    t: &Tuning,
    screen: &Screen,
    visible: &Visible,
    capacity: u32,
    flags: Buffer,
) -> Result<Entries, GraphError> {
    let v = u64::from(visible.capacity);
    let e = u64::from(capacity);
    let count = Count::Gpu(visible.work);
    // Depths are positive: their bits sort as integers, without the sign bit. Shorter keys have fewer digits.
    let bits = 0..t.accuracy.depth_bits.clamp(8, 31);
    let order = radix_sort(g, *t, "depth_sort", visible.depth_keys, None, bits, false, count)?.values;
    let offsets = g.transient("entry_offsets", 4 * v);
    let total = g.transient("entries_total", 4);
    let wanted = g.transient("entries_wanted", 4);
    exclusive_scan(g, *t, "entry_scan", visible.tile_counts, Some(order), offsets, total, count)?;
    let works = g.transient("entries", 64);
    let overflow = Overflow { capacity, flags: flags.into(), flag: 1, wanted: wanted.into() };
    let entry_work = work(g, "entries", total, overflow, works, group_sizes(t))?;
    let keys = g.transient("tile_keys", 4 * e);
    let splats = g.transient("entry_splats", 4 * e);
    let starts = g.transient("entry_starts", 4 * v);
    let bindings = kernel::Bindings {
        params: screen.step.into(),
        visible: visible.work.slice,
        entries: entry_work.slice,
        depth_order: order,
        entry_offsets: offsets.into(),
        tile_counts: visible.tile_counts.into(),
        splats: visible.splats.into(),
        tile_keys: keys.into(),
        entry_splats: splats.into(),
        entry_starts: starts.into(),
    };
    let specs = splat_specs!(kernel, t, { workgroup: t.workgroup,
        subgroup: t.subgroup_size,
        large_tiles: t.large_tiles,
        tile_width: screen.tile[0],
        tile_height: screen.tile[1], });
    stage(g, "intersect", &kernel::KERNEL, bindings.entries(), specs.entries(), &[])
        .subgroup_size(Some(t.subgroup_size))
        .dispatch_indirect(visible.work.slice.buffer, visible.work.slice.offset)?;
    let tiles = screen.tiles();
    // One value more than the tiles, for entries that a driver's rounding may leave over.
    let bits = 32 - tiles.leading_zeros();
    let sorted = radix_sort(g, *t, "tile_sort", keys, None, 0..bits, true, Count::Gpu(entry_work))?;
    let sorted_keys = sorted.keys.unwrap_or_else(|| keys.into());
    let tile_ranges = g.transient("tile_ranges", 8 * u64::from(tiles));
    g.fill("clear_tile_ranges", tile_ranges, 0)?;
    let bindings =
        tile_ranges::Bindings { entries: entry_work.slice, tile_keys: sorted_keys, tile_ranges: tile_ranges.into() };
    let specs = tile_ranges::Specs { workgroup: t.workgroup };
    stage(g, "tile_ranges", &tile_ranges::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch_indirect(entry_work.slice.buffer, entry_work.slice.offset)?;
    Ok(Entries { work: entry_work, wanted, sorted: sorted.values, splats, starts, tile_ranges, capacity })
}
