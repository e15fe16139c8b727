//! Smaller copies of images: `images_2`, `images_4` and `images_8` beside or instead of `images`, as MipNeRF-360 and DL3DV
//! ship them, with cameras that were calibrated for the full size.

use std::path::{Path, PathBuf};

use super::frame::find_image;
use crate::camera::Camera;
use crate::error::Result;
use crate::image::read_size;

/// By how much the copies are smaller, in the order in which they are looked for.
const FACTORS: [u32; 3] = [2, 4, 8];

/// The copy of an image that a file names in the folder `images` below `root`.
pub(super) fn find(root: &Path, name: &str) -> Option<PathBuf> {
    let name = name.replace('\\', "/");
    FACTORS.iter().find_map(|factor| {
        let mut replaced = false;
        let parts = name.split('/').map(|part| {
            let this = part == "images" && !replaced;
            replaced |= this;
            if this { format!("images_{factor}") } else { part.to_string() }
        });
        let copy = parts.collect::<Vec<_>>().join("/");
        if replaced { find_image(root, &copy) } else { None }
    })
}

/// The camera for the image: where this lies in a folder of smaller copies and is as much smaller than the camera's, the
/// camera is scaled to it.
pub(super) fn fitted(camera: Camera, image: &Path) -> Result<Camera> {
    let folder = image.parent().and_then(Path::file_name).unwrap_or_default().to_string_lossy();
    let factor = FACTORS.iter().find(|factor| folder == format!("images_{factor}"));
    let Some(&factor) = factor else {
        return Ok(camera);
    };
    let (width, height) = read_size(image)?;
    let near = |copy: u32, full: u32| (f64::from(copy) - f64::from(full) / f64::from(factor)).abs() < 1.0;
    let is_copy = near(width, camera.width) && near(height, camera.height);
    Ok(if is_copy { camera.scaled(width, height) } else { camera })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::tests::camera;
    use crate::image::{Image, write_png};

    #[test]
    fn copies_are_found_and_cameras_follow_them() {
        let directory = tempfile::tempdir().unwrap();
        let root = directory.path();
        for (factor, width, height) in [(4, 40, 31), (8, 20, 15)] {
            let folder = root.join(format!("deep/images_{factor}"));
            std::fs::create_dir_all(&folder).unwrap();
            write_png(&folder.join("a.png"), &Image::new(width, height, 3)).unwrap();
        }
        let found = find(root, "deep/images/a.png").unwrap();
        assert!(found.ends_with("deep/images_4/a.png"), "{found:?}");
        assert_eq!(find(root, "deep/a.png"), None);
        assert_eq!(find(root, "deep/images/b.png"), None);

        // 122 rows make 30.5; either whole number is a copy's.
        let full = Camera { height: 122, ..camera() };
        let small = fitted(full.clone(), &found).unwrap();
        assert_eq!((small.width, small.height), (40, 31));
        assert!((small.fx - full.fx / 4.0).abs() < 1e-12 && (small.cy - full.cy * 31.0 / 122.0).abs() < 1e-12);
        // A camera that is the copy's own stays, and so does one that belongs to another image.
        let own = Camera { width: 40, height: 31, ..camera() };
        assert_eq!(fitted(own.clone(), &found).unwrap(), own);
        let other = Camera { width: 320, ..camera() };
        assert_eq!(fitted(other.clone(), &found).unwrap(), other);
    }
}
