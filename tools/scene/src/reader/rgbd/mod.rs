//! Recordings of RGB-D cameras: images, depth of a sensor, and a pose for each frame.
//!
//! - 7-Scenes and 3DMatch: `frame-NNNNNN.color.png`, `.depth.png` and `.pose.txt`, in the scene directory or in its
//!   folders `seq-NN`. Intrinsics are in `camera-intrinsics.txt`, or are those of the Kinect.
//! - TUM: `rgb.txt`, `depth.txt` and `groundtruth.txt`, whose times are matched. The name of the directory says which of
//!   the three calibrated cameras took the images.
//! - ScanNet, as its exporter writes it: `color`, `depth`, `pose` and `intrinsic/intrinsic_color.txt`.
//!
//! Poses are camera-to-world matrices or quaternions with OpenCV axes, in meters. Frames whose pose is missing or not
//! finite are skipped, as trackers write them when they are lost.

mod numbers;

use std::path::{Path, PathBuf};

use super::frame::missing_warning;
use super::{Found, Frame, pose};
use crate::beside::{Beside, SensorDepth};
use crate::camera::{Camera, Distortion, NEAR};
use crate::error::{Result, SceneError, io_error};
use crate::image::{read_size, stem_of};

/// Meters of a step of depth in 7-Scenes and ScanNet.
const MILLIMETER: f64 = 0.001;
/// Meters of a step of depth in TUM.
const TUM_UNIT: f64 = 1.0 / 5000.0;
/// Largest difference of times that TUM's own tools match, in seconds.
const TOLERANCE: f64 = 0.02;

/// Layout of a recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    SevenScenes,
    Tum,
    ScanNet,
}

/// Detects a recording in a scene directory.
pub(super) fn sign(root: &Path) -> Option<Kind> {
    let has = |names: &[&str]| names.iter().all(|name| root.join(name).exists());
    if has(&["rgb.txt", "groundtruth.txt"]) {
        Some(Kind::Tum)
    } else if has(&["color", "pose", "intrinsic/intrinsic_color.txt"]) {
        Some(Kind::ScanNet)
    } else {
        sequences(root).iter().any(|folder| !frames_in(folder).is_empty()).then_some(Kind::SevenScenes)
    }
}

/// Reads a scene directory.
pub(super) fn read(root: &Path) -> Result<Found> {
    let kind = sign(root).ok_or_else(|| SceneError::NotAScene {
        path: root.to_owned(),
        problem: "holds no recording of an RGB-D camera".into(),
    })?;
    let mut found = Found::default();
    match kind {
        Kind::SevenScenes => seven_scenes(root, &mut found)?,
        Kind::Tum => tum(root, &mut found)?,
        Kind::ScanNet => scannet(root, &mut found)?,
    }
    if found.frames.is_empty() {
        let problem = "no frame of the recording has both an image and a finite pose; copy it again".into();
        return Err(SceneError::NotAScene { path: root.to_owned(), problem });
    }
    let total = found.frames.len() + found.missing.len();
    let lost = found.missing.first().map(|first| {
        let n = found.missing.len();
        format!(
            "{n} of {total} frames in {} are skipped because they have no pose (the first is {first:?})",
            root.display()
        )
    });
    found.warnings.extend(lost);
    found.points = super::transforms::usual_points(root)?;
    Ok(found)
}

/// Returns the folders that may hold frames of 7-Scenes: the directory itself and its sequences.
fn sequences(root: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(root).into_iter().flatten().flatten();
    let is_sequence = |path: &PathBuf| {
        path.file_name().is_some_and(|name| name.to_string_lossy().starts_with("seq-")) && path.is_dir()
    };
    let mut folders: Vec<PathBuf> = entries.map(|entry| entry.path()).filter(is_sequence).collect();
    folders.sort();
    folders.insert(0, root.to_owned());
    folders
}

/// Returns the names of the frames of 7-Scenes in a folder, in order.
fn frames_in(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let names = entries.filter_map(|entry| entry.file_name().into_string().ok());
    let frames = names.filter_map(|name| Some(name.strip_suffix(".color.png")?.to_owned()));
    let mut frames: Vec<String> = frames.filter(|name| name.starts_with("frame-")).collect();
    frames.sort();
    frames
}

