//! One step of the intrinsic stage: shade a view, compare, go back, update materials, lights, surroundings and shadows.
//!
//! Geometry stands still. What the view sees of it ([`super::Surface`]) is bound before each step; nothing of the size of
//! pixels times lights is stored; the host waits for nothing.

mod across;
mod build;
mod inputs;
mod priors;
mod refresh;
mod relit;

pub use inputs::{COPIES, EnvironmentMemory, IntrinsicInputs, IntrinsicParameters, IntrinsicSizes};
pub use refresh::{EnvironmentRefresh, KeptEnvironment};
pub use relit::{RelitOptions, RelitView};

use self::build::{Words, build};
use self::inputs::Declared as Inputs;
use super::status::RING;
use super::{Masks, PSEUDO_VIEWS, Step, Surface, SurfaceHandles, SurfaceShape};
use crate::Tuning;
use crate::shade::environment::{Environment, EnvironmentTables, Kept};
use crate::shade::lights::LightModel;
use crate::shade::traced::TracedShape;
use crate::shade::visibility::FieldConfig;
use sgs_engine::graph::exec::{ExecOptions, Executor};
use sgs_engine::graph::{Buffer, CompileOptions, Graph, Plan};
use sgs_engine::{Device, DeviceBuffer, Location, Result, Ticket};
use sgs_shaders::structs::{FieldStep, IntrinsicReport, MaterialWeights};
use std::sync::Arc;

/// What an intrinsic step is made of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IntrinsicOptions {
    /// Columns and rows that no view exceeds, Gaussians, and room for weights.
    pub shape: SurfaceShape,
    /// The lowest albedo, and how far above it the highest lies.
    pub albedo_range: [f32; 2],
    /// Whether there is a metallic value for each Gaussian.
    pub metallic: bool,
    /// Point lights, and the factor of all their light: one over their number at the start.
    pub lights: Option<(LightModel, f32)>,
    /// What lights see, if it is learned.
    pub visibility: Option<FieldConfig>,
    /// What lights see, if it is traced; the tree itself is an input. Nothing is learned of it.
    pub traced: Option<TracedShape>,
    /// Whether visibility is not to notice a jitter of places.
    pub visibility_jitter: bool,
    /// One pair of pixel and light of so many teaches the field, for as many: 1 is all of them.
    pub visibility_sample: u32,
    /// Weights of the lights' nearness to surfaces and of their amplitudes.
    pub light_regularizers: [f32; 2],
    /// Lights whose amplitudes are all below this share of the largest are switched off for good; 0 keeps all.
    pub light_prune: f32,
    /// What lamps' diffuse radiance may be short of, each channel, because lights too faint to matter are left out of blocks of
    /// pixels; 0 leaves none out. Specular radiance is short of `1 / (2 roughness^6)` times that at most
    /// ([`crate::shade::lights::lights_prepare_culled`]).
    pub cull_error: f32,
    /// Weight of the environment's smoothness; the environment itself is an input.
    pub environment_smooth: f32,
    /// Of how many steps the environment's texels move after one, by what all of these asked of them; its levels stay meanwhile
    /// ([`EnvironmentRefresh`]). 1: with every step.
    pub environment_every: u32,
    /// Whether albedo and roughness are to be smooth where the photograph is.
    pub edge_aware: bool,
    /// Whether their gradients are compared with those of the priors at several scales.
    pub gradients: bool,
    /// How the step's region is found in the training view and in pseudo-views.
    pub masks: Masks,
    /// Whether a region's albedo is compared with two pseudo-views; needs regions among the inputs.
    pub cross_view: bool,
    /// Whether albedo in the region is compared with estimates of it under other lights; needs these and regions.
    pub relight: bool,
    /// Whether albedo in the region is compared with the view's own prior; needs that and regions.
    pub own_prior: bool,
    /// What roughness in the region weighs beside albedo, where there are estimates of it under other lights.
    pub relight_roughness: f32,
    /// Pixels that are too bright keep the gradients that lead them back.
    pub returning: bool,
    /// Learning rates.
    pub rates: IntrinsicRates,
    /// Whether the shaded picture can be had after a step ([`IntrinsicStep::picture`]).
    pub picture: bool,
    /// Timestamps around every pass.
    pub timestamps: bool,
    /// Replays in flight.
    pub frames_in_flight: usize,
}

