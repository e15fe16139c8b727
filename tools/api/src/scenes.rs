//! Opens the scene of a command and checks it before training.

use anyhow::bail;
use sgs_config::Settings;
use sgs_run::{RunDirectory, use_learned_views};
use sgs_scene::Scene;
use sgs_train::Framing;
use std::path::Path;

/// Opens the scene that the settings name, and logs its warnings.
pub fn open_scene(s: &Settings) -> anyhow::Result<Scene> {
    let scene = Scene::open(&s.scene, &s.scene_options())?;
    for warning in &scene.warnings {
        tracing::warn!("{warning}");
    }
    Ok(scene)
}

/// Opens the scene of a run, with the cameras and exposures that training learned. Fails with advice if the scene has moved.
pub fn open_scene_of_run(run: &Path, s: &Settings) -> anyhow::Result<Scene> {
    if !s.scene.exists() {
        let (run, scene) = (run.display(), s.scene.display());
        bail!("the scene of \"{run}\" is no longer at \"{scene}\"; name its place with --scene DIR.");
    }
    let mut scene = open_scene(s)?;
    if let Some(learned) = RunDirectory::open(run)?.learned_views()? {
        use_learned_views(&mut scene, &learned);
    }
    Ok(scene)
}

/// Checks that training can start from a scene; logs warnings about a bad start.
///
/// Refuses a scene if no training view sees any of its points.
pub fn check_start(scene: &Scene) -> anyhow::Result<()> {
    let mut warnings = scene.start_warnings()?;
    warnings.extend(Framing::of(scene).check(scene)?);
    for warning in warnings {
        tracing::warn!("{warning}");
    }
    Ok(())
}

/// Warns if the training views have no prior of normals or materials.
pub fn warn_without_priors(scene: &Scene) -> anyhow::Result<()> {
    for &view in &scene.split.train {
        let materials = scene.albedo_prior(view)?.is_some() || scene.roughness_prior(view)?.is_some();
        if materials || scene.metallic_prior(view)?.is_some() || scene.normal_prior(view)?.is_some() {
            return Ok(());
        }
    }
    tracing::warn!(
        "{} has no priors of normals or materials: photographs alone do not tell albedo from light; sgs priors makes priors \
         (docs/guide/priors.md)",
        scene.root.display()
    );
    Ok(())
}
