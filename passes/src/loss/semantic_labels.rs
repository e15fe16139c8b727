//! `semantic_labels`: class of every pixel, and its relevance to a queried class.
//!
//! The class has the largest cosine between decoded features and text embedding; the first of equal ones. The relevance
//! is the softmax probability of the queried class at the step's temperature, or its cosine. Pixels with non-finite
//! features have [`NO_LABEL`] and relevance 0. Results at pixels without splats have no meaning: their features are
//! zero, so the class is that of the decoder's bias. Mask them by transmittance.
//!
//! Cost per pixel: 128 bytes read, 8 written, about 2300 + 140 C operations.

use super::semantic::{Prepared, batch_groups};
use crate::Tuning;
use crate::kernel::{groups, stage};
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::semantic_labels as kernel;

/// Label of pixels and samples without a class.
pub const NO_LABEL: u32 = u32::MAX;

/// Measure of relevance.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Relevance {
    /// Softmax probability of the class.
    Probability,
    /// Cosine between decoded features and the class's text embedding.
    Cosine,
}

/// Inputs of the classification.
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
    /// Upper bounds of the width and height of all views, in pixels.
    pub largest: [u32; 2],
    /// Number of classes.
    pub classes: u32,
    /// Class whose relevance is computed.
    pub query: u32,
    /// Measure of relevance.
    pub meaning: Relevance,
}

/// Returns the number of workgroups: one per batch. On narrow subgroups, where each workgroup holds all rows of the
/// matrices, it is as small as possible.
fn label_groups(tuning: Tuning, pixels: u64, classes: u32) -> u64 {
    let batch = tuning.subgroup_size * tuning.tiles();
    match tuning.narrow() {
        true => batch_groups(tuning, pixels, batch, 128 + 2 * classes).into(),
        false => pixels.div_ceil(batch.into()),
    }
}

/// Adds the pass of the classification. `labels`: one word per pixel; `relevance`: one float per pixel.
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
