//! `lights_prepare`: converts raw parameters of lights for shading.
//!
//! Guarantees: lights that are off are not in the list, and shading skips them. With a [`Perturbation`] the result is a
//! function of the step's seed, the copy and the parameters. The pass is one workgroup. A lobe costs 24 bytes read, 32
//! bytes written and about 60 operations.

use super::{Axes, LightModel, LightParameters};
use crate::Tuning;
use crate::kernel::stage;
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::lights_prepare as kernel;

/// Perturbation of a copy of the lights, for consistency under other lighting. The perturbation has no gradient of its
/// own: the copy's gradient is applied to the light as if it were the light's own.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Perturbation {
    /// Index of the copy within a step.
    pub copy: u32,
    /// Maximum displacement of a light along each axis, in world units. The published value is a quarter of the unit in
    /// which the scene spans -1.5 to 1.5.
    pub distance: f32,
    /// Probability that a light is off.
    pub off: f32,
    /// Maximum relative change of a light's intensity.
    pub intensity: f32,
}

impl Perturbation {
    /// Returns the published perturbation for lights that started `spacing` apart.
    pub fn published(copy: u32, spacing: f32) -> Perturbation {
        Perturbation { copy, distance: 0.25 * spacing, off: 0.3, intensity: 0.3 }
    }
}

/// Lights in the layout that shading reads.
#[derive(Clone, Copy, Debug)]
pub struct Prepared {
    /// Lights as laid out in `lights.glsl`, `[lights * (1 + 2 lobes)]` of four floats.
    pub lights: Buffer,
    /// Number of lights that are on, followed by their indices.
    pub list: Buffer,
    /// Sizes of the lights.
    pub model: LightModel,
}

/// Adds the pass; `name` distinguishes several in a graph. `step` is the uniform `Step`, whose seed determines
/// perturbations.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn lights_prepare(
    g: &mut Graph,
    tuning: Tuning,
    name: &str,
    step: Buffer,
    model: LightModel,
    parameters: &LightParameters,
    perturbation: Option<&Perturbation>,
) -> Result<Prepared, GraphError> {
    lights_prepare_culled(g, tuning, name, step, model, parameters, perturbation, 0.0)
}

/// Adds the pass of [`lights_prepare`], with culling of faint lights. A workgroup skips a light if the box around its
/// pixels is farther away than the light's reach.
///
/// `missing` bounds the irradiance that culling may remove from a pixel by all lights together, in each channel, before
/// the normalizer. The bound assumes that every direction of a light gets the sum of its amplitudes. Each light has an
/// equal share of `missing`. The error of diffuse radiance is at most `missing * normalizer * albedo / pi`. The error
/// of specular radiance is at most `missing * normalizer / (2 pi roughness^6)`, which only a highlight of a culled
/// light approaches. Gradients are those of the culled image.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
#[expect(clippy::too_many_arguments, reason = "declares a kernel")]
pub fn lights_prepare_culled(
    g: &mut Graph,
    tuning: Tuning,
    name: &str,
    step: Buffer,
    model: LightModel,
    parameters: &LightParameters,
    perturbation: Option<&Perturbation>,
    missing: f32,
) -> Result<Prepared, GraphError> {
    let lights = u64::from(model.lights);
    let prepared = Prepared {
        lights: g.transient(format!("{name}.lights"), 16 * lights * (1 + 2 * u64::from(model.lobes))),
        list: g.transient(format!("{name}.list"), 4 * (1 + lights)),
        model,
    };
    let bindings = kernel::Bindings {
        params: step.into(),
        positions: parameters.positions.into(),
        lobes: parameters.lobes.into(),
        gains: parameters.gains.into(),
        prepared: prepared.lights.into(),
        light_list: prepared.list.into(),
    };
    let specs = kernel::Specs {
        workgroup: tuning.workgroup,
        lobes: model.lobes,
        free: model.axes == Axes::Free,
        perturbed: perturbation.is_some(),
    };
    let p = perturbation.copied().unwrap_or(Perturbation { copy: 0, distance: 0.0, off: 0.0, intensity: 0.0 });
    let push = kernel::Push {
        lights: model.lights,
        copy: p.copy,
        distance: p.distance,
        off: p.off,
        intensity: p.intensity,
        missing,
    };
    stage(g, name, &kernel::KERNEL, bindings.entries(), specs.entries(), bytemuck::bytes_of(&push))
        .dispatch([1, 1, 1])?;
    Ok(prepared)
}
