//! `edge_aware`: edge-aware smoothness of albedo and roughness, with its gradients.
//!
//! Penalizes changes of albedo and roughness where the photograph is smooth. This is a term of SGS-Intrinsic's second
//! stage, in the form of the first stage's smoothness of normals. The absolute Sobel responses of an image (divided by
//! 8, border repeated) are multiplied by `exp(-|Sobel of the photograph|)` and summed over both directions. Albedo is
//! compared by channel; its loss is the mean over pixels and channels. Roughness uses the mean of the three factors.
//! A response contributes 0 if one of its nine pixels is invalid: alpha 0 in the photograph. The mean stays that over all
//! pixels of the view.
//!
//! Guarantees: adds gradients, which must have been written. Nothing after the view's pixels is changed. Results are
//! bit-identical between runs. Without roughness its term is compiled out.
//!
//! Cost per pixel with both: 28 bytes read (46 from caches, with the margins), 24 read and written; about 350
//! operations, 6 exponentials among them.

use super::MaterialImages;
use crate::Tuning;
use crate::kernel::{groups, stage};
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::edge_aware as kernel;

/// Images to smooth, and their guide.
#[derive(Clone, Copy, Debug)]
pub struct EdgeAware {
    /// Uniform `Step`: size of the view, offset of its photograph.
    pub step: Buffer,
    /// Uniform `MaterialWeights`.
    pub weights: Buffer,
    /// Images of materials. The first channel of roughness counts.
    pub images: MaterialImages,
    /// All photographs, packed RGBA8. A pixel with alpha 0 has no loss and no gradient.
    pub targets: Buffer,
    /// Upper bounds of the width and height of all views, in pixels.
    pub largest: [u32; 2],
}

/// Result for [`super::material_sum()`].
#[derive(Clone, Copy, Debug)]
pub struct EdgeSums {
    /// Smoothness losses of albedo and of roughness, summed by workgroup.
    pub sums: Buffer,
    /// Number of workgroups.
    pub count: u32,
}

/// Tiles of kernels that filter an image with margins of two pixels.
pub(super) struct Tiles {
    /// Invocations of a workgroup, which takes one tile.
    pub(super) workgroup: u32,
    /// Columns and rows. With both margins a tile is 32 columns wide.
    pub(super) size: [u32; 2],
    /// Rows of one invocation.
    pub(super) run: u32,
    /// Whether derivatives take the place of the values in shared memory: 15 KiB instead of 30.
    pub(super) reuse: bool,
}

impl Tiles {
    /// Returns the tiles for a device. On a GPU three runs of six rows occupy 96 invocations, each with one run. A CPU
    /// gains nothing from more invocations than lanes, nor from less shared memory.
    pub(super) fn new(tuning: Tuning) -> Tiles {
        if tuning.subgroup_size >= 16 {
            Tiles { workgroup: 96, size: [28, 14], run: 6, reuse: true }
        } else {
            Tiles { workgroup: 4 * tuning.subgroup_size, size: [28, 16], run: 18, reuse: false }
        }
    }

    /// Returns the number of tiles of an image.
    pub(super) fn count(&self, size: [u32; 2]) -> u32 {
        size[0].div_ceil(self.size[0]) * size[1].div_ceil(self.size[1])
    }
}

/// Adds the pass, which adds to `gradients`. A roughness image requires a roughness gradient.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn edge_aware(
    g: &mut Graph,
    tuning: Tuning,
    a: &EdgeAware,
    gradients: &MaterialImages,
) -> Result<EdgeSums, GraphError> {
    let tiles = Tiles::new(tuning);
    let count = tiles.count(a.largest);
    let sums = g.transient("edge_aware.sums", u64::from(count) * 8);
    let both = a.images.roughness.zip(gradients.roughness);
    // Absent inputs are bound to a buffer that the specialized kernel never reads.
    let (gray, by_gray) = match both {
        Some(both) => both,
        None => {
            let nothing = g.transient("edge_aware.no_roughness", 12);
            g.fill("edge_aware.none", nothing, 0)?;
            (a.images.albedo, nothing)
        }
    };
    let bindings = kernel::Bindings {
        params: a.step.into(),
        loss_weights: a.weights.into(),
        albedo_srgb: a.images.albedo.into(),
        roughness_gray: gray.into(),
        targets: a.targets.into(),
        albedo_gradient: gradients.albedo.into(),
        roughness_gradient: by_gray.into(),
        sums: sums.into(),
    };
    let Tiles { workgroup, size: [tile_x, tile_y], run, reuse } = tiles;
    let specs = kernel::Specs { workgroup, tile_x, tile_y, run, roughness: both.is_some(), reuse };
    stage(g, "edge_aware", &kernel::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch(groups(u64::from(count), 1))?;
    Ok(EdgeSums { sums, count })
}
