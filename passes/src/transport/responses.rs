//! `response_sum`: irradiance of receivers under the colors of a frame; `gaussian_emission`: what Gaussians emit;
//! `response_radiosity`: radiosity of receivers under the colors of a frame; `response_source`, `response_store`: source of a
//! response, and its place among all.
//!
//! Light is linear in the colors of emitters, by channel. The irradiance of a receiver is the sum over the emitters of color
//! times response, which is the irradiance by color 1. Emitters are added in their order, so that results are bit-identical
//! from run to run. Emitters of color 0 are not read.
//!
//! Cost of a receiver: 12 bytes and 6 operations per emitter, 12 bytes written. Of a Gaussian: 4 bytes read, 16 written.
//! Source and place of a response: 28 and 24 bytes per receiver, 32 with direct light.
//!
//! Radiosity is reflectance / pi times direct and bounced irradiance. Direct irradiance by color 1 is one number by emitter, so
//! that the sum reads 4 bytes per pair and 36 per receiver. Responses of radiosity would take 12 per pair.

use crate::Tuning;
use crate::kernel::{groups, stage};
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::{
    gaussian_emission as emission, response_radiosity as radiosity, response_source as from_unit,
    response_store as store, response_sum as kernel,
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

/// Inputs and output of [`response_radiosity`].
#[derive(Clone, Copy, Debug)]
pub struct ResponseRadiosity {
    /// Number of emitters.
    pub lights: u32,
    /// Number of receivers.
    pub receivers: u32,
    /// Direct irradiance by each emitter of color 1, `[lights * receivers]` floats.
    pub unit: Buffer,
    /// Colors of the emitters, `[lights * 3]` floats.
    pub colors: Buffer,
    /// Irradiance that bounces, `[receivers * 3]` floats.
    pub irradiance: Buffer,
    /// Reflectance, `[receivers * 3]` floats.
    pub reflectance: Buffer,
    /// Radiosity as a radiance, `[receivers * 3]` floats; written.
    pub radiosity: Buffer,
}

/// Writes the radiosity of receivers.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn response_radiosity(g: &mut Graph, t: &Tuning, a: &ResponseRadiosity) -> Result<(), GraphError> {
    let bindings = radiosity::Bindings {
        unit: a.unit.into(),
        light_colors: a.colors.into(),
        irradiance: a.irradiance.into(),
        reflectance: a.reflectance.into(),
        radiosity: a.radiosity.into(),
    };
    let specs = radiosity::Specs { workgroup: t.workgroup };
    let push = radiosity::Push { receivers: a.receivers, lights: a.lights };
    stage(g, "response_radiosity", &radiosity::KERNEL, bindings.entries(), specs.entries(), bytemuck::bytes_of(&push))
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

/// Direct light of one emitter, and of all.
#[derive(Clone, Copy, Debug)]
pub struct DirectLight {
    /// Irradiance by the emitter of color 1, `[receivers]` floats.
    pub unit: Buffer,
    /// That of all emitters, `[lights * receivers]` floats; the emitter's part is written.
    pub units: Buffer,
}

/// Writes `irradiance`, `[receivers * 3]` floats, as the response to one emitter; also its direct light if requested.
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
    direct: Option<&DirectLight>,
) -> Result<(), GraphError> {
    let units = direct.map_or_else(|| g.transient("response_store.no_units", 4), |d| d.units);
    let bindings = store::Bindings {
        emitter: emitter.into(),
        irradiance: irradiance.into(),
        responses: into.responses.into(),
        unit: direct.map_or(irradiance, |d| d.unit).into(),
        units: units.into(),
    };
    let specs = store::Specs { workgroup: t.workgroup, direct: direct.is_some() };
    let push = store::Push { receivers: into.receivers, lights: into.lights };
    stage(g, "response_store", &store::KERNEL, bindings.entries(), specs.entries(), bytemuck::bytes_of(&push))
        .dispatch(groups(into.receivers.into(), t.workgroup))
}
