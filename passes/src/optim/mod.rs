//! Optimizer, densification and pruning, opacity reset.

pub mod adam;
pub mod adam_unseen;
mod decoder;
pub mod densify;
pub mod opacity_reset;
mod trainable;

pub use adam::{Adam, EPSILON, Rate, adam};
pub use adam_unseen::{AdamUnseen, adam_unseen, adam_unseen_features};
pub use decoder::decoder_step;
pub use densify::{Densify, densify};
pub use opacity_reset::opacity_reset;
pub use trainable::{AdamRule, StepWords};
