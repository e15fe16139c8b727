//! What can go wrong, each in one sentence that says what to change.

use std::path::PathBuf;

/// Why no scene directory was made.
#[derive(Debug, thiserror::Error)]
pub enum SynthError {
    /// The scene's name is none of the known ones.
    #[error("there is no scene called `{name}`; the scenes are {known}")]
    UnknownScene {
        /// What was asked for.
        name: String,
        /// The names that exist, separated by commas.
        known: String,
    },
    /// The layout's name is none of the known ones.
    #[error("no layout is called `{name}`; the layouts are {known}")]
    UnknownLayout {
        /// What was asked for.
        name: String,
        /// The names that exist, separated by commas.
        known: String,
    },
    /// An option lies outside what makes sense.
    #[error("{option} is {value} but must lie between {min} and {max}")]
    OutOfRange {
        /// The option's name.
        option: &'static str,
        /// The value given.
        value: u64,
        /// The smallest allowed value.
        min: u64,
        /// The largest allowed value.
        max: u64,
    },
    /// A share lies outside 0 to 1.
    #[error("{option} is {value}, but must be 0 to 1")]
    NoShare {
        /// The option's name.
        option: &'static str,
        /// The value given.
        value: f32,
    },
    /// The output directory holds something that may not be replaced.
    #[error("{} already holds something; name another directory, or replace a scene with --force", .0.display())]
    OutputOccupied(PathBuf),
    /// The output may be replaced, but it is no scene directory.
    #[error("{} is not replaced because it is no scene directory: it holds no file of cameras", .0.display())]
    NotAScene(PathBuf),
    /// The output path has no final component that could be renamed into place.
    #[error("{} does not name a directory that could be made", .0.display())]
    BadPath(PathBuf),
    /// The file system refused.
    #[error("cannot {action} {}: {source}", .path.display())]
    Io {
        /// What was attempted, as a verb.
        action: &'static str,
        /// The file or directory.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// An encoder refused.
    #[error("cannot encode {}: {reason}", .path.display())]
    Encode {
        /// The file that was being written.
        path: PathBuf,
        /// The encoder's reason.
        reason: String,
    },
}

impl SynthError {
    /// Wraps a file-system error with what was attempted on which path.
    pub(crate) fn io(action: &'static str, path: impl Into<PathBuf>) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.into();
        move |source| Self::Io { action, path, source }
    }

    /// Wraps an encoder's error with the file it concerned.
    pub(crate) fn encode(path: impl Into<PathBuf>, reason: impl ToString) -> Self {
        Self::Encode { path: path.into(), reason: reason.to_string() }
    }
}
