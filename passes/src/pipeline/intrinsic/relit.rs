//! Shades a view as input of a material estimator.
//!
//! Uses the parameters before the step: under the current lights, and under copies of them that are moved, dimmed and
//! switched off at random.
//!
//! Guarantees: the output is a function of parameters, seed and view. Shading changes no parameter. Each copy of the
//! lights costs a forward pass of shading; the environment map is shaded once. The host waits.

use super::inputs::Declared as Inputs;
use super::{COPIES, IntrinsicInputs, IntrinsicOptions, IntrinsicSizes, IntrinsicStepValues, Step};
use crate::Tuning;
use crate::pipeline::{Surface, SurfaceHandles};
use crate::shade::environment::{Environment, EnvironmentView, environment as ambient_light, environment_filter};
use crate::shade::lights::{LightParameters, Lights, Perturbation, Shape, lights, lights_prepare};
use crate::shade::traced::lights_traced;
use crate::shade::visibility::lights_field;
use crate::shade::{PixelMaterials, Pixels, RawMaterials, materials, normals, values};
use crate::splat::Screen;
use sgs_engine::exec::{ExecOptions, Executor};
use sgs_engine::graph::{Buffer, CompileOptions, Graph, Plan};
use sgs_engine::{Device, DeviceBuffer, Location, Result};
use std::sync::Arc;

/// Lights under which a view is shaded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RelitOptions {
    /// Shades under the current lights, before all copies.
    pub as_is: bool,
    /// Number of perturbed copies of the lights.
    ///
    /// At most [`COPIES`]; at least one is used if `as_is` is false.
    pub copies: u32,
    /// Unit of the distance that copies move, e.g. the initial distance between lights.
    pub spacing: f32,
}

/// Shader of views for a material estimator.
pub struct RelitView {
    exec: Executor,
    step: Buffer,
    field: Option<Buffer>,
    surface: SurfaceHandles,
    tile: [u32; 2],
    /// Direct light: under the current lights, under each copy; then ambient light if present.
    outputs: Vec<DeviceBuffer>,
    /// Number of direct-light outputs.
    direct: usize,
}

struct Built {
    plan: Arc<Plan>,
    step: Buffer,
    surface: SurfaceHandles,
    inputs: Inputs,
    outputs: Vec<Buffer>,
}

impl RelitView {
    /// Builds the graph and binds the parameters. `inputs` must have lights.
    ///
    /// # Errors
    /// If memory runs out.
    pub fn new(
        device: &Device,
        tuning: &Tuning,
        inputs: &IntrinsicInputs<'_>,
        options: &IntrinsicOptions,
        relit: &RelitOptions,
    ) -> Result<RelitView> {
        let made = declare(tuning, &inputs.sizes(), inputs.environment(), options, relit)?;
        let bytes = output_bytes(options);
        let outputs: Vec<DeviceBuffer> =
            made.outputs.iter().map(|_| device.buffer("relit", bytes, Location::Device)).collect::<Result<_>>()?;
        let mut exec = Executor::new(device, made.plan, ExecOptions { frames_in_flight: 1, ..Default::default() })?;
        made.inputs.bind(&mut exec, inputs)?;
        for (handle, buffer) in made.outputs.iter().zip(&outputs) {
            exec.bind(*handle, buffer)?;
        }
        Ok(RelitView {
            exec,
            step: made.step,
            field: made.inputs.visibility.map(|v| v.field.step),
            surface: made.surface,
            tile: tuning.tile,
            direct: lights_of(relit).len(),
            outputs,
        })
    }

    /// Compiles the plan without allocating it, and returns the bytes of its outputs.
    ///
    /// # Errors
    /// If the graph rejects the sizes.
    pub fn plan(
        tuning: &Tuning,
        sizes: &IntrinsicSizes,
        environment: Option<&Environment>,
        options: &IntrinsicOptions,
        relit: &RelitOptions,
    ) -> Result<(Arc<Plan>, u64)> {
        let made = declare(tuning, sizes, environment, options, relit)?;
        Ok((made.plan, made.outputs.len() as u64 * output_bytes(options)))
    }

