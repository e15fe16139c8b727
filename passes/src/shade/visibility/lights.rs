//! Lights with learned visibility: forward passes and gradients. Kernels: `lights_field`, `lights_train_field`,
//! `lights_bwd_field` and `visibility_lights_bwd`, which trains the field.
//!
//! The passes follow [`crate::shade::lights`], with one pixel per lane. The unoccluded light of a pair is multiplied by
//! its visibility. The gradient of visibility is the gradient of the pixel's radiance times the unoccluded light, which
//! is recomputed where needed. Regularization covers the lights that are on.

use super::bwd::{Plan, pass_name};
use super::{BackwardOptions, Field, Gradients, View, field_batched, field_spread, forward};
use crate::Tuning;
use crate::kernel::{groups, stage};
use crate::shade::lights::backward::{OWN, cut, sum_rows};
use crate::shade::lights::forward::{lit_specs, of_lights};
use crate::shade::lights::{LightGradients, Lights, Shape, Sums};
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::{
    lights_bwd_field as lights_kernel, lights_field as render, lights_field_halves as render_halves,
    lights_normals_bwd_field as normals, lights_split_field as split, lights_split_field_halves as split_halves,
    lights_train_field as train, lights_train_field_halves as train_halves, visibility_lights_bwd as pairs,
    visibility_lights_bwd_halves as halves, visibility_lights_bwd_lanes as lanes,
};

/// Writes `direct`, `[P * 3]` floats: linear radiance towards the camera. Ignores `per_lane` of `a.shape`.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn lights_field(
    g: &mut Graph,
    tuning: Tuning,
    a: &Lights,
    field: &Field,
    direct: Buffer,
) -> Result<(), GraphError> {
    let p = &a.pixels;
    let shape = Shape { per_lane: 1, ..a.shape };
    let bindings = of_lights!(render, a, {
        field_params: field.step.into(),
        field_levels: field.levels.into(),
        tables: field.lookup().into(),
        packed_tables: field.lookup().into(),
        mlp: field.mlp.into(),
        mlp_vectors: field.mlp.into(),
        direct: direct.into(),
    });
    let specs = lit_specs!(render, a, shape, {
        levels: field.config.levels,
        field_spread: field_spread(tuning),
        table_bits: field.table_bits(),
    });
    let push = render::Push { normalizer: a.normalizer };
    let (kernel, specs) = forward(tuning, [&render::KERNEL, &render_halves::KERNEL], specs.entries());
    stage(g, kernel.name, kernel, bindings.entries(), specs, bytemuck::bytes_of(&push))
        .subgroup_size(Some(shape.subgroup))
        .dispatch(groups(p.screen.pixels(), shape.block()))
}

/// Writes `direct` like [`lights_field`], and its diffuse term. `diffuse` is `[P * 3]`. The remainder is specular.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn lights_split_field(
    g: &mut Graph,
    tuning: Tuning,
    a: &Lights,
    field: &Field,
    direct: Buffer,
    diffuse: Buffer,
) -> Result<(), GraphError> {
    let p = &a.pixels;
    let shape = Shape { per_lane: 1, ..a.shape };
    let bindings = of_lights!(split, a, {
        field_params: field.step.into(),
        field_levels: field.levels.into(),
        tables: field.lookup().into(),
        packed_tables: field.lookup().into(),
        mlp: field.mlp.into(),
        mlp_vectors: field.mlp.into(),
        direct: direct.into(),
        diffuse: diffuse.into(),
    });
    let specs = lit_specs!(split, a, shape, {
        levels: field.config.levels,
        field_spread: field_spread(tuning),
        table_bits: field.table_bits(),
    });
    let push = split::Push { normalizer: a.normalizer };
    let (kernel, specs) = forward(tuning, [&split::KERNEL, &split_halves::KERNEL], specs.entries());
    stage(g, kernel.name, kernel, bindings.entries(), specs, bytemuck::bytes_of(&push))
        .subgroup_size(Some(shape.subgroup))
        .dispatch(groups(p.screen.pixels(), shape.block()))
}

