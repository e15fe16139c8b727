//! Workload of the intrinsic stage: surfaces of a scene directory or of a synthetic room.

use anyhow::{Context, ensure};
use sgs_config::Settings;
use sgs_scene::{Camera, Scene, Splats};
use std::path::Path;
use std::sync::Arc;
use tempfile::TempDir;

/// Scene with its surfaces.
pub struct LitScene {
    /// Photographs and priors.
    pub scene: Arc<Scene>,
    /// Geometry of the surfaces.
    pub splats: Splats,
    /// Directory of a generated room, deleted on drop.
    _made: Option<TempDir>,
}

impl LitScene {
    /// Opens a scene at `path`, or generates a room with four views of this size.
    ///
    /// Surfaces come from a PLY file, or from the scene's points if `geometry` is `None`. Sets `settings.scene`.
    ///
    /// # Errors
    /// If a file cannot be read or the room cannot be generated.
    pub fn open(
        path: Option<&Path>,
        geometry: Option<&Path>,
        size: [u32; 2],
        settings: &mut Settings,
    ) -> anyhow::Result<LitScene> {
        let made = match path {
            Some(path) => {
                path.clone_into(&mut settings.scene);
                None
            }
            None => {
                let folder = tempfile::tempdir()?;
                settings.scene = folder.path().join("room");
                let [width, height] = size.map(|n| n as usize);
                let options = sgs_synth::SynthOptions { views: 4, width, height, ..Default::default() };
                sgs_synth::generate(&settings.scene, &options, &|_, _| {})?;
                Some(folder)
            }
        };
        let scene = Scene::open(&settings.scene, &settings.scene_options())?;
        let splats = match geometry {
            Some(file) => Splats::read_ply(file)?,
            None => {
                let mut splats = Splats::from_points(&scene.points, 0)?;
                // Opaque, so that a surface hides everything behind it.
                splats.opacity_logits.iter_mut().for_each(|o| *o = 4.0);
                splats
            }
        };
        Ok(LitScene { scene: Arc::new(scene), splats, _made: made })
    }

    /// Returns the camera of the first training view.
    pub fn camera(&self) -> &Camera {
        &self.scene.views[self.scene.split.train[0]].camera
    }

    /// Returns the name of the scene for reports.
    pub fn name(&self) -> String {
        self.scene.root.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned())
    }
}

/// Reads settings from a file; without one returns the defaults.
///
/// # Errors
/// If the file cannot be read, or lights and environment map are both disabled.
pub fn lit_settings(file: Option<&Path>) -> anyhow::Result<Settings> {
    let settings = match file {
        Some(path) => {
            let context = || format!("\"{}\"", path.display());
            let table = std::fs::read_to_string(path).with_context(context)?.parse().with_context(context)?;
            Settings::from_table(table).with_context(context)?
        }
        None => Settings::default(),
    };
    let i = &settings.intrinsic;
    ensure!(i.lights.enabled() || i.environment.enabled(), "There is nothing that gives light.");
    Ok(settings)
}

/// Returns the settings for measured steps, without losses that need other graphs.
///
/// Pseudo-views and other lights need other graphs. Without them every step replays the same graph.
pub fn plain(settings: &Settings) -> Settings {
    let mut plain = settings.clone();
    (plain.intrinsic.losses.cross_view, plain.intrinsic.losses.relight) = (0.0, 0.0);
    plain
}
