//! `environment_mips` and `environment_prefilter`: filtering and its exact adjoint. The passes filter the texels of an
//! environment map into prefiltered levels, and take gradients back to the texels.
//!
//! Cost: [`super::Environment::levels`] gives the reach of each level's lobe. Each product costs about 20 operations. A
//! subgroup works on blocks of 32 texels or more that share their reads.

use super::levels::Level;
use super::smoothness::Smoothness;
use super::{Environment, EnvironmentSums, EnvironmentTables};
use crate::Tuning;
use crate::kernel::{groups, stage};
use sgs_engine::graph::{Buffer, Graph, GraphError, Slice};
use sgs_shaders::{
    environment_collect, environment_gather, environment_mips, environment_mips_bwd, environment_prefilter,
    environment_prefilter_bwd,
};

/// Prefiltered environment map that surfaces look up.
#[derive(Clone, Copy, Debug)]
pub struct Filtered {
    /// Prefiltered radiance, `[texels of all levels * 3]`.
    pub radiance: Buffer,
    /// Inverse of the sum of each filter's weights, `[texels of all levels]`.
    pub inverse_sums: Buffer,
}

impl Filtered {
    /// Wraps levels that another graph left in memory. The result supports lookups, not gradients.
    pub fn from_radiance(radiance: Buffer) -> Filtered {
        Filtered { radiance, inverse_sums: radiance }
    }
}

/// Persistent levels and the gradients that steps accumulate between updates.
#[derive(Clone, Copy, Debug)]
pub struct StoredFilter {
    /// Prefiltered radiance, `[texels of all levels * 3]`.
    pub radiance: Buffer,
    /// Inverse of the sum of each filter's weights, `[texels of all levels]`.
    pub inverse_sums: Buffer,
    /// Accumulated gradients over the sums of weights, `[texels of all levels * 3]`.
    pub gathered: Buffer,
}

impl StoredFilter {
    /// Returns the sizes of the buffers in bytes, in declaration order.
    pub fn bytes(e: &Environment) -> [u64; 3] {
        let all = u64::from(e.filtered_texels());
        [12 * all, 4 * all, 12 * all]
    }

    /// Declares the buffers in a graph. Set `moving` in the graph that filters and updates the texels. Other graphs
    /// only look up levels and accumulate gradients.
    pub fn declare(g: &mut Graph, e: &Environment, moving: bool) -> StoredFilter {
        let [radiance, inverse_sums, gathered] = StoredFilter::bytes(e);
        let mut fixed = |name: &str, bytes: u64| match moving {
            true => g.external(format!("environment.kept_{name}"), bytes),
            false => g.input(format!("environment.kept_{name}"), bytes),
        };
        let (radiance, inverse_sums) = (fixed("radiance", radiance), fixed("inverse_sums", inverse_sums));
        StoredFilter { radiance, inverse_sums, gathered: g.external("environment.gathered", gathered) }
    }

    /// Returns the levels in the form that lookups take.
    pub fn filtered(&self) -> Filtered {
        Filtered { radiance: self.radiance, inverse_sums: self.inverse_sums }
    }

    /// Adds the pass that accumulates a step's gradients, scaled by `share`.
    ///
    /// # Errors
    /// If a buffer does not belong to the graph or is too small to be bound.
    pub fn gather(
        &self,
        g: &mut Graph,
        t: &Tuning,
        e: &Environment,
        sums: &EnvironmentSums,
        share: f32,
    ) -> Result<(), GraphError> {
        let texels = e.filtered_texels();
        let bindings = environment_gather::Bindings {
            texel_sums: sums.texel_sums.into(),
            largest: sums.largest.into(),
            inverse_sums: self.inverse_sums.into(),
            gathered: self.gathered.into(),
        };
        let specs = environment_gather::Specs { workgroup: t.workgroup, fixed_bits: sums.bits };
        let push = environment_gather::Push { texels, share };
        let (kernel, bytes) = (&environment_gather::KERNEL, bytemuck::bytes_of(&push));
        stage(g, "environment_gather", kernel, bindings.entries(), specs.entries(), bytes)
            .dispatch(groups(3 * u64::from(texels), t.workgroup))
    }
}