/// Writes `direct` like [`lights_field`], and stores sums for the backward pass.
/// [`crate::shade::lights::lights_materials_bwd`] reads the sums.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn lights_train_field(
    g: &mut Graph,
    tuning: Tuning,
    a: &Lights,
    field: &Field,
    direct: Buffer,
) -> Result<Sums, GraphError> {
    let p = &a.pixels;
    let shape = Shape { per_lane: 1, ..a.shape };
    let sums = g.transient("lights.sums", p.screen.pixels() * if p.materials.metallic.is_some() { 48 } else { 24 });
    let bindings = of_lights!(train, a, {
        field_params: field.step.into(),
        field_levels: field.levels.into(),
        tables: field.lookup().into(),
        packed_tables: field.lookup().into(),
        mlp: field.mlp.into(),
        mlp_vectors: field.mlp.into(),
        direct: direct.into(),
        sums: sums.into(),
    });
    let specs = lit_specs!(train, a, shape, {
        levels: field.config.levels,
        field_spread: field_spread(tuning),
        table_bits: field.table_bits(),
    });
    let push = train::Push { normalizer: a.normalizer };
    let (kernel, specs) = forward(tuning, [&train::KERNEL, &train_halves::KERNEL], specs.entries());
    stage(g, kernel.name, kernel, bindings.entries(), specs, bytemuck::bytes_of(&push))
        .subgroup_size(Some(shape.subgroup))
        .dispatch(groups(p.screen.pixels(), shape.block()))?;
    Ok(Sums { buffer: sums })
}

/// Computes [`crate::shade::lights::lights_bwd`] with learned visibility. Visibility counts as a constant:
/// [`visibility_lights_bwd`] computes the light gradients that pass through it.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn lights_bwd_field(
    g: &mut Graph,
    tuning: Tuning,
    a: &Lights,
    field: &Field,
    radiance_gradient: Buffer,
) -> Result<LightGradients, GraphError> {
    let (p, model) = (&a.pixels, a.prepared.model);
    let shape = Shape { per_lane: 1, ..a.shape };
    let width = model.lights * 8 * (1 + model.lobes);
    // Encoding a block's point iterates over the levels.
    let (blocks, workgroups) = cut(tuning, &shape, &a.prepared, p, 2 * field.config.levels + 8);
    let partials = g.transient("lights_bwd.partials", 4 * u64::from(width) * u64::from(workgroups));
    g.fill("lights_bwd.clear", partials, 0)?;
    let bindings = of_lights!(lights_kernel, a, {
        field_params: field.step.into(),
        field_levels: field.levels.into(),
        tables: field.lookup().into(),
        packed_tables: field.lookup().into(),
        mlp: field.mlp.into(),
        mlp_vectors: field.mlp.into(),
        radiance_gradient: radiance_gradient.into(),
        partials: partials.into(),
    });
    let specs = lit_specs!(lights_kernel, a, shape, {
        lights: model.lights,
        mine: shape.spread && shape.subgroup == 8 && model.lights * (1 + model.lobes) <= OWN,
        levels: field.config.levels,
        field_spread: field_spread(tuning),
        table_bits: field.table_bits(),
    });
    let push = lights_kernel::Push { normalizer: a.normalizer, blocks };
    let bytes = bytemuck::bytes_of(&push);
    stage(g, "lights_bwd_field", &lights_kernel::KERNEL, bindings.entries(), specs.entries(), bytes)
        .subgroup_size(Some(shape.subgroup))
        .dispatch(groups(u64::from(workgroups), 1))?;
    sum_rows(g, tuning, partials, width, workgroups)
}

