//! Shades Gaussians with materials and downloads each term.
//!
//! Light comes from point lights and an environment map.

use super::shaded::{Shaded, ShadedEnvironment, ShadedLights, ShadedVisibility};
use super::transport::{EmitterHandles, FrameEmitter, ShadedTransport, Terms};
use super::{Step, Surface, SurfaceBuilder, SurfaceHandles, SurfaceShape};
use crate::Tuning;
use crate::scene::{Gaussians, Trainable, TrainableHandles};
use crate::shade::environment::{
    EnvironmentTables, EnvironmentView, environment as ambient_light, environment_background, environment_diffuse,
    environment_filter,
};
use crate::shade::lights::{LightParameters, Lights, Shape, lights_prepare, lights_split};
use crate::shade::traced::{Traced, lights_split_traced};
use crate::shade::visibility::{FieldHandles, View as VisibilityView, lights_split_field, visibility};
use crate::shade::{ALBEDO_RANGE, PixelMaterials, Pixels, RawMaterials, materials, values};
use crate::splat::Screen;
use sgs_engine::exec::{ExecOptions, Executor};
use sgs_engine::graph::{Buffer, CompileOptions, Graph};
use sgs_engine::{Device, DeviceBuffer, Location, Result};
use sgs_shaders::structs::{Camera, FieldStep};
use std::sync::Arc;
use std::time::Instant;

/// Shading inputs in device memory.
#[derive(Debug)]
pub struct ShadedScene {
    /// World length of one unit in device memory.
    ///
    /// Gaussians, lights and the visibility field are positioned in this unit; gains are divided by its square. Cameras
    /// passed in and points returned are in world units.
    pub unit: f32,
    /// Gaussians with normals.
    pub gaussians: Gaussians,
    /// Raw albedo, 3 floats per Gaussian.
    pub albedo: Trainable,
    /// Raw roughness, 1 float per Gaussian.
    pub roughness: Trainable,
    /// Raw metallic, 1 float per Gaussian, if present.
    pub metallic: Option<Trainable>,
    /// Point lights.
    pub lights: Option<ShadedLights>,
    /// Environment map.
    pub environment: Option<ShadedEnvironment>,
    /// Visibility of the lights; without it nothing occludes them.
    pub visibility: Option<ShadedVisibility>,
    /// Physical lights, light that bounces, and emission.
    pub transport: Option<ShadedTransport>,
}

impl ShadedScene {
    /// Converts a camera from world units to the scene's unit.
    pub(super) fn camera(&self, camera: &Camera) -> Camera {
        let by = 1.0 / self.unit;
        let mut camera = *camera;
        camera.world_to_camera.iter_mut().for_each(|row| row[3] *= by);
        camera.position.iter_mut().for_each(|v| *v *= by);
        camera.near *= by;
        camera
    }

    /// Changes the emitters of a scene with responses, in world units.
    ///
    /// Frames of [`super::LitView`] bring their own. Does nothing unless there are as many emitters in the scene.
    pub fn set_emitters(&mut self, emitters: &[FrameEmitter]) {
        let by = 1.0 / self.unit;
        if let Some(t) = self.transport.as_mut().filter(|t| t.emitters() as usize == emitters.len()) {
            t.set_emitters(emitters.iter().map(|e| e.scaled(by)).collect());
        }
    }
}

/// Reusable shader of views.
pub struct Shader {
    device: Device,
    tuning: Tuning,
    builder: SurfaceBuilder,
    surface: Option<Surface>,
    state: Option<State>,
    /// Camera of the current surface.
    seen: Option<Camera>,
    /// Computes [`Shaded::visibility`].
    visibility: bool,
}

struct State {
    shape: SurfaceShape,
    exec: Executor,
    step: Buffer,
    surface: SurfaceHandles,
    /// Uniform of the visibility field.
    field: Option<Buffer>,
    /// Whether visibility is requested and the scene has occlusion.
    hidden: bool,
    outputs: Vec<DeviceBuffer>,
    /// Terms of physical lights and of bounced light, in the order of [`TERMS`].
    terms: Vec<DeviceBuffer>,
    /// Uniforms of emitters whose light changes.
    emitters: Option<EmitterHandles>,
}

/// Names of the terms of physical lights and of bounced light.
///
/// Each has 3 floats per pixel.
const TERMS: [&str; 4] = ["light_diffuse", "light_specular", "indirect", "emission"];

