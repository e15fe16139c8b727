//! Errors of runs: one sentence each, naming what to do.

use sgs_config::ConfigError;
use std::path::{Path, PathBuf};

/// Errors of this crate.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// The GPU side failed.
    #[error(transparent)]
    Engine(#[from] sgs_engine::Error),
    /// The scene cannot be used.
    #[error(transparent)]
    Scene(#[from] sgs_scene::SceneError),
    /// A setting is wrong.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// A file of a run cannot be used.
    #[error("\"{path}\": {reason}.", path = path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// Another process writes into the directory.
    #[error("\"{path}\" is locked: {reason}.", path = path.display())]
    Locked {
        /// The directory.
        path: PathBuf,
        /// Who holds it, and what to do.
        reason: String,
    },
    /// The run cannot do what it was asked for.
    #[error("{0}")]
    Refused(String),
}

impl RunError {
    /// Makes an error about a file.
    pub fn file(path: &Path, reason: String) -> RunError {
        RunError::File { path: path.to_owned(), reason }
    }

    /// Whether the device's memory did not suffice.
    pub fn is_out_of_memory(&self) -> bool {
        matches!(self, RunError::Engine(error) if error.is_out_of_memory())
    }
}

/// Result with this crate's error.
pub type Result<T> = std::result::Result<T, RunError>;

/// Removes a file; a missing one is no error.
///
/// # Errors
/// If it cannot be removed.
pub fn remove(path: &Path) -> Result<()> {
    match std::fs::remove_file(path) {
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => Err(error(path, format!("cannot be removed: {e}"))),
        _ => Ok(()),
    }
}

pub(crate) fn error(path: &Path, reason: String) -> RunError {
    RunError::File { path: path.to_owned(), reason }
}
