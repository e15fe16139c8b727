//! State of the window and the effects of input.
//!
//! Guarantees: input only changes the state. Drawing happens in one place, once for any amount of previous input.
//! [`crate::app`] handles the window's events.

use crate::canvas::{Canvas, CanvasImage};
use crate::channel::{Channel, Drawn};
use crate::error::{Result, ViewerError};
use crate::eye::Eye;
use crate::input::{Action, KEYS, Walk};
use crate::lights::{Handles, LightAction};
use crate::save;
use crate::source::Source;
use glam::{DVec2, DVec3};
use sgs_engine::{Device, Surface};
use sgs_relight::Relighter;
use sgs_run::EmitterRow;
use sgs_scene::Camera;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Walking speed, in scene radii per second.
const RATE: f64 = 0.5;
/// Time without movement after which the camera rests.
const REST: Duration = Duration::from_millis(200);
/// Weight of the last frame in the mean frame time.
const LATEST: f64 = 0.3;
/// Rotation of a drag by one pixel, in radians.
const TURN: f64 = 0.005;

/// Walking keys of an axis that are held.
#[derive(Clone, Copy, Debug, Default)]
struct HeldKeys {
    back: bool,
    forth: bool,
}

/// Kind of drag.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Drag {
    Light,
    Orbit,
    Turn,
    Pan,
}

/// State of the viewer, without the window.
pub struct Stage {
    source: Source,
    relighter: Option<(Relighter, Handles)>,
    pub canvas: Canvas,
    channels: Vec<Channel>,
    channel: Channel,
    eye: Eye,
    camera: usize,
    stops: f32,
    handles: bool,
    help: bool,
    message: String,
    pointer: DVec2,
    drag: Option<Drag>,
    /// Held walking keys of the right, down and forward axes.
    walking: [HeldKeys; 3],
    /// Time of the last change of the camera or the window.
    moved: Option<Instant>,
    /// Mean frame time in seconds; 0 before the first frame.
    seconds: f64,
    pub fast: bool,
    /// Screen pixels along a pixel of a letter.
    pub letter_size: u32,
    output: PathBuf,
    save_requested: bool,
    pub saved: Vec<PathBuf>,
    /// True if the window changed since the last frame.
    pub stale: bool,
}

impl Stage {
    pub fn new(
        device: &Device,
        surface: &Arc<Surface>,
        source: Source,
        channel: Option<Channel>,
        output: &Path,
        size: [u32; 2],
    ) -> Result<Stage> {
        let relighter = if source.has_materials() {
            let relighter = Relighter::open(device, &source.path, 0)?;
            let handles = Handles::new(&relighter)?;
            Some((relighter, handles))
        } else {
            None
        };
        let there = |c: &Channel| match c.drawn() {
            Drawn::Blended(_) => *c != Channel::Normal || source.splats.normals.is_some(),
            Drawn::Lit(_) => relighter.as_ref().is_some_and(|(r, _)| match c {
                Channel::Metallic => r.scene().scene.metallic.is_some(),
                Channel::Visibility => r.scene().scene.visibility.is_some(),
                Channel::Env => !r.has_emitters(),
                _ => true,
            }),
        };
        let channels: Vec<Channel> = Channel::ALL.into_iter().filter(there).collect();
        if let Some(wanted) = channel.filter(|c| !channels.contains(c)) {
            let has = channels.iter().map(|c| c.name()).collect::<Vec<_>>().join(", ");
            return Err(ViewerError::Channel { path: source.path.clone(), channel: wanted.name(), has });
        }
        let canvas = Canvas::new(device, surface, &source.splats, size)?;
        Ok(Stage {
            eye: source.eye(0),
            source,
            relighter,
            canvas,
            channels,
            channel: channel.unwrap_or(Channel::Rgb),
            camera: 0,
            stops: 0.0,
            handles: true,
            help: false,
            message: "H: help".into(),
            pointer: DVec2::ZERO,
            drag: None,
            walking: [HeldKeys::default(); 3],
            moved: None,
            seconds: 0.0,
            fast: false,
            letter_size: 1,
            output: output.to_owned(),
            save_requested: false,
            saved: Vec::new(),
            stale: true,
        })
    }

