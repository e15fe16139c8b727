//! `gbuffer` and the sparse matrix of a view's blending weights. Kernels: `weights_count`, `weights`,
//! `weights_transpose`, `column_starts`.
//!
//! Geometry is fixed while materials and lights are trained, so the surface of a pixel is constant: its point, its
//! normal and the weights of its Gaussians. An image of materials is therefore a sparse matrix times the Gaussians'
//! values. The gradients are the transposed matrix times the pixels' gradients ([`super::materials`]). Both are stored,
//! as compressed rows and compressed columns, so that neither direction needs atomics. Weights are divided by the
//! pixel's opacity: rows of covered pixels add up to one.
//!
//! Weights may be stored in 16 bits ([`crate::Accuracy::weight_bits`]), in units of 1/65535. This suits numbers between
//! zero and one better than half precision. The rounding error is carried along a row, so that rows still add up to one
//! within half a unit.
//!
//! Guarantees: the weights equal those of [`crate::splat::blend`] bit for bit, or within one unit. Both directions hold
//! the same weights. Rows are in depth order, columns in pixel order.
//!
//! Cost: the loop of `blend` twice without its channels, 12 bytes written per entry, and a sort of as many pairs as
//! entries. The matrix takes 16 bytes per entry (12 with 16-bit weights). The caller provides the capacity for the
//! entries.

use crate::Tuning;
use crate::kernel::{groups, splat_specs, stage};
use crate::prim::{Count, Overflow, Records, exclusive_scan, radix_sort, work};
use crate::splat::{Blended, Channels, Entries, Screen, Visible, group_sizes, per_lane};
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::{
    column_starts, gbuffer as kernel, surface_depth as depth, weights as fill, weights_count, weights_transpose,
    weights_transpose_packed as packed,
};

/// Channels that [`gbuffer`] requires to be blended.
pub const GBUFFER_CHANNELS: Channels = Channels { colors: false, normals: true, depth: true };

/// Minimum opacity of a pixel with a surface.
pub const LEAST_COVERAGE: f32 = 1e-3;

/// Visible surfaces of a view, by pixel.
#[derive(Clone, Copy, Debug)]
pub struct Surfaces {
    /// World-space points, zero without a surface, `[pixels * 3]` floats.
    pub points: Buffer,
    /// Unit world-space normals or zero, `[pixels * 3]` floats.
    pub normals: Buffer,
    /// Opacity, `[pixels]` floats.
    pub coverage: Buffer,
}

/// Blending weights of a view, in both directions, as 32-bit words.
#[derive(Clone, Copy, Debug)]
pub struct Weights {
    /// Start of each pixel's row, `[pixels + 1]`.
    pub row_starts: Buffer,
    /// Gaussian of each entry, by rows, `[capacity]`.
    pub columns: Buffer,
    /// Weight of each entry, by rows, `[capacity]`; see `bits`.
    pub weights: Buffer,
    /// Start of each Gaussian's column, `[Gaussians + 1]`.
    pub column_starts: Buffer,
    /// Pixel of each entry, by columns, `[capacity]`.
    pub rows: Buffer,
    /// Weight of each entry, by columns, `[capacity]`.
    pub row_weights: Buffer,
    /// Bits of a weight: 32 or 16. 32 is a float; 16 is in units of 1/65535, two weights a word ([`weight_words`]).
    pub bits: u32,
}

/// Returns the number of words that store `weights` weights.
pub fn weight_words(weights: u32, bits: u32) -> u64 {
    if bits == 16 { u64::from(weights).div_ceil(2) } else { weights.into() }
}

/// Converts the 16-bit weights of a matrix to floats.
pub fn unpacked_weights(words: &[u32], count: usize) -> Vec<f32> {
    let parts = words.iter().flat_map(|w| [w & 0xffff, w >> 16]);
    parts.take(count).map(|p| p as f32 * (1.0 / 65535.0)).collect()
}

/// Rows of the matrix alone, which blending requires.
#[derive(Clone, Copy, Debug)]
pub struct Rows {
    /// Start of each pixel's row, `[pixels + 1]`.
    pub row_starts: Buffer,
    /// Gaussian of each entry, by rows, `[capacity]`.
    pub columns: Buffer,
    /// Weight of each entry, `[capacity]`.
    pub weights: Buffer,
    /// Bits of a weight, as [`Weights::bits`].
    pub bits: u32,
}

