//! `response_sum`: irradiance of receivers under the colors of a frame; `gaussian_emission`: what Gaussians emit;
//! `response_source`, `response_store`: source of a response, and its place among all.
//!
//! Light is linear in the colors of emitters, by channel. The irradiance of a receiver is the sum over the emitters of color
//! times response, which is the irradiance by color 1. Emitters are added in their order, so that results are bit-identical
//! from run to run. Emitters of color 0 are not read.
//!
//! Cost of a receiver: 12 bytes and 6 operations per emitter, 12 bytes written. Of a Gaussian: 4 bytes read, 16 written.
//! Source and place of a response: 28 and 24 bytes per receiver.

use crate::Tuning;
use crate::kernel::{groups, stage};
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::{
    gaussian_emission as emission, response_source as from_unit, response_store as store, response_sum as kernel,
};

/// Inputs of [`response_sum`].
#[derive(Clone, Copy, Debug)]
pub struct Responses {
    /// Number of emitters.
    pub lights: u32,
    /// Number of receivers.
    pub receivers: u32,
    /// Irradiance by each emitter of color 1, `[lights * receivers * 3]` floats.
    pub responses: Buffer,
    /// Colors of the emitters, `[lights * 3]` floats.
    pub colors: Buffer,
}

/// Writes `irradiance`, `[receivers * 3]` floats.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn response_sum(g: &mut Graph, t: &Tuning, a: &Responses, irradiance: Buffer) -> Result<(), GraphError> {
    let bindings = kernel::Bindings {
        responses: a.responses.into(),
        light_colors: a.colors.into(),
        irradiance: irradiance.into(),
    };
    let specs = kernel::Specs { workgroup: t.workgroup };
    let push = kernel::Push { receivers: a.receivers, lights: a.lights };
    stage(g, "response_sum", &kernel::KERNEL, bindings.entries(), specs.entries(), bytemuck::bytes_of(&push))
        .dispatch(groups(a.receivers.into(), t.workgroup))
}

/// Inputs of [`gaussian_emission`].
#[derive(Clone, Copy, Debug)]
pub struct GaussianEmitters {
    /// Number of Gaussians.
    pub gaussians: u32,
    /// Number of emitters.
    pub emitters: u32,
    /// Number of the emitter of each Gaussian, `[Gaussians]` words. The first emitter has 1. Others emit nothing.
    pub numbers: Buffer,
    /// Radiance of the surface of each emitter, `[emitters * 3]` floats.
    pub radiance: Buffer,
}

/// Writes the radiance that each Gaussian emits: `values` is `[Gaussians * 4]` floats, red, green, blue and 0.
///
/// The pass `materials` blends them to pixels.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn gaussian_emission(g: &mut Graph, t: &Tuning, a: &GaussianEmitters, values: Buffer) -> Result<(), GraphError> {
    let bindings = emission::Bindings { numbers: a.numbers.into(), radiance: a.radiance.into(), values: values.into() };
    let specs = emission::Specs { workgroup: t.workgroup };
    let push = emission::Push { gaussians: a.gaussians, emitters: a.emitters };
    stage(g, "gaussian_emission", &emission::KERNEL, bindings.entries(), specs.entries(), bytemuck::bytes_of(&push))
        .dispatch(groups(a.gaussians.into(), t.workgroup))
}

/// Inputs and output of [`response_source`].
#[derive(Clone, Copy, Debug)]
pub struct ResponseSource {
    /// Number of receivers.
    pub receivers: u32,
    /// Irradiance by an emitter of color 1, `[receivers]` floats.
    pub unit: Buffer,
    /// Reflectance, `[receivers * 3]` floats.
    pub reflectance: Buffer,
    /// Radiosity without bounces, `[receivers * 3]` floats; written.
    pub source: Buffer,
}

/// Writes the radiosity of direct light: reflectance / pi times irradiance.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn response_source(g: &mut Graph, t: &Tuning, a: &ResponseSource) -> Result<(), GraphError> {
    let bindings =
        from_unit::Bindings { unit: a.unit.into(), reflectance: a.reflectance.into(), source: a.source.into() };
    let specs = from_unit::Specs { workgroup: t.workgroup };
    let push = from_unit::Push { receivers: a.receivers };
    stage(g, "response_source", &from_unit::KERNEL, bindings.entries(), specs.entries(), bytemuck::bytes_of(&push))
        .dispatch(groups(a.receivers.into(), t.workgroup))
}

/// Writes `irradiance`, `[receivers * 3]` floats, as the response to one emitter.
///
/// `emitter` holds the index of the emitter. An index of no emitter changes nothing.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn response_store(
    g: &mut Graph,
    t: &Tuning,
    into: &Responses,
    emitter: Buffer,
    irradiance: Buffer,
) -> Result<(), GraphError> {
    let bindings =
        store::Bindings { emitter: emitter.into(), irradiance: irradiance.into(), responses: into.responses.into() };
    let specs = store::Specs { workgroup: t.workgroup };
    let push = store::Push { receivers: into.receivers, lights: into.lights };
    stage(g, "response_store", &store::KERNEL, bindings.entries(), specs.entries(), bytemuck::bytes_of(&push))
        .dispatch(groups(into.receivers.into(), t.workgroup))
}
