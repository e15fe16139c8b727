//! Errors of the transport of light.

use sgs_passes::transport::{AreaLightError, EnclosureError, TreeError};

/// Result of this crate.
pub type Result<T> = std::result::Result<T, TransportError>;

/// Reason why a room or its light cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum TransportError {
    /// No view shows a surface.
    #[error("No view shows a surface, so no light can bounce; check the cameras of the scene.")]
    Empty,
    /// The room cannot be fitted.
    #[error("{0}")]
    Refused(String),
    /// The surfels cannot be arranged for rays.
    #[error(transparent)]
    Tree(#[from] TreeError),
    /// The surfaces span no box.
    #[error(transparent)]
    Enclosure(#[from] EnclosureError),
    /// A light is invalid.
    #[error("A light is invalid: {0}.")]
    Light(#[from] AreaLightError),
    /// The run cannot be shaded.
    #[error(transparent)]
    Run(#[from] sgs_run::RunError),
    /// The device failed or memory ran out.
    #[error(transparent)]
    Engine(#[from] sgs_engine::Error),
    /// A photograph cannot be read.
    #[error(transparent)]
    Scene(#[from] sgs_scene::SceneError),
}
