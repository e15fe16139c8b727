//! Entry points for fuzz tests (`tests/fuzz`) of the checkpoint readers.
//! They feed damaged files to readers that otherwise require a device, and have no other use.

use crate::course::Course;
use crate::divergence::{Seen, Watch};
use crate::error::Result;
use crate::error::error;
use crate::geometry::checkpoint;
use crate::intrinsic::Saved;
use crate::transport;
use sgs_passes::scene::Model;
use std::path::Path;

/// Reads a geometry checkpoint and continues the divergence check from its state.
/// The model has no normals. With `any_degree` the checkpoint may hold any spherical-harmonics degree. Returns a short
/// summary of the contents.
///
/// # Errors
/// If the checkpoint is damaged or belongs to another model.
pub fn checkpoint(path: &Path, sh_degree: u32, semantics: bool, any_degree: bool) -> Result<String> {
    let state = checkpoint::load(path, Model { sh_degree, normals: false, semantics, mip: false }, any_degree, None)?;
    let known = goes_on(&state.course, state.step);
    Ok(format!("{} {known} {}", state.parameters.len().min(3), state.course.roll_backs.len().min(3)))
}

/// Reads a transport checkpoint of two splats. Returns a short summary of the contents.
///
/// # Errors
/// If the checkpoint is damaged or belongs to other splats.
pub fn transport_checkpoint(path: &Path) -> Result<String> {
    let fitted = transport::Saved::read(path, 2)?.fitted;
    let emitters = fitted.map(|room| room.emitters.lights().len().min(3));
    Ok(format!("{emitters:?}"))
}

/// Reads an intrinsic checkpoint and continues the divergence check from its state.
/// The model has two splats, a light with one lobe and an environment map of one texel per face edge. Returns a short
/// summary of the contents.
///
/// # Errors
/// If the checkpoint is damaged or belongs to another model.
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
    let mut requested = Vec::new();
    if saved.has("relit_queried_at") {
        requested = saved.requested_at(2)?;
        assert!(requested.iter().all(|step| step.saturating_sub(1) <= saved.step), "what was asked has been");
        saved.words("relit_estimates0", 4)?;
    }
    let decided = [saved.lobes, saved.levels, saved.texels, saved.update_interval.map(|interval| interval.every)]
        .map(|n| n.is_some());
    Ok(format!(
        "{known} {} {} {decided:?} {} {gathered} {}",
        before.len().min(3),
        saved.decisions.len().min(3),
        requested.len(),
        saved.last.is_some()
    ))
}

/// Continues the divergence check from a checkpoint. Returns whether its state could be restored.
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
