//! What is shown in the window, and what input does to it.
//!
//! Promises: input changes numbers; drawing happens in one place, once for however much input came before. Leaves the
//! window's events to [`crate::app`].

use crate::canvas::{Canvas, Picture};
use crate::channel::{Channel, Drawn};
use crate::error::{Result, ViewerError};
use crate::eye::Eye;
use crate::input::{Action, KEYS, Walk};
use crate::lamps::{Handles, LampAction};
use crate::save;
use crate::source::Source;
use glam::{DVec2, DVec3};
use sgs_engine::{Device, Surface};
use sgs_relight::Relighter;
use sgs_scene::Camera;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// How fast one walks: radii of the scene in a second.
const PACE: f64 = 0.5;
/// The camera rests once it has not moved for so long.
const REST: Duration = Duration::from_millis(200);
/// Weight of the last frame in the mean time of a frame.
const LATEST: f64 = 0.3;
/// Radians that a drag by one pixel turns.
const TURN: f64 = 0.005;

/// What is being dragged with which button.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Drag {
    Light,
    Orbit,
    Look,
    Pan,
}

/// Everything but the window.
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
    walking: [[bool; 2]; 3],
    /// When the camera or the window has changed last.
    moved: Option<Instant>,
    /// Mean seconds of a frame; 0 before the first.
    seconds: f64,
    pub fast: bool,
    /// Pixels along a pixel of a letter.
    pub letter_size: u32,
    output: PathBuf,
    picture_wanted: bool,
    pub saved: Vec<PathBuf>,
    /// Something has changed since the last frame.
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
            walking: [[false; 2]; 3],
            moved: None,
            seconds: 0.0,
            fast: false,
            letter_size: 1,
            output: output.to_owned(),
            picture_wanted: false,
            saved: Vec::new(),
            stale: true,
        })
    }

    /// The window's title.
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
        // Depth is white at the far end of the scene.
        let full = if self.channel == Channel::Depth { (0.3 / self.source.radius) as f32 } else { 1.0 };
        full * self.stops.exp2()
    }

    fn handles_shown(&self) -> bool {
        self.handles && self.channel.shows_lamps() && self.relighter.is_some()
    }

    fn handle_radius(&self) -> f32 {
        7.0 * self.letter_size as f32
    }

    /// Draws a frame. False if there was nothing to draw on, or the window changes just now.
    pub fn draw(&mut self) -> Result<bool> {
        if self.canvas.size().contains(&0) {
            return Ok(false);
        }
        let camera = self.seen_with();
        let (moving, seconds) = (self.is_moving() && !self.picture_wanted, self.seconds);
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
        let picture = Picture { channel, camera: &camera, moving, gain, letter_size: *letter_size, marks };
        let count = source.splats.len();
        let rate = if seconds > 0.0 { 1.0 / seconds } else { 0.0 };
        let done = canvas.draw(relighter, &picture, |page| {
            let stops = if channel.has_exposure() && *stops != 0.0 { Some(*stops) } else { None };
            let name = channel.name();
            match stops {
                Some(stops) => {
                    page.line(format_args!("{name}  {stops:+.1} stops  {count} Gaussians  {rate:.1} frames/s"))
                }
                None => page.line(format_args!("{name}  {count} Gaussians  {rate:.1} frames/s")),
            }
            if let Some((light, lamp)) = chosen {
                let ([r, g, b], [x, y, z]) = (lamp.color, lamp.position);
                let on = if lamp.on { "" } else { " off" };
                page.line(format_args!(
                    "light {light}{on}  gain {:.3}  color {r:.2} {g:.2} {b:.2}  at {x:.2} {y:.2} {z:.2}",
                    lamp.gain
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
        if done && self.picture_wanted {
            self.picture_wanted = false;
            if let Some((camera, texels, blue_first)) = self.grab()? {
                match save::picture_and_camera(&self.output, &camera, &texels, blue_first) {
                    Ok(path) => self.wrote(path),
                    // A full disk is no reason to close the window.
                    Err(error) => self.say(error.to_string()),
                }
            }
        }
        Ok(done)
    }

    /// Writes what is shown, without marks and letters.
    pub fn save_to(&mut self, path: &Path) -> Result<()> {
        if let Some((camera, texels, blue_first)) = self.grab()? {
            save::picture(path, [camera.width, camera.height], &texels, blue_first)?;
            self.saved.push(path.to_owned());
        }
        Ok(())
    }

    /// The texels of what is shown, with its camera; and whether blue comes first in them.
    fn grab(&mut self) -> Result<Option<(Camera, Vec<u8>, bool)>> {
        if self.canvas.is_coarse() {
            self.moved = None;
            self.draw()?;
        }
        let camera = self.seen_with();
        let (channel, gain) = (self.channel, self.gain());
        let picture = Picture { channel, camera: &camera, moving: false, gain, letter_size: 1, marks: &[] };
        self.stale = true;
        let read = self.canvas.read(&picture)?;
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

    /// Does what a key says. True if the window is to be closed.
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
            Action::Picture => self.picture_wanted = true,
            Action::Lamp(_) | Action::Add | Action::Remove | Action::Sky(_) | Action::Reset | Action::Edit => {
                if let Err(error) = self.relight(action) {
                    // What a light cannot be changes nothing.
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
            Action::Lamp(lamp) => chosen = handles.act(relighter, lamp)?,
            Action::Remove => chosen = handles.remove(relighter)?,
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
        // Where light does not show, nothing would seem to happen.
        if !self.channel.shows_lamps() && self.channel != Channel::Env {
            self.show(Channel::Pbr);
        }
        Ok(())
    }

    /// A key that walks goes down or up.
    pub fn walk(&mut self, Walk(axis, way): Walk, pressed: bool) {
        self.walking[axis][usize::from(way > 0)] = pressed;
    }

    /// All keys are up: the window is not listened to any more.
    pub fn stand(&mut self) {
        self.walking = [[false; 2]; 3];
        self.fast = false;
    }

    /// The camera or the window has just changed.
    pub fn moves(&mut self) {
        self.moved = Some(Instant::now());
        self.stale = true;
    }

    /// Whether the camera moves, or has until just now.
    fn is_moving(&self) -> bool {
        self.walks() || self.moved.is_some_and(|at| at.elapsed() < REST)
    }

    /// Whether a coarse frame still has to be replaced by a fine one; asks for that frame once the camera rests.
    pub fn settles(&mut self) -> bool {
        let coarse = self.canvas.is_coarse();
        self.stale |= coarse && !self.is_moving();
        coarse
    }

    /// Whether one is walking.
    pub fn walks(&self) -> bool {
        self.walking.as_flattened().contains(&true)
    }

    /// Walks for a while.
    pub fn step(&mut self, time: Duration) {
        if !self.walks() {
            return;
        }
        let way = self.walking.map(|[back, forth]| f64::from(i8::from(forth) - i8::from(back)));
        let pace = PACE * self.source.radius * if self.fast { 4.0 } else { 1.0 };
        // Whoever could not draw for a while does not jump.
        self.eye.walk(DVec3::from(way) * pace * time.as_secs_f64().min(0.2));
        self.stale = true;
    }

    /// A button goes down.
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

    /// Buttons are up.
    pub fn release(&mut self) {
        self.drag = None;
        if let Some((_, handles)) = &mut self.relighter {
            handles.release();
        }
    }

    /// The pointer is elsewhere.
    pub fn point(&mut self, to: DVec2) -> Result<()> {
        let by = to - self.pointer;
        self.pointer = to;
        let Some(drag) = self.drag else { return Ok(()) };
        self.moves();
        match drag {
            Drag::Orbit => self.eye.orbit(-TURN * by.x, TURN * by.y),
            Drag::Look => self.eye.look(TURN * by.x, -TURN * by.y),
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

    /// The wheel turns: over a light it dims that, else one comes nearer.
    pub fn wheel(&mut self, notches: f64) -> Result<()> {
        self.stale = true;
        let (camera, radius, shown) = (self.seen_with(), f64::from(self.handle_radius()), self.handles_shown());
        if let Some((relighter, handles)) = self.relighter.as_mut().filter(|_| shown)
            && let Some(light) = handles.pick(relighter, &camera, self.pointer, radius)?
        {
            handles.chosen = Some(light);
            handles.act(relighter, LampAction::Gain(1.1f32.powf(notches as f32)))?;
            return Ok(());
        }
        self.moves();
        self.eye.zoom(0.9f64.powf(notches), 1e-3 * self.source.radius);
        Ok(())
    }
}
