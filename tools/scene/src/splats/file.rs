//! Splats of a file with what the file says about them.

use super::Splats;
use crate::placement::Placement;

/// Splats of a file in the coordinates of the file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SplatFile {
    /// Splats as the file has them.
    pub splats: Splats,
    /// Transform from the scene to the file, if the file records one.
    pub transform: Option<Placement>,
    /// Descriptions of content that is not read or not rendered as the file requests.
    pub left_out: Vec<String>,
}
