//! The layout of FIPT's real scenes: `cam.txt`, `K_list.txt` and EXR images. It is recognized but not read yet.

use std::path::Path;

use super::Found;
use crate::error::{Result, SceneError};

/// The files that the layout is recognized by.
pub(super) fn sign(root: &Path) -> Option<String> {
    let both = root.join("cam.txt").is_file() && root.join("K_list.txt").is_file();
    both.then(|| "cam.txt and K_list.txt".into())
}

/// Says that there is no reader yet.
pub(super) fn read(root: &Path) -> Result<Found> {
    let sign = sign(root).unwrap_or_default();
    Err(SceneError::LayoutNotRead { path: root.to_path_buf(), layout: "FIPT", sign })
}
