//! `visibility_adam`: a step of Adam for the field's tables and layers.
//!
//! Promises: an entry whose gradient is exactly zero keeps its numbers and moments; gradients of tables and the bits of what was
//! touched are zero afterwards, whatever happened; a raised flag moves nothing. What moves is bit for bit what
//! [`crate::optim::adam()`] with `skip_zero` makes of the same gradients. A copy in 16 bits is what the tables round to. Cost: the bits, 1/8 byte an entry, and 80 bytes for each entry
//! that was touched; those that were not, most of the finer levels, cost nothing.

use super::{Field, Gradients};
use crate::Tuning;
use crate::kernel::{groups, stage};
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::{visibility_adam as tables, visibility_adam_layers as layers, visibility_adam_packed as packed};

/// What drives the field, and what remembers.
#[derive(Clone, Copy, Debug)]
pub struct Moments {
    /// `[entries * 2 * 2]` floats: first and second moment of each scalar.
    pub tables: Buffer,
    /// `[weights * 2]` floats.
    pub mlp: Buffer,
    /// Words of which none may be set.
    pub flags: Buffer,
    /// How many words.
    pub flag_words: u32,
    /// A counter, increased by the number of gradients that were skipped because they are not finite.
    pub skipped: Buffer,
}

/// Adds the passes. The learning rate and 1 / (1 - beta^t) are the field's step's.
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
            let specs = $kernel::Specs { workgroup, flags: moments.flag_words };
            let push = $kernel::Push { words: field.config.entries().div_ceil(32) };
            let bytes = bytemuck::bytes_of(&push);
            stage(g, "visibility_adam", &$kernel::KERNEL, bindings.entries(), specs.entries(), bytes)
                .dispatch(groups(u64::from(push.words), workgroup))?;
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
