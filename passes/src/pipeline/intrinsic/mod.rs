//! One step of the intrinsic stage: shade a view, evaluate the losses, propagate gradients, update.
//!
//! A step updates materials, lights, environment map and visibility; geometry is fixed. The surfaces of the view
//! ([`super::Surface`]) are bound before each step. No buffer has the size of pixels times lights. The host does not
//! wait.

mod across;
mod build;
mod inputs;
mod priors;
mod refresh;
mod relit;
mod transport;

pub use inputs::{
    COPIES, EnvironmentMemory, IntrinsicInputs, IntrinsicParameters, IntrinsicSizes, LightTrainables,
    TransportTrainables, ViewImages,
};
pub use refresh::{EnvironmentRefresh, StoredEnvironment};
pub use relit::{RelitOptions, RelitView};
pub use transport::TransportTraining;

use self::build::{StepResources, Words, build};
use self::inputs::{Declared as Inputs, ImageHandles};
use super::status::RING;
use super::{Masks, PSEUDO_VIEWS, Step, Surface, SurfaceHandles, SurfaceShape};
use crate::Tuning;
use crate::shade::environment::{Environment, EnvironmentTables, StoredFilter};
use crate::shade::lights::LightModel;
use crate::shade::traced::TracedShape;
use crate::shade::visibility::FieldConfig;
use sgs_engine::exec::{ExecOptions, Executor, HostTimes};
use sgs_engine::graph::{Buffer, CompileOptions, Graph, Plan};
use sgs_engine::{Device, DeviceBuffer, Location, Result, Ticket};
use sgs_shaders::structs::{FieldStep, IntrinsicReport, MaterialWeights};
use std::sync::Arc;

/// Options of an intrinsic step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IntrinsicOptions {
    /// Maximum size of a view, number of Gaussians, and capacity of weights.
    pub shape: SurfaceShape,
    /// Lowest albedo, and the distance from it to the highest.
    pub albedo_range: [f32; 2],
    /// Trains a metallic value per Gaussian.
    pub metallic: bool,
    /// Point lights, and the factor on all their light: one over their initial number.
    pub lights: Option<(LightModel, f32)>,
    /// Learned visibility field, if used.
    pub visibility: Option<FieldConfig>,
    /// Traced visibility, if used; the tree is an input. It has no trained parameters.
    pub traced: Option<TracedShape>,
    /// Physical lights and bounced light, if used instead of point lights.
    pub transport: Option<TransportTraining>,
    /// Enables the smoothness loss of visibility under a jitter of positions.
    pub visibility_jitter: bool,
    /// Supervises the field with one in this many (pixel, light) pairs; 1 uses all.
    ///
    /// Each pair is weighted by this number.
    pub visibility_sample: u32,
    /// Weights of the distance of lights from surfaces and of their amplitudes.
    pub light_regularizers: [f32; 2],
    /// Diffuse radiance per channel that culled lights may lack at a pixel.
    ///
    /// Faint lights are culled from blocks of pixels; 0 disables culling. Specular radiance lacks at most
    /// `1 / (2 roughness^6)` times that ([`crate::shade::lights::lights_prepare_culled`]).
    pub cull_error: f32,
    /// Weight of the smoothness of the environment map, which is itself an input.
    pub environment_smooth: f32,
    /// Number of steps between updates of the environment map; 1 updates it with every step.
    ///
    /// An update uses the mean gradient of these steps. The mip levels are fixed in between ([`EnvironmentRefresh`]).
    pub environment_every: u32,
    /// Enables the edge-aware smoothness losses, guided by the photograph.
    ///
    /// They smooth albedo and roughness.
    pub edge_aware: bool,
    /// Compares gradients of albedo and roughness with the priors' at several scales.
    pub gradients: bool,
    /// Source of the region masks in the training view and the pseudo-views.
    pub masks: Masks,
    /// Compares the albedo of a region with two pseudo-views; requires regions among the inputs.
    pub cross_view: bool,
    /// Compares the albedo of the region with estimates under other lights; requires these and regions.
    pub relight: bool,
    /// Compares the albedo of the region with the view's own prior; requires that prior and regions.
    pub own_prior: bool,
    /// Weight of the estimated roughness relative to albedo, under other lights.
    pub relight_roughness: f32,
    /// Learning rates.
    pub rates: IntrinsicRates,
    /// Makes the shaded image available after a step ([`IntrinsicStep::image`]).
    pub image: bool,
    /// Writes timestamps around every pass.
    pub timestamps: bool,
    /// Maximum number of replays in flight.
    pub frames_in_flight: usize,
}

