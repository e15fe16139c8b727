//! `lights` and its variants: radiance of pixels, and gradients of materials. The variants are `lights_train` and
//! `lights_split`. `lights_materials_bwd` computes gradients of materials from the results of the forward pass.
//!
//! Guarantees: every pixel of the view is written, zero without a surface. Pairs that face away contribute exactly
//! zero. Results are bit-identical from run to run. See [`super`] for the cost.
//!
//! Radiance depends on roughness through two sums over the lights, and on everything else linearly or through F0. The
//! forward pass therefore stores the irradiance and the derivative by roughness: 6 floats per pixel, or 12 with
//! metallic, which adds the specular sums. [`lights_materials_bwd`] does not iterate over lights again. It costs 60
//! bytes and 20 operations per pixel (128 and 60 with metallic).

use super::Prepared;
use crate::Tuning;
use crate::kernel::{groups, stage};
use crate::shade::Pixels;
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::{
    lights as render, lights_materials_bwd as materials, lights_materials_bwd_metallic as with_metallic,
    lights_split as split, lights_train as train,
};

/// Inputs of shading by lights.
#[derive(Clone, Copy, Debug)]
pub struct Lights {
    /// Pixels to be shaded.
    pub pixels: Pixels,
    /// Prepared lights.
    pub prepared: Prepared,
    /// Factor of all light: 1 over the initial number of lights. The factor stays constant when lights are switched off
    /// or added.
    pub normalizer: f32,
    /// Shape of the kernels' workgroups.
    pub shape: Shape,
}

/// Bindings that the kernels over pixels and lights share; `$a` is a [`Lights`].
macro_rules! of_lights {
    ($kernel:ident, $a:expr, { $($more:tt)* }) => {
        $kernel::Bindings {
            params: $a.pixels.screen.step.into(),
            prepared: $a.prepared.lights.into(),
            prepared_floats: $a.prepared.lights.into(),
            light_list: $a.prepared.list.into(),
            points: $a.pixels.surfaces.points.into(),
            normals: $a.pixels.surfaces.normals.into(),
            coverage: $a.pixels.surfaces.coverage.into(),
            materials: $a.pixels.materials.materials.into(),
            metallic: $a.pixels.materials.metallic.unwrap_or($a.pixels.materials.materials).into(),
            $($more)*
        }
    };
}
pub(in crate::shade) use of_lights;

/// Specialization constants that the kernels share.
macro_rules! lit_specs {
    ($kernel:ident, $a:expr, $shape:expr, { $($more:tt)* }) => {
        $kernel::Specs {
            subgroup: $shape.subgroup,
            lobes: $a.prepared.model.lobes,
            metallic: $a.pixels.materials.metallic.is_some(),
            per_lane: $shape.per_lane,
            spread: $shape.spread,
            $($more)*
        }
    };
}
pub(in crate::shade) use lit_specs;

/// Workgroup shape of kernels over pixels and lights.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shape {
    /// Lanes of a subgroup; a workgroup is one subgroup.
    pub subgroup: u32,
    /// Pixels per lane, which share the fetched data of a light.
    pub per_lane: u32,
    /// Whether lanes fetch the lights' numbers for one another. Faster where loads are executed lane by lane.
    pub spread: bool,
}

impl Shape {
    /// Returns the shape for a device.
    pub fn for_device(tuning: Tuning) -> Shape {
        let narrow = tuning.narrow();
        Shape { subgroup: tuning.subgroup_size, per_lane: if narrow { 16 } else { 2 }, spread: narrow }
    }

    /// Returns the number of pixels of a workgroup.
    pub fn block(&self) -> u32 {
        self.subgroup * self.per_lane
    }
}

/// Sums that [`lights_train`] stores for [`lights_materials_bwd`].
#[derive(Clone, Copy, Debug)]
pub struct Sums {
    /// Sums per pixel, `[P * 6]`, or 12 with metallic.
    pub buffer: Buffer,
}

