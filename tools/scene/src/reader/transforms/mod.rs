//! Layout of nerfstudio and instant-ngp: one `transforms.json` beside the images.
//!
//! The file has pinhole intrinsics with OpenCV distortion, for all frames or per frame, and camera-to-world matrices
//! with OpenGL axes. Without images, the same file describes cameras to render ([`Camera::read_transforms`]).

mod intrinsics;
mod listing;
mod write;

use std::collections::HashSet;
use std::path::{Path, PathBuf};

use serde::Deserialize;

use self::intrinsics::Entry;
pub(super) use self::listing::{Source, collect};
use super::Found;
use super::frame::find_image;
use super::pose::Axes;
use crate::camera::Camera;
use crate::error::{Result, SceneError};
use crate::image::{read_size, stem_of};
use crate::json::read_json;
use crate::points::PointCloud;
use crate::split::Split;

/// Default names of point clouds, in search order. They apply if the file names no point cloud.
const POINT_FILES: [&str; 4] = ["points.ply", "init.ply", "points3d.ply", "points3D.ply"];

/// Files with held-out frames that `transforms.json` may lack.
const COMPANIONS: [&str; 2] = ["transforms_val.json", "transforms_test.json"];

/// File with a list of frames.
#[derive(Deserialize)]
pub(super) struct Listing {
    ply_file_path: Option<String>,
    frames: Vec<Entry>,
    /// Top-level fields for all frames.
    #[serde(skip)]
    all: Entry,
}

impl Listing {
    /// Returns the image name of the first frame.
    pub(super) fn first(&self) -> Option<&str> {
        self.frames.first()?.file_path.as_deref()
    }
}

/// Reads a file; fails if it has no frames.
pub(super) fn open(path: &Path) -> Result<Listing> {
    let all: Entry = read_json(path)?;
    let listing: Listing = read_json(path)?;
    let listing = Listing { all, ..listing };
    if listing.frames.is_empty() {
        return Err(SceneError::cameras(path, "", "the list of frames is empty; there must be at least one"));
    }
    Ok(listing)
}

/// Finds the `transforms.json` of a scene directory. DL3DV stores it in the subfolder `nerfstudio` or `gaussian_splat`.
pub(super) fn find(root: &Path) -> Option<PathBuf> {
    let folders = ["", "nerfstudio", "gaussian_splat"];
    folders.iter().map(|folder| root.join(folder).join("transforms.json")).find(|path| path.is_file())
}

/// Returns the image that the first frame of a file names, if it exists.
pub(super) fn first_image(path: &Path) -> Result<Option<PathBuf>> {
    let file = open(path)?;
    let root = path.parent().unwrap_or(Path::new(""));
    Ok(file.first().and_then(|name| find_image(root, name)))
}

/// Reads a scene directory. `split` is a file that replaces the scene's `split.json`.
pub(super) fn read(root: &Path, split: Option<&Path>) -> Result<Found> {
    let path = find(root).unwrap_or_else(|| root.join("transforms.json"));
    let root = path.parent().unwrap_or(root);
    let file = open(&path)?;
    let mut found = Found::default();
    collect(&Source::plain(&path), &file, &mut found, |_| true)?;
    if found.frames.is_empty() {
        let looked = file.frames[0].file_path.clone().unwrap_or_default();
        let problem = format!(
            "none of the {} frames has its image (the first should be {}); put the images there or correct file_path",
            file.frames.len(),
            root.join(looked).display()
        );
        return Err(SceneError::cameras(&path, "", problem));
    }
    held_out(root, split, &mut found)?;
    found.points = points_of(root, &path, file.ply_file_path.as_deref())?;
    Ok(found)
}

/// Adds held-out frames from the companion files. Some scenes list only training frames in `transforms.json`. Views
/// that `split.json` names and `transforms.json` lacks are searched in its companions.
fn held_out(root: &Path, split: Option<&Path>, found: &mut Found) -> Result<()> {
    let split = split.map_or_else(|| root.join("split.json"), Path::to_path_buf);
    if !split.is_file() {
        return Ok(());
    }
    let mut wanted = Split::names(&split)?;
    let known = found.frames.iter().map(|frame| &frame.camera.name).chain(&found.missing);
    known.for_each(|name| {
        wanted.remove(name);
    });
    for name in COMPANIONS {
        let path = root.join(name);
        if wanted.is_empty() || !path.is_file() {
            continue;
        }
        let file = open(&path)?;
        collect(&Source::plain(&path), &file, found, |stem| wanted.remove(stem))?;
    }
    Ok(())
}

/// Reads the point cloud that the file names, or one with a default name.
fn points_of(root: &Path, declared_in: &Path, named: Option<&str>) -> Result<Option<PointCloud>> {
    let named = named.filter(|name| !name.is_empty()).map(|name| root.join(name));
    if let Some(path) = &named
        && !path.is_file()
    {
        let problem =
            format!("ply_file_path is {}, which does not exist; put it there or remove the key", path.display());
        return Err(SceneError::cameras(declared_in, "", problem));
    }
    match named {
        Some(path) => read_points(&path).map(Some),
        None => usual_points(root),
    }
}

/// Reads the point cloud of a folder with a default name.
pub(super) fn usual_points(root: &Path) -> Result<Option<PointCloud>> {
    let usual = POINT_FILES.iter().map(|name| root.join(name)).find(|path| path.is_file());
    usual.map(|path| read_points(&path)).transpose()
}

/// Reads a point cloud; fails if it is empty.
pub(in crate::reader) fn read_points(path: &Path) -> Result<PointCloud> {
    let points = PointCloud::read_ply(path)?;
    if points.is_empty() {
        let problem = "the file holds no points; replace it, or remove it to start from random points";
        return Err(SceneError::points(path, "", problem));
    }
    Ok(points)
}

impl Camera {
    /// Reads the cameras of a `transforms.json`, in file order. Images need not exist.
    ///
    /// The size comes from `w` and `h`, or from the image if it exists. A frame without `file_path` has its index as
    /// name. Lens distortion is ignored, because renders show the undistorted image.
    pub fn read_transforms(path: &Path) -> Result<Vec<Self>> {
        let file = open(path)?;
        let folder: PathBuf = path.parent().unwrap_or(Path::new("")).into();
        let mut names = HashSet::new();
        let mut cameras = Vec::with_capacity(file.frames.len());
        for (index, entry) in file.frames.iter().enumerate() {
            let fail = |problem: String| SceneError::cameras(path, entry.place(index), problem);
            let (rotation, translation) = entry.pose(Axes::OpenGl).map_err(fail)?;
            let intrinsics = entry.or(&file.all);
            let file_path = entry.file_path.as_deref().unwrap_or("");
            let size = match intrinsics.size().map_err(fail)? {
                Some(size) => size,
                None => match find_image(&folder, file_path) {
                    Some(image) => read_size(&image)?,
                    None => {
                        return Err(fail("the image size is unknown; add w and h in pixels to the file".into()));
                    }
                },
            };
            let name = if file_path.is_empty() { format!("{index:03}") } else { stem_of(Path::new(file_path)) };
            if !names.insert(name.clone()) {
                let problem = format!("the name \"{name}\" was used before; give every frame a file_path of its own");
                return Err(fail(problem));
            }
            cameras.push(intrinsics.camera(name, size, rotation, translation).map_err(fail)?);
        }
        Ok(cameras)
    }
}

#[cfg(test)]
mod tests;
