//! Optimizer, densification, opacity reset, learned cameras and colors of views.

pub mod adam;
pub mod adam_unseen;
mod decoder;
pub mod densify;
pub mod opacity_reset;
pub mod position_noise;
pub mod relocate;
mod trainable;
pub mod views;

pub use adam::{Adam, EPSILON, Rate, adam};
pub use adam_unseen::{AdamUnseen, adam_unseen, adam_unseen_features};
pub use decoder::decoder_step;
pub use densify::{Densify, densify};
pub use opacity_reset::opacity_reset;
pub use position_noise::position_noise;
pub use relocate::{Relocate, relocate};
pub use trainable::{AdamRule, StepWords};
pub use views::{
    CameraParts, ViewGradients, ViewStatus, camera_bwd, camera_part_bytes, view_gain, view_gain_bwd, view_place,
    view_step,
};