/// Name and floats per pixel of each output, in the order of the bindings.
const OUTPUTS: [(&str, u64); 8] = [
    ("shaded_materials", 4),
    ("shaded_metallic", 1),
    ("shaded_direct", 3),
    ("shaded_direct_diffuse", 3),
    ("shaded_ambient", 3),
    ("shaded_ambient_diffuse", 3),
    ("shaded_background", 3),
    ("shaded_visibility", 1),
];

/// Index of the light of the point lights in [`OUTPUTS`].
const DIRECT: usize = 2;

impl Shader {
    /// Prepares for views of at most `largest` columns and rows; a larger view grows the buffers.
    ///
    /// # Errors
    /// If memory runs out.
    pub fn new(device: &Device, tuning: Tuning, scene: &ShadedScene, largest: [u32; 2]) -> Result<Shader> {
        let builder = SurfaceBuilder::new(device, tuning, &scene.gaussians, largest)?;
        Ok(Shader { device: device.clone(), tuning, builder, surface: None, state: None, seen: None, visibility: true })
    }

    /// Leaves [`Shaded::visibility`] empty.
    ///
    /// That mean covers all lights, including those that are off. With a learned field it takes as long as shading with
    /// all lights.
    pub fn without_visibility(mut self) -> Shader {
        (self.visibility, self.state) = (false, None);
        self
    }

    /// Shades a view and downloads all outputs.
    ///
    /// # Errors
    /// If memory runs out or the device fails.
    pub fn shade(&mut self, scene: &ShadedScene, camera: &Camera) -> Result<Shaded> {
        self.run(scene, camera)?;
        let (Some(state), Some(surface)) = (&self.state, &self.surface) else { return Ok(Shaded::default()) };
        let shaded = state.download(&self.device, scene, surface, camera);
        if shaded.is_err() {
            self.seen = None;
        }
        shaded
    }

    /// Shades the last view again under the current lights and downloads all outputs.
    ///
    /// Reuses the surface of that view if `camera` is its camera.
    ///
    /// # Errors
    /// If memory runs out or the device fails.
    pub fn shade_again(&mut self, scene: &ShadedScene, camera: &Camera) -> Result<Shaded> {
        if self.again(scene, camera)?.is_none() {
            return self.shade(scene, camera);
        }
        let (Some(state), Some(surface)) = (&self.state, &self.surface) else { return Ok(Shaded::default()) };
        state.download(&self.device, scene, surface, &scene.camera(camera))
    }

    /// Shades a view without readback and returns the duration.
    ///
    /// The duration counts seconds of submitted work, without allocation.
    ///
    /// # Errors
    /// If memory runs out or the device fails.
    pub fn time(&mut self, scene: &ShadedScene, camera: &Camera) -> Result<f64> {
        let seconds = self.run(scene, camera);
        // `Shader::again` needs a view whose outputs were downloaded.
        self.seen = None;
        seconds
    }

    /// Shades a view and leaves the outputs on the device. Returns the seconds without allocation.
    fn run(&mut self, scene: &ShadedScene, camera: &Camera) -> Result<f64> {
        self.seen = None;
        let camera = &scene.camera(camera);
        let largest = self.builder.shape().largest;
        let needed = [largest[0].max(camera.size[0]), largest[1].max(camera.size[1])];
        if needed != largest {
            self.state = None;
            self.surface = None;
            self.builder = SurfaceBuilder::new(&self.device, self.tuning, &scene.gaussians, needed)?;
        }
        let start = Instant::now();
        self.builder.measure(&scene.gaussians, camera)?;
        let mut seconds = start.elapsed().as_secs_f64();
        let shape = self.builder.shape();
        let surface = match self.surface.take().filter(|s| s.shape() == shape) {
            Some(surface) => surface,
            None => Surface::new(&self.device, shape)?,
        };
        let start = Instant::now();
        self.builder.fill(&scene.gaussians, camera, &surface)?;
        self.builder.finish()?;
        seconds += start.elapsed().as_secs_f64();
        let mut state = match self.state.take().filter(|s| s.shape == shape) {
            Some(state) => state,
            None => State::new(&self.device, &self.tuning, scene, shape, self.visibility)?,
        };
        let start = Instant::now();
        let done = state.run(&self.tuning, scene, &surface, camera);
        seconds += start.elapsed().as_secs_f64();
        self.surface = Some(surface);
        self.state = Some(state);
        self.seen = done.is_ok().then_some(*camera);
        done.map(|()| seconds)
    }

