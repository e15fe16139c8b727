//! What training learned of the photographs' views and lens: `cameras.json`.

use crate::directory::RunDirectory;
use crate::error::{Result, error};
use glam::{DMat3, DVec3};
use serde::{Deserialize, Serialize};
use sgs_scene::{Camera, Residual, Scene};

/// Name of the file.
const FILE: &str = "cameras.json";

/// Format identifier of the file.
const FORMAT: &str = "sgs-cameras-1";

/// Largest deviation of a rotation's columns from unit length and right angles.
const CROOKED: f64 = 1e-3;

/// Learned camera and colors of a training view.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LearnedViewRow {
    /// Name of the view.
    pub name: String,
    /// World-to-camera pose in the scene's unit: three rows of rotation and translation.
    pub world_to_camera: [[f64; 4]; 3],
    /// Factors on display-referred red, green and blue: photograph over render.
    pub gains: [f32; 3],
}

/// Lens that all views share, relative to the given one.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LearnedLens {
    /// Factor on the focal lengths.
    pub focal: f64,
    /// Shift of the principal point, in given focal lengths.
    pub center: [f64; 2],
    /// [Vignetting](sgs_scene::View::vignetting) of the photographs.
    pub vignetting: f32,
    /// [Radial distortion](sgs_scene::Residual::radial) of the photographs.
    #[serde(default)]
    pub distortion: f64,
}

impl Default for LearnedLens {
    fn default() -> Self {
        LearnedLens { focal: 1.0, center: [0.0; 2], vignetting: 0.0, distortion: 0.0 }
    }
}

/// What training learned of the photographs.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LearnedCameras {
    /// Training views.
    pub views: Vec<LearnedViewRow>,
    /// Lens of all views, test views included.
    pub lens: LearnedLens,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    format: String,
    #[serde(default)]
    lens: LearnedLens,
    views: Vec<LearnedViewRow>,
}

impl LearnedViewRow {
    /// Makes the row of a camera in the scene's unit.
    pub fn of(camera: &Camera, gains: [f32; 3]) -> LearnedViewRow {
        let row = |i: usize| {
            let r = camera.rotation.row(i);
            [r.x, r.y, r.z, camera.translation[i]]
        };
        LearnedViewRow { name: camera.name.clone(), world_to_camera: [row(0), row(1), row(2)], gains }
    }

    fn pose(&self) -> (DMat3, DVec3) {
        let [x, y, z] = self.world_to_camera.map(|[x, y, z, _]| DVec3::new(x, y, z));
        (DMat3::from_cols(x, y, z).transpose(), DVec3::from(self.world_to_camera.map(|row| row[3])))
    }

    fn problem(&self) -> Option<&'static str> {
        let (rotation, translation) = self.pose();
        let error = (rotation * rotation.transpose() - DMat3::IDENTITY).to_cols_array().into_iter();
        if !translation.is_finite() || !error.map(f64::abs).all(|e| e < CROOKED) || rotation.determinant() < 0.0 {
            return Some("a pose that is no rotation and translation");
        }
        (!self.gains.iter().all(|g| g.is_finite() && *g > 0.0)).then_some("a color factor that is not positive")
    }
}

impl LearnedLens {
    fn problem(&self) -> Option<&'static str> {
        if !(self.focal.is_finite() && self.focal > 0.0) {
            return Some("a factor on focal lengths that is not positive");
        }
        let rest = self.center.iter().chain([&self.distortion]).all(|c| c.is_finite()) && self.vignetting.is_finite();
        (!rest).then_some("a lens with numbers that are not finite")
    }
}

impl RunDirectory {
    /// Writes the learned views, or removes the file of an earlier training.
    ///
    /// # Errors
    /// If the file cannot be written or removed.
    pub fn write_learned_views(&self, learned: Option<&LearnedCameras>) -> Result<()> {
        match learned.cloned() {
            Some(LearnedCameras { views, lens }) => self.write_json(FILE, &File { format: FORMAT.into(), lens, views }),
            None => self.remove([self.path(FILE)]),
        }
    }

