//! Semantic classes of a run.

use anyhow::bail;
use sgs_passes::scene::FEATURES;
use sgs_run::{RunDirectory, SemanticHead};
use sgs_scene::Splats;
use std::path::Path;

/// Loads the semantic head of a run. Fails if the Gaussians or the run cannot be classified.
///
/// # Errors
/// If the Gaussians or the run cannot be classified.
pub fn head_of(source: &Path, splats: &Splats) -> anyhow::Result<SemanticHead> {
    let name = source.display();
    let Some((width, _)) = splats.semantic else {
        bail!(
            "\"{name}\" holds no semantic features; leave out \"semantic\" and --query, or train on a scene with \
             priors/semantic."
        );
    };
    if width != FEATURES {
        bail!("\"{name}\" holds {width} semantic features a splat, but {FEATURES} are needed to classify them.");
    }
    if !source.is_dir() {
        bail!(
            "\"{name}\" holds semantic features, but not the decoder that tells their classes; give the run directory \
             with its semantics.safetensors instead of the PLY."
        );
    }
    Ok(SemanticHead::load(&RunDirectory::open(source)?.semantics())?)
}
