//! Training progress in checkpoints: metadata that all stages save besides tensors.

use crate::divergence::RollBack;
use crate::error::{Result, error};
use std::collections::HashMap;
use std::path::Path;

/// Progress of a training. Stored as metadata; older checkpoints lack it.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Course {
    /// State of the divergence check, as written by [`crate::divergence::Watch::save`].
    pub watch: String,
    /// Rollbacks to the last good state.
    pub roll_backs: Vec<RollBack>,
}

impl Course {
    /// Writes the progress as metadata.
    pub fn write(&self, meta: &mut HashMap<String, String>) {
        meta.insert("watch".to_owned(), self.watch.clone());
        if !self.roll_backs.is_empty() {
            meta.insert("roll_backs".to_owned(), serde_json::to_string(&self.roll_backs).unwrap_or_default());
        }
    }

    /// Reads the progress from metadata.
    pub fn read(path: &Path, meta: &HashMap<String, String>) -> Result<Course> {
        let of = |name: &str| meta.get(name).cloned().unwrap_or_default();
        Ok(Course { watch: of("watch"), roll_backs: json(path, meta, "roll_backs")?.unwrap_or_default() })
    }
}

/// Parses a metadata entry as JSON. Returns none if the entry is missing.
pub(crate) fn json<T: serde::de::DeserializeOwned>(
    path: &Path,
    meta: &HashMap<String, String>,
    name: &str,
) -> Result<Option<T>> {
    let read = |text: &String| serde_json::from_str(text);
    meta.get(name).map(read).transpose().map_err(|e| error(path, format!("damaged: \"{name}\": {e}")))
}

/// Checks pairs of first and second moments. Returns a description of the first defect.
/// Adam clamps gradients before it updates the moments, so the moments of a correct run are finite.
pub(crate) fn wrong_moments(pairs: &[f32]) -> Option<&'static str> {
    if pairs.iter().any(|v| !v.is_finite()) {
        return Some("values that are not finite");
    }
    pairs.as_chunks().0.iter().any(|[_, second]| *second < 0.0).then_some("squares that are negative")
}
