//! Renders Gaussians to an image on the host.
//!
//! Optionally blends their semantic features on the device.

use super::{Camera, Step};
use crate::Tuning;
use crate::scene::{FEATURES, Gaussians, Handles, Layout};
use crate::splat::{Blended, Channels, Screen, Wanted, blend, blend_features, intersect, project, wanted_words};
use sgs_engine::exec::{ExecOptions, Executor};
use sgs_engine::graph::{Buffer, CompileOptions, Graph, Plan};
use sgs_engine::{Device, DeviceBuffer, Location, Result};
use std::sync::Arc;
use std::time::Instant;

/// Rendered image.
#[derive(Clone, Debug)]
pub struct RenderedImage {
    /// Columns and rows.
    pub size: [u32; 2],
    /// Floats per pixel.
    pub channels: u32,
    /// `[pixels * channels]` floats: blended values, colors over the background.
    pub image: Vec<f32>,
    /// `[pixels]` floats: transmittance.
    pub transmittance: Vec<f32>,
}

/// Reusable renderer that grows its buffers as required.
pub struct Renderer {
    device: Device,
    tuning: Tuning,
    largest: [u32; 2],
    channels: Channels,
    /// Blends semantic features if the Gaussians have them.
    features: bool,
    capacity: u32,
    state: State,
}

struct State {
    exec: Executor,
    step: Buffer,
    gaussians: Handles,
    image: DeviceBuffer,
    transmittance: DeviceBuffer,
    features: Option<DeviceBuffer>,
    flags: DeviceBuffer,
    wanted: DeviceBuffer,
}

/// Minimum capacity of tile entries.
const LEAST: u32 = 1 << 12;

/// Estimates the capacity of tile entries.
fn usual(gaussians: &Gaussians) -> u32 {
    gaussians.capacity.saturating_mul(2).clamp(LEAST, 1 << 24)
}

impl Renderer {
    /// Prepares for views of at most `largest` columns and rows.
    ///
    /// # Errors
    /// If memory runs out.
    pub fn new(
        device: &Device,
        tuning: Tuning,
        gaussians: &Gaussians,
        largest: [u32; 2],
        channels: Channels,
    ) -> Result<Renderer> {
        Renderer::of(device, tuning, gaussians, largest, channels, false, usual(gaussians))
    }

    /// Prepares as [`Renderer::new`], and blends semantic features if present.
    ///
    /// Blends at every pixel. The features stay on the device ([`Renderer::features`]): 128 bytes per pixel.
    ///
    /// # Errors
    /// If memory runs out.
    pub fn with_features(
        device: &Device,
        tuning: Tuning,
        gaussians: &Gaussians,
        largest: [u32; 2],
        channels: Channels,
    ) -> Result<Renderer> {
        Renderer::of(device, tuning, gaussians, largest, channels, true, usual(gaussians))
    }

    /// Prepares as [`Renderer::new`], with this initial capacity of tile entries.
    ///
    /// Useful if memory is short and the number of entries is known.
    ///
    /// # Errors
    /// If memory runs out.
    pub fn with_entries(
        device: &Device,
        tuning: Tuning,
        gaussians: &Gaussians,
        largest: [u32; 2],
        channels: Channels,
        entries: u32,
    ) -> Result<Renderer> {
        Renderer::of(device, tuning, gaussians, largest, channels, false, entries.max(LEAST))
    }

    fn of(
        device: &Device,
        tuning: Tuning,
        gaussians: &Gaussians,
        largest: [u32; 2],
        channels: Channels,
        features: bool,
        capacity: u32,
    ) -> Result<Renderer> {
        let state = State::new(device, &tuning, gaussians, largest, channels, features, capacity)?;
        Ok(Renderer { device: device.clone(), tuning, largest, channels, features, capacity, state })
    }

    /// Returns the device memory of a renderer in bytes, without its uniform.
    ///
    /// The parameters are those of [`Renderer::with_entries`].
    ///
    /// # Errors
    /// If the graph rejects the sizes.
    pub fn bytes(t: &Tuning, layout: &Layout, largest: [u32; 2], channels: Channels, entries: u32) -> Result<u64> {
        let d = Declared::new(t, layout, largest, channels, false, entries.max(LEAST))?;
        Ok(d.plan.arena_bytes + d.outputs().map(|b| d.plan.buffers[b.index()].bytes).sum::<u64>())
    }

    /// Renders one view.
    ///
    /// # Errors
    /// If memory runs out while growing, or the device fails.
    pub fn render(
        &mut self,
        gaussians: &Gaussians,
        camera: &Camera,
        sh_degree: u32,
        background: [f32; 3],
    ) -> Result<RenderedImage> {
        let (size, _) = self.run(gaussians, camera, sh_degree, background)?;
        let pixels = size[0] as usize * size[1] as usize;
        let channels = self.channels.count();
        Ok(RenderedImage {
            size,
            channels,
            image: self.device.download_as(&self.state.image, pixels * channels as usize)?,
            transmittance: self.device.download_as(&self.state.transmittance, pixels)?,
        })
    }

    /// Renders one view without readback and returns the duration.
    ///
    /// The duration counts seconds from submission to completion.
    ///
    /// # Errors
    /// If memory runs out while growing, or the device fails.
    pub fn time(
        &mut self,
        gaussians: &Gaussians,
        camera: &Camera,
        sh_degree: u32,
        background: [f32; 3],
    ) -> Result<f64> {
        self.run(gaussians, camera, sh_degree, background).map(|(_, seconds)| seconds)
    }