    /// Returns the title of the window.
    pub fn title(&self) -> String {
        let name = self.source.path.file_name().unwrap_or(self.source.path.as_os_str());
        format!("{} - {} - sgs view", name.to_string_lossy(), self.channel.name())
    }

    fn seen_with(&self) -> Camera {
        self.eye.camera("view", self.canvas.size())
    }

    fn gain(&self) -> f32 {
        if !self.channel.has_exposure() {
            return 1.0;
        }
        // The depth channel is white at the far end of the scene.
        let full = if self.channel == Channel::Depth { (0.3 / self.source.radius) as f32 } else { 1.0 };
        full * self.stops.exp2()
    }

    fn handles_shown(&self) -> bool {
        self.handles && self.channel.shows_lights() && self.relighter.is_some()
    }

    fn handle_radius(&self) -> f32 {
        7.0 * self.letter_size as f32
    }

    /// Draws a frame. Returns false if the window has no area or changed meanwhile.
    pub fn draw(&mut self) -> Result<bool> {
        if self.canvas.size().contains(&0) {
            return Ok(false);
        }
        if let Some((relighter, _)) = &mut self.relighter {
            // The bounces of moved emitters, which the frame shows.
            while relighter.update()? {}
        }
        let camera = self.seen_with();
        let (moving, seconds) = (self.is_moving() && !self.save_requested, self.seconds);
        let (shown, radius, gain) = (self.handles_shown(), self.handle_radius(), self.gain());
        let Stage { source, relighter, canvas, channel, letter_size, stops, help, message, .. } = self;
        let (channel, help) = (*channel, *help);
        let (relighter, mut handles) = match relighter {
            Some((relighter, handles)) => (Some(&*relighter), Some(handles)),
            None => (None, None),
        };
        let chosen = handles.as_ref().and_then(|h| h.chosen).filter(|_| shown);
        let chosen = match (chosen, relighter) {
            (Some(light), Some(r)) => Some((light, r.light(light)?)),
            _ => None,
        };
        let marks = match (&mut handles, relighter) {
            (Some(handles), Some(relighter)) if shown => handles.marks(relighter, &camera, radius)?,
            _ => &[],
        };
        let image = CanvasImage { channel, camera: &camera, moving, gain, letter_size: *letter_size, marks };
        let count = source.splats.len();
        let rate = if seconds > 0.0 { 1.0 / seconds } else { 0.0 };
        let done = canvas.draw(relighter, &image, |page| {
            let stops = if channel.has_exposure() && *stops != 0.0 { Some(*stops) } else { None };
            let name = channel.name();
            match stops {
                Some(stops) => {
                    page.line(format_args!("{name}  {stops:+.1} stops  {count} Gaussians  {rate:.1} frames/s"))
                }
                None => page.line(format_args!("{name}  {count} Gaussians  {rate:.1} frames/s")),
            }
            if let Some((light, light_parameters)) = chosen {
                let ([r, g, b], [x, y, z]) = (light_parameters.color, light_parameters.position);
                let on = if light_parameters.on { "" } else { " off" };
                let emitter = relighter.filter(|r| r.has_emitters()).and_then(|r| r.emitter(light).ok());
                let kind = |row: &EmitterRow| format!("{}, {}", row.name, row.shape.name());
                let name = emitter.map_or_else(|| format!("light {light}"), kind);
                page.line(format_args!(
                    "{name}{on}  gain {:.3}  color {r:.2} {g:.2} {b:.2}  at {x:.2} {y:.2} {z:.2}",
                    light_parameters.gain
                ));
            }
            if !message.is_empty() {
                page.line(format_args!("{message}"));
            }
            if help {
                KEYS.lines().for_each(|line| page.line(format_args!("{line}")));
            }
        })?;
        self.stale = !done;
        let took = self.canvas.took().as_secs_f64();
        self.seconds = if self.seconds > 0.0 { self.seconds + LATEST * (took - self.seconds) } else { took };
        if done && self.save_requested {
            self.save_requested = false;
            if let Some((camera, texels, blue_first)) = self.grab()? {
                match save::image_and_camera(&self.output, &camera, &texels, blue_first) {
                    Ok(path) => self.wrote(path),
                    // A full disk is no reason to close the window.
                    Err(error) => self.say(error.to_string()),
                }
            }
        }
        Ok(done)
    }

