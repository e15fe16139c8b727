//! Masks of valid pixels in a folder beside the images.
//!
//! nerfstudio and users name a mask after the stem of its image, COLMAP after its whole name: `masks/NAME.png` or
//! `masks/NAME.jpg.png` for `images/NAME.jpg`. Folders below `images` repeat below `masks`.

use std::path::{Path, PathBuf};

use super::Frame;

/// Adds the masks beside the images of frames that have none.
pub(super) fn add(root: &Path, frames: &mut [Frame]) {
    for frame in frames.iter_mut().filter(|frame| frame.beside.mask.is_none()) {
        frame.beside.mask = candidates(root, &frame.image).into_iter().find(|path| path.is_file());
    }
}

/// Returns the possible paths of an image's mask, in search order.
fn candidates(root: &Path, image: &Path) -> Vec<PathBuf> {
    let inside = image.strip_prefix(root).unwrap_or(image);
    let is_images =
        |part: &Path| part.file_name().is_some_and(|n| n == "images" || n.to_string_lossy().starts_with("images_"));
    // The innermost folder of images; without one, the scene directory stands in for it.
    let folder = inside.ancestors().skip(1).find(|part| is_images(part));
    let base = folder.and_then(Path::parent).map_or_else(|| root.to_owned(), |parent| root.join(parent));
    let name = folder.and_then(|folder| inside.strip_prefix(folder).ok()).unwrap_or(inside);
    let whole = |name: &Path| {
        let mut name = name.as_os_str().to_owned();
        name.push(".png");
        PathBuf::from(name)
    };
    let flat = Path::new(name.file_name().unwrap_or_default());
    let names = [whole(name), name.with_extension("png"), whole(flat), flat.with_extension("png")];
    names.iter().map(|name| base.join("masks").join(name)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn masks_are_searched_beside_the_folder_of_images() {
        let of = |image: &str| -> Vec<String> {
            let all = candidates(Path::new("/s"), &Path::new("/s").join(image));
            all.iter().map(|path| path.strip_prefix("/s").unwrap().display().to_string()).collect()
        };
        assert_eq!(of("images/a.5.jpg")[..2], ["masks/a.5.jpg.png", "masks/a.5.png"]);
        let deep = ["masks/left/a.JPG.png", "masks/left/a.png", "masks/a.JPG.png", "masks/a.png"];
        assert_eq!(of("images_4/left/a.JPG"), deep);
        assert_eq!(of("train/a.png")[1], "masks/train/a.png");
        assert_eq!(of("part/images/a.png")[1], "part/masks/a.png");
    }
}
