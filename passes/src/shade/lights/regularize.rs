//! `lights_near`, `lights_regularize`: regularizers of lights.
//!
//! The regularizers are two means (SGS-Intrinsic, as in the published code): `1 / max(d², 1e-3)` over the lights, with
//! d the distance to the nearest visible point of the view, and three times the mean of all amplitudes. Lights that are
//! off count as zeros, so that the weight of one light never depends on the others. The gradient of the first mean goes
//! through the nearest pixel, the one with the lowest index among equals. [`super::lights_prepare_bwd`] adds the
//! gradients.
//!
//! Guarantees: results are bit-identical from run to run. Cost: 10 operations per pair of pixel and light (49 Mop at
//! 320x240 with 64 lights, a twentieth of shading), 16 bytes per pixel.

use super::{LightParameters, Lights};
use crate::Tuning;
use crate::kernel::{groups, stage};
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::{lights_near as near, lights_regularize as regularize};

/// Regularizer data that [`super::lights_prepare_bwd`] needs to add gradients.
#[derive(Clone, Copy, Debug)]
pub struct LightRegularizers {
    /// By light: bits of the squared distance, and the pixel.
    pub nearest: Buffer,
    /// Weight of the mean of `1 / max(d², 1e-3)`; 1e-6 as published.
    pub weight_near: f32,
    /// Weight of three times the mean of the amplitudes; 1e-4 as published.
    pub weight_brightness: f32,
    /// Points of the pixels.
    pub points: Buffer,
}

/// Finds the nearest points and writes the two unweighted losses to `losses`. `losses` holds two floats.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn lights_regularize(
    g: &mut Graph,
    tuning: Tuning,
    a: &Lights,
    parameters: &LightParameters,
    weights: [f32; 2],
    losses: Buffer,
) -> Result<LightRegularizers, GraphError> {
    let (p, model, shape) = (&a.pixels, a.prepared.model, a.shape);
    let blocks = p.screen.pixels().div_ceil(u64::from(shape.block())) as u32;
    let most = (tuning.rounds / 2 / (model.lights + 16)).max(1);
    let each = blocks.div_ceil(2 * tuning.workers).clamp(1, most);
    let workgroups = blocks.div_ceil(each);
    let partials = g.transient("lights_near.partials", 8 * u64::from(model.lights) * u64::from(workgroups));
    let bindings = near::Bindings {
        params: p.screen.step.into(),
        prepared: a.prepared.lights.into(),
        light_list: a.prepared.list.into(),
        points: p.surfaces.points.into(),
        coverage: p.surfaces.coverage.into(),
        near_partials: partials.into(),
    };
    let specs =
        near::Specs { subgroup: shape.subgroup, lobes: model.lobes, lights: model.lights, per_lane: shape.per_lane };
    let push = near::Push { blocks: each, groups: workgroups };
    stage(g, "lights_near", &near::KERNEL, bindings.entries(), specs.entries(), bytemuck::bytes_of(&push))
        .subgroup_size(Some(shape.subgroup))
        .dispatch(groups(u64::from(workgroups), 1))?;
    let nearest = g.transient("lights.nearest", 8 * u64::from(model.lights));
    let bindings = regularize::Bindings {
        near_partials: partials.into(),
        lobes: parameters.lobes.into(),
        gains: parameters.gains.into(),
        nearest: nearest.into(),
        light_losses: losses.into(),
    };
    let specs = regularize::Specs { workgroup: tuning.workgroup, lobes: model.lobes, free: model.is_free() };
    let push = regularize::Push { lights: model.lights, groups: workgroups };
    let name = "lights_regularize";
    stage(g, name, &regularize::KERNEL, bindings.entries(), specs.entries(), bytemuck::bytes_of(&push))
        .dispatch([1, 1, 1])?;
    let [weight_near, weight_brightness] = weights;
    Ok(LightRegularizers { nearest, weight_near, weight_brightness, points: p.surfaces.points })
}