/// Learning rates of Adam; those of materials and normals are multiplied by `lr_share` of the step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IntrinsicRates {
    /// Rate of albedo.
    pub albedo: f32,
    /// Rate of roughness.
    pub roughness: f32,
    /// Rate of metallic.
    pub metallic: f32,
    /// Rate of light positions, in world units.
    pub light_positions: f32,
    /// Rate of light lobes.
    pub lights: f32,
    /// Rate of the environment map's texels.
    pub environment: f32,
    /// Rate of the visibility field.
    pub visibility: f32,
    /// Rate of the Gaussians' normals through the light of the point lights; 0 keeps them fixed.
    pub normals: f32,
}

impl IntrinsicOptions {
    /// Returns the irradiance that culled lights may lack at a pixel.
    ///
    /// The value precedes the normalizer and corresponds to [`Self::cull_error`]. The bound assumes an albedo of at
    /// most 1.
    fn missing(&self, normalizer: f32) -> f32 {
        self.cull_error * std::f32::consts::PI / normalizer.max(f32::MIN_POSITIVE)
    }

    /// Returns whether normals are trained.
    pub fn learns_normals(&self) -> bool {
        self.rates.normals > 0.0 && self.lights.is_some()
    }
}

/// Uniforms of a step.
///
/// The photograph and each prior have their own weights and target offset. Camera, step number and seed come from
/// [`Self::shaded`].
#[derive(Clone, Copy, Debug, Default)]
pub struct IntrinsicStepValues {
    /// Uniform of the photograph.
    pub shaded: Step,
    /// Uniform of the albedo prior.
    pub albedo: Step,
    /// Uniform of the roughness prior.
    pub roughness: Step,
    /// Uniform of the metallic prior.
    pub metallic: Step,
    /// Weights of the other material losses.
    pub weights: MaterialWeights,
    /// Uniforms of the pseudo-views, if present.
    pub pseudo: [Step; PSEUDO_VIEWS],
    /// Uniform of the visibility field, if present.
    pub field: FieldStep,
}

/// Intrinsic step, replayable.
pub struct IntrinsicStep {
    exec: Executor,
    steps: Steps,
    surface: SurfaceHandles,
    pseudo: Vec<SurfaceHandles>,
    field: Option<Buffer>,
    /// Irradiance of the view from each physical light.
    view_light: Option<Buffer>,
    images: ImageHandles,
    image: Option<DeviceBuffer>,
    tile: [u32; 2],
    options: IntrinsicOptions,
}

/// Handles of the uniforms.
#[derive(Clone, Copy, Debug)]
pub(super) struct Steps {
    pub shaded: Buffer,
    pub albedo: Buffer,
    pub roughness: Buffer,
    pub metallic: Buffer,
    pub weights: Buffer,
    pub pseudo: [Buffer; PSEUDO_VIEWS],
    /// Uniform whose view has the surfels as pixels; unused without transport.
    pub surfels: Buffer,
}

/// Status that steps report to the host: a counter and a ring of reports.
#[derive(Debug)]
pub struct IntrinsicStatus {
    flags: DeviceBuffer,
    skipped: DeviceBuffer,
    reports: DeviceBuffer,
    /// Smoothness loss of the environment map at its last update.
    ///
    /// Unused if every step updates it.
    smoothness: DeviceBuffer,
}

const REPORTS: u64 = RING as u64 * size_of::<IntrinsicReport>() as u64;

impl IntrinsicStatus {
    /// Bytes of the status buffers.
    pub const BYTES: u64 = 12 + REPORTS;

    /// Allocates the buffers and clears them.
    ///
    /// # Errors
    /// If memory runs out.
    pub fn new(device: &Device) -> Result<IntrinsicStatus> {
        let flags = device.buffer("flags", 4, Location::Device)?;
        let skipped = device.buffer("skipped", 4, Location::Device)?;
        let reports = device.buffer("reports", REPORTS, Location::Readback)?;
        let smoothness = device.buffer("smoothness", 4, Location::Device)?;
        for buffer in [&flags, &skipped, &reports, &smoothness] {
            device.fill(buffer, 0)?;
        }
        Ok(IntrinsicStatus { flags, skipped, reports, smoothness })
    }

    /// Returns the smoothness loss that steps report until the next update.
    ///
    /// # Errors
    /// If the device fails.
    pub fn smoothness(&self, device: &Device) -> Result<f32> {
        Ok(device.download_as(&self.smoothness, 1)?.first().copied().unwrap_or(0.0))
    }

    /// Sets the smoothness loss that steps report until the next update.
    ///
    /// # Errors
    /// If the device fails.
    pub fn set_smoothness(&self, device: &Device, value: f32) -> Result<()> {
        device.upload(&self.smoothness, 0, bytemuck::bytes_of(&value))
    }

    /// Returns the ring of reports. A step has the place of its number, modulo the length of the ring.
    ///
    /// Drivers that run no kernels report nothing; their callers write reports themselves.
    pub fn reports(&self) -> &DeviceBuffer {
        &self.reports
    }