/// Writes `direct`, `[P * 3]` floats: linear radiance towards the camera.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn lights(g: &mut Graph, a: &Lights, direct: Buffer) -> Result<(), GraphError> {
    let p = &a.pixels;
    let bindings = of_lights!(render, a, {
        direct: direct.into(),
    });
    let specs = lit_specs!(render, a, a.shape, {});
    let push = render::Push { normalizer: a.normalizer };
    stage(g, "lights", &render::KERNEL, bindings.entries(), specs.entries(), bytemuck::bytes_of(&push))
        .subgroup_size(Some(a.shape.subgroup))
        .dispatch(groups(p.screen.pixels(), a.shape.block()))
}

/// Writes `direct` like [`lights`], and its diffuse term to `diffuse`, `[P * 3]`. The remainder is specular.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn lights_split(g: &mut Graph, a: &Lights, direct: Buffer, diffuse: Buffer) -> Result<(), GraphError> {
    let p = &a.pixels;
    let bindings = of_lights!(split, a, {
        direct: direct.into(),
        diffuse: diffuse.into(),
    });
    let specs = lit_specs!(split, a, a.shape, {});
    let push = split::Push { normalizer: a.normalizer };
    stage(g, "lights_split", &split::KERNEL, bindings.entries(), specs.entries(), bytemuck::bytes_of(&push))
        .subgroup_size(Some(a.shape.subgroup))
        .dispatch(groups(p.screen.pixels(), a.shape.block()))
}

/// Writes `direct` like [`lights`], and stores sums for [`lights_materials_bwd`].
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn lights_train(g: &mut Graph, a: &Lights, direct: Buffer) -> Result<Sums, GraphError> {
    let p = &a.pixels;
    let sums = g.transient("lights.sums", p.screen.pixels() * if p.materials.metallic.is_some() { 48 } else { 24 });
    let bindings = of_lights!(train, a, {
        direct: direct.into(),
        sums: sums.into(),
    });
    let specs = lit_specs!(train, a, a.shape, {});
    let push = train::Push { normalizer: a.normalizer };
    stage(g, "lights_train", &train::KERNEL, bindings.entries(), specs.entries(), bytemuck::bytes_of(&push))
        .subgroup_size(Some(a.shape.subgroup))
        .dispatch(groups(p.screen.pixels(), a.shape.block()))?;
    Ok(Sums { buffer: sums })
}

/// Adds the gradients of materials from the gradient of radiance, `[P * 3]`. Adds to `materials_gradient` (`[P * 4]`)
/// and, if present, to `metallic_gradient` (`[P]`). Without metallic, `metallic_gradient` is not touched.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn lights_materials_bwd(
    g: &mut Graph,
    tuning: Tuning,
    pixels: &Pixels,
    sums: &Sums,
    radiance_gradient: Buffer,
    materials_gradient: Buffer,
    metallic_gradient: Option<Buffer>,
) -> Result<(), GraphError> {
    let size = groups(pixels.screen.pixels(), tuning.workgroup);
    let name = "lights_materials_bwd";
    if let Some(metallic) = pixels.materials.metallic {
        let metallic_gradient = match metallic_gradient {
            Some(buffer) => buffer,
            None => {
                let unwanted = g.transient("lights.metallic_gradient", 4 * pixels.screen.pixels());
                g.fill("lights.clear_metallic_gradient", unwanted, 0)?;
                unwanted
            }
        };
        let bindings = with_metallic::Bindings {
            params: pixels.screen.step.into(),
            sums: sums.buffer.into(),
            coverage: pixels.surfaces.coverage.into(),
            materials: pixels.materials.materials.into(),
            metallic: metallic.into(),
            radiance_gradient: radiance_gradient.into(),
            materials_gradient: materials_gradient.into(),
            metallic_gradient: metallic_gradient.into(),
        };
        let specs = with_metallic::Specs { workgroup: tuning.workgroup };
        return stage(g, name, &with_metallic::KERNEL, bindings.entries(), specs.entries(), &[]).dispatch(size);
    }
    let bindings = materials::Bindings {
        params: pixels.screen.step.into(),
        sums: sums.buffer.into(),
        coverage: pixels.surfaces.coverage.into(),
        radiance_gradient: radiance_gradient.into(),
        materials_gradient: materials_gradient.into(),
    };
    let specs = materials::Specs { workgroup: tuning.workgroup };
    stage(g, name, &materials::KERNEL, bindings.entries(), specs.entries(), &[]).dispatch(size)
}
