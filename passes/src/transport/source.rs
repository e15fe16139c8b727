//! `transport_source`: reflectance of the receivers and the direct light that they reflect, from parameters that are trained.
//!
//! A surfel has the mean material of its Gaussians; its reflectance is the diffuse albedo and the hemispherical albedo of the
//! specular lobe (Karis 2014). A patch has the albedo of its face and a faint lobe. The source, as a radiance, is
//! `reflectance / pi * sum over lights of color unit`. Colors are exponentials and albedos logistic functions of their parameters,
//! so that both stay in range.
//!
//! `irradiance_blend_bwd`: gradients of what [`super::irradiance_gather`] writes, from those of the pixels that it is blended to.
//!
//! Cost of a receiver: 44 bytes and 4 by light; backward 64 and 4. Sums over receivers have a fixed order.

use crate::Tuning;
use crate::kernel::{groups, stage};
use crate::shade::{PixelMaterials, Weights};
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::{
    irradiance_blend_bwd as blend, lights_reduce as reduce, transport_parameters_bwd as parameters,
    transport_source as kernel, transport_source_bwd as backward,
};

/// Number of faces of the enclosure.
const FACES: u32 = 6;

/// Inputs of [`transport_source`].
#[derive(Clone, Copy, Debug)]
pub struct SourceInputs {
    /// Number of receivers: surfels, then patches.
    pub receivers: u32,
    /// Number of surfels.
    pub surfels: u32,
    /// Number of lights.
    pub lights: u32,
    /// Materials of the surfels.
    pub materials: PixelMaterials,
    /// Raw albedo of the faces of the enclosure, `[6 * 3]` floats.
    pub enclosure: Buffer,
    /// Face of each patch, one word each.
    pub faces: Buffer,
    /// Irradiance from each light of color 1, `[lights * receivers]` floats.
    pub unit: Buffer,
    /// Logarithms of the lights' colors, `[lights * 3]` floats.
    pub log_colors: Buffer,
}

/// Outputs of [`transport_source`].
#[derive(Clone, Copy, Debug)]
pub struct Sources {
    /// Reflectance, `[receivers * 3]` floats.
    pub reflectance: Buffer,
    /// Direct light that is reflected, as a radiance, `[receivers * 3]` floats.
    pub source: Buffer,
    /// Colors of the lights, `[lights * 3]` floats.
    pub colors: Buffer,
}

/// Gradients that [`transport_source_bwd`] propagates.
#[derive(Clone, Copy, Debug)]
pub struct SourceGradients {
    /// By reflectance, `[receivers * 3]` floats.
    pub reflectance: Buffer,
    /// By source, `[receivers * 3]` floats.
    pub source: Buffer,
    /// By the colors of the lights where they light pixels, `[lights * 3]` floats.
    pub colors: Buffer,
}

/// Gradients that [`transport_source_bwd`] writes.
#[derive(Clone, Copy, Debug)]
pub struct ParameterGradients {
    /// By the materials of the surfels.
    pub materials: PixelMaterials,
    /// By log color, `[lights * 3]` floats.
    pub log_colors: Buffer,
    /// By raw albedo of the faces, `[6 * 3]` floats.
    pub enclosure: Buffer,
}

/// Computes reflectance, source and colors.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn transport_source(g: &mut Graph, t: &Tuning, a: &SourceInputs, into: &Sources) -> Result<(), GraphError> {
    let bindings = kernel::Bindings {
        materials: a.materials.materials.into(),
        metallic: a.materials.metallic.unwrap_or(a.materials.materials).into(),
        enclosure: a.enclosure.into(),
        faces: a.faces.into(),
        unit: a.unit.into(),
        log_colors: a.log_colors.into(),
        reflectance: into.reflectance.into(),
        source: into.source.into(),
        colors: into.colors.into(),
    };
    let specs = kernel::Specs { workgroup: t.workgroup, metallic: a.materials.metallic.is_some() };
    let push = kernel::Push { receivers: a.receivers, surfels: a.surfels, lights: a.lights };
    stage(g, "transport_source", &kernel::KERNEL, bindings.entries(), specs.entries(), bytemuck::bytes_of(&push))
        .dispatch(groups(a.receivers.max(a.lights).into(), t.workgroup))
}