impl From<&Weights> for Rows {
    fn from(w: &Weights) -> Rows {
        Rows { row_starts: w.row_starts, columns: w.columns, weights: w.weights, bits: w.bits }
    }
}

/// Converts the blended [`GBUFFER_CHANNELS`] to surfaces.
///
/// # Errors
/// If the graph rejects the pass.
pub fn gbuffer(
    g: &mut Graph,
    t: &Tuning,
    screen: &Screen,
    blended: &Blended,
    into: &Surfaces,
) -> Result<(), GraphError> {
    let bindings = kernel::Bindings {
        params: screen.step.into(),
        image: blended.image.into(),
        transmittance: blended.transmittance.into(),
        points: into.points.into(),
        normals: into.normals.into(),
        coverage: into.coverage.into(),
    };
    let specs = splat_specs!(kernel, t, { workgroup: t.workgroup, });
    stage(g, "gbuffer", &kernel::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch(groups(screen.pixels(), t.workgroup))
}

/// Channels that [`surface_depth`] writes, in an image of two channels.
pub const SURFACE_DEPTH: Channels = Channels { colors: false, normals: false, depth: true };

/// Writes the depth of surfaces in the format of blended views. The result has [`SURFACE_DEPTH`] (without the squares)
/// and transmittance.
///
/// # Errors
/// If the graph rejects the pass.
pub fn surface_depth(g: &mut Graph, t: &Tuning, screen: &Screen, seen: &Surfaces) -> Result<Blended, GraphError> {
    let into = Blended {
        image: g.transient("surface_depth", 8 * screen.pixels()),
        transmittance: g.transient("surface_transmittance", 4 * screen.pixels()),
    };
    let bindings = depth::Bindings {
        params: screen.step.into(),
        points: seen.points.into(),
        coverage: seen.coverage.into(),
        image: into.image.into(),
        transmittance: into.transmittance.into(),
    };
    let specs = splat_specs!(depth, t, { workgroup: t.workgroup, });
    stage(g, "surface_depth", &depth::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch(groups(screen.pixels(), t.workgroup))?;
    Ok(into)
}

/// Capacity of the matrix, and the reports of overflow.
#[derive(Clone, Copy, Debug)]
pub struct Room {
    /// Maximum number of entries.
    pub capacity: u32,
    /// Number of Gaussians.
    pub gaussians: u32,
    /// Word in which bit 0 is set on overflow; the matrix is then empty.
    pub flags: Buffer,
    /// Word that receives the required number of entries.
    pub wanted: Buffer,
}

/// Fills the matrix of a view; rows past its last pixel are empty.
///
/// # Errors
/// If the graph rejects a pass.
#[expect(clippy::too_many_arguments, reason = "declares a kernel")]
pub fn weights(
    g: &mut Graph,
    t: &Tuning,
    screen: &Screen,
    visible: &Visible,
    entries: &Entries,
    coverage: Buffer,
    room: &Room,
    into: &Weights,
) -> Result<(), GraphError> {
    let mut by_rows = Rows::from(into);
    if into.bits == 16 {
        // One word per weight while rows may end anywhere.
        by_rows.weights = g.transient("weight_parts", 4 * u64::from(room.capacity));
    }
    let (found, entry_pixels) = rows(g, t, screen, visible, entries, coverage, room, &by_rows)?;
    let bits = 32 - room.gaussians.saturating_sub(1).leading_zeros();
    let sorted = radix_sort(g, *t, "weights_sort", into.columns, None, 0..bits.max(1), true, Count::Gpu(found))?;
    if into.bits == 16 {
        let bindings = packed::Bindings {
            entries: found.slice,
            order: sorted.values,
            pixels: entry_pixels.into(),
            parts: by_rows.weights.into(),
            rows: into.rows.into(),
            weights: into.weights.into(),
            row_weights: into.row_weights.into(),
        };
        let specs = packed::Specs { workgroup: t.workgroup };
        stage(g, "weights_transpose", &packed::KERNEL, bindings.entries(), specs.entries(), &[])
            .dispatch_indirect(found.slice.buffer, found.slice.offset)?;
    } else {
        let bindings = weights_transpose::Bindings {
            entries: found.slice,
            order: sorted.values,
            pixels: entry_pixels.into(),
            weights: into.weights.into(),
            rows: into.rows.into(),
            row_weights: into.row_weights.into(),
        };
        let specs = weights_transpose::Specs { workgroup: t.workgroup };
        stage(g, "weights_transpose", &weights_transpose::KERNEL, bindings.entries(), specs.entries(), &[])
            .dispatch_indirect(found.slice.buffer, found.slice.offset)?;
    }
    let bindings = column_starts::Bindings {
        entries: found.slice,
        sorted_columns: sorted.keys.unwrap_or_else(|| into.columns.into()),
        column_starts: into.column_starts.into(),
    };
    let specs = column_starts::Specs { workgroup: t.workgroup };
    stage(g, "column_starts", &column_starts::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch(groups(u64::from(room.gaussians) + 1, t.workgroup))
}

/// Fills only the rows, in 32 bits, for forward-only views. On overflow the last rows are truncated.
///
/// # Errors
/// If the graph rejects a pass.
#[expect(clippy::too_many_arguments, reason = "declares a kernel")]
pub fn weight_rows(
    g: &mut Graph,
    t: &Tuning,
    screen: &Screen,
    visible: &Visible,
    entries: &Entries,
    coverage: Buffer,
    room: &Room,
    into: &Rows,
) -> Result<(), GraphError> {
    debug_assert_eq!(into.bits, 32, "rows that may be cut off are not packed");
    rows(g, t, screen, visible, entries, coverage, room, into).map(|_| ())
}

/// Fills the rows; returns the number of entries and the pixel of each.
#[expect(clippy::too_many_arguments, reason = "declares a kernel")]
fn rows(
    g: &mut Graph,
    t: &Tuning,
    screen: &Screen,
    visible: &Visible,
    entries: &Entries,
    coverage: Buffer,
    room: &Room,
    into: &Rows,
) -> Result<(Records, Buffer), GraphError> {
    let pixels = screen.pixels();
    let counts = g.transient("weight_counts", 4 * (pixels + 1));
    g.fill("clear_weight_counts", counts, 0)?;
    let lanes = per_lane(t, screen);
    let bindings = weights_count::Bindings {
        params: screen.step.into(),
        tile_ranges: entries.tile_ranges.into(),
        sorted_entries: entries.sorted,
        entry_splats: entries.splats.into(),
        splats: visible.splats.into(),
        counts: counts.into(),
    };
    let [tile_width, tile_height] = screen.tile;
    let specs = splat_specs!(weights_count, t, { subgroup: t.subgroup_size,
        per_lane: lanes,
        tile_width,
        tile_height,
        sub_tiles: t.sub_tiles,
        slot_margin: t.slot_margin,
        slot_width: t.slot_width, });
    let tiles = groups(u64::from(screen.tiles()), 1);
    stage(g, "weights_count", &weights_count::KERNEL, bindings.entries(), specs.entries(), &[])
        .subgroup_size(Some(t.subgroup_size))
        .dispatch(tiles)?;
    let total = g.transient("weights_total", 4);
    let all = u32::try_from(pixels + 1).unwrap_or(u32::MAX);
    exclusive_scan(g, *t, "weights_scan", counts, None, into.row_starts, total, Count::Host(all))?;
    let works = g.transient("weight_works", 64);
    let overflow = Overflow { capacity: room.capacity, flags: room.flags.into(), flag: 1, wanted: room.wanted.into() };
    let found: Records = work(g, "weights_work", total, overflow, works, group_sizes(t))?;
    let entry_pixels = g.transient("weight_pixels", 4 * u64::from(room.capacity));
    let bindings = fill::Bindings {
        params: screen.step.into(),
        tile_ranges: entries.tile_ranges.into(),
        sorted_entries: entries.sorted,
        entry_splats: entries.splats.into(),
        splats: visible.splats.into(),
        splat_ids: visible.ids.into(),
        row_starts: into.row_starts.into(),
        coverage: coverage.into(),
        columns: into.columns.into(),
        weights: into.weights.into(),
        pixels: entry_pixels.into(),
    };
    let specs = splat_specs!(fill, t, { subgroup: t.subgroup_size,
        per_lane: lanes,
        tile_width,
        tile_height,
        sub_tiles: t.sub_tiles,
        slot_margin: t.slot_margin,
        slot_width: t.slot_width,
        weight_bits: into.bits, });
    stage(g, "weights", &fill::KERNEL, bindings.entries(), specs.entries(), &[])
        .subgroup_size(Some(t.subgroup_size))
        .dispatch(tiles)?;
    Ok((found, entry_pixels))
}
