//! Downscaled copies of images: `images_2`, `images_4` and `images_8`. They are beside `images` or replace it.
//! MipNeRF-360 and DL3DV ship them with cameras that were calibrated for the full size.

use std::path::{Path, PathBuf};

use super::frame::find_image;
use crate::camera::Camera;
use crate::error::Result;
use crate::image::read_size;

/// Downscaling factors, in search order.
const FACTORS: [u32; 3] = [2, 4, 8];

/// Finds the downscaled copy of an image in the folder `images` below `root`.
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

/// Scales a camera to its image if the image is a downscaled copy. The image must be in a folder of copies, and its
/// size must match the camera's size divided by the factor, within one pixel. Otherwise the camera is unchanged.
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
    fn copies_are_found_and_their_cameras_scaled() {
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

        // 122 rows / 4 = 30.5; copies may round either way.
        let full = Camera { height: 122, ..camera() };
        let small = fitted(full.clone(), &found).unwrap();
        assert_eq!((small.width, small.height), (40, 31));
        assert!((small.fx - full.fx / 4.0).abs() < 1e-12 && (small.cy - full.cy * 31.0 / 122.0).abs() < 1e-12);
        // A camera that already has the copy's size is unchanged, and so is a camera of another image.
        let own = Camera { width: 40, height: 31, ..camera() };
        assert_eq!(fitted(own.clone(), &found).unwrap(), own);
        let other = Camera { width: 320, ..camera() };
        assert_eq!(fitted(other.clone(), &found).unwrap(), other);
    }
}