/// Returns the columns of a block and the rows of a lane. A processor shares each fetched texel among several output
/// texels. Where the cone is narrow, a nearly square block needs the fewest texels that only some of its outputs use.
fn block(t: &Tuning, level: &Level) -> [u32; 2] {
    let narrow = level.reach() < 16.0 * std::f64::consts::FRAC_PI_2 / f64::from(level.size);
    match (t.narrow(), narrow) {
        (true, true) => [4, 2],
        (true, false) => [8, 4],
        (false, _) => [8, 1],
    }
}

fn floats(texels: u32) -> u64 {
    12 * u64::from(texels)
}

/// Push constants that describe a lobe to the kernels.
macro_rules! push {
    ($kernel:ident, $level:expr) => {
        $kernel::Push {
            size: $level.size,
            steep: $level.steep() as f32,
            cutoff: $level.cutoff as f32,
            fade: $level.fade() as f32,
            reach: $level.reach() as f32,
        }
    };
}

/// Returns the number of workgroups of a level.
fn blocks(t: &Tuning, level: &Level) -> [u32; 3] {
    let [columns, rows] = block(t, level);
    let height = t.subgroup_size / columns * rows;
    groups(u64::from(6 * (level.size / columns) * (level.size / height)), 1)
}

/// Adds the passes that filter the environment map stored in `texels`.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn environment_filter(
    g: &mut Graph,
    t: &Tuning,
    e: &Environment,
    tables: &EnvironmentTables,
    texels: Buffer,
) -> Result<Filtered, GraphError> {
    let radiance = g.transient("environment.radiance", floats(e.filtered_texels()));
    let inverse_sums = g.transient("environment.inverse_sums", 4 * u64::from(e.filtered_texels()));
    filter_into(g, t, e, tables, texels, Filtered { radiance, inverse_sums })
}

/// Adds the passes of [`environment_filter`], which write persistent levels.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn environment_filter_stored(
    g: &mut Graph,
    t: &Tuning,
    e: &Environment,
    tables: &EnvironmentTables,
    texels: Buffer,
    filter: &StoredFilter,
) -> Result<(), GraphError> {
    filter_into(g, t, e, tables, texels, filter.filtered()).map(|_| ())
}

fn filter_into(
    g: &mut Graph,
    t: &Tuning,
    e: &Environment,
    tables: &EnvironmentTables,
    texels: Buffer,
    into: Filtered,
) -> Result<Filtered, GraphError> {
    // Reduces to the coarsest mip that any level is filtered from; the last level always has size 16.
    let mut mips = vec![(e.size, texels)];
    while let Some(&(size, finer)) = mips.last()
        && size > 16
    {
        let half = size / 2;
        let coarser = g.transient(format!("environment.mip{half}"), floats(6 * half * half));
        let bindings = environment_mips::Bindings { finer: finer.into(), coarser: coarser.into() };
        let specs = environment_mips::Specs { workgroup: t.workgroup };
        let push = environment_mips::Push { size: half };
        let name = format!("environment_mips{half}");
        stage(g, &name, &environment_mips::KERNEL, bindings.entries(), specs.entries(), bytemuck::bytes_of(&push))
            .dispatch(groups(u64::from(6 * half * half), t.workgroup))?;
        mips.push((half, coarser));
    }
    let mip = |size: u32| mips.iter().find(|(s, _)| *s == size).map_or(texels, |(_, b)| *b);
    let Filtered { radiance, inverse_sums } = into;
    for (i, level) in e.levels.iter().enumerate() {
        let part = |buffer: Buffer, floats: u64| Slice {
            buffer,
            offset: 4 * floats * u64::from(level.first),
            bytes: 4 * floats * u64::from(level.texels()),
        };
        let bindings = environment_prefilter::Bindings {
            source: mip(level.size).into(),
            areas: e.areas(tables, level.size),
            target: part(radiance, 3),
            inverse_sums: part(inverse_sums, 1),
        };
        let [columns, rows] = block(t, level);
        let specs = environment_prefilter::Specs { subgroup: t.subgroup_size, rows, columns };
        let push = push!(environment_prefilter, level);
        let (kernel, name) = (&environment_prefilter::KERNEL, format!("environment_prefilter{i}"));
        stage(g, &name, kernel, bindings.entries(), specs.entries(), bytemuck::bytes_of(&push))
            .subgroup_size(Some(t.subgroup_size))
            .dispatch(blocks(t, level))?;
    }
    Ok(into)
}

