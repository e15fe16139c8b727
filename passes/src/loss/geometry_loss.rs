//! `geometry_loss`: losses of blended normals and depths, with their gradients.
//!
//! Geometry terms of the first stage (SGS-Intrinsic), each a mean over **all** pixels of the view:
//! * `weight_normal`: 1 - cos of the angle between the blended normal and a prior normal, both in world space. Pixels
//!   without a prior contribute 0.
//! * `weight_normal_smooth`: absolute Sobel responses (divided by 8, border repeated) of the unit normal, times
//!   `exp(-|Sobel of the photograph|)` by channel, summed over both directions.
//! * `weight_depth_smooth`: the same for depth; the factor is the mean over the photograph's channels.
//! * `weight_depth_variance`: `sqrt(max(variance of depth along the ray, 1e-6))`.
//! * `weight_depth`: `confidence |depth / prior depth - 1|`. Pixels without a prior contribute 0. Priors up to a factor
//!   and a shift are fitted to the view first ([`super::depth_fit()`]).
//!
//! A pixel with alpha 0 in the photograph is invalid: it contributes 0 and has no gradient. A Sobel response contributes 0
//! if one of its nine pixels is invalid. The mean stays that over all pixels, as in [`super::photometric()`].
//!
//! Depth is `sum(w z) / max(opacity, 1e-3)`, the unit normal is `sum(w n) / max(length, 1e-3)`. The floors bound the
//! gradients of nearly empty pixels. The variance is a difference of squares. Its error in 32 bits is about 2e-7 of the
//! squared depth, so scenes should be scaled to depths of a few units.
//!
//! Guarantees: the channels of normals and depth and the gradient by transmittance are written for every pixel; the
//! latter is zero without depth. Nothing after the view's pixels is changed. Results are bit-identical between runs.
//! Terms that the model lacks are compiled out.
//!
//! Cost per pixel with all terms: 32 bytes read (64 from caches, with the margins), 24 written; about 450 operations, 6
//! exponentials among them. Prior depths add 4 bytes and 8 operations.

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
    /// All photographs, packed RGBA8. A pixel with alpha 0 has no loss and no gradient.
    pub targets: Buffer,
    /// Prior normals of all views ([`super::octahedral_encode`], world space), if any.
    pub priors: Option<Buffer>,
    /// Prior depths of all views ([`pack_depth`]), if any. They need blended depth.
    pub depth_priors: Option<Buffer>,
    /// Fit of the prior depths ([`super::depth_fit()`]); without it they are inverse depths.
    pub depth_line: Option<Buffer>,
    /// Uniform `Step` with the lens of the prior depths, if theirs is another.
    ///
    /// Each pixel takes the depth of the nearest ray.
    pub depth_lens: Option<Buffer>,
    /// Upper bounds of the width and height of all views, in pixels.
    pub largest: [u32; 2],
}

/// Packs a prior depth, in scene units, and its confidence from 0 to 1.
///
/// The word holds two half floats: the inverse of the depth, so that its relative error is 5e-4, and the confidence.
/// 0 means that the depth is unknown.
pub fn pack_depth(depth: f32, confidence: f32) -> u32 {
    let inverse = half::f16::from_f32((1.0 / depth).min(f32::from(half::f16::MAX)));
    let confidence = half::f16::from_f32(confidence.min(1.0));
    let known = depth > 0.0 && confidence.to_f32() > 0.0 && inverse > half::f16::ZERO;
    if known { u32::from(inverse.to_bits()) | u32::from(confidence.to_bits()) << 16 } else { 0 }
}

/// Packs inverse depths up to a factor and, with `shift`, an offset.
///
/// The values are stored with mean 0 and variance 1 with `shift`, else with mean 1. Values that are not finite, and
/// without `shift` those of 0 and less, are unknown.
pub fn pack_relative_depth(values: &[f32], confidence: &[f32], shift: bool) -> Vec<u32> {
    let known = |v: f32, c: f32| v.is_finite() && c > 0.0 && (shift || v > 0.0);
    let pairs = || values.iter().zip(confidence).filter(|(v, c)| known(**v, **c)).map(|(v, _)| f64::from(*v));
    let count = pairs().count().max(1) as f64;
    let mean = pairs().sum::<f64>() / count;
    let variance = pairs().map(|v| (v - mean).powi(2)).sum::<f64>() / count;
    let (offset, scale) = match shift {
        true => (mean, if variance > 0.0 { variance.sqrt() } else { 1.0 }),
        false => (0.0, mean),
    };
    let pack = |(&v, &c): (&f32, &f32)| {
        if !known(v, c) {
            return 0;
        }
        let most = f64::from(half::f16::MAX);
        let value = half::f16::from_f64(((f64::from(v) - offset) / scale).clamp(-most, most));
        u32::from(value.to_bits()) | u32::from(half::f16::from_f32(c.min(1.0)).to_bits()) << 16
    };
    values.iter().zip(confidence).map(pack).collect()
}

/// Returns the inverse depth and the confidence of a packed prior depth; none if it is unknown.
pub fn unpack_depth(word: u32) -> Option<[f64; 2]> {
    let half = |bits: u32| f64::from(half::f16::from_bits(bits as u16));
    (word >> 16 != 0).then(|| [half(word & 0xffff), half(word >> 16)])
}

/// Result for [`super::loss_sum`].
#[derive(Clone, Copy, Debug)]
pub struct GeometrySums {
    /// Four losses, summed by workgroup; then those of prior depths, if there are any.
    pub sums: Buffer,
    /// Number of workgroups.
    pub count: u32,
    /// Whether there are losses of prior depths.
    pub depth: bool,
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
    let depth = a.depth_priors.is_some() && a.depth.is_some();
    let sums = g.transient("geometry_loss.sums", u64::from(count) * 16 * (1 + u64::from(depth)));
    let bindings = kernel::Bindings {
        params: a.step.into(),
        given: a.depth_lens.unwrap_or(a.step).into(),
        image: a.image.into(),
        transmittance: a.transmittance.into(),
        targets: a.targets.into(),
        priors: a.priors.unwrap_or(a.targets).into(),
        depth_priors: a.depth_priors.unwrap_or(a.targets).into(),
        depth_line: a.depth_line.unwrap_or(a.transmittance).into(),
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
        depth_prior: depth,
        depth_fit: depth && a.depth_line.is_some(),
        sensor: depth && a.depth_lens.is_some(),
        distorted: tuning.distorted,
    };
    stage(g, "geometry_loss", &kernel::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch(groups(u64::from(count), 1))?;
    Ok(GeometrySums { sums, count, depth })
}