    /// Returns the linear radiance of a view's surfaces for each set of lights.
    ///
    /// Waits for the device. First under the current lights if the options request that, then under each copy drawn
    /// from the step's seed. `[pixels * 3]` floats each, without background.
    ///
    /// # Errors
    /// If the device fails, or the surface differs in shape from the options.
    pub fn shade(&mut self, device: &Device, surface: &Surface, values: &IntrinsicStepValues) -> Result<Vec<Vec<f32>>> {
        surface.bind(&mut self.exec, &self.surface)?;
        let mut step = values.shaded;
        let size = step.camera.size;
        step.camera.tiles = [size[0].div_ceil(self.tile[0]), size[1].div_ceil(self.tile[1])];
        let mut uniforms = vec![(self.step, bytemuck::bytes_of(&step))];
        if let Some(field) = self.field {
            uniforms.push((field, bytemuck::bytes_of(&values.field)));
        }
        self.exec.submit(&uniforms)?;
        self.exec.finish()?;
        let floats = 3 * size[0] as usize * size[1] as usize;
        let read = |b: &DeviceBuffer| device.download_as::<f32>(b, floats);
        let around = self.outputs.get(self.direct).map(read).transpose()?;
        let mut images = self.outputs[..self.direct].iter().map(read).collect::<Result<Vec<_>>>()?;
        if let Some(around) = around {
            images.iter_mut().for_each(|p| p.iter_mut().zip(&around).for_each(|(v, a)| *v += a));
        }
        Ok(images)
    }
}

/// Returns the lights of each image: `None` for the current ones, else the number of a copy.
fn lights_of(relit: &RelitOptions) -> Vec<Option<u32>> {
    let copies = relit.copies.clamp(u32::from(!relit.as_is), COPIES as u32);
    relit.as_is.then_some(None).into_iter().chain((0..copies).map(Some)).collect()
}

fn output_bytes(o: &IntrinsicOptions) -> u64 {
    12 * u64::from(o.shape.largest[0]) * u64::from(o.shape.largest[1])
}

fn declare(
    t: &Tuning,
    sizes: &IntrinsicSizes,
    environment: Option<&Environment>,
    o: &IntrinsicOptions,
    relit: &RelitOptions,
) -> Result<Built> {
    let mut g = Graph::new("relit_view");
    let step = g.uniform("step", size_of::<Step>() as u64);
    let surface = o.shape.declare(&mut g, "", false);
    let tables = environment.map(|e| (e.declare(&mut g), e.floats()));
    let inputs = Inputs::declare(&mut g, sizes, tables, o, t.accuracy.visibility_bits);
    let screen = Screen { step, largest: o.shape.largest, tile: t.tile };
    let pixels = screen.pixels();
    let raw = RawMaterials {
        albedo_range: o.albedo_range,
        albedo: inputs.albedo.parameters,
        roughness: inputs.roughness.parameters,
        metallic: inputs.metallic.map(|m| m.parameters),
    };
    let of_gaussians = values(&mut g, t, &raw, o.shape.gaussians)?;
    let of_pixels = PixelMaterials {
        materials: g.transient("materials", 16 * pixels),
        metallic: raw.metallic.map(|_| g.transient("pixel_metallic", 4 * pixels)),
    };
    materials(&mut g, t, &screen, &of_gaussians, &surface.weights, &of_pixels)?;
    let learned = inputs.normals.map(|l| normals(&mut g, t, &screen, l.parameters, &surface.weights)).transpose()?;
    let seen = learned.map_or(surface.surfaces, |l| l.of(&surface.surfaces));
    let shaded = Pixels { screen, surfaces: seen, materials: of_pixels };
    let mut outputs = Vec::new();
    for copy in lights_of(relit) {
        let name = |what: &str| copy.map_or(what.to_owned(), |copy| format!("{what}{copy}"));
        let direct = g.external(name("relit"), 12 * pixels);
        outputs.push(direct);
        let Some(l) = &inputs.lights else {
            g.fill(name("no_lights"), direct, 0)?;
            continue;
        };
        let parameters =
            LightParameters { positions: l.positions.parameters, lobes: l.lobes.parameters, gains: l.gains };
        let other = copy.map(|copy| Perturbation::published(copy, relit.spacing));
        let prepared = lights_prepare(&mut g, *t, &name("lights_prepare"), step, l.model, &parameters, other.as_ref())?;
        let lit = Lights { pixels: shaded, prepared, normalizer: l.normalizer, shape: Shape::for_device(*t) };
        match (&inputs.visibility, &inputs.traced) {
            (Some(v), _) => lights_field(&mut g, *t, &lit, &v.field, direct)?,
            (None, Some(traced)) => lights_traced(&mut g, &lit, traced, direct)?,
            (None, None) => lights(&mut g, &lit, direct)?,
        }
    }
    if let (Some(e), Some((texels, tables))) = (environment, &inputs.environment) {
        let ambient = g.external("relit_ambient", 12 * pixels);
        outputs.push(ambient);
        let filtered = environment_filter(&mut g, t, e, tables, texels.parameters)?;
        ambient_light(&mut g, t, e, tables, &EnvironmentView::from(&shaded), &filtered, ambient)?;
    }
    let plan = Arc::new(g.compile(&CompileOptions::default())?);
    Ok(Built { plan, step, surface, inputs, outputs })
}
