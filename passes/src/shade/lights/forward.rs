//! `lights` (with its variants `lights_train` and `lights_split`): radiance of pixels; `lights_materials_bwd`: gradients of
//! materials from what the forward pass left.
//!
//! Promises: every pixel of the view is written, zero where there is no surface; pairs that face away contribute exactly
//! nothing; the same bits from run to run. See [`super`] for the cost.
//!
//! Radiance depends on roughness through two sums over the lights, and on everything else linearly or through F0: the forward
//! pass leaves the irradiance and the derivative by roughness (6 floats a pixel; with metallic 12, the specular sums too).
//! [`lights_materials_bwd`] then looks at no light again: 60 bytes and 20 operations a pixel (128 and 60 with metallic).

use super::Prepared;
use crate::Tuning;
use crate::kernel::{groups, stage};
use crate::shade::Pixels;
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::{
    lights as render, lights_materials_bwd as materials, lights_materials_bwd_metallic as with_metallic,
    lights_split as split, lights_train as train,
};

/// What is shaded, and by what.
#[derive(Clone, Copy, Debug)]
pub struct Lights {
    /// The pixels.
    pub pixels: Pixels,
    /// The lights.
    pub prepared: Prepared,
    /// Factor of all light: 1 over the number of lights at the start, whatever has become of them.
    pub normalizer: f32,
    /// How the kernels are cut.
    pub shape: Shape,
}

/// What the kernels over pixels and lights bind alike; `$a` is a [`Lights`].
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

/// And the constants that they share.
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

/// How kernels over pixels and lights are cut.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shape {
    /// Lanes of a subgroup; a workgroup is one.
    pub subgroup: u32,
    /// Pixels of a lane, which share what is fetched of a light.
    pub per_lane: u32,
    /// Whether lanes fetch lights' numbers for one another: quicker where loads go lane by lane.
    pub spread: bool,
}

impl Shape {
    /// What suits a device.
    pub fn for_device(tuning: Tuning) -> Shape {
        let narrow = tuning.narrow();
        Shape { subgroup: tuning.subgroup_size, per_lane: if narrow { 16 } else { 2 }, spread: narrow }
    }

    /// Pixels of a workgroup.
    pub fn block(&self) -> u32 {
        self.subgroup * self.per_lane
    }
}

/// What [`lights_train`] leaves for [`lights_materials_bwd`].
#[derive(Clone, Copy, Debug)]
pub struct Sums {
    /// `[P * 6]`, or 12 with metallic.
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

/// As [`lights`], and writes the diffuse part of it to `diffuse`, `[P * 3]`; the rest is specular.
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

/// As [`lights`], and leaves what [`lights_materials_bwd`] needs.
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

/// Adds to `materials_gradient` (`[P * 4]`) and, if it is wanted, to `metallic_gradient` (`[P]`), from the gradient of the
/// radiance, `[P * 3]`. Without metallic its gradient is left alone.
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
