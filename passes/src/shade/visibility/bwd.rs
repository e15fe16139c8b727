//! `visibility_bwd`: gradients of the field's tables and layers, and of the lights' places.
//!
//! What the loss asks of a pair of pixel and light is a number: the derivative of the loss by its visibility, plus
//! the smoothness term's, regularizer · sign(V - V'), where V' is the visibility of point and light moved by a little, and has
//! no gradient. One draw moves a pixel's point and one a light, so both cost nothing by pair but the evaluation.
//!
//! Steps, by chunk of pixels: `visibility_encode` twice (points, and moved); `visibility_bwd`, which evaluates each pair, goes back
//! through the layers and sums over the lights what arrives at a pixel's row. Then `visibility_scale`, and by chunk
//! `visibility_encode_bwd`, from rows to the first layer's weights and the tables; `visibility_reduce` and a sum over workgroups
//! for the lights.
//!
//! Promises: the same bits every time. Weights are summed by workgroup and then over workgroups in order; tables as whole
//! numbers of 64 bits, in units of a power of two that follows from the step's own largest gradient, so that nothing
//! saturates and a gradient 2^-15 of the largest still has 24 bits at two million pixels. That takes 32-bit atomics only; see ADR 0017.
//! Gradients of lights' places are exact: direction and distance both move with the light, in or on the box alike, but not
//! where it is held at the faces.
//!
//! Cost a pair: 3 x 1024 multiply-adds for value and way back, 1024 more with the smoothness term, and about 500 for the rest.
//! A pixel: 384 gathers of 8 bytes (4 with tables of 16 bits), 5 x 1024 multiply-adds, 256 to 512 atomics. Memory: 128 bytes a pixel, and 256 for each of a chunk.

use super::{Field, View, visibility_encode};
use crate::Tuning;
use crate::kernel::{groups, stage};
use crate::shade::visibility::FIELD_WIDTH;
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::{
    semantic_reduce, visibility_bwd as pairs, visibility_encode_bwd as points, visibility_reduce as reduce,
    visibility_scale as scale,
};

/// Pixels whose rows are in memory together, but for the gradients.
const CHUNK: u32 = 1 << 19;

/// Sums that a workgroup of `visibility_bwd` leaves.
const SUMS: u64 = (FIELD_WIDTH * (FIELD_WIDTH + 5)) as u64;

/// Bytes of a pixel's row.
const ROW: u64 = 4 * FIELD_WIDTH as u64;

/// What is asked of the field.
#[derive(Clone, Copy, Debug)]
pub struct BackwardOptions {
    /// Whether there is the smoothness term.
    pub regularized: bool,
    /// Whether lights' places have gradients.
    pub places: bool,
    /// One pair of so many counts, for as many: 1 is all of them. Which ones follows from the step's seed.
    pub sample: u32,
    /// Whether gradients of lights' places are added to what is there, rather than written.
    pub add_places: bool,
}

impl Default for BackwardOptions {
    fn default() -> Self {
        BackwardOptions { regularized: true, places: true, sample: 1, add_places: false }
    }
}

/// Lights whose radiance is the same everywhere, and what the loss asks of the pixels.
#[derive(Clone, Copy, Debug)]
pub struct Constant {
    /// `[lights * 3]` floats: radiance that a pixel has of a light that it sees.
    pub radiance: Buffer,
    /// `[pixels * 3]` floats: gradient of the loss by the pixels' radiance.
    pub radiance_gradient: Buffer,
}

/// Where gradients go.
#[derive(Clone, Copy, Debug)]
pub struct Gradients {
    /// `[weights]` floats, like [`Field::mlp`]; overwritten.
    pub mlp: Buffer,
    /// `[lights * 3]` floats; overwritten.
    pub lights: Buffer,
    /// `[entries * 4]` words: two features, lower and upper half of a whole number each. All zero before;
    /// [`super::visibility_adam`] leaves it so.
    pub tables: Buffer,
    /// A bit an entry: which were touched. Likewise.
    pub touched: Buffer,
    /// 2 floats: by what table gradients were multiplied, and its inverse.
    pub scale: Buffer,
}

