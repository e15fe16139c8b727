//! `transport_rays`: receivers that cosine-distributed rays of each receiver meet.
//!
//! Directions are a Hammersley set, shifted for each receiver by a hash of its number and the seed. Results are
//! bit-identical from run to run and do not depend on the tree.
//!
//! Cost: 4 bytes written per ray; 80 bytes and about 200 operations per visited node, 32 bytes and 25 operations per
//! tested disc.

use super::{Enclosure, SurfelHandles};
use crate::Tuning;
use crate::kernel::{groups, stage};
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::transport_rays as kernel;

/// Inputs of [`transport_rays`].
#[derive(Clone, Copy, Debug)]
pub struct TransportRays {
    /// Tree of the surfels.
    pub tree: SurfelHandles,
    /// Surfels, then patches, 8 floats each: [`super::receivers`].
    pub receivers: Buffer,
    /// Box that closes the scene.
    pub enclosure: Enclosure,
    /// Number of surfels.
    pub surfels: u32,
    /// Number of rays of a receiver.
    pub rays: u32,
    /// Seed of the directions.
    pub seed: u32,
    /// Distance above the receiver at which rays begin.
    pub offset: f32,
}

impl TransportRays {
    /// Returns the number of receivers: surfels and patches.
    pub fn count(&self) -> u32 {
        self.surfels + self.enclosure.patch_count()
    }

    /// Returns the bytes of the targets.
    pub fn target_bytes(&self) -> u64 {
        4 * u64::from(self.count()) * u64::from(self.rays)
    }
}

/// Traces all rays. `targets` receives the receiver that each meets, `[receivers * rays]` words.
///
/// Receivers with values that are not finite, or without a normal, have no rays; their targets are `0xffffffff`.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn transport_rays(g: &mut Graph, t: &Tuning, a: &TransportRays, targets: Buffer) -> Result<(), GraphError> {
    let bindings = kernel::Bindings {
        surfel_nodes: a.tree.nodes.into(),
        surfel_discs: a.tree.discs.into(),
        receivers: a.receivers.into(),
        targets: targets.into(),
    };
    let workgroup = t.workgroup.min(64);
    let push = kernel::Push {
        enclosure: a.enclosure.shape(),
        receivers: a.count(),
        surfels: a.surfels,
        rays: a.rays,
        seed: a.seed,
        offset: a.offset,
    };
    let specs = kernel::Specs { workgroup };
    stage(g, "transport_rays", &kernel::KERNEL, bindings.entries(), specs.entries(), bytemuck::bytes_of(&push))
        .dispatch(groups(u64::from(push.receivers) * u64::from(a.rays), workgroup))
}
