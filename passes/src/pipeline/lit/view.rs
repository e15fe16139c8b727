//! Frames of a shaded view.

use super::build::{Built, build, field_step};
use super::{Lighting, LitFrame, LitLayer, LitOptions, LitScene};
use crate::Tuning;
use crate::pipeline::transport::{Declared, FrameUniforms, ShadedShape};
use crate::pipeline::{ShadedTransport, ShadedVisibility, Step, ViewError, ViewReport, ViewResult};
use crate::shade::lights::{LightModel, LightParameters};
use crate::shade::traced::TracedShape;
use sgs_engine::exec::{ExecOptions, Executor};
use sgs_engine::graph::Buffer;
use sgs_engine::{Device, DeviceBuffer, DeviceImage, ImageFormat, Location};
use sgs_shaders::structs::LitStep;

/// Renderer of shaded views into images of one size and format, frame by frame.
pub struct LitView {
    device: Device,
    tuning: Tuning,
    options: LitOptions,
    capacity: [u32; 2],
    report: [DeviceBuffer; 2],
    state: State,
    /// Earlier plans of which a host still holds recordings.
    retired: Vec<Executor>,
    built: u32,
}

struct State {
    key: Key,
    exec: Executor,
    built: Built,
}

/// Inputs of a plan besides the options of the view; a change rebuilds the plan.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Key {
    gaussians: u32,
    metallic: bool,
    field: Option<u32>,
    tree: Option<TracedShape>,
    environment: Option<u32>,
    model: LightModel,
    normalizer: u32,
    transport: Option<ShadedShape>,
}

impl Key {
    fn of(scene: &LitScene, lighting: &Lighting) -> Key {
        let s = &scene.scene;
        Key {
            gaussians: s.gaussians.capacity,
            metallic: s.metallic.is_some(),
            field: match &s.visibility {
                Some(ShadedVisibility::Field { field, .. }) => Some(field.config().entries()),
                _ => None,
            },
            tree: match &s.visibility {
                Some(ShadedVisibility::Traced { shape, .. }) => Some(*shape),
                _ => None,
            },
            environment: scene.environment.as_ref().map(|e| e.tables().size()),
            model: lighting.model,
            normalizer: lighting.normalizer.to_bits(),
            transport: s.transport.as_ref().map(ShadedTransport::shape),
        }
    }
}

impl LitView {
    /// Prepares a view of a scene.
    ///
    /// # Errors
    /// If the scene lacks the requested layer, the format cannot show it, or memory runs out.
    pub fn new(
        device: &Device,
        tuning: Tuning,
        scene: &LitScene,
        lighting: &Lighting,
        options: LitOptions,
    ) -> ViewResult<LitView> {
        if options.format.srgb() && options.layer.is_value() {
            return Err(ViewError::SrgbValues { what: options.layer.name(), format: options.format.into() });
        }
        let limit = device.info().max_image_size;
        if options.size.iter().any(|side| !(1..=limit).contains(side)) {
            return Err(sgs_engine::Error::ImageSize { what: "view".into(), size: options.size, limit }.into());
        }
        let pixels = u64::from(options.size[0]) * u64::from(options.size[1]);
        let guesses = [
            scene.scene.gaussians.capacity.saturating_mul(2).clamp(1 << 12, 1 << 24),
            u32::try_from(8 * pixels).unwrap_or(u32::MAX).max(1 << 10),
        ];
        let capacity = [0, 1].map(|i| if options.capacity[i] > 0 { options.capacity[i] } else { guesses[i] });
        let report = [
            device.buffer("view_report", 12, Location::Readback)?,
            device.buffer("weights_report", 4, Location::Readback)?,
        ];
        report[0].write(0, &[0; 12])?;
        report[1].write(0, &[0; 4])?;
        let state = State::new(device, &tuning, scene, lighting, &options, capacity, &report)?;
        let device = device.clone();
        Ok(LitView { device, tuning, options, capacity, report, state, retired: Vec::new(), built: 1 })
    }

