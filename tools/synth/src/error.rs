//! Errors of scene generation. Each message is one sentence that says what to change.

use std::path::PathBuf;

/// Reason why no scene directory was written.
#[derive(Debug, thiserror::Error)]
pub enum SynthError {
    /// Unknown scene name.
    #[error("there is no scene called `{name}`; the scenes are {known}")]
    UnknownScene {
        /// Requested name.
        name: String,
        /// Known names, separated by commas.
        known: String,
    },
    /// Unknown layout name.
    #[error("no layout is called `{name}`; the layouts are {known}")]
    UnknownLayout {
        /// Requested name.
        name: String,
        /// Known names, separated by commas.
        known: String,
    },
    /// Option outside its range.
    #[error("{option} is {value} but must lie between {min} and {max}")]
    OutOfRange {
        /// Name of the option.
        option: &'static str,
        /// Given value.
        value: u64,
        /// Smallest allowed value.
        min: u64,
        /// Largest allowed value.
        max: u64,
    },
    /// Fraction outside 0 to 1.
    #[error("{option} is {value}, but must be 0 to 1")]
    NoShare {
        /// Name of the option.
        option: &'static str,
        /// Given value.
        value: f32,
    },
    /// Output directory that is not empty and may not be replaced.
    #[error("{} already holds something; name another directory, or replace a scene with --force", .0.display())]
    OutputOccupied(PathBuf),
    /// Output directory that may be replaced but is not a scene directory.
    #[error("{} is not replaced because it is no scene directory: it holds no file of cameras", .0.display())]
    NotAScene(PathBuf),
    /// Output path without a final component to rename into place.
    #[error("{} does not name a directory that could be made", .0.display())]
    BadPath(PathBuf),
    /// Failure of the file system.
    #[error("cannot {action} {}: {source}", .path.display())]
    Io {
        /// Attempted action, as a verb.
        action: &'static str,
        /// File or directory.
        path: PathBuf,
        /// Reason reported by the system.
        source: std::io::Error,
    },
    /// Failure of an encoder.
    #[error("cannot encode {}: {reason}", .path.display())]
    Encode {
        /// File that was being written.
        path: PathBuf,
        /// Reason reported by the encoder.
        reason: String,
    },
}

impl SynthError {
    /// Wraps a file-system error with the attempted action and its path.
    pub(crate) fn io(action: &'static str, path: impl Into<PathBuf>) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.into();
        move |source| Self::Io { action, path, source }
    }

    /// Wraps an encoder's error with the path of its file.
    pub(crate) fn encode(path: impl Into<PathBuf>, reason: impl ToString) -> Self {
        Self::Encode { path: path.into(), reason: reason.to_string() }
    }
}