    /// Shades the last view again under the current lights.
    ///
    /// Reuses the surface of that view. Returns the light of the point lights, 3 floats per pixel as
    /// [`Shaded::direct`]. Returns `None` if `camera` is not the camera of the last shaded view.
    ///
    /// # Errors
    /// If memory runs out or the device fails.
    pub fn again(&mut self, scene: &ShadedScene, camera: &Camera) -> Result<Option<Vec<f32>>> {
        let camera = &scene.camera(camera);
        let same = self.seen.is_some_and(|seen| bytemuck::bytes_of(&seen) == bytemuck::bytes_of(camera));
        match (&mut self.state, &self.surface) {
            (Some(state), Some(surface)) if same => {
                state.run(&self.tuning, scene, surface, camera)?;
                state.read(&self.device, DIRECT, camera).map(Some)
            }
            _ => Ok(None),
        }
    }

    /// Shades each Gaussian at its center, as seen from a point.
    ///
    /// Pixel `i` of `surface` ([`Surface::of_gaussians`]) is Gaussian `i`. The surface and the point are in the scene's
    /// unit.
    ///
    /// # Errors
    /// If memory runs out or the device fails.
    pub fn shade_centers(&mut self, scene: &ShadedScene, surface: &Surface, from: [f32; 3]) -> Result<Shaded> {
        self.seen = None;
        let shape = surface.shape();
        let mut state = match self.state.take().filter(|s| s.shape == shape) {
            Some(state) => state,
            None => State::new(&self.device, &self.tuning, scene, shape, self.visibility)?,
        };
        // The position of a pixel in the image affects only the background, which no caller reads.
        let camera = Camera {
            world_to_camera: [[1.0, 0.0, 0.0, -from[0]], [0.0, 1.0, 0.0, -from[1]], [0.0, 0.0, 1.0, -from[2]]],
            position: from,
            near: 1e-3,
            focal: [1.0; 2],
            size: shape.largest,
            ..Camera::default()
        };
        let done = state.run(&self.tuning, scene, surface, &camera);
        let shaded = done.and_then(|()| state.download(&self.device, scene, surface, &camera));
        self.state = Some(state);
        shaded
    }

    /// Discards the plan, after components of the scene were added or removed.
    pub fn forget(&mut self) {
        self.state = None;
    }
}

