//! `visibility_bwd`: gradients of the field's tables, layers, and of light positions.
//!
//! The gradient of a pair of pixel and light is a number: the derivative of the loss by its visibility, plus the
//! smoothness term's regularizer · sign(V - V'). V' is the visibility of the slightly displaced point and light, and
//! has no gradient. A single draw displaces a pixel's point and another a light, so that the only cost per pair is the
//! evaluation.
//!
//! Passes, by chunk of pixels: `visibility_encode` twice (points and displaced points), then `visibility_bwd`. The
//! latter evaluates each pair, propagates back through the layers, and sums the gradient of a pixel's row over the
//! lights. Then follow `visibility_scale` and, by chunk, `visibility_encode_bwd`, which propagates from rows to the
//! first layer's weights and the tables. Last are `visibility_reduce` and, for the lights, a sum over workgroups.
//!
//! Guarantees: results are bit-identical from run to run. Weights are summed by workgroup and then over workgroups in
//! order. Table gradients are summed as 64-bit integers. Their unit is a power of two that follows from the step's own
//! largest gradient. Sums therefore cannot overflow, and a gradient 2^-15 of the largest still has 24 bits at two
//! million pixels. This requires 32-bit atomics only; see ADR 0017. Gradients of light positions are exact: direction
//! and distance both follow the light, except along axes where its position is clamped to the box.
//!
//! GPUs batch pairs: a lane evaluates its pixel's pairs by itself, and lanes exchange numbers for the gradients of
//! weights only. On CPUs the lanes of a subgroup share a pair, because loads are executed lane by lane there. Instructions
//! of a subgroup of 32 per pair, with the smoothness term and gradients of positions, by count in the source:
//!
//! | | batched | lanes share a pair |
//! |---|---|---|
//! | multiply-adds | 148 | 148 |
//! | shuffles | 0.2 | 120 |
//! | loads of four weights from a uniform buffer, the same address in all lanes | 18.5 | 0 |
//! | loads of rows, neighboring addresses | 2 | 0 |
//! | accesses of shared memory, four numbers each | 4.5 | 0 |
//! | bytes moved by loads, shared memory and shuffles | 2900 | 15 360 |
//!
//! A load from one address moves its bytes once for the subgroup; all others move a number or four for each lane. With matrix
//! units and 16 bits, the products with the second layer and the sums of weights run on units. A subgroup of 32 then loads 80
//! vectors of weights for a light instead of 592; see ADR 0019. CPUs keep the kernel whose lanes share a pair.
//!
//! Cost per pair: 3 x 1024 multiply-adds for value and gradient, 1024 more with the smoothness term, and about 500 for
//! the rest. Per pixel: 384 gathers of 8 bytes (4 with 16-bit tables), 5 x 1024 multiply-adds, 256 to 512 atomics.
//! Memory: 128 bytes per pixel, and 256 for each pixel of a chunk.
//!
//! Small views split the lights into up to eight parts on GPUs, so that each subgroup has about four batches. Each part takes
//! 128 bytes per pixel: in all less than 32 KiB for each subgroup of 32 lanes that runs at once. The parts of a row are
//! added in order.

use super::{Field, View, field_batched, forward, visibility_encode};
use crate::Tuning;
use crate::kernel::{groups, stage};
use crate::shade::visibility::FIELD_WIDTH;
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::{
    Kernel, semantic_reduce, visibility_bwd as pairs, visibility_bwd_halves as halves, visibility_bwd_lanes as lanes,
    visibility_encode_bwd as points, visibility_reduce as reduce, visibility_scale as scale,
};

/// Maximum number of pixels of a chunk, whose rows are in memory together. Gradients of rows are in memory for all
/// pixels.
const CHUNK: u32 = 1 << 19;

/// Sums that a workgroup of `visibility_bwd` writes.
const SUMS: u64 = (FIELD_WIDTH * (FIELD_WIDTH + 5)) as u64;

/// Subgroups of a compute unit that process pairs: two for each of four schedulers, which their registers allow. Units with
/// 64 KiB of shared memory run four to six at once.
const PAIRS_PER_UNIT: u32 = 8;

