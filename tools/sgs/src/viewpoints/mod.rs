//! Cameras to render from: a transforms file, the scene's own views, an orbit or a path.

mod orbit;
mod path;

use crate::failure::{Kind, failure, refuse_usage};
use crate::scenes::open_scene;
use anyhow::bail;
use glam::{DMat3, DVec3};
use sgs_config::Settings;
use sgs_scene::{Camera, NEAR, Scene, Splats, Unit};
use std::path::{Path, PathBuf};

/// Options that choose cameras.
#[derive(clap::Args)]
pub struct ViewpointArgs {
    /// Transforms file with the cameras; by default the scene's views.
    #[arg(long, value_name = "FILE.json", conflicts_with_all = ["views", "orbit", "path"])]
    pub cameras: Option<PathBuf>,
    /// Split of the scene's own views; test by default.
    #[arg(long, value_enum, value_name = "SPLIT", conflicts_with_all = ["orbit", "path"])]
    views: Option<Views>,
    /// N cameras on a circle around the scene's center. Height and distance are those of the training cameras.
    #[arg(long, value_name = "N", conflicts_with = "path", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    orbit: Option<u32>,
    /// Cameras on a smooth path through the training cameras.
    #[arg(long)]
    path: bool,
    /// Number of cameras on the path.
    #[arg(long, value_name = "N", requires = "path", default_value_t = 120, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    frames: u32,
    /// Scene directory; by default that of the training.
    #[arg(long, value_name = "DIR")]
    pub scene: Option<PathBuf>,
}

/// Views of a scene by split.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Views {
    Train,
    Test,
    All,
}

impl ViewpointArgs {
    /// Returns whether an option chooses cameras.
    pub fn choose_cameras(&self) -> bool {
        self.cameras.is_some() || self.views.is_some() || self.orbit.is_some() || self.path
    }

    /// Opens the scene named by `--scene` or by the run.
    pub fn open_scene(&self, source: &Path, settings: Option<&Settings>) -> anyhow::Result<Scene> {
        if settings.is_none() && self.scene.is_none() {
            refuse_usage!("\"{}\" is no run and has no views of its own; give --cameras or --scene.", source.display());
        }
        let mut settings = settings.cloned().unwrap_or_default();
        if let Some(scene) = &self.scene {
            settings.scene.clone_from(scene);
        }
        if !settings.scene.exists() {
            bail!(
                "The scene \"{}\" does not exist; give its directory with --scene, or cameras with --cameras.",
                settings.scene.display()
            );
        }
        open_scene(&settings)
    }

    /// Returns the cameras that the options choose. Opens the scene if `scene` is `None` and a scene is needed.
    pub fn cameras(
        &self,
        source: &Path,
        settings: Option<&Settings>,
        splats: &Splats,
        scene: Option<&Scene>,
    ) -> anyhow::Result<Vec<Camera>> {
        if let Some(file) = &self.cameras {
            let mut cameras = Camera::read_transforms(file)?;
            if cameras.is_empty() {
                return Err(failure(Kind::Input, format!("\"{}\" holds no cameras.", file.display())));
            }
            let near = NEAR * Unit::of_splats(splats).length();
            cameras.iter_mut().for_each(|camera| camera.near = near);
            return Ok(cameras);
        }
        let opened;
        let scene = match scene {
            Some(scene) => scene,
            None => {
                opened = self.open_scene(source, settings)?;
                &opened
            }
        };
        let of = |list: &[usize]| list.iter().map(|&i| scene.views[i].camera.clone()).collect::<Vec<_>>();
        let train = of(&scene.split.train);
        if let Some(count) = self.orbit {
            return Ok(orbit::cameras(&train, &splats.means, count));
        }
        if self.path {
            return Ok(path::cameras(&train, self.frames));
        }
        let cameras = match self.views.unwrap_or(Views::Test) {
            Views::Train => train,
            Views::Test => of(&scene.split.test),
            Views::All => scene.views.iter().map(|view| view.camera.clone()).collect(),
        };
        if cameras.is_empty() {
            refuse_usage!("The scene \"{}\" has no test views; use --views train.", scene.root.display());
        }
        Ok(cameras)
    }
}

/// Returns the world's up direction.
///
/// The direction is perpendicular to the cameras' horizontal axes and close to the mean of the cameras' up
/// directions. The mean alone is tilted if all cameras look down in similar directions. If the horizontal axes are
/// parallel, the component of the mean perpendicular to them remains.
pub(crate) fn up_of(cameras: &[Camera]) -> DVec3 {
    let count = cameras.len().max(1) as f64;
    let (mut level, mut mean) = (DMat3::IDENTITY * 1e-3, DVec3::ZERO);
    for camera in cameras {
        let to_world = camera.rotation.transpose();
        let right = to_world.x_axis;
        level += DMat3::from_cols(right * right.x, right * right.y, right * right.z) * (1.0 / count);
        mean -= to_world.y_axis / count;
    }
    (level.inverse() * mean).try_normalize().unwrap_or(DVec3::NEG_Y)
}

/// Returns `word` and a zero-padded index, so that files sort in order.
fn numbered(word: &str, index: u32, count: u32) -> String {
    let digits = count.saturating_sub(1).to_string().len().max(3);
    format!("{word}_{index:0digits$}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn indices_are_padded_to_the_largest() {
        assert_eq!(numbered("path", 7, 120), "path_007");
        assert_eq!(numbered("path", 7, 1001), "path_0007");
    }
}
