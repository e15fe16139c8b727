//! Window and event loop.
//!
//! Guarantees: the window is drawn only after a change. A missing display is detected before any file is read. The
//! stage interprets events.

use crate::channel::Channel;
use crate::error::{Result, ViewerError};
use crate::input::{Action, action, walk};
use crate::source::Source;
use crate::stage::{Drag, Stage};
use glam::DVec2;
use sgs_engine::{Device, DeviceOptions};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};
use winit::application::ApplicationHandler;
use winit::dpi::PhysicalSize;
use winit::event::{ElementState, KeyEvent, MouseButton, MouseScrollDelta, WindowEvent};
use winit::event_loop::{ActiveEventLoop, ControlFlow, EventLoop};
use winit::window::{Window, WindowId};

/// Interval of polls for a resting camera, while a coarse frame is shown.
const POLL_INTERVAL: Duration = Duration::from_millis(20);
/// Frames after which the window is expected to create no more buffers or images.
const WARM: u64 = 4;

/// Options of the viewer.
#[derive(Clone, Debug)]
pub struct Options {
    /// Run directory, or PLY or glTF file.
    pub source: PathBuf,
    /// Transforms file of the initial cameras. Default: the cameras of the run's scene.
    pub cameras: Option<PathBuf>,
    /// Initial channel. Default: color.
    pub channel: Option<Channel>,
    /// Width and height of the window's interior in pixels.
    pub size: Option<[u32; 2]>,
    /// Folder for saved images and edits.
    pub output: PathBuf,
    /// Number of frames after which the window closes.
    pub frames: Option<u64>,
    /// File for the last of these frames.
    pub save: Option<PathBuf>,
    /// Device options.
    pub device: DeviceOptions,
}

/// Result of a viewer session.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Outcome {
    /// Number of drawn frames.
    pub frames: u64,
    /// Final size of the window in pixels.
    pub size: [u32; 2],
    /// Name of the device.
    pub device: String,
    /// Buffers and images created while drawing, from the fifth frame on.
    pub made_later: u64,
    /// Written files.
    pub saved: Vec<PathBuf>,
    /// Validation messages.
    pub messages: Vec<String>,
}

/// Shows a window until it is closed.
///
/// # Errors
/// If no display exists, no device can present to its windows, or the source cannot be shown.
pub fn run(options: Options) -> Result<Outcome> {
    let events = EventLoop::new().map_err(|e| {
        let text = e.to_string();
        // The libraries prefix the reason with a location in their source.
        let reason = text.rsplit(": ").next().unwrap_or(&text).trim_end_matches('.');
        ViewerError::NoDisplay(reason.to_owned())
    })?;
    let source = Source::open(&options.source, options.cameras.as_deref())?;
    let mut app = App {
        options,
        source: Some(source),
        open: None,
        failed: None,
        last: Instant::now(),
        outcome: Outcome::default(),
        warm: None,
    };
    events.run_app(&mut app).map_err(|e| ViewerError::Window(e.to_string()))?;
    match app.failed.take() {
        Some(error) => Err(error),
        None => Ok(app.outcome),
    }
}

struct App {
    options: Options,
    /// Source, until the window exists.
    source: Option<Source>,
    open: Option<Open>,
    failed: Option<ViewerError>,
    last: Instant,
    outcome: Outcome,
    /// Number of buffers and images created by the end of frame [`WARM`].
    warm: Option<u64>,
}

struct Open {
    // Dropped before the window, which its surface holds anyway.
    stage: Stage,
    device: Device,
    window: Arc<Window>,
}

impl App {
    fn start(&mut self, events: &ActiveEventLoop) -> Result<()> {
        let Some(source) = self.source.take() else { return Ok(()) };
        let [width, height] = self.options.size.unwrap_or_else(|| match source.cameras.first() {
            // The camera's aspect ratio, within 1280 by 800 pixels.
            Some(camera) => {
                let scale = (1280.0 / f64::from(camera.width)).min(800.0 / f64::from(camera.height));
                [camera.width, camera.height].map(|s| ((f64::from(s) * scale).round() as u32).max(160))
            }
            None => [1280, 720],
        });
        let attributes = Window::default_attributes()
            .with_title("sgs view")
            .with_inner_size(PhysicalSize::new(width, height))
            .with_min_inner_size(PhysicalSize::new(16, 16));
        let window = events.create_window(attributes).map_err(|e| ViewerError::Window(e.to_string()))?;
        let window = Arc::new(window);
        let (device, surface) = Device::open_for(&self.options.device, window.clone())?;
        self.outcome.device = device.info().name.clone();
        let size: [u32; 2] = window.inner_size().into();
        let (channel, output) = (self.options.channel, &self.options.output);
        let mut stage = Stage::new(&device, &surface, source, channel, output, size)?;
        stage.letter_size = (window.scale_factor().round() as u32).max(1);
        window.set_title(&stage.title());
        window.request_redraw();
        self.open = Some(Open { stage, device, window });
        Ok(())
    }

