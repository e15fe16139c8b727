//! Record of a capture: `capture.json` in the scene.

use serde::Serialize;

/// Result of a capture; the contents of `capture.json`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Captured {
    /// Name and version of the format.
    pub format: &'static str,
    /// Name of the folder or video.
    pub source: String,
    /// Number of photographs or chosen frames.
    pub photographs: usize,
    /// Number of photographs with a camera.
    pub registered: usize,
    /// Photographs that the scene lacks, and why.
    pub unregistered: Vec<Unregistered>,
    /// Number of points.
    pub points: usize,
    /// Pairs of images that were matched: "exhaustive" or "sequential".
    pub matcher: &'static str,
    /// Version of COLMAP, as it prints it.
    pub colmap: String,
    /// Duration in seconds.
    pub seconds: f64,
}

/// Photograph without a camera.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Unregistered {
    /// Name of the file, or of the frame.
    pub file: String,
    /// Why the scene lacks it.
    pub reason: String,
}