    /// Writes the shown image, without marks and letters.
    pub fn save_to(&mut self, path: &Path) -> Result<()> {
        if let Some((camera, texels, blue_first)) = self.grab()? {
            save::image(path, [camera.width, camera.height], &texels, blue_first)?;
            self.saved.push(path.to_owned());
        }
        Ok(())
    }

    /// Reads the shown image and its camera. The flag is true if blue is the first channel.
    fn grab(&mut self) -> Result<Option<(Camera, Vec<u8>, bool)>> {
        if self.canvas.is_coarse() {
            self.moved = None;
            self.draw()?;
        }
        let camera = self.seen_with();
        let (channel, gain) = (self.channel, self.gain());
        let image = CanvasImage { channel, camera: &camera, moving: false, gain, letter_size: 1, marks: &[] };
        self.stale = true;
        let read = self.canvas.read(&image)?;
        Ok(read.map(|(texels, blue_first)| (camera, texels, blue_first)))
    }

    fn wrote(&mut self, path: PathBuf) {
        self.say(format!("wrote {}", path.display()));
        self.saved.push(path);
    }

    fn say(&mut self, text: String) {
        tracing::info!("{text}");
        self.message = text;
        self.stale = true;
    }

    /// Executes an action. Returns true if it closes the window.
    pub fn act(&mut self, action: Action) -> Result<bool> {
        self.stale = true;
        self.message.clear();
        match action {
            Action::Leave => return Ok(true),
            Action::Show(channel) => self.show(channel),
            Action::Turn(by) => {
                let at = self.channels.iter().position(|c| *c == self.channel).unwrap_or(0) as i32;
                self.channel = self.channels[(at + by).rem_euclid(self.channels.len() as i32) as usize];
            }
            Action::Exposure(stops) => self.stops = stops.map_or(0.0, |s| (self.stops + s).clamp(-16.0, 16.0)),
            Action::Camera(by) => {
                let count = self.source.cameras.len().max(1) as i32;
                self.camera = by.map_or(0, |by| (self.camera as i32 + by).rem_euclid(count) as usize);
                self.eye = self.source.eye(self.camera);
                let name = self.source.cameras.get(self.camera).map(|c| format!("camera {}", c.name));
                self.message = name.unwrap_or_else(|| "no cameras are known".into());
            }
            Action::Handles => self.handles = !self.handles,
            Action::Help => self.help = !self.help,
            Action::SaveImage => self.save_requested = true,
            Action::LightParameters(_)
            | Action::Add
            | Action::Next
            | Action::Remove
            | Action::Sky(_)
            | Action::Reset
            | Action::Edit => {
                if let Err(error) = self.relight(action) {
                    // A refused change of a light leaves the lights unchanged.
                    self.say(error.to_string());
                }
            }
        }
        Ok(false)
    }

    fn show(&mut self, channel: Channel) {
        if self.channels.contains(&channel) {
            self.channel = channel;
        } else {
            self.say(format!("there is no {} here", channel.name()));
        }
    }

    fn relight(&mut self, action: Action) -> Result<()> {
        let (target, reach) = (self.eye.target(), 0.5 * self.source.radius);
        let Some((relighter, handles)) = &mut self.relighter else {
            self.say("there are no materials to be lit: train them with --stage intrinsic".into());
            return Ok(());
        };
        let mut chosen = true;
        match action {
            Action::LightParameters(light_parameters) => chosen = handles.act(relighter, light_parameters)?,
            Action::Remove => chosen = handles.remove(relighter)?,
            Action::Next => {
                if !handles.choose_next(relighter) {
                    self.message = "there are no lights".into();
                }
            }
            Action::Add => handles.add(relighter, target, reach)?,
            Action::Sky(factor) => {
                handles.dim_sky(relighter, factor)?;
                self.message = format!("environment map {:.3}", handles.sky);
            }
            Action::Reset => handles.reset(relighter)?,
            _ => {
                let path = save::edit(&self.output, &handles.edit(relighter)?)?;
                self.wrote(path);
                return Ok(());
            }
        }
        if !chosen {
            self.message = "choose a light first: click on it".into();
        }
        // In a channel without lighting the change would be invisible.
        if !self.channel.shows_lights() && self.channel != Channel::Env {
            self.show(Channel::Pbr);
        }
        Ok(())
    }

