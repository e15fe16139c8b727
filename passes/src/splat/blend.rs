//! `blend`, `blend_debt` and `blend_bwd`: blending of any number of channels, one subgroup per tile, per part of it (forward
//! in views of few tiles) or, backward, per bucket of a tile's entries ([`Buckets`]).
//!
//! Cost: each entry's record is fetched once per tile (28 + 4 C bytes, 4 fewer with 16-bit colors). Further parts of a tile
//! fetch it from a cache. A pixel takes about 12 + C multiply-adds and one exponential per entry of its tile until it is
//! opaque, backward about 30 + 2 C. Pixels write 4 (C + 1) bytes. The debt reads twice that and writes 4. Backward reads
//! 4 (C + 1) bytes per pixel and writes 4 (6 + C) bytes per entry.

use super::buckets::{Buckets, OWN, blend_buckets};
use super::project::EntryGradients;
use super::{Entries, Screen, Visible, parts};
use crate::Tuning;
use crate::kernel::{groups, splat_specs, stage};
use sgs_engine::DeviceInfo;
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::{blend as kernel, blend_debt as blend_debt_kernel};

/// Blended view.
#[derive(Clone, Copy, Debug)]
pub struct Blended {
    /// `[pixels * channels]`, over the background.
    pub image: Buffer,
    /// `[pixels]` of transmittance.
    pub transmittance: Buffer,
}

/// Selection of the backward kernel. The kernels agree up to rounding.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BackwardKernel {
    /// Lanes are pixels; sums are reduced across lanes once per splat and tile.
    Pixel,
    /// Lanes are splats; prefix operations propagate transmittance across lanes.
    Splat,
    /// Lanes are splats of a bucket of a tile's entries; pixels stream through the lanes. Small views fill a device, but
    /// the forward pass writes checkpoints ([`Buckets`]).
    Bucket,
    /// Lanes are pixels; float atomics add sums of tiles to splats. This takes less memory and no second sum, but
    /// results are not bit-identical between runs. Not every device supports float atomics
    /// ([`BackwardKernel::runs_on`]).
    Atomic,
}

impl BackwardKernel {
    /// Returns whether a device supports the kernel.
    pub fn runs_on(self, info: &DeviceInfo) -> bool {
        self != BackwardKernel::Atomic || info.optional.float_atomics
    }

    /// Returns a number of the code of all kernels of blending. Measured times of other code do not apply.
    pub fn code() -> u64 {
        use sgs_shaders::{blend, blend_buckets, blend_bwd, blend_bwd_bucket, blend_bwd_splat};
        let kernels = [
            &blend::KERNEL,
            &blend_buckets::KERNEL,
            &blend_bwd::KERNEL,
            &blend_bwd_bucket::KERNEL,
            &blend_bwd_splat::KERNEL,
        ];
        let words = kernels.into_iter().flat_map(|kernel| kernel.spirv.words());
        // FNV-1a, over words.
        words.fold(0xcbf2_9ce4_8422_2325, |hash, word| (hash ^ u64::from(*word)).wrapping_mul(0x0100_0000_01b3))
    }
}

/// Blends a view into `into`. The caller declares these buffers, as transient or external ones.
///
/// # Errors
/// If the graph rejects the pass.
pub fn blend(
    g: &mut Graph,
    t: &Tuning,
    screen: &Screen,
    visible: &Visible,
    entries: &Entries,
    into: &Blended,
) -> Result<(), GraphError> {
    let bindings = kernel::Bindings {
        params: screen.step.into(),
        tile_ranges: entries.tile_ranges.into(),
        sorted_entries: entries.sorted,
        entry_splats: entries.splats.into(),
        splats: visible.splats.into(),
        features: visible.features.into(),
        image: into.image.into(),
        transmittance: into.transmittance.into(),
    };
    let part = parts::part(t, screen);
    let specs = splat_specs!(kernel, t, { subgroup: t.subgroup_size,
        per_lane: parts::per_lane(t, part),
        part_width: part[0],
        part_height: part[1],
        tile_width: screen.tile[0],
        tile_height: screen.tile[1],
        sub_tiles: t.sub_tiles,
        slot_margin: t.slot_margin,
        slot_width: t.slot_width,
        channels: visible.channels.count(),
        has_colors: visible.channels.colors,
        color_bits: visible.color_bits, });
    stage(g, "blend", &kernel::KERNEL, bindings.entries(), specs.entries(), &[])
        .subgroup_size(Some(t.subgroup_size))
        .dispatch(groups(u64::from(screen.tiles()) * u64::from(parts::count(screen, part)), 1))
}