/// Learning rates of Adam. Those of materials and normals count times `lr_share` of the step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IntrinsicRates {
    /// Of albedo.
    pub albedo: f32,
    /// Of roughness.
    pub roughness: f32,
    /// Of metallic.
    pub metallic: f32,
    /// Of lights' places, world units.
    pub light_positions: f32,
    /// Of their lobes.
    pub lights: f32,
    /// Of the environment's texels.
    pub environment: f32,
    /// Of the visibility field.
    pub visibility: f32,
    /// Of the Gaussians' normals, through the light of lamps; 0 leaves them as they are.
    pub normals: f32,
}

impl IntrinsicOptions {
    /// What irradiance may miss before the normalizer, for [`Self::cull_error`]: no albedo is above 1.
    fn missing(&self, normalizer: f32) -> f32 {
        self.cull_error * std::f32::consts::PI / normalizer.max(f32::MIN_POSITIVE)
    }

    /// Whether normals are learned.
    pub fn learns_normals(&self) -> bool {
        self.rates.normals > 0.0 && self.lights.is_some()
    }
}

/// The uniforms of a step: what the shaded picture is compared with, and the priors, each with weights and offset of its
/// own. Camera and step number are those of the first.
#[derive(Clone, Copy, Debug, Default)]
pub struct IntrinsicStepValues {
    /// The photograph.
    pub shaded: Step,
    /// The albedo prior.
    pub albedo: Step,
    /// The roughness prior.
    pub roughness: Step,
    /// The metallic prior.
    pub metallic: Step,
    /// Of the other losses of materials.
    pub weights: MaterialWeights,
    /// The pseudo-views', where there are some.
    pub pseudo: [Step; PSEUDO_VIEWS],
    /// Of the visibility field, where there is one.
    pub field: FieldStep,
}

/// An intrinsic step, ready to be replayed.
pub struct IntrinsicStep {
    exec: Executor,
    steps: Steps,
    surface: SurfaceHandles,
    pseudo: Vec<SurfaceHandles>,
    field: Option<Buffer>,
    picture: Option<DeviceBuffer>,
    tile: [u32; 2],
    options: IntrinsicOptions,
}

/// The uniforms.
#[derive(Clone, Copy, Debug)]
pub(super) struct Steps {
    pub shaded: Buffer,
    pub albedo: Buffer,
    pub roughness: Buffer,
    pub metallic: Buffer,
    pub weights: Buffer,
    pub pseudo: [Buffer; PSEUDO_VIEWS],
}

/// What steps tell the host: a counter, and a ring of reports.
#[derive(Debug)]
pub struct IntrinsicStatus {
    flags: DeviceBuffer,
    skipped: DeviceBuffer,
    reports: DeviceBuffer,
    /// Smoothness of the environment when its texels last moved, where they do not move in each step.
    smoothness: DeviceBuffer,
}

const REPORTS: u64 = RING as u64 * size_of::<IntrinsicReport>() as u64;

impl IntrinsicStatus {
    /// What it takes.
    pub const BYTES: u64 = 12 + REPORTS;

    /// Makes it, all clear.
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

    /// The smoothness that steps report until texels move again.
    ///
    /// # Errors
    /// If the device fails.
    pub fn smoothness(&self, device: &Device) -> Result<f32> {
        Ok(device.download_as(&self.smoothness, 1)?.first().copied().unwrap_or(0.0))
    }

    /// Sets the smoothness that steps report until texels move again.
    ///
    /// # Errors
    /// If the device fails.
    pub fn set_smoothness(&self, device: &Device, value: f32) -> Result<()> {
        device.upload(&self.smoothness, 0, bytemuck::bytes_of(&value))
    }

