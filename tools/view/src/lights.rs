//! Light handles: drawing, picking, dragging, dimming, coloring; and the resulting edit.
//!
//! Emitters of a run take the place of lights. Guarantees: handles lie at the projected positions of their lights. An edit gives `sgs relight` the lights of the
//! window. [`Relighter`] owns the lights.

use crate::error::Result;
use glam::{DVec2, DVec3};
use sgs_passes::splat::{MARK_HOLLOW, MARK_RINGED, Mark};
use sgs_passes::transport::LightShape;
use sgs_relight::{
    Edit, EmitterChange, EmitterEdit, EnvironmentEdit, LightChange, LightEdit, LightParameters, NewEmitter, NewLight,
    Relighter,
};
use sgs_scene::{Camera, linear_to_srgb};

/// Largest number of drawn handles.
pub const MOST: usize = 256;
/// Tolerance of picking around a handle, in pixels.
const SLACK: f64 = 3.0;

/// Change of the selected light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LightAction {
    /// Rotates the hue, in turns.
    Hue(f32),
    /// Adds to the saturation.
    Saturation(f32),
    /// Multiplies the gain.
    Gain(f32),
    /// Switches the light on or off.
    Switch,
    /// Resets the light.
    Reset,
}

/// Handles of all lights.
pub struct Handles {
    /// Lights of the run, as stored on disk.
    before: Vec<LightParameters>,
    /// Intensity of each added light at a gain of 1.
    added: Vec<[f32; 3]>,
    /// Factor on the environment map.
    pub sky: f32,
    /// Light selected for key commands.
    pub chosen: Option<usize>,
    /// Dragged light: its index, its depth, and the offset of the pointer.
    held: Option<(usize, f64, DVec2)>,
    marks: Vec<Mark>,
}

impl Handles {
    /// Creates the handles of a newly opened run.
    pub fn new(relighter: &Relighter) -> Result<Handles> {
        let before = (0..relighter.lights()).map(|i| relighter.light(i)).collect::<sgs_relight::Result<Vec<_>>>()?;
        let marks = Vec::with_capacity(MOST);
        Ok(Handles { before, added: Vec::new(), sky: 1.0, chosen: None, held: None, marks })
    }

    /// Returns the marks to draw.
    pub fn marks(&mut self, relighter: &Relighter, camera: &Camera, radius: f32) -> Result<&[Mark]> {
        self.marks.clear();
        for light in 0..relighter.lights().min(MOST) {
            let light_parameters = relighter.light(light)?;
            let Some(at) = seen(&light_parameters, camera) else { continue };
            let color = relighter.light_color(light)?.map(linear_to_srgb);
            let mut style = if self.chosen == Some(light) { MARK_RINGED } else { 0 };
            if !light_parameters.on || light_parameters.gain == 0.0 {
                style |= MARK_HOLLOW;
            }
            self.marks.push(Mark { at: at.as_vec2().to_array(), radius, style, color });
        }
        Ok(&self.marks)
    }

    /// Returns the light with a handle at `at`; of several, the nearest to the viewer.
    pub fn pick(&self, relighter: &Relighter, camera: &Camera, at: DVec2, radius: f64) -> Result<Option<usize>> {
        let mut best: Option<(f64, usize)> = None;
        for light in 0..relighter.lights().min(MOST) {
            let light_parameters = relighter.light(light)?;
            let near = seen(&light_parameters, camera).is_some_and(|p| (p - at).length() <= radius + SLACK);
            let depth = depth(&light_parameters, camera);
            if near && best.is_none_or(|(d, _)| depth < d) {
                best = Some((depth, light));
            }
        }
        Ok(best.map(|(_, light)| light))
    }

    /// Selects a light and starts dragging it.
    pub fn grab(&mut self, relighter: &Relighter, camera: &Camera, light: usize, at: DVec2) -> Result<()> {
        let light_parameters = relighter.light(light)?;
        self.chosen = Some(light);
        self.held = seen(&light_parameters, camera).map(|p| (light, depth(&light_parameters, camera), p - at));
        Ok(())
    }

    /// Selects the next light, in the order of their numbers. Returns false if there are none.
    ///
    /// Reaches lights whose handles are hidden or at one place, such as those of several suns.
    pub fn choose_next(&mut self, relighter: &Relighter) -> bool {
        let count = relighter.lights();
        self.release();
        self.chosen = (count > 0).then(|| self.chosen.map_or(0, |light| (light + 1) % count));
        count > 0
    }

    /// Stops dragging.
    pub fn release(&mut self) {
        self.held = None;
    }

    /// Moves the dragged light to the pointer, at constant depth. Returns false if no light is dragged.
    pub fn drag(&mut self, relighter: &mut Relighter, camera: &Camera, at: DVec2) -> Result<bool> {
        let Some((light, depth, offset)) = self.held else { return Ok(false) };
        let light_parameters = relighter.light(light)?;
        let position = camera.unproject(at + offset, depth).as_vec3().to_array();
        relighter.set_light(light, LightParameters { position, ..light_parameters })?;
        Ok(true)
    }

