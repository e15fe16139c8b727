//! Files that a layout stores beside its photographs: masks and ground truth.
//!
//! Readers only list these files; they are read on request. The mask belongs to the photograph. Ground truth is
//! reachable only through [`GroundTruth`](crate::GroundTruth), so training code cannot read it by accident.

use std::path::{Path, PathBuf};

use crate::error::{Result, SceneError};
use crate::map_file::NormalFrame;

/// Files stored beside one photograph.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Beside {
    /// Whether the layout assigns the view to the test set; `None` if the layout does not say.
    pub(crate) test: Option<bool>,
    /// Mask of valid pixels of the photograph; values above one half are valid.
    pub(crate) mask: Option<PathBuf>,
    /// Whether the mask marks invalid pixels instead.
    pub(crate) inverted: bool,
    /// Depth that a sensor measured.
    pub(crate) depth: Option<SensorDepth>,
    /// Ground-truth maps, at most one of each kind.
    pub(crate) truth: Vec<TruthFile>,
    /// Images of the same view under other lightings: name and path.
    pub(crate) relit: Vec<(String, PathBuf)>,
}

/// Depth map that a sensor measured with a photograph.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct SensorDepth {
    /// Map over the field of the photograph, distortion included: EXR, NPY, or gray PNG of 8 or 16 bits, in which 0 and
    /// 65535 are unknown.
    pub(crate) path: PathBuf,
    /// Camera z of the value 1, in units of the scene; the sensor's are meters.
    pub(crate) unit: f64,
}

/// Kinds of ground-truth maps.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum GroundTruthKind {
    /// Linear RGB.
    Albedo,
    /// Unit vectors in world space, zero where the pixel shows no surface.
    Normal,
    /// Camera z in scene units, 0 where the pixel shows no surface.
    Depth,
    /// Roughness in one channel.
    Roughness,
    /// Metallic in one channel.
    Metallic,
    /// Fraction of the pixel in which the other maps are valid, in one channel.
    Mask,
}

impl GroundTruthKind {
    /// All kinds.
    pub const ALL: [Self; 6] = [Self::Albedo, Self::Normal, Self::Depth, Self::Roughness, Self::Metallic, Self::Mask];

    /// Returns the name of the folder under `gt/`.
    pub fn folder(self) -> &'static str {
        match self {
            Self::Albedo => "albedo",
            Self::Normal => "normal",
            Self::Depth => "depth",
            Self::Roughness => "roughness",
            Self::Metallic => "metallic",
            Self::Mask => "mask",
        }
    }
}

/// Ground-truth map of one view.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct TruthFile {
    /// Quantity that the map shows.
    pub(crate) kind: GroundTruthKind,
    /// Path of the file.
    pub(crate) path: PathBuf,
    /// Encoding of the quantity in the file.
    pub(crate) form: Form,
}

/// Encoding of a map in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Form {
    /// Linear color, in files of any format.
    LinearColor,
    /// Normals in the given frame.
    Normal(NormalFrame),
    /// Depth whose definition is detected later.
    Depth,
    /// Single channel with this index.
    Channel(u32),
    /// Alpha channel.
    Alpha,
}

impl Beside {
    /// Adds a map if its file exists and no map of its kind is listed.
    pub(crate) fn add(&mut self, kind: GroundTruthKind, path: PathBuf, form: Form) {
        if path.is_file() && self.truth.iter().all(|file| file.kind != kind) {
            self.truth.push(TruthFile { kind, path, form });
        }
    }
}

/// Returns an error if a map does not have the size of its photograph.
pub(crate) fn check_size(path: &Path, size: (u32, u32), image: &Path, expected: (u32, u32)) -> Result<()> {
    if size == expected {
        return Ok(());
    }
    let problem = format!(
        "the map is {}×{} pixels, but its image {} is {}×{}; both must have the same size",
        size.0,
        size.1,
        image.display(),
        expected.0,
        expected.1
    );
    Err(SceneError::image(path, problem))
}