    /// The report of a step that is done.
    ///
    /// # Errors
    /// If the memory is not visible, which would be a defect.
    pub fn report(&self, step: u32) -> Result<IntrinsicReport> {
        let bytes = size_of::<IntrinsicReport>() as u64;
        let mut report = IntrinsicReport::default();
        self.reports.read(u64::from(step % RING) * bytes, bytemuck::bytes_of_mut(&mut report))?;
        Ok(report)
    }
}

impl IntrinsicStep {
    /// Builds the graph and binds everything but what a view sees.
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
        if let (Some(kept), Some(handles)) = (inputs.kept, &declared.kept) {
            kept.bind(&mut exec, handles)?;
        }
        exec.bind(declared.words.flags, &status.flags)?;
        exec.bind(declared.words.skipped, &status.skipped)?;
        exec.bind(declared.words.reports, &status.reports)?;
        if let Some(smoothness) = declared.words.smoothness {
            exec.bind(smoothness, &status.smoothness)?;
        }
        let bytes = 12 * u64::from(options.shape.largest[0]) * u64::from(options.shape.largest[1]);
        let make = || device.buffer("shaded_picture", bytes, Location::Device);
        let picture = declared.picture.map(|_| make()).transpose()?;
        if let (Some(handle), Some(buffer)) = (declared.picture, &picture) {
            exec.bind(handle, buffer)?;
        }
        let field = declared.inputs.visibility.map(|v| v.field.step);
        Ok(IntrinsicStep {
            exec,
            steps: declared.steps,
            surface: declared.surface,
            pseudo: declared.pseudo,
            field,
            picture,
            tile: tuning.tile,
            options,
        })
    }

    /// The plan of a step that does not exist yet, for what it would cost.
    ///
    /// # Errors
    /// If the sizes make no graph.
    pub fn plan(
        tuning: &Tuning,
        sizes: &IntrinsicSizes,
        environment: Option<&Environment>,
        options: &IntrinsicOptions,
    ) -> Result<Arc<Plan>> {
        Ok(declare(tuning, sizes, environment, options)?.plan)
    }

    /// Replays the step on a view, and its pseudo-views if it has some.
    ///
    /// # Errors
    /// If the device fails, or a surface has another shape than the step was made for.
    pub fn submit(&mut self, surface: &Surface, pseudo: &[Surface], values: &IntrinsicStepValues) -> Result<Ticket> {
        surface.bind(&mut self.exec, &self.surface)?;
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
        let mut uniforms: Vec<(Buffer, &[u8])> = Vec::new();
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

    /// What the last step shaded, display-referred, three floats a pixel of the largest view (waits for the device). Nothing where
    /// [`IntrinsicOptions::picture`] did not ask for it.
    ///
    /// # Errors
    /// If the device fails.
    pub fn picture(&mut self, device: &Device) -> Result<Vec<f32>> {
        self.exec.finish()?;
        match &self.picture {
            Some(buffer) => device.download_as(buffer, buffer.bytes() as usize / 4),
            None => Ok(Vec::new()),
        }
    }

    /// What it was made of.
    pub fn options(&self) -> &IntrinsicOptions {
        &self.options
    }

    /// The executor, for its plan and its times.
    pub fn executor(&mut self) -> &mut Executor {
        &mut self.exec
    }
}

/// A compiled step and what is bound to it.
struct Declared {
    plan: Arc<Plan>,
    steps: Steps,
    surface: SurfaceHandles,
    pseudo: Vec<SurfaceHandles>,
    words: Words,
    inputs: Inputs,
    kept: Option<Kept>,
    picture: Option<Buffer>,
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
    let inputs = Inputs::declare(&mut g, sizes, tables, o, t.accuracy.table_bits);
    let kept = environment.filter(|_| o.environment_every > 1).map(|e| Kept::declare(&mut g, e, false));
    let shaded = build(&mut g, t, &steps, &surface, &pseudo, &inputs, environment, kept.as_ref(), &words, o)?;
    let picture = o.picture.then_some(shaded);
    let plan = Arc::new(g.compile(&CompileOptions::default())?);
    Ok(Declared { plan, steps, surface, pseudo, words, inputs, kept, picture })
}
