//! Window content: a view of the Gaussians, the display overlay, the swapchain.
//!
//! Guarantees: a frame of unchanged channel and size creates no buffers or images. The canvas follows the window's size
//! and draws nothing without a size. A frame that lacks capacity for tile entries is drawn again before it is shown.
//! While the camera moves, frames may be smaller than the window: as small as needed to take less than [`SLOW`].

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

/// Number of frames in flight.
const FRAMES: usize = 2;
/// Attempts to draw a frame with insufficient buffers.
///
/// Each attempt grows the buffers to the previous attempt's demand.
const ATTEMPTS: u32 = 6;
/// Time limit of a frame, above which the resolution drops while the camera moves.
const SLOW: Duration = Duration::from_millis(80);
/// Largest number of window pixels along a pixel of a frame.
const MOST_FACTOR: u32 = 16;

/// Renderer and swapchain of the window.
pub struct Canvas {
    device: Device,
    gaussians: Gaussians,
    chain: Swapchain,
    font: Font,
    /// Channel of `made` and `coarse`.
    channel: Option<Channel>,
    made: Option<Made>,
    /// Resources for frames while the camera moves. `factor`: window pixels along a pixel of such a frame.
    coarse: Option<Made>,
    factor: u32,
    /// True if the last frame was a coarse frame.
    is_coarse: bool,
    /// Duration of the last frame.
    took: Duration,
}

/// Returns a larger downscaling factor for frames that took too long.
///
/// The factor is the number of window pixels along a pixel of a frame. Most of a frame's time is proportional to its
/// pixels, so the factor grows with the square root of the time.
fn coarser(factor: u32, took: Duration) -> u32 {
    let by = (took.as_secs_f64() / SLOW.as_secs_f64()).sqrt();
    ((f64::from(factor) * by).ceil() as u32).clamp(factor + 1, MOST_FACTOR.max(factor + 1))
}

/// Resources for one channel and size.
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

/// Parameters of one frame.
pub struct CanvasImage<'a> {
    /// Channel.
    pub channel: Channel,
    /// Camera of the canvas's size.
    pub camera: &'a Camera,
    /// True while the camera moves; a fast frame is then preferred to a fine one.
    pub moving: bool,
    /// Factor on light or values.
    pub gain: f32,
    /// Screen pixels along a pixel of a letter.
    pub letter_size: u32,
    /// Handles of lights.
    pub marks: &'a [Mark],
}