impl State {
    fn new(device: &Device, t: &Tuning, scene: &ShadedScene, shape: SurfaceShape, means: bool) -> Result<State> {
        let mut g = Graph::new("shade");
        let step = g.uniform("step", size_of::<Step>() as u64);
        let surface = shape.declare(&mut g, "", false);
        let screen = Screen { step, largest: shape.largest, tile: t.tile };
        let pixels = screen.pixels();
        let out = OUTPUTS.map(|(name, floats)| g.external(name, 4 * floats * pixels));
        let mut bound: Vec<(&Trainable, TrainableHandles)> = Vec::new();
        let take = |g: &mut Graph, what: &'static str, trained: &'_ Trainable| {
            Trainable::handles(g, what, trained.floats(), false)
        };
        let albedo = take(&mut g, "albedo", &scene.albedo);
        let roughness = take(&mut g, "roughness", &scene.roughness);
        bound.extend([(&scene.albedo, albedo), (&scene.roughness, roughness)]);
        let metallic = scene.metallic.as_ref().map(|m| {
            let handles = take(&mut g, "metallic", m);
            bound.push((m, handles));
            handles.parameters
        });
        let raw = RawMaterials {
            albedo_range: ALBEDO_RANGE,
            albedo: albedo.parameters,
            roughness: roughness.parameters,
            metallic,
        };
        let of_gaussians = values(&mut g, t, &raw, shape.gaussians)?;
        let of_pixels = PixelMaterials { materials: out[0], metallic: metallic.map(|_| out[1]) };
        materials(&mut g, t, &screen, &of_gaussians, &surface.weights, &of_pixels)?;
        let seen = &surface.surfaces;
        let lit = Pixels { screen, surfaces: *seen, materials: of_pixels };
        let mut field: Option<FieldHandles> = None;
        let mut tree: Option<Traced> = None;
        if let Some(l) = &scene.lights {
            let [positions, lobes, gains] = [("positions", &l.positions), ("lobes", &l.lobes), ("gains", &l.gains)]
                .map(|(name, trained)| {
                    let handles = take(&mut g, name, trained);
                    bound.push((trained, handles));
                    handles.parameters
                });
            let parameters = LightParameters { positions, lobes, gains };
            let prepared = lights_prepare(&mut g, *t, "lights_prepare", step, l.model, &parameters, None)?;
            let lights = Lights { pixels: lit, prepared, normalizer: l.normalizer, shape: Shape::for_device(*t) };
            match &scene.visibility {
                Some(ShadedVisibility::Traced { shape, .. }) => {
                    let traced = Traced::declare(&mut g, shape);
                    lights_split_traced(&mut g, *t, &lights, &traced, [out[2], out[3]], out[7])?;
                    tree = Some(traced);
                }
                Some(ShadedVisibility::Field { field: trained, .. }) => {
                    let handles = trained.declare(&mut g, false);
                    lights_split_field(&mut g, *t, &lights, &handles.field, out[2], out[3])?;
                    let view = VisibilityView {
                        pixels: pixels as u32,
                        points: seen.points,
                        coverage: seen.coverage,
                        lights: positions,
                    };
                    if means {
                        visibility(&mut g, *t, &handles.field, &view, None, true, out[7])?;
                    }
                    field = Some(handles);
                }
                None => lights_split(&mut g, &lights, out[2], out[3])?,
            }
        } else {
            g.fill("no_direct", out[2], 0)?;
            g.fill("no_direct_diffuse", out[3], 0)?;
        }
        let mut tables: Option<EnvironmentTables> = None;
        if let Some(e) = &scene.environment {
            let declared = e.tables.declare(&mut g);
            tables = Some(declared);
            let texels = take(&mut g, "texels", &e.texels);
            bound.push((&e.texels, texels));
            let filtered = environment_filter(&mut g, t, &e.tables, &declared, texels.parameters)?;
            let view = EnvironmentView::from(&lit);
            ambient_light(&mut g, t, &e.tables, &declared, &view, &filtered, out[4])?;
            environment_diffuse(&mut g, t, &e.tables, &declared, &view, &filtered, out[5])?;
            environment_background(&mut g, t, &e.tables, step, pixels, texels.parameters, out[6])?;
        } else {
            for (name, buffer) in ["no_ambient", "no_ambient_diffuse", "no_background"].into_iter().zip(&out[4..]) {
                g.fill(name, *buffer, 0)?;
            }
        }
        let mut transport = None;
        if let Some(lit_by) = &scene.transport {
            let declared = lit_by.declare(&mut g);
            let terms = Terms { each: TERMS.map(|name| g.external(name, 12 * pixels)) };
            lit_by.shade(&mut g, t, &declared, (&lit, (&surface.weights).into()), &terms)?;
            transport = Some((lit_by, declared, terms));
        }
        if metallic.is_none() {
            g.fill("no_metallic", out[1], 0)?;
        }
        // Traced shading also writes visibility.
        if tree.is_none() && (field.is_none() || !means) {
            g.fill("no_visibility", out[7], 0)?;
        }
        let hidden = means && (field.is_some() || tree.is_some());
        let plan = Arc::new(g.compile(&CompileOptions::default())?);
        let outputs = OUTPUTS
            .iter()
            .map(|(name, floats)| device.buffer(name, 4 * floats * pixels, Location::Device))
            .collect::<Result<Vec<_>>>()?;
        let mut exec = Executor::new(device, plan, ExecOptions { frames_in_flight: 1, ..Default::default() })?;
        for (handle, buffer) in out.iter().zip(&outputs) {
            exec.bind(*handle, buffer)?;
        }
        for (memory, handles) in bound {
            memory.bind(&mut exec, &handles)?;
        }
        let mut term_memory = Vec::new();
        if let Some((lit_by, declared, terms)) = &transport {
            lit_by.bind(&mut exec, declared)?;
            for (name, handle) in TERMS.iter().zip(terms.each) {
                let buffer = device.buffer(name, 12 * pixels, Location::Device)?;
                exec.bind(handle, &buffer)?;
                term_memory.push(buffer);
            }
        }
        if let (Some(e), Some(tables)) = (&scene.environment, &tables) {
            e.memory.bind(&mut exec, &e.tables, tables)?;
        }
        if let (Some(ShadedVisibility::Field { field, .. }), Some(handles)) = (&scene.visibility, &field) {
            field.bind(&mut exec, handles)?;
        }
        if let (Some(ShadedVisibility::Traced { memory, .. }), Some(handles)) = (&scene.visibility, &tree) {
            memory.bind(&mut exec, handles)?;
        }
        let field = field.map(|f| f.field.step);
        let emitters = transport.as_ref().and_then(|(_, declared, _)| declared.emitters());
        Ok(State { shape, exec, step, surface, field, hidden, outputs, terms: term_memory, emitters })
    }

