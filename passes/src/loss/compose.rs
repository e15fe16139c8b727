//! `compose`, `compose_bwd`: light over a background as the picture that photographs are compared with, and the way back.
//!
//! Direct and ambient light are linear, and so is their sum; times the coverage, over the background (display-referred in the
//! step, decoded here), it is encoded in sRGB (IEC 61966-2-1) and cut off at black and white. What is cut off has no
//! gradient: a light that is too bright everywhere stays so. With [`Compose::returning`] such a pixel keeps the gradients
//! that lead it back, with the slope at white. How many pixels are cut off at white is counted.
//!
//! Promises: every pixel of the view is written, nothing behind them is touched; pixels whose coverage is below 1e-3 show the
//! background and get no gradient; light that is not finite is black and gets none either; counts are exact below 2^24.
//!
//! Cost a pixel: 28 bytes read, 12 written; backward 40 and 12. 3 powers each, 3 more for the background.

use crate::Tuning;
use crate::kernel::{groups, stage};
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::{compose as forward, compose_bwd as backward};

/// What is composed.
#[derive(Clone, Copy, Debug)]
pub struct Compose {
    /// Uniform `Step`: size of the view, background.
    pub step: Buffer,
    /// `[P * 3]` floats: light of lamps, linear, if there are any.
    pub direct: Option<Buffer>,
    /// `[P * 3]` floats: light of the surroundings, linear, if there are any.
    pub ambient: Option<Buffer>,
    /// `[P]` floats: blended opacity.
    pub coverage: Buffer,
    /// Whether what was cut off keeps gradients that lead it back.
    pub returning: bool,
    /// Columns and rows that no view exceeds, each for itself.
    pub largest: [u32; 2],
}

/// Pixels that were cut off at white.
#[derive(Clone, Copy, Debug)]
pub struct Saturated {
    /// Their number by workgroup, as floats.
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
        // What is absent is bound to something that the specialized kernel never touches.
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

/// Adds the pass that writes `radiance_gradient` (`[P * 3]` floats), which is that of direct and of ambient light.
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
    let specs = backward::Specs { workgroup: tuning.workgroup, direct, ambient, returning: a.returning };
    stage(g, "compose_bwd", &backward::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch(groups(a.pixels(), tuning.workgroup))
}
