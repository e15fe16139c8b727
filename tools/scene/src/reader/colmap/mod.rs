//! Layout of COLMAP and of VGGT's export.
//!
//! The model is in `sparse/0` or `sparse` (nerfstudio: `colmap/sparse/0`; RealityScan: the scene directory), with
//! `cameras`, `images` and `points3D`, in binary or text form. Photographs are in `images`, or beside the model.
//!
//! The binary form takes precedence if both exist. Poses are already world-to-camera with OpenCV axes. Versions from 3.12
//! on also write rigs and frames, whose poses then place the images.

mod binary;
mod model;
mod rigs;
mod text;

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use super::downscaled;
use super::frame::{find_image, missing_warning};
use super::{Found, Frame, pose};
use crate::camera::Camera;
use crate::error::{Result, SceneError};
use crate::image::stem_of;
use crate::points::{PointCloud, Tracks};

pub(super) use model::Model;

/// Calibrated camera, shared by images.
#[derive(Clone, Debug, PartialEq)]
struct CameraRow {
    id: u32,
    width: u64,
    height: u64,
    model: Model,
}

/// Registered image.
#[derive(Clone, Debug, PartialEq)]
struct ImageRow {
    /// Image id; tracks refer to it.
    id: u32,
    /// World-to-camera quaternion, `(w, x, y, z)`.
    rotation: [f64; 4],
    translation: [f64; 3],
    camera: u32,
    name: String,
    /// Location in the file, for errors.
    place: String,
}

/// Folder and form of a model.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Location {
    folder: PathBuf,
    binary: bool,
}

impl Location {
    fn file(&self, name: &str) -> PathBuf {
        self.folder.join(format!("{name}.{}", if self.binary { "bin" } else { "txt" }))
    }
}

/// Possible folders of a model in a scene directory, in search order.
const FOLDERS: [&str; 4] = ["sparse/0", "sparse", "colmap/sparse/0", ""];

/// Returns the model of a scene directory if it exists.
pub(super) fn find(root: &Path) -> Option<Location> {
    FOLDERS.iter().find_map(|folder| in_folder(root.join(folder)))
}

/// Returns the model in a folder if it exists.
fn in_folder(folder: PathBuf) -> Option<Location> {
    let forms = [(true, "cameras.bin"), (false, "cameras.txt")];
    let (binary, _) = forms.into_iter().find(|(_, name)| folder.join(name).is_file())?;
    Some(Location { folder, binary })
}

/// Returns the scene directory of a folder that holds a model, such as `sparse/0`. Returns `None` for any other folder.
pub(super) fn scene_of_model(folder: &Path) -> Option<PathBuf> {
    in_folder(folder.to_owned())?;
    let folder = folder.canonicalize().ok()?;
    let root =
        folder.ancestors().skip(1).take(3).find(|root| find(root).is_some_and(|model| model.folder == folder))?;
    // In nerfstudio's layout, the `colmap` folder is in the scene directory beside the images.
    let outer = root.parent().filter(|_| root.ends_with("colmap") && !root.join("images").is_dir());
    Some(outer.unwrap_or(root).to_owned())
}

/// Reconstruction of COLMAP.
#[derive(Clone, Debug, PartialEq)]
pub struct ColmapModel {
    /// File names of the registered images, in the order of the file.
    pub images: Vec<String>,
    /// Number of reconstructed points.
    pub points: usize,
}

impl ColmapModel {
    /// Reads the model in a folder, such as `sparse/0`. Returns `None` if the folder holds no model.
    pub fn read(folder: &Path) -> Result<Option<Self>> {
        let Some(location) = in_folder(folder.to_owned()) else { return Ok(None) };
        let path = location.file("images");
        let images = if location.binary { binary::read_images(&path)? } else { text::read_images(&path)? };
        let path = location.file("points3D");
        let (points, _) = if location.binary { binary::read_points(&path)? } else { text::read_points(&path)? };
        Ok(Some(Self { images: images.into_iter().map(|row| row.name).collect(), points: points.len() }))
    }
}

