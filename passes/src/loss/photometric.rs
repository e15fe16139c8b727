//! `photometric`, `photometric_bwd` (and in place): `weight_l1 * L1 + weight_dssim * (1 - SSIM)` against a photograph, and its gradient.
//!
//! SSIM after Wang et al. 2004 with the constants of 3D Gaussian splatting (Kerbl et al. 2023, section 5): 11 x 11
//! Gaussian window of sigma 1.5, zero padding, C1 = 1e-4, C2 = 9e-4, mean over pixels and the three channels.
//!
//! Promises: every gradient of the first three channels is written, nothing behind the current view's pixels is
//! touched, sums are bit-identical from run to run. Leaves the composition with a background to the caller, whose image
//! is complete, and the addition of the workgroups' sums to [`super::sum`].
//!
//! Cost a pixel. Device memory: 4 C + 4 read, 36 written (`photometric`); 36 + 4 C + 4 read, 12 written, in a pixel of
//! 4 C (`photometric_bwd`; in place 4 more are written): 104 bytes for C = 3. A tile's margins make that 2.1 times as much from the caches.
//! Arithmetic: a window takes 11 multiply-adds a value, columns are filtered 2.4 times (both margins) and rows 1.9
//! times: 3 channels x 11 x (4 + 3) values x 4.3 = 990 multiply-adds, and 3 x 40 for SSIM.

use crate::Tuning;
use crate::kernel::{groups, stage};
use crate::splat::PixelGradients;
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::{photometric as forward, photometric_bwd as backward, photometric_bwd_in_place as in_place};

/// What the loss works on.
#[derive(Clone, Copy, Debug)]
pub struct Photometric {
    /// Uniform `Step`: size of the view, offset of its photograph, weights.
    pub step: Buffer,
    /// `[P * channels]` floats; of each pixel the first three are compared.
    pub image: Buffer,
    /// All photographs, packed RGBA8. A pixel with alpha 0 does not count: it has no loss and no gradient.
    pub targets: Buffer,
    /// Floats of a pixel of `image` and of its gradient.
    pub channels: u32,
    /// Columns and rows that no view exceeds, each for itself.
    pub largest: [u32; 2],
}

/// What the forward half leaves for the backward half and for [`super::sum`].
#[derive(Clone, Copy, Debug)]
pub struct Partials {
    /// Derivatives of SSIM by the windowed means.
    pub partials: Buffer,
    /// L1 and SSIM, summed by workgroup.
    pub sums: Buffer,
    /// Number of workgroups.
    pub count: u32,
}

/// Columns and rows of a tile: with its margins of 5 it is 32 columns wide, and its shared memory takes 25 KiB.
const TILE: [u32; 2] = [22, 16];

/// One invocation for each of the 32 columns of the 3 channels; on a CPU fewer, for barriers cost by the invocation.
fn workgroup(tuning: Tuning) -> u32 {
    (3 * tuning.subgroup_size).min(96)
}

/// Pixels of a row that one invocation filters. On a GPU half of the tile, so that rows keep all invocations busy; on a
/// CPU, where idle invocations cost nothing and margins do, all of it.
fn run(tuning: Tuning) -> u32 {
    if tuning.subgroup_size < 32 { TILE[0] } else { TILE[0] / 2 }
}

fn tiles(largest: [u32; 2]) -> u32 {
    largest[0].div_ceil(TILE[0]) * largest[1].div_ceil(TILE[1])
}

/// Adds the forward half.
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

/// Adds the backward half, which overwrites the first three channels of `grad_image`.
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

/// As [`photometric_bwd`] for an image of color alone: the image becomes its own gradient, so that a picture is in memory
/// once, and what blending's backward starts from is complete.
///
/// # Errors
/// If a buffer does not belong to the graph, is too small to be bound, or the image has not three channels.
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