/// Propagates the gradients of reflectance, source and colors to the parameters.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn transport_source_bwd(
    g: &mut Graph,
    t: &Tuning,
    a: &SourceInputs,
    gradients: &SourceGradients,
    into: &ParameterGradients,
) -> Result<(), GraphError> {
    let all = a.receivers.div_ceil(t.subgroup_size).max(1);
    let most = (t.rounds / 2 / (a.lights + 8)).max(1);
    let blocks = all.div_ceil(2 * t.workers).clamp(1, most);
    let workgroups = all.div_ceil(blocks);
    let width = 3 * (a.lights + FACES);
    let partials = g.transient("transport_source_bwd.partials", 4 * u64::from(width) * u64::from(workgroups));
    g.fill("transport_source_bwd.clear_partials", partials, 0)?;
    let has_metallic = a.materials.metallic.is_some();
    let metallic_gradient = match into.materials.metallic.filter(|_| has_metallic) {
        Some(buffer) => buffer,
        None => {
            g.transient("transport_source_bwd.no_metallic", if has_metallic { 4 * u64::from(a.surfels) } else { 4 })
        }
    };
    let bindings = backward::Bindings {
        materials: a.materials.materials.into(),
        metallic: a.materials.metallic.unwrap_or(a.materials.materials).into(),
        enclosure: a.enclosure.into(),
        faces: a.faces.into(),
        unit: a.unit.into(),
        log_colors: a.log_colors.into(),
        reflectance_gradient: gradients.reflectance.into(),
        source_gradient: gradients.source.into(),
        materials_gradient: into.materials.materials.into(),
        metallic_gradient: metallic_gradient.into(),
        partials: partials.into(),
    };
    let specs = backward::Specs { subgroup: t.subgroup_size, metallic: has_metallic };
    let push = backward::Push { receivers: a.receivers, surfels: a.surfels, lights: a.lights, blocks, workgroups };
    let kernel = &backward::KERNEL;
    stage(g, "transport_source_bwd", kernel, bindings.entries(), specs.entries(), bytemuck::bytes_of(&push))
        .subgroup_size(Some(t.subgroup_size))
        .dispatch(groups(u64::from(workgroups), 1))?;
    let sums = g.transient("transport_source_bwd.sums", 4 * u64::from(width));
    let bindings = reduce::Bindings { partials: partials.into(), light_gradients: sums.into() };
    let parts = if t.narrow() { 1 } else { 8 };
    let specs = reduce::Specs { workgroup: t.workgroup, parts };
    let (kernel, push) = (&reduce::KERNEL, reduce::Push { width, rows: workgroups });
    stage(g, "transport_source_reduce", kernel, bindings.entries(), specs.entries(), bytemuck::bytes_of(&push))
        .dispatch(groups(width.into(), t.workgroup / parts))?;
    let bindings = parameters::Bindings {
        log_colors: a.log_colors.into(),
        by_pixels: gradients.colors.into(),
        by_receivers: sums.into(),
        colors_gradient: into.log_colors.into(),
        enclosure_gradient: into.enclosure.into(),
    };
    let specs = parameters::Specs { workgroup: t.workgroup };
    let (kernel, push) = (&parameters::KERNEL, parameters::Push { lights: a.lights });
    stage(g, "transport_parameters_bwd", kernel, bindings.entries(), specs.entries(), bytemuck::bytes_of(&push))
        .dispatch(groups(width.into(), t.workgroup))
}

/// Inputs of [`irradiance_blend_bwd`].
#[derive(Clone, Copy, Debug)]
pub struct BlendGradients<'a> {
    /// Uniform `Step`: size of the view.
    pub step: Buffer,
    /// Number of Gaussians.
    pub gaussians: u32,
    /// Weights of the Gaussians at the pixels.
    pub weights: &'a Weights,
    /// Gradients of the pixels' irradiance and gain, `[pixels * 4]` floats.
    pub pixels: Buffer,
    /// Logarithms of the gains, `[Gaussians]` floats.
    pub log_gains: Buffer,
    /// Weight of the loss that pulls gains towards 1: the mean over pixels of their blended square logarithms.
    pub pull: f32,
}

/// Propagates gradients of pixels to Gaussians.
///
/// `values` receives those of irradiance and gain, `[Gaussians * 4]` floats; `log_gains` those of the log gains, `[Gaussians]`.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn irradiance_blend_bwd(
    g: &mut Graph,
    t: &Tuning,
    a: &BlendGradients<'_>,
    values: Buffer,
    log_gains: Buffer,
) -> Result<(), GraphError> {
    let bindings = blend::Bindings {
        params: a.step.into(),
        column_starts: a.weights.column_starts.into(),
        rows: a.weights.rows.into(),
        row_weights: a.weights.row_weights.into(),
        irradiance_gradient: a.pixels.into(),
        log_gains: a.log_gains.into(),
        values_gradient: values.into(),
        gains_gradient: log_gains.into(),
    };
    let specs = blend::Specs { workgroup: t.workgroup, weight_bits: a.weights.bits };
    let push = blend::Push { gaussians: a.gaussians, pull: a.pull };
    let kernel = &blend::KERNEL;
    stage(g, "irradiance_blend_bwd", kernel, bindings.entries(), specs.entries(), bytemuck::bytes_of(&push))
        .subgroup_size(Some(t.subgroup_size))
        .dispatch(groups(8 * u64::from(a.gaussians), t.workgroup))
}
