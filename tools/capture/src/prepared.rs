//! Images in the folder for COLMAP.

/// Quality of JPEG files that stand in for the original.
pub(crate) const QUALITY: u8 = 98;

/// Photograph or frame in the folder for COLMAP.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Prepared {
    /// Name of the original.
    pub(crate) file: String,
    /// File name for COLMAP and in the scene.
    pub(crate) name: String,
    /// Width and height in pixels.
    pub(crate) size: (u32, u32),
    /// Focal length in pixels by the EXIF data.
    pub(crate) focal: Option<f64>,
    /// Camera by the EXIF data; empty if unknown.
    pub(crate) camera: String,
}
