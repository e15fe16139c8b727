//! Errors of batches.

use std::path::{Path, PathBuf};

/// Batch that cannot start or cannot go on.
#[derive(Debug, thiserror::Error)]
pub enum BatchError {
    /// Manifest or baseline that is wrong.
    #[error("\"{}\": {problem}{}", path.display(), sgs_config::end_mark(problem))]
    Wrong {
        /// File that is wrong.
        path: PathBuf,
        /// What is wrong, and what to do.
        problem: String,
    },
    /// File that cannot be read or written.
    #[error("\"{}\" {problem}.", path.display())]
    File {
        /// Path of the file.
        path: PathBuf,
        /// Reason.
        problem: String,
        /// Whether the disk is full or read-only.
        storage: bool,
    },
    /// Error of settings.
    #[error(transparent)]
    Config(#[from] sgs_config::ConfigError),
    /// Error of a scene.
    #[error(transparent)]
    Scene(#[from] sgs_scene::SceneError),
    /// Error of a run directory.
    #[error(transparent)]
    Run(#[from] sgs_run::RunError),
}

/// Result with this crate's error.
pub type Result<T> = std::result::Result<T, BatchError>;

/// Creates the error of a wrong file.
pub(crate) fn wrong(path: &Path, problem: impl Into<String>) -> BatchError {
    BatchError::Wrong { path: path.to_owned(), problem: problem.into() }
}

/// Returns a function that creates the error of a failed action on a file.
pub(crate) fn failed(action: &'static str, path: &Path) -> impl FnOnce(std::io::Error) -> BatchError {
    move |e| {
        let storage = sgs_scene::is_storage_error(&e);
        BatchError::File { path: path.to_owned(), problem: format!("cannot be {action}: {e}"), storage }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_end_with_one_mark() {
        let message = |problem: &str| wrong(Path::new("a"), problem).to_string();
        assert_eq!(message("did you mean \"b\"?"), "\"a\": did you mean \"b\"?");
        assert_eq!(message("scenes is empty"), "\"a\": scenes is empty.");
    }
}
