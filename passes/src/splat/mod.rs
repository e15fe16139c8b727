//! Splatting: projection, tile sort, blending, and their backward passes.
//!
//! Guarantees: nothing is read back. Quantities that depend on the scene's content are counted on the GPU and drive
//! indirect dispatches. An overflow of the tile entries sets a flag and empties the rest of the step. Results are
//! bit-identical between runs, except those of [`BackwardKernel::Atomic`], the only kernel that adds floats atomically.

mod blend;
mod buckets;
mod extra;
mod features;
mod intersect;
mod parts;
mod present;
mod project;
mod show;

pub(crate) use blend::per_lane;
pub use blend::{
    BackwardKernel, Blended, PixelGradients, Statistic, blend, blend_bwd, blend_debt, blend_for, statistic_debt,
};
pub use buckets::{Buckets, blend_buckets};
pub use extra::{ExtraGradients, project_bwd_features};
pub use features::{
    EntryFeatures, FeatureAdam, Wanted, blend_features, blend_features_bwd, features_bwd, features_bwd_adam,
    wanted_words,
};
pub use intersect::{Entries, intersect};
pub use present::{Encoding, Layer, Present, Presented, TexelFormat, present, present_light};
pub use project::{EntryGradients, FusedAdam, Gradients, Visible, project, project_bwd, project_bwd_adam};
pub(crate) use project::{backward_specs, group_sizes};
pub use show::{Letters, MARK_HOLLOW, MARK_RINGED, Mark, Show, ShowStep, ShownKind, show};

use sgs_engine::graph::Buffer;

/// Image side of a view: its `Step` uniform, largest size and tile size.
#[derive(Clone, Copy, Debug)]
pub struct Screen {
    /// Uniform `Step`.
    pub step: Buffer,
    /// Largest width and height of a view.
    pub largest: [u32; 2],
    /// Columns and rows of a tile, in pixels.
    pub tile: [u32; 2],
}

impl Screen {
    /// Returns the number of tiles of the largest view.
    pub fn tiles(&self) -> u32 {
        self.largest[0].div_ceil(self.tile[0]) * self.largest[1].div_ceil(self.tile[1])
    }

    /// Returns the number of pixels of the largest view.
    pub fn pixels(&self) -> u64 {
        u64::from(self.largest[0]) * u64::from(self.largest[1])
    }
}

/// Blended channels, in order: rgb, normal (3), depth (z, z²). Each is optional. Backward passes need rgb.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Channels {
    /// Display-referred rgb over the background, from spherical harmonics.
    pub colors: bool,
    /// Unit normals in world space.
    pub normals: bool,
    /// z and z² in camera space.
    pub depth: bool,
}

/// Selects colors only.
impl Default for Channels {
    fn default() -> Channels {
        Channels { colors: true, normals: false, depth: false }
    }
}

impl Channels {
    /// Returns the number of floats per pixel.
    pub fn count(&self) -> u32 {
        3 * u32::from(self.colors) + 3 * u32::from(self.normals) + 2 * u32::from(self.depth)
    }
}