/// Pinhole camera of a recording at the size for which it is known.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Intrinsics {
    /// Focal lengths and principal point.
    values: [f64; 4],
    lens: Distortion,
    /// Width and height; `None` for the size of the image.
    size: Option<(f64, f64)>,
}

impl Intrinsics {
    /// Intrinsics of a camera with a common focal length at 640×480 pixels.
    fn vga(values: [f64; 4], lens: Distortion) -> Self {
        Self { values, lens, size: Some((640.0, 480.0)) }
    }

    /// Reads a matrix of intrinsics with `N` columns.
    fn read<const N: usize>(path: &Path) -> Result<Self> {
        let rows = numbers::matrix::<N>(path, 3)?;
        let values = [rows[0][0], rows[1][1], rows[0][2], rows[1][2]];
        Ok(Self { values, lens: Distortion::default(), size: None })
    }

    /// Returns the frame of an image.
    fn frame(
        &self,
        name: String,
        image: PathBuf,
        declared_in: &Path,
        rotation: glam::DMat3,
        translation: glam::DVec3,
    ) -> Result<Frame> {
        let (width, height) = read_size(&image)?;
        let scale = self.size.map_or((1.0, 1.0), |(w, h)| (f64::from(width) / w, f64::from(height) / h));
        let [fx, fy, cx, cy] = self.values;
        let (fx, cx, fy, cy) = (fx * scale.0, cx * scale.0, fy * scale.1, cy * scale.1);
        let camera = Camera { name, width, height, fx, fy, cx, cy, rotation, translation, near: NEAR };
        if let Some(problem) = camera.problem() {
            return Err(SceneError::cameras(declared_in, camera.name, problem));
        }
        Ok(Frame::new(camera, self.lens, image, declared_in.to_owned()))
    }
}

/// Reads a pose; `None` if it does not exist or is not finite.
fn pose_of(path: &Path) -> Result<Option<(glam::DMat3, glam::DVec3)>> {
    if !path.is_file() {
        return Ok(None);
    }
    let rows = numbers::matrix::<4>(path, 3)?;
    if rows.iter().flatten().any(|v| !v.is_finite()) {
        return Ok(None);
    }
    let pose = pose::from_matrix(&rows, pose::Axes::OpenCv);
    let pose =
        pose.map_err(|problem| SceneError::cameras(path, "", problem.replace("transform_matrix", "the pose")))?;
    Ok(Some(pose))
}

/// Adds the depth of a frame if its file exists.
fn with_depth(frame: Frame, path: PathBuf, unit: f64) -> Frame {
    let depth = path.is_file().then_some(SensorDepth { path, unit });
    Frame { beside: Beside { depth, ..frame.beside }, ..frame }
}

fn seven_scenes(root: &Path, found: &mut Found) -> Result<()> {
    let calibration = root.join("camera-intrinsics.txt");
    let intrinsics = if calibration.is_file() {
        Intrinsics::read::<3>(&calibration)?
    } else {
        // The data set has no calibration and recommends this one.
        Intrinsics::vga([585.0, 585.0, 320.0, 240.0], Distortion::default())
    };
    for folder in sequences(root) {
        let prefix = if folder == root {
            String::new()
        } else {
            format!("{}_", folder.file_name().unwrap_or_default().to_string_lossy())
        };
        for frame in frames_in(&folder) {
            let at = |suffix: &str| folder.join(format!("{frame}.{suffix}"));
            let (name, declared_in) = (format!("{prefix}{frame}"), at("pose.txt"));
            let Some((rotation, translation)) = pose_of(&declared_in)? else {
                found.missing.push(name);
                continue;
            };
            let read = intrinsics.frame(name, at("color.png"), &declared_in, rotation, translation)?;
            found.frames.push(with_depth(read, at("depth.png"), MILLIMETER));
        }
    }
    Ok(())
}

