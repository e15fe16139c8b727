//! Errors of the viewer.

use std::path::PathBuf;

/// Errors of this crate, one sentence each.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ViewerError {
    /// Missing display.
    #[error(
        "There is no display to open a window on ({0}); set DISPLAY or WAYLAND_DISPLAY, or write images with \
         \"sgs render\"."
    )]
    NoDisplay(String),
    /// Error of the window system.
    #[error("The window could not be opened: {0}.")]
    Window(String),
    /// Requested channel that the source lacks.
    #[error("\"{path}\" has no {channel} to be shown; it has {has}.", path = path.display())]
    Channel {
        /// Shown source.
        path: PathBuf,
        /// Requested channel.
        channel: &'static str,
        /// Available channels.
        has: String,
    },
    /// Source without Gaussians.
    #[error("\"{path}\" holds no Gaussians.", path = path.display())]
    Empty {
        /// Path of the source.
        path: PathBuf,
    },
    /// Camera file without cameras.
    #[error("\"{path}\" holds no cameras.", path = path.display())]
    NoCameras {
        /// Path of the file.
        path: PathBuf,
    },
    /// Run that cannot be opened.
    #[error(transparent)]
    Run(#[from] sgs_run::RunError),
    /// Source that cannot be relit.
    #[error(transparent)]
    Relight(#[from] sgs_relight::RelightError),
    /// File that cannot be read or written.
    #[error(transparent)]
    Scene(#[from] sgs_scene::SceneError),
    /// Failure of drawing.
    #[error(transparent)]
    View(#[from] sgs_passes::pipeline::ViewError),
    /// Failure of the device.
    #[error(transparent)]
    Engine(#[from] sgs_engine::Error),
}

/// Result with this crate's error.
pub type Result<T> = std::result::Result<T, ViewerError>;
