//! Light that bounces between the surfaces of a room.
//!
//! Surfels stand for the surfaces that the training views see ([`RoomSurfels`]). Emitters are found in the photographs
//! ([`find_emitters`]). A [`Room`] lights Gaussians with physical lights and their bounces. [`fit_room`] explains the
//! photographs of a scene.

mod emitters;
mod error;
mod explain;
mod fit;
mod fitted;
mod needs;
mod placement;
mod radiosity;
mod room;
mod shown;
mod surfels;
mod training;
mod views;

pub use emitters::{FoundEmitter, find_emitters};
pub use error::{Result, TransportError};
pub use explain::Explained;
pub use fitted::{FittedRoom, fit_room, room_of, training_room};
pub use needs::FitNeeds;
pub use room::{Bounces, LitRoom, Room, RoomOptions, planned_patches};
pub use surfels::{RoomSurfels, SurfelMaterial, SurfelOptions};
pub use training::{TrainingRoom, ViewLightBuffers};
pub use views::SeenViews;
