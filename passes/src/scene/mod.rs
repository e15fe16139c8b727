//! What is learned, as buffers on the GPU: one for each parameter group, with Adam's moments beside it.
//!
//! Promises: groups that the model lacks cost nothing. Leaves files to the tools.

mod decoder;
mod gaussians;
mod model;
mod trainable;

pub use decoder::{AUGMENTED, Decoder, DecoderHandles, EMBEDDING, FEATURES, decoder_step};
pub use gaussians::{GaussianData, Gaussians, Handles, Layout, STATISTICS};
pub use model::{Group, Model, SEMANTIC_FEATURES};
pub use trainable::{StepWords, Trainable, TrainableHandles};