    fn event(&mut self, events: &ActiveEventLoop, event: WindowEvent) -> Result<()> {
        let Some(Open { stage, window, .. }) = &mut self.open else { return Ok(()) };
        match event {
            WindowEvent::CloseRequested => events.exit(),
            WindowEvent::Resized(size) => {
                stage.canvas.resize(size.into())?;
                stage.stale = true;
                if self.options.frames.is_none() {
                    stage.moves();
                }
            }
            WindowEvent::ScaleFactorChanged { scale_factor, .. } => {
                stage.letter_size = (scale_factor.round() as u32).max(1);
                stage.stale = true;
            }
            WindowEvent::Focused(false) => stage.stand(),
            WindowEvent::ModifiersChanged(modifiers) => stage.fast = modifiers.state().shift_key(),
            WindowEvent::KeyboardInput { event, is_synthetic: false, .. } => {
                if key(stage, &event)? {
                    events.exit();
                }
                window.set_title(&stage.title());
            }
            WindowEvent::CursorMoved { position, .. } => stage.point(DVec2::new(position.x, position.y))?,
            WindowEvent::MouseInput { state: ElementState::Pressed, button, .. } => match button {
                MouseButton::Left if stage.fast => stage.press(Drag::Pan)?,
                MouseButton::Left => stage.press(Drag::Orbit)?,
                MouseButton::Right => stage.press(Drag::Turn)?,
                MouseButton::Middle => stage.press(Drag::Pan)?,
                _ => {}
            },
            WindowEvent::MouseInput { state: ElementState::Released, .. } => stage.release(),
            WindowEvent::MouseWheel { delta, .. } => stage.wheel(match delta {
                MouseScrollDelta::LineDelta(_, lines) => f64::from(lines),
                MouseScrollDelta::PixelDelta(by) => by.y / 40.0,
            })?,
            WindowEvent::RedrawRequested => return self.draw(events),
            _ => {}
        }
        Ok(())
    }

    fn draw(&mut self, events: &ActiveEventLoop) -> Result<()> {
        let Some(Open { stage, window, .. }) = &mut self.open else { return Ok(()) };
        let now = Instant::now();
        stage.step(now - self.last);
        self.last = now;
        window.pre_present_notify();
        if !stage.draw()? {
            // The window changed during the frame. A window without a size sends an event when it gets one.
            stage.canvas.resize(window.inner_size().into())?;
            return Ok(());
        }
        self.outcome.frames += 1;
        let made = stage.canvas.made();
        if self.outcome.frames == WARM {
            self.warm = Some(made);
        }
        self.outcome.made_later = self.warm.map_or(0, |warm| made - warm);
        if self.options.frames.is_some_and(|frames| self.outcome.frames >= frames) {
            if let Some(path) = self.options.save.clone() {
                stage.save_to(&path)?;
            }
            events.exit();
        }
        Ok(())
    }

    /// Sets the time of the next wake-up and requests a redraw if needed.
    fn rest(&mut self, events: &ActiveEventLoop) -> Result<()> {
        let Some(Open { stage, window, .. }) = &mut self.open else { return Ok(()) };
        let coarse = stage.settles();
        let drawable = !stage.canvas.size().contains(&0);
        if drawable && (stage.stale || stage.walks() || self.options.frames.is_some()) {
            if !stage.walks() {
                self.last = Instant::now();
            }
            window.request_redraw();
        }
        let idle = ControlFlow::Wait;
        events.set_control_flow(if !coarse { idle } else { ControlFlow::WaitUntil(Instant::now() + POLL_INTERVAL) });
        Ok(())
    }

    fn end(&mut self, events: &ActiveEventLoop, result: Result<()>) {
        if let Err(error) = result {
            self.failed = Some(error);
            events.exit();
        }
    }
}

/// Handles a key press or release. Returns true if it closes the window.
fn key(stage: &mut Stage, event: &KeyEvent) -> Result<bool> {
    if let Some(way) = walk(&event.logical_key) {
        stage.walk(way, event.state.is_pressed());
        return Ok(false);
    }
    // A toggle would flicker while its key repeats.
    let repeats = |a: &Action| matches!(a, Action::LightParameters(_) | Action::Exposure(_) | Action::Sky(_));
    match action(&event.logical_key).filter(|a| event.state.is_pressed() && (!event.repeat || repeats(a))) {
        Some(action) => stage.act(action),
        None => Ok(false),
    }
}

impl ApplicationHandler for App {
    fn resumed(&mut self, events: &ActiveEventLoop) {
        let result = self.start(events);
        self.end(events, result);
    }

    fn window_event(&mut self, events: &ActiveEventLoop, _: WindowId, event: WindowEvent) {
        let result = self.event(events, event);
        self.end(events, result);
    }

    fn about_to_wait(&mut self, events: &ActiveEventLoop) {
        if events.exiting() {
            return;
        }
        let result = self.rest(events);
        self.end(events, result);
    }

    fn exiting(&mut self, _: &ActiveEventLoop) {
        let Some(Open { stage, device, window }) = self.open.take() else { return };
        self.outcome.size = stage.canvas.size();
        self.outcome.saved = stage.saved.clone();
        // Stage and window are dropped before the connection to the display closes.
        drop((stage, window));
        self.outcome.messages = device.messages().take();
    }
}
