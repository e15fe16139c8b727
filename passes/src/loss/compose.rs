//! `compose`, `compose_bwd`: composition of light over a background, and its backward pass.
//!
//! The result is the image that the photometric loss compares with photographs. Direct and ambient light are linear and
//! added. The sum is multiplied by the coverage and composed over the background, which the step holds display-referred
//! and the kernel decodes. The result is encoded in sRGB (IEC 61966-2-1) and clipped at black and white. Clipped values
//! have no gradient, so a light that is too bright everywhere stays too bright. The kernel counts the
//! pixels clipped at white.
//!
//! Guarantees: every pixel of the view is written, nothing after them is changed. Pixels with a coverage below 1e-3
//! show the background and get no gradient. Non-finite light is black and gets no gradient. Counts are exact below
//! 2^24.
//!
//! Cost per pixel: 28 bytes read, 12 written; backward 40 and 12. 3 powers each, 3 more for the background.

use crate::Tuning;
use crate::kernel::{groups, stage};
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::{compose as forward, compose_bwd as backward};

/// Inputs of the composition.
#[derive(Clone, Copy, Debug)]
pub struct Compose {
    /// Uniform `Step`: size of the view, background.
    pub step: Buffer,
    /// `[P * 3]` floats: direct light of light sources, linear, if any.
    pub direct: Option<Buffer>,
    /// `[P * 3]` floats: ambient light of the environment map, linear, if any.
    pub ambient: Option<Buffer>,
    /// `[P]` floats: blended opacity.
    pub coverage: Buffer,
    /// Upper bounds of the width and height of all views, in pixels.
    pub largest: [u32; 2],
}

/// Counts of pixels clipped at white.
#[derive(Clone, Copy, Debug)]
pub struct Saturated {
    /// Count by workgroup, as floats.
    pub sums: Buffer,
    /// Number of workgroups.
    pub count: u32,
}

impl Compose {
    fn pixels(&self) -> u64 {
        u64::from(self.largest[0]) * u64::from(self.largest[1])
    }
}

/// Adds the pass that writes `image` (`[P * 3]` floats, sRGB).
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn compose(g: &mut Graph, tuning: Tuning, a: &Compose, image: Buffer) -> Result<Saturated, GraphError> {
    let count = a.pixels().div_ceil(u64::from(tuning.workgroup)).max(1) as u32;
    let sums = g.transient("compose.sums", 4 * u64::from(count));
    let bindings = forward::Bindings {
        params: a.step.into(),
        // Absent inputs are bound to a buffer that the specialized kernel never reads.
        direct: a.direct.unwrap_or(a.coverage).into(),
        ambient: a.ambient.unwrap_or(a.coverage).into(),
        coverage: a.coverage.into(),
        image: image.into(),
        sums: sums.into(),
    };
    let (direct, ambient) = (a.direct.is_some(), a.ambient.is_some());
    let specs = forward::Specs { workgroup: tuning.workgroup, direct, ambient };
    stage(g, "compose", &forward::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch(groups(a.pixels(), tuning.workgroup))?;
    Ok(Saturated { sums, count })
}

/// Adds the pass that writes `radiance_gradient` (`[P * 3]` floats). Direct and ambient light have this same gradient.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn compose_bwd(
    g: &mut Graph,
    tuning: Tuning,
    a: &Compose,
    grad_image: Buffer,
    radiance_gradient: Buffer,
) -> Result<(), GraphError> {
    let bindings = backward::Bindings {
        params: a.step.into(),
        direct: a.direct.unwrap_or(a.coverage).into(),
        ambient: a.ambient.unwrap_or(a.coverage).into(),
        coverage: a.coverage.into(),
        grad_image: grad_image.into(),
        radiance_gradient: radiance_gradient.into(),
    };
    let (direct, ambient) = (a.direct.is_some(), a.ambient.is_some());
    let specs = backward::Specs { workgroup: tuning.workgroup, direct, ambient };
    stage(g, "compose_bwd", &backward::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch(groups(a.pixels(), tuning.workgroup))
}
