//! Renders Gaussians into an image on the device, without intermediate host access.
//!
//! Guarantees: the path reads nothing back. A frame whose tile entries do not fit shows no splats. The device counts
//! such frames; capacity grows before the next frame that is prepared after the host reads the count. The caller
//! submits, or records into a host's commands; it gets the executor for that.

use super::{Camera, Step};
use crate::Tuning;
use crate::scene::{Gaussians, Handles};
use crate::splat::{
    Blended, Channels, Layer, Present, Presented, Screen, TexelFormat, blend, intersect, present, project,
};
use sgs_engine::exec::{ExecOptions, Executor};
use sgs_engine::graph::{Buffer, CompileOptions, Graph, Image, ImageState};
use sgs_engine::{Device, DeviceBuffer, DeviceImage, ImageFormat, Location, Ticket};
use std::sync::Arc;

/// Error of a view.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ViewError {
    /// GPU error.
    #[error(transparent)]
    Engine(#[from] sgs_engine::Error),
    /// Normals are requested, but the Gaussians have none.
    #[error("The normals are to be shown, but the Gaussians have none.")]
    NoNormals,
    /// A layer that is not a color would be decoded from sRGB when read.
    #[error("{layer:?} cannot be shown in {format}: reading it decodes colors. Use a format without sRGB.")]
    SrgbData {
        /// Requested layer.
        layer: Layer,
        /// Requested format.
        format: ImageFormat,
    },
    /// Material values would be decoded from sRGB when read.
    #[error("{what} cannot be shown in {format}: reading it decodes colors. Use a format without sRGB.")]
    SrgbValues {
        /// Name of the requested layer.
        what: &'static str,
        /// Requested format.
        format: ImageFormat,
    },
    /// A component is requested that the scene lacks.
    #[error("The scene has no {0}, so that it cannot be shown.")]
    Without(&'static str),
    /// Format that no kernel packs.
    #[error("A view cannot be shown in {0}.")]
    Format(ImageFormat),
    /// Size of an image or a camera that differs from the size of the view.
    #[error("The view is {} x {} pixels, but the {what} is {} x {}.", view[0], view[1], actual[0], actual[1])]
    Size {
        /// `image` or `camera`.
        what: &'static str,
        /// Columns and rows of the view.
        view: [u32; 2],
        /// Columns and rows of the image or camera.
        actual: [u32; 2],
    },
}

/// Result with [`ViewError`] as its error.
pub type ViewResult<T> = std::result::Result<T, ViewError>;

/// Options of a [`View`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ViewOptions {
    /// Columns and rows of the images.
    pub size: [u32; 2],
    /// Layer and its encoding.
    pub presented: Presented,
    /// Image state before a frame. A frame overwrites all texels, so [`ImageState::Undefined`] is sufficient.
    pub entry: ImageState,
    /// Image state after a frame.
    pub exit: ImageState,
    /// Maximum number of frames in flight.
    pub frames_in_flight: usize,
    /// Initial capacity of tile entries; 0 estimates it.
    pub entry_capacity: u32,
}

/// Inputs of one frame.
#[derive(Clone, Copy, Debug)]
pub struct Frame {
    /// Camera.
    pub camera: Camera,
    /// Highest band of spherical harmonics; clamped to the bands of the Gaussians.
    pub sh_degree: u32,
    /// Background color, display-referred.
    pub background: [f32; 3],
}

/// Device-side statistics of completed frames; they lag behind submission.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ViewReport {
    /// Number of completed frames.
    pub frames: u32,
    /// Number of completed frames that overflowed and show only the background.
    pub incomplete: u32,
    /// Largest number of tile entries that a frame required.
    pub wanted: u32,
}

impl TryFrom<ImageFormat> for TexelFormat {
    type Error = ViewError;

    fn try_from(format: ImageFormat) -> ViewResult<TexelFormat> {
        TexelFormat::ALL.into_iter().find(|f| ImageFormat::from(*f) == format).ok_or(ViewError::Format(format))
    }
}

