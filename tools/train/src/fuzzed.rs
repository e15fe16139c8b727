//! Ways for damaged files to readers that otherwise need a device to come to (`tests/fuzz`). Nobody else has a use for them.

use crate::checkpoint;
use crate::divergence::{Seen, Watch};
use crate::error::Result;
use crate::intrinsic::LightFile;
use crate::relight::{Edit, edited_light_of, true_edit_of, true_lights_of};
use crate::shaded::Texels;
use sgs_passes::scene::Model;
use std::path::Path;

/// Reads the state of a training of a model without normals, of whatever degree if that is to be so, and goes on watching from there; what it holds, in words.
///
/// # Errors
/// If it is damaged or of another model.
pub fn checkpoint(path: &Path, sh_degree: u32, semantics: bool, any_degree: bool) -> Result<String> {
    let state = checkpoint::load(path, Model { sh_degree, normals: false, semantics }, any_degree)?;
    let mut watch = Watch::new(vec![0.1; 2]);
    let known = watch.restore(&state.course.watch);
    for step in 1..200 {
        let step = state.step.saturating_add(step);
        watch.see(&Seen { step, view: step as usize % 2, loss: 0.1, l1: 0.1, skipped: 0, of: 1, rates: 1.0 });
        watch.vouched_for();
    }
    Ok(format!("{} {known} {}", state.parameters.len().min(3), state.course.roll_backs.len().min(3)))
}

/// What an edit makes of lights, and of surroundings of one color.
///
/// # Errors
/// If it names what is not there.
pub fn edited_light(edit: &Edit, lights: LightFile) -> Result<(Option<LightFile>, Option<Texels>)> {
    edited_light_of(edit, lights, Texels::uniform(4, [0.5; 3]))
}

/// The true lights of a scene (`gt/lights.json`) as lights of a run.
///
/// # Errors
/// If the file is damaged.
pub fn true_lights(path: &Path) -> Result<Option<LightFile>> {
    true_lights_of(path)
}

/// Whether a file of a relit set says what became of materials.
///
/// # Errors
/// If the file is damaged.
pub fn true_edit(path: &Path) -> Result<bool> {
    true_edit_of(path)
}
