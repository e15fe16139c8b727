//! Lights as handles: drawn, picked, dragged, dimmed, colored; and all that was done to them as an edit.
//!
//! Promises: handles lie where the lights' places are seen; an edit gives `sgs relight` the lights that were seen here. Leaves
//! the light itself to [`Relighter`].

use crate::error::Result;
use glam::{DVec2, DVec3};
use sgs_passes::splat::{MARK_HOLLOW, MARK_RINGED, Mark};
use sgs_relight::{Edit, EnvironmentEdit, Lamp, LightChange, LightEdit, NewLight, Relighter};
use sgs_scene::{Camera, linear_to_srgb};

/// Handles that are drawn at most.
pub const MOST: usize = 256;
/// Pixels beside a handle that still count.
const SLACK: f64 = 3.0;

/// What can be done to the chosen light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LampAction {
    /// Turns its hue, in turns.
    Hue(f32),
    /// More or less of the hue.
    Saturation(f32),
    /// A factor.
    Gain(f32),
    /// On or off.
    Switch,
    /// As it was.
    Reset,
}

/// Handles of all lights.
pub struct Handles {
    /// The run's own lights, as they are on disk.
    before: Vec<Lamp>,
    /// What each light that was added sends at a gain of 1.
    added: Vec<[f32; 3]>,
    /// Factor of the surroundings.
    pub sky: f32,
    /// The one that keys change.
    pub chosen: Option<usize>,
    /// What is being dragged: the light, its depth, and where it was taken.
    held: Option<(usize, f64, DVec2)>,
    marks: Vec<Mark>,
}

impl Handles {
    /// Of a run as it was opened.
    pub fn new(relighter: &Relighter) -> Result<Handles> {
        let before = (0..relighter.lights()).map(|i| relighter.light(i)).collect::<sgs_relight::Result<Vec<_>>>()?;
        let marks = Vec::with_capacity(MOST);
        Ok(Handles { before, added: Vec::new(), sky: 1.0, chosen: None, held: None, marks })
    }

    /// What is drawn for them.
    pub fn marks(&mut self, relighter: &Relighter, camera: &Camera, radius: f32) -> Result<&[Mark]> {
        self.marks.clear();
        for light in 0..relighter.lights().min(MOST) {
            let lamp = relighter.light(light)?;
            let Some(at) = seen(&lamp, camera) else { continue };
            let color = relighter.light_color(light)?.map(linear_to_srgb);
            let mut look = if self.chosen == Some(light) { MARK_RINGED } else { 0 };
            if !lamp.on || lamp.gain == 0.0 {
                look |= MARK_HOLLOW;
            }
            self.marks.push(Mark { at: at.as_vec2().to_array(), radius, look, color });
        }
        Ok(&self.marks)
    }

    /// The light whose handle lies there; the nearest to the viewer, where several do.
    pub fn pick(&self, relighter: &Relighter, camera: &Camera, at: DVec2, radius: f64) -> Result<Option<usize>> {
        let mut best: Option<(f64, usize)> = None;
        for light in 0..relighter.lights().min(MOST) {
            let lamp = relighter.light(light)?;
            let near = seen(&lamp, camera).is_some_and(|p| (p - at).length() <= radius + SLACK);
            let depth = depth(&lamp, camera);
            if near && best.is_none_or(|(d, _)| depth < d) {
                best = Some((depth, light));
            }
        }
        Ok(best.map(|(_, light)| light))
    }

    /// Takes hold of a light.
    pub fn grab(&mut self, relighter: &Relighter, camera: &Camera, light: usize, at: DVec2) -> Result<()> {
        let lamp = relighter.light(light)?;
        self.chosen = Some(light);
        self.held = seen(&lamp, camera).map(|p| (light, depth(&lamp, camera), p - at));
        Ok(())
    }

    /// Lets go.
    pub fn release(&mut self) {
        self.held = None;
    }

    /// Moves what is held to where the pointer is, in the plane that it was seen in. True if there was anything.
    pub fn drag(&mut self, relighter: &mut Relighter, camera: &Camera, at: DVec2) -> Result<bool> {
        let Some((light, depth, offset)) = self.held else { return Ok(false) };
        let lamp = relighter.light(light)?;
        let position = camera.unproject(at + offset, depth).as_vec3().to_array();
        relighter.set_light(light, Lamp { position, ..lamp })?;
        Ok(true)
    }

    /// Changes the chosen light; false if none is.
    pub fn act(&mut self, relighter: &mut Relighter, action: LampAction) -> Result<bool> {
        let Some(light) = self.chosen else { return Ok(false) };
        let mut lamp = relighter.light(light)?;
        match action {
            LampAction::Gain(factor) => lamp.gain = (lamp.gain * factor).clamp(0.0, 1e6),
            LampAction::Switch => lamp.on = !lamp.on,
            LampAction::Hue(turns) => {
                let (hue, saturation) = hue_of(lamp.color);
                // White has no hue to turn.
                lamp.color = colored(hue + turns, if saturation < 0.05 { 0.6 } else { saturation });
            }
            LampAction::Saturation(more) => {
                let (hue, saturation) = hue_of(lamp.color);
                lamp.color = colored(hue, saturation + more);
            }
            LampAction::Reset => match self.before.get(light) {
                Some(before) => lamp = *before,
                None => lamp = Lamp { on: true, gain: 1.0, color: [1.0; 3], ..lamp },
            },
        }
        relighter.set_light(light, lamp)?;
        Ok(true)
    }

