//! Trained parameters as GPU buffers, with Adam's moments.
//!
//! Gaussians take one buffer of columns, and one each for their first and second moments; semantic features take two of
//! their own. Guarantees: features that the model lacks take placeholders of four scalars. The tools read and write files.

mod columns;
mod compact;
mod decoder;
mod gaussians;
mod model;
mod trainable;
mod views;

pub use columns::BLOCK;
pub use compact::Storage;
pub use decoder::{AUGMENTED, Decoder, DecoderHandles, EMBEDDING, FEATURES};
pub use gaussians::{GaussianData, Gaussians, Handles, Layout, MomentHandles, STATISTICS};
pub use model::{Group, Model, SEMANTIC_FEATURES};
pub use trainable::{Trainable, TrainableHandles};
pub use views::{LearnedViews, ViewHandles, ViewKinds};
