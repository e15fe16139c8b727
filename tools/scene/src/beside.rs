//! Files that a layout keeps beside its photographs: a mask of what counts, and ground truth.
//!
//! Readers list them; nothing is read before it is asked for. The mask belongs to the photograph. Ground truth is reached
//! through [`GroundTruth`](crate::GroundTruth) alone, so code that trains cannot come upon it.

use std::path::{Path, PathBuf};

use crate::error::{Result, SceneError};
use crate::ground_truth::GroundTruthKind;
use crate::maps::NormalFrame;

/// What lies beside one photograph.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Beside {
    /// Whether the layout holds the view out, where it says.
    pub(crate) test: Option<bool>,
    /// Where pixels of the photograph are valid: above one half.
    pub(crate) mask: Option<PathBuf>,
    /// Maps to measure against, at most one of each kind.
    pub(crate) truth: Vec<TruthFile>,
    /// The same view under other lightings, by their names.
    pub(crate) relit: Vec<(String, PathBuf)>,
}

/// A map to measure against.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct TruthFile {
    /// What it shows.
    pub(crate) kind: GroundTruthKind,
    /// The file.
    pub(crate) path: PathBuf,
    /// How it says so.
    pub(crate) form: Form,
}

/// How a file stores a map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Form {
    /// Color, linear in files of any kind.
    LinearColor,
    /// Vectors in this frame.
    Normal(NormalFrame),
    /// Depth of a definition that is yet to be found out.
    Depth,
    /// The channel with this number.
    Channel(u32),
    /// The alpha channel.
    Alpha,
}

impl Beside {
    /// Adds a map if its file exists and there is none of its kind yet.
    pub(crate) fn add(&mut self, kind: GroundTruthKind, path: PathBuf, form: Form) {
        if path.is_file() && self.truth.iter().all(|file| file.kind != kind) {
            self.truth.push(TruthFile { kind, path, form });
        }
    }
}

/// Refuses a map that does not have the size of its photograph.
pub(crate) fn check_size(path: &Path, size: (u32, u32), image: &Path, expected: (u32, u32)) -> Result<()> {
    if size == expected {
        return Ok(());
    }
    let problem = format!(
        "the map is {}×{} pixels, but its image {} is {}×{}; both must have the same size",
        size.0,
        size.1,
        image.display(),
        expected.0,
        expected.1
    );
    Err(SceneError::image(path, problem))
}