/// Workgroups of one subgroup for `count` pixels, each of which goes through `rounds` loops for every four of them.
fn subgroups(tuning: Tuning, count: u32, rounds: u64) -> u32 {
    let batch = 4 * tuning.subgroup_size.div_ceil(32).max(1);
    let batches = u64::from(count.div_ceil(batch).max(1));
    let least = (batches * rounds).div_ceil(u64::from(tuning.rounds) / 4 * 3);
    // An even number, so that slices of sums begin where buffers may be bound.
    (least.max(u64::from(tuning.workers)).min(batches) as u32).next_multiple_of(2)
}

/// Adds the passes for lights of constant radiance. `most`: lights that there can be; the step's `lights` says how many
/// there are.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn visibility_bwd(
    g: &mut Graph,
    tuning: Tuning,
    field: &Field,
    view: &View,
    most: u32,
    asked: &Constant,
    options: &BackwardOptions,
    into: &Gradients,
) -> Result<(), GraphError> {
    let plan = Plan::new(g, tuning, field, view, [most, 0], options)?;
    for (first, count) in plan.chunks() {
        let [rows, moved] = plan.rows(g, field, view, [first, count])?;
        let chunk = plan.chunk(first, count);
        let bindings = pairs::Bindings {
            field_params: field.step.into(),
            mlp: field.mlp.into(),
            points: view.points.into(),
            coverage: view.coverage.into(),
            rows: rows.into(),
            moved_rows: moved.into(),
            row_gradients: chunk.gradients,
            sums_of: chunk.sums,
            place_sums: plan.places.into(),
            jitter_sums: plan.jitter.into(),
            extent: plan.extent.into(),
            light_positions: view.lights.into(),
            light_radiance: asked.radiance.into(),
            radiance_gradient: asked.radiance_gradient.into(),
        };
        let specs = pairs::Specs {
            subgroup: tuning.subgroup_size,
            levels: field.config.levels,
            regularized: options.regularized,
            places: options.places,
            sample: options.sample,
        };
        let push = pairs::Push { first, count, most, normalizer: 1.0 };
        stage(g, "visibility_bwd", &pairs::KERNEL, bindings.entries(), specs.entries(), bytemuck::bytes_of(&push))
            .subgroup_size(Some(tuning.subgroup_size))
            .dispatch([chunk.groups, 1, 1])?;
    }
    plan.finish(g, field, view, into)
}

