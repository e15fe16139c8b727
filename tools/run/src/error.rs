//! Errors of runs. Each is one sentence that states what to do.

use sgs_config::ConfigError;
use std::path::{Path, PathBuf};

/// Errors of this crate.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// Failure of the GPU engine.
    #[error(transparent)]
    Engine(#[from] sgs_engine::Error),
    /// Unusable scene.
    #[error(transparent)]
    Scene(#[from] sgs_scene::SceneError),
    /// Invalid setting.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// Unusable file of a run.
    #[error("\"{path}\": {reason}.", path = path.display())]
    File {
        /// Path of the file.
        path: PathBuf,
        /// What is wrong with the file.
        reason: String,
    },
    /// Directory that another process writes into.
    #[error("\"{path}\" is locked: {reason}.", path = path.display())]
    Locked {
        /// Path of the directory.
        path: PathBuf,
        /// Holder of the lock, and what to do.
        reason: String,
    },
    /// Request that the run cannot fulfill.
    #[error("{0}")]
    Refused(String),
}

impl RunError {
    /// Creates an error about a file.
    pub fn file(path: &Path, reason: String) -> RunError {
        RunError::File { path: path.to_owned(), reason }
    }

    /// Returns whether device memory ran out.
    pub fn is_out_of_memory(&self) -> bool {
        matches!(self, RunError::Engine(error) if error.is_out_of_memory())
    }
}

/// Result with this crate's error.
pub type Result<T> = std::result::Result<T, RunError>;

/// Removes a file; a missing file is no error.
///
/// # Errors
/// If the file cannot be removed.
pub fn remove(path: &Path) -> Result<()> {
    match std::fs::remove_file(path) {
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => Err(error(path, format!("cannot be removed: {e}"))),
        _ => Ok(()),
    }
}

pub(crate) fn error(path: &Path, reason: String) -> RunError {
    RunError::File { path: path.to_owned(), reason }
}
