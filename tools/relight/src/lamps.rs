//! Lights that change from frame to frame: what each is like, and the numbers that shading takes, kept in step.
//!
//! Promises: changing a light writes its own numbers and nothing else, as an edit of the same content would have them;
//! memory is taken only where lights outgrow their room.

use super::edit::NewLight;
use super::lights::{MOST_AMPLITUDE, new_light};
use crate::error::{RelightError, Result};
use sgs_passes::pipeline::Lighting;
use sgs_passes::shade::lights::{Axes, LightModel};
use sgs_run::{LightFile, LightRow, LobeRow, raw_lobe};

/// Most lights there can be.
const MOST: usize = 1 << 16;

/// A light as a program changes it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lamp {
    /// Whether it shines.
    pub on: bool,
    /// Where it is.
    pub position: [f32; 3],
    /// Factor of its light.
    pub gain: f32,
    /// Factors of red, green and blue.
    pub color: [f32; 3],
}

/// All lights.
#[derive(Clone, Debug)]
pub struct Lamps {
    rows: Vec<(LightRow, Lamp)>,
    lighting: Lighting,
}

fn refused<T>(text: String) -> Result<T> {
    Err(RelightError::Edit(text))
}

impl Lamps {
    /// Lights with room for more: for `capacity` lights at least, of `lobes` lobes at least.
    pub fn new(file: Option<&LightFile>, capacity: u32, lobes: u32) -> Lamps {
        let rows: Vec<(LightRow, Lamp)> =
            file.iter().flat_map(|f| &f.lights).map(|row| (row.clone(), Lamp::of(row))).collect();
        let most = rows.iter().map(|(r, _)| r.lobes.len() as u32).max().unwrap_or(1).max(lobes).max(1);
        let lights = capacity.max(rows.len() as u32).max(1);
        let model = LightModel { lights, lobes: most, axes: Axes::Free };
        let normalizer = file.map_or(1.0, |f| f.normalizer);
        let lighting = Lighting {
            model,
            normalizer,
            count: 0,
            positions: Vec::new(),
            lobes: Vec::new(),
            gains: Vec::new(),
            environment: [1.0; 3],
        };
        let mut all = Lamps { rows, lighting };
        all.write_all();
        all
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.rows.len()
    }

    /// What shading takes.
    pub fn lighting(&self) -> &Lighting {
        &self.lighting
    }

    /// Sets the factors of the light of the surroundings.
    ///
    /// # Errors
    /// If they are no factors.
    pub fn set_environment(&mut self, gain: [f32; 3]) -> Result<()> {
        if !gain.iter().all(|v| v.is_finite() && *v >= 0.0) {
            return refused(format!("The environment's gain is {gain:?}, but must be finite and at least 0."));
        }
        self.lighting.environment = gain;
        Ok(())
    }

    fn known(&self, light: usize) -> Result<()> {
        match self.rows.len() {
            n if light < n => Ok(()),
            0 => refused(format!("Light {light} does not exist, there are none.")),
            n => refused(format!("Light {light} does not exist, there are lights 0 to {}.", n - 1)),
        }
    }

    /// One of them.
    ///
    /// # Errors
    /// If it does not exist.
    pub fn get(&self, light: usize) -> Result<Lamp> {
        self.known(light)?;
        Ok(self.rows[light].1)
    }

    /// The color of one's rays, all lobes together; white where it has none.
    ///
    /// # Errors
    /// If it does not exist.
    pub fn color(&self, light: usize) -> Result<[f32; 3]> {
        self.known(light)?;
        let (row, lamp) = &self.rows[light];
        let sum = row.lobes.iter().map(|l| lamp.amplitude(l)).fold([0.0; 3], |a, b| [0, 1, 2].map(|c| a[c] + b[c]));
        let most = sum.iter().copied().fold(0.0, f32::max);
        Ok(if most > 0.0 { sum.map(|v| v / most) } else { [1.0; 3] })
    }

    /// Changes one.
    ///
    /// # Errors
    /// If it does not exist, or cannot be like that; then nothing has changed.
    pub fn set(&mut self, light: usize, lamp: Lamp) -> Result<()> {
        self.known(light)?;
        lamp.check(light, &self.rows[light].0)?;
        self.rows[light].1 = lamp;
        self.write(light);
        Ok(())
    }