    /// Changes the selected light. Returns false if none is selected.
    pub fn act(&mut self, relighter: &mut Relighter, action: LightAction) -> Result<bool> {
        let Some(light) = self.chosen else { return Ok(false) };
        let mut light_parameters = relighter.light(light)?;
        match action {
            LightAction::Gain(factor) => light_parameters.gain = (light_parameters.gain * factor).clamp(0.0, 1e6),
            LightAction::Switch => light_parameters.on = !light_parameters.on,
            LightAction::Hue(turns) => {
                let (hue, saturation) = hue_of(light_parameters.color);
                // White has no hue to rotate, so it first gets a saturation.
                light_parameters.color = colored(hue + turns, if saturation < 0.05 { 0.6 } else { saturation });
            }
            LightAction::Saturation(more) => {
                let (hue, saturation) = hue_of(light_parameters.color);
                light_parameters.color = colored(hue, saturation + more);
            }
            LightAction::Reset => match self.before.get(light) {
                Some(before) => light_parameters = *before,
                None => light_parameters = LightParameters { on: true, gain: 1.0, color: [1.0; 3], ..light_parameters },
            },
        }
        relighter.set_light(light, light_parameters)?;
        Ok(true)
    }

    /// Adds a light at a position and selects it.
    ///
    /// Its intensity gives a white surface at distance `reach` a radiance of 1.
    pub fn add(&mut self, relighter: &mut Relighter, position: DVec3, reach: f64) -> Result<()> {
        // The radiance of a white surface under an intensity I at a distance r is I / (pi r^2).
        let intensity = [(std::f64::consts::PI * reach * reach) as f32; 3];
        let position = Some(position.as_vec3().to_array());
        let new = NewLight { position, intensity: Some(intensity), ..NewLight::default() };
        self.chosen = Some(relighter.add_light(&new)?);
        self.added.push(intensity);
        Ok(())
    }

    /// Removes an added light, or switches off a light of the run.
    ///
    /// Acts on the selected light. Returns false if none is selected.
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
                let light_parameters = relighter.light(light)?;
                relighter.set_light(light, LightParameters { on: false, ..light_parameters })?;
            }
        }
        Ok(true)
    }

    /// Resets all light.
    pub fn reset(&mut self, relighter: &mut Relighter) -> Result<()> {
        relighter.reset()?;
        self.added.clear();
        self.sky = 1.0;
        (self.chosen, self.held) = (None, None);
        Ok(())
    }

    /// Multiplies the environment map by a factor.
    pub fn dim_sky(&mut self, relighter: &mut Relighter, factor: f32) -> Result<()> {
        let sky = (self.sky * factor).clamp(0.0, 1e4);
        relighter.set_environment_gain([sky; 3])?;
        self.sky = sky;
        Ok(())
    }

    /// Returns the edit for `sgs relight --edit`.
    pub fn edit(&self, relighter: &Relighter) -> Result<Edit> {
        if relighter.has_emitters() {
            return Ok(Edit { emitters: self.emitter_edit(relighter)?, ..Default::default() });
        }
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

    /// Returns the changed and added emitters, and the factor on the environment.
    fn emitter_edit(&self, relighter: &Relighter) -> Result<EmitterEdit> {
        let mut edit = EmitterEdit::default();
        edit.environment.scale = (self.sky != 1.0).then_some(self.sky);
        for (number, before) in self.before.iter().enumerate() {
            let now = relighter.light(number)?;
            if now != *before {
                let by = [0, 1, 2].map(|k| now.position[k] - before.position[k]);
                edit.change.push(EmitterChange {
                    emitter: Some(relighter.emitter(number)?.name.clone()),
                    on: (now.on != before.on).then_some(now.on),
                    intensity: (now.gain != before.gain).then(|| now.gain / before.gain),
                    color: (now.color != before.color).then_some(now.color),
                    by: (by != [0.0; 3]).then_some(by),
                });
            }
        }
        for number in self.before.len()..relighter.lights() {
            let (now, row) = (relighter.light(number)?, relighter.emitter(number)?);
            if now.on && now.gain > 0.0 {
                edit.add.push(NewEmitter {
                    name: Some(row.name.clone()),
                    shape: LightShape::Point { position: now.position },
                    color: [0, 1, 2].map(|c| row.color[c] * now.gain * now.color[c]),
                });
            }
        }
        Ok(edit)
    }
}

fn place(light_parameters: &LightParameters) -> DVec3 {
    DVec3::from(light_parameters.position.map(f64::from))
}

fn depth(light_parameters: &LightParameters, camera: &Camera) -> f64 {
    (camera.rotation * place(light_parameters) + camera.translation).z
}

/// Returns the projection of a light's position, if it lies in front of the camera.
fn seen(light_parameters: &LightParameters, camera: &Camera) -> Option<DVec2> {
    let near = f64::from(sgs_run::camera(camera).near);
    (depth(light_parameters, camera) > near).then(|| camera.project(place(light_parameters))).flatten()
}

/// Returns the color of a hue (in turns) and a saturation. Its largest component is 1.
fn colored(hue: f32, saturation: f32) -> [f32; 3] {
    let (hue, saturation) = (hue.rem_euclid(1.0), saturation.clamp(0.0, 1.0));
    [0.0, 1.0 / 3.0, 2.0 / 3.0].map(|peak: f32| {
        let away = (hue - peak + 0.5).rem_euclid(1.0) - 0.5;
        let full = (2.0 - 6.0 * away.abs()).clamp(0.0, 1.0);
        1.0 - saturation * (1.0 - full)
    })
}

/// Returns hue (in turns) and saturation of a color.
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
    fn hue_and_saturation_round_trip() {
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
