//! Entry points for fuzzing readers that otherwise need a device (`tests/fuzz`).

use crate::error::Result;
use crate::truth::{true_edit_of, true_lights_of};
use crate::{Edit, edited_light_of};
use sgs_run::{LightFile, Texels};
use std::path::Path;

/// Applies an edit to lights and to an environment map of one color.
///
/// # Errors
/// If the edit names something that does not exist.
pub fn edited_light(edit: &Edit, lights: LightFile) -> Result<(Option<LightFile>, Option<Texels>)> {
    edited_light_of(edit, lights, Texels::uniform(4, [0.5; 3]))
}

/// Reads the true lights of a scene (`gt/lights.json`) as lights of a run.
///
/// # Errors
/// If the file is damaged.
pub fn true_lights(path: &Path) -> Result<Option<LightFile>> {
    true_lights_of(path)
}

/// Returns whether the file of a relit set describes a material edit.
///
/// # Errors
/// If the file is damaged.
pub fn true_edit(path: &Path) -> Result<bool> {
    true_edit_of(path)
}
