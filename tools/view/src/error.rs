//! Why nothing can be shown.

use std::path::PathBuf;

/// Errors of this crate: one sentence each.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ViewerError {
    /// There is no display.
    #[error(
        "There is no display to open a window on ({0}); set DISPLAY or WAYLAND_DISPLAY, or write pictures with \
         \"sgs render\"."
    )]
    NoDisplay(String),
    /// The window's system refused something.
    #[error("The window could not be opened: {0}.")]
    Window(String),
    /// The channel that was asked for is none of the source's.
    #[error("\"{path}\" has no {channel} to be shown; it has {has}.", path = path.display())]
    Channel {
        /// What is shown.
        path: PathBuf,
        /// What was asked for.
        channel: &'static str,
        /// What there is.
        has: String,
    },
    /// There is nothing to look at.
    #[error("\"{path}\" holds no Gaussians.", path = path.display())]
    Empty {
        /// What was to be shown.
        path: PathBuf,
    },
    /// A file of cameras without any.
    #[error("\"{path}\" holds no cameras.", path = path.display())]
    NoCameras {
        /// The file.
        path: PathBuf,
    },
    /// The run cannot be opened.
    #[error(transparent)]
    Run(#[from] sgs_run::RunError),
    /// The source cannot be relit.
    #[error(transparent)]
    Relight(#[from] sgs_relight::RelightError),
    /// A file cannot be read or written.
    #[error(transparent)]
    Scene(#[from] sgs_scene::SceneError),
    /// Drawing failed.
    #[error(transparent)]
    View(#[from] sgs_passes::pipeline::ViewError),
    /// The device failed.
    #[error(transparent)]
    Engine(#[from] sgs_engine::Error),
}

/// Result with this crate's error.
pub type Result<T> = std::result::Result<T, ViewerError>;
