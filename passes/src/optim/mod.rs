//! Optimizer, densification, opacity reset, learned cameras and colors of views.

pub mod adam;
pub mod adam_unseen;
mod decoder;
pub mod densify;
pub mod opacity_reset;
mod trainable;
pub mod views;

pub use adam::{Adam, EPSILON, Rate, adam};
pub use adam_unseen::{AdamUnseen, adam_unseen, adam_unseen_features};
pub use decoder::decoder_step;
pub use densify::{Densify, densify};
pub use opacity_reset::opacity_reset;
pub use trainable::{AdamRule, StepWords};
pub use views::{
    CameraParts, ViewGradients, ViewStatus, camera_bwd, camera_part_bytes, view_gain, view_gain_bwd, view_place,
    view_step,
};