    /// Returns the options of the view.
    pub fn options(&self) -> &LitOptions {
        &self.options
    }

    /// Prepares one frame under these lights, as [`super::super::View::frame`].
    ///
    /// Passes the executor with the frame's uniforms to `how`. Rebuilds the plan first if an earlier frame is known to
    /// have overflowed, if the components of the scene changed, or if the model or the normalizer of the lighting
    /// changed.
    ///
    /// # Errors
    /// If the size of the image or the camera differs from that of the view, the lengths of the lighting differ from
    /// its model, or memory runs out. Passes on the errors of `how`.
    pub fn frame<R>(
        &mut self,
        scene: &LitScene,
        lighting: &Lighting,
        image: &DeviceImage,
        frame: &LitFrame,
        how: impl FnOnce(&mut Executor, &[(Buffer, &[u8])]) -> sgs_engine::Result<R>,
    ) -> ViewResult<R> {
        let view = self.options.size;
        for (what, actual) in [("image", image.size()), ("camera", frame.camera.size)] {
            if actual != view {
                return Err(ViewError::Size { what, view, actual });
            }
        }
        if image.format() != ImageFormat::from(self.options.format) {
            return Err(ViewError::Format(image.format()));
        }
        self.make_room(scene, lighting)?;
        let State { exec, built, .. } = &mut self.state;
        bind(exec, built, scene)?;
        exec.bind_image(built.image, image)?;
        let tile = self.tuning.tile;
        let mut camera = scene.scene.camera(&frame.camera);
        let scaled = lighting.in_unit(scene.scene.unit);
        let lighting = scaled.as_ref().unwrap_or(lighting);
        camera.tiles = [view[0].div_ceil(tile[0]), view[1].div_ceil(tile[1])];
        let step = Step { camera, step: 1, ..Default::default() };
        // Emitters replace the environment map. The light that its factor multiplies is theirs.
        let environment = if scene.scene.transport.is_some() { [1.0; 3] } else { lighting.environment };
        let lit = LitStep { behind: frame.background, exposure: frame.exposure, environment };
        let field = field_step(scene, lighting, view);
        let mut uniforms = vec![(built.step, bytemuck::bytes_of(&step)), (built.lit, bytemuck::bytes_of(&lit))];
        if let Some(LightParameters { positions, lobes, gains }) = built.lights {
            uniforms.push((positions, bytemuck::cast_slice(&lighting.positions)));
            // The field alone requires only the positions of the lights.
            if self.options.layer != LitLayer::Visibility || built.tree.is_some() {
                uniforms.push((lobes, bytemuck::cast_slice(&lighting.lobes)));
                uniforms.push((gains, bytemuck::cast_slice(&lighting.gains)));
            }
        }
        if let Some(f) = &built.field {
            uniforms.push((f.field.step, bytemuck::bytes_of(&field)));
        }
        let emitters = FrameUniforms::new(&lighting.emitters);
        if let Some(handles) = built.transport.as_ref().and_then(Declared::emitters) {
            uniforms.extend(emitters.of(&handles));
        }
        Ok(how(exec, &uniforms)?)
    }

    /// Returns the statistics of completed frames without waiting.
    ///
    /// # Errors
    /// If the memory is not host-visible, which indicates a bug.
    pub fn report(&self) -> sgs_engine::Result<ViewReport> {
        let mut words = [0u32; 3];
        self.report[0].read(0, bytemuck::cast_slice_mut(&mut words))?;
        Ok(ViewReport { frames: words[0], incomplete: words[1], wanted: words[2] })
    }

    /// Returns the number of plans built.
    pub fn plans(&self) -> u32 {
        self.built
    }

    /// Returns the number of recordings that a host still holds.
    ///
    /// # Errors
    /// If the device fails.
    pub fn recordings(&self) -> sgs_engine::Result<usize> {
        self.retired.iter().chain([&self.state.exec]).map(Executor::recordings).sum()
    }

