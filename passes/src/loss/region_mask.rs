//! `region_mask` and `carry_mask`: where a region is in the training view, and where the same surface is in a pseudo-view.
//!
//! Masks are bits as [`super::pack_mask`] makes them, from the first word, so they serve as `wanted` of
//! [`crate::splat::blend_features`] and, with a `mask_offset` of 0, as masks of [`super::Pictured`]. Every word of the
//! output is written up to those of the largest view; bits past the last pixel are 0.
//!
//! The paper tracks a region through pictures with a network. Here its surface is known: a pixel of the pseudo-view goes
//! through its blended depth (sum of weights times z over opacity) into the world and into the training view, and belongs
//! if it arrives at a pixel of the region whose own depth agrees. A pixel without depth (too transparent, not finite),
//! behind the training camera, beside its image, hidden there or grazing an edge is in no region. Masks from elsewhere can
//! take the place of these.
//!
//! Deterministic: every pixel asks for itself. Cost: `region_mask` reads 2 bytes a pixel; `carry_mask` reads the depth and
//! transmittance of each pixel of the pseudo-view (4 C + 4 bytes as memory goes) and the same again at the training
//! view's for pixels that arrive in the region, about 60 operations a pixel. Both write a bit a pixel.

use crate::Tuning;
use crate::kernel::{groups, stage};
use crate::splat::{Blended, Channels, Screen, wanted_words};
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::{carry_mask as carry, region_mask as kernel};

/// A view that was blended with depth.
#[derive(Clone, Copy, Debug)]
pub struct Seen {
    /// Its `Step`, and how large it can be.
    pub screen: Screen,
    /// What was blended.
    pub blended: Blended,
    /// Of which channels.
    pub channels: Channels,
}

/// When two views show the same surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CarryOptions {
    /// Pixels that are less opaque have no depth.
    pub least_opacity: f32,
    /// How far depths may be apart, as a share of the training view's.
    pub tolerance: f32,
}

impl Default for CarryOptions {
    fn default() -> Self {
        CarryOptions { least_opacity: 0.5, tolerance: 0.03 }
    }
}

/// Region ids as words: two a word, the lower half first. Views lie one behind the other by pixels, as their photographs do,
/// not by words.
pub fn pack_regions(ids: &[u16]) -> Vec<u32> {
    ids.chunks(2).map(|pair| u32::from(pair[0]) | u32::from(pair.get(1).copied().unwrap_or(0)) << 16).collect()
}

/// Adds the pass that finds the step's region in the training view: pixel p is in it if the id at `target_offset` + p of
/// `ids` ([`pack_regions`]) is the step's `region`, which is not 0. `into`: [`wanted_words`] of the largest view.
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

/// Adds the pass that carries a region from the training view, where `mask` has it from word `mask_offset` of its step, to
/// a pseudo-view. `into`: [`wanted_words`] of the largest pseudo-view. Without depth in both, nothing is carried.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
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
    // Depth and its square come last.
    let [mine, theirs] = [pseudo, trained].map(|s| s.channels.count());
    let workgroup = tuning.workgroup.next_multiple_of(32);
    let specs = carry::Specs {
        workgroup,
        channels: mine,
        depth_at: mine - 2,
        trained_channels: theirs,
        trained_depth_at: theirs - 2,
    };
    let push = carry::Push { least_opacity: options.least_opacity, tolerance: options.tolerance };
    stage(g, name, &carry::KERNEL, bindings.entries(), specs.entries(), bytemuck::bytes_of(&push))
        .dispatch(groups(32 * wanted_words(pseudo.screen.pixels()), workgroup))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_are_pairs_from_the_lower_half() {
        assert_eq!(pack_regions(&[1, 0xffff, 3]), [0xffff_0001, 3]);
        assert!(pack_regions(&[]).is_empty());
    }
}