/// Adds the passes that write the texels' `gradient`. Its inputs are the sums that [`super::environment_bwd`] left and
/// the smoothness term.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
#[expect(clippy::too_many_arguments, reason = "declares a kernel")]
pub fn environment_filter_bwd(
    g: &mut Graph,
    t: &Tuning,
    e: &Environment,
    tables: &EnvironmentTables,
    filtered: &Filtered,
    sums: &EnvironmentSums,
    smoothness: Option<&Smoothness>,
    gradient: Buffer,
) -> Result<(), GraphError> {
    let texels = e.filtered_texels();
    let scaled = g.transient("environment.scaled", floats(texels));
    let bindings = environment_collect::Bindings {
        texel_sums: sums.texel_sums.into(),
        largest: sums.largest.into(),
        inverse_sums: filtered.inverse_sums.into(),
        scaled: scaled.into(),
    };
    let specs = environment_collect::Specs { workgroup: t.workgroup, fixed_bits: sums.bits };
    let push = environment_collect::Push { texels };
    let (kernel, bytes) = (&environment_collect::KERNEL, bytemuck::bytes_of(&push));
    stage(g, "environment_collect", kernel, bindings.entries(), specs.entries(), bytes)
        .dispatch(groups(3 * u64::from(texels), t.workgroup))?;
    back(g, t, e, tables, scaled, smoothness, gradient)
}

/// Adds the passes that write the texels' `gradient` from accumulated gradients.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn environment_filter_stored_bwd(
    g: &mut Graph,
    t: &Tuning,
    e: &Environment,
    tables: &EnvironmentTables,
    filter: &StoredFilter,
    smoothness: Option<&Smoothness>,
    gradient: Buffer,
) -> Result<(), GraphError> {
    back(g, t, e, tables, filter.gathered, smoothness, gradient)
}

fn back(
    g: &mut Graph,
    t: &Tuning,
    e: &Environment,
    tables: &EnvironmentTables,
    scaled: Buffer,
    smoothness: Option<&Smoothness>,
    gradient: Buffer,
) -> Result<(), GraphError> {
    let texels = e.filtered_texels();
    let parts = e.parts(smoothness.is_some());
    let smoothed = parts[e.levels.len()..].iter().map(|(_, size)| 6 * size * size).sum::<u32>();
    let mip_gradients = g.transient("environment.mip_gradients", floats(texels + smoothed));
    for (i, level) in e.levels.iter().enumerate() {
        let part = |buffer: Buffer| Slice { buffer, offset: floats(level.first), bytes: floats(level.texels()) };
        let bindings = environment_prefilter_bwd::Bindings {
            source: part(scaled),
            areas: e.areas(tables, level.size),
            target: part(mip_gradients),
        };
        let [columns, rows] = block(t, level);
        let specs = environment_prefilter_bwd::Specs { subgroup: t.subgroup_size, rows, columns };
        let push = push!(environment_prefilter_bwd, level);
        let (kernel, name) = (&environment_prefilter_bwd::KERNEL, format!("environment_prefilter{i}_bwd"));
        stage(g, &name, kernel, bindings.entries(), specs.entries(), bytemuck::bytes_of(&push))
            .subgroup_size(Some(t.subgroup_size))
            .dispatch(blocks(t, level))?;
    }
    if let Some(s) = smoothness {
        let part = Slice { buffer: mip_gradients, offset: floats(texels), bytes: floats(smoothed) };
        s.add(g, t, part)?;
    }
    let mut push = environment_mips_bwd::Push { size: e.size, ..Default::default() };
    for (i, (first, size)) in parts.iter().enumerate() {
        push.first[i] = *first;
        push.shift[i] = (e.size / size).ilog2();
    }
    let bindings = environment_mips_bwd::Bindings { mip_gradients: mip_gradients.into(), gradient: gradient.into() };
    let specs = environment_mips_bwd::Specs { workgroup: t.workgroup, parts: parts.len() as u32 };
    let (kernel, bytes) = (&environment_mips_bwd::KERNEL, bytemuck::bytes_of(&push));
    stage(g, "environment_mips_bwd", kernel, bindings.entries(), specs.entries(), bytes)
        .dispatch(groups(u64::from(6 * e.size * e.size), t.workgroup))
}
