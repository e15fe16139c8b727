//! `environment` and `environment_bwd`: shading by the prefiltered environment map.
//!
//! Radiance is `(1 - M) A irradiance(n) / pi + radiance(2 max(n.v, 0) n - v, roughness) (F0 a + b)`. Cost per pixel: 12
//! texels and 4 entries of the split-sum table from the caches, and about 500 operations. The backward pass adds 72
//! integer atomic additions.
//!
//! Gradients of the levels are sums of 64-bit integers, stored in two words each. They therefore need no device feature
//! and do not depend on the order of additions. Their unit is a power of two, chosen in each step so that as many
//! contributions as there are pixels, each as large as the largest, still fit. With P pixels, contributions are exact
//! to 2^-(61 - log2 P) of the largest, about 2^-46 at 160x120 and 2^-40 at 1600x1200. A pixel whose gradient or
//! material is not finite contributes nothing to the environment map.

use super::{Environment, EnvironmentTables, Filtered};
use crate::Tuning;
use crate::kernel::{groups, stage};
use crate::shade::Pixels;
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::{
    environment as kernel, environment_background as background, environment_bwd as bwd, environment_scale as scale,
};

/// Surfaces of a view.
#[derive(Clone, Copy, Debug)]
pub struct EnvironmentView {
    /// Uniform `Step`: size of the view and position of the camera.
    pub step: Buffer,
    /// World-space points, `[P * 3]`.
    pub points: Buffer,
    /// Unit normals or zero, `[P * 3]`.
    pub normals: Buffer,
    /// Blended opacity, `[P]`; pixels below 0.001 are not shaded.
    pub coverage: Buffer,
    /// Albedo and roughness, `[P * 4]`.
    pub materials: Buffer,
    /// Metallic, `[P]`; 0 everywhere if `None`.
    pub metallic: Option<Buffer>,
    /// Maximum number of pixels of a view.
    pub pixels: u64,
}

impl From<&Pixels> for EnvironmentView {
    fn from(p: &Pixels) -> EnvironmentView {
        EnvironmentView {
            step: p.screen.step,
            points: p.surfaces.points,
            normals: p.surfaces.normals,
            coverage: p.surfaces.coverage,
            materials: p.materials.materials,
            metallic: p.materials.metallic,
            pixels: p.screen.pixels(),
        }
    }
}

/// Gradients of the levels, written by [`environment_bwd`].
#[derive(Clone, Copy, Debug)]
pub struct EnvironmentSums {
    /// 64-bit integers, low word first, `[texels of all levels * 3]`.
    pub texel_sums: Buffer,
    /// Bits of a float that bounds every contribution, `[1]`.
    pub largest: Buffer,
    /// Number of bits of the largest contribution.
    pub bits: i32,
}

/// Adds the pass that writes `ambient`, `[P * 3]`. Unshaded pixels are zero.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn environment(
    g: &mut Graph,
    t: &Tuning,
    e: &Environment,
    tables: &EnvironmentTables,
    view: &EnvironmentView,
    filtered: &Filtered,
    ambient: Buffer,
) -> Result<(), GraphError> {
    light(g, t, ("environment", false), e, tables, view, filtered, ambient)
}

/// Adds the pass that writes only the diffuse term of [`environment`], `[P * 3]`.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn environment_diffuse(
    g: &mut Graph,
    t: &Tuning,
    e: &Environment,
    tables: &EnvironmentTables,
    view: &EnvironmentView,
    filtered: &Filtered,
    diffuse: Buffer,
) -> Result<(), GraphError> {
    light(g, t, ("environment_diffuse", true), e, tables, view, filtered, diffuse)
}

