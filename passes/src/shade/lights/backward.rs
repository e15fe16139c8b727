//! Backward passes of lights: `lights_bwd`, `lights_prepare_bwd`, `lights_normals_bwd`. The first two compute gradients
//! of the lights, the last one gradients of normals.
//!
//! Guarantees: the passes need nothing from the forward pass and recompute everything. Sums have a fixed order, so that
//! results are bit-identical from run to run. Every gradient is written, zero for lights that are off.
//!
//! `lights_bwd` iterates over pixels, like the forward pass. Data of a pixel (its surface, the visibility field's
//! encoding of its point) is therefore computed once for all lights. A pair that faces takes 48 operations per lobe and
//! 200 more. With 64 lights of 12 lobes this is 64 (20 + 0.5 (576 + 200)) = 26000 per pixel: 2.0 Gop at 320x240, 50 Gop
//! at 1600x1200. The reduction across lanes adds 8 numbers per lobe for each block of pixels. Memory: 56 bytes per
//! pixel, and a row of `32 lights (1 + lobes)` bytes for each workgroup (27 KB), of which there are at most a few
//! hundred.

use super::{LightParameters, LightRegularizers, Lights, Prepared, Shape};
use crate::Tuning;
use crate::kernel::{groups, stage};
use crate::shade::Pixels;
use crate::shade::lights::forward::{lit_specs, of_lights};
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::{
    lights_bwd as kernel, lights_normals_bwd as normals, lights_prepare_bwd as finish, lights_reduce as reduce,
};

/// Gradients of prepared lights.
#[derive(Clone, Copy, Debug)]
pub struct LightGradients {
    /// Gradients as laid out in `lights_bwd.glsl`, `[lights * 8 (1 + lobes)]` floats.
    pub buffer: Buffer,
}

/// Destinations of the raw parameters' gradients, shaped like [`LightParameters`].
#[derive(Clone, Copy, Debug)]
pub struct LightParameterGradients {
    /// Gradients of positions, `[lights * 3]`.
    pub positions: Buffer,
    /// Gradients of lobes, `[lights * lobes * row]`.
    pub lobes: Buffer,
}

/// Maximum number of elements in an invocation's private arrays.
pub(in crate::shade) const OWN: u32 = 4096;

/// Returns the blocks of a workgroup, and the number of workgroups. `extra` is the number of loop iterations per block
/// beyond those of this kernel.
pub(in crate::shade) fn cut(
    tuning: Tuning,
    shape: &Shape,
    prepared: &Prepared,
    pixels: &Pixels,
    extra: u32,
) -> (u32, u32) {
    cut_blocks(tuning, shape, prepared, pixels.screen.pixels().div_ceil(u64::from(shape.block())) as u32, extra)
}

/// Returns the same as [`cut`] for a given number of blocks.
pub(in crate::shade) fn cut_blocks(
    tuning: Tuning,
    shape: &Shape,
    prepared: &Prepared,
    blocks: u32,
    extra: u32,
) -> (u32, u32) {
    // Each light of a block takes two iterations, and one per group of lobes.
    let groups = prepared.model.lobes.div_ceil(shape.subgroup / 8);
    let rounds = prepared.model.lights * (3 + groups) + 8 + extra;
    let most = (tuning.rounds / 2 / rounds).max(1);
    // Two workgroups per worker: fewer rows of partial sums matter more than perfect balance.
    let each = blocks.div_ceil(2 * tuning.workers).clamp(1, most);
    (each, blocks.div_ceil(each))
}

