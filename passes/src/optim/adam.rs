//! `adam`: one step of Adam for a parameter group whose gradients lie in a buffer.
//!
//! Kingma and Ba 2015, for Gaussians with epsilon 1e-15 (Kerbl et al. 2023). Promises: nothing changes when a flag of the step is
//! raised; gradients that are not finite are skipped and counted; gradients beyond 1e15 count as 1e15, so that the second
//! moment stays finite; with [`Adam::skip_zero`] what was not seen in a step is left exactly as it is.
//!
//! Cost a scalar: 16 bytes read, 12 written, about 15 operations.

use crate::kernel::stage;
use crate::{Tuning, kernel};
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::adam;

/// Which learning rate a group follows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Rate {
    /// `lr_means` of the step.
    Means,
    /// `lr_scales` of the step.
    Scales,
    /// `lr_rotations` of the step.
    Rotations,
    /// `lr_opacities` of the step.
    Opacities,
    /// `lr_sh0` of the step.
    Sh0,
    /// `lr_sh_rest` of the step.
    ShRest,
    /// `lr_normals` of the step.
    Normals,
    /// `lr_decoder` of the step.
    Decoder,
    /// `lr_semantics` of the step.
    Semantics,
    /// One that never changes.
    Constant(f32),
    /// This one times `lr_share` of the step.
    Share(f32),
}

impl Rate {
    pub(super) fn index(self) -> u32 {
        match self {
            Rate::Means => 0,
            Rate::Scales => 1,
            Rate::Rotations => 2,
            Rate::Opacities => 3,
            Rate::Sh0 => 4,
            Rate::ShRest => 5,
            Rate::Normals => 6,
            Rate::Constant(_) => 7,
            Rate::Decoder => 8,
            Rate::Semantics => 9,
            Rate::Share(_) => 10,
        }
    }
}

/// Epsilon of everything that Gaussians carry.
pub const EPSILON: f32 = 1e-15;

/// A parameter group and what drives it.
#[derive(Clone, Copy, Debug)]
pub struct Adam {
    /// Uniform `Step`: learning rates and bias corrections.
    pub step: Buffer,
    /// A `Work`: the number of elements.
    pub live: Buffer,
    /// Words of which none may be set.
    pub flags: Buffer,
    /// How many words.
    pub flag_words: u32,
    /// Scalars of an element.
    pub width: u32,
    /// Most elements that there can be.
    pub capacity: u64,
    /// The learning rate.
    pub rate: Rate,
    /// Whether an exactly-zero gradient leaves its scalar and moments untouched, rather than letting them decay.
    pub skip_zero: bool,
    /// Added to the root of the second moment: [`EPSILON`] for Gaussians.
    pub epsilon: f32,
    /// Gradients, `width` an element.
    pub gradients: Buffer,
    /// Parameters, likewise.
    pub parameters: Buffer,
    /// First and second moment of each scalar.
    pub moments: Buffer,
    /// A counter, increased by the number of skipped gradients.
    pub skipped: Buffer,
}

/// Adds the pass.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn adam(g: &mut Graph, tuning: Tuning, name: &str, a: &Adam) -> Result<(), GraphError> {
    let bindings = adam::Bindings {
        params: a.step.into(),
        live: a.live.into(),
        flags: a.flags.into(),
        gradients: a.gradients.into(),
        parameters: a.parameters.into(),
        moments: a.moments.into(),
        skipped: a.skipped.into(),
    };
    let specs = adam::Specs {
        workgroup: tuning.workgroup,
        width: a.width,
        rate: a.rate.index(),
        skip_zero: a.skip_zero,
        flags: a.flag_words,
        epsilon: a.epsilon,
    };
    let rate = if let Rate::Constant(rate) | Rate::Share(rate) = a.rate { rate } else { 0.0 };
    // Every invocation has one element's worth of scalars when all of the capacity is alive.
    stage(g, name, &adam::KERNEL, bindings.entries(), specs.entries(), bytemuck::bytes_of(&adam::Push { rate }))
        .dispatch(kernel::groups(a.capacity, tuning.workgroup))
}
