//! Photometric loss against a photograph, and its gradient.
//!
//! The loss is `weight_l1 * L1 + weight_dssim * (1 - SSIM)`. Passes are `photometric` and `photometric_bwd`, the latter
//! also in place. SSIM follows Wang et al. 2004 with the constants of 3D Gaussian splatting (Kerbl et al. 2023, section
//! 5): 11 x 11 Gaussian window of sigma 1.5, zero padding, C1 = 1e-4, C2 = 9e-4, mean over pixels and the three
//! channels.
//!
//! Guarantees: every gradient of the first three channels is written, nothing after the current view's pixels is
//! changed. Sums are bit-identical between runs. The caller composes the image over its background before, and adds the
//! sums of the workgroups with [`super::sum`] after.
//!
//! Cost per pixel. Device memory: 4 C + 4 bytes read, 36 written (`photometric`); 36 + 4 C + 4 read, 12 written, in a
//! pixel of 4 C (`photometric_bwd`; in place 4 more are written). That is 104 bytes for C = 3. With a tile's margins,
//! caches supply 2.1 times as much. Arithmetic: a window takes 11 multiply-adds per value; columns are filtered 2.4
//! times (both margins) and rows 1.9 times. That is 3 channels x 11 x (4 + 3) values x 4.3 = 990 multiply-adds, and 3 x
//! 40 for SSIM.

use crate::Tuning;
use crate::kernel::{groups, stage};
use crate::splat::PixelGradients;
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::{photometric as forward, photometric_bwd as backward, photometric_bwd_in_place as in_place};

/// Inputs of the photometric loss.
#[derive(Clone, Copy, Debug)]
pub struct Photometric {
    /// Uniform `Step`: size of the view, offset of its photograph, weights.
    pub step: Buffer,
    /// `[P * channels]` floats; the first three channels of each pixel are compared.
    pub image: Buffer,
    /// All photographs, packed RGBA8. A pixel with alpha 0 has no loss and no gradient.
    pub targets: Buffer,
    /// Floats of a pixel of `image` and of its gradient.
    pub channels: u32,
    /// Upper bounds of the width and height of all views, in pixels.
    pub largest: [u32; 2],
}

/// Results of the forward pass for the backward pass and for [`super::sum`].
#[derive(Clone, Copy, Debug)]
pub struct Partials {
    /// Derivatives of SSIM with respect to the windowed means.
    pub partials: Buffer,
    /// L1 and SSIM, summed by workgroup.
    pub sums: Buffer,
    /// Number of workgroups.
    pub count: u32,
}

/// Columns and rows of a tile. With margins of 5 a tile is 32 columns wide and takes 25 KiB of shared memory.
const TILE: [u32; 2] = [22, 16];

/// Returns the workgroup size: one invocation for each of the 32 columns of the 3 channels. On a CPU it is smaller,
/// since barriers cost time per invocation.
fn workgroup(tuning: Tuning) -> u32 {
    (3 * tuning.subgroup_size).min(96)
}

/// Returns the pixels of a row that one invocation filters. On a GPU this is half of the tile, so that rows occupy all
/// invocations. On a CPU it is the whole row: idle invocations cost nothing there, but margins do.
fn run(tuning: Tuning) -> u32 {
    if tuning.subgroup_size < 32 { TILE[0] } else { TILE[0] / 2 }
}

fn tiles(largest: [u32; 2]) -> u32 {
    largest[0].div_ceil(TILE[0]) * largest[1].div_ceil(TILE[1])
}

/// Adds the forward pass.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn photometric(g: &mut Graph, tuning: Tuning, a: &Photometric) -> Result<Partials, GraphError> {
    let count = tiles(a.largest);
    let pixels = u64::from(a.largest[0]) * u64::from(a.largest[1]);
    let partials = g.transient("photometric.partials", pixels * 36);
    let sums = g.transient("photometric.sums", u64::from(count) * 8);
    let bindings = forward::Bindings {
        params: a.step.into(),
        image: a.image.into(),
        targets: a.targets.into(),
        partials: partials.into(),
        sums: sums.into(),
    };
    let specs = forward::Specs {
        workgroup: workgroup(tuning),
        tile_x: TILE[0],
        tile_y: TILE[1],
        run: run(tuning),
        channels: a.channels,
    };
    stage(g, "photometric", &forward::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch(groups(u64::from(count), 1))?;
    Ok(Partials { partials, sums, count })
}

/// Adds the backward pass. It overwrites the first three channels of `grad_image`.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn photometric_bwd(
    g: &mut Graph,
    tuning: Tuning,
    a: &Photometric,
    partials: &Partials,
    grad_image: Buffer,
) -> Result<(), GraphError> {
    let bindings = backward::Bindings {
        params: a.step.into(),
        image: a.image.into(),
        targets: a.targets.into(),
        partials: partials.partials.into(),
        grad_image: grad_image.into(),
    };
    let specs = backward::Specs {
        workgroup: workgroup(tuning),
        tile_x: TILE[0],
        tile_y: TILE[1],
        run: run(tuning),
        channels: a.channels,
    };
    stage(g, "photometric_bwd", &backward::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch(groups(u64::from(partials.count), 1))
}

/// Adds the backward pass in place, for an image of color only. Like [`photometric_bwd`], but the image becomes its own
/// gradient: memory holds one image instead of two. Also writes the debt, which completes the inputs of blending's
/// backward pass.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound. The image must have three channels.
pub fn photometric_bwd_in_place(
    g: &mut Graph,
    tuning: Tuning,
    a: &Photometric,
    partials: &Partials,
) -> Result<PixelGradients, GraphError> {
    debug_assert_eq!(a.channels, 3, "a loss of color alone");
    let debt = g.transient("debt", 4 * u64::from(a.largest[0]) * u64::from(a.largest[1]));
    let bindings = in_place::Bindings {
        params: a.step.into(),
        image: a.image.into(),
        targets: a.targets.into(),
        partials: partials.partials.into(),
        debt: debt.into(),
    };
    let specs = in_place::Specs {
        workgroup: workgroup(tuning),
        tile_x: TILE[0],
        tile_y: TILE[1],
        run: run(tuning),
        channels: 3,
    };
    stage(g, "photometric_bwd_in_place", &in_place::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch(groups(u64::from(partials.count), 1))?;
    Ok(PixelGradients { image: a.image, debt, statistic: None })
}
