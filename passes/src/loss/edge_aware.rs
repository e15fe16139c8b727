//! `edge_aware`: albedo and roughness should be smooth where the photograph is, with what that adds to their gradients.
//!
//! SGS-Intrinsic's second stage, in the form of the first one's smoothness of normals: Sobel filters (over 8, border
//! repeated) of a picture, absolute, times `exp(-|Sobel of the photograph|)`, summed over the two directions. Albedo is
//! compared channel by channel and is a mean over pixels and channels; roughness takes the mean of the three factors. All
//! pixels of the view count.
//!
//! Promises: gradients are added to (they must have been written), nothing behind the view's pixels is touched, the same bits
//! from run to run. Without roughness its part is compiled out.
//!
//! Cost a pixel with both: 28 bytes read (46 from the caches with the margins), 24 read and written; about 350 operations,
//! 6 exponentials among them.

use super::MaterialPictures;
use crate::Tuning;
use crate::kernel::{groups, stage};
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::edge_aware as kernel;

/// What should be smooth, and guided by what.
#[derive(Clone, Copy, Debug)]
pub struct EdgeAware {
    /// Uniform `Step`: size of the view, offset of its photograph.
    pub step: Buffer,
    /// Uniform `MaterialWeights`.
    pub weights: Buffer,
    /// The pictures; of roughness the first channel counts.
    pub pictures: MaterialPictures,
    /// All photographs, packed RGBA8.
    pub targets: Buffer,
    /// Columns and rows that no view exceeds, each for itself.
    pub largest: [u32; 2],
}

/// What is left for [`super::material_sum()`].
#[derive(Clone, Copy, Debug)]
pub struct EdgeSums {
    /// Smoothness of albedo and of roughness, summed by workgroup.
    pub sums: Buffer,
    /// Number of workgroups.
    pub count: u32,
}

/// Columns and rows of a tile: with its margins of 2 it is 32 columns wide, and its shared memory takes 30 KiB.
pub(super) const TILE: [u32; 2] = [28, 16];

/// Workgroup and rows of one invocation. On a GPU three runs of six rows keep 96 invocations busy; a CPU has no use for more
/// than its lanes.
pub(super) fn shape(tuning: Tuning) -> (u32, u32) {
    ((4 * tuning.subgroup_size).min(96), if tuning.subgroup_size >= 32 { 6 } else { TILE[1] + 2 })
}

/// Adds the pass, which adds to `gradients`; those of roughness are there if the picture is.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn edge_aware(
    g: &mut Graph,
    tuning: Tuning,
    a: &EdgeAware,
    gradients: &MaterialPictures,
) -> Result<EdgeSums, GraphError> {
    let count = a.largest[0].div_ceil(TILE[0]) * a.largest[1].div_ceil(TILE[1]);
    let sums = g.transient("edge_aware.sums", u64::from(count) * 8);
    let both = a.pictures.roughness.zip(gradients.roughness);
    // What is absent is bound to something that the specialized kernel never touches.
    let (gray, by_gray) = match both {
        Some(both) => both,
        None => {
            let nothing = g.transient("edge_aware.no_roughness", 12);
            g.fill("edge_aware.none", nothing, 0)?;
            (a.pictures.albedo, nothing)
        }
    };
    let bindings = kernel::Bindings {
        params: a.step.into(),
        loss_weights: a.weights.into(),
        albedo_srgb: a.pictures.albedo.into(),
        roughness_gray: gray.into(),
        targets: a.targets.into(),
        albedo_gradient: gradients.albedo.into(),
        roughness_gradient: by_gray.into(),
        sums: sums.into(),
    };
    let (workgroup, run) = shape(tuning);
    let specs = kernel::Specs { workgroup, tile_x: TILE[0], tile_y: TILE[1], run, roughness: both.is_some() };
    stage(g, "edge_aware", &kernel::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch(groups(u64::from(count), 1))?;
    Ok(EdgeSums { sums, count })
}
