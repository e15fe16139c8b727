//! `environment_smoothness` and `environment_clamp`: what the texels are asked for besides light.
//!
//! Smoothness is weight times the mean, over a map of 512 by 1024 pixels, of squared differences of neighbors, down and to
//! the right: a fixed quadratic form ([`super::form`]). Cost a texel: about ten entries of 8 bytes and their texels.

use super::{Environment, EnvironmentTables, Filtered};
use crate::Tuning;
use crate::kernel::{groups, stage};
use sgs_engine::graph::{Buffer, Graph, GraphError, Slice};
use sgs_shaders::environment_clamp as clamp;
use sgs_shaders::environment_smoothness as kernel;

/// The smoothness of an environment, to be added to its gradients.
#[derive(Clone, Copy, Debug)]
pub struct Smoothness {
    texels: Buffer,
    form: [Buffer; 2],
    count: u32,
    weight: f32,
    /// `[groups]` floats: the term without its weight, by workgroup.
    pub sums: Buffer,
    /// Number of workgroups.
    pub groups: u32,
}

/// Declares the term; [`super::environment_filter_bwd`] adds its pass. None if the environment was made without it.
pub fn environment_smoothness(
    g: &mut Graph,
    t: &Tuning,
    e: &Environment,
    tables: &EnvironmentTables,
    texels: Buffer,
    filtered: &Filtered,
    weight: f32,
) -> Option<Smoothness> {
    let form = tables.form?;
    let size = e.size.min(Environment::SMOOTHED);
    let count = 6 * size * size;
    let groups = count.div_ceil(t.workgroup);
    let sums = g.transient("environment_smoothness.sums", 4 * u64::from(groups));
    Some(Smoothness { texels: filtered.smoothed.unwrap_or(texels), form, count, weight, sums, groups })
}

impl Smoothness {
    /// Adds the pass, which writes `gradient`.
    pub(super) fn add(&self, g: &mut Graph, t: &Tuning, gradient: Slice) -> Result<(), GraphError> {
        let bindings = kernel::Bindings {
            texels: self.texels.into(),
            row_starts: self.form[0].into(),
            row_entries: self.form[1].into(),
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

/// Adds the pass that makes negative texels black, after a step of the optimizer.
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
