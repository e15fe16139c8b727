//! Errors of captures.

use sgs_scene::SceneError;
use std::io;
use std::path::{Path, PathBuf};

/// Reason why no scene was written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CaptureError {
    /// The photographs or the video can never become a scene.
    #[error("{0}")]
    Input(String),
    /// A program is not installed.
    #[error("the program {program} is not on the PATH; install it, on Debian with: apt-get install {package}")]
    Missing {
        /// Name of the program.
        program: &'static str,
        /// Debian package of the program.
        package: &'static str,
    },
    /// A program failed.
    #[error("{program} failed ({status}): {message}")]
    Program {
        /// Program and its command.
        program: String,
        /// Exit status of the program.
        status: String,
        /// Last message of the program.
        message: String,
    },
    /// An operating system call failed.
    #[error("cannot {action} {}: {cause}", path.display())]
    Io {
        /// Attempted action as a verb.
        action: &'static str,
        /// File, directory or program.
        path: PathBuf,
        /// Error of the operating system.
        cause: io::Error,
    },
    /// A file cannot be read or written.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// The caller stopped the capture.
    #[error("the capture was stopped; nothing was written")]
    Stopped,
}

/// Result of the functions of this crate.
pub type Result<T, E = CaptureError> = std::result::Result<T, E>;

/// Returns a closure for `map_err` that creates a [`CaptureError::Io`].
pub(crate) fn io_error(action: &'static str, path: &Path) -> impl FnOnce(io::Error) -> CaptureError {
    let path = path.to_path_buf();
    move |cause| CaptureError::Io { action, path, cause }
}
