//! `visibility_encode` and `visibility`: learned visibility of lights from points.
//!
//! SGS-Intrinsic, stage II: the features of a hash grid at the point, the direction from the light and the distance
//! pass through layers of 32, 32 and 1 neurons. Positions are relative to the box, and clamped to it. The first layer
//! is split: its product with the features is computed once per pixel. A pair of pixel and light therefore costs 4 x 32
//! products there instead of 36 x 32. Direction and distance are not split further: differences of positions are exact
//! where points and lights are close, differences of products are not.
//!
//! No buffer has the size of pixels times lights. The first layer's output for a point can be stored
//! (`visibility_encode`, 128 bytes per pixel). Passes that iterate over the lights in another order, or twice, then
//! need not look up the tables again.
//!
//! Tables may be looked up in 16 bits ([`crate::Accuracy::visibility_bits`]). The lookup reads a copy, rounded to nearest,
//! which is updated together with the tables. Gradients are evaluated at the rounded numbers and passed on unchanged
//! (straight-through). Tables and moments keep 32 bits.
//!
//! Cost: 128 gathers of 8 bytes (4 with 16-bit tables) and 1024 multiply-adds per pixel; 1184 multiply-adds per pair.
//! A GPU's invocation evaluates several lights of its pixel together, so that they share each load of weights: four lights
//! up to 32 lanes, two above (`visibility_pairs.glsl`). Loads of a pair and lane; lanes share the addresses of weights:
//!
//! | | vectors of four weights | bytes of shared memory | bytes in all |
//! |---|---|---|---|
//! | one light alone, weights in shared memory | 288, and 32 single ones | 4736 | 4736 |
//! | two lights together | 148 | 64 | 2432 |
//! | four lights together | 74 | 32 | 1216 |
//!
//! Four lights together therefore load a quarter of the bytes of one alone, and 1/148 of them from shared memory.
//!
//! No lanes exchange values. On CPUs with eight lanes, lanes hold neurons, and two pixels share loads of the second layer.

mod adam;
mod bwd;
mod config;
mod lights;
mod memory;

pub use adam::{Moments, visibility_adam};
pub use bwd::{BackwardOptions, Constant, Gradients, visibility_bwd};
pub use config::{FIELD_FEATURES, FIELD_LEVELS, FIELD_WIDTH, FieldConfig, FieldError};
pub use lights::{
    lights_bwd_field, lights_field, lights_normals_bwd_field, lights_split_field, lights_train_field,
    visibility_lights_bwd,
};
pub use memory::{FieldHandles, TrainingHandles, VisibilityField, packed_tables};

use crate::Tuning;
use crate::kernel::{groups, stage};
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::{Kernel, visibility as kernel, visibility_encode as encode_kernel, visibility_halves as halves};

/// Visibility field in a graph.
#[derive(Clone, Copy, Debug)]
pub struct Field {
    /// Shape of the field.
    pub config: FieldConfig,
    /// Uniform `FieldStep`: box, jitter, sizes, seed, learning rate.
    pub step: Buffer,
    /// `[levels]` of `FieldLevel`: [`FieldConfig::table_levels`].
    pub levels: Buffer,
    /// Tables, `[entries * 2]` floats.
    pub tables: Buffer,
    /// 16-bit copy of the tables, `[entries]` words of two halves. If present, lookups read the copy instead of the
    /// tables.
    pub packed: Option<Buffer>,
    /// Weights of the network, `[weights]` floats. Rows of the first layer (features, direction, distance), rows of the
    /// second layer, and the last layer.
    pub mlp: Buffer,
}

impl Field {
    /// Returns the buffer that lookups read.
    fn lookup(&self) -> Buffer {
        self.packed.unwrap_or(self.tables)
    }

    /// Returns the bits of a number in that buffer.
    fn table_bits(&self) -> u32 {
        if self.packed.is_some() { 16 } else { 32 }
    }
}

/// Points and lights to be evaluated.
#[derive(Clone, Copy, Debug)]
pub struct View {
    /// Maximum number of pixels; the step's `pixels` is the actual number.
    pub pixels: u32,
    /// World-space points, `[pixels * 3]` floats.
    pub points: Buffer,
    /// Coverage, `[pixels]` floats; pixels below 1e-3 are not shaded.
    pub coverage: Buffer,
    /// World-space positions of the lights, `[lights * 3]` floats.
    pub lights: Buffer,
}

/// Returns whether subgroups process their pixels together, lanes over neurons.
fn field_spread(tuning: Tuning) -> bool {
    tuning.cpu && tuning.subgroup_size == 8
}

/// Returns whether the backward pass batches pairs. On CPUs lanes share a pair instead, because loads from buffers and
/// shared memory cost more than products there.
fn field_batched(tuning: Tuning) -> bool {
    !tuning.cpu
}

/// Returns the workgroup and subgroup sizes, and whether subgroups cooperate.
fn shape(tuning: Tuning) -> ([u32; 2], bool) {
    let spread = field_spread(tuning);
    ([if spread { 8 } else { tuning.workgroup.min(128) }, tuning.subgroup_size], spread)
}

