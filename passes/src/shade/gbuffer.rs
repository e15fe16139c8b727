//! `gbuffer` and the sparse matrix of a view's blending weights: `weights_count`, `weights`, `weights_transpose`,
//! `column_starts`.
//!
//! Geometry is fixed while materials and lights are learned, so what a pixel sees is constant: its point, its normal, and
//! the weights with which Gaussians show there. A picture of materials is then a sparse matrix times their values, and the
//! gradients its transpose times the pixels' ([`super::materials`]); both are kept (compressed rows and compressed columns),
//! so that neither direction needs atomics. Weights are over the pixel's opacity: rows of covered pixels add up to one.
//!
//! Weights may be kept in 16 bits ([`crate::Accuracy::weight_bits`]): in parts of 65535, which suits numbers between zero and one better
//! than half precision. Rounding goes along a row and hands on what it leaves, so that rows add up to one still, to half a part.
//!
//! Promises: the weights are those of [`crate::splat::blend`] bit for bit, or within a part of them; both directions hold the same; rows are in the order of depth, columns in the
//! order of pixels. Cost: the loop of `blend` twice without its channels, 12 bytes written an entry, a sort of as many pairs
//! as there are entries, 16 bytes of memory an entry afterwards (12 with weights of 16 bits). Leaves room for the entries to the caller.

use crate::Tuning;
use crate::kernel::{groups, splat_specs, stage};
use crate::prim::{Count, Overflow, Records, exclusive_scan, radix_sort, work};
use crate::splat::{Blended, Channels, Entries, Screen, Visible, group_sizes, per_lane};
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::{
    column_starts, gbuffer as kernel, surface_depth as depth, weights as fill, weights_count, weights_transpose,
    weights_transpose_packed as packed,
};

/// What has to be blended for [`gbuffer`].
pub const GBUFFER_CHANNELS: Channels = Channels { colors: false, normals: true, depth: true };

/// Pixels that are less opaque have no surface.
pub const LEAST_COVERAGE: f32 = 1e-3;

/// The surfaces that a view sees, by pixel.
#[derive(Clone, Copy, Debug)]
pub struct Surfaces {
    /// `[pixels * 3]` floats, world; zero where nothing is.
    pub points: Buffer,
    /// `[pixels * 3]` floats, world, unit, or zero.
    pub normals: Buffer,
    /// `[pixels]` floats: opacity.
    pub coverage: Buffer,
}

/// A view's weights, in both directions. Words each.
#[derive(Clone, Copy, Debug)]
pub struct Weights {
    /// `[pixels + 1]`: where each pixel's row begins.
    pub row_starts: Buffer,
    /// `[capacity]`: the Gaussian of each entry, by rows.
    pub columns: Buffer,
    /// `[capacity]`: its weight; see `bits`.
    pub weights: Buffer,
    /// `[Gaussians + 1]`: where each Gaussian's column begins.
    pub column_starts: Buffer,
    /// `[capacity]`: the pixel of each entry, by columns.
    pub rows: Buffer,
    /// `[capacity]`: its weight.
    pub row_weights: Buffer,
    /// Bits of a weight: 32, a float; or 16, parts of 65535, two a word ([`weight_words`]).
    pub bits: u32,
}

/// Words of so many weights.
pub fn weight_words(weights: u32, bits: u32) -> u64 {
    if bits == 16 { u64::from(weights).div_ceil(2) } else { weights.into() }
}

/// Weights of a matrix with `bits` of 16 as floats.
pub fn unpacked_weights(words: &[u32], count: usize) -> Vec<f32> {
    let parts = words.iter().flat_map(|w| [w & 0xffff, w >> 16]);
    parts.take(count).map(|p| p as f32 * (1.0 / 65535.0)).collect()
}

/// The rows alone, which is what blending takes.
#[derive(Clone, Copy, Debug)]
pub struct Rows {
    /// `[pixels + 1]`: where each pixel's row begins.
    pub row_starts: Buffer,
    /// `[capacity]`: the Gaussian of each entry, by rows.
    pub columns: Buffer,
    /// `[capacity]`: its weight.
    pub weights: Buffer,
    /// As [`Weights::bits`].
    pub bits: u32,
}

impl From<&Weights> for Rows {
    fn from(w: &Weights) -> Rows {
        Rows { row_starts: w.row_starts, columns: w.columns, weights: w.weights, bits: w.bits }
    }
}

/// Turns what was blended of [`GBUFFER_CHANNELS`] into surfaces.
///
/// # Errors
/// If the graph refuses the pass.
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

/// What [`surface_depth`] leaves in a picture of two channels.
pub const SURFACE_DEPTH: Channels = Channels { colors: false, normals: false, depth: true };

/// Depth of surfaces as blending leaves it, for what works on blended views: [`SURFACE_DEPTH`] (without the squares) and
/// transmittance.
///
/// # Errors
/// If the graph refuses the pass.
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

/// How many entries there are and what is done if they do not fit.
#[derive(Clone, Copy, Debug)]
pub struct Room {
    /// Entries that fit.
    pub capacity: u32,
    /// Gaussians.
    pub gaussians: u32,
    /// A word in which bit 0 is set where they do not fit; then there are none.
    pub flags: Buffer,
    /// A word that receives how many are wanted.
    pub wanted: Buffer,
}

/// Fills the matrix of a view. Rows past its last pixel are empty.
///
/// # Errors
/// If the graph refuses a pass.
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
        // A word each as long as rows end where they like.
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

/// As [`weights`] without the columns, for views that only go forward, in 32 bits. Where there is no room the last rows are cut off.
///
/// # Errors
/// If the graph refuses a pass.
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

/// The rows; how many entries there are, and the pixel of each.
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
    let specs =
        splat_specs!(weights_count, t, { subgroup: t.subgroup_size, per_lane: lanes, tile_width, tile_height, });
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
        weight_bits: into.bits, });
    stage(g, "weights", &fill::KERNEL, bindings.entries(), specs.entries(), &[])
        .subgroup_size(Some(t.subgroup_size))
        .dispatch(tiles)?;
    Ok((found, entry_pixels))
}
