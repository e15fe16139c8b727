//! `cross_view`: consistency of a region's albedo between the training view and pseudo-views.
//!
//! Term of SGS-Intrinsic's second stage that acts on materials. The loss is the distance of the region's mean albedo
//! (sRGB) in a pseudo-view from that in the training view, summed over the pseudo-views, times `cross_view`. A
//! pseudo-view contributes 0 if its region, or the training view's, has fewer than 16 pixels. A distance of 0 has no
//! gradient.
//!
//! Regions are bit masks from [`super::region_mask()`] and [`super::carry_mask`]. Guarantees: adds gradients at the
//! pixels of the masks only, which must have been written. Results are bit-identical between runs.
//!
//! Cost: one bit per pixel and 12 bytes per pixel of the region; backward one bit per pixel and 24 bytes per pixel of
//! the region.

use crate::Tuning;
use crate::kernel::{groups, stage};
use crate::splat::wanted_words;
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::structs::CrossRegion;
use sgs_shaders::{cross_sums, cross_view as kernel, cross_view_bwd as backward};

/// Albedo image with the mask of a region.
#[derive(Clone, Copy, Debug)]
pub struct CrossViewImage {
    /// Uniform `Step` of this image: its size, `mask_offset`.
    pub step: Buffer,
    /// `[P * 3]` floats: albedo in sRGB.
    pub albedo: Buffer,
    /// One bit per pixel ([`super::pack_mask`]), from word `mask_offset`.
    pub mask: Buffer,
    /// `[P * 3]` floats; the passes add to them.
    pub albedo_gradient: Buffer,
    /// Upper bounds of the width and height of all views, in pixels.
    pub largest: [u32; 2],
}

/// Result for [`super::material_sum()`].
#[derive(Clone, Copy, Debug)]
pub struct CrossView {
    /// `CrossRegion` of each image.
    pub regions: Buffer,
    /// Number of images.
    pub images: u32,
}

impl CrossViewImage {
    fn pixels(&self) -> u64 {
        u64::from(self.largest[0]) * u64::from(self.largest[1])
    }
}

/// Adds the passes of the loss and its gradients. `weights`: uniform `MaterialWeights`. `images`: the training view's
/// image, then those of the pseudo-views.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn cross_view(
    g: &mut Graph,
    tuning: Tuning,
    weights: Buffer,
    images: &[CrossViewImage],
) -> Result<CrossView, GraphError> {
    let workgroup = tuning.workgroup;
    let words = images.iter().map(|p| wanted_words(p.pixels())).max().unwrap_or(1);
    let count = words.div_ceil(u64::from(workgroup)).max(1) as u32;
    // Sums of each image have their own binding, which requires alignment.
    let pitch = count.next_multiple_of(16);
    let bytes = 16 * u64::from(pitch);
    let number = images.len().max(1) as u64;
    let sums = g.transient("cross_view.sums", bytes * number);
    for (k, p) in images.iter().enumerate() {
        let bindings = cross_sums::Bindings {
            params: p.step.into(),
            albedo_srgb: p.albedo.into(),
            mask: p.mask.into(),
            sums: sums.slice(k as u64 * bytes, 16 * u64::from(count)),
        };
        let specs = cross_sums::Specs { workgroup };
        stage(g, &format!("cross_view{k}.sums"), &cross_sums::KERNEL, bindings.entries(), specs.entries(), &[])
            .dispatch(groups(u64::from(count), 1))?;
    }
    let regions = g.transient("cross_view.regions", size_of::<CrossRegion>() as u64 * number);
    let bindings = kernel::Bindings { loss_weights: weights.into(), sums: sums.into(), regions: regions.into() };
    let specs = kernel::Specs { workgroup, views: images.len() as u32 };
    let push = kernel::Push { count, pitch };
    stage(g, "cross_view", &kernel::KERNEL, bindings.entries(), specs.entries(), bytemuck::bytes_of(&push))
        .dispatch([1, 1, 1])?;
    for (k, p) in images.iter().enumerate() {
        let bindings = backward::Bindings {
            params: p.step.into(),
            mask: p.mask.into(),
            regions: regions.into(),
            albedo_gradient: p.albedo_gradient.into(),
        };
        let specs = backward::Specs { workgroup };
        let push = backward::Push { view: k as u32 };
        let push = bytemuck::bytes_of(&push);
        stage(g, &format!("cross_view{k}.bwd"), &backward::KERNEL, bindings.entries(), specs.entries(), push)
            .dispatch(groups(p.pixels(), workgroup))?;
    }
    Ok(CrossView { regions, images: images.len() as u32 })
}