/// Writes the gradients of the prepared lights from `radiance_gradient`, `[P * 3]`.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn lights_bwd(
    g: &mut Graph,
    tuning: Tuning,
    a: &Lights,
    radiance_gradient: Buffer,
) -> Result<LightGradients, GraphError> {
    let (p, model, shape) = (&a.pixels, a.prepared.model, a.shape);
    let width = model.lights * 8 * (1 + model.lobes);
    let (blocks, workgroups) = cut(tuning, &shape, &a.prepared, p, 0);
    let partials = g.transient("lights_bwd.partials", 4 * u64::from(width) * u64::from(workgroups));
    g.fill("lights_bwd.clear", partials, 0)?;
    let bindings = of_lights!(kernel, a, {
        radiance_gradient: radiance_gradient.into(),
        partials: partials.into(),
    });
    let specs = lit_specs!(kernel, a, shape, {
        lights: model.lights,
        mine: shape.spread && shape.subgroup == 8 && model.lights * (1 + model.lobes) <= OWN,
    });
    let push = kernel::Push { normalizer: a.normalizer, blocks };
    stage(g, "lights_bwd", &kernel::KERNEL, bindings.entries(), specs.entries(), bytemuck::bytes_of(&push))
        .subgroup_size(Some(shape.subgroup))
        .dispatch(groups(u64::from(workgroups), 1))?;
    sum_rows(g, tuning, partials, width, workgroups)
}

/// Adds up the rows of partial sums that workgroups wrote.
pub(in crate::shade) fn sum_rows(
    g: &mut Graph,
    tuning: Tuning,
    partials: Buffer,
    width: u32,
    rows: u32,
) -> Result<LightGradients, GraphError> {
    let buffer = g.transient("lights_bwd.sums", 4 * u64::from(width));
    let bindings = reduce::Bindings { partials: partials.into(), light_gradients: buffer.into() };
    let parts = if tuning.narrow() { 1 } else { 8 };
    let specs = reduce::Specs { workgroup: tuning.workgroup, parts };
    let push = reduce::Push { width, rows };
    stage(g, "lights_reduce", &reduce::KERNEL, bindings.entries(), specs.entries(), bytemuck::bytes_of(&push))
        .dispatch(groups(u64::from(width), tuning.workgroup / parts))?;
    Ok(LightGradients { buffer })
}

/// Writes `normals_gradient`, `[P * 3]`: gradients of unit normals. Only the component orthogonal to the normal is
/// written. Pixels without a surface are zero. The cost is that of [`super::lights_train`].
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn lights_normals_bwd(
    g: &mut Graph,
    a: &Lights,
    radiance_gradient: Buffer,
    normals_gradient: Buffer,
) -> Result<(), GraphError> {
    let (p, shape) = (&a.pixels, a.shape);
    let bindings = of_lights!(normals, a, {
        radiance_gradient: radiance_gradient.into(),
        normals_gradient: normals_gradient.into(),
    });
    let specs = lit_specs!(normals, a, shape, {});
    let push = normals::Push { normalizer: a.normalizer };
    let name = "lights_normals_bwd";
    stage(g, name, &normals::KERNEL, bindings.entries(), specs.entries(), bytemuck::bytes_of(&push))
        .subgroup_size(Some(shape.subgroup))
        .dispatch(groups(p.screen.pixels(), shape.block()))
}

/// Writes the gradients of the raw parameters. Includes those of the regularizers, if present.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn lights_prepare_bwd(
    g: &mut Graph,
    prepared: &Prepared,
    parameters: &LightParameters,
    gradients: &LightGradients,
    regularizers: Option<&LightRegularizers>,
    into: &LightParameterGradients,
) -> Result<(), GraphError> {
    let model = prepared.model;
    let bindings = finish::Bindings {
        lobes: parameters.lobes.into(),
        gains: parameters.gains.into(),
        prepared: prepared.lights.into(),
        light_gradients: gradients.buffer.into(),
        nearest: regularizers.map_or(gradients.buffer, |r| r.nearest).into(),
        points: regularizers.map_or(gradients.buffer, |r| r.points).into(),
        positions_gradient: into.positions.into(),
        lobes_gradient: into.lobes.into(),
    };
    let workgroup = 64;
    let specs =
        finish::Specs { workgroup, lobes: model.lobes, free: model.is_free(), regularize: regularizers.is_some() };
    let push = finish::Push {
        lights: model.lights,
        weight_near: regularizers.map_or(0.0, |r| r.weight_near),
        weight_brightness: regularizers.map_or(0.0, |r| r.weight_brightness),
    };
    let name = "lights_prepare_bwd";
    stage(g, name, &finish::KERNEL, bindings.entries(), specs.entries(), bytemuck::bytes_of(&push))
        .dispatch(groups(u64::from(model.lights) * u64::from(model.lobes), workgroup))
}