/// Subgroups of a compute unit that process points: three for each scheduler.
const POINTS_PER_UNIT: u32 = 12;

/// Maximum number of parts of the lights.
const PARTS: u32 = 8;

/// Bytes of a pixel's row.
const ROW: u64 = 4 * FIELD_WIDTH as u64;

/// Options of the field's backward pass.
#[derive(Clone, Copy, Debug)]
pub struct BackwardOptions {
    /// Whether to add the smoothness term.
    pub regularized: bool,
    /// Whether to compute gradients of light positions.
    pub places: bool,
    /// Evaluates one in `sample` pairs, with `sample` times its weight. 1 evaluates all pairs. The step's seed selects
    /// the pairs.
    pub sample: u32,
    /// Whether to add gradients of light positions instead of overwriting them.
    pub add_places: bool,
}

impl Default for BackwardOptions {
    fn default() -> Self {
        BackwardOptions { regularized: true, places: true, sample: 1, add_places: false }
    }
}

/// Lights of constant radiance, and the gradient of the pixels' radiance.
#[derive(Clone, Copy, Debug)]
pub struct Constant {
    /// Radiance that an unoccluded light gives a pixel, `[lights * 3]` floats.
    pub radiance: Buffer,
    /// Gradient of the loss by the pixels' radiance, `[pixels * 3]` floats.
    pub radiance_gradient: Buffer,
}

/// Destinations of the gradients.
#[derive(Clone, Copy, Debug)]
pub struct Gradients {
    /// Gradients of [`Field::mlp`], `[weights]` floats; overwritten.
    pub mlp: Buffer,
    /// Gradients of light positions, `[lights * 3]` floats. Overwritten, or added to with
    /// [`BackwardOptions::add_places`].
    pub lights: Buffer,
    /// Gradients of tables, `[entries * 4]` words. Each of the two features has the lower and upper half of an integer.
    /// All must be zero before the pass; [`super::visibility_adam`] resets them to zero.
    pub tables: Buffer,
    /// Bit per entry that is set if the entry was touched. All must be zero before the pass; [`super::visibility_adam`]
    /// resets them to zero.
    pub touched: Buffer,
    /// Scale of the table gradients and its inverse, 2 floats.
    pub scale: Buffer,
}

/// Returns the number of single-subgroup workgroups for `batches` of pixels. Each batch takes `rounds` loop iterations.
/// `per_unit`: subgroups of a compute unit.
fn subgroups(tuning: Tuning, per_unit: u32, batches: u32, rounds: u64) -> u32 {
    let batches = u64::from(batches.max(1));
    let least = (batches * rounds).div_ceil(u64::from(tuning.rounds) / 4 * 3);
    // An even number, so that slices of sums start at an offset that buffers can be bound at.
    (least.max(u64::from(tuning.parts(per_unit))).min(batches) as u32).next_multiple_of(2)
}

/// Returns the number of parts of the lights. Each subgroup has several batches, so that all end at about the same time.
/// Views of several chunks are not split, because each part has memory for all pixels.
fn parts(tuning: Tuning, pixels: u32, lights: u32) -> u32 {
    if pixels > CHUNK {
        return 1;
    }
    let batches = pixels.div_ceil(tuning.subgroup_size).max(1);
    (4 * tuning.parts(PAIRS_PER_UNIT)).div_ceil(batches).clamp(1, lights.clamp(1, PARTS))
}

