//! Conversion of file entries to frames, for all layouts that list frames.

use std::path::{Path, PathBuf};

use super::Listing;
use crate::beside::Beside;
use crate::depth_prior::DepthFile;
use crate::error::{Result, SceneError};
use crate::image::{read_size, stem_of};
use crate::reader::frame::{find_image, missing_warning};
use crate::reader::pose::Axes;
use crate::reader::{Found, Frame, downscaled};

/// Function that finds the image of a frame from its index and `file_path`. Returns the path of the image, if it
/// exists, and the name of the view.
type FindImage<'a> = dyn Fn(usize, &str) -> (Option<PathBuf>, String) + 'a;

/// Interpretation of the frames of a file.
pub(in crate::reader) struct Source<'a> {
    /// Path of the file.
    pub(in crate::reader) path: &'a Path,
    /// Camera axes of the poses.
    pub(in crate::reader) axes: Axes,
    /// Whether frames without `file_path` have an image.
    pub(in crate::reader) by_index: bool,
    /// Whether all frames are test views or all are not. If `None`, the frames' own values apply.
    pub(in crate::reader) test: Option<bool>,
    /// Finds images.
    pub(in crate::reader) image: Box<FindImage<'a>>,
}

impl<'a> Source<'a> {
    /// Returns the source for files of nerfstudio and instant-ngp.
    pub(super) fn plain(path: &'a Path) -> Self {
        let root = path.parent().unwrap_or(Path::new(""));
        let image = |_, name: &str| {
            let image = find_image(root, name).or_else(|| downscaled::find(root, name));
            let stem = stem_of(image.as_deref().unwrap_or(Path::new(name)));
            (image, stem)
        };
        Self { path, axes: Axes::OpenGl, by_index: false, test: None, image: Box::new(image) }
    }
}

/// Returns the depth map that a frame names. It must exist.
fn depth_of(listing: &Path, name: &str, unit: f64) -> Result<DepthFile, String> {
    let path = listing.parent().unwrap_or(Path::new("")).join(name.replace('\\', "/"));
    if path.is_file() {
        return Ok(DepthFile { path, unit });
    }
    Err(format!("depth_file_path is {}, which does not exist; put it there or remove the key", path.display()))
}

/// Adds the frames of a file whose name is `wanted`. Frames whose image does not exist are recorded as missing.
pub(in crate::reader) fn collect(
    source: &Source,
    file: &Listing,
    found: &mut Found,
    mut wanted: impl FnMut(&str) -> bool,
) -> Result<()> {
    let (mut missing, mut total) = (Vec::new(), 0);
    for (index, entry) in file.frames.iter().enumerate() {
        let fail = |problem: String| SceneError::cameras(source.path, entry.place(index), problem);
        let named = entry.file_path.as_deref().filter(|name| !name.is_empty());
        if named.is_none() && !source.by_index {
            return Err(fail("there is no file_path; every frame needs one".into()));
        }
        let (image, name) = (source.image)(index, named.unwrap_or(""));
        if !wanted(&name) {
            continue;
        }
        total += 1;
        let Some(image) = image else {
            missing.push(name);
            continue;
        };
        let (rotation, translation) = entry.pose(source.axes).map_err(fail)?;
        let intrinsics = entry.or(&file.all);
        let size = match intrinsics.size().map_err(fail)? {
            Some(size) => size,
            None => read_size(&image)?,
        };
        let camera = intrinsics.camera(name, size, rotation, translation).map_err(fail)?;
        let camera = downscaled::fitted(camera, &image)?;
        let lens = intrinsics.lens().map_err(fail)?;
        let depth = match entry.depth_file_path.as_deref().filter(|path| !path.is_empty()) {
            Some(depth) => Some(depth_of(source.path, depth, intrinsics.depth_unit().map_err(fail)?).map_err(fail)?),
            None => None,
        };
        let beside = Beside { test: source.test.or(entry.test()), depth, ..Default::default() };
        found.frames.push(Frame { beside, ..Frame::new(camera, lens, image, source.path.to_path_buf()) });
    }
    found.warnings.extend(missing_warning(source.path, &missing, total));
    found.missing.extend(missing);
    Ok(())
}
