//! The layout of InteriorVerse: HDR images `NNN_im.exr` with albedo, material, normal, depth and mask beside each.
//!
//! The release has no cameras; they come from `transforms.json`, whose frames may name their `split`, from FIPT's `cam.txt`
//! and `K_list.txt`, or from a COLMAP or VGGT model of the images in `sparse`.
//!
//! The mask marks valid pixels and belongs to the image: what it excludes is not trained on. Everything else is for
//! measuring only, never a prior: roughness is the red channel of the material and metallic the green one, normals have
//! OpenGL camera axes, depth is documented in millimeters and checked before use.

use std::path::{Path, PathBuf};

use super::{Found, Frame, colmap, fipt, transforms};
use crate::beside::Form;
use crate::error::{Result, SceneError};
use crate::ground_truth::GroundTruthKind;
use crate::maps::NormalFrame;

/// The image that the layout is recognized by: the first one, `NNN_im.exr`.
pub(super) fn sign(root: &Path) -> Option<String> {
    let entries = std::fs::read_dir(root).ok()?;
    let names = entries.filter_map(|entry| entry.ok()?.file_name().into_string().ok());
    names.filter(|name| name.ends_with("_im.exr") && number(name).is_some()).min()
}

/// The number of `NNN_im.exr`, `NNN_im_denoised.exr` or `NNN_im_denoised.png`.
fn number(name: &str) -> Option<&str> {
    let digits = &name[..name.find(|c: char| !c.is_ascii_digit())?];
    let rest = name[digits.len()..].strip_prefix("_im")?;
    let rest = rest.strip_prefix("_denoised").unwrap_or(rest);
    (!digits.is_empty() && (rest == ".exr" || rest == ".png")).then_some(digits)
}

/// Reads a scene directory. `split` is a file that takes the place of the scene's `split.json`.
pub(super) fn read(root: &Path, split: Option<&Path>) -> Result<Found> {
    let mut found = if root.join("transforms.json").is_file() {
        transforms::read(root, split)?
    } else if root.join("cam.txt").is_file() && root.join("K_list.txt").is_file() {
        let is_image = |name: &str| name.ends_with(".exr").then(|| number(name)?.parse().ok()).flatten();
        fipt::read_real(root, root, "_im", &is_image)?
    } else if colmap::find(root).is_some() {
        colmap::read(root)?
    } else {
        let problem = format!(
            "holds InteriorVerse images ({}) without cameras; put a transforms.json beside them, or a model of COLMAP or \
             VGGT into sparse",
            sign(root).unwrap_or_default()
        );
        return Err(SceneError::NotAScene { path: root.to_path_buf(), problem });
    };
    found.own_split = found.frames.iter().any(|frame| frame.beside.test == Some(true));
    found.frames.iter_mut().for_each(|frame| add_beside(root, frame));
    Ok(found)
}

/// Lists what lies beside an image, in its folder or in the scene's.
fn add_beside(root: &Path, frame: &mut Frame) {
    let image = frame.image.clone();
    let name = image.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let Some(number) = number(&name) else {
        return;
    };
    let find = |kind: &str| -> Option<PathBuf> {
        // Only masks come as PNG too.
        let extensions: &[&str] = if kind == "mask" { &["exr", "png"] } else { &["exr"] };
        let folders = image.parent().into_iter().chain([root]);
        let paths = |folder: &Path| extensions.iter().map(|e| folder.join(format!("{number}_{kind}.{e}"))).collect();
        folders.flat_map(|folder| -> Vec<PathBuf> { paths(folder) }).find(|path| path.is_file())
    };
    let beside = &mut frame.beside;
    beside.mask = find("mask");
    for (kind, file, form) in [
        (GroundTruthKind::Albedo, "albedo", Form::LinearColor),
        (GroundTruthKind::Normal, "normal", Form::Normal(NormalFrame::CameraOpengl)),
        (GroundTruthKind::Depth, "depth", Form::Depth),
        (GroundTruthKind::Roughness, "material", Form::Channel(0)),
        (GroundTruthKind::Metallic, "material", Form::Channel(1)),
        (GroundTruthKind::Mask, "mask", Form::Channel(0)),
    ] {
        if let Some(path) = find(file) {
            beside.add(kind, path, form);
        }
    }
}
