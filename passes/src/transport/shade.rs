//! `transport_shade` and `transport_shade_bwd`: radiance of pixels under physical lights and gathered irradiance.
//!
//! Radiance is `gain (k_d E / pi + k_s L + sum over lights of color unit (k_d / pi + specular BRDF)) + emission`. `k_d` is albedo
//! (1 - metallic), `k_s` the hemispherical albedo of the specular lobe from the split-sum table, E the gathered irradiance, L
//! the radiance of [`super::transport_reflect`], or E / pi without reflections, `unit` the irradiance of [`super::transport_lights`]. The BRDF is that of `brdf.glsl`. Highlights of lights with an
//! extent use the representative point of Karis (2013): the point of the light closest to the mirrored ray, and a lobe
//! that the light's size widens. A mirror at normal incidence reflects the light's own radiance.
//!
//! Gradients, without reflections: materials, gathered irradiance, gain, emission and light colors. Points, normals and `unit` are constants. Sums over
//! pixels have a fixed order, so that results are bit-identical from run to run. Pixels without a surface or a normal are
//! zero, and so are their gradients.
//!
//! Cost of a pixel: 72 bytes (16 more with emission, 16 with reflections) and about 80 operations. A pair of pixel and light takes 4 bytes, and
//! 165 operations if it is lit. The gradient takes 120 bytes and 120 operations per pixel, 4 bytes and 240 operations per
//! pair.

use super::AreaLights;
use crate::Tuning;
use crate::kernel::{groups, stage};
use crate::shade::Pixels;
use crate::shade::environment::split_sum;
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::{lights_reduce as reduce, transport_shade as kernel, transport_shade_bwd as backward};

/// Inputs of shading.
#[derive(Clone, Copy, Debug)]
pub struct TransportShading {
    /// Points, normals, coverage and materials of a view.
    pub pixels: Pixels,
    /// Physical lights.
    pub lights: AreaLights,
    /// Irradiance of color 1, `[lights * pixels]`. [`super::transport_lights`] writes it.
    pub unit: Buffer,
    /// Gathered irradiance and gain of all light, `[pixels * 4]` floats: rgb, gain. With reflections
    /// [`super::transport_reflect`] writes as many behind it.
    pub irradiance: Buffer,
    /// Whether the specular lobe reflects traced radiance. Gradients ignore it.
    pub reflections: bool,
    /// Emitted radiance, `[pixels * 4]` floats: rgb, unused; 0 everywhere if `None`.
    pub emission: Option<Buffer>,
    /// Split-sum table of [`split_sum_table`].
    pub split_sum: Buffer,
}

/// Separate terms of the radiance, `[pixels * 3]` floats each. Their sum is the radiance.
#[derive(Clone, Copy, Debug)]
pub struct ShadeTerms {
    /// Diffuse reflection of the lights.
    pub diffuse: Buffer,
    /// Specular reflection of the lights.
    pub specular: Buffer,
    /// Reflection of the gathered irradiance.
    pub indirect: Buffer,
    /// Emission.
    pub emission: Buffer,
}

/// Destinations of the gradients.
#[derive(Clone, Copy, Debug)]
pub struct ShadeGradients {
    /// Gradients of albedo and roughness, `[pixels * 4]`; added to.
    pub materials: Buffer,
    /// Gradients of metallic, `[pixels]`; added to. Not computed if `None`.
    pub metallic: Option<Buffer>,
    /// Gradients of the gathered irradiance and of the gain, `[pixels * 4]`; overwritten.
    pub irradiance: Buffer,
    /// Gradients of the emission, `[pixels * 4]`; overwritten. Not computed if `None`.
    pub emission: Option<Buffer>,
    /// Gradients of the light colors, `[lights * 3]`; overwritten.
    pub colors: Buffer,
}

/// Declares the split-sum table as an input of a graph, and returns its contents.
pub fn split_sum_table(g: &mut Graph) -> (Buffer, Vec<u8>) {
    let table = split_sum::table();
    let bytes: Vec<u8> = bytemuck::cast_slice(&table).to_vec();
    (g.input("split_sum", bytes.len() as u64), bytes)
}