/// Adds the passes for lights of constant radiance. `most` is the maximum number of lights; the step's `lights` is the
/// actual number.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
#[expect(clippy::too_many_arguments, reason = "declares a kernel")]
pub fn visibility_bwd(
    g: &mut Graph,
    tuning: Tuning,
    field: &Field,
    view: &View,
    most: u32,
    requested: &Constant,
    options: &BackwardOptions,
    into: &Gradients,
) -> Result<(), GraphError> {
    let plan = Plan::new(g, tuning, field, view, [most, 0], options)?;
    for (first, count) in plan.chunks() {
        let [rows, moved] = plan.rows(g, field, view, [first, count])?;
        let chunk = plan.chunk(first, count);
        macro_rules! of_pairs {
            ($kernel:ident, $weights:ident, $chosen:expr) => {{
                let bindings = $kernel::Bindings {
                    field_params: field.step.into(),
                    $weights: field.mlp.into(),
                    points: view.points.into(),
                    coverage: view.coverage.into(),
                    rows: rows.into(),
                    moved_rows: moved.into(),
                    row_gradients: chunk.gradients,
                    sums_of: chunk.sums,
                    place_sums: plan.places.into(),
                    jitter_sums: plan.jitter.into(),
                    light_positions: view.lights.into(),
                    light_radiance: requested.radiance.into(),
                    radiance_gradient: requested.radiance_gradient.into(),
                };
                let specs = $kernel::Specs {
                    subgroup: tuning.subgroup_size,
                    levels: field.config.levels,
                    regularized: options.regularized,
                    places: options.places,
                    sample: options.sample,
                    parts: plan.parts,
                };
                let push = $kernel::Push { first, count, most, normalizer: 1.0 };
                let (kernel, specs) = $chosen(specs.entries());
                stage(g, pass_name(kernel), kernel, bindings.entries(), specs, bytemuck::bytes_of(&push))
                    .subgroup_size(Some(tuning.subgroup_size))
                    .dispatch([chunk.groups, 1, 1])?;
            }};
        }
        match field_batched(tuning) {
            true => of_pairs!(pairs, mlp_vectors, |specs| forward(tuning, [&pairs::KERNEL, &halves::KERNEL], specs)),
            false => of_pairs!(lanes, mlp, |specs| (&lanes::KERNEL, specs)),
        }
    }
    plan.finish(g, field, view, into)
}

/// Returns the name of the pass that runs a kernel for pairs.
pub(super) fn pass_name(kernel: &Kernel) -> &'static str {
    kernel.name.trim_end_matches("_lanes")
}

/// Buffers that the passes of one backward pass exchange.
pub(super) struct Plan {
    tuning: Tuning,
    levels: u32,
    pixels: u32,
    lights: u32,
    options: BackwardOptions,
    /// Workgroups of a whole chunk, for pairs and for points.
    groups: [u32; 2],
    /// Sets of sums of a chunk that these write.
    sets: [u32; 2],
    /// Rows of sums for the lights' positions.
    place_rows: u32,
    /// Parts of the lights, whose rows of a pixel are separate.
    pub parts: u32,
    gradients: Buffer,
    sums: Buffer,
    feature_sums: Buffer,
    pub places: Buffer,
    /// Smoothness term by set of sums, then the largest row gradient by workgroup.
    pub jitter: Buffer,
}

/// Slices of a chunk.
pub(super) struct Chunk {
    pub groups: u32,
    pub gradients: sgs_engine::graph::Slice,
    pub sums: sgs_engine::graph::Slice,
}

