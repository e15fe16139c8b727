//! `msg`, `relight` and `own_prior`: multi-scale gradient losses of materials against priors.
//!
//! Multi-scale gradient loss of SGS-Intrinsic (method of Careaga and Aksoy). The difference d of an image and its prior
//! is reduced to 1/2^l of the image, l = 0 to 3. Sizes are rounded down, to at least one pixel. The filter is a tent of
//! two pixels of the level. Pixel centers are in the middle; weights are normalized over the pixels inside the image.
//! On each channel, three taps (0.425287, 0, -0.425287) times (0.229879, 0.540242, 0.229879), with mirrored borders,
//! give sqrt(gx² + gy² + 1e-8). The loss of a level is the mean over channels and valid pixels; `msg` is the mean over
//! four levels. A pixel of a level is valid if valid pixels make up at least 0.99903 of it and of each of its
//! neighbors. A level without valid pixels contributes 0. A pixel of the image is valid if its prior's alpha is not 0
//! and its coverage is at least 0.5.
//!
//! `relight` compares albedo with an estimate of it under other light (or from elsewhere) within a mask. Its loss is
//! the squared difference, summed over channels and averaged over the valid pixels, plus `msg` over the same pixels.
//! The kernels are the same; the squares are summed in place of roughness. `own_prior` is the same loss against the
//! view's own prior, with its own weight. It is not part of the paper.
//!
//! Guarantees: adds gradients, which must have been written. Nothing after the view's pixels is changed. Results are
//! bit-identical between runs: the transposed tent is bilinear interpolation between pixels of a level, so gradients
//! are gathered. Without valid pixels loss and gradient are zero. Priors may hold any values where their alpha is 0.
//!
//! Memory: 48 bytes per pixel between the passes. Cost per pixel: 40 bytes read and 20 written (`difference`); 12 taps
//! of 14 operations (`levels`); 27 bytes read and 21 written, 300 operations (`slopes`); 40 bytes read and 24 changed
//! (`bwd`).

use super::MaterialImages;
use super::edge_aware::Tiles;
use crate::Tuning;
use crate::kernel::{groups, stage};
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::structs::MsgLevels;
use sgs_shaders::{msg_bwd, msg_difference, msg_levels, msg_slopes, msg_sum};

/// Inputs of the losses.
#[derive(Clone, Copy, Debug)]
pub struct Msg {
    /// Uniform `Step`: size of the view, `target_offset`, `mask_offset`.
    pub step: Buffer,
    /// Uniform `MaterialWeights`.
    pub weights: Buffer,
    /// Images of materials. The first channel of roughness counts.
    pub images: MaterialImages,
    /// `[P]` floats: blended opacity.
    pub coverage: Buffer,
    /// Packed RGBA8: target of albedo.
    pub albedo_prior: Buffer,
    /// Packed RGBA8: target of roughness, in red, if any. For [`msg`] only.
    pub roughness_prior: Option<Buffer>,
    /// Whether the priors contain all views. This view begins at `target_offset` then. Otherwise they contain this view
    /// only.
    pub all_views: bool,
    /// Optional mask that restricts the loss. One bit per pixel ([`super::pack_mask`]) from word `mask_offset`.
    pub mask: Option<Buffer>,
    /// Upper bounds of the width and height of all views, in pixels.
    pub largest: [u32; 2],
}

/// Result for [`super::material_sum()`].
#[derive(Clone, Copy, Debug)]
pub struct MsgLoss {
    /// `MsgLevels` record.
    pub result: Buffer,
}

/// Number of levels. Each is half as wide and high as the level before.
const LEVELS: u32 = 4;

/// Returns the number of pixels of all levels, and of tiles.
fn extent(largest: [u32; 2], tiles: &Tiles) -> (u64, u64) {
    let all = || (0..LEVELS).map(|l| largest.map(|n| (n >> l).max(1)));
    (all().map(|n| u64::from(n[0]) * u64::from(n[1])).sum(), all().map(|n| u64::from(tiles.count(n))).sum())
}

/// Adds the passes of the loss. They add gradients weighted by `albedo_msg` and `roughness_msg`.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn msg(g: &mut Graph, tuning: Tuning, a: &Msg, gradients: &MaterialImages) -> Result<MsgLoss, GraphError> {
    compared(g, tuning, "msg", a, gradients, Against::Priors)
}

/// Target of a comparison.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Against {
    /// Priors of the view, everywhere.
    Priors,
    /// Estimate under other light, with its share of the weight.
    Estimate(f32),
    /// Prior of the view, in a region.
    OwnPrior,
}

/// Adds the passes `relight{number}` of one estimate. They add the gradient of albedo, weighted by `relight` times
/// `share`. The share is one over the number of estimates.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn relight(
    g: &mut Graph,
    tuning: Tuning,
    a: &Msg,
    number: u32,
    share: f32,
    albedo_gradient: Buffer,
) -> Result<MsgLoss, GraphError> {
    let gradients = MaterialImages { albedo: albedo_gradient, roughness: None };
    compared(g, tuning, &format!("relight{number}"), a, &gradients, Against::Estimate(share))
}