/// Writes `radiance`, `[pixels * 3]`, and the separate terms if requested.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn transport_shade(
    g: &mut Graph,
    t: Tuning,
    a: &TransportShading,
    radiance: Buffer,
    terms: Option<&ShadeTerms>,
) -> Result<(), GraphError> {
    let p = &a.pixels;
    let mut nothing = || g.transient("transport_shade.no_term", 4);
    let [diffuse, specular, indirect, emitted] = match terms {
        Some(t) => [t.diffuse, t.specular, t.indirect, t.emission],
        None => [nothing(), nothing(), nothing(), nothing()],
    };
    let bindings = kernel::Bindings {
        params: p.screen.step.into(),
        points: p.surfaces.points.into(),
        normals: p.surfaces.normals.into(),
        coverage: p.surfaces.coverage.into(),
        materials: p.materials.materials.into(),
        metallic: p.materials.metallic.unwrap_or(p.materials.materials).into(),
        irradiance: a.irradiance.into(),
        emission: a.emission.unwrap_or(a.irradiance).into(),
        light_records: a.lights.records.into(),
        light_colors: a.lights.colors.into(),
        unit: a.unit.into(),
        split_sum: a.split_sum.into(),
        radiance: radiance.into(),
        diffuse: diffuse.into(),
        specular: specular.into(),
        indirect: indirect.into(),
        emitted: emitted.into(),
    };
    let workgroup = t.workgroup.min(64);
    let specs = kernel::Specs {
        workgroup,
        metallic: p.materials.metallic.is_some(),
        emission: a.emission.is_some(),
        terms: terms.is_some(),
        reflections: a.reflections,
    };
    let push = kernel::Push { lights: a.lights.count, stride: p.screen.pixels() as u32 };
    stage(g, "transport_shade", &kernel::KERNEL, bindings.entries(), specs.entries(), bytemuck::bytes_of(&push))
        .dispatch(groups(p.screen.pixels(), workgroup))
}

/// Propagates `radiance_gradient`, `[pixels * 3]`.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn transport_shade_bwd(
    g: &mut Graph,
    t: Tuning,
    a: &TransportShading,
    radiance_gradient: Buffer,
    into: &ShadeGradients,
) -> Result<(), GraphError> {
    let (p, count) = (&a.pixels, a.lights.count);
    let all = p.screen.pixels().div_ceil(u64::from(t.subgroup_size)).max(1) as u32;
    // Two workgroups per worker, unless an invocation's loops would take too many iterations.
    let most = (t.rounds / 2 / (count + 8)).max(1);
    let blocks = all.div_ceil(2 * t.workers).clamp(1, most);
    let workgroups = all.div_ceil(blocks);
    let partials = g.transient("transport_shade_bwd.partials", 12 * u64::from(count.max(1)) * u64::from(workgroups));
    // The kernel writes gradients of whatever it has as input.
    let mut scratch = |name: &str, bytes: u64| -> Result<Buffer, GraphError> {
        let buffer = g.transient(name, bytes);
        g.fill(format!("{name}.clear"), buffer, 0)?;
        Ok(buffer)
    };
    let (has_metallic, has_emission) = (p.materials.metallic.is_some(), a.emission.is_some());
    let bytes = |present: bool, width: u64| if present { 4 * width * p.screen.pixels() } else { 4 };
    let metallic_gradient = match into.metallic {
        Some(buffer) if has_metallic => buffer,
        _ => scratch("transport_shade_bwd.no_metallic", bytes(has_metallic, 1))?,
    };
    let emission_gradient = match into.emission {
        Some(buffer) if has_emission => buffer,
        _ => scratch("transport_shade_bwd.no_emission", bytes(has_emission, 4))?,
    };
    g.fill("transport_shade_bwd.clear_partials", partials, 0)?;
    let bindings = backward::Bindings {
        params: p.screen.step.into(),
        points: p.surfaces.points.into(),
        normals: p.surfaces.normals.into(),
        coverage: p.surfaces.coverage.into(),
        materials: p.materials.materials.into(),
        metallic: p.materials.metallic.unwrap_or(p.materials.materials).into(),
        irradiance: a.irradiance.into(),
        light_records: a.lights.records.into(),
        light_colors: a.lights.colors.into(),
        unit: a.unit.into(),
        split_sum: a.split_sum.into(),
        radiance_gradient: radiance_gradient.into(),
        materials_gradient: into.materials.into(),
        metallic_gradient: metallic_gradient.into(),
        irradiance_gradient: into.irradiance.into(),
        emission_gradient: emission_gradient.into(),
        partials: partials.into(),
    };
    let specs = backward::Specs {
        subgroup: t.subgroup_size,
        metallic: has_metallic,
        emission: has_emission,
        reflections: false,
    };
    let push = backward::Push { lights: count, stride: p.screen.pixels() as u32, blocks, workgroups };
    let bytes = bytemuck::bytes_of(&push);
    stage(g, "transport_shade_bwd", &backward::KERNEL, bindings.entries(), specs.entries(), bytes)
        .subgroup_size(Some(t.subgroup_size))
        .dispatch(groups(u64::from(workgroups), 1))?;
    if count == 0 {
        return Ok(());
    }
    let bindings = reduce::Bindings { partials: partials.into(), light_gradients: into.colors.into() };
    let parts = if t.narrow() { 1 } else { 8 };
    let specs = reduce::Specs { workgroup: t.workgroup, parts };
    let push = reduce::Push { width: 3 * count, rows: workgroups };
    let bytes = bytemuck::bytes_of(&push);
    stage(g, "transport_colors_reduce", &reduce::KERNEL, bindings.entries(), specs.entries(), bytes)
        .dispatch(groups(u64::from(3 * count), t.workgroup / parts))
}