/// Adds the named shading pass, restricted to the diffuse term if `diffuse_only`.
#[expect(clippy::too_many_arguments, reason = "declares a kernel")]
fn light(
    g: &mut Graph,
    t: &Tuning,
    (name, diffuse_only): (&'static str, bool),
    e: &Environment,
    tables: &EnvironmentTables,
    view: &EnvironmentView,
    filtered: &Filtered,
    ambient: Buffer,
) -> Result<(), GraphError> {
    let bindings = kernel::Bindings {
        params: view.step.into(),
        points: view.points.into(),
        normals: view.normals.into(),
        coverage: view.coverage.into(),
        materials: view.materials.into(),
        metallic: view.metallic.unwrap_or(view.coverage).into(),
        levels: tables.levels.into(),
        radiance: filtered.radiance.into(),
        split_sum: tables.split_sum.into(),
        ambient: ambient.into(),
    };
    let levels = e.levels.len() as u32;
    let specs = kernel::Specs { workgroup: t.workgroup, levels, metallic: view.metallic.is_some(), diffuse_only };
    stage(g, name, &kernel::KERNEL, bindings.entries(), specs.entries(), &[]).dispatch(groups(view.pixels, t.workgroup))
}

/// Adds the passes that propagate `radiance_gradient`, `[P * 3]`. The gradients of materials (`[P * 4]`) and of
/// metallic (`[P]`, if the view has it) are added to. Returns the gradients of the levels.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
#[expect(clippy::too_many_arguments, reason = "declares a kernel")]
pub fn environment_bwd(
    g: &mut Graph,
    t: &Tuning,
    e: &Environment,
    tables: &EnvironmentTables,
    view: &EnvironmentView,
    filtered: &Filtered,
    radiance_gradient: Buffer,
    materials_gradient: Buffer,
    metallic_gradient: Option<Buffer>,
) -> Result<EnvironmentSums, GraphError> {
    let largest = g.transient("environment.largest", 4);
    g.fill("environment.clear_largest", largest, 0)?;
    let metallic = view.metallic.unwrap_or(view.coverage);
    let bindings = scale::Bindings {
        params: view.step.into(),
        coverage: view.coverage.into(),
        materials: view.materials.into(),
        metallic: metallic.into(),
        radiance_gradient: radiance_gradient.into(),
        largest: largest.into(),
    };
    let specs = scale::Specs { workgroup: t.workgroup, metallic: view.metallic.is_some() };
    stage(g, "environment_scale", &scale::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch(groups(view.pixels, t.workgroup))?;

    let texel_sums = g.transient("environment.texel_sums", 24 * u64::from(e.filtered_texels()));
    g.fill("environment.clear_sums", texel_sums, 0)?;
    // A pixel contributes to a texel at most twice: from a level and, if that is the last, from diffuse light.
    let bits = 62 - (2 * view.pixels.max(1)).next_power_of_two().ilog2() as i32;
    // Without metallic, the kernel never writes this buffer.
    let unused = g.transient("environment.unused", 4);
    let metallic_gradient = match (view.metallic, metallic_gradient) {
        (Some(_), Some(buffer)) => buffer,
        _ => {
            g.fill("environment.clear_unused", unused, 0)?;
            unused
        }
    };
    let bindings = bwd::Bindings {
        params: view.step.into(),
        points: view.points.into(),
        normals: view.normals.into(),
        coverage: view.coverage.into(),
        materials: view.materials.into(),
        metallic: metallic.into(),
        levels: tables.levels.into(),
        radiance: filtered.radiance.into(),
        split_sum: tables.split_sum.into(),
        radiance_gradient: radiance_gradient.into(),
        largest: largest.into(),
        materials_gradient: materials_gradient.into(),
        metallic_gradient: metallic_gradient.into(),
        texel_sums: texel_sums.into(),
    };
    let specs = bwd::Specs {
        workgroup: t.workgroup,
        levels: e.levels.len() as u32,
        metallic: view.metallic.is_some(),
        fixed_bits: bits,
        merge: !t.narrow(),
    };
    stage(g, "environment_bwd", &bwd::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch(groups(view.pixels, t.workgroup))?;
    Ok(EnvironmentSums { texel_sums, largest, bits })
}

/// Adds the pass that writes `background`, `[P * 3]`. The background is the unfiltered environment map along each
/// pixel's ray.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn environment_background(
    g: &mut Graph,
    t: &Tuning,
    e: &Environment,
    step: Buffer,
    pixels: u64,
    texels: Buffer,
    background_image: Buffer,
) -> Result<(), GraphError> {
    let bindings =
        background::Bindings { params: step.into(), texels: texels.into(), background: background_image.into() };
    let specs = background::Specs { workgroup: t.workgroup };
    let push = background::Push { size: e.size };
    let bytes = bytemuck::bytes_of(&push);
    stage(g, "environment_background", &background::KERNEL, bindings.entries(), specs.entries(), bytes)
        .dispatch(groups(pixels, t.workgroup))
}
