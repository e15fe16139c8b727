//! `depth_fit`, `depth_fit_solve`: fit of a view's prior depths to its blended depth.
//!
//! Networks return depth up to a factor, or inverse depth up to a factor and a shift. Both passes find the line
//! `y = a x + b` with the least sum of `w (a x + b - y)^2`, where x is the prior value, y the inverse blended depth and
//! w the confidence times the opacity. Pixels with an opacity below a half do not count. With [`Fit::Scale`], b is 0.
//! The loss ([`super::geometry_loss()`]) treats a and b as constants.
//!
//! Values of [`Fit::ScaleShift`] are stored with mean 0 and variance 1 ([`super::pack_relative_depth`]), so that the
//! variance, a difference of squares, keeps its digits.
//!
//! Guarantees: a and b are zero if no line with a positive slope fits. Results are bit-identical between runs.
//!
//! Cost: 12 bytes and 15 operations per pixel; one more workgroup.

use crate::Tuning;
use crate::kernel::stage;
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::{depth_fit as sums_kernel, depth_fit_solve as kernel};

/// Workgroups that share the pixels of a view.
const PARTS: u32 = 64;

/// How prior depths relate to depth.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Fit {
    /// They are inverse depths in scene units, at the photograph's pixels.
    #[default]
    Metric,
    /// They are inverse depths in scene units, along the rays of the given camera.
    ///
    /// Those of a sensor are.
    Sensor,
    /// They are inverse depths up to a factor for each view.
    Scale,
    /// They are inverse depths up to a factor and a shift for each view.
    ScaleShift,
}

impl Fit {
    /// Returns whether depths need no fit.
    pub fn is_metric(self) -> bool {
        matches!(self, Fit::Metric | Fit::Sensor)
    }
}

/// Inputs of the fit.
#[derive(Clone, Copy, Debug)]
pub struct DepthFit {
    /// Uniform `Step`: size of the view, offset of its priors.
    pub step: Buffer,
    /// `[P * channels]` floats.
    pub image: Buffer,
    /// Floats of a pixel of `image`.
    pub channels: u32,
    /// Channel of depth.
    pub depth: u32,
    /// `[P]` floats.
    pub transmittance: Buffer,
    /// Prior values of all views, packed.
    pub priors: Buffer,
    /// Whether the line may miss the origin.
    pub shift: bool,
}

/// Adds both passes. Returns slope and offset: two floats.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn depth_fit(g: &mut Graph, tuning: Tuning, a: &DepthFit) -> Result<Buffer, GraphError> {
    let sums = g.transient("depth_fit.sums", u64::from(PARTS) * 32);
    let bindings = sums_kernel::Bindings {
        params: a.step.into(),
        image: a.image.into(),
        transmittance: a.transmittance.into(),
        depth_priors: a.priors.into(),
        sums: sums.into(),
    };
    let specs = sums_kernel::Specs { workgroup: tuning.workgroup, channels: a.channels, depth_at: a.depth };
    stage(g, "depth_fit", &sums_kernel::KERNEL, bindings.entries(), specs.entries(), &[]).dispatch([PARTS, 1, 1])?;
    let line = g.transient("depth_fit.line", 8);
    let bindings = kernel::Bindings { sums: sums.into(), line: line.into() };
    let specs = kernel::Specs { workgroup: PARTS, shift: a.shift };
    let push = kernel::Push { count: PARTS };
    stage(g, "depth_fit_solve", &kernel::KERNEL, bindings.entries(), specs.entries(), bytemuck::bytes_of(&push))
        .dispatch([1, 1, 1])?;
    Ok(line)
}