/// Adds the passes `own_prior`. They add the gradient of albedo, weighted by `own_prior`.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn own_prior(g: &mut Graph, tuning: Tuning, a: &Msg, albedo_gradient: Buffer) -> Result<MsgLoss, GraphError> {
    let gradients = MaterialImages { albedo: albedo_gradient, roughness: None };
    compared(g, tuning, "own_prior", a, &gradients, Against::OwnPrior)
}

fn compared(
    g: &mut Graph,
    tuning: Tuning,
    name: &str,
    a: &Msg,
    gradients: &MaterialImages,
    against: Against,
) -> Result<MsgLoss, GraphError> {
    let shape = Tiles::new(tuning);
    let (all, tiles) = extent(a.largest, &shape);
    let pixels = u64::from(a.largest[0]) * u64::from(a.largest[1]);
    let name = |what: &str| format!("{name}.{what}");
    let levels = g.transient(name("levels"), 16 * all);
    let present = g.transient(name("present"), 4 * all);
    let slopes = g.transient(name("slopes"), 16 * all);
    let sums = g.transient(name("sums"), 16 * tiles);
    let result = g.transient(name("result"), size_of::<MsgLevels>() as u64);
    let (workgroup, square) = (tuning.workgroup, against != Against::Priors);
    let gray = a.images.roughness.zip(gradients.roughness).zip(a.roughness_prior);

    // Absent inputs are bound to a buffer that the specialized kernel never reads.
    let bindings = msg_difference::Bindings {
        params: a.step.into(),
        albedo_srgb: a.images.albedo.into(),
        roughness_gray: gray.map_or(a.images.albedo, |g| g.0.0).into(),
        albedo_prior: a.albedo_prior.into(),
        roughness_prior: gray.map_or(a.albedo_prior, |g| g.1).into(),
        coverage: a.coverage.into(),
        mask: a.mask.unwrap_or(a.albedo_prior).into(),
        levels: levels.into(),
        present: present.into(),
    };
    let (roughness, masked, all_views) = (gray.is_some(), a.mask.is_some(), a.all_views);
    let specs = msg_difference::Specs { workgroup, roughness, masked, all_views };
    stage(g, &name("difference"), &msg_difference::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch(groups(pixels, workgroup))?;

    let bindings = msg_levels::Bindings { params: a.step.into(), levels: levels.into(), present: present.into() };
    let specs = msg_levels::Specs { workgroup };
    stage(g, &name("levels"), &msg_levels::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch(groups(all - pixels, workgroup))?;

    let bindings = msg_slopes::Bindings {
        params: a.step.into(),
        levels: levels.into(),
        present: present.into(),
        slopes: slopes.into(),
        sums: sums.into(),
    };
    let Tiles { size: [tile_x, tile_y], run, reuse, .. } = shape;
    let specs = msg_slopes::Specs { workgroup: shape.workgroup, tile_x, tile_y, run, square, reuse };
    stage(g, &name("slopes"), &msg_slopes::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch(groups(tiles, 1))?;

    let bindings = msg_sum::Bindings {
        params: a.step.into(),
        loss_weights: a.weights.into(),
        sums: sums.into(),
        result: result.into(),
    };
    let own = against == Against::OwnPrior;
    let specs = msg_sum::Specs { workgroup, tile_x, tile_y, square, own };
    let push = msg_sum::Push { share: if let Against::Estimate(share) = against { share } else { 1.0 } };
    stage(g, &name("sum"), &msg_sum::KERNEL, bindings.entries(), specs.entries(), bytemuck::bytes_of(&push))
        .dispatch([1, 1, 1])?;

    let bindings = msg_bwd::Bindings {
        params: a.step.into(),
        levels: levels.into(),
        present: present.into(),
        slopes: slopes.into(),
        result: result.into(),
        albedo_gradient: gradients.albedo.into(),
        // Without roughness the kernel never writes this binding. The sums are not read after this.
        roughness_gradient: gray.map_or(sums, |g| g.0.1).into(),
    };
    let specs = msg_bwd::Specs { workgroup, roughness, square };
    stage(g, &name("bwd"), &msg_bwd::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch(groups(pixels, workgroup))?;
    Ok(MsgLoss { result })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_have_at_least_a_pixel() {
        let count = |size, lanes| extent(size, &Tiles::new(Tuning::for_subgroups(lanes)));
        assert_eq!(count([1, 1], 8), (4, 4));
        assert_eq!(count([5, 3], 8), (15 + 2 + 1 + 1, 4));
        assert_eq!(count([57, 16], 8), (57 * 16 + 28 * 8 + 14 * 4 + 7 * 2, 3 + 1 + 1 + 1));
        // Tiles of 14 rows.
        assert_eq!(count([57, 16], 32).1, 6 + 1 + 1 + 1);
    }
}
