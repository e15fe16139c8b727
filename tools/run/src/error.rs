//! Errors of runs. Each is one sentence that states what to do.

use sgs_config::{ConfigError, end_mark};
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
    #[error("\"{path}\": {reason}{}", end_mark(reason), path = path.display())]
    File {
        /// Path of the file.
        path: PathBuf,
        /// What is wrong with the file.
        reason: String,
    },
    /// File or directory that cannot be written or removed.
    #[error("\"{path}\" cannot be {action}: {cause}.", path = path.display())]
    Io {
        /// Attempted action as a participle: "written", "made", "removed".
        action: &'static str,
        /// Path of the file or directory.
        path: PathBuf,
        /// Error of the operating system.
        cause: std::io::Error,
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

    /// Returns whether the disk is full or read-only.
    pub fn is_storage_error(&self) -> bool {
        match self {
            RunError::Scene(error) => error.is_storage_error(),
            RunError::Io { cause, .. } => sgs_scene::is_storage_error(cause),
            _ => false,
        }
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
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => Err(io_error("removed", path)(e)),
        _ => Ok(()),
    }
}

/// Returns a function that creates the error of a failed action on a file.
pub fn io_error(action: &'static str, path: &Path) -> impl FnOnce(std::io::Error) -> RunError {
    let path = path.to_owned();
    move |cause| RunError::Io { action, path, cause }
}

pub(crate) fn error(path: &Path, reason: String) -> RunError {
    RunError::File { path: path.to_owned(), reason }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_end_with_one_mark() {
        let message = |reason: &str| RunError::file(Path::new("a"), reason.into()).to_string();
        assert_eq!(message("\"b\" is unknown; did you mean \"c\"?"), "\"a\": \"b\" is unknown; did you mean \"c\"?");
        assert_eq!(message("is not valid"), "\"a\": is not valid.");
    }
}
