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
//! pixel of 4 C (`photometric_bwd`; in place 4 more are written). That is 104 bytes for C = 3. With the margins of a
//! high tile, caches supply 2.1 times as much. Arithmetic: a window takes 11 multiply-adds per value; columns are
//! filtered 2.4 times (both margins) and rows 1.5 times. That is 3 channels x 11 x (4 + 3) values x 3.9 = 900
//! multiply-adds, and 3 x 40 for SSIM. Low tiles would filter columns 5 times. On GPUs taps add up instead: 1.5 times for
//! columns, once for rows.

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

/// Sizes of the kernels' tiles.
#[derive(Clone, Copy, Debug)]
struct Tile {
    /// Columns and rows. With margins of 5 on both sides, columns are a multiple of 32.
    size: [u32; 2],
    /// Invocations of a workgroup: at most one for each column of the 3 channels.
    workgroup: u32,
    /// Pixels of a row that one invocation filters. With 1, invocations add up taps.
    run: u32,
    /// Rows that an invocation loads together; divides the rows of a tile and its margins.
    ahead: u32,
}

impl Tile {
    /// Returns the sizes for a device.
    ///
    /// A GPU hides the latency of memory by the number of workgroups, so tiles are low (6 KiB of shared memory), and by
    /// loads that are issued together. On a CPU, margins cost more than latency: tiles are high and runs long. Barriers
    /// cost time per invocation there, so workgroups are small.
    fn of(tuning: Tuning) -> Tile {
        if tuning.subgroup_size < 32 {
            Tile { size: [22, 16], workgroup: (3 * tuning.subgroup_size).min(96), run: 22, ahead: 1 }
        } else {
            Tile { size: [22, 4], workgroup: 96, run: 1, ahead: 7 }
        }
    }

    /// Returns the tiles of a view.
    fn count(&self, largest: [u32; 2]) -> u32 {
        largest[0].div_ceil(self.size[0]) * largest[1].div_ceil(self.size[1])
    }
}

/// Adds the forward pass.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn photometric(g: &mut Graph, tuning: Tuning, a: &Photometric) -> Result<Partials, GraphError> {
    let tile = Tile::of(tuning);
    let count = tile.count(a.largest);
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
        workgroup: tile.workgroup,
        tile_x: tile.size[0],
        tile_y: tile.size[1],
        run: tile.run,
        channels: a.channels,
        ahead: tile.ahead,
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
    let tile = Tile::of(tuning);
    let bindings = backward::Bindings {
        params: a.step.into(),
        image: a.image.into(),
        targets: a.targets.into(),
        partials: partials.partials.into(),
        grad_image: grad_image.into(),
    };
    let specs = backward::Specs {
        workgroup: tile.workgroup,
        tile_x: tile.size[0],
        tile_y: tile.size[1],
        run: tile.run,
        channels: a.channels,
        ahead: tile.ahead,
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
    let tile = Tile::of(tuning);
    let bindings = in_place::Bindings {
        params: a.step.into(),
        image: a.image.into(),
        targets: a.targets.into(),
        partials: partials.partials.into(),
        debt: debt.into(),
    };
    let specs = in_place::Specs {
        workgroup: tile.workgroup,
        tile_x: tile.size[0],
        tile_y: tile.size[1],
        run: tile.run,
        channels: 3,
        ahead: tile.ahead,
    };
    stage(g, "photometric_bwd_in_place", &in_place::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch(groups(u64::from(partials.count), 1))?;
    Ok(PixelGradients { image: a.image, debt, statistic: None, buckets: None })
}
