//! Trained parameters as GPU buffers: one per parameter group, with Adam's moments.
//!
//! Guarantees: groups that the model lacks take placeholders of four scalars. The tools read and write files.

mod decoder;
mod gaussians;
mod model;
mod trainable;

pub use decoder::{AUGMENTED, Decoder, DecoderHandles, EMBEDDING, FEATURES};
pub use gaussians::{GaussianData, Gaussians, Handles, Layout, STATISTICS};
pub use model::{Group, Model, SEMANTIC_FEATURES};
pub use trainable::{Trainable, TrainableHandles};
