//! From Gaussians and light to the window: a view, the display over it, the window's images.
//!
//! Promises: a frame of the same channel and size makes nothing; the window's size is followed, and without a size nothing is
//! drawn. A frame that lacked room for tile entries is drawn again before it is shown. While the camera moves, frames may be
//! smaller than the window: as small as they must be to take less than [`SLOW`].

use crate::channel::{Channel, Drawn};
use crate::error::Result;
use crate::font::{Page, font, letters};
use sgs_engine::graph::ImageState;
use sgs_engine::{Device, ImageFormat, PresentStatus, Surface, Swapchain};
use sgs_passes::Tuning;
use sgs_passes::pipeline::{
    Display, DisplayRoom, Font, Frame, LitFrame, LitOptions, LitView, Shown, View, ViewOptions, ViewReport,
};
use sgs_passes::scene::{Gaussians, Model};
use sgs_passes::splat::{self, Encoding, Mark, TexelFormat};
use sgs_relight::Relighter;
use sgs_run::gaussian_data;
use sgs_scene::{Camera, Splats};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Frames that may be in flight together.
const FRAMES: usize = 2;
/// Attempts to draw a frame whose buffers are too small. Each makes room for what the one before wanted.
const ATTEMPTS: u32 = 6;
/// A frame that takes longer is drawn at a lower resolution while the camera moves.
const SLOW: Duration = Duration::from_millis(80);
/// The most pixels of the window along a pixel of a frame.
const MOST_FACTOR: u32 = 16;

/// What draws.
pub struct Canvas {
    device: Device,
    gaussians: Gaussians,
    chain: Swapchain,
    font: Font,
    /// The channel that the two below are made for.
    channel: Option<Channel>,
    made: Option<Made>,
    /// For frames while the camera moves, and pixels of the window along a pixel of such a frame.
    coarse: Option<Made>,
    factor: u32,
    /// Whether the last frame was one of these.
    is_coarse: bool,
    /// How long the last frame took.
    took: Duration,
}

/// Pixels of the window along a pixel of a frame, so that frames that took too long are fast enough: most of their time goes into pixels.
fn coarser(factor: u32, took: Duration) -> u32 {
    let by = (took.as_secs_f64() / SLOW.as_secs_f64()).sqrt();
    ((f64::from(factor) * by).ceil() as u32).clamp(factor + 1, MOST_FACTOR.max(factor + 1))
}

/// What is made for one channel and size.
struct Made {
    factor: u32,
    view: Drawing,
    display: Display,
    page: Page,
}

enum Drawing {
    Blended(Box<View>),
    Lit(Box<LitView>),
}

impl Drawing {
    fn finish(&mut self) -> Result<()> {
        match self {
            Drawing::Blended(view) => Ok(view.finish()?),
            Drawing::Lit(view) => Ok(view.finish()?),
        }
    }

    fn report(&self) -> Result<ViewReport> {
        match self {
            Drawing::Blended(view) => Ok(view.report()?),
            Drawing::Lit(view) => Ok(view.report()?),
        }
    }
}

