//! Source of the viewer: Gaussians, initial cameras, extent of the scene.

use crate::error::{Result, ViewerError};
use crate::eye::Eye;
use glam::DVec3;
use sgs_config::Settings;
use sgs_relight::source_of;
use sgs_scene::{Camera, NEAR, Scene, Splats, Unit};
use std::path::{Path, PathBuf};

/// Number of Gaussians sampled for the extent of a scene.
const SAMPLES: usize = 4096;

/// Run, or PLY or glTF file.
pub struct Source {
    /// Path of the source.
    pub path: PathBuf,
    /// Gaussians.
    pub splats: Splats,
    /// Initial cameras; empty for a file without a transforms file.
    pub cameras: Vec<Camera>,
    /// Up direction of most cameras.
    up: DVec3,
    /// Center of the Gaussians.
    center: DVec3,
    /// Distance from the center that four fifths of the Gaussians do not exceed.
    pub radius: f64,
}

impl Source {
    /// Opens a source.
    ///
    /// Cameras come from a transforms file, or else from the run's scene if it still exists.
    pub fn open(path: &Path, cameras: Option<&Path>) -> Result<Source> {
        let (splats, settings) = source_of(path)?;
        if splats.is_empty() {
            return Err(ViewerError::Empty { path: path.to_owned() });
        }
        let cameras = match cameras {
            Some(file) => {
                let mut cameras = Camera::read_transforms(file)?;
                if cameras.is_empty() {
                    return Err(ViewerError::NoCameras { path: file.to_owned() });
                }
                let near = NEAR * Unit::of_splats(&splats).length();
                cameras.iter_mut().for_each(|camera| camera.near = near);
                cameras
            }
            None => settings.as_ref().map_or_else(Vec::new, cameras_of),
        };
        let (center, radius) = spread(&splats.means);
        let up = up_of(&cameras);
        Ok(Source { path: path.to_owned(), splats, cameras, up, center, radius })
    }

    /// Returns true if the source has materials for shading.
    pub fn has_materials(&self) -> bool {
        self.splats.albedo.is_some() && self.splats.roughness.is_some() && self.splats.normals.is_some()
    }

    /// Returns the viewpoint of a camera.
    ///
    /// Without cameras it lies outside the scene.
    pub fn eye(&self, camera: usize) -> Eye {
        match self.cameras.get(camera) {
            Some(camera) => {
                let ahead = (self.center - camera.position()).dot(camera.forward());
                Eye::of(camera, self.up, ahead.clamp(0.3 * self.radius, 2.0 * self.radius))
            }
            None => Eye::at(self.center, self.up, 2.0 * self.radius),
        }
    }
}

fn cameras_of(settings: &Settings) -> Vec<Camera> {
    match Scene::open(&settings.scene, &settings.scene_options()) {
        Ok(scene) => scene.views.into_iter().map(|view| view.camera).collect(),
        Err(error) => {
            tracing::info!(%error, "the run's scene is not there, so that its cameras are not known");
            Vec::new()
        }
    }
}

/// Returns the up direction of most cameras, or a world axis close to it.
///
/// Without cameras it is −y, because PLY files mostly have y down.
fn up_of(cameras: &[Camera]) -> DVec3 {
    let mean: DVec3 = cameras.iter().map(|c| -(c.rotation.transpose() * DVec3::Y)).sum();
    let mean = mean.try_normalize().unwrap_or(-DVec3::Y);
    let axes = [DVec3::X, DVec3::Y, DVec3::Z].map(|a| if a.dot(mean) < 0.0 { -a } else { a });
    axes.into_iter().find(|a| a.dot(mean) > 0.8).unwrap_or(mean)
}

/// Returns the median position of a sample and its 80th-percentile distance.
fn spread(means: &[[f32; 3]]) -> (DVec3, f64) {
    let every = means.len().div_ceil(SAMPLES).max(1);
    let places: Vec<DVec3> = means.iter().step_by(every).map(|m| DVec3::from(m.map(f64::from))).collect();
    let middle = |axis: usize| {
        let mut along: Vec<f64> = places.iter().map(|p| p[axis]).filter(|v| v.is_finite()).collect();
        along.sort_by(f64::total_cmp);
        along.get(along.len() / 2).copied().unwrap_or(0.0)
    };
    let center = DVec3::new(middle(0), middle(1), middle(2));
    let mut away: Vec<f64> = places.iter().map(|p| (*p - center).length()).filter(|v| v.is_finite()).collect();
    away.sort_by(f64::total_cmp);
    let radius = away.get(away.len() * 4 / 5).copied().unwrap_or(1.0);
    (center, radius.max(1e-3))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn outliers_do_not_enlarge_the_scene_extent() {
        let mut means: Vec<[f32; 3]> =
            (0..1000).map(|i| [(i % 10) as f32, (i / 10 % 10) as f32, (i / 100) as f32]).collect();
        means.extend([[1e9, 0.0, 0.0], [f32::NAN, 0.0, 0.0], [0.0, f32::INFINITY, 0.0]]);
        let (center, radius) = spread(&means);
        assert!((center - DVec3::splat(5.0)).length() < 2.0 && (4.0..8.0).contains(&radius), "{center} {radius}");
        assert_eq!(spread(&[[2.0; 3]]), (DVec3::splat(2.0), 1e-3));
    }

    #[test]
    fn up_snaps_to_a_nearby_axis() {
        assert_eq!(up_of(&[]), -DVec3::Y);
        let eye = Eye::at(DVec3::ZERO, DVec3::Z, 2.0);
        assert_eq!(up_of(&[eye.camera("a", [4, 4])]), DVec3::Z);
    }
}
