//! The window and its events.
//!
//! Promises: the window is drawn when something changed and not otherwise; a display that is not there is found out before
//! anything is read. Leaves what events mean to the stage.

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

/// How often it is asked whether the camera rests, where a coarse frame is shown.
const LOOK_AGAIN: Duration = Duration::from_millis(20);
/// Frames after which a window is expected to make nothing more.
const WARM: u64 = 4;

/// What is shown, and how.
#[derive(Clone, Debug)]
pub struct Options {
    /// A run directory or a PLY file.
    pub source: PathBuf,
    /// Cameras to begin with: a transforms file; those of the run's scene by default.
    pub cameras: Option<PathBuf>,
    /// What is shown first; color by default.
    pub channel: Option<Channel>,
    /// Columns and rows of the window's inside.
    pub size: Option<[u32; 2]>,
    /// Where pictures and edits go.
    pub output: PathBuf,
    /// So many frames are drawn, and the window is closed.
    pub frames: Option<u64>,
    /// The last of these is written here.
    pub save: Option<PathBuf>,
    /// The device.
    pub device: DeviceOptions,
}

/// What came of it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Outcome {
    /// Frames that were drawn.
    pub frames: u64,
    /// The window's size at the end.
    pub size: [u32; 2],
    /// The device.
    pub device: String,
    /// Buffers and images made while frames were drawn, from the fifth on.
    pub made_later: u64,
    /// Files that were written.
    pub saved: Vec<PathBuf>,
    /// What validation said.
    pub messages: Vec<String>,
}

/// Shows a window until it is closed.
///
/// # Errors
/// If there is no display, no device that can show in its windows, or the source cannot be shown.
pub fn run(options: Options) -> Result<Outcome> {
    let events = EventLoop::new().map_err(|e| {
        let text = e.to_string();
        // The libraries say where in their source they found out.
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
    /// Until the window is there.
    source: Option<Source>,
    open: Option<Open>,
    failed: Option<ViewerError>,
    last: Instant,
    outcome: Outcome,
    /// What had been made once the window was warm.
    warm: Option<u64>,
}

struct Open {
    // Before the window, which its surface holds anyway.
    stage: Stage,
    device: Device,
    window: Arc<Window>,
}

impl App {
    fn start(&mut self, events: &ActiveEventLoop) -> Result<()> {
        let Some(source) = self.source.take() else { return Ok(()) };
        let [width, height] = self.options.size.unwrap_or_else(|| match source.cameras.first() {
            // The camera's shape at a size that is good to look at.
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
                MouseButton::Right => stage.press(Drag::Look)?,
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
            // The window has changed under the picture; without a size it says so when it gets one.
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

    /// Says when to come back.
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
        events.set_control_flow(if !coarse { idle } else { ControlFlow::WaitUntil(Instant::now() + LOOK_AGAIN) });
        Ok(())
    }

    fn end(&mut self, events: &ActiveEventLoop, result: Result<()>) {
        if let Err(error) = result {
            self.failed = Some(error);
            events.exit();
        }
    }
}

/// A key goes down or up; true if that closes the window.
fn key(stage: &mut Stage, event: &KeyEvent) -> Result<bool> {
    if let Some(way) = walk(&event.logical_key) {
        stage.walk(way, event.state.is_pressed());
        return Ok(false);
    }
    // What is switched would flicker if a key were held.
    let repeats = |a: &Action| matches!(a, Action::Lamp(_) | Action::Exposure(_) | Action::Sky(_));
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
        // Everything goes before the connection to the display does.
        drop((stage, window));
        self.outcome.messages = device.messages().take();
    }
}
