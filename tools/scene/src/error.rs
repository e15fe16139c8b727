//! What can be wrong with a scene on disk, said in one sentence each.
//!
//! Every message names the file, the place in it as far as it is known (line, frame, vertex, byte), the values that are
//! wrong, and what to do. The variants tell callers which kind of input is at fault; the sentence is made where the
//! fault is found, because only there are all the values at hand.

use std::io;
use std::path::{Path, PathBuf};

/// Why a scene, or one file of it, cannot be read or written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SceneError {
    /// The operating system refused.
    #[error("cannot {action} {}: {cause}", path.display())]
    Io {
        /// What was attempted, as a verb: "read", "write", "rename".
        action: &'static str,
        /// The file or directory.
        path: PathBuf,
        /// The system's answer.
        cause: io::Error,
    },
    /// The directory is not a scene in any known layout, or not a directory.
    #[error("{} {problem}", path.display())]
    NotAScene {
        /// The directory that was given.
        path: PathBuf,
        /// What is missing and what to do.
        problem: String,
    },
    /// A JSON file is not valid, or does not have the fields that it needs.
    #[error("{}, line {line}, column {column}: {problem}", path.display())]
    Json {
        /// The file.
        path: PathBuf,
        /// Line, from 1.
        line: usize,
        /// Column, from 1 (0 where the parser does not know it).
        column: usize,
        /// What is wrong.
        problem: String,
    },
    /// A file that lists cameras is readable, but says something impossible.
    #[error("{}{}{place}: {problem}", path.display(), if place.is_empty() { "" } else { ", " })]
    Cameras {
        /// The file.
        path: PathBuf,
        /// The frame, line, camera or byte; empty for the file as a whole.
        place: String,
        /// What is wrong and what to do.
        problem: String,
    },
    /// An image or a per-pixel map cannot be used.
    #[error("{}: {problem}", path.display())]
    Image {
        /// The file.
        path: PathBuf,
        /// What is wrong and what to do.
        problem: String,
    },
    /// An image is not of the size its camera was calibrated for.
    #[error(
        "{} is {}×{} pixels, but {} gives {}×{} for its camera; resize the images or correct the camera's size and \
         intrinsics",
        path.display(), image.0, image.1, declared_in.display(), camera.0, camera.1
    )]
    ImageSize {
        /// The image.
        path: PathBuf,
        /// Its width and height.
        image: (u32, u32),
        /// The camera's width and height.
        camera: (u32, u32),
        /// The file that describes the camera.
        declared_in: PathBuf,
    },
    /// A PLY or COLMAP point file cannot be used.
    #[error("{}{}{place}: {problem}", path.display(), if place.is_empty() { "" } else { ", " })]
    Points {
        /// The file.
        path: PathBuf,
        /// The header line, vertex or byte; empty for the file as a whole.
        place: String,
        /// What is wrong and what to do.
        problem: String,
    },
    /// The split into training and test views is impossible.
    #[error("{}: {problem}", path.display())]
    Split {
        /// `split.json`, or the scene where there is none.
        path: PathBuf,
        /// What is wrong and what to do.
        problem: String,
    },
    /// Values in memory that no file could be made from.
    #[error("{what}: {problem}")]
    Data {
        /// The object, for instance "the splats".
        what: &'static str,
        /// What is wrong.
        problem: String,
    },
    /// An option has a value that means nothing.
    #[error("{option} is {value}, but {expected}")]
    Option {
        /// The option, by its name on the command line.
        option: &'static str,
        /// The value.
        value: String,
        /// What it must be.
        expected: &'static str,
    },
}

/// The result of everything in this crate that reads or writes.
pub type Result<T, E = SceneError> = std::result::Result<T, E>;

/// Makes the function that turns a system error into [`SceneError::Io`], for `map_err`.
pub(crate) fn io_error(action: &'static str, path: &Path) -> impl FnOnce(io::Error) -> SceneError {
    let path = path.to_path_buf();
    move |cause| SceneError::Io { action, path, cause }
}

impl SceneError {
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