impl Plan {
    pub(super) fn new(
        g: &mut Graph,
        tuning: Tuning,
        field: &Field,
        view: &View,
        [lights, lobes]: [u32; 2],
        options: &BackwardOptions,
    ) -> Result<Plan, GraphError> {
        let pixels = view.pixels.max(1);
        let chunk = pixels.min(CHUNK);
        let sides = tuning.subgroup_size.div_ceil(32).max(1);
        // Groups of 32 lanes process their own pixels in one kernel for pairs, and in that for points.
        let (batched, lobes, most) = (field_batched(tuning), u64::from(lobes), u64::from(lights));
        let pixels_of_pairs = if batched { tuning.subgroup_size } else { 4 * sides };
        // Iterations per batch. Pairs: the loops over the lights, and those in them, share a counter. Points: levels,
        // features and corners.
        let by_light = if batched { 24 + lobes + u64::from(tuning.subgroup_size.min(32) / 2) } else { 4 + lobes };
        // Without units, a lane computes its elements of the tiles of all products one after the other.
        let elements =
            tuning.field_matrices().filter(|m| batched && !m.units).map_or(0, |_| 8192 / tuning.subgroup_size);
        let by_light = by_light + u64::from(elements);
        let batches = chunk.div_ceil(pixels_of_pairs);
        let parts = if batched { parts(tuning, pixels, lights) } else { 1 };
        let groups = [
            subgroups(tuning, PAIRS_PER_UNIT, batches * parts, by_light * most.div_ceil(u64::from(parts)) + 8),
            subgroups(tuning, POINTS_PER_UNIT, chunk.div_ceil(4 * sides), 16 + 4 + 8 * 9 + 8),
        ];
        let sets = [groups[0] * if batched { 1 } else { sides }, groups[1] * sides];
        // With sampling, groups of eight lanes visit different lights.
        let place_rows = if batched && options.sample > 1 { groups[0] * tuning.subgroup_size / 8 } else { sets[0] };
        let chunks = u64::from(pixels.div_ceil(CHUNK));
        let levels = field.config.levels;
        let plan = Plan {
            tuning,
            levels,
            pixels,
            lights,
            options: *options,
            groups,
            sets,
            place_rows,
            parts,
            gradients: g.transient("visibility.gradients", u64::from(parts) * u64::from(pixels) * ROW),
            sums: g.transient("visibility.sums", chunks * u64::from(sets[0]) * SUMS * 4),
            feature_sums: g
                .transient("visibility.feature_sums", chunks * u64::from(sets[1]) * u64::from(levels) * 2 * ROW),
            places: g.transient("visibility.places", u64::from(place_rows * lights.max(1)) * 12),
            jitter: g.transient("visibility.jitter", 4 * u64::from(sets[0] + groups[0])),
        };
        g.fill("visibility.clear_jitter", plan.jitter, 0)?;
        g.fill("visibility.clear_places", plan.places, 0)?;
        Ok(plan)
    }

    /// Returns the weighted sums of the smoothness term, and their number. Each set of sums has one. Returns `None`
    /// without the term.
    pub(super) fn jitter(&self) -> Option<(Buffer, u32)> {
        self.options.regularized.then_some((self.jitter, self.sets[0]))
    }

    /// Returns the first pixel and the number of pixels of each chunk.
    pub(super) fn chunks(&self) -> impl Iterator<Item = (u32, u32)> + use<> {
        let pixels = self.pixels;
        (0..pixels.div_ceil(CHUNK)).map(move |i| (i * CHUNK, CHUNK.min(pixels - i * CHUNK)))
    }

    /// Encodes a chunk's points and its displaced points to rows.
    pub(super) fn rows(
        &self,
        g: &mut Graph,
        field: &Field,
        view: &View,
        [first, count]: [u32; 2],
    ) -> Result<[Buffer; 2], GraphError> {
        let bytes = u64::from(count.next_multiple_of(self.tuning.subgroup_size)) * ROW;
        let rows = g.transient("visibility.rows", bytes);
        visibility_encode(g, self.tuning, "visibility_encode", field, view, [first, count], false, rows)?;
        if !self.options.regularized {
            return Ok([rows; 2]);
        }
        let moved = g.transient("visibility.moved", bytes);
        visibility_encode(g, self.tuning, "visibility_encode_moved", field, view, [first, count], true, moved)?;
        Ok([rows, moved])
    }

    pub(super) fn chunk(&self, first: u32, count: u32) -> Chunk {
        let sets = u64::from(self.sets[0]) * SUMS * 4;
        Chunk {
            groups: self.groups[0],
            gradients: self.gradients.slice(u64::from(self.parts * first) * ROW, u64::from(self.parts * count) * ROW),
            sums: self.sums.slice(u64::from(first / CHUNK) * sets, sets),
        }
    }

