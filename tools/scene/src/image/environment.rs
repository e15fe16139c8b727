//! Environment maps in files.
//!
//! Maps are equirectangular (latitude-longitude), in linear RGB, and twice as wide as high. The center of the map is in
//! direction -z, and up is +y. A quarter of the width to the right of the center is +x. Values are neither scaled nor
//! clamped, except that negative values become 0, because resampled files may have small negative values.

use std::path::Path;

use super::{Image, read_exr, write_exr};
use crate::error::{Result, SceneError};

/// Reads an environment map with three non-negative channels.
pub fn read_environment(path: &Path) -> Result<Image> {
    let file = read_exr(path)?;
    let (image, names) = (file.image, file.names);
    if image.width != 2 * image.height {
        let problem = format!(
            "an environment must be twice as wide as high, but this is {}×{}; save it as latitude and longitude",
            image.width, image.height
        );
        return Err(SceneError::image(path, problem));
    }
    if names.len() < 3 || names[..3] != ["R", "G", "B"] {
        return Err(SceneError::image(path, "an environment needs the channels R, G and B"));
    }
    if image.data.iter().any(|v| !v.is_finite()) {
        return Err(SceneError::image(path, "an environment must not hold numbers that are not finite"));
    }
    let channels = image.channels as usize;
    let data = image.data.chunks_exact(channels).flat_map(|p| &p[..3]).map(|v| v.max(0.0)).collect();
    Image::from_data(image.width, image.height, 3, data)
}

/// Writes an environment map with three channels.
pub fn write_environment(path: &Path, image: &Image) -> Result<()> {
    if image.width != 2 * image.height {
        let problem = format!("an environment is twice as wide as high, not {}×{}", image.width, image.height);
        return Err(SceneError::image(path, problem));
    }
    write_exr(path, image, &["R", "G", "B"])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn maps_round_trip_and_invalid_maps_are_rejected() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("environment.exr");
        let mut image = Image::from_data(8, 4, 3, (0..96).map(|i| i as f32 * 0.25).collect()).unwrap();
        write_environment(&path, &image).unwrap();
        assert_eq!(read_environment(&path).unwrap(), image);
        assert!(write_environment(&path, &Image::new(8, 8, 3)).is_err());

        let refused = |image: &Image, names: &[&str]| {
            write_exr(&path, image, names).unwrap();
            read_environment(&path).unwrap_err().to_string()
        };
        assert!(refused(&Image::new(9, 4, 3), &["R", "G", "B"]).contains("twice as wide"));
        assert!(refused(&Image::new(8, 4, 3), &["X", "Y", "Z"]).contains("R, G and B"));
        image.data[7] = f32::NAN;
        assert!(refused(&image, &["R", "G", "B"]).contains("not finite"));
        // A fourth channel is dropped, and negative values become 0.
        let mut four = Image::new(2, 1, 4);
        four.data[1] = -1e-3;
        four.data[4] = 2.0;
        write_exr(&path, &four, &["R", "G", "B", "A"]).unwrap();
        assert_eq!(read_environment(&path).unwrap().data, [0.0, 0.0, 0.0, 2.0, 0.0, 0.0]);
    }
}
