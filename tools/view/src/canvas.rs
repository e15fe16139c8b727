//! From Gaussians and light to the window: a view, the display over it, the window's images.
//!
//! Promises: a frame of the same channel and size makes nothing; the window's size is followed, and without a size nothing is
//! drawn. Frames that lacked room for tile entries are known ([`Canvas::settled`]), so that they can be drawn again.

use crate::channel::{Channel, Drawn};
use crate::error::Result;
use crate::font::{Page, font, letters};
use sgs_engine::graph::ImageState;
use sgs_engine::{Device, ImageFormat, Shown as Presented, Surface, Swapchain};
use sgs_passes::Tuning;
use sgs_passes::pipeline::{
    Camera, Display, DisplayRoom, Font, Frame, LitFrame, LitOptions, LitView, Shown, View, ViewOptions, ViewReport,
};
use sgs_passes::scene::{Gaussians, Model};
use sgs_passes::splat::{self, Encoding, Mark, TexelFormat};
use sgs_scene::Splats;
use sgs_train::{Relighter, gaussian_data};
use std::sync::Arc;

/// Frames that may be in flight together.
const FRAMES: usize = 2;

/// What draws.
pub struct Canvas {
    device: Device,
    gaussians: Gaussians,
    chain: Swapchain,
    font: Font,
    made: Option<Made>,
    /// Frames of the present view, and how many of them are known to have lacked room.
    submitted: u32,
    incomplete: u32,
}

/// What is made for one channel and size.
struct Made {
    channel: Channel,
    view: Drawing,
    display: Display,
    page: Page,
}

enum Drawing {
    Blended(Box<View>),
    Lit(Box<LitView>),
}

/// One frame.
pub struct Picture<'a> {
    /// What is shown.
    pub channel: Channel,
    /// From where; of the canvas's size.
    pub camera: Camera,
    /// Factor of light or values.
    pub gain: f32,
    /// Pixels along a pixel of a letter.
    pub letter_size: u32,
    /// Handles.
    pub marks: &'a [Mark],
}

impl Canvas {
    /// For a window of about this size.
    pub fn new(device: &Device, surface: &Arc<Surface>, splats: &Splats, size: [u32; 2]) -> Result<Canvas> {
        let degree = splats.sh_degree() as u32;
        let model = Model { sh_degree: degree, normals: splats.normals.is_some(), ..Model::default() };
        let gaussians = Gaussians::new(device, model, splats.len() as u32, false)?;
        gaussians.upload(device, &gaussian_data(splats, model))?;
        let chain = Swapchain::new(device, surface, size)?;
        let font = font(device)?;
        Ok(Canvas { device: device.clone(), gaussians, chain, font, made: None, submitted: 0, incomplete: 0 })
    }

    /// Columns and rows; zeros while there is nothing to draw on.
    pub fn size(&self) -> [u32; 2] {
        self.chain.size()
    }

    /// Takes the window as it is now.
    pub fn resize(&mut self, size: [u32; 2]) -> Result<()> {
        Ok(self.chain.renew(size)?)
    }

    /// Draws a frame and shows it; false if the window has changed, and the frame has to be drawn anew for its size.
    pub fn draw(
        &mut self,
        relighter: Option<&Relighter>,
        picture: &Picture<'_>,
        write: impl FnOnce(&mut Page),
    ) -> Result<bool> {
        if !self.chain.is_open() {
            return Ok(false);
        }
        let size = self.chain.size();
        let same = |m: &Made| m.channel == picture.channel && m.display.window().size() == size;
        if !self.made.as_ref().is_some_and(same) {
            // The old one goes first: there may be no room for both.
            self.made = None;
            self.made = Some(self.make(relighter, picture, size)?);
            (self.submitted, self.incomplete) = (0, 0);
        }
        let Some(Made { view, display, page, .. }) = &mut self.made else { return Ok(false) };
        match (view, relighter) {
            (Drawing::Blended(view), _) => {
                let frame = Frame { camera: picture.camera, sh_degree: u32::MAX, background: [0.0; 3] };
                view.submit(&self.gaussians, display.picture(), &frame)?;
            }
            (Drawing::Lit(view), Some(relighter)) => {
                let frame = LitFrame { camera: picture.camera, background: [0.0; 3], exposure: 1.0 };
                let (scene, lighting) = (relighter.scene(), relighter.lighting());
                view.frame(scene, lighting, display.picture(), &frame, |exec, uniforms| exec.submit(uniforms))?;
            }
            (Drawing::Lit(_), None) => return Ok(false),
        }
        self.submitted += 1;
        page.clear();
        write(page);
        display.submit(&Shown {
            kind: picture.channel.kind(),
            gain: picture.gain,
            marks: picture.marks,
            text: page.cells(),
            letter_size: picture.letter_size,
        })?;
        Ok(self.chain.show(display.window())? == Presented::Yes)
    }

