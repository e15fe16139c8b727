//! `wanted_samples`: bit mask of the pixels whose features the semantic losses read.
//!
//! These are the pixels that samples of the view's target map are interpolated from ([`super::semantic_loss`]), and
//! those of a region ([`super::region`]). Features are blended at these pixels only.
//!
//! Cost: 4 bytes and about 600 operations per 32 pixels.

use crate::Tuning;
use crate::kernel::{groups, stage};
use crate::splat::{Screen, wanted_words};
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::wanted_samples as kernel;

/// Adds the pass that writes `wanted` ([`wanted_words`] of the largest view). `mask`: bits of a region, from the step's
/// `mask_offset`; bits after the last pixel must be 0. Without a mask, `stand_in` is bound, any buffer that was
/// written.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn wanted_samples(
    g: &mut Graph,
    tuning: Tuning,
    screen: &Screen,
    mask: Option<Buffer>,
    stand_in: Buffer,
    wanted: Buffer,
) -> Result<(), GraphError> {
    let bindings = kernel::Bindings {
        params: screen.step.into(),
        // Absent inputs are bound to a buffer that specialized kernels never read.
        mask: mask.unwrap_or(stand_in).into(),
        pixel_mask: wanted.into(),
    };
    let specs = kernel::Specs { workgroup: tuning.workgroup, region: mask.is_some() };
    stage(g, "wanted_samples", &kernel::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch(groups(wanted_words(screen.pixels()), tuning.workgroup))
}
