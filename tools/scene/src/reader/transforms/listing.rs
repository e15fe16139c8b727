//! Conversion of file entries to frames, for all layouts that list frames.

use std::path::{Path, PathBuf};

use super::Listing;
use crate::beside::{Beside, SensorDepth};
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

/// Adds the frames of a file whose name is `wanted`. Frames whose image does not exist are recorded as missing.
pub(in crate::reader) fn collect(
    source: &Source,
    file: &Listing,
    found: &mut Found,
    mut wanted: impl FnMut(&str) -> bool,
) -> Result<()> {
    let (mut missing, mut total) = (Vec::new(), 0);
    let (mut masks, mut depths) = (NamedFiles::of("mask_path"), NamedFiles::of("depth_file_path"));
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
        let mut beside = Beside { test: source.test.or(entry.test()), ..Default::default() };
        let root = source.path.parent().unwrap_or(Path::new(""));
        beside.mask = masks.find(root, entry.mask_path.as_deref());
        if let Some(path) = depths.find(root, entry.depth_file_path.as_deref()) {
            beside.depth = Some(SensorDepth { path, unit: intrinsics.depth_unit().map_err(fail)? });
        }
        found.frames.push(Frame { beside, ..Frame::new(camera, lens, image, source.path.to_path_buf()) });
    }
    found.warnings.extend(missing_warning(source.path, &missing, total));
    found.warnings.extend([masks, depths].iter().filter_map(|files| files.warning(source.path)));
    found.missing.extend(missing);
    Ok(())
}

/// Files of one kind that frames name by a key.
struct NamedFiles {
    key: &'static str,
    missing: Vec<String>,
}

impl NamedFiles {
    fn of(key: &'static str) -> Self {
        Self { key, missing: Vec::new() }
    }

    /// Returns the file that a frame names; `None` if there is none.
    fn find(&mut self, root: &Path, name: Option<&str>) -> Option<PathBuf> {
        let name = name.filter(|name| !name.is_empty())?;
        let path = root.join(name.replace('\\', "/"));
        if path.is_file() {
            return Some(path);
        }
        self.missing.push(name.to_owned());
        None
    }

    /// Returns a warning about missing files.
    fn warning(&self, declared_in: &Path) -> Option<String> {
        let (first, n, key) = (self.missing.first()?, self.missing.len(), self.key);
        Some(format!(
            "{n} frames in {} name a {key} that does not exist, and are used without it (the first is {first:?})",
            declared_in.display()
        ))
    }
}
