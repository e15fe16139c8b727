//! `region_mask` and `carry_mask`: bit masks of a region in the training view and in pseudo-views.
//!
//! Masks have the format of [`super::pack_mask`], from the first word. They serve as selected pixels of
//! [`crate::splat::blend_features`] and, with a `mask_offset` of 0, as masks of [`super::ImagePart`]. Every word of the
//! output is written, up to those of the largest view; bits after the last pixel are 0.
//!
//! The paper tracks a region through images with a network. Here the region's surface is known. A pixel of the
//! pseudo-view is unprojected by its blended depth (sum of weights times z over opacity) and projected into the
//! training view. It belongs to the region if it lands on a pixel of the region whose own depth agrees. Pixels without
//! depth (too transparent, not finite) belong to no region. Neither do pixels that land behind the training camera or
//! outside its image, are occluded there, or graze an edge. Masks from other sources can replace these.
//!
//! Results are deterministic: each pixel is computed independently. Cost: `region_mask` reads 2 bytes per pixel.
//! `carry_mask` reads depth and transmittance of each pixel of the pseudo-view (4 C + 4 bytes of memory traffic). For
//! pixels that land in the region it reads the same from the training view. It takes about 60 operations per pixel.
//! Both write one bit per pixel.

use crate::Tuning;
use crate::kernel::{groups, stage};
use crate::splat::{Blended, Channels, Screen, wanted_words};
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::{carry_mask as carry, region_mask as kernel};

/// View blended with depth.
#[derive(Clone, Copy, Debug)]
pub struct Seen {
    /// `Step` and largest size of the view.
    pub screen: Screen,
    /// Blended image and transmittance.
    pub blended: Blended,
    /// Blended channels.
    pub channels: Channels,
}

/// Thresholds for matching surfaces in two views.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CarryOptions {
    /// Smallest opacity of a pixel with a depth.
    pub least_opacity: f32,
    /// Largest difference of depths, relative to the training view's.
    pub tolerance: f32,
}

impl Default for CarryOptions {
    fn default() -> Self {
        CarryOptions { least_opacity: 0.5, tolerance: 0.03 }
    }
}

/// Packs region ids, two per word, the lower half first. Views follow each other by pixels; a view may begin in the
/// middle of a word.
pub fn pack_regions(ids: &[u16]) -> Vec<u32> {
    ids.chunks(2).map(|pair| u32::from(pair[0]) | u32::from(pair.get(1).copied().unwrap_or(0)) << 16).collect()
}

/// Adds the pass that marks the step's region in the training view. Pixel p belongs to the region if the id at
/// `region_offset` + p of `ids` ([`pack_regions`]) is the step's `region`, which is not 0. `into`: [`wanted_words`] of
/// the largest view.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn region_mask(
    g: &mut Graph,
    tuning: Tuning,
    screen: &Screen,
    ids: Buffer,
    into: Buffer,
) -> Result<(), GraphError> {
    let bindings = kernel::Bindings { params: screen.step.into(), ids: ids.into(), mask: into.into() };
    let specs = kernel::Specs { workgroup: tuning.workgroup };
    stage(g, "region_mask", &kernel::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch(groups(wanted_words(screen.pixels()), tuning.workgroup))
}

/// Adds the pass that transfers a region from the training view to a pseudo-view. `mask` holds the region from word
/// `mask_offset` of the training view's step. `into`: [`wanted_words`] of the largest pseudo-view. If either view lacks
/// depth, the result is empty.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
#[expect(clippy::too_many_arguments, reason = "declares a kernel")]
pub fn carry_mask(
    g: &mut Graph,
    tuning: Tuning,
    name: &str,
    trained: &Seen,
    mask: Buffer,
    pseudo: &Seen,
    options: CarryOptions,
    into: Buffer,
) -> Result<(), GraphError> {
    if !(trained.channels.depth && pseudo.channels.depth) {
        return g.fill(name, into, 0);
    }
    let bindings = carry::Bindings {
        params: pseudo.screen.step.into(),
        trained: trained.screen.step.into(),
        image: pseudo.blended.image.into(),
        transmittance: pseudo.blended.transmittance.into(),
        trained_image: trained.blended.image.into(),
        trained_transmittance: trained.blended.transmittance.into(),
        trained_mask: mask.into(),
        mask: into.into(),
    };
    // Depth and squared depth are the last channels.
    let [mine, theirs] = [pseudo, trained].map(|s| s.channels.count());
    let workgroup = tuning.workgroup.next_multiple_of(32);
    let specs = carry::Specs {
        workgroup,
        channels: mine,
        depth_at: mine - 2,
        trained_channels: theirs,
        trained_depth_at: theirs - 2,
        distorted: tuning.distorted,
    };
    let push = carry::Push { least_opacity: options.least_opacity, tolerance: options.tolerance };
    stage(g, name, &carry::KERNEL, bindings.entries(), specs.entries(), bytemuck::bytes_of(&push))
        .dispatch(groups(32 * wanted_words(pseudo.screen.pixels()), workgroup))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pack_regions_starts_at_lower_half() {
        assert_eq!(pack_regions(&[1, 0xffff, 3]), [0xffff_0001, 3]);
        assert!(pack_regions(&[]).is_empty());
    }
}
