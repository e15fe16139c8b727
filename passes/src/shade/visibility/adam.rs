//! `visibility_adam`: an Adam step for the field's tables and layers.
//!
//! Guarantees: an entry whose gradient is exactly zero keeps its values and moments. Table gradients and touched bits
//! are always zero afterwards. If a flag is set, no parameter changes. Updates are bit-identical to those of
//! [`crate::optim::adam()`] with `skip_zero` for the same gradients. A 16-bit copy holds the rounded tables.
//!
//! Cost: 1/8 byte per entry for the touched bits, and 80 bytes for each touched entry. Untouched entries, most of those
//! of the finer levels, cost nothing else.

use super::{Field, Gradients};
use crate::Tuning;
use crate::kernel::{groups, stage};
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::{visibility_adam as tables, visibility_adam_layers as layers, visibility_adam_packed as packed};

/// Optimizer state of a field.
#[derive(Clone, Copy, Debug)]
pub struct Moments {
    /// First and second moment of each table value, `[entries * 2 * 2]` floats.
    pub tables: Buffer,
    /// First and second moment of each weight, `[weights * 2]` floats.
    pub mlp: Buffer,
    /// Flag words; if any is set, the step changes no parameters.
    pub flags: Buffer,
    /// Number of flag words.
    pub flag_words: u32,
    /// Counter of skipped gradients, increased by each one that is not finite.
    pub skipped: Buffer,
}

/// Adds the passes. The field's step holds the learning rate and 1 / (1 - beta^t).
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn visibility_adam(
    g: &mut Graph,
    tuning: Tuning,
    field: &Field,
    gradients: &Gradients,
    moments: &Moments,
) -> Result<(), GraphError> {
    let workgroup = tuning.workgroup.min(64);
    macro_rules! of_tables {
        ($kernel:ident, $($more:tt)*) => {{
            let bindings = $kernel::Bindings {
                params: field.step.into(),
                flags: moments.flags.into(),
                scale: gradients.scale.into(),
                touched: gradients.touched.into(),
                table_gradients: gradients.tables.into(),
                tables: field.tables.into(),
                moments: moments.tables.into(),
                $($more)*
            };
            let by_entry = workgroup.is_multiple_of(32) && tuning.subgroup_size >= 32;
            let specs = $kernel::Specs { workgroup, flags: moments.flag_words, by_entry };
            let push = $kernel::Push { words: field.config.entries().div_ceil(32) };
            let invocations = u64::from(push.words) * if by_entry { 32 } else { 1 };
            let bytes = bytemuck::bytes_of(&push);
            stage(g, "visibility_adam", &$kernel::KERNEL, bindings.entries(), specs.entries(), bytes)
                .dispatch(groups(invocations, workgroup))?;
        }};
    }
    match field.packed {
        Some(copy) => of_tables!(packed, packed_tables: copy.into(),),
        None => of_tables!(tables,),
    }
    let bindings = layers::Bindings {
        params: field.step.into(),
        flags: moments.flags.into(),
        mlp_gradient: gradients.mlp.into(),
        mlp: field.mlp.into(),
        moments: moments.mlp.into(),
        skipped: moments.skipped.into(),
    };
    let specs = layers::Specs { workgroup, flags: moments.flag_words };
    let push = layers::Push { count: field.config.weights() as u32 };
    stage(g, "visibility_adam_layers", &layers::KERNEL, bindings.entries(), specs.entries(), bytemuck::bytes_of(&push))
        .dispatch(groups(u64::from(push.count), workgroup))
}
