//! `geometry_loss`: losses of blended normals and depths, with their gradients.
//!
//! Geometry terms of the first stage (SGS-Intrinsic), each a mean over **all** pixels of the view:
//! * `weight_normal`: 1 - cos of the angle between the blended normal and a prior normal, both in world space. Pixels
//!   without a prior contribute 0.
//! * `weight_normal_smooth`: absolute Sobel responses (divided by 8, border repeated) of the unit normal, times
//!   `exp(-|Sobel of the photograph|)` by channel, summed over both directions.
//! * `weight_depth_smooth`: the same for depth; the factor is the mean over the photograph's channels.
//! * `weight_depth_variance`: `sqrt(max(variance of depth along the ray, 1e-6))`.
//!
//! Depth is `sum(w z) / max(opacity, 1e-3)`, the unit normal is `sum(w n) / max(length, 1e-3)`. The floors bound the
//! gradients of nearly empty pixels. The variance is a difference of squares. Its error in 32 bits is about 2e-7 of the
//! squared depth, so scenes should be scaled to depths of a few units.
//!
//! Guarantees: the channels of normals and depth and the gradient by transmittance are written for every pixel; the
//! latter is zero without depth. Nothing after the view's pixels is changed. Results are bit-identical between runs.
//! Terms that the model lacks are compiled out.
//!
//! Cost per pixel with all terms: 32 bytes read (60 from caches, with the margins), 24 written; about 450 operations, 6
//! exponentials among them.

use super::edge_aware::Tiles;
use crate::Tuning;
use crate::kernel::{groups, stage};
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::geometry_loss as kernel;

/// Inputs of the geometry losses.
#[derive(Clone, Copy, Debug)]
pub struct GeometryLoss {
    /// Uniform `Step`: size of the view, offset of its photograph and priors, weights.
    pub step: Buffer,
    /// `[P * channels]` floats.
    pub image: Buffer,
    /// Floats of a pixel of `image` and of its gradient.
    pub channels: u32,
    /// First of the three channels of normals, if blended.
    pub normals: Option<u32>,
    /// Channel of depth, if blended. The channel of squared depth follows.
    pub depth: Option<u32>,
    /// `[P]` floats.
    pub transmittance: Buffer,
    /// All photographs, packed RGBA8.
    pub targets: Buffer,
    /// Prior normals of all views ([`super::octahedral_encode`], world space), if any.
    pub priors: Option<Buffer>,
    /// Upper bounds of the width and height of all views, in pixels.
    pub largest: [u32; 2],
}

/// Result for [`super::loss_sum`].
#[derive(Clone, Copy, Debug)]
pub struct GeometrySums {
    /// Four losses, summed by workgroup.
    pub sums: Buffer,
    /// Number of workgroups.
    pub count: u32,
}

/// Adds the pass of the losses. It writes its channels of `grad_image` and all of `grad_transmittance`.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn geometry_loss(
    g: &mut Graph,
    tuning: Tuning,
    a: &GeometryLoss,
    grad_image: Buffer,
    grad_transmittance: Buffer,
) -> Result<GeometrySums, GraphError> {
    let Tiles { workgroup, size: [tile_x, tile_y], run, reuse } = Tiles::new(tuning);
    let count = a.largest[0].div_ceil(tile_x) * a.largest[1].div_ceil(tile_y);
    let sums = g.transient("geometry_loss.sums", u64::from(count) * 16);
    let bindings = kernel::Bindings {
        params: a.step.into(),
        image: a.image.into(),
        transmittance: a.transmittance.into(),
        targets: a.targets.into(),
        priors: a.priors.unwrap_or(a.targets).into(),
        grad_image: grad_image.into(),
        grad_transmittance: grad_transmittance.into(),
        sums: sums.into(),
    };
    let specs = kernel::Specs {
        workgroup,
        tile_x,
        tile_y,
        run,
        channels: a.channels,
        normals: a.normals.is_some().into(),
        normal_at: a.normals.unwrap_or(0),
        depth: a.depth.is_some().into(),
        depth_at: a.depth.unwrap_or(0),
        prior: a.priors.is_some(),
        reuse,
    };
    stage(g, "geometry_loss", &kernel::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch(groups(u64::from(count), 1))?;
    Ok(GeometrySums { sums, count })
}
