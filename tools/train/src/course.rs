//! What checkpoints of all stages hold besides tensors: how the training goes.

use crate::divergence::RollBack;
use crate::error::{Result, error};
use std::collections::HashMap;
use std::path::Path;

/// How a training goes: in metadata, and absent in checkpoints that are older.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Course {
    /// [`crate::divergence::Watch::save`].
    pub watch: String,
    /// Returns to the last good state.
    pub roll_backs: Vec<RollBack>,
}

impl Course {
    /// As metadata.
    pub fn write(&self, meta: &mut HashMap<String, String>) {
        meta.insert("watch".to_owned(), self.watch.clone());
        if !self.roll_backs.is_empty() {
            meta.insert("roll_backs".to_owned(), serde_json::to_string(&self.roll_backs).unwrap_or_default());
        }
    }

    /// From metadata.
    pub fn read(path: &Path, meta: &HashMap<String, String>) -> Result<Course> {
        let of = |name: &str| meta.get(name).cloned().unwrap_or_default();
        Ok(Course { watch: of("watch"), roll_backs: json(path, meta, "roll_backs")?.unwrap_or_default() })
    }
}

/// What metadata hold as JSON, if they do.
pub(crate) fn json<T: serde::de::DeserializeOwned>(
    path: &Path,
    meta: &HashMap<String, String>,
    name: &str,
) -> Result<Option<T>> {
    let read = |text: &String| serde_json::from_str(text);
    meta.get(name).map(read).transpose().map_err(|e| error(path, format!("damaged: \"{name}\": {e}")))
}

/// What pairs hold that first and second moments cannot be. Gradients are bounded before they come to these, so that both are finite.
pub(crate) fn wrong_moments(pairs: &[f32]) -> Option<&'static str> {
    if pairs.iter().any(|v| !v.is_finite()) {
        return Some("values that are not finite");
    }
    pairs.as_chunks().0.iter().any(|[_, second]| *second < 0.0).then_some("squares that are negative")
}