    /// Returns the report of a completed step.
    ///
    /// # Errors
    /// If the memory is not host-visible, which indicates a bug.
    pub fn report(&self, step: u32) -> Result<IntrinsicReport> {
        let bytes = size_of::<IntrinsicReport>() as u64;
        let mut report = IntrinsicReport::default();
        self.reports.read(u64::from(step % RING) * bytes, bytemuck::bytes_of_mut(&mut report))?;
        Ok(report)
    }
}

impl IntrinsicStep {
    /// Builds the graph and binds everything except the surfaces of a view.
    ///
    /// # Errors
    /// If memory runs out.
    pub fn new(
        device: &Device,
        tuning: &Tuning,
        inputs: &IntrinsicInputs<'_>,
        status: &IntrinsicStatus,
        options: IntrinsicOptions,
    ) -> Result<IntrinsicStep> {
        let declared = declare(tuning, &inputs.sizes(), inputs.environment(), &options)?;
        let exec_options = ExecOptions {
            frames_in_flight: options.frames_in_flight,
            timestamps: options.timestamps,
            ..Default::default()
        };
        let mut exec = Executor::new(device, declared.plan, exec_options)?;
        declared.inputs.bind(&mut exec, inputs)?;
        if let (Some(stored), Some(handles)) = (inputs.stored, &declared.stored) {
            stored.bind(&mut exec, handles)?;
        }
        exec.bind(declared.words.flags, &status.flags)?;
        exec.bind(declared.words.skipped, &status.skipped)?;
        exec.bind(declared.words.reports, &status.reports)?;
        if let Some(smoothness) = declared.words.smoothness {
            exec.bind(smoothness, &status.smoothness)?;
        }
        let bytes = 12 * u64::from(options.shape.largest[0]) * u64::from(options.shape.largest[1]);
        let make = || device.buffer("shaded_image", bytes, Location::Device);
        let image = declared.image.map(|_| make()).transpose()?;
        if let (Some(handle), Some(buffer)) = (declared.image, &image) {
            exec.bind(handle, buffer)?;
        }
        let field = declared.inputs.visibility.map(|v| v.field.step);
        let view_light = declared.inputs.transport.map(|t| t.unit);
        Ok(IntrinsicStep {
            exec,
            steps: declared.steps,
            surface: declared.surface,
            pseudo: declared.pseudo,
            field,
            view_light,
            images: declared.inputs.images(),
            image,
            tile: tuning.tile,
            options,
        })
    }

    /// Binds the images of the next steps, if a scene has several buffers of them.
    ///
    /// Buffers that were used before are not recorded again. They are those of the step's view.
    ///
    /// # Errors
    /// If a buffer is smaller than the one that the step was built with.
    pub fn use_images(&mut self, images: &ViewImages<'_>) -> Result<()> {
        self.images.pairs(images).try_for_each(|(handle, memory)| self.exec.alternate(handle, memory))
    }

    /// Compiles the plan of a step without allocating it, to estimate its cost.
    ///
    /// # Errors
    /// If the graph rejects the sizes.
    pub fn plan(
        tuning: &Tuning,
        sizes: &IntrinsicSizes,
        environment: Option<&Environment>,
        options: &IntrinsicOptions,
    ) -> Result<Arc<Plan>> {
        Ok(declare(tuning, sizes, environment, options)?.plan)
    }

    /// Replays the step on a view, and on its pseudo-views if present.
    ///
    /// `light`: irradiance of the view's pixels from each physical light ([`crate::pipeline::ViewLights`]).
    ///
    /// # Errors
    /// If the device fails, or a surface differs in shape from the step's options.
    pub fn submit(
        &mut self,
        surface: &Surface,
        light: Option<&DeviceBuffer>,
        pseudo: &[Surface],
        values: &IntrinsicStepValues,
    ) -> Result<Ticket> {
        surface.alternate(&mut self.exec, &self.surface)?;
        if let (Some(handle), Some(light)) = (self.view_light, light) {
            self.exec.alternate(handle, light)?;
        }
        for (surface, handles) in pseudo.iter().zip(&self.pseudo) {
            surface.bind(&mut self.exec, handles)?;
        }
        let mut shaded = values.shaded;
        let size = shaded.camera.size;
        shaded.camera.tiles = [size[0].div_ceil(self.tile[0]), size[1].div_ceil(self.tile[1])];
        let of = |step: &Step| Step { camera: shaded.camera, step: shaded.step, seed: shaded.seed, ..*step };
        let [albedo, roughness, metallic] = [&values.albedo, &values.roughness, &values.metallic].map(of);
        let s = &self.steps;
        let others = values.pseudo.each_ref().map(|other| {
            let mut other = *other;
            let size = other.camera.size;
            other.camera.tiles = [size[0].div_ceil(self.tile[0]), size[1].div_ceil(self.tile[1])];
            other
        });
        let mut of_surfels = Step::default();
        of_surfels.camera.size = [self.options.transport.map_or(1, |t| t.shape.surfels), 1];
        let mut uniforms: Vec<(Buffer, &[u8])> = Vec::new();
        if self.options.transport.is_some() {
            uniforms.push((s.surfels, bytemuck::bytes_of(&of_surfels)));
        }
        if let Some(field) = self.field {
            uniforms.push((field, bytemuck::bytes_of(&values.field)));
        }
        if !self.pseudo.is_empty() {
            uniforms.extend(s.pseudo.iter().zip(&others).map(|(b, step)| (*b, bytemuck::bytes_of(step))));
        }
        uniforms.extend([
            (s.shaded, bytemuck::bytes_of(&shaded)),
            (s.albedo, bytemuck::bytes_of(&albedo)),
            (s.roughness, bytemuck::bytes_of(&roughness)),
            (s.metallic, bytemuck::bytes_of(&metallic)),
            (s.weights, bytemuck::bytes_of(&values.weights)),
        ]);
        self.exec.submit(&uniforms)
    }

