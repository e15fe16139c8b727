//! `adam`: one Adam step of a parameter group with gradients in a buffer.
//!
//! Kingma and Ba 2015; epsilon 1e-15 for Gaussians (Kerbl et al. 2023). Guarantees: a raised flag of the step prevents
//! all changes. Non-finite gradients are skipped and counted. Gradients are clamped to ±1e15, so that the second moment
//! stays finite. With [`Adam::skip_zero`], elements that a step did not see stay unchanged.
//!
//! Cost per scalar: 16 bytes read, 12 written, about 15 operations.

use crate::kernel::stage;
use crate::{Tuning, kernel};
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::adam;

/// Learning rate of a group.
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
    /// Constant rate.
    Constant(f32),
    /// This value times `lr_share` of the step.
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

/// Epsilon for all parameters of Gaussians.
pub const EPSILON: f32 = 1e-15;

/// Adam inputs of a parameter group.
#[derive(Clone, Copy, Debug)]
pub struct Adam {
    /// Uniform `Step`: learning rates and bias corrections.
    pub step: Buffer,
    /// Number of elements, a `Work`.
    pub live: Buffer,
    /// Flag words. If any is not zero, the step changes nothing.
    pub flags: Buffer,
    /// Number of flag words.
    pub flag_words: u32,
    /// Scalars per element.
    pub width: u32,
    /// Largest number of elements.
    pub capacity: u64,
    /// Learning rate of the group.
    pub rate: Rate,
    /// Whether a zero gradient leaves its scalar and moments unchanged. Otherwise the moments decay.
    pub skip_zero: bool,
    /// Added to the root of the second moment: [`EPSILON`] for Gaussians.
    pub epsilon: f32,
    /// Gradients, `width` per element.
    pub gradients: Buffer,
    /// Parameters, `width` per element.
    pub parameters: Buffer,
    /// First and second moment of each scalar.
    pub moments: Buffer,
    /// Counter of skipped gradients.
    pub skipped: Buffer,
}

/// Adds the Adam pass of a parameter group.
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
    // With the full capacity in use, an invocation processes the scalars of one element.
    stage(g, name, &adam::KERNEL, bindings.entries(), specs.entries(), bytemuck::bytes_of(&adam::Push { rate }))
        .dispatch(kernel::groups(a.capacity, tuning.workgroup))
}