/// Blends a view into `into`, as [`blend`], and prepares for a backward kernel. The caller passes the result on in
/// [`PixelGradients::buckets`].
///
/// # Errors
/// If the graph rejects a pass.
pub fn blend_for(
    g: &mut Graph,
    t: &Tuning,
    screen: &Screen,
    visible: &Visible,
    entries: &Entries,
    into: &Blended,
    which: BackwardKernel,
) -> Result<Option<Buckets>, GraphError> {
    if which == BackwardKernel::Bucket {
        return blend_buckets(g, t, screen, visible, entries, into).map(Some);
    }
    blend(g, t, screen, visible, entries, into)?;
    Ok(None)
}

/// Losses whose gradients enter the densification statistic.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Statistic {
    /// Losses of color.
    Photometric,
    /// Losses of normals and depth. Gradients by raw normals are a second criterion.
    Geometric,
    /// All losses that reach the footprint. These include losses of features if features move geometry.
    Total,
}

impl Statistic {
    /// Returns the number of the statistic in the kernels.
    pub(crate) fn spec(self) -> u32 {
        match self {
            Statistic::Total => 0,
            Statistic::Photometric => 1,
            Statistic::Geometric => 2,
        }
    }
}

/// Inputs of blending's backward pass.
#[derive(Clone, Copy, Debug)]
pub struct PixelGradients {
    /// `[pixels * channels]`: gradient of the loss with respect to the image.
    pub image: Buffer,
    /// `[pixels]`: image times gradient, summed over channels and transmittance.
    pub debt: Buffer,
    /// Densification statistic with its own moments, and its debt ([`statistic_debt`]).
    pub statistic: Option<(Statistic, Buffer)>,
    /// Checkpoints of the forward pass ([`blend_for`]). [`BackwardKernel::Bucket`] requires them.
    pub buckets: Option<Buckets>,
}

/// Computes the debt of every pixel from the image and its gradients. A loss of color only computes the debt in its own
/// pass ([`crate::loss::photometric_bwd_in_place`]).
///
/// # Errors
/// If the graph rejects the pass.
pub fn blend_debt(
    g: &mut Graph,
    t: &Tuning,
    screen: &Screen,
    channels: u32,
    blended: &Blended,
    gradient: &Blended,
) -> Result<PixelGradients, GraphError> {
    let debt = statistic_debt(g, t, screen, channels, blended, gradient, Statistic::Total)?;
    Ok(PixelGradients { image: gradient.image, debt, statistic: None, buckets: None })
}

