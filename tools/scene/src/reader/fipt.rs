//! FIPT scenes with HDR images `Image/NNN_0001.exr`.
//!
//! Real captures have `cam.txt` and `K_list.txt`. `cam.txt` has the origin, a target point, and the up vector of each
//! camera, with OpenCV axes. `K_list.txt` has one intrinsic matrix per camera, including the principal point.
//!
//! Synthetic scenes have `transforms.json`, in `train/` and `val/` or alone. Poses have Mitsuba's axes (x left, y up, z
//! forward), and frames refer to images by index. Albedo and roughness are stored beside the images, for evaluation
//! only.

use std::path::{Path, PathBuf};

use glam::DVec3;

use super::frame::missing_warning;
use super::numbers::{self, Block};
use super::pose::{self, Axes};
use super::transforms::{self, Source, collect, usual_points};
use super::{Found, Frame};
use crate::beside::{Form, GroundTruthKind};
use crate::camera::{Camera, Distortion};
use crate::error::{Result, SceneError, io_error};
use crate::image::{read_size, stem_of};

/// Returns the names of the files that identify the layout, if they exist.
pub(super) fn sign(root: &Path) -> Option<String> {
    let both = root.join("cam.txt").is_file() && root.join("K_list.txt").is_file();
    let synthetic = |folder: &Path| folder.join("transforms.json").is_file() && folder.join("Image").is_dir();
    if both {
        Some("cam.txt and K_list.txt".into())
    } else if synthetic(&root.join("train")) {
        Some("train/transforms.json and train/Image".into())
    } else {
        (synthetic(root) && by_index(root)).then(|| "transforms.json and Image".into())
    }
}

/// Returns whether frames of `transforms.json` refer to images in `Image` by index.
fn by_index(root: &Path) -> bool {
    let named = |path: &Path| transforms::first_image(path).is_ok_and(|image| image.is_some());
    image_of(root, "Image", 0).is_file() && !named(&root.join("transforms.json"))
}

fn image_of(root: &Path, folder: &str, index: usize) -> PathBuf {
    root.join(folder).join(format!("{index:03}_0001.exr"))
}

/// Reads a scene directory.
pub(super) fn read(root: &Path) -> Result<Found> {
    if root.join("cam.txt").is_file() && root.join("K_list.txt").is_file() {
        let is_image = |name: &str| {
            let stem = name.strip_suffix(".exr").or_else(|| name.strip_suffix(".EXR"))?;
            stem.split('_').next()?.parse().ok()
        };
        return read_real(root, &root.join("Image"), "_0001", &is_image);
    }
    let mut found = Found::default();
    if !root.join("train").is_dir() {
        read_synthetic(root, None, &mut found)?;
    } else {
        found.own_split = true;
        read_synthetic(root, Some(("train", false)), &mut found)?;
        if root.join("val/transforms.json").is_file() {
            read_synthetic(root, Some(("val", true)), &mut found)?;
        }
    }
    if found.frames.is_empty() {
        let problem = "none of the frames has its image; they should be Image/000_0001.exr and up";
        return Err(SceneError::cameras(&root.join("transforms.json"), "", problem));
    }
    found.points = usual_points(root)?;
    Ok(found)
}

/// Adds the frames of one `transforms.json`.
fn read_synthetic(root: &Path, split: Option<(&str, bool)>, found: &mut Found) -> Result<()> {
    let folder = root.join(split.map_or("", |(name, _)| name));
    let path = folder.join("transforms.json");
    let file = transforms::open(&path)?;
    let image = |index: usize, _: &str| {
        let image = image_of(&folder, "Image", index);
        // Both splits count from 000.
        let name = split.map_or(format!("{index:03}"), |(split, _)| format!("{split}_{index:03}"));
        (image.is_file().then_some(image), name)
    };
    let test = split.map(|(_, test)| test);
    let source = Source { path: &path, axes: Axes::Mitsuba, by_index: true, test, image: Box::new(image) };
    let before = found.frames.len();
    collect(&source, &file, found, |_| true)?;
    for frame in &mut found.frames[before..] {
        let stem = stem_of(&frame.image);
        let number = stem.split('_').next().unwrap_or_default();
        let beside = &mut frame.beside;
        beside.add(GroundTruthKind::Albedo, folder.join("albedo").join(format!("{number}.exr")), Form::LinearColor);
        beside.add(GroundTruthKind::Albedo, folder.join("DiffCol").join(format!("{stem}.exr")), Form::LinearColor);
        beside.add(GroundTruthKind::Roughness, folder.join("Roughness").join(format!("{stem}.exr")), Form::Channel(0));
    }
    Ok(())
}