    /// Reads the learned views; none if training learned none.
    ///
    /// # Errors
    /// If the file is damaged.
    pub fn learned_views(&self) -> Result<Option<LearnedCameras>> {
        let path = self.path(FILE);
        if !path.is_file() {
            return Ok(None);
        }
        let text = std::fs::read_to_string(&path).map_err(|e| error(&path, format!("cannot be read: {e}")))?;
        let file: File = serde_json::from_str(&text).map_err(|e| error(&path, format!("is not valid: {e}")))?;
        if file.format != FORMAT {
            return Err(error(&path, format!("has the format \"{}\" and not \"{FORMAT}\"", file.format)));
        }
        if let Some(problem) = file.lens.problem() {
            return Err(error(&path, format!("has {problem}")));
        }
        match file.views.iter().find_map(|view| view.problem().map(|problem| (view, problem))) {
            Some((view, problem)) => Err(error(&path, format!("has {problem}, at view \"{}\"", view.name))),
            None => Ok(Some(LearnedCameras { views: file.views, lens: file.lens })),
        }
    }
}

/// Gives a scene the learned cameras and lens.
///
/// Loading divides its photographs by the learned exposures and vignetting, and removes the learned distortion from
/// them and from their priors.
pub fn use_learned_views(scene: &mut Scene, learned: &LearnedCameras) {
    let LearnedLens { focal, center, vignetting, distortion } = learned.lens;
    for view in &mut scene.views {
        view.distortion.residual = (distortion != 0.0).then(|| Residual::of(&view.camera, center, distortion));
        let camera = &mut view.camera;
        (camera.cx, camera.cy) = (camera.cx + center[0] * camera.fx, camera.cy + center[1] * camera.fy);
        (camera.fx, camera.fy) = (focal * camera.fx, focal * camera.fy);
        view.vignetting = vignetting;
    }
    for row in &learned.views {
        if let Some(view) = scene.views.iter_mut().find(|view| view.camera.name == row.name) {
            (view.camera.rotation, view.camera.translation) = row.pose();
            (view.gains, view.learned_pose) = (row.gains, true);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run() -> (tempfile::TempDir, RunDirectory) {
        let folder = tempfile::tempdir().unwrap();
        let run = RunDirectory::create(folder.path()).unwrap();
        (folder, run)
    }

    fn row() -> LearnedViewRow {
        let world_to_camera = [[0.0, 1.0, 0.0, 0.5], [-1.0, 0.0, 0.0, 2.0], [0.0, 0.0, 1.0, -1.0]];
        LearnedViewRow { name: "a".into(), world_to_camera, gains: [1.0, 0.9, 1.2] }
    }

    #[test]
    fn rows_are_read_as_written() {
        let (_folder, run) = run();
        assert_eq!(run.learned_views().unwrap(), None);
        let lens = LearnedLens { focal: 0.9, center: [0.01, -0.02], vignetting: -0.3, distortion: 0.02 };
        let learned = LearnedCameras { views: vec![row()], lens };
        run.write_learned_views(Some(&learned)).unwrap();
        assert_eq!(run.learned_views().unwrap(), Some(learned));
        // A file without a lens leaves the given one.
        let text = std::fs::read_to_string(run.path(FILE)).unwrap();
        let mut file: serde_json::Value = serde_json::from_str(&text).unwrap();
        file.as_object_mut().unwrap().remove("lens").unwrap();
        std::fs::write(run.path(FILE), file.to_string()).unwrap();
        assert_eq!(run.learned_views().unwrap().unwrap().lens, LearnedLens::default());
        run.write_learned_views(None).unwrap();
        assert_eq!(run.learned_views().unwrap(), None);
    }

    #[test]
    fn damaged_files_are_refused() {
        let (_folder, run) = run();
        let mut crooked = row();
        crooked.world_to_camera[0][1] = 1.1;
        let mut dark = row();
        dark.gains[1] = 0.0;
        for (row, part) in [(crooked, "no rotation"), (dark, "not positive")] {
            run.write_learned_views(Some(&LearnedCameras { views: vec![row], ..Default::default() })).unwrap();
            assert!(run.learned_views().unwrap_err().to_string().contains(part));
        }
        let lens = LearnedLens { focal: -1.0, ..Default::default() };
        run.write_learned_views(Some(&LearnedCameras { lens, ..Default::default() })).unwrap();
        assert!(run.learned_views().unwrap_err().to_string().contains("focal lengths"));
        std::fs::write(run.path("cameras.json"), "{").unwrap();
        assert!(run.learned_views().unwrap_err().to_string().contains("is not valid"));
    }
}