impl From<TexelFormat> for ImageFormat {
    fn from(format: TexelFormat) -> ImageFormat {
        match format {
            TexelFormat::Rgba8Unorm => ImageFormat::Rgba8Unorm,
            TexelFormat::Bgra8Unorm => ImageFormat::Bgra8Unorm,
            TexelFormat::Rgba8Srgb => ImageFormat::Rgba8Srgb,
            TexelFormat::Bgra8Srgb => ImageFormat::Bgra8Srgb,
            TexelFormat::Rgba16Float => ImageFormat::Rgba16Float,
            TexelFormat::Rgba32Float => ImageFormat::Rgba32Float,
        }
    }
}

/// Renderer into images of one size and format, frame by frame.
pub struct View {
    device: Device,
    tuning: Tuning,
    options: ViewOptions,
    channels: Channels,
    capacity: u32,
    report: DeviceBuffer,
    state: State,
    /// Plans with less capacity, of which a host still holds recordings.
    retired: Vec<Executor>,
}

struct State {
    exec: Executor,
    step: Buffer,
    image: Image,
    gaussians: Handles,
}

impl View {
    /// Prepares a view of these Gaussians.
    ///
    /// # Errors
    /// If normals are requested but absent, the format cannot show the layer, or memory runs out.
    pub fn new(device: &Device, tuning: Tuning, gaussians: &Gaussians, options: ViewOptions) -> ViewResult<View> {
        let layer = options.presented.layer;
        if layer == Layer::Normal && !gaussians.model.normals {
            return Err(ViewError::NoNormals);
        }
        if options.presented.format.srgb() && layer != Layer::Color {
            return Err(ViewError::SrgbData { layer, format: options.presented.format.into() });
        }
        let limit = device.info().max_image_size;
        if options.size.iter().any(|side| !(1..=limit).contains(side)) {
            return Err(sgs_engine::Error::ImageSize { what: "view".into(), size: options.size, limit }.into());
        }
        let channels = Channels { colors: true, normals: layer == Layer::Normal, depth: layer == Layer::Depth };
        let guess = gaussians.capacity.saturating_mul(2).clamp(1 << 12, 1 << 24);
        let capacity = if options.entry_capacity > 0 { options.entry_capacity } else { guess };
        let report = device.buffer("view_report", 12, Location::Readback)?;
        report.write(0, &[0; 12])?;
        let state = State::new(device, &tuning, gaussians, &options, channels, capacity, &report)?;
        let device = device.clone();
        Ok(View { device, tuning, options, channels, capacity, report, state, retired: Vec::new() })
    }

    /// Returns the options of the view.
    pub fn options(&self) -> &ViewOptions {
        &self.options
    }

    /// Prepares one frame and passes the executor with the frame's uniforms to `how`.
    ///
    /// `how` submits, with or without semaphores, or records into a host's commands. Grows the capacity first if an
    /// earlier frame is known to have overflowed.
    ///
    /// # Errors
    /// If the size of the image or the camera differs from that of the view, or memory runs out. Passes on the errors
    /// of `how`.
    pub fn frame<R>(
        &mut self,
        gaussians: &Gaussians,
        image: &DeviceImage,
        frame: &Frame,
        how: impl FnOnce(&mut Executor, &[(Buffer, &[u8])]) -> sgs_engine::Result<R>,
    ) -> ViewResult<R> {
        let view = self.options.size;
        for (what, actual) in [("image", image.size()), ("camera", frame.camera.size)] {
            if actual != view {
                return Err(ViewError::Size { what, view, actual });
            }
        }
        if image.format() != self.options.presented.format.into() {
            return Err(ViewError::Format(image.format()));
        }
        self.make_room(gaussians)?;
        gaussians.bind(&mut self.state.exec, &self.state.gaussians)?;
        self.state.exec.bind_image(self.state.image, image)?;
        let tile = self.tuning.tile;
        let mut camera = frame.camera;
        camera.tiles = [view[0].div_ceil(tile[0]), view[1].div_ceil(tile[1])];
        let sh_degree = frame.sh_degree.min(gaussians.model.sh_degree);
        let step = Step { camera, background: frame.background, step: 1, sh_degree, ..Default::default() };
        Ok(how(&mut self.state.exec, &[(self.state.step, bytemuck::bytes_of(&step))])?)
    }

