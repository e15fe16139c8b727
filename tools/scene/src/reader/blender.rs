//! Layout of Blender's synthetic scenes and TensoIR.
//!
//! Uses `transforms_train.json` and `transforms_test.json`. Frames name images without extension (`./train/r_0`) or in
//! one folder per view (`./train_000/rgba`).
//!
//! Poses have OpenGL axes. Images are RGBA. TensoIR stores ground truth beside `rgba.png`, for evaluation only:
//! `albedo.png` (linear values, as in TensoIR's loader), `normal.png` (world space), and `rgba_NAME.png` under other
//! lightings.

use std::path::{Path, PathBuf};

use super::frame::find_image;
use super::pose::Axes;
use super::transforms::{Source, collect, open, usual_points};
use super::{Found, Frame};
use crate::beside::{Form, GroundTruthKind};
use crate::error::{Result, SceneError};
use crate::image::stem_of;
use crate::map_file::NormalFrame;

/// Returns the name of the file that identifies the layout, if it exists.
pub(super) fn sign(root: &Path) -> Option<String> {
    let name = "transforms_train.json";
    root.join(name).is_file().then(|| name.into())
}

/// Reads a scene directory.
pub(super) fn read(root: &Path) -> Result<Found> {
    let mut found = Found { own_split: true, ..Default::default() };
    let mut first = String::new();
    let test = ["transforms_test.json", "transforms_val.json"].into_iter().find(|name| root.join(name).is_file());
    for (name, is_test) in [("transforms_train.json", false)].into_iter().chain(test.map(|name| (name, true))) {
        let path = root.join(name);
        let file = open(&path)?;
        if first.is_empty() {
            first = file.first().unwrap_or_default().into();
        }
        let image = |_, name: &str| find(root, name);
        let source =
            Source { path: &path, axes: Axes::OpenGl, by_index: false, test: Some(is_test), image: Box::new(image) };
        collect(&source, &file, &mut found, |_| true)?;
    }
    if found.frames.is_empty() {
        let problem = format!(
            "none of the frames has its image (the first should be {}); put the images there or correct file_path",
            root.join(first).display()
        );
        return Err(SceneError::cameras(&root.join("transforms_train.json"), "", problem));
    }
    found.frames.iter_mut().for_each(add_beside);
    found.points = usual_points(root)?;
    Ok(found)
}

/// Returns the image of a frame and the name of its view. The name is the path without extension, so that `train/r_0`
/// and `test/r_0` differ. In a folder for one view, the name omits the file.
fn find(root: &Path, file_path: &str) -> (Option<PathBuf>, String) {
    let clean = file_path.replace('\\', "/");
    let clean = clean.trim().trim_start_matches("./").trim_end_matches('/');
    let image = find_image(root, clean).or_else(|| find_image(root, &format!("{clean}/rgba")));
    let own_folder = |stem: &str| stem == "rgba" || stem.starts_with("rgba_");
    let name = match clean.rsplit_once('/') {
        Some((folder, file)) if own_folder(&stem_of(Path::new(file))) => folder.to_string(),
        Some((folder, file)) => format!("{folder}/{}", stem_of(Path::new(file))),
        None => stem_of(Path::new(clean)),
    };
    (image, name.replace('/', "_"))
}

/// Lists the files beside an image.
fn add_beside(frame: &mut Frame) {
    let image = frame.image.clone();
    let (Some(folder), stem) = (image.parent(), stem_of(&image)) else {
        return;
    };
    frame.beside.add(GroundTruthKind::Mask, image.clone(), Form::Alpha);
    if stem != "rgba" && !stem.starts_with("rgba_") {
        return;
    }
    frame.beside.add(GroundTruthKind::Albedo, folder.join("albedo.png"), Form::LinearColor);
    frame.beside.add(GroundTruthKind::Normal, folder.join("normal.png"), Form::Normal(NormalFrame::World));
    frame.beside.add(GroundTruthKind::Roughness, folder.join("roughness.png"), Form::Channel(0));
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        let path = entry.path();
        let other = stem_of(&path);
        if let Some(light) = other.strip_prefix("rgba_")
            && path.extension().is_some_and(|e| e == "png")
            && other != stem
        {
            frame.beside.relit.push((light.to_string(), path));
        }
    }
    frame.beside.relit.sort();
}
