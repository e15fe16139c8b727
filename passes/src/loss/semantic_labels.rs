//! `semantic_labels`: the class of every pixel, and how much it has of one.
//!
//! The class is that of the largest cosine between decoded features and text, the first of equals. Its relevance to a
//! queried class is the softmax's probability at the step's temperature, or the cosine itself. Pixels with features that
//! are not finite have [`NO_LABEL`] and relevance 0. Nothing is said about pixels without splats: their features are zero,
//! and the class is that of the decoder's bias; mask them by transmittance.
//!
//! Cost a pixel: 128 bytes read, 8 written, about 2300 + 140 C operations.

use super::semantic::{Prepared, batch_groups};
use crate::Tuning;
use crate::kernel::{groups, stage};
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::semantic_labels as kernel;

/// Where there is no class.
pub const NO_LABEL: u32 = u32::MAX;

/// What relevance means.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Relevance {
    /// Probability of the class by softmax.
    Probability,
    /// Cosine between decoded features and the class's text.
    Cosine,
}

/// What is classified.
#[derive(Clone, Copy, Debug)]
pub struct SemanticLabels {
    /// Uniform `Step`: size of the view, temperature.
    pub step: Buffer,
    /// `[P * channels]` floats.
    pub image: Buffer,
    /// Floats of a pixel.
    pub channels: u32,
    /// Channel of the first of the 32 features.
    pub first: u32,
    /// Columns and rows that no view exceeds, each for itself.
    pub largest: [u32; 2],
    /// How many classes.
    pub classes: u32,
    /// The class whose relevance is asked for.
    pub query: u32,
    /// What that is.
    pub meaning: Relevance,
}

/// Workgroups: one a batch, but on narrow subgroups, where each keeps all rows of the matrices, as few as possible.
fn label_groups(tuning: Tuning, pixels: u64, classes: u32) -> u64 {
    let batch = tuning.subgroup_size * tuning.tiles();
    match tuning.narrow() {
        true => batch_groups(tuning, pixels, batch, 128 + 2 * classes).into(),
        false => pixels.div_ceil(batch.into()),
    }
}

/// Adds the pass. `labels`: a word a pixel; `relevance`: a float a pixel.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn semantic_labels(
    g: &mut Graph,
    a: &SemanticLabels,
    prepared: &Prepared,
    labels: Buffer,
    relevance: Buffer,
) -> Result<(), GraphError> {
    let (subgroup, tiles) = (prepared.tuning.subgroup_size, prepared.tuning.tiles());
    let bindings = kernel::Bindings {
        params: a.step.into(),
        image: a.image.into(),
        matrices: prepared.matrices.into(),
        labels: labels.into(),
        relevance: relevance.into(),
    };
    let specs = kernel::Specs {
        subgroup,
        tiles,
        classes: a.classes,
        channels: a.channels,
        first: a.first,
        cosine: a.meaning == Relevance::Cosine,
    };
    let push = kernel::Push { query: a.query.min(a.classes.saturating_sub(1)) };
    let pixels = u64::from(a.largest[0]) * u64::from(a.largest[1]);
    stage(g, "semantic_labels", &kernel::KERNEL, bindings.entries(), specs.entries(), bytemuck::bytes_of(&push))
        .subgroup_size(Some(subgroup))
        .dispatch(groups(label_groups(prepared.tuning, pixels, a.classes), 1))
}
