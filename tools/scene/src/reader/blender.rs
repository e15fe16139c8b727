//! The layout of Blender's synthetic scenes and TensoIR: `transforms_train.json`, `transforms_test.json`, and a folder
//! for each frame. It is recognized but not read yet.

use std::path::Path;

use super::Found;
use crate::error::{Result, SceneError};

/// The file that the layout is recognized by.
pub(super) fn sign(root: &Path) -> Option<String> {
    let name = "transforms_train.json";
    root.join(name).is_file().then(|| name.into())
}

/// Says that there is no reader yet.
pub(super) fn read(root: &Path) -> Result<Found> {
    let sign = sign(root).unwrap_or_default();
    Err(SceneError::LayoutNotRead { path: root.to_path_buf(), layout: "Blender", sign })
}