/// Computes the debt of the losses in a densification statistic. The gradients are those of all losses.
///
/// # Errors
/// If the graph rejects the pass.
pub fn statistic_debt(
    g: &mut Graph,
    t: &Tuning,
    screen: &Screen,
    channels: u32,
    blended: &Blended,
    gradient: &Blended,
    statistic: Statistic,
) -> Result<Buffer, GraphError> {
    let name = if statistic == Statistic::Total { "debt" } else { "statistic_debt" };
    let debt = g.transient(name, 4 * screen.pixels());
    let bindings = blend_debt_kernel::Bindings {
        params: screen.step.into(),
        image: blended.image.into(),
        transmittance: blended.transmittance.into(),
        grad_image: gradient.image.into(),
        grad_transmittance: gradient.transmittance.into(),
        debt: debt.into(),
    };
    let specs = blend_debt_kernel::Specs { workgroup: t.workgroup, channels, statistic: statistic.spec() };
    stage(g, &format!("blend_{name}"), &blend_debt_kernel::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch(groups(screen.pixels(), t.workgroup))?;
    Ok(debt)
}

/// Runs the backward pass of [`blend`]. Computes the gradients of every entry from those of the image.
///
/// # Errors
/// If the graph rejects the pass, or if [`BackwardKernel::Bucket`] has no checkpoints.
#[expect(clippy::too_many_arguments, reason = "declares a kernel")]
pub fn blend_bwd(
    g: &mut Graph,
    t: &Tuning,
    screen: &Screen,
    visible: &Visible,
    entries: &Entries,
    gradient: &PixelGradients,
    which: BackwardKernel,
    weights: bool,
) -> Result<EntryGradients, GraphError> {
    let channels = visible.channels.count();
    let statistic = gradient.statistic.map_or(Statistic::Total, |s| s.0);
    let own = if statistic == Statistic::Total { 0 } else { 2 };
    let floats = u64::from(6 + channels + u32::from(weights) + own);
    let reduced = which == BackwardKernel::Atomic;
    let (name, rows) =
        if reduced { ("splat_gradients", visible.capacity) } else { ("entry_gradients", entries.capacity) };
    let gradients = g.transient(name, 4 * floats * u64::from(rows));
    if reduced {
        g.fill("clear_splat_gradients", gradients, 0)?;
    }
    // Passes have the names of their kernels. Only that of buckets has more bindings, and no slots of tiles.
    macro_rules! add {
        ($kernel:ident, $gradients:ident, $groups:expr, { $($binding:tt)* }, { $($spec:tt)* }) => {{
            let bindings = $kernel::Bindings {
                params: screen.step.into(),
                tile_ranges: entries.tile_ranges.into(),
                sorted_entries: entries.sorted,
                entry_splats: entries.splats.into(),
                splats: visible.splats.into(),
                features: visible.features.into(),
                grad_image: gradient.image.into(),
                debt: gradient.debt.into(),
                statistic_debt: gradient.statistic.map_or(gradient.debt, |s| s.1).into(),
                $gradients: gradients.into(),
                $($binding)*
            };
            let specs = splat_specs!($kernel, t, { subgroup: t.subgroup_size,
                per_lane: per_lane(t, screen),
                tile_width: screen.tile[0],
                tile_height: screen.tile[1],
                channels,
                weights: u32::from(weights),
                statistic: statistic.spec(),
                color_bits: visible.color_bits,
                $($spec)* });
            stage(g, stringify!($kernel), &sgs_shaders::$kernel::KERNEL, bindings.entries(), specs.entries(), &[])
                .subgroup_size(Some(t.subgroup_size))
                .dispatch($groups)?
        }};
    }
    let tiles = groups(u64::from(screen.tiles()), 1);
    use sgs_shaders::{blend_bwd, blend_bwd_atomic, blend_bwd_bucket, blend_bwd_splat};
    macro_rules! add_tiles {
        ($kernel:ident, $gradients:ident) => {
            add!($kernel, $gradients, tiles, {}, {
                sub_tiles: t.sub_tiles,
                slot_margin: t.slot_margin,
                slot_width: t.slot_width,
            })
        };
    }
    match which {
        BackwardKernel::Pixel => add_tiles!(blend_bwd, entry_gradients),
        BackwardKernel::Splat => add_tiles!(blend_bwd_splat, entry_gradients),
        BackwardKernel::Atomic => add_tiles!(blend_bwd_atomic, splat_gradients),
        BackwardKernel::Bucket => {
            let b = gradient.buckets.ok_or_else(|| GraphError::Unbound {
                pass: "blend_bwd_bucket".to_owned(),
                shader: "blend_bwd_bucket".to_owned(),
                binding: "checkpoints".to_owned(),
            })?;
            add!(blend_bwd_bucket, entry_gradients, groups(u64::from(b.slots), 1),
                { checkpoints: b.checkpoints.into(), bucket_tiles: b.tiles.into(), },
                { own: OWN, bucket: b.entries, part_width: b.part[0], part_height: b.part[1], });
        }
    }
    Ok(EntryGradients { starts: entries.starts, gradients, features: None, weights, statistic, reduced })
}

pub(crate) fn per_lane(t: &Tuning, screen: &Screen) -> u32 {
    (screen.tile[0] * screen.tile[1] / t.subgroup_size).max(1)
}
