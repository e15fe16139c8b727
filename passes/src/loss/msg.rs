//! `msg`, `relight` and `own_prior`: materials should change over the picture as their priors do, at several scales.
//!
//! The multi-scale gradient loss of SGS-Intrinsic (method of Careaga and Aksoy). The difference d of a picture and its prior
//! is made smaller to 1/2^l of the picture (rounded down, at least a pixel), l = 0 to 3, by a tent of two pixels' width of the
//! level, pixel centers in the middle, weights over what lies inside the picture. Of each channel, filters of three taps
//! (0.425287, 0, -0.425287) times (0.229879, 0.540242, 0.229879), with borders mirrored, give sqrt(gx² + gy² + 1e-8); the loss
//! of a level is the mean over the channels and over the pixels that count, and `msg` the mean over four levels. On each
//! level a pixel counts if at least 0.99903 of what it is made of does, and all its neighbors likewise; a level where none counts
//! is 0. In the picture a pixel counts if its prior's alpha is not 0 and its coverage at least 0.5.
//!
//! `relight` compares albedo with an estimate of it under other light (or from elsewhere) within a mask: the squared
//! difference, summed over channels, mean over the pixels that count, plus `msg` over the same pixels. It has the same
//! kernels, with its squares where roughness would be summed. `own_prior` is the same against the view's own prior, with a
//! weight of its own: that loss is not of the paper.
//!
//! Promises: gradients are added to (they must have been written), nothing behind the view's pixels is touched, the same
//! bits from run to run: the transposed tent is bilinear interpolation between pixels of a level, so gradients are gathered.
//! Where nothing counts there is no loss and no gradient. Priors may hold anything where their alpha is 0.
//!
//! Memory: 48 bytes a pixel between the passes. Cost a pixel: 40 bytes read and 20 written (`difference`); 12 taps of 14
//! operations (`levels`); 27 bytes read and 21 written, 300 operations (`slopes`); 40 bytes read and 24 changed (`bwd`).

use super::MaterialPictures;
use super::edge_aware::{TILE, shape};
use crate::Tuning;
use crate::kernel::{groups, stage};
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::structs::MsgLevels;
use sgs_shaders::{msg_bwd, msg_difference, msg_levels, msg_slopes, msg_sum};

/// What is compared with what.
#[derive(Clone, Copy, Debug)]
pub struct Msg {
    /// Uniform `Step`: size of the view, `target_offset`, `mask_offset`.
    pub step: Buffer,
    /// Uniform `MaterialWeights`.
    pub weights: Buffer,
    /// The pictures; of roughness the first channel counts.
    pub pictures: MaterialPictures,
    /// `[P]` floats: blended opacity.
    pub coverage: Buffer,
    /// Packed RGBA8: what albedo is compared with.
    pub albedo_prior: Buffer,
    /// Packed RGBA8: what roughness is compared with, red, if there is such. For [`msg`] alone.
    pub roughness_prior: Option<Buffer>,
    /// Whether priors are those of all views, this one's from `target_offset`; or of this view alone.
    pub all_views: bool,
    /// A bit a pixel ([`super::pack_mask`]) from word `mask_offset`, if only those of a mask count.
    pub mask: Option<Buffer>,
    /// Columns and rows that no view exceeds, each for itself.
    pub largest: [u32; 2],
}

/// What is left for [`super::material_sum()`].
#[derive(Clone, Copy, Debug)]
pub struct MsgLoss {
    /// `MsgLevels`.
    pub result: Buffer,
}

/// Levels, each half as wide and high as the one before.
const LEVELS: u32 = 4;

/// Pixels of all levels, and tiles.
fn extent(largest: [u32; 2]) -> (u64, u64) {
    let level = |l: u32| largest.map(|n| u64::from((n >> l).max(1)));
    let tiles = |n: [u64; 2]| n[0].div_ceil(TILE[0].into()) * n[1].div_ceil(TILE[1].into());
    let all = || (0..LEVELS).map(level);
    (all().map(|n| n[0] * n[1]).sum(), all().map(tiles).sum())
}

/// Adds the passes of the loss, which add to `gradients` what `albedo_msg` and `roughness_msg` weigh.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn msg(g: &mut Graph, tuning: Tuning, a: &Msg, gradients: &MaterialPictures) -> Result<MsgLoss, GraphError> {
    compared(g, tuning, "msg", a, gradients, Against::Priors)
}

/// What is compared with.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Against {
    /// The priors of the view, everywhere.
    Priors,
    /// An estimate under other light, which has this share of the weight.
    Estimate(f32),
    /// The prior of the view, in a region.
    OwnPrior,
}

/// Adds the passes `relight{number}` of one estimate, which add to the gradient of albedo what `relight` weighs times
/// `share`: one by the number of estimates.
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
    let gradients = MaterialPictures { albedo: albedo_gradient, roughness: None };
    compared(g, tuning, &format!("relight{number}"), a, &gradients, Against::Estimate(share))
}

/// Adds the passes `own_prior`, which add to the gradient of albedo what `own_prior` weighs.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn own_prior(g: &mut Graph, tuning: Tuning, a: &Msg, albedo_gradient: Buffer) -> Result<MsgLoss, GraphError> {
    let gradients = MaterialPictures { albedo: albedo_gradient, roughness: None };
    compared(g, tuning, "own_prior", a, &gradients, Against::OwnPrior)
}

fn compared(
    g: &mut Graph,
    tuning: Tuning,
    name: &str,
    a: &Msg,
    gradients: &MaterialPictures,
    against: Against,
) -> Result<MsgLoss, GraphError> {
    let (all, tiles) = extent(a.largest);
    let pixels = u64::from(a.largest[0]) * u64::from(a.largest[1]);
    let name = |what: &str| format!("{name}.{what}");
    let levels = g.transient(name("levels"), 16 * all);
    let present = g.transient(name("present"), 4 * all);
    let slopes = g.transient(name("slopes"), 16 * all);
    let sums = g.transient(name("sums"), 16 * tiles);
    let result = g.transient(name("result"), size_of::<MsgLevels>() as u64);
    let (workgroup, square) = (tuning.workgroup, against != Against::Priors);
    let gray = a.pictures.roughness.zip(gradients.roughness).zip(a.roughness_prior);

    // What is absent is bound to something that the specialized kernel never touches.
    let bindings = msg_difference::Bindings {
        params: a.step.into(),
        albedo_srgb: a.pictures.albedo.into(),
        roughness_gray: gray.map_or(a.pictures.albedo, |g| g.0.0).into(),
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
    let (tiled, run) = shape(tuning);
    let specs = msg_slopes::Specs { workgroup: tiled, tile_x: TILE[0], tile_y: TILE[1], run, square };
    stage(g, &name("slopes"), &msg_slopes::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch(groups(tiles, 1))?;

    let bindings = msg_sum::Bindings {
        params: a.step.into(),
        loss_weights: a.weights.into(),
        sums: sums.into(),
        result: result.into(),
    };
    let own = against == Against::OwnPrior;
    let specs = msg_sum::Specs { workgroup, tile_x: TILE[0], tile_y: TILE[1], square, own };
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
        // The sums have been added up: nobody minds that a kernel could write them which does not.
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
        assert_eq!(extent([1, 1]), (4, 4));
        assert_eq!(extent([5, 3]), (15 + 2 + 1 + 1, 4));
        assert_eq!(extent([57, 16]), (57 * 16 + 28 * 8 + 14 * 4 + 7 * 2, 3 + 1 + 1 + 1));
    }
}
