//! Splatting: project, sort into tiles, blend, and the way back.
//!
//! Promises: nothing is read back; whatever depends on the scene's content is counted on the GPU and drives indirect
//! dispatches; an overflow of the tile entries raises a flag and empties the rest of the step. Results are
//! bit-identical from run to run, but for those of [`BackwardKernel::Atomic`], the only kernel that adds floats atomically.

mod blend;
mod extra;
mod features;
mod intersect;
mod present;
mod project;
mod show;

pub(crate) use blend::per_lane;
pub use blend::{BackwardKernel, Blended, PixelGradients, Statistic, blend, blend_bwd, blend_debt, statistic_debt};
pub use extra::{ExtraGradients, project_bwd_features};
pub use features::{
    EntryFeatures, FeatureAdam, Wanted, blend_features, blend_features_bwd, features_bwd, features_bwd_adam,
    features_pack, wanted_words,
};
pub use intersect::{Entries, intersect};
pub use present::{Encoding, Layer, Present, Presented, TexelFormat, present, present_light};
pub(crate) use project::group_sizes;
pub use project::{EntryGradients, FusedAdam, Gradients, Visible, project, project_bwd, project_bwd_adam};
pub use show::{Letters, MARK_HOLLOW, MARK_RINGED, Mark, Show, ShowStep, ShownKind, show};

use sgs_engine::graph::Buffer;

/// The image side of a view: where its `Step` uniform is, how large it can be, how it is cut into tiles.
#[derive(Clone, Copy, Debug)]
pub struct Screen {
    /// Uniform `Step`.
    pub step: Buffer,
    /// Columns and rows that no view exceeds.
    pub largest: [u32; 2],
    /// Pixels of a tile.
    pub tile: [u32; 2],
}

impl Screen {
    /// Tiles that no view exceeds.
    pub fn tiles(&self) -> u32 {
        self.largest[0].div_ceil(self.tile[0]) * self.largest[1].div_ceil(self.tile[1])
    }

    /// Pixels that no view exceeds.
    pub fn pixels(&self) -> u64 {
        u64::from(self.largest[0]) * u64::from(self.largest[1])
    }
}

/// What is blended at every pixel: rgb, then the normal (3) and depth (z, z²), each if wanted. Backward passes need rgb.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Channels {
    /// Display-referred rgb over the background: spherical harmonics are evaluated.
    pub colors: bool,
    /// World-space unit normals.
    pub normals: bool,
    /// z and z².
    pub depth: bool,
}

/// Colors alone.
impl Default for Channels {
    fn default() -> Channels {
        Channels { colors: true, normals: false, depth: false }
    }
}

impl Channels {
    /// Floats of a pixel.
    pub fn count(&self) -> u32 {
        3 * u32::from(self.colors) + 3 * u32::from(self.normals) + 2 * u32::from(self.depth)
    }
}
