//! Workload of the intrinsic stage: surfaces of a scene directory, or of a generated synthetic room.

use anyhow::{Context, ensure};
use sgs_config::Settings;
use sgs_scene::{Camera, Scene, Splats};
use std::path::Path;
use std::sync::Arc;
use tempfile::TempDir;

/// A scene with its surfaces.
pub struct LitScene {
    /// Photographs and priors.
    pub scene: Arc<Scene>,
    /// Geometry.
    pub splats: Splats,
    /// A room that was made is there for as long as this.
    _made: Option<TempDir>,
}

impl LitScene {
    /// Opens `path` with the geometry of a PLY file, or makes a room of four views of this size; without geometry the points
    /// are surfaces. The settings then name the scene.
    ///
    /// # Errors
    /// If something cannot be read or made.
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
                // What is behind a surface is hidden.
                splats.opacity_logits.iter_mut().for_each(|o| *o = 4.0);
                splats
            }
        };
        Ok(LitScene { scene: Arc::new(scene), splats, _made: made })
    }

    /// That of the first training view.
    pub fn camera(&self) -> &Camera {
        &self.scene.views[self.scene.split.train[0]].camera
    }

    /// The scene's, for reports.
    pub fn name(&self) -> String {
        self.scene.root.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned())
    }
}

/// Settings from a file, the defaults without one.
///
/// # Errors
/// If the file cannot be read, or nothing would shine.
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
    ensure!(i.lights.enabled || i.environment.enabled, "There is nothing that gives light.");
    Ok(settings)
}

/// Returns the settings for measured steps, without losses that need other graphs (pseudo-views, other lights), so that
/// every step is the same graph.
pub fn plain(settings: &Settings) -> Settings {
    let mut plain = settings.clone();
    (plain.intrinsic.losses.cross_view, plain.intrinsic.losses.relight) = (0.0, 0.0);
    plain
}
