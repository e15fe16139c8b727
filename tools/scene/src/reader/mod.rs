//! Readers: one module per layout of a scene directory.
//!
//! The files in a directory determine its layout. A reader finds cameras, images and points and converts them to this
//! crate's conventions. [`Scene`](crate::Scene) then performs the steps that all layouts share: split, scale, priors,
//! and checks.

mod blender;
pub(crate) mod colmap;
mod downscaled;
mod fipt;
mod frame;
mod interiorverse;
mod masks;
mod numbers;
mod photographs;
mod pose;
mod rgbd;
pub(crate) mod transforms;

use std::path::{Path, PathBuf};

pub use colmap::ColmapModel;
pub(crate) use frame::Frame;

use crate::error::{Result, SceneError};
use crate::points::{PointCloud, Tracks};

/// Layout of a scene directory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Layout {
    /// `transforms.json` of nerfstudio and instant-ngp.
    Transforms,
    /// `sparse/0` or `sparse` of COLMAP and VGGT.
    Colmap,
    /// `NNN_im.exr` and its maps.
    InteriorVerse,
    /// `transforms_train.json` with image folders, as in Blender and TensoIR scenes.
    Blender,
    /// `cam.txt` and `K_list.txt`, or `transforms.json` with the folder `Image`.
    Fipt,
    /// Recording of an RGB-D camera, as in 7-Scenes, TUM and ScanNet.
    Rgbd,
}

impl Layout {
    /// Returns the layout of a scene directory; `None` if it holds no scene.
    pub fn of(root: &Path) -> Option<Layout> {
        recognize(root).ok()
    }
}

/// Result of a reader.
#[derive(Debug, Default)]
pub(crate) struct Found {
    /// Frames whose image exists, in file order.
    pub(crate) frames: Vec<Frame>,
    /// Stems of frames whose image does not exist.
    pub(crate) missing: Vec<String>,
    /// Points, if the layout has any.
    pub(crate) points: Option<PointCloud>,
    /// Tracks of the points, if the layout has any.
    pub(crate) tracks: Option<Tracks>,
    /// Warnings for the user.
    pub(crate) warnings: Vec<String>,
    /// Whether the layout defines the test views; `split.json` takes precedence.
    pub(crate) own_split: bool,
}

/// Returns the scene directory of a path. A path to a COLMAP model refers to the scene that contains it.
pub(crate) fn scene_root(path: &Path) -> PathBuf {
    colmap::scene_of_model(path).unwrap_or_else(|| path.to_owned())
}

/// Detects the layout of a scene directory.
pub(crate) fn recognize(root: &Path) -> Result<Layout> {
    let problem = if !root.exists() {
        "does not exist; give the directory of a scene"
    } else if !root.is_dir() {
        "is not a directory; give the directory of a scene"
    } else if interiorverse::sign(root).is_some() {
        return Ok(Layout::InteriorVerse);
    } else if fipt::sign(root).is_some() {
        return Ok(Layout::Fipt);
    } else if transforms::find(root).is_some() {
        return Ok(Layout::Transforms);
    } else if colmap::find(root).is_some() {
        return Ok(Layout::Colmap);
    } else if blender::sign(root).is_some() {
        return Ok(Layout::Blender);
    } else if rgbd::sign(root).is_some() {
        return Ok(Layout::Rgbd);
    } else if let Some(problem) = photographs::problem(root) {
        return Err(SceneError::NotAScene { path: root.to_path_buf(), problem });
    } else {
        "holds no scene: there is neither transforms.json, nor sparse/0 with cameras.bin or cameras.txt, nor \
         transforms_train.json, nor images NNN_im.exr, nor cam.txt with K_list.txt, nor frames of an RGB-D camera"
    };
    Err(SceneError::NotAScene { path: root.to_path_buf(), problem: problem.into() })
}

/// Reads a scene directory with the given layout. `split` is a file that replaces the scene's `split.json`.
pub(crate) fn read(root: &Path, layout: Layout, split: Option<&Path>) -> Result<Found> {
    let with_masks = |mut found: Found| {
        masks::add(root, &mut found.frames);
        found
    };
    match layout {
        Layout::Transforms => transforms::read(root, split).map(with_masks),
        Layout::Colmap => colmap::read(root).map(with_masks),
        Layout::InteriorVerse => interiorverse::read(root, split),
        Layout::Blender => blender::read(root),
        Layout::Fipt => fipt::read(root),
        Layout::Rgbd => rgbd::read(root).map(with_masks),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn layouts_are_detected_from_files() {
        let directory = tempfile::tempdir().unwrap();
        let root = directory.path();
        let put = |name: &str, content: &str| {
            let path = root.join(name);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, content).unwrap();
        };
        assert!(recognize(root).unwrap_err().to_string().contains("neither transforms.json, nor sparse/0"));
        put("cam.txt", "");
        assert!(recognize(root).is_err());
        put("images/a.JPG", "");
        let error = recognize(root).unwrap_err().to_string();
        assert!(error.contains("photographs without cameras"), "{error}");
        put("transforms_train.json", "");
        assert_eq!(recognize(root).unwrap(), Layout::Blender);
        put("im.exr", "");
        put("x_im.exr", "");
        put("7_imx.exr", "");
        put("sparse/cameras.txt", "");
        assert_eq!(recognize(root).unwrap(), Layout::Colmap);
        put("gaussian_splat/transforms.json", "");
        assert_eq!(recognize(root).unwrap(), Layout::Transforms);
        put("transforms.json", "{\"frames\": [{\"file_path\": \"Image/000_0001.exr\"}]}");
        assert_eq!(recognize(root).unwrap(), Layout::Transforms);
        // Frames that name their images belong to nerfstudio; frames that do not belong to FIPT.
        put("Image/000_0001.exr", "");
        assert_eq!(recognize(root).unwrap(), Layout::Transforms);
        put("transforms.json", "{\"frames\": [{\"file_path\": \"./train/r_0\"}]}");
        assert_eq!(recognize(root).unwrap(), Layout::Fipt);
        put("transforms.json", "");
        put("K_list.txt", "");
        assert_eq!(recognize(root).unwrap(), Layout::Fipt);
        put("007_im.exr", "");
        assert_eq!(recognize(root).unwrap(), Layout::InteriorVerse);

        let error = recognize(&root.join("none")).unwrap_err().to_string();
        assert!(error.ends_with("none does not exist; give the directory of a scene"), "{error}");
        let error = recognize(&root.join("cam.txt")).unwrap_err().to_string();
        assert!(error.ends_with("cam.txt is not a directory; give the directory of a scene"), "{error}");
    }
}