impl Canvas {
    /// Creates a canvas for a window of about this size.
    pub fn new(device: &Device, surface: &Arc<Surface>, splats: &Splats, size: [u32; 2]) -> Result<Canvas> {
        let degree = splats.sh_degree() as u32;
        let (normals, mip) = (splats.normals.is_some(), splats.antialiased);
        let model = Model { sh_degree: degree, normals, mip, ..Model::default() };
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

    /// Returns width and height; zeros while the window has no area.
    pub fn size(&self) -> [u32; 2] {
        self.chain.size()
    }

    /// Adapts to the size of the window.
    pub fn resize(&mut self, size: [u32; 2]) -> Result<()> {
        Ok(self.chain.recreate(size)?)
    }

    /// Draws and presents a frame.
    ///
    /// Returns false if the window changed and the frame must be drawn again for its size.
    pub fn draw(
        &mut self,
        relighter: Option<&Relighter>,
        image: &CanvasImage<'_>,
        write: impl FnOnce(&mut Page),
    ) -> Result<bool> {
        if !self.chain.is_open() {
            return Ok(false);
        }
        let begun = Instant::now();
        let size = self.chain.size();
        if self.channel != Some(image.channel) {
            (self.channel, self.made, self.coarse, self.factor) = (Some(image.channel), None, None, 1);
        }
        // Resources of another size are dropped first, because memory may not suffice for both.
        for slot in [&mut self.made, &mut self.coarse] {
            slot.take_if(|m| m.display.window().size() != size);
        }
        self.is_coarse = image.moving && self.factor > 1;
        let factor = if self.is_coarse { self.factor } else { 1 };
        let slot = if self.is_coarse { &mut self.coarse } else { &mut self.made };
        let ready = slot.take().filter(|m| m.factor == factor);
        let reused = ready.is_some();
        let mut made = match ready {
            Some(made) => made,
            None => self.make(relighter, image.channel, size, factor)?,
        };
        let drawn = self.submit(&mut made, relighter, image, write);
        let shown = drawn.and_then(|drawn| match drawn {
            true => Ok(self.chain.present(made.display.window())? == PresentStatus::Presented),
            false => Ok(false),
        });
        *(if self.is_coarse { &mut self.coarse } else { &mut self.made }) = Some(made);
        self.took = begun.elapsed();
        if reused && image.moving && self.took > SLOW && self.factor < MOST_FACTOR {
            self.factor = coarser(self.factor, self.took);
        }
        shown
    }

    /// Draws a frame until its buffers have enough capacity, then the overlay.
    fn submit(
        &self,
        Made { view, display, page, .. }: &mut Made,
        relighter: Option<&Relighter>,
        image: &CanvasImage<'_>,
        write: impl FnOnce(&mut Page),
    ) -> Result<bool> {
        let [width, height] = display.image().size();
        let camera = sgs_run::camera(&image.camera.scaled(width, height));
        for _ in 0..ATTEMPTS {
            let before = view.report()?.incomplete;
            match (&mut *view, relighter) {
                (Drawing::Blended(view), _) => {
                    let frame = Frame { camera, sh_degree: u32::MAX, background: [0.0; 3] };
                    view.submit(&self.gaussians, display.image(), &frame)?;
                }
                (Drawing::Lit(view), Some(relighter)) => {
                    let frame = LitFrame { camera, background: [0.0; 3], exposure: 1.0 };
                    let (scene, lighting) = (relighter.scene(), relighter.lighting());
                    view.frame(scene, lighting, display.image(), &frame, |exec, uniforms| exec.submit(uniforms))?;
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
            kind: image.channel.kind(),
            gain: image.gain,
            marks: image.marks,
            text: page.cells(),
            letter_size: image.letter_size,
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
        let marks = crate::lights::MOST as u32;
        let room = DisplayRoom { columns: (window[0] / cell[0]).max(1), rows: (window[1] / cell[1]).max(1), marks };
        let display = Display::scaled(device, &self.font, [window, size], self.chain.format(), room)?;
        Ok(Made { factor, view, display, page: Page::new(room) })
    }

    /// Returns true if the last frame was smaller than the window.
    pub fn is_coarse(&self) -> bool {
        self.is_coarse
    }

    /// Returns the duration of the last frame, from its start until presentation.
    pub fn took(&self) -> Duration {
        self.took
    }

    /// Reads the last frame of the window's size, without marks and letters. Waits for the device.
    ///
    /// Returns texels in the window's format, and true if blue is the first channel.
    pub fn read(&mut self, image: &CanvasImage<'_>) -> Result<Option<(Vec<u8>, bool)>> {
        let Some(Made { display, .. }) = &mut self.made else { return Ok(None) };
        let kind = image.channel.kind();
        display.submit(&Shown { kind, gain: image.gain, marks: &[], text: &[], letter_size: 1 })?;
        display.finish()?;
        let texels = self.device.download_image(display.window())?;
        let blue_first = matches!(self.chain.format(), ImageFormat::Bgra8Unorm | ImageFormat::Bgra8Srgb);
        Ok(Some((texels, blue_first)))
    }

    /// Returns the number of buffers and images created.
    pub fn made(&self) -> u64 {
        self.device.activity().made
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn downscaling_factor_follows_frame_time() {
        let of = |factor, millis| coarser(factor, Duration::from_millis(millis));
        assert_eq!([of(1, 81), of(1, 300), of(1, 2000), of(5, 119), of(8, 100)], [2, 2, 5, 7, 9]);
        assert_eq!([of(1, 1_000_000), of(15, 81), of(12, 500)], [16; 3]);
    }
}