    /// Puts a new light there and chooses it. It sends as much as to light a white surface so far away like the picture's
    /// white.
    pub fn add(&mut self, relighter: &mut Relighter, position: DVec3, reach: f64) -> Result<()> {
        // Radiance of a white surface under an intensity I at a distance r is I / (pi r^2).
        let intensity = [(std::f64::consts::PI * reach * reach) as f32; 3];
        let position = Some(position.as_vec3().to_array());
        let new = NewLight { position, intensity: Some(intensity), ..NewLight::default() };
        self.chosen = Some(relighter.add_light(&new)?);
        self.added.push(intensity);
        Ok(())
    }

    /// Removes the chosen light if it was added here, and switches it off if it is the run's. False if none is chosen.
    pub fn remove(&mut self, relighter: &mut Relighter) -> Result<bool> {
        let Some(light) = self.chosen else { return Ok(false) };
        self.release();
        match light.checked_sub(self.before.len()) {
            Some(added) => {
                relighter.remove_light(light)?;
                self.added.remove(added);
                self.chosen = None;
            }
            None => {
                let lamp = relighter.light(light)?;
                relighter.set_light(light, Lamp { on: false, ..lamp })?;
            }
        }
        Ok(true)
    }

    /// Everything as it was.
    pub fn reset(&mut self, relighter: &mut Relighter) -> Result<()> {
        relighter.reset()?;
        self.added.clear();
        self.sky = 1.0;
        (self.chosen, self.held) = (None, None);
        Ok(())
    }

    /// Dims the surroundings.
    pub fn dim_sky(&mut self, relighter: &mut Relighter, factor: f32) -> Result<()> {
        let sky = (self.sky * factor).clamp(0.0, 1e4);
        relighter.set_environment_gain([sky; 3])?;
        self.sky = sky;
        Ok(())
    }

    /// What was done, for `sgs relight --edit`.
    pub fn edit(&self, relighter: &Relighter) -> Result<Edit> {
        let mut lights = LightEdit::default();
        for (number, before) in self.before.iter().enumerate() {
            let now = relighter.light(number)?;
            if now == *before {
                continue;
            }
            lights.change.push(LightChange {
                light: Some(number),
                on: (now.on != before.on).then_some(now.on),
                intensity: (now.gain != before.gain && now.on).then(|| now.gain / before.gain),
                color: (now.color != before.color).then_some(now.color),
                to: (now.position != before.position).then_some(now.position),
                by: None,
            });
        }
        for (k, intensity) in self.added.iter().enumerate() {
            let now = relighter.light(self.before.len() + k)?;
            if now.on && now.gain > 0.0 {
                let intensity = [0, 1, 2].map(|c| intensity[c] * now.gain * now.color[c]);
                let position = Some(now.position);
                lights.add.push(NewLight { position, intensity: Some(intensity), ..NewLight::default() });
            }
        }
        let scale = (self.sky != 1.0).then_some(self.sky);
        Ok(Edit { lights, environment: EnvironmentEdit { scale, ..Default::default() }, ..Default::default() })
    }
}

fn place(lamp: &Lamp) -> DVec3 {
    DVec3::from(lamp.position.map(f64::from))
}

fn depth(lamp: &Lamp, camera: &Camera) -> f64 {
    (camera.rotation * place(lamp) + camera.translation).z
}

/// Where a light's place is seen, if it is in front.
fn seen(lamp: &Lamp, camera: &Camera) -> Option<DVec2> {
    let near = f64::from(sgs_run::camera(camera).near);
    (depth(lamp, camera) > near).then(|| camera.project(place(lamp))).flatten()
}

/// A color whose largest component is 1, by its hue in turns and its saturation.
fn colored(hue: f32, saturation: f32) -> [f32; 3] {
    let (hue, saturation) = (hue.rem_euclid(1.0), saturation.clamp(0.0, 1.0));
    [0.0, 1.0 / 3.0, 2.0 / 3.0].map(|peak: f32| {
        let away = (hue - peak + 0.5).rem_euclid(1.0) - 0.5;
        let full = (2.0 - 6.0 * away.abs()).clamp(0.0, 1.0);
        1.0 - saturation * (1.0 - full)
    })
}

/// Hue and saturation of a color.
fn hue_of(color: [f32; 3]) -> (f32, f32) {
    let [r, g, b] = color;
    let (most, least) = (r.max(g).max(b), r.min(g).min(b));
    if most <= least {
        return (0.0, 0.0);
    }
    let range = most - least;
    let sixth = if most == r {
        (g - b) / range
    } else if most == g {
        2.0 + (b - r) / range
    } else {
        4.0 + (r - g) / range
    };
    ((sixth / 6.0).rem_euclid(1.0), range / most)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hues_go_around_and_come_back() {
        for (hue, expected) in [(0.0, [1.0, 0.0, 0.0]), (1.0 / 3.0, [0.0, 1.0, 0.0])] {
            let found: [f32; 3] = colored(hue, 1.0);
            assert!((0..3).all(|k| (found[k] - expected[k]).abs() < 1e-6), "hue {hue}: {found:?}");
        }
        assert_eq!(colored(0.7, 0.0), [1.0; 3]);
        for k in 0..60 {
            for saturation in [0.2, 0.6, 1.0] {
                let hue = k as f32 / 60.0;
                let color = colored(hue, saturation);
                let (h, s) = hue_of(color);
                let apart = ((h - hue + 0.5).rem_euclid(1.0) - 0.5).abs();
                assert!(apart < 1e-5 && (s - saturation).abs() < 1e-5, "{hue} {saturation}: {color:?}");
                assert!((color.iter().copied().fold(0.0, f32::max) - 1.0).abs() < 1e-6);
            }
        }
    }
}