/// Reads a scene directory.
pub(super) fn read(root: &Path) -> Result<Found> {
    let problem = || "holds no sparse/0 with cameras.bin or cameras.txt".to_string();
    let location = find(root).ok_or_else(|| SceneError::NotAScene { path: root.to_path_buf(), problem: problem() })?;
    let (cameras_path, images_path) = (location.file("cameras"), location.file("images"));
    let (cameras, images) = if location.binary {
        (binary::read_cameras(&cameras_path)?, binary::read_images(&images_path)?)
    } else {
        (text::read_cameras(&cameras_path)?, text::read_images(&images_path)?)
    };
    if images.is_empty() {
        let problem = "no image is registered; run the reconstruction again";
        return Err(SceneError::cameras(&images_path, "", problem));
    }
    let mut images = images;
    rigs::place(&location, &mut images)?;
    let cameras: HashMap<u32, CameraRow> = cameras.into_iter().map(|camera| (camera.id, camera)).collect();

    let folder = root.join("images");
    let mut found = Found::default();
    let mut names = HashMap::new();
    // Images by the name of their view.
    let mut used = HashMap::new();
    let files: Vec<Option<PathBuf>> = images.iter().map(|row| image_of(root, &row.name)).collect();
    let mut stems: HashMap<String, usize> = HashMap::new();
    files.iter().flatten().for_each(|image| *stems.entry(stem_of(image)).or_default() += 1);
    for (row, image) in images.iter().zip(files) {
        let place = format!("{} ({})", row.place, row.name);
        let fail = |problem: String| SceneError::cameras(&images_path, place.clone(), problem);
        let Some(image) = image else {
            found.missing.push(stem_of(Path::new(&row.name)));
            continue;
        };
        let shared = cameras.get(&row.camera).ok_or_else(|| {
            fail(format!("the image has the camera {}, which {} lacks", row.camera, cameras_path.display()))
        })?;
        let (rotation, translation) = pose::from_quaternion(row.rotation, row.translation).map_err(fail)?;
        let side = |n: u64| u32::try_from(n).unwrap_or(u32::MAX);
        let Model { fx, fy, cx, cy, lens } = shared.model;
        let stem = stem_of(&image);
        let camera = Camera {
            name: if stems[&stem] > 1 { with_folders(&row.name, &stem) } else { stem },
            width: side(shared.width),
            height: side(shared.height),
            fx,
            fy,
            cx,
            cy,
            rotation,
            translation,
            near: crate::camera::NEAR,
        };
        if let Some(problem) = camera.problem().or_else(|| lens.problem()) {
            return Err(SceneError::cameras(&cameras_path, format!("camera {}", shared.id), problem));
        }
        let camera = downscaled::fitted(camera, &image)?;
        if let Some(other) = used.insert(camera.name.clone(), row.name.clone()) {
            return Err(fail(format!(
                "this image and {other} would both be the view {}; rename one of them",
                camera.name
            )));
        }
        names.insert(row.id, camera.name.clone());
        found.frames.push(Frame::new(camera, lens, image, cameras_path.clone()));
    }
    if found.frames.is_empty() {
        let problem = format!(
            "none of the {} images exists (the first should be {}); put the images into {}",
            images.len(),
            folder.join(&images[0].name).display(),
            folder.display()
        );
        return Err(SceneError::cameras(&images_path, "", problem));
    }
    found.warnings.extend(missing_warning(&images_path, &found.missing, images.len()));
    if let Some((points, mut tracks)) = points_of(&location)? {
        tracks.name(names);
        (found.points, found.tracks) = (Some(points), Some(tracks));
    }
    Ok(found)
}

/// Returns the name of a view whose stem another image has, too: its folders and its stem.
fn with_folders(name: &str, stem: &str) -> String {
    let path = name.replace('\\', "/");
    path.rsplit_once('/').map_or(stem.to_owned(), |(folders, _)| format!("{}_{stem}", folders.replace('/', "_")))
}

/// Returns the photograph of a registered image. Searches `images`, then smaller copies, then the scene directory
/// itself.
fn image_of(root: &Path, name: &str) -> Option<PathBuf> {
    let in_images = format!("images/{name}");
    let exact = find_image(root, &in_images).or_else(|| downscaled::find(root, &in_images));
    // Smaller copies may have a different format than the originals.
    let stem = || format!("images/{}", Path::new(name).with_extension("").display());
    let other_kind = || find_image(root, &stem()).or_else(|| downscaled::find(root, &stem()));
    exact.or_else(other_kind).or_else(|| find_image(root, name))
}

/// Reads the model's points and tracks. Prefers `points3D` in the model's form over other forms. Fails if all files are
/// empty.
fn points_of(location: &Location) -> Result<Option<(PointCloud, Tracks)>> {
    let path = |name: &str| location.folder.join(name);
    let own = if location.binary { ["points3D.bin", "points3D.txt"] } else { ["points3D.txt", "points3D.bin"] };
    let mut empty = None;
    for name in own.into_iter().chain(["points3D.ply", "points.ply"]) {
        let path = path(name);
        if !path.is_file() {
            continue;
        }
        let points = match path.extension().and_then(|e| e.to_str()) {
            Some("bin") => binary::read_points(&path)?,
            Some("txt") => text::read_points(&path)?,
            _ => (PointCloud::read_ply(&path)?, Tracks::default()),
        };
        if !points.0.is_empty() {
            return Ok(Some(points));
        }
        empty.get_or_insert(path);
    }
    match empty {
        None => Ok(None),
        Some(path) => {
            let problem = "the file holds no points; replace it, or remove it to start from random points";
            Err(SceneError::points(&path, "", problem))
        }
    }
}

#[cfg(test)]
mod tests;
