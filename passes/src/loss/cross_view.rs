//! `cross_view`: a region should have the same albedo in the training view and in pseudo-views.
//!
//! SGS-Intrinsic's second stage, the part that acts on materials: the distance of the mean albedo (sRGB) of a region in a
//! pseudo-view and in the training view, summed over the pseudo-views, times `cross_view`. Where a region, or the training
//! view's, has fewer than 16 pixels, a pseudo-view counts as 0. A distance of 0 has no gradient.
//!
//! Regions are masks of bits as [`super::region_mask()`] and [`super::carry_mask`] make them. Promises: gradients are added
//! to, at the pixels of the masks alone (they must have been written); the same bits from run to run.
//!
//! Cost: a bit a pixel and 12 bytes a pixel of the region; backward a bit a pixel, and 24 bytes a pixel of the region.

use crate::Tuning;
use crate::kernel::{groups, stage};
use crate::splat::wanted_words;
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::structs::CrossRegion;
use sgs_shaders::{cross_sums, cross_view as kernel, cross_view_bwd as backward};

/// A picture of albedo, and where the region is in it.
#[derive(Clone, Copy, Debug)]
pub struct CrossPicture {
    /// Uniform `Step` of this picture: its size, `mask_offset`.
    pub step: Buffer,
    /// `[P * 3]` floats: albedo in sRGB.
    pub albedo: Buffer,
    /// A bit a pixel ([`super::pack_mask`]), from word `mask_offset`.
    pub mask: Buffer,
    /// `[P * 3]` floats, added to.
    pub albedo_gradient: Buffer,
    /// Columns and rows that no view exceeds, each for itself.
    pub largest: [u32; 2],
}

/// What is left for [`super::material_sum()`].
#[derive(Clone, Copy, Debug)]
pub struct CrossView {
    /// `CrossRegion` of each picture.
    pub regions: Buffer,
    /// How many pictures.
    pub pictures: u32,
}

impl CrossPicture {
    fn pixels(&self) -> u64 {
        u64::from(self.largest[0]) * u64::from(self.largest[1])
    }
}

/// Adds the passes. `weights`: uniform `MaterialWeights`; `pictures`: the training view's, then the pseudo-views'.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn cross_view(
    g: &mut Graph,
    tuning: Tuning,
    weights: Buffer,
    pictures: &[CrossPicture],
) -> Result<CrossView, GraphError> {
    let workgroup = tuning.workgroup;
    let words = pictures.iter().map(|p| wanted_words(p.pixels())).max().unwrap_or(1);
    let count = words.div_ceil(u64::from(workgroup)).max(1) as u32;
    // Each picture's sums are bound on their own, which asks for some alignment.
    let pitch = count.next_multiple_of(16);
    let bytes = 16 * u64::from(pitch);
    let number = pictures.len().max(1) as u64;
    let sums = g.transient("cross_view.sums", bytes * number);
    for (k, p) in pictures.iter().enumerate() {
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
    let specs = kernel::Specs { workgroup, views: pictures.len() as u32 };
    let push = kernel::Push { count, pitch };
    stage(g, "cross_view", &kernel::KERNEL, bindings.entries(), specs.entries(), bytemuck::bytes_of(&push))
        .dispatch([1, 1, 1])?;
    for (k, p) in pictures.iter().enumerate() {
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
    Ok(CrossView { regions, pictures: pictures.len() as u32 })
}
