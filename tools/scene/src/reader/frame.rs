//! Frame: a photograph with its camera, as returned by every reader.

use std::path::{Path, PathBuf};

use crate::beside::Beside;
use crate::camera::{Camera, Distortion};
use crate::error::{Result, SceneError};
use crate::image::{EXTENSIONS, read_size, turning_orientation};

/// Photograph with its camera.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Frame {
    /// Camera of the image at its stored size.
    pub(crate) camera: Camera,
    /// Lens distortion of that camera.
    pub(crate) lens: Distortion,
    /// Path of the image.
    pub(crate) image: PathBuf,
    /// File that describes the camera.
    pub(crate) declared_in: PathBuf,
    /// Files stored beside the image.
    pub(crate) beside: Beside,
}

impl Frame {
    /// Creates a frame without files beside it.
    pub(crate) fn new(camera: Camera, lens: Distortion, image: PathBuf, declared_in: PathBuf) -> Self {
        Self { camera, lens, image, declared_in, beside: Beside::default() }
    }

    /// Returns an error if the image header and the camera differ in size.
    pub(crate) fn check_size(&self) -> Result<()> {
        let image = read_size(&self.image)?;
        let camera = (self.camera.width, self.camera.height);
        if image == camera {
            return Ok(());
        }
        if (image.1, image.0) == camera
            && let Some(orientation) = turning_orientation(&self.image).filter(|orientation| *orientation >= 5)
        {
            let problem = format!(
                "the file stores {}×{} pixels and an EXIF orientation ({orientation}) that turns them, but {} gives {}×{} for \
                 its camera; turn the pixels themselves (mogrify -auto-orient), or calibrate the images as they are stored",
                image.0,
                image.1,
                self.declared_in.display(),
                camera.0,
                camera.1
            );
            return Err(SceneError::image(&self.image, problem));
        }
        let declared_in = self.declared_in.clone();
        Err(SceneError::ImageSize { path: self.image.clone(), image, camera, declared_in })
    }
}

/// Returns the image that a scene file names, relative to `folder`. The name may lack the extension. Returns `None` if
/// the file does not exist.
pub(crate) fn find_image(folder: &Path, name: &str) -> Option<PathBuf> {
    if name.is_empty() {
        return None;
    }
    // Files written on Windows separate folders with backslashes.
    let path = folder.join(name.replace('\\', "/"));
    if path.is_file() {
        return Some(path);
    }
    let with = |extension: &str| {
        let mut name = path.clone().into_os_string();
        name.push(".");
        name.push(extension);
        PathBuf::from(name)
    };
    let upper = EXTENSIONS.map(str::to_uppercase);
    let candidates = EXTENSIONS.iter().copied().chain(upper.iter().map(String::as_str));
    candidates.map(with).find(|candidate| candidate.is_file())
}

/// Returns a warning about frames whose image is missing; `None` if none is.
pub(crate) fn missing_warning(declared_in: &Path, missing: &[String], total: usize) -> Option<String> {
    let first = missing.first()?;
    let n = missing.len();
    Some(format!(
        "{n} of {total} frames in {} are skipped because their image does not exist (the first is {first:?})",
        declared_in.display()
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_are_found_with_and_without_extension() {
        let directory = tempfile::tempdir().unwrap();
        let root = directory.path();
        std::fs::create_dir(root.join("images")).unwrap();
        for name in ["images/a.png", "images/b.JPG", "images/c.5.exr"] {
            std::fs::write(root.join(name), "").unwrap();
        }
        let find = |name: &str| find_image(root, name).map(|p| p.strip_prefix(root).unwrap().to_path_buf());
        assert_eq!(find("images/a.png"), Some("images/a.png".into()));
        assert_eq!(find("images/a"), Some("images/a.png".into()));
        assert_eq!(find("images/b"), Some("images/b.JPG".into()));
        assert_eq!(find("images\\c.5"), Some("images/c.5.exr".into()));
        for none in ["images/d", "images", "", "images/a.jpg"] {
            assert_eq!(find(none), None, "{none}");
        }
    }

    #[test]
    fn missing_frames_cause_one_warning() {
        assert_eq!(missing_warning(Path::new("t.json"), &[], 3), None);
        let warning = missing_warning(Path::new("t.json"), &["a".into(), "b".into()], 5).unwrap();
        assert_eq!(
            warning,
            "2 of 5 frames in t.json are skipped because their image does not exist (the first is \"a\")"
        );
    }
}