    /// Computes all outputs for a view of a surface.
    fn run(&mut self, t: &Tuning, scene: &ShadedScene, surface: &Surface, camera: &Camera) -> Result<()> {
        surface.bind(&mut self.exec, &self.surface)?;
        let mut camera = *camera;
        camera.tiles = [camera.size[0].div_ceil(t.tile[0]), camera.size[1].div_ceil(t.tile[1])];
        let step = Step { camera, step: 1, ..Default::default() };
        let place = match &scene.visibility {
            Some(ShadedVisibility::Field { place, .. }) => FieldStep {
                pixels: camera.size[0] * camera.size[1],
                lights: scene.lights.as_ref().map_or(0, |l| l.model.lights),
                ..*place
            },
            _ => FieldStep::default(),
        };
        let mut uniforms = vec![(self.step, bytemuck::bytes_of(&step))];
        if let Some(field) = self.field {
            uniforms.push((field, bytemuck::bytes_of(&place)));
        }
        let frame = scene.transport.as_ref().map(ShadedTransport::uniforms);
        if let (Some(handles), Some(frame)) = (&self.emitters, &frame) {
            uniforms.extend(frame.of(handles));
        }
        self.exec.submit(&uniforms)?;
        self.exec.finish()
    }

    /// Downloads one output of the last shaded view.
    fn read(&self, device: &Device, output: usize, camera: &Camera) -> Result<Vec<f32>> {
        let pixels = camera.size[0] as usize * camera.size[1] as usize;
        device.download_as(&self.outputs[output], OUTPUTS[output].1 as usize * pixels)
    }

    /// Downloads all outputs of the last shaded view.
    fn download(&self, device: &Device, scene: &ShadedScene, surface: &Surface, camera: &Camera) -> Result<Shaded> {
        let pixels = camera.size[0] as usize * camera.size[1] as usize;
        let [points, normals, coverage] = surface.download(device)?;
        let cut = |mut values: Vec<f32>, width: usize| {
            values.truncate(width * pixels);
            values
        };
        let read = |i: usize| self.read(device, i, camera);
        let all = camera.size[0] as usize * camera.size[1] as usize;
        let terms: Vec<Vec<f32>> =
            self.terms.iter().map(|buffer| device.download_as(buffer, 3 * all)).collect::<Result<_>>()?;
        let [mut direct, mut direct_diffuse] = [read(DIRECT)?, read(3)?];
        let add = |into: &mut Vec<f32>, term: &[f32]| into.iter_mut().zip(term).for_each(|(sum, v)| *sum += v);
        if let [diffuse, specular, ..] = &terms[..] {
            add(&mut direct, diffuse);
            add(&mut direct, specular);
            add(&mut direct_diffuse, diffuse);
        }
        let mut rest = terms.into_iter().skip(2);
        Ok(Shaded {
            size: camera.size,
            points: cut(points, 3).into_iter().map(|v| v * scene.unit).collect(),
            normals: cut(normals, 3),
            coverage: cut(coverage, 1),
            materials: read(0)?,
            metallic: if scene.metallic.is_some() { read(1)? } else { Vec::new() },
            direct,
            direct_diffuse,
            ambient: read(4)?,
            ambient_diffuse: read(5)?,
            background: read(6)?,
            visibility: if self.hidden { read(7)? } else { Vec::new() },
            indirect: rest.next().unwrap_or_default(),
            emission: rest.next().unwrap_or_default(),
        })
    }
}
