//! Normals computed from the depths of a scene.

use super::view::turned;
use super::write::Writer;
use super::{FillError, FillOptions, Filled, NormalFrame, Prior, Scene};

/// Writes normal priors of the views that have depth.
///
/// They are those of [`Scene::normals_of_depth`]. `step` is the distance in pixels of the neighbors whose differences are
/// taken. `progress` receives the number of finished and of all views. `go_on` is called before each view; `false`
/// interrupts the run.
///
/// # Errors
/// The first failure, or that no view has depth. Files written before it stay.
pub fn fill_normals_from_depth(
    scene: &Scene,
    step: usize,
    options: &FillOptions,
    mut progress: impl FnMut(usize, usize),
    mut go_on: impl FnMut() -> bool,
) -> Result<Filled, FillError> {
    let mut filled = Filled::default();
    let mut writer = Writer::open(scene, options, &mut filled)?;
    let mut without = 0;
    for (done, &index) in options.views.iter().enumerate() {
        progress(done, options.views.len());
        if !go_on() {
            return Ok(filled);
        }
        let view = scene.view(index)?;
        if !writer.lacks(Prior::Normal, &view.camera.name) {
            continue;
        }
        let Some(normals) = scene.normals_of_depth(index, step)? else {
            without += 1;
            continue;
        };
        let frame = writer.frame(NormalFrame::CameraOpencv)?;
        writer.normal(&view.camera.name, &turned(normals, NormalFrame::CameraOpencv, frame, view))?;
    }
    if without == options.views.len() && without > 0 {
        return Err(FillError::Unfit(format!(
            "{} has no depth in its {without} views, which normals could be computed from; add the maps of a sensor or \
             priors/depth",
            scene.root.display()
        )));
    }
    if without > 0 {
        writer.warn(&format!("{without} of {} views have no depth, and so no normals from it", options.views.len()));
    }
    progress(options.views.len(), options.views.len());
    filled.complete = true;
    Ok(filled)
}