    /// Adds the passes from rows to the tables, and all sums over workgroups.
    pub(super) fn finish(&self, g: &mut Graph, field: &Field, view: &View, into: &Gradients) -> Result<(), GraphError> {
        let (tuning, levels) = (self.tuning, self.levels);
        let bindings = scale::Bindings {
            params: field.step.into(),
            mlp: field.mlp.into(),
            extents: self.jitter.into(),
            scale: into.scale.into(),
        };
        let specs = scale::Specs { workgroup: 32, levels };
        let push = scale::Push { first: self.sets[0], count: self.groups[0], parts: self.parts };
        let push = bytemuck::bytes_of(&push);
        stage(g, "visibility_scale", &scale::KERNEL, bindings.entries(), specs.entries(), push).dispatch([1, 1, 1])?;
        let sets = u64::from(self.sets[1]) * u64::from(levels) * 2 * ROW;
        for (first, count) in self.chunks() {
            let bindings = points::Bindings {
                params: field.step.into(),
                field_levels: field.levels.into(),
                tables: field.lookup().into(),
                packed_tables: field.lookup().into(),
                mlp: field.mlp.into(),
                points: view.points.into(),
                coverage: view.coverage.into(),
                row_gradients: self.chunk(first, count).gradients,
                scale: into.scale.into(),
                feature_sums: self.feature_sums.slice(u64::from(first / CHUNK) * sets, sets),
                table_gradients: into.tables.into(),
                touched: into.touched.into(),
            };
            let (subgroup, parts, table_bits) = (tuning.subgroup_size, self.parts, field.table_bits());
            let specs = points::Specs { subgroup, levels, parts, table_bits };
            let push = points::Push { first, count };
            let bytes = bytemuck::bytes_of(&push);
            stage(g, "visibility_encode_bwd", &points::KERNEL, bindings.entries(), specs.entries(), bytes)
                .subgroup_size(Some(tuning.subgroup_size))
                .dispatch([self.groups[1], 1, 1])?;
        }
        let bindings = reduce::Bindings {
            sums_of: self.sums.into(),
            feature_sums: self.feature_sums.into(),
            mlp_gradient: into.mlp.into(),
        };
        let chunks = self.pixels.div_ceil(CHUNK);
        let [pairs, points] = self.sets.map(|n| chunks * n);
        let workgroup = 64;
        let stripes = if tuning.cpu { 1 } else { 8 };
        let push = reduce::Push { pairs, points };
        let specs = reduce::Specs { workgroup, levels, stripes };
        stage(g, "visibility_reduce", &reduce::KERNEL, bindings.entries(), specs.entries(), bytemuck::bytes_of(&push))
            .dispatch(groups(field.config.weights() as u64, workgroup / stripes))?;
        if !self.options.places && self.options.add_places {
            return Ok(());
        }
        let specs = semantic_reduce::Specs { workgroup: tuning.workgroup, add: self.options.add_places, parts: 1 };
        let push = semantic_reduce::Push { width: 3 * self.lights, groups: self.place_rows };
        let name = "visibility_reduce_places";
        let pass = stage(g, name, &semantic_reduce::KERNEL, [], specs.entries(), bytemuck::bytes_of(&push));
        let pass = pass.bind("partials", self.places);
        // An overwritten buffer is not read.
        let pass = match self.options.add_places {
            true => pass.bind("accumulated", into.lights),
            false => pass.bind_discard("accumulated", into.lights),
        };
        pass.dispatch(groups(3 * u64::from(self.lights), tuning.workgroup))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lights_are_split_on_small_views() {
        let split = |units, pixels, lights| parts(Tuning { units, ..Tuning::for_subgroups(32) }, pixels, lights);
        assert_eq!([1, 2, 48].map(|units| split(units, 40 * 32, 5)), [1, 2, 5]);
        // Sizes of views on a large GPU.
        assert_eq!([160 * 120, 320 * 240, 640 * 480].map(|pixels| split(132, pixels, 64)), [8, 2, 1]);
        assert_eq!(split(132, 1, 0), 1);
        // Views of several chunks keep one row per pixel.
        let largest = Tuning { units: 304, ..Tuning::for_subgroups(64) };
        assert_eq!([CHUNK, CHUNK + 1].map(|pixels| parts(largest, pixels, 64)), [2, 1]);
    }
}