/// Computes [`crate::shade::lights::lights_normals_bwd`] with learned visibility. Visibility does not depend on
/// normals.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn lights_normals_bwd_field(
    g: &mut Graph,
    tuning: Tuning,
    a: &Lights,
    field: &Field,
    radiance_gradient: Buffer,
    normals_gradient: Buffer,
) -> Result<(), GraphError> {
    let p = &a.pixels;
    let shape = Shape { per_lane: 1, ..a.shape };
    let bindings = of_lights!(normals, a, {
        field_params: field.step.into(),
        field_levels: field.levels.into(),
        tables: field.lookup().into(),
        packed_tables: field.lookup().into(),
        mlp: field.mlp.into(),
        mlp_vectors: field.mlp.into(),
        radiance_gradient: radiance_gradient.into(),
        normals_gradient: normals_gradient.into(),
    });
    let specs = lit_specs!(normals, a, shape, {
        levels: field.config.levels,
        field_spread: field_spread(tuning),
        table_bits: field.table_bits(),
    });
    let push = normals::Push { normalizer: a.normalizer };
    let name = "lights_normals_bwd_field";
    stage(g, name, &normals::KERNEL, bindings.entries(), specs.entries(), bytemuck::bytes_of(&push))
        .subgroup_size(Some(shape.subgroup))
        .dispatch(groups(p.screen.pixels(), shape.block()))
}

/// Computes [`super::visibility_bwd`] under prepared lights. Gradients of light positions are only those that pass
/// through the field. Returns the weighted partial sums of the smoothness term, and their number.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn visibility_lights_bwd(
    g: &mut Graph,
    tuning: Tuning,
    a: &Lights,
    field: &Field,
    radiance_gradient: Buffer,
    options: &BackwardOptions,
    into: &Gradients,
) -> Result<Option<(Buffer, u32)>, GraphError> {
    let p = &a.pixels;
    let most = a.prepared.model.lights;
    let view = View {
        pixels: p.screen.pixels() as u32,
        points: p.surfaces.points,
        coverage: p.surfaces.coverage,
        lights: a.prepared.lights,
    };
    let plan = Plan::new(g, tuning, field, &view, [most, a.prepared.model.lobes], options)?;
    for (first, count) in plan.chunks() {
        let [rows, moved] = plan.rows(g, field, &view, [first, count])?;
        let chunk = plan.chunk(first, count);
        macro_rules! of_pairs {
            ($kernel:ident, $weights:ident, $chosen:expr) => {{
                let bindings = of_lights!($kernel, a, {
                    field_params: field.step.into(),
                    $weights: field.mlp.into(),
                    rows: rows.into(),
                    moved_rows: moved.into(),
                    row_gradients: chunk.gradients,
                    sums_of: chunk.sums,
                    place_sums: plan.places.into(),
                    jitter_sums: plan.jitter.into(),
                    radiance_gradient: radiance_gradient.into(),
                });
                let specs = $kernel::Specs {
                    subgroup: a.shape.subgroup,
                    lobes: a.prepared.model.lobes,
                    metallic: p.materials.metallic.is_some(),
                    per_lane: 1,
                    spread: a.shape.spread,
                    levels: field.config.levels,
                    regularized: options.regularized,
                    places: options.places,
                    sample: options.sample,
                    parts: plan.parts,
                };
                let push = $kernel::Push { first, count, most, normalizer: a.normalizer };
                let (kernel, specs) = $chosen(specs.entries());
                stage(g, pass_name(kernel), kernel, bindings.entries(), specs, bytemuck::bytes_of(&push))
                    .subgroup_size(Some(a.shape.subgroup))
                    .dispatch([chunk.groups, 1, 1])?;
            }};
        }
        match field_batched(tuning) {
            true => of_pairs!(pairs, mlp_vectors, |specs| forward(tuning, [&pairs::KERNEL, &halves::KERNEL], specs)),
            false => of_pairs!(lanes, mlp, |specs| (&lanes::KERNEL, specs)),
        }
    }
    plan.finish(g, field, &view, into)?;
    Ok(plan.jitter())
}
