//! `adam` of the semantic decoder.

use super::{Adam, Rate, adam};
use crate::Tuning;
use crate::scene::{AUGMENTED, DecoderHandles, EMBEDDING};
use sgs_engine::graph::{Buffer, Graph, GraphError};

/// Epsilon of the decoder's Adam.
const EPSILON: f32 = 1e-8;

/// Adds the Adam pass of a decoder. The gradient is that of [`crate::loss::decoder_gradient`], the rate is `lr_decoder`
/// of the step, epsilon is 1e-8. A decoder without moments is not changed. `flags`, `skipped`: as in [`Adam`].
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn decoder_step(
    g: &mut Graph,
    tuning: Tuning,
    step: Buffer,
    decoder: &DecoderHandles,
    gradients: Buffer,
    flags: Buffer,
    skipped: Buffer,
) -> Result<(), GraphError> {
    let Some(moments) = decoder.moments else { return Ok(()) };
    let what = Adam {
        step,
        live: decoder.work,
        flags,
        flag_words: 1,
        width: AUGMENTED as u32,
        capacity: (EMBEDDING * AUGMENTED) as u64,
        rate: Rate::Decoder,
        skip_zero: false,
        epsilon: EPSILON,
        gradients,
        parameters: decoder.parameters,
        moments,
        skipped,
    };
    adam(g, tuning, "adam.decoder", &what)
}