fn scannet(root: &Path, found: &mut Found) -> Result<()> {
    let intrinsics = Intrinsics::read::<4>(&root.join("intrinsic/intrinsic_color.txt"))?;
    let folder = root.join("color");
    let entries = std::fs::read_dir(&folder).map_err(io_error("read", &folder))?.flatten();
    let is_image = |path: &PathBuf| {
        path.extension().is_some_and(|e| ["jpg", "png"].iter().any(|known| e.eq_ignore_ascii_case(known)))
    };
    let mut images: Vec<PathBuf> = entries.map(|entry| entry.path()).filter(is_image).collect();
    images.sort();
    for image in images {
        let name = stem_of(&image);
        let declared_in = root.join(format!("pose/{name}.txt"));
        let Some((rotation, translation)) = pose_of(&declared_in)? else {
            found.missing.push(name);
            continue;
        };
        let depth = root.join(format!("depth/{name}.png"));
        let read = intrinsics.frame(name, image, &declared_in, rotation, translation)?;
        found.frames.push(with_depth(read, depth, MILLIMETER));
    }
    Ok(())
}

/// Returns the intrinsics of TUM's cameras, which the name of a recording tells.
fn tum_intrinsics(root: &Path) -> Intrinsics {
    let name = root.canonicalize().unwrap_or_else(|_| root.to_owned());
    let name = name.to_string_lossy().to_lowercase();
    let lens = |k1, k2, p1, p2, k3| Distortion { k1, k2, p1, p2, k3, ..Distortion::default() };
    let is = |number: u32| name.contains(&format!("freiburg{number}")) || name.contains(&format!("_fr{number}"));
    // The calibration that the data set publishes, and else the default of the driver.
    if is(1) {
        Intrinsics::vga([517.3, 516.5, 318.6, 255.3], lens(0.2624, -0.9531, -0.0054, 0.0026, 1.1633))
    } else if is(2) {
        Intrinsics::vga([520.9, 521.0, 325.1, 249.7], lens(0.2312, -0.7849, -0.0033, -0.0001, 0.9172))
    } else if is(3) {
        Intrinsics::vga([535.4, 539.2, 320.1, 247.6], Distortion::default())
    } else {
        Intrinsics::vga([525.0, 525.0, 319.5, 239.5], Distortion::default())
    }
}

fn tum(root: &Path, found: &mut Found) -> Result<()> {
    let (intrinsics, poses_path, depths_path) =
        (tum_intrinsics(root), root.join("groundtruth.txt"), root.join("depth.txt"));
    let sorted = |mut lines: Vec<numbers::Timed>| {
        lines.sort_by(|a, b| a.time.total_cmp(&b.time));
        lines
    };
    let images = numbers::timed(&root.join("rgb.txt"), 1)?;
    let poses = sorted(numbers::timed(&poses_path, 7)?);
    let depths = if depths_path.is_file() { sorted(numbers::timed(&depths_path, 1)?) } else { Vec::new() };
    let mut absent = Vec::new();
    for line in &images {
        let image = root.join(&line.words[0]);
        let name = stem_of(&image);
        if !image.is_file() {
            absent.push(name);
            continue;
        }
        let Some(pose) = numbers::nearest(&poses, line.time, TOLERANCE).map(|i| &poses[i]) else {
            found.missing.push(name);
            continue;
        };
        let place = || format!("line {}", pose.line);
        let values: Option<Vec<f64>> = pose.words[..7].iter().map(|word| word.parse().ok()).collect();
        let Some([x, y, z, qx, qy, qz, qw]) = values.as_deref().and_then(|v| <[f64; 7]>::try_from(v).ok()) else {
            let problem = "the line is not a time, a position and a quaternion; copy the file again";
            return Err(SceneError::cameras(&poses_path, place(), problem));
        };
        // The file has camera-to-world poses.
        let to_world = pose::from_quaternion([qw, qx, qy, qz], [x, y, z]);
        let (to_world, center) = to_world.map_err(|problem| SceneError::cameras(&poses_path, place(), problem))?;
        let rotation = to_world.transpose();
        let read = intrinsics.frame(name, image, &poses_path, rotation, -(rotation * center))?;
        let depth = numbers::nearest(&depths, line.time, TOLERANCE).map(|i| root.join(&depths[i].words[0]));
        found.frames.push(match depth {
            Some(path) => with_depth(read, path, TUM_UNIT),
            None => read,
        });
    }
    found.warnings.extend(missing_warning(&root.join("rgb.txt"), &absent, images.len()));
    Ok(())
}

#[cfg(test)]
mod tests;