    fn make(&self, relighter: Option<&Relighter>, picture: &Picture<'_>, size: [u32; 2]) -> Result<Made> {
        let (device, tuning) = (&self.device, Tuning::for_device(self.device.info()));
        let (format, entry, exit) = (TexelFormat::Rgba16Float, ImageState::Undefined, ImageState::General);
        let view = match (picture.channel.drawn(), relighter) {
            (Drawn::Lit(layer), Some(relighter)) => {
                let encoding = Encoding::Linear;
                let (frames_in_flight, capacity) = (FRAMES, [0; 2]);
                let options = LitOptions { size, layer, format, encoding, entry, exit, frames_in_flight, capacity };
                Drawing::Lit(Box::new(LitView::new(device, tuning, relighter.scene(), relighter.lighting(), options)?))
            }
            (drawn, _) => {
                let layer = if let Drawn::Blended(layer) = drawn { layer } else { splat::Layer::Color };
                let presented = splat::Presented { layer, format, encoding: Encoding::Display, depth_scale: 1.0 };
                let options = ViewOptions { size, presented, entry, exit, frames_in_flight: FRAMES, entry_capacity: 0 };
                Drawing::Blended(Box::new(View::new(device, tuning, &self.gaussians, options)?))
            }
        };
        let cell = letters().cell;
        let marks = crate::lamps::MOST as u32;
        let room = DisplayRoom { columns: (size[0] / cell[0]).max(1), rows: (size[1] / cell[1]).max(1), marks };
        let display = Display::new(device, &self.font, size, self.chain.format(), room)?;
        Ok(Made { channel: picture.channel, view, display, page: Page::new(room) })
    }

    /// Whether all frames are done (asked, not waited for), and whether the last ones lacked room and should be drawn again.
    pub fn settled(&mut self) -> Result<(bool, bool)> {
        let report: ViewReport = match self.made.as_ref().map(|m| &m.view) {
            Some(Drawing::Blended(view)) => view.report()?,
            Some(Drawing::Lit(view)) => view.report()?,
            None => return Ok((true, false)),
        };
        let again = report.incomplete > self.incomplete;
        self.incomplete = report.incomplete;
        Ok((report.frames >= self.submitted, again))
    }

    /// Waits for the frames in flight.
    pub fn finish(&mut self) -> Result<()> {
        match self.made.as_mut().map(|m| &mut m.view) {
            Some(Drawing::Blended(view)) => view.finish()?,
            Some(Drawing::Lit(view)) => view.finish()?,
            None => {}
        }
        Ok(())
    }

    /// The last frame without marks and letters, as texels of the window's format; and whether blue comes first in them.
    /// Waits.
    pub fn read(&mut self, picture: &Picture<'_>) -> Result<Option<(Vec<u8>, bool)>> {
        let Some(Made { display, .. }) = &mut self.made else { return Ok(None) };
        let kind = picture.channel.kind();
        display.submit(&Shown { kind, gain: picture.gain, marks: &[], text: &[], letter_size: 1 })?;
        display.finish()?;
        let texels = self.device.download_image(display.window())?;
        let blue_first = matches!(self.chain.format(), ImageFormat::Bgra8Unorm | ImageFormat::Bgra8Srgb);
        Ok(Some((texels, blue_first)))
    }

    /// Buffers and images made so far.
    pub fn made(&self) -> u64 {
        self.device.activity().made
    }
}
