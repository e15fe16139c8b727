//! `visibility_encode` and `visibility`: a learned field of how much of a light a point sees.
//!
//! SGS-Intrinsic, stage II: features of a hash grid at the point, direction from the light, distance, through layers of 32,
//! 32 and 1; positions are those of the box, clamped to it. The first layer is split: its product with the features is
//! made once a pixel, so a pair of pixel and light costs 4 x 32 products there instead of 36 x 32. Direction and distance are not
//! split any further: differences of positions are exact where points and lights are close, differences of products are not.
//!
//! Nothing of size pixels times lights is stored. What the first layer makes of a point can be (`visibility_encode`, 128
//! bytes a pixel): whoever goes through the lights in another order, or twice, then need not look into the tables again.
//!
//! Tables may be looked up in 16 bits ([`crate::Accuracy::table_bits`]): a copy of them, rounded to nearest, that whoever moves them
//! keeps. Gradients are those at the rounded numbers, passed on as if nothing had been rounded; tables and moments keep 32 bits.
//!
//! Cost: 128 gathers of 8 bytes (4 with tables of 16 bits) and 1024 multiply-adds a pixel; 1184 multiply-adds a pair.

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
pub use memory::{FieldHandles, VisibilityField, packed_tables};

use crate::Tuning;
use crate::kernel::{groups, stage};
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::{Kernel, visibility as kernel, visibility_encode as encode_kernel, visibility_halves as halves};

/// A field in a graph.
#[derive(Clone, Copy, Debug)]
pub struct Field {
    /// Its shape.
    pub config: FieldConfig,
    /// Uniform `FieldStep`: box, jitter, sizes, seed, learning rate.
    pub step: Buffer,
    /// `[levels]` of `FieldLevel`: [`FieldConfig::table_levels`].
    pub levels: Buffer,
    /// `[entries * 2]` floats.
    pub tables: Buffer,
    /// `[entries]` words of two halves: what is looked up instead of the tables, if that has 16 bits.
    pub packed: Option<Buffer>,
    /// `[weights]` floats: rows of the first layer (features, direction, distance), of the second, the last.
    pub mlp: Buffer,
}

impl Field {
    /// What lookups read.
    fn lookup(&self) -> Buffer {
        self.packed.unwrap_or(self.tables)
    }

    /// Bits of a number there.
    fn table_bits(&self) -> u32 {
        if self.packed.is_some() { 16 } else { 32 }
    }
}

/// What is looked at from where.
#[derive(Clone, Copy, Debug)]
pub struct View {
    /// Most pixels that there can be; the step's `pixels` says how many there are.
    pub pixels: u32,
    /// `[pixels * 3]` floats, world.
    pub points: Buffer,
    /// `[pixels]` floats; pixels below 1e-3 are not shaded.
    pub coverage: Buffer,
    /// `[lights * 3]` floats, world.
    pub lights: Buffer,
}

/// Whether subgroups work on their pixels together.
fn field_spread(tuning: Tuning) -> bool {
    tuning.subgroup_size == 8
}

/// Invocations of a workgroup and a subgroup, and whether these work on their pixels together.
fn shape(tuning: Tuning) -> ([u32; 2], bool) {
    let spread = field_spread(tuning);
    ([if spread { 8 } else { tuning.workgroup.min(128) }, tuning.subgroup_size], spread)
}

/// A kernel that looks into the field, forward, and its constants: as they are for the portable kernel, or for one on matrices, which
/// bear its name with an ending and differ in the constants below.
fn forward(
    tuning: Tuning,
    [portable, halves]: [&'static Kernel; 2],
    specs: impl IntoIterator<Item = (&'static str, u32)>,
) -> (&'static Kernel, Vec<(&'static str, u32)>) {
    let on_units = || sgs_shaders::optional(&format!("{}_cooperative", portable.name));
    let chosen = tuning.field_matrices().and_then(|m| Some((m, if m.units { on_units()? } else { halves })));
    let Some((matrices, kernel)) = chosen else { return (portable, specs.into_iter().collect()) };
    let changed = |(name, bits): (&'static str, u32)| match name {
        // A workgroup is a subgroup, whose pixels are multiplied together, neurons by neurons of its own.
        "WORKGROUP" => (name, tuning.subgroup_size),
        "FIELD_SPREAD" => (name, 0),
        _ => (name, bits),
    };
    let known = |(name, _): &(&'static str, u32)| kernel.specs.iter().any(|s| s.name == *name);
    (kernel, specs.into_iter().map(changed).filter(known).chain(matrices.specs()).collect())
}

/// Adds the pass that writes how much of the lights each pixel sees: `into`, `[pixels]` floats in 0 to 1, 0 where nothing is
/// shaded. The mean over the step's `lights`, or of light `one` alone. `split`: whether the first layer's share of the point
/// is made once a pixel; if not, once a pair (only there for comparison).
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
        light_positions: view.lights.into(),
        points: view.points.into(),
        coverage: view.coverage.into(),
        visibility: into.into(),
    };
    let ([workgroup, subgroup], field_spread) = shape(tuning);
    let one = one.unwrap_or(u32::MAX);
    let (levels, table_bits) = (field.config.levels, field.table_bits());
    let specs = kernel::Specs { workgroup, subgroup, field_spread, levels, split, one, table_bits };
    // What is there for comparison is the portable kernel.
    let tuning = if split { tuning } else { Tuning { matrices: None, ..tuning } };
    let (chosen, specs) = forward(tuning, [&kernel::KERNEL, &halves::KERNEL], specs.entries());
    let name = if split { chosen.name } else { "visibility_plain" };
    // Ordinary instructions on pieces know no subgroups: tests try any size of these.
    let matrices = tuning.field_matrices();
    let pass = stage(g, name, chosen, bindings.entries(), specs, &[]);
    let emulated = matrices.is_some_and(|m| !m.units);
    let pass = if emulated { pass.without_subgroups() } else { pass.subgroup_size(Some(subgroup)) };
    pass.dispatch(groups(u64::from(view.pixels), if matrices.is_some() { subgroup } else { workgroup }))
}

/// Adds the pass that writes what the first layer makes of the points of `count` pixels from `first` on: `into`, rows of 32
/// floats, whether or not something is shaded there. `jitter`: of points moved a little, for the smoothness term.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
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
        points: view.points.into(),
        rows: into.into(),
    };
    let ([workgroup, subgroup], field_spread) = shape(tuning);
    let (levels, table_bits) = (field.config.levels, field.table_bits());
    let specs = encode_kernel::Specs { workgroup, subgroup, field_spread, levels, table_bits };
    let push = encode_kernel::Push { first, count, moved: jitter.into() };
    stage(g, name, &encode_kernel::KERNEL, bindings.entries(), specs.entries(), bytemuck::bytes_of(&push))
        .subgroup_size(Some(subgroup))
        .dispatch(groups(u64::from(count), workgroup))
}