    /// Handles the press or release of a walking key.
    pub fn walk(&mut self, Walk(axis, way): Walk, pressed: bool) {
        let keys = &mut self.walking[axis];
        *(if way > 0 { &mut keys.forth } else { &mut keys.back }) = pressed;
    }

    /// Releases all keys, because the window lost the focus.
    pub fn stand(&mut self) {
        self.walking = [HeldKeys::default(); 3];
        self.fast = false;
    }

    /// Records a change of the camera or the window.
    pub fn moves(&mut self) {
        self.moved = Some(Instant::now());
        self.stale = true;
    }

    /// Returns true if the camera moves or moved less than [`REST`] ago.
    fn is_moving(&self) -> bool {
        self.walks() || self.moved.is_some_and(|at| at.elapsed() < REST)
    }

    /// Returns true if the last frame was coarse. Marks it stale once the camera rests.
    pub fn settles(&mut self) -> bool {
        let coarse = self.canvas.is_coarse();
        self.stale |= coarse && !self.is_moving();
        coarse
    }

    /// Returns true if a walking key is held.
    pub fn walks(&self) -> bool {
        self.walking.iter().any(|keys| keys.back || keys.forth)
    }

    /// Walks for the given time.
    pub fn step(&mut self, time: Duration) {
        if !self.walks() {
            return;
        }
        let way = self.walking.map(|keys| f64::from(i8::from(keys.forth) - i8::from(keys.back)));
        let turn_rate = RATE * self.source.radius * if self.fast { 4.0 } else { 1.0 };
        // The time step is limited, so that a slow frame causes no jump.
        self.eye.walk(DVec3::from(way) * turn_rate * time.as_secs_f64().min(0.2));
        self.stale = true;
    }

    /// Handles the press of a button.
    pub fn press(&mut self, drag: Drag) -> Result<()> {
        self.drag = Some(drag);
        let (camera, radius, shown) = (self.seen_with(), f64::from(self.handle_radius()), self.handles_shown());
        let Some((relighter, handles)) = self.relighter.as_mut().filter(|_| shown && drag == Drag::Orbit) else {
            return Ok(());
        };
        self.stale = true;
        match handles.pick(relighter, &camera, self.pointer, radius)? {
            Some(light) => {
                handles.grab(relighter, &camera, light, self.pointer)?;
                self.drag = Some(Drag::Light);
            }
            None => handles.chosen = None,
        }
        Ok(())
    }

    /// Handles the release of the buttons.
    pub fn release(&mut self) {
        self.drag = None;
        if let Some((_, handles)) = &mut self.relighter {
            handles.release();
        }
    }

    /// Handles a movement of the pointer.
    pub fn point(&mut self, to: DVec2) -> Result<()> {
        let by = to - self.pointer;
        self.pointer = to;
        let Some(drag) = self.drag else { return Ok(()) };
        self.moves();
        match drag {
            Drag::Orbit => self.eye.orbit(-TURN * by.x, TURN * by.y),
            Drag::Turn => self.eye.turn(TURN * by.x, -TURN * by.y),
            Drag::Pan => {
                let pixel = self.eye.pixel(self.canvas.size());
                self.eye.walk(DVec3::new(-by.x, -by.y, 0.0) * pixel);
            }
            Drag::Light => {
                let camera = self.seen_with();
                if let Some((relighter, handles)) = &mut self.relighter {
                    handles.drag(relighter, &camera, to)?;
                }
            }
        }
        Ok(())
    }

    /// Handles the wheel: dims the light under the pointer, otherwise zooms.
    pub fn wheel(&mut self, notches: f64) -> Result<()> {
        self.stale = true;
        let (camera, radius, shown) = (self.seen_with(), f64::from(self.handle_radius()), self.handles_shown());
        if let Some((relighter, handles)) = self.relighter.as_mut().filter(|_| shown)
            && let Some(light) = handles.pick(relighter, &camera, self.pointer, radius)?
        {
            handles.chosen = Some(light);
            handles.act(relighter, LightAction::Gain(1.1f32.powf(notches as f32)))?;
            return Ok(());
        }
        self.moves();
        self.eye.zoom(0.9f64.powf(notches), 1e-3 * self.source.radius);
        Ok(())
    }
}