/// Reads `cam.txt` and `K_list.txt` with images `NNN` plus a suffix from `folder`. `number` returns the number of an
/// image file, or `None` for other files.
pub(super) fn read_real(
    root: &Path,
    folder: &Path,
    suffix: &str,
    number: &dyn Fn(&str) -> Option<usize>,
) -> Result<Found> {
    let (cameras, matrices) = (root.join("cam.txt"), root.join("K_list.txt"));
    let (poses, intrinsics) = (numbers::read(&cameras)?, numbers::read(&matrices)?);
    if poses.len() != intrinsics.len() {
        let problem = format!(
            "the file has {} matrices, but {} has {} cameras; both must have the same number",
            intrinsics.len(),
            cameras.display(),
            poses.len()
        );
        return Err(SceneError::cameras(&matrices, "", problem));
    }
    let images = images_of(folder, poses.len(), number)?;
    let mut found = Found::default();
    for (index, (pose, matrix)) in poses.iter().zip(&intrinsics).enumerate() {
        let Some(image) = images[index].clone() else {
            found.missing.push(format!("{index:03}{suffix}"));
            continue;
        };
        let (width, height) = read_size(&image)?;
        let (fx, fy, cx, cy) = intrinsics_of(matrix, (width, height), &image).map_err(|problem| {
            SceneError::cameras(&matrices, format!("line {}, camera {index}", matrix.line), problem)
        })?;
        let fail = |problem| SceneError::cameras(&cameras, format!("line {}, camera {index}", pose.line), problem);
        let [origin, target, up] = pose.rows.map(DVec3::from);
        let (rotation, translation) = pose::from_look_at(origin, target, up).map_err(fail)?;
        let name = stem_of(&image);
        let camera = Camera { name, width, height, fx, fy, cx, cy, rotation, translation, near: crate::camera::NEAR };
        if let Some(problem) = camera.problem() {
            return Err(fail(problem));
        }
        found.frames.push(Frame::new(camera, Distortion::default(), image, matrices.clone()));
    }
    if found.frames.is_empty() {
        let problem = format!(
            "none of the {} cameras has its image (the first should be {}); put the images there",
            poses.len(),
            folder.join(format!("000{suffix}.exr")).display()
        );
        return Err(SceneError::cameras(&cameras, "", problem));
    }
    found.warnings.extend(missing_warning(&cameras, &found.missing, poses.len()));
    found.points = usual_points(root)?;
    Ok(found)
}

/// Returns the image of each camera. With equally many images and cameras, images are assigned in the order of their
/// numbers. Otherwise the number of an image is the index of its camera.
fn images_of(folder: &Path, count: usize, number: &dyn Fn(&str) -> Option<usize>) -> Result<Vec<Option<PathBuf>>> {
    let entries = std::fs::read_dir(folder).map_err(io_error("read", folder))?;
    let mut numbered: Vec<(usize, PathBuf)> = Vec::new();
    for path in entries.flatten().map(|entry| entry.path()) {
        if let Some(number) = path.file_name().and_then(|name| number(&name.to_string_lossy())) {
            numbered.push((number, path));
        }
    }
    numbered.sort();
    let mut images = vec![None; count];
    let in_order = numbered.len() == count;
    for (position, (number, path)) in numbered.into_iter().enumerate() {
        if let Some(place) = images.get_mut(if in_order { position } else { number }) {
            *place = Some(path);
        }
    }
    Ok(images)
}

/// Returns focal lengths and principal point of an intrinsic matrix.
fn intrinsics_of(k: &Block, size: (u32, u32), image: &Path) -> Result<(f64, f64, f64, f64), String> {
    let [[fx, skew, cx], [below, fy, cy], last] = k.rows;
    if k.rows.iter().flatten().any(|v| !v.is_finite()) {
        return Err("the matrix holds values that are not finite; correct it".into());
    }
    let scale = fx.abs().max(1.0);
    if skew.abs() > 1e-6 * scale || below.abs() > 1e-6 * scale || last != [0.0, 0.0, 1.0] {
        return Err(format!("the matrix is {:?}; it must be [fx, 0, cx], [0, fy, cy], [0, 0, 1]", k.rows));
    }
    let (width, height) = (f64::from(size.0), f64::from(size.1));
    if !(0.0..=width).contains(&cx) || !(0.0..=height).contains(&cy) {
        return Err(format!(
            "the principal point ({cx}, {cy}) lies outside of {}, which is {}×{} pixels; the matrix is for images of \
             another size",
            image.display(),
            size.0,
            size.1
        ));
    }
    Ok((fx, fy, cx, cy))
}
