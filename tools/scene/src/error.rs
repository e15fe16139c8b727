//! Errors of scenes on disk.
//!
//! Every message is one sentence. Messages name the file, the place in it if known (line, frame, vertex, byte), the
//! wrong values, and the remedy. Variants distinguish kinds of input. The message is built where the error is detected,
//! because all values are available there.

use std::io;
use std::path::{Path, PathBuf};

/// Reason why a scene or one of its files cannot be read or written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SceneError {
    /// An operating system call failed.
    #[error("cannot {action} {}: {cause}", path.display())]
    Io {
        /// Attempted action as a verb: "read", "write", "rename".
        action: &'static str,
        /// File or directory.
        path: PathBuf,
        /// Error of the operating system.
        cause: io::Error,
    },
    /// The path is not a directory, or the directory has no known scene layout.
    #[error("{} {problem}", path.display())]
    NotAScene {
        /// Requested directory.
        path: PathBuf,
        /// Missing content and the remedy.
        problem: String,
    },
    /// A JSON file is invalid or lacks required fields.
    #[error("{}, line {line}, column {column}: {problem}", path.display())]
    Json {
        /// Path of the file.
        path: PathBuf,
        /// Line, from 1.
        line: usize,
        /// Column, from 1; 0 if the parser does not know it.
        column: usize,
        /// Description of the problem.
        problem: String,
    },
    /// A camera file is readable but has invalid content.
    #[error("{}{}{place}: {problem}", path.display(), if place.is_empty() { "" } else { ", " })]
    Cameras {
        /// Path of the file.
        path: PathBuf,
        /// Frame, line, camera or byte; empty for the whole file.
        place: String,
        /// Description of the problem and what to do.
        problem: String,
    },
    /// An image or a per-pixel map cannot be used.
    #[error("{}: {problem}", path.display())]
    Image {
        /// Path of the file.
        path: PathBuf,
        /// Description of the problem and what to do.
        problem: String,
    },
    /// An image does not have the size its camera was calibrated for.
    #[error(
        "{} is {}×{} pixels, but {} gives {}×{} for its camera; resize the images or correct the camera's size and \
         intrinsics",
        path.display(), image.0, image.1, declared_in.display(), camera.0, camera.1
    )]
    ImageSize {
        /// Path of the image.
        path: PathBuf,
        /// Width and height of the image.
        image: (u32, u32),
        /// Width and height of the camera.
        camera: (u32, u32),
        /// File that describes the camera.
        declared_in: PathBuf,
    },
    /// A PLY, glTF or COLMAP point file cannot be used.
    #[error("{}{}{place}: {problem}", path.display(), if place.is_empty() { "" } else { ", " })]
    Points {
        /// Path of the file.
        path: PathBuf,
        /// Header line, vertex or byte; empty for the whole file.
        place: String,
        /// Description of the problem and what to do.
        problem: String,
    },
    /// The split into training and test views is invalid.
    #[error("{}: {problem}", path.display())]
    Split {
        /// Path of `split.json`, or of the scene if that file does not exist.
        path: PathBuf,
        /// Description of the problem and what to do.
        problem: String,
    },
    /// The emitters that a scene names cannot be used.
    #[error("{}: {problem}", path.display())]
    Emitters {
        /// Path of `emitters.json`.
        path: PathBuf,
        /// Description of the problem and what to do.
        problem: String,
    },
    /// Values in memory cannot be stored in a file.
    #[error("{what}: {problem}")]
    Data {
        /// Name of the object, for instance "the splats".
        what: &'static str,
        /// Description of the problem.
        problem: String,
    },
    /// An option has an invalid value.
    #[error("{option} is {value}, but {expected}")]
    Option {
        /// Name of the option on the command line.
        option: &'static str,
        /// Value of the option.
        value: String,
        /// Requirement on the value.
        expected: &'static str,
    },
}

/// Result of the reading and writing functions of this crate.
pub type Result<T, E = SceneError> = std::result::Result<T, E>;

/// Returns a closure for `map_err` that creates a [`SceneError::Io`].
pub(crate) fn io_error(action: &'static str, path: &Path) -> impl FnOnce(io::Error) -> SceneError {
    let path = path.to_path_buf();
    move |cause| SceneError::Io { action, path, cause }
}

/// Returns whether a disk cannot take any file: it is full, a quota is used up, or it is read-only.
pub fn is_storage_error(error: &io::Error) -> bool {
    use io::ErrorKind as K;
    matches!(error.kind(), K::StorageFull | K::QuotaExceeded | K::ReadOnlyFilesystem)
}

impl SceneError {
    /// Returns whether the disk is full or read-only.
    pub fn is_storage_error(&self) -> bool {
        matches!(self, SceneError::Io { cause, .. } if is_storage_error(cause))
    }

    pub(crate) fn image(path: &Path, problem: impl Into<String>) -> Self {
        Self::Image { path: path.to_path_buf(), problem: problem.into() }
    }

    pub(crate) fn cameras(path: &Path, place: impl Into<String>, problem: impl Into<String>) -> Self {
        Self::Cameras { path: path.to_path_buf(), place: place.into(), problem: problem.into() }
    }

    pub(crate) fn points(path: &Path, place: impl Into<String>, problem: impl Into<String>) -> Self {
        Self::Points { path: path.to_path_buf(), place: place.into(), problem: problem.into() }
    }

    pub(crate) fn split(path: &Path, problem: impl Into<String>) -> Self {
        Self::Split { path: path.to_path_buf(), problem: problem.into() }
    }
}
