//! `wanted_samples`: the pixels of a view at which losses of meaning look, a bit a pixel.
//!
//! They are those that samples of the view's target map are interpolated from ([`super::semantic_loss`]), and those of a
//! region ([`super::region`]). Features are blended there and nowhere else.
//!
//! Cost: 4 bytes and about 600 operations for 32 pixels.

use crate::Tuning;
use crate::kernel::{groups, stage};
use crate::splat::{Screen, wanted_words};
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::wanted_samples as kernel;

/// Adds the pass that writes `wanted` ([`wanted_words`] of the largest view). `mask`: bits of a region, from the step's
/// `mask_offset`; those past the last pixel must be down. Without one, `stand_in`, any buffer that was written, is bound.
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
        // Specialized kernels never touch what is absent.
        mask: mask.unwrap_or(stand_in).into(),
        pixel_mask: wanted.into(),
    };
    let specs = kernel::Specs { workgroup: tuning.workgroup, region: mask.is_some() };
    stage(g, "wanted_samples", &kernel::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch(groups(wanted_words(screen.pixels()), tuning.workgroup))
}
