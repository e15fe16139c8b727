//! From Gaussians and a camera into an image, without the host looking at anything on the way.
//!
//! Promises: nothing is read back on the path. Tile entries that do not fit leave a frame without splats; the device
//! counts it, and the room is made before the next frame that is prepared after the count is seen. Leaves submitting, or
//! recording into a host's commands, to the caller, who gets the executor for it.

use super::{Camera, Step};
use crate::Tuning;
use crate::scene::{Gaussians, Handles};
use crate::splat::{
    Blended, Channels, Layer, Present, Presented, Screen, TexelFormat, blend, intersect, present, project,
};
use sgs_engine::graph::exec::{ExecOptions, Executor};
use sgs_engine::graph::{Buffer, CompileOptions, Graph, Image, ImageState};
use sgs_engine::{Device, DeviceBuffer, DeviceImage, ImageFormat, Location, Ticket};
use std::sync::Arc;

/// What can be wrong with a view.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ViewError {
    /// The GPU side failed.
    #[error(transparent)]
    Engine(#[from] sgs_engine::Error),
    /// Normals are to be shown, but there are none.
    #[error("The normals are to be shown, but the Gaussians have none.")]
    NoNormals,
    /// Numbers would go through a decoding that is made for colors.
    #[error("{layer:?} cannot be shown in {format}: reading it decodes colors. Use a format without sRGB.")]
    SrgbData {
        /// What is to be shown.
        layer: Layer,
        /// In which format.
        format: ImageFormat,
    },
    /// Materials would go through a decoding that is made for colors.
    #[error("{what} cannot be shown in {format}: reading it decodes colors. Use a format without sRGB.")]
    SrgbValues {
        /// What is to be shown.
        what: &'static str,
        /// In which format.
        format: ImageFormat,
    },
    /// A part is to be shown that the scene does not have.
    #[error("The scene has no {0}, so that it cannot be shown.")]
    Without(&'static str),
    /// A format that no kernel packs.
    #[error("A view cannot be shown in {0}.")]
    Format(ImageFormat),
    /// An image or a camera that is not of the size that was prepared for.
    #[error("The view is {} x {} pixels, but the {what} is {} x {}.", view[0], view[1], given[0], given[1])]
    Size {
        /// `image` or `camera`.
        what: &'static str,
        /// The view.
        view: [u32; 2],
        /// What was given.
        given: [u32; 2],
    },
}

/// Result with the error of views.
pub type ViewResult<T> = std::result::Result<T, ViewError>;

/// What a view is made for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ViewOptions {
    /// Columns and rows of the images.
    pub size: [u32; 2],
    /// What is shown, and how.
    pub presented: Presented,
    /// The state in which images are found. Their texels are overwritten, so that [`ImageState::Undefined`] will do.
    pub entry: ImageState,
    /// The state in which images are left.
    pub exit: ImageState,
    /// Frames that may be in flight together.
    pub frames_in_flight: usize,
    /// Room for tile entries at first; 0 guesses.
    pub entry_capacity: u32,
}

/// One frame.
#[derive(Clone, Copy, Debug)]
pub struct Frame {
    /// From where.
    pub camera: Camera,
    /// Highest band of spherical harmonics to use; more than the Gaussians have is as many as they have.
    pub sh_degree: u32,
    /// What lies behind, display-referred.
    pub background: [f32; 3],
}

/// What the device has said of frames so far, some frames late.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ViewReport {
    /// Frames that are done.
    pub frames: u32,
    /// Of these, the ones that lacked room and show the background alone.
    pub incomplete: u32,
    /// Most tile entries that a frame wanted.
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

/// Renders into images of one size and format, frame by frame.
pub struct View {
    device: Device,
    tuning: Tuning,
    options: ViewOptions,
    channels: Channels,
    capacity: u32,
    report: DeviceBuffer,
    state: State,
    /// Plans with less room, of which a host still holds recordings.
    retired: Vec<Executor>,
}

struct State {
    exec: Executor,
    step: Buffer,
    image: Image,
    gaussians: Handles,
}

impl View {
    /// Prepares for frames of some Gaussians.
    ///
    /// # Errors
    /// If normals are wanted and there are none, if the format cannot show the layer, or if memory runs out.
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

    /// What it was made for.
    pub fn options(&self) -> &ViewOptions {
        &self.options
    }

    /// Prepares one frame and hands over the executor with its uniforms: to be submitted, with semaphores or without, or
    /// recorded into a host's commands. Makes room first if an earlier frame is known to have lacked it.
    ///
    /// # Errors
    /// If image or camera have another size than the view, or memory runs out; and what `how` returns.
    pub fn frame<R>(
        &mut self,
        gaussians: &Gaussians,
        image: &DeviceImage,
        frame: &Frame,
        how: impl FnOnce(&mut Executor, &[(Buffer, &[u8])]) -> sgs_engine::Result<R>,
    ) -> ViewResult<R> {
        let view = self.options.size;
        for (what, given) in [("image", image.size()), ("camera", frame.camera.size)] {
            if given != view {
                return Err(ViewError::Size { what, view, given });
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

    /// Submits one frame into an image of ours; see [`View::frame`].
    ///
    /// # Errors
    /// As [`View::frame`]; if the device fails.
    pub fn submit(&mut self, gaussians: &Gaussians, image: &DeviceImage, frame: &Frame) -> ViewResult<Ticket> {
        self.frame(gaussians, image, frame, |exec, uniforms| exec.submit(uniforms))
    }

    /// What is known of the frames that are done. Waits for nothing.
    ///
    /// # Errors
    /// If the memory is not visible, which would be a defect.
    pub fn report(&self) -> sgs_engine::Result<ViewReport> {
        let mut words = [0u32; 3];
        self.report.read(0, bytemuck::cast_slice_mut(&mut words))?;
        Ok(ViewReport { frames: words[0], incomplete: words[1], wanted: words[2] })
    }

    /// Room for tile entries.
    pub fn entry_capacity(&self) -> u32 {
        self.capacity
    }

    /// Recordings that a host still holds.
    ///
    /// # Errors
    /// If the device fails.
    pub fn recordings(&self) -> sgs_engine::Result<usize> {
        self.retired.iter().chain([&self.state.exec]).map(Executor::recordings).sum()
    }

    /// Waits for the frames submitted here; recordings are the host's to wait for.
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