/// One frame.
pub struct Picture<'a> {
    /// What is shown.
    pub channel: Channel,
    /// From where; of the canvas's size.
    pub camera: &'a Camera,
    /// Whether the camera moves, so that a fast frame is better than a fine one.
    pub moving: bool,
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
        Ok(Canvas {
            device: device.clone(),
            gaussians,
            chain,
            font,
            channel: None,
            made: None,
            coarse: None,
            factor: 1,
            is_coarse: false,
            took: Duration::ZERO,
        })
    }

    /// Columns and rows; zeros while there is nothing to draw on.
    pub fn size(&self) -> [u32; 2] {
        self.chain.size()
    }

    /// Takes the window as it is now.
    pub fn resize(&mut self, size: [u32; 2]) -> Result<()> {
        Ok(self.chain.recreate(size)?)
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
        let begun = Instant::now();
        let size = self.chain.size();
        if self.channel != Some(picture.channel) {
            (self.channel, self.made, self.coarse, self.factor) = (Some(picture.channel), None, None, 1);
        }
        // What has another size goes first: there may be no room for both.
        for slot in [&mut self.made, &mut self.coarse] {
            slot.take_if(|m| m.display.window().size() != size);
        }
        self.is_coarse = picture.moving && self.factor > 1;
        let factor = if self.is_coarse { self.factor } else { 1 };
        let slot = if self.is_coarse { &mut self.coarse } else { &mut self.made };
        let ready = slot.take().filter(|m| m.factor == factor);
        let reused = ready.is_some();
        let mut made = match ready {
            Some(made) => made,
            None => self.make(relighter, picture.channel, size, factor)?,
        };
        let drawn = self.submit(&mut made, relighter, picture, write);
        let shown = drawn.and_then(|drawn| match drawn {
            true => Ok(self.chain.present(made.display.window())? == PresentStatus::Presented),
            false => Ok(false),
        });
        *(if self.is_coarse { &mut self.coarse } else { &mut self.made }) = Some(made);
        self.took = begun.elapsed();
        if reused && picture.moving && self.took > SLOW && self.factor < MOST_FACTOR {
            self.factor = coarser(self.factor, self.took);
        }
        shown
    }

    /// Draws a frame until its buffers have room for all of it, and what lies over it.
    fn submit(
        &self,
        Made { view, display, page, .. }: &mut Made,
        relighter: Option<&Relighter>,
        picture: &Picture<'_>,
        write: impl FnOnce(&mut Page),
    ) -> Result<bool> {
        let [width, height] = display.picture().size();
        let camera = sgs_run::camera(&picture.camera.scaled(width, height));
        for _ in 0..ATTEMPTS {
            let before = view.report()?.incomplete;
            match (&mut *view, relighter) {
                (Drawing::Blended(view), _) => {
                    let frame = Frame { camera, sh_degree: u32::MAX, background: [0.0; 3] };
                    view.submit(&self.gaussians, display.picture(), &frame)?;
                }
                (Drawing::Lit(view), Some(relighter)) => {
                    let frame = LitFrame { camera, background: [0.0; 3], exposure: 1.0 };
                    let (scene, lighting) = (relighter.scene(), relighter.lighting());
                    view.frame(scene, lighting, display.picture(), &frame, |exec, uniforms| exec.submit(uniforms))?;
                }
                (Drawing::Lit(_), None) => return Ok(false),
            }
            view.finish()?;
            if view.report()?.incomplete == before {
                break;
            }
        }
        page.clear();
        write(page);
        display.submit(&Shown {
            kind: picture.channel.kind(),
            gain: picture.gain,
            marks: picture.marks,
            text: page.cells(),
            letter_size: picture.letter_size,
        })?;
        Ok(true)
    }

    fn make(&self, relighter: Option<&Relighter>, channel: Channel, window: [u32; 2], factor: u32) -> Result<Made> {
        let size = window.map(|side| side.div_ceil(factor));
        let (device, tuning) = (&self.device, Tuning::for_device(self.device.info()));
        let (format, entry, exit) = (TexelFormat::Rgba16Float, ImageState::Undefined, ImageState::General);
        let view = match (channel.drawn(), relighter) {
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
        let room = DisplayRoom { columns: (window[0] / cell[0]).max(1), rows: (window[1] / cell[1]).max(1), marks };
        let display = Display::scaled(device, &self.font, [window, size], self.chain.format(), room)?;
        Ok(Made { factor, view, display, page: Page::new(room) })
    }

    /// Whether the last frame was smaller than the window.
    pub fn is_coarse(&self) -> bool {
        self.is_coarse
    }

    /// How long the last frame took, from its beginning until it was handed to the window.
    pub fn took(&self) -> Duration {
        self.took
    }

    /// The last frame of the window's size without marks and letters, as texels of the window's format; and whether blue comes
    /// first in them. Waits.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_get_as_coarse_as_they_must() {
        let of = |factor, millis| coarser(factor, Duration::from_millis(millis));
        assert_eq!([of(1, 81), of(1, 300), of(1, 2000), of(5, 119), of(8, 100)], [2, 2, 5, 7, 9]);
        assert_eq!([of(1, 1_000_000), of(15, 81), of(12, 500)], [16; 3]);
    }
}
