//! Ways for damaged files to readers that otherwise need a device to come to (`tests/fuzz`). Nobody else has a use for them.

use crate::course::Course;
use crate::divergence::{Seen, Watch};
use crate::error::Result;
use crate::error::error;
use crate::geometry::checkpoint;
use crate::intrinsic::Saved;
use sgs_passes::scene::Model;
use std::path::Path;

/// Reads the state of a training of a model without normals, of whatever degree if that is to be so, and goes on watching from there; what it holds, in words.
///
/// # Errors
/// If it is damaged or of another model.
pub fn checkpoint(path: &Path, sh_degree: u32, semantics: bool, any_degree: bool) -> Result<String> {
    let state = checkpoint::load(path, Model { sh_degree, normals: false, semantics }, any_degree)?;
    let known = goes_on(&state.course, state.step);
    Ok(format!("{} {known} {}", state.parameters.len().min(3), state.course.roll_backs.len().min(3)))
}

/// Reads the state of a training of materials of two splats with a light of one lobe and surroundings of one texel a side, and goes
/// on watching from there; what it holds, in words.
///
/// # Errors
/// If it is damaged or of another model.
pub fn intrinsic_checkpoint(path: &Path) -> Result<String> {
    let bytes = std::fs::read(path).map_err(|e| error(path, e.to_string()))?;
    let saved = Saved::read(path, &bytes)?;
    let known = goes_on(&saved.course, saved.step);
    for (name, count) in [("albedo", 6), ("roughness", 2), ("environment", 18)] {
        saved.floats(name, count)?;
        saved.moments(&format!("{name}_moments"), count)?;
    }
    let before = saved.before(18)?;
    assert!(
        before.iter().all(|(taken, texels)| *taken <= saved.step && texels.len() == 18),
        "what was before is whole"
    );
    let gathered = saved.has("environment_gathered");
    if gathered {
        saved.floats("environment_gathered", 18)?;
    }
    saved.floats("light_gains", 1)?;
    let mut asked = Vec::new();
    if saved.has("relit_asked_at") {
        asked = saved.asked_at(2)?;
        assert!(asked.iter().all(|step| step.saturating_sub(1) <= saved.step), "what was asked has been");
        saved.words("relit_estimates0", 4)?;
    }
    let decided = [saved.lobes, saved.levels, saved.texels, saved.pace.map(|[every, _, _]| every)].map(|n| n.is_some());
    Ok(format!(
        "{known} {} {} {decided:?} {} {gathered} {}",
        before.len().min(3),
        saved.decisions.len().min(3),
        asked.len(),
        saved.last.is_some()
    ))
}

/// Watches from what a checkpoint says of how training goes. Whether that was known.
fn goes_on(course: &Course, from: u32) -> bool {
    let mut watch = Watch::new(vec![0.1; 2]);
    let known = watch.restore(&course.watch);
    for step in 1..200 {
        let step = from.saturating_add(step);
        watch.see(&Seen { step, view: step as usize % 2, loss: 0.1, l1: 0.1, skipped: 0, of: 1, rates: 1.0 });
        watch.validate_candidate();
    }
    known
}