    /// Renders one view. Returns its size and the seconds of the first run without overflow.
    fn run(
        &mut self,
        gaussians: &Gaussians,
        camera: &Camera,
        sh_degree: u32,
        background: [f32; 3],
    ) -> Result<([u32; 2], f64)> {
        let largest = [self.largest[0].max(camera.size[0]), self.largest[1].max(camera.size[1])];
        let made_for = &self.state.gaussians;
        if largest != self.largest || (made_for.capacity, made_for.model) != (gaussians.capacity, gaussians.model) {
            self.largest = largest;
            self.rebuild(gaussians)?;
        }
        gaussians.bind(&mut self.state.exec, &self.state.gaussians)?;
        let tile = self.tuning.tile;
        let mut camera = *camera;
        camera.tiles = [camera.size[0].div_ceil(tile[0]), camera.size[1].div_ceil(tile[1])];
        let step = Step { camera, background, step: 1, sh_degree, ..Default::default() };
        loop {
            self.device.fill(&self.state.flags, 0)?;
            let start = Instant::now();
            self.state.exec.submit(&[(self.state.step, bytemuck::bytes_of(&step))])?;
            self.state.exec.finish()?;
            let seconds = start.elapsed().as_secs_f64();
            if self.device.download_as::<u32>(&self.state.flags, 1)?[0] == 0 {
                return Ok((camera.size, seconds));
            }
            let wanted = self.device.download_as::<u32>(&self.state.wanted, 1)?[0];
            self.capacity = wanted.saturating_add(wanted / 8);
            self.rebuild(gaussians)?;
        }
    }

    /// Returns the blended semantic features of the last view.
    ///
    /// `[pixels * 32]` floats by row, without background; the buffer may be larger. Returns `None` if features were not
    /// requested or the Gaussians have none.
    pub fn features(&self) -> Option<&DeviceBuffer> {
        self.state.features.as_ref()
    }

    /// Returns the executor, for its plan and its pass times.
    pub fn executor(&mut self) -> &mut Executor {
        &mut self.state.exec
    }

    fn rebuild(&mut self, gaussians: &Gaussians) -> Result<()> {
        let (t, l, c) = (&self.tuning, self.largest, self.channels);
        self.state = State::new(&self.device, t, gaussians, l, c, self.features, self.capacity)?;
        gaussians.bind(&mut self.state.exec, &self.state.gaussians)
    }
}

/// Compiled graph of a renderer, before its memory is allocated.
struct Declared {
    plan: Arc<Plan>,
    step: Buffer,
    gaussians: Handles,
    image: Buffer,
    transmittance: Buffer,
    features: Option<Buffer>,
    flags: Buffer,
    wanted: Buffer,
}

impl Declared {
    fn new(
        t: &Tuning,
        layout: &Layout,
        largest: [u32; 2],
        channels: Channels,
        features: bool,
        capacity: u32,
    ) -> Result<Declared> {
        let mut g = Graph::new("render");
        let step = g.uniform("step", size_of::<Step>() as u64);
        let screen = Screen { step, largest, tile: t.tile };
        let gaussians = layout.declare(&mut g, false);
        let flags = g.external("flags", 4);
        let wanted = g.external("wanted", 4);
        let image = g.external("image", 4 * u64::from(channels.count()) * screen.pixels());
        let transmittance = g.external("transmittance", 4 * screen.pixels());
        let visible = project(&mut g, t, &screen, &gaussians, channels)?;
        let entries = intersect(&mut g, t, &screen, &visible, capacity, flags)?;
        blend(&mut g, t, &screen, &visible, &entries, &Blended { image, transmittance })?;
        // An absent group has no memory that a kernel could read.
        let features = (features && layout.model.semantics)
            .then(|| g.external("feature_image", 4 * FEATURES as u64 * screen.pixels()));
        if let Some(into) = features {
            let everywhere = g.transient("everywhere", 4 * wanted_words(screen.pixels()));
            g.fill("want_all", everywhere, u32::MAX)?;
            let wanted = Wanted { pixels: everywhere, dense: true };
            blend_features(&mut g, t, &screen, &gaussians, &visible, &entries, wanted, into)?;
        }
        g.copy("copy_wanted", entries.wanted, wanted)?;
        let plan = Arc::new(g.compile(&CompileOptions::default())?);
        Ok(Declared { plan, step, gaussians, image, transmittance, features, flags, wanted })
    }

    /// Returns the buffers besides the arena and the uniform.
    fn outputs(&self) -> impl Iterator<Item = Buffer> {
        [self.image, self.transmittance, self.flags, self.wanted].into_iter().chain(self.features)
    }
}

impl State {
    fn new(
        device: &Device,
        t: &Tuning,
        gaussians: &Gaussians,
        largest: [u32; 2],
        channels: Channels,
        features: bool,
        capacity: u32,
    ) -> Result<State> {
        let d = Declared::new(t, &gaussians.layout(), largest, channels, features, capacity)?;
        let buffer = |b: Buffer| {
            let made = &d.plan.buffers[b.index()];
            device.buffer(&made.name, made.bytes, Location::Device)
        };
        let (image, transmittance) = (buffer(d.image)?, buffer(d.transmittance)?);
        let (flags, wanted) = (buffer(d.flags)?, buffer(d.wanted)?);
        let features = d.features.map(buffer).transpose()?;
        let options = ExecOptions { frames_in_flight: 1, timestamps: true, ..Default::default() };
        let mut exec = Executor::new(device, d.plan.clone(), options)?;
        let memory = [&image, &transmittance, &flags, &wanted].into_iter().chain(&features);
        for (handle, memory) in d.outputs().zip(memory) {
            exec.bind(handle, memory)?;
        }
        Ok(State { exec, step: d.step, gaussians: d.gaussians, image, transmittance, features, flags, wanted })
    }
}
