//! The layout of the InteriorVerse release: `NNN_im.exr` with albedo, material, normal, depth and mask beside it. It is
//! recognized but not read yet; with a `transforms.json` beside the images the scene is read through that.

use std::path::Path;

use super::Found;
use crate::error::{Result, SceneError};

/// The image that the layout is recognized by: the first one, `NNN_im.exr`.
pub(super) fn sign(root: &Path) -> Option<String> {
    let entries = std::fs::read_dir(root).ok()?;
    let names = entries.filter_map(|entry| entry.ok()?.file_name().into_string().ok());
    let is_image = |name: &String| {
        let number = name.strip_suffix("_im.exr").unwrap_or_default();
        !number.is_empty() && number.bytes().all(|b| b.is_ascii_digit())
    };
    names.filter(is_image).min()
}

/// Says that there is no reader yet.
pub(super) fn read(root: &Path) -> Result<Found> {
    let sign = sign(root).unwrap_or_default();
    Err(SceneError::LayoutNotRead { path: root.to_path_buf(), layout: "InteriorVerse", sign })
}
