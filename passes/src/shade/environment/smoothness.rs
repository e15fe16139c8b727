//! `environment_smoothness` and `environment_clamp`: regularization of the texels.
//!
//! Smoothness is the weight times the mean, over a map of 512 by 1024 pixels, of squared differences between each pixel
//! and its neighbors below and to the right. For cubes of up to [`Environment::FORM`] texels a side, the term is a
//! fixed quadratic form ([`super::form`]). It costs about ten entries of 8 bytes and their texels per texel. Finer
//! cubes are looked up at the map's pixels ([`super::map`]), and derivatives go back through the same lookups. This
//! costs about 160 bytes per pixel, and per texel 16 bytes plus 20 for each of its pixels.

use super::{Environment, EnvironmentTables, SmoothnessTables};
use crate::Tuning;
use crate::kernel::{groups, stage};
use sgs_engine::graph::{Buffer, Graph, GraphError, Slice};
use sgs_shaders::environment_clamp as clamp;
use sgs_shaders::environment_smoothness as kernel;
use sgs_shaders::{environment_map, environment_map_bwd, environment_map_smoothness};

/// Smoothness term of an environment map, added to its gradients.
#[derive(Clone, Copy, Debug)]
pub struct Smoothness {
    texels: Buffer,
    tables: SmoothnessTables,
    count: u32,
    weight: f32,
    /// Unweighted term by workgroup, `[groups]` floats.
    pub sums: Buffer,
    /// Number of workgroups.
    pub groups: u32,
}

/// Declares the term, whose passes [`super::environment_filter_bwd`] adds. Returns `None` if the environment map was
/// created without smoothness.
pub fn environment_smoothness(
    g: &mut Graph,
    t: &Tuning,
    e: &Environment,
    tables: &EnvironmentTables,
    texels: Buffer,
    weight: f32,
) -> Option<Smoothness> {
    let tables = tables.smoothness?;
    let count = 6 * e.size * e.size;
    let summed = match tables {
        SmoothnessTables::Form(_) => count,
        SmoothnessTables::Map(_, [w, h]) => w * h,
    };
    let groups = summed.div_ceil(t.workgroup);
    let sums = g.transient("environment_smoothness.sums", 4 * u64::from(groups));
    Some(Smoothness { texels, tables, count, weight, sums, groups })
}

impl Smoothness {
    /// Adds the passes that write `gradient`.
    pub(super) fn add(&self, g: &mut Graph, t: &Tuning, gradient: Slice) -> Result<(), GraphError> {
        match self.tables {
            SmoothnessTables::Form(form) => self.by_form(g, t, form, gradient),
            SmoothnessTables::Map(tables, size) => self.by_map(g, t, (tables, size), gradient),
        }
    }

    fn by_map(
        &self,
        g: &mut Graph,
        t: &Tuning,
        ([footprints, starts, entries], size): ([Buffer; 3], [u32; 2]),
        gradient: Slice,
    ) -> Result<(), GraphError> {
        let [w, h] = size;
        let pixels = u64::from(w) * u64::from(h);
        let map = g.transient("environment.map", 12 * pixels);
        let slopes = g.transient("environment.map_slopes", 12 * pixels);
        let bindings =
            environment_map::Bindings { texels: self.texels.into(), footprints: footprints.into(), map: map.into() };
        let specs = environment_map::Specs { workgroup: t.workgroup };
        let push = environment_map::Push { pixels: w * h };
        let (of, bytes) = (&environment_map::KERNEL, bytemuck::bytes_of(&push));
        stage(g, "environment_map", of, bindings.entries(), specs.entries(), bytes)
            .dispatch(groups(pixels, t.workgroup))?;
        let bindings =
            environment_map_smoothness::Bindings { map: map.into(), slopes: slopes.into(), sums: self.sums.into() };
        let specs = environment_map_smoothness::Specs { workgroup: t.workgroup };
        let mean = |rows: u32| (1.0 / (3.0 * f64::from(w) * f64::from(rows))) as f32;
        let push = environment_map_smoothness::Push { size, across: mean(h), down: mean(h - 1) };
        let (of, bytes) = (&environment_map_smoothness::KERNEL, bytemuck::bytes_of(&push));
        stage(g, "environment_map_smoothness", of, bindings.entries(), specs.entries(), bytes)
            .dispatch(groups(pixels, t.workgroup))?;
        let bindings = environment_map_bwd::Bindings {
            slopes: slopes.into(),
            row_starts: starts.into(),
            row_entries: entries.into(),
            gradient,
        };
        let specs = environment_map_bwd::Specs { workgroup: t.workgroup };
        let push = environment_map_bwd::Push { texels: self.count, weight: self.weight };
        let (of, bytes) = (&environment_map_bwd::KERNEL, bytemuck::bytes_of(&push));
        stage(g, "environment_map_bwd", of, bindings.entries(), specs.entries(), bytes)
            .dispatch(groups(u64::from(self.count), t.workgroup))
    }

    fn by_form(&self, g: &mut Graph, t: &Tuning, form: [Buffer; 2], gradient: Slice) -> Result<(), GraphError> {
        let bindings = kernel::Bindings {
            texels: self.texels.into(),
            row_starts: form[0].into(),
            row_entries: form[1].into(),
            gradient,
            sums: self.sums.into(),
        };
        let specs = kernel::Specs { workgroup: t.workgroup };
        let push = kernel::Push { texels: self.count, weight: self.weight };
        let bytes = bytemuck::bytes_of(&push);
        stage(g, "environment_smoothness", &kernel::KERNEL, bindings.entries(), specs.entries(), bytes)
            .dispatch(groups(u64::from(self.count), t.workgroup))
    }
}

/// Adds the pass that clamps negative texels to zero after an optimizer step.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn environment_clamp(g: &mut Graph, t: &Tuning, e: &Environment, texels: Buffer) -> Result<(), GraphError> {
    let bindings = clamp::Bindings { texels: texels.into() };
    let specs = clamp::Specs { workgroup: t.workgroup };
    let push = clamp::Push { count: e.floats() };
    let bytes = bytemuck::bytes_of(&push);
    stage(g, "environment_clamp", &clamp::KERNEL, bindings.entries(), specs.entries(), bytes)
        .dispatch(groups(u64::from(e.floats()), t.workgroup))
}