/// Selects the forward kernel that evaluates the field, and its constants. The portable kernel takes the constants
/// unchanged. Kernels on matrices share its name with a suffix, and differ in the constants below.
fn forward(
    tuning: Tuning,
    [portable, halves]: [&'static Kernel; 2],
    specs: impl IntoIterator<Item = (&'static str, u32)>,
) -> (&'static Kernel, Vec<(&'static str, u32)>) {
    let on_units = || sgs_shaders::optional(&format!("{}_cooperative", portable.name));
    let chosen = tuning.field_matrices().and_then(|m| Some((m, if m.units { on_units()? } else { halves })));
    let Some((matrices, kernel)) = chosen else { return (portable, specs.into_iter().collect()) };
    let changed = |(name, bits): (&'static str, u32)| match name {
        // A workgroup is one subgroup, which multiplies its pixels together in groups of neurons.
        "WORKGROUP" => (name, tuning.subgroup_size),
        "FIELD_SPREAD" => (name, 0),
        _ => (name, bits),
    };
    let known = |(name, _): &(&'static str, u32)| kernel.specs.iter().any(|s| s.name == *name);
    (kernel, specs.into_iter().map(changed).filter(known).chain(matrices.specs()).collect())
}

/// Adds the pass that writes visibility to `into`, `[pixels]` floats in 0 to 1. Unshaded pixels are 0. The value is the
/// mean over the step's `lights`, or that of light `one` alone. With `split`, the first layer's product with the
/// point's features is computed once per pixel, otherwise once per pair (for comparison only).
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn visibility(
    g: &mut Graph,
    tuning: Tuning,
    field: &Field,
    view: &View,
    one: Option<u32>,
    split: bool,
    into: Buffer,
) -> Result<(), GraphError> {
    let bindings = kernel::Bindings {
        params: field.step.into(),
        field_levels: field.levels.into(),
        tables: field.lookup().into(),
        packed_tables: field.lookup().into(),
        mlp: field.mlp.into(),
        mlp_vectors: field.mlp.into(),
        light_positions: view.lights.into(),
        points: view.points.into(),
        coverage: view.coverage.into(),
        visibility: into.into(),
    };
    let ([workgroup, subgroup], field_spread) = shape(tuning);
    let one = one.unwrap_or(u32::MAX);
    let (levels, table_bits) = (field.config.levels, field.table_bits());
    let specs = kernel::Specs { workgroup, subgroup, field_spread, levels, split, one, table_bits };
    // The unsplit variant, used for comparison, exists only as a portable kernel.
    let tuning = if split { tuning } else { Tuning { matrices: None, ..tuning } };
    let (chosen, specs) = forward(tuning, [&kernel::KERNEL, &halves::KERNEL], specs.entries());
    let name = if split { chosen.name } else { "visibility_plain" };
    // Emulated matrix kernels do not depend on the subgroup size, and tests run them at any size.
    let matrices = tuning.field_matrices();
    let pass = stage(g, name, chosen, bindings.entries(), specs, &[]);
    let emulated = matrices.is_some_and(|m| !m.units);
    let pass = if emulated { pass.without_subgroups() } else { pass.subgroup_size(Some(subgroup)) };
    pass.dispatch(groups(u64::from(view.pixels), if matrices.is_some() { subgroup } else { workgroup }))
}

/// Adds the pass that writes the first layer's output for points of pixels. Encodes `count` pixels from `first` on.
/// `into` holds rows of 32 floats, written for shaded and unshaded pixels alike. Where the backward pass batches pairs,
/// rows of as many pixels as a subgroup has lanes are side by side, and `into` holds whole blocks of them. With `jitter`, points are displaced
/// slightly for the smoothness term.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
#[expect(clippy::too_many_arguments, reason = "declares a kernel")]
pub fn visibility_encode(
    g: &mut Graph,
    tuning: Tuning,
    name: &str,
    field: &Field,
    view: &View,
    [first, count]: [u32; 2],
    jitter: bool,
    into: Buffer,
) -> Result<(), GraphError> {
    let bindings = encode_kernel::Bindings {
        params: field.step.into(),
        field_levels: field.levels.into(),
        tables: field.lookup().into(),
        packed_tables: field.lookup().into(),
        mlp: field.mlp.into(),
        mlp_vectors: field.mlp.into(),
        points: view.points.into(),
        rows: into.into(),
    };
    let ([workgroup, subgroup], field_spread) = shape(tuning);
    let (levels, table_bits) = (field.config.levels, field.table_bits());
    let specs =
        encode_kernel::Specs { workgroup, subgroup, field_spread, levels, table_bits, by_block: field_batched(tuning) };
    let push = encode_kernel::Push { first, count, moved: jitter.into() };
    stage(g, name, &encode_kernel::KERNEL, bindings.entries(), specs.entries(), bytemuck::bytes_of(&push))
        .subgroup_size(Some(subgroup))
        .dispatch(groups(u64::from(count), workgroup))
}