    /// Submits one frame into an image of this device; see [`View::frame`].
    ///
    /// # Errors
    /// As [`View::frame`]; if the device fails.
    pub fn submit(&mut self, gaussians: &Gaussians, image: &DeviceImage, frame: &Frame) -> ViewResult<Ticket> {
        self.frame(gaussians, image, frame, |exec, uniforms| exec.submit(uniforms))
    }

    /// Returns the statistics of completed frames without waiting.
    ///
    /// # Errors
    /// If the memory is not host-visible, which indicates a bug.
    pub fn report(&self) -> sgs_engine::Result<ViewReport> {
        let mut words = [0u32; 3];
        self.report.read(0, bytemuck::cast_slice_mut(&mut words))?;
        Ok(ViewReport { frames: words[0], incomplete: words[1], wanted: words[2] })
    }

    /// Returns the capacity of tile entries.
    pub fn entry_capacity(&self) -> u32 {
        self.capacity
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

    fn make_room(&mut self, gaussians: &Gaussians) -> ViewResult<()> {
        let mut open = Vec::new();
        for exec in self.retired.drain(..) {
            if exec.recordings()? > 0 {
                open.push(exec);
            }
        }
        self.retired = open;
        let wanted = self.report()?.wanted;
        if wanted <= self.capacity && self.state.gaussians.capacity == gaussians.capacity {
            return Ok(());
        }
        let capacity = self.capacity.max(wanted.saturating_add(if wanted > self.capacity { wanted / 8 } else { 0 }));
        tracing::debug!(wanted, capacity, "tile entries of a view grow");
        let (device, tuning) = (&self.device, &self.tuning);
        let state = State::new(device, tuning, gaussians, &self.options, self.channels, capacity, &self.report)?;
        self.capacity = capacity;
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
        gaussians: &Gaussians,
        options: &ViewOptions,
        channels: Channels,
        capacity: u32,
        report_memory: &DeviceBuffer,
    ) -> ViewResult<State> {
        let mut g = Graph::new("view");
        let step = g.uniform("step", size_of::<Step>() as u64);
        let screen = Screen { step, largest: options.size, tile: t.tile };
        let handles = gaussians.declare(&mut g, false);
        let report = g.external("view_report", 12);
        let format = options.presented.format;
        let image = g.external_image("target", options.size, format.into(), options.entry, options.exit);
        let declare = |g: &mut Graph, flags: Buffer| {
            g.fill("clear_flags", flags, 0)?;
            let visible = project(g, t, &screen, &handles, channels)?;
            let entries = intersect(g, t, &screen, &visible, capacity, flags)?;
            let blended = Blended {
                image: g.transient("image", 4 * u64::from(channels.count()) * screen.pixels()),
                transmittance: g.transient("transmittance", 4 * screen.pixels()),
            };
            blend(g, t, &screen, &visible, &entries, &blended)?;
            let texels = g.transient("texels", format.bytes() * screen.pixels());
            let wanted = entries.wanted.into();
            let what = Present { blended, channels, flags, wanted, texels, report };
            present(g, t, &screen, &what, &options.presented)?;
            g.copy_to_image("copy_to_target", texels, image)
        };
        let flags = g.transient("flags", 4);
        declare(&mut g, flags).map_err(sgs_engine::Error::from)?;
        let plan = Arc::new(g.compile(&CompileOptions::default()).map_err(sgs_engine::Error::from)?);
        let options = ExecOptions { frames_in_flight: options.frames_in_flight, ..Default::default() };
        let mut exec = Executor::new(device, plan, options)?;
        exec.bind(report, report_memory)?;
        gaussians.bind(&mut exec, &handles)?;
        Ok(State { exec, step, image, gaussians: handles })
    }
}