/// What the passes of one backward pass leave for each other.
pub(super) struct Plan {
    tuning: Tuning,
    levels: u32,
    pixels: u32,
    lights: u32,
    options: BackwardOptions,
    /// Sides of a subgroup: each leaves sums of its own.
    sides: u32,
    /// Workgroups of a whole chunk.
    groups: [u32; 2],
    gradients: Buffer,
    sums: Buffer,
    feature_sums: Buffer,
    pub places: Buffer,
    pub extent: Buffer,
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
        // Two loops over the lights, one within the other, which share the counter, with two turns and the lobes in each; levels,
        // features and corners.
        let by_batch = [(4 + u64::from(lobes)) * u64::from(lights) + 8, 16 + 4 + 8 * 9 + 8];
        let groups = by_batch.map(|rounds| subgroups(tuning, chunk, rounds));
        let chunks = u64::from(pixels.div_ceil(CHUNK));
        let sets = groups.map(|n| chunks * u64::from(n * sides));
        let levels = field.config.levels;
        let plan = Plan {
            tuning,
            levels,
            pixels,
            lights,
            options: *options,
            sides,
            groups,
            gradients: g.transient("visibility.gradients", u64::from(pixels) * ROW),
            sums: g.transient("visibility.sums", sets[0] * SUMS * 4),
            feature_sums: g.transient("visibility.feature_sums", sets[1] * u64::from(levels) * 2 * ROW),
            places: g.transient("visibility.places", u64::from(groups[0] * sides * lights.max(1)) * 12),
            extent: g.transient("visibility.extent", 4),
            jitter: g.transient("visibility.jitter", 4 * u64::from(groups[0] * sides)),
        };
        g.fill("visibility.clear_jitter", plan.jitter, 0)?;
        g.fill("visibility.clear_extent", plan.extent, 0)?;
        g.fill("visibility.clear_places", plan.places, 0)?;
        Ok(plan)
    }

    /// Sums of the smoothness term, with its weight, by workgroup and side; and how many. None without the term.
    pub(super) fn jitter(&self) -> Option<(Buffer, u32)> {
        self.options.regularized.then_some((self.jitter, self.groups[0] * self.sides))
    }

    /// First pixel and number of pixels of each chunk.
    pub(super) fn chunks(&self) -> impl Iterator<Item = (u32, u32)> + use<> {
        let pixels = self.pixels;
        (0..pixels.div_ceil(CHUNK)).map(move |i| (i * CHUNK, CHUNK.min(pixels - i * CHUNK)))
    }

    /// Rows of a chunk's points, and of these moved.
    pub(super) fn rows(
        &self,
        g: &mut Graph,
        field: &Field,
        view: &View,
        [first, count]: [u32; 2],
    ) -> Result<[Buffer; 2], GraphError> {
        let bytes = u64::from(count) * ROW;
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
        let sets = u64::from(self.groups[0] * self.sides) * SUMS * 4;
        Chunk {
            groups: self.groups[0],
            gradients: self.gradients.slice(u64::from(first) * ROW, u64::from(count) * ROW),
            sums: self.sums.slice(u64::from(first / CHUNK) * sets, sets),
        }
    }

    /// From rows to the tables, and everything's sums over workgroups.
    pub(super) fn finish(&self, g: &mut Graph, field: &Field, view: &View, into: &Gradients) -> Result<(), GraphError> {
        let (tuning, levels) = (self.tuning, self.levels);
        let bindings = scale::Bindings {
            params: field.step.into(),
            mlp: field.mlp.into(),
            extent: self.extent.into(),
            scale: into.scale.into(),
        };
        let specs = scale::Specs { workgroup: 32, levels };
        stage(g, "visibility_scale", &scale::KERNEL, bindings.entries(), specs.entries(), &[]).dispatch([1, 1, 1])?;
        let sets = u64::from(self.groups[1] * self.sides) * u64::from(levels) * 2 * ROW;
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
            let specs = points::Specs { subgroup: tuning.subgroup_size, levels, table_bits: field.table_bits() };
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
        let [pairs, points] = self.groups.map(|n| chunks * n * self.sides);
        let workgroup = 64;
        let push = reduce::Push { pairs, points };
        let specs = reduce::Specs { workgroup, levels };
        stage(g, "visibility_reduce", &reduce::KERNEL, bindings.entries(), specs.entries(), bytemuck::bytes_of(&push))
            .dispatch(groups(field.config.weights() as u64, workgroup))?;
        if !self.options.places && self.options.add_places {
            return Ok(());
        }
        let specs = semantic_reduce::Specs { workgroup: tuning.workgroup, add: self.options.add_places, parts: 1 };
        let push = semantic_reduce::Push { width: 3 * self.lights, groups: self.groups[0] * self.sides };
        let name = "visibility_reduce_places";
        let pass = stage(g, name, &semantic_reduce::KERNEL, [], specs.entries(), bytemuck::bytes_of(&push));
        let pass = pass.bind("partials", self.places);
        // What is replaced is not read.
        let pass = match self.options.add_places {
            true => pass.bind("accumulated", into.lights),
            false => pass.bind_discard("accumulated", into.lights),
        };
        pass.dispatch(groups(3 * u64::from(self.lights), tuning.workgroup))
    }
}
