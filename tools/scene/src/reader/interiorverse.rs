//! Layout of InteriorVerse: HDR images `NNN_im.exr` with maps beside each. The maps are albedo, material, normal, depth
//! and mask.
//!
//! The release has no cameras. They come from `transforms.json`, whose frames may have a `split`, from FIPT's `cam.txt`
//! and `K_list.txt`, or from a COLMAP or VGGT model in `sparse`.
//!
//! The mask marks valid pixels and belongs to the image: training ignores excluded pixels. All other maps are for
//! evaluation only and never priors. Roughness is the red channel of the material, and metallic the green channel.
//! Normals have OpenGL camera axes. Depth is documented in millimeters and checked before use.

use std::path::{Path, PathBuf};

use super::{Found, Frame, colmap, fipt, transforms};
use crate::beside::{Form, GroundTruthKind};
use crate::error::{Result, SceneError};
use crate::map_file::NormalFrame;

/// Returns the name of the first image `NNN_im.exr`, which identifies the layout.
pub(super) fn sign(root: &Path) -> Option<String> {
    let entries = std::fs::read_dir(root).ok()?;
    let names = entries.filter_map(|entry| entry.ok()?.file_name().into_string().ok());
    names.filter(|name| name.ends_with("_im.exr") && number(name).is_some()).min()
}

/// Returns the number in the name of an image. Supported names are `NNN_im` and `NNN_im_denoised`, with the extension
/// `.exr` or `.png`.
fn number(name: &str) -> Option<&str> {
    let digits = &name[..name.find(|c: char| !c.is_ascii_digit())?];
    let rest = name[digits.len()..].strip_prefix("_im")?;
    let rest = rest.strip_prefix("_denoised").unwrap_or(rest);
    (!digits.is_empty() && (rest == ".exr" || rest == ".png")).then_some(digits)
}

/// Reads a scene directory. `split` is a file that replaces the scene's `split.json`.
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

/// Lists the files beside an image, in its folder or in the scene directory.
fn add_beside(root: &Path, frame: &mut Frame) {
    let image = frame.image.clone();
    let name = image.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let Some(number) = number(&name) else {
        return;
    };
    let find = |kind: &str| -> Option<PathBuf> {
        // Only masks may also be PNG files.
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
