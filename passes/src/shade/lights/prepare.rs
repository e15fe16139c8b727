//! `lights_prepare`: raw parameters of lights to what shading reads.
//!
//! Promises: lights that are off are not in the list, and shading does not look at them; with a [`Perturbation`] what comes
//! out is a function of the step's seed, the copy and the parameters. One workgroup; a lobe costs 24 bytes read, 32 written,
//! about 60 operations.

use super::{Axes, LightModel, LightParameters};
use crate::Tuning;
use crate::kernel::stage;
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::lights_prepare as kernel;

/// How the lights of a copy differ from those that are trained, for consistency under other lighting. Without gradients of
/// its own: what is moved back is the copy's gradient as if it were the light's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Perturbation {
    /// Which of several copies in a step.
    pub copy: u32,
    /// Most that a light moves along each axis, in world units; the published value is a quarter of the unit in which the
    /// scene spans -1.5 to 1.5.
    pub distance: f32,
    /// Probability that a light is off.
    pub off: f32,
    /// Most that its intensity changes, as a share.
    pub intensity: f32,
}

impl Perturbation {
    /// The published one, in a scene whose lights started `spacing` apart.
    pub fn published(copy: u32, spacing: f32) -> Perturbation {
        Perturbation { copy, distance: 0.25 * spacing, off: 0.3, intensity: 0.3 }
    }
}

/// Lights as shading reads them.
#[derive(Clone, Copy, Debug)]
pub struct Prepared {
    /// `[lights * (1 + 2 lobes)]` of four floats, see `lights.glsl`.
    pub lights: Buffer,
    /// How many lights are on, then which.
    pub list: Buffer,
    /// Their sizes.
    pub model: LightModel,
}

/// Adds the pass; `name` distinguishes several in a graph. `step`: uniform `Step`, whose seed perturbations follow.
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

/// As [`lights_prepare`], for lights that are left out where they are too faint: of all pixels of a workgroup, if the box around
/// these is farther away than the light reaches.
///
/// `missing` is what all of them together may take from a pixel's irradiance, in each channel, before the normalizer: no
/// direction of a light gets more than the sum of its amplitudes, and each light has an equal share of what may be missing.
/// Diffuse radiance is then off by `missing * normalizer * albedo / pi` at most; specular radiance by
/// `missing * normalizer / (2 pi roughness^6)` at most, which only a highlight of that very light comes near. The
/// gradients are those of what is shown.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
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