    /// Adds one (all patches of a rectangle); gives the number of the first. Past the room for lights there will be twice
    /// as much.
    ///
    /// # Errors
    /// If there cannot be such a light.
    pub fn add(&mut self, new: &NewLight) -> Result<usize> {
        new.check("The new light").map_err(|reason| RelightError::Edit(format!("{reason}.")))?;
        let rows = new_light(new, self.lighting.normalizer)?;
        if self.rows.len() + rows.len() > MOST {
            return refused(format!("There are {} lights, of at most {MOST}.", self.rows.len()));
        }
        let first = self.rows.len();
        self.rows.extend(rows.into_iter().map(|row| (row.clone(), Lamp::of(&row))));
        let model = &mut self.lighting.model;
        let lobes = self.rows[first..].iter().map(|(r, _)| r.lobes.len() as u32).max().unwrap_or(1);
        let count = self.rows.len() as u32;
        if count > model.lights || lobes > model.lobes {
            model.lights = if count > model.lights { count.max(2 * model.lights) } else { model.lights };
            model.lobes = model.lobes.max(lobes);
            self.write_all();
        } else {
            (first..self.rows.len()).for_each(|light| self.write(light));
            self.lighting.count = count;
        }
        Ok(first)
    }

    /// Removes one; those after it move up by one.
    ///
    /// # Errors
    /// If it does not exist.
    pub fn remove(&mut self, light: usize) -> Result<()> {
        self.known(light)?;
        self.rows.remove(light);
        (light..self.rows.len()).for_each(|light| self.write(light));
        let last = self.rows.len();
        self.lighting.count = last as u32;
        self.lighting.gains[last] = 0.0;
        Ok(())
    }

    /// As a file of lights would have them; none if there are none.
    pub fn file(&self) -> Option<LightFile> {
        let shown = |(row, lamp): &(LightRow, Lamp)| {
            let lobes = row.lobes.iter().map(|l| LobeRow { amplitude: lamp.amplitude(l), ..*l });
            LightRow { position: lamp.position, gain: lamp.shines(), lobes: lobes.collect() }
        };
        let lights: Vec<LightRow> = self.rows.iter().map(shown).collect();
        (!lights.is_empty()).then(|| LightFile::new(self.lighting.normalizer, lights))
    }

    fn write_all(&mut self) {
        let model = self.lighting.model;
        let (lights, lobes) = (model.lights as usize, model.lobes as usize);
        self.lighting.positions = vec![0.0; 3 * lights];
        self.lighting.lobes = raw_lobe(None).repeat(lights * lobes);
        self.lighting.gains = vec![0.0; lights];
        self.lighting.count = self.rows.len() as u32;
        (0..self.rows.len()).for_each(|light| self.write(light));
    }

    fn write(&mut self, light: usize) {
        let (row, lamp) = &self.rows[light];
        let floats = (self.lighting.model.lobes * self.lighting.model.row()) as usize;
        self.lighting.positions[3 * light..3 * light + 3].copy_from_slice(&lamp.position);
        self.lighting.gains[light] = lamp.shines();
        let into = &mut self.lighting.lobes[light * floats..(light + 1) * floats];
        let each = self.lighting.model.row() as usize;
        for (k, place) in into.chunks_exact_mut(each).enumerate() {
            let lobe = row.lobes.get(k).map(|l| LobeRow { amplitude: lamp.amplitude(l), ..*l });
            place.copy_from_slice(&raw_lobe(lobe.as_ref()));
        }
    }
}

impl Lamp {
    /// As it is in a file. One that is off there comes on at full gain.
    fn of(row: &LightRow) -> Lamp {
        let on = row.gain != 0.0;
        Lamp { on, position: row.position, gain: if on { row.gain } else { 1.0 }, color: [1.0; 3] }
    }

    fn shines(&self) -> f32 {
        if self.on { self.gain } else { 0.0 }
    }

    fn amplitude(&self, lobe: &LobeRow) -> [f32; 3] {
        [0, 1, 2].map(|c| lobe.amplitude[c] * self.color[c])
    }

    fn check(&self, light: usize, row: &LightRow) -> Result<()> {
        if !self.position.iter().all(|v| v.is_finite()) {
            return refused(format!("The position of light {light} is not finite."));
        }
        if !self.color.iter().chain([&self.gain]).all(|v| v.is_finite() && *v >= 0.0) {
            return refused(format!("Gain and color of light {light} must be finite and at least 0."));
        }
        let brightest = row.lobes.iter().flat_map(|l| self.amplitude(l)).fold(0.0, f32::max);
        if brightest > MOST_AMPLITUDE && self.color.iter().any(|c| *c > 1.0) {
            return refused(format!("Light {light} becomes too bright; use its gain instead of its color."));
        }
        Ok(())
    }
}