    /// Waits for the frames submitted here, but not for a host's recordings.
    ///
    /// # Errors
    /// If the device fails.
    pub fn finish(&mut self) -> sgs_engine::Result<()> {
        self.state.exec.finish()
    }

    fn make_room(&mut self, scene: &LitScene, lighting: &Lighting) -> ViewResult<()> {
        let mut open = Vec::new();
        for exec in self.retired.drain(..) {
            if exec.recordings()? > 0 {
                open.push(exec);
            }
        }
        self.retired = open;
        let mut weights = 0u32;
        self.report[1].read(0, bytemuck::bytes_of_mut(&mut weights))?;
        let more = |room: u32, wanted: u32| if wanted > room { wanted.saturating_add(wanted / 8) } else { room };
        let capacity = [more(self.capacity[0], self.report()?.wanted), more(self.capacity[1], weights)];
        if capacity == self.capacity && self.state.key == Key::of(scene, lighting) {
            return Ok(());
        }
        tracing::debug!(?capacity, "the plan of a shaded view is rebuilt");
        let (device, tuning) = (&self.device, &self.tuning);
        let state = State::new(device, tuning, scene, lighting, &self.options, capacity, &self.report)?;
        self.capacity = capacity;
        self.built += 1;
        let old = std::mem::replace(&mut self.state, state);
        if old.exec.recordings()? > 0 {
            self.retired.push(old.exec);
        }
        Ok(())
    }
}

impl State {
    fn new(
        device: &Device,
        t: &Tuning,
        scene: &LitScene,
        lighting: &Lighting,
        options: &LitOptions,
        capacity: [u32; 2],
        report: &[DeviceBuffer; 2],
    ) -> ViewResult<State> {
        let s = &scene.scene;
        match options.layer {
            LitLayer::Metallic if s.metallic.is_none() => return Err(ViewError::Without("metallic")),
            LitLayer::Visibility if s.visibility.is_none() => return Err(ViewError::Without("visibility")),
            _ => {}
        }
        let built = build(t, scene, lighting, options, capacity)?;
        let frames = ExecOptions { frames_in_flight: options.frames_in_flight, ..Default::default() };
        let mut exec = Executor::new(device, built.plan.clone(), frames)?;
        for (handle, buffer) in built.report.iter().zip(report) {
            exec.bind(*handle, buffer)?;
        }
        bind(&mut exec, &built, scene)?;
        Ok(State { key: Key::of(scene, lighting), exec, built })
    }
}

/// Binds the buffers of a scene to their handles; unchanged bindings cost nothing.
fn bind(exec: &mut Executor, built: &Built, scene: &LitScene) -> sgs_engine::Result<()> {
    let s = &scene.scene;
    s.gaussians.bind(exec, &built.gaussians)?;
    for (handles, memory) in built.materials.iter().zip([Some(&s.albedo), Some(&s.roughness), s.metallic.as_ref()]) {
        if let Some(memory) = memory {
            memory.bind(exec, handles)?;
        }
    }
    if let (Some(handles), Some(ShadedVisibility::Field { field, .. })) = (&built.field, &s.visibility) {
        field.bind(exec, handles)?;
    }
    if let (Some(handles), Some(ShadedVisibility::Traced { memory, .. })) = (&built.tree, &s.visibility) {
        memory.bind(exec, handles)?;
    }
    if let (Some(declared), Some(transport)) = (&built.transport, &s.transport) {
        transport.bind(exec, declared)?;
    }
    if let (Some(h), Some(e)) = (&built.environment, &scene.environment) {
        e.source.memory.bind(exec, &e.source.tables, &h.tables)?;
        e.source.texels.bind(exec, &h.texels)?;
        exec.bind(h.radiance, &e.radiance)?;
    }
    Ok(())
}