    /// Waits for every replay in flight.
    ///
    /// # Errors
    /// If the device fails.
    pub fn finish(&mut self) -> Result<()> {
        self.exec.finish()
    }

    /// Returns the shaded image of the last step (waits for the device).
    ///
    /// Display-referred, three floats per pixel of the largest view. Empty unless [`IntrinsicOptions::image`] is set.
    ///
    /// # Errors
    /// If the device fails.
    pub fn image(&mut self, device: &Device) -> Result<Vec<f32>> {
        self.exec.finish()?;
        match &self.image {
            Some(buffer) => device.download_as(buffer, buffer.bytes() as usize / 4),
            None => Ok(Vec::new()),
        }
    }

    /// Returns the options of the step.
    pub fn options(&self) -> &IntrinsicOptions {
        &self.options
    }

    /// Returns the host time of all replays.
    pub fn host_times(&self) -> HostTimes {
        self.exec.host_times()
    }

    /// Returns the executor, for its plan and its pass times.
    pub fn executor(&mut self) -> &mut Executor {
        &mut self.exec
    }
}

/// Compiled step and the handles to bind.
struct Declared {
    plan: Arc<Plan>,
    steps: Steps,
    surface: SurfaceHandles,
    pseudo: Vec<SurfaceHandles>,
    words: Words,
    inputs: Inputs,
    stored: Option<StoredFilter>,
    image: Option<Buffer>,
}

fn declare(
    t: &Tuning,
    sizes: &IntrinsicSizes,
    environment: Option<&Environment>,
    o: &IntrinsicOptions,
) -> Result<Declared> {
    let mut g = Graph::new("intrinsic_step");
    let mut uniform = |name: &str| g.uniform(name, size_of::<Step>() as u64);
    let steps = Steps {
        shaded: uniform("step"),
        albedo: uniform("albedo_step"),
        roughness: uniform("roughness_step"),
        metallic: uniform("metallic_step"),
        weights: g.uniform("material_weights", size_of::<MaterialWeights>() as u64),
        pseudo: ["pseudo0", "pseudo1"].map(|name| g.uniform(name, size_of::<Step>() as u64)),
        surfels: g.uniform("surfel_step", size_of::<Step>() as u64),
    };
    let surface = o.shape.declare(&mut g, "", false);
    let pseudo: Vec<SurfaceHandles> = match o.cross_view {
        true => (0..PSEUDO_VIEWS).map(|i| o.shape.declare(&mut g, &format!("pseudo{i}."), false)).collect(),
        false => Vec::new(),
    };
    let words = Words {
        flags: g.input("flags", 4),
        skipped: g.external("skipped", 4),
        reports: g.external("reports", REPORTS),
        smoothness: (environment.is_some() && o.environment_every > 1).then(|| g.input("smoothness", 4)),
    };
    let tables: Option<(EnvironmentTables, u32)> = environment.map(|e| (e.declare(&mut g), e.floats()));
    let inputs = Inputs::declare(&mut g, sizes, tables, o, t.accuracy.visibility_bits);
    let stored = environment.filter(|_| o.environment_every > 1).map(|e| StoredFilter::declare(&mut g, e, false));
    let resources = StepResources {
        steps: &steps,
        surface: &surface,
        pseudo: &pseudo,
        inputs: &inputs,
        environment,
        stored: stored.as_ref(),
        words: &words,
    };
    let shaded = build(&mut g, t, &resources, o)?;
    let image = o.image.then_some(shaded);
    let plan = Arc::new(g.compile(&CompileOptions::default())?);
    Ok(Declared { plan, steps, surface, pseudo, words, inputs, stored, image })
}
