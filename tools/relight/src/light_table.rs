//! Lights that change per frame, and their shading parameters, kept in sync.
//!
//! Guarantees: changing a light writes only the parameters of that light. They equal those of an edit with the same
//! content. Memory is allocated only if the lights exceed the capacity.

use super::edit::NewLight;
use super::lights::new_light;
use crate::error::{RelightError, Result};
use sgs_passes::pipeline::{FrameEmitter, Lighting};
use sgs_passes::shade::lights::{Axes, LightModel};
use sgs_run::{LightFile, LightRow, LobeRow, MOST_AMPLITUDE, raw_lobe};

/// Maximum number of lights.
const MOST: usize = 1 << 16;

/// Editable state of a light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightParameters {
    /// Whether the light is on.
    pub on: bool,
    /// Position in scene units.
    pub position: [f32; 3],
    /// Factor on the light's intensity.
    pub gain: f32,
    /// Factors on red, green and blue.
    pub color: [f32; 3],
}

/// All lights, with their shading parameters.
#[derive(Clone, Debug)]
pub struct LightTable {
    rows: Vec<(LightRow, LightParameters)>,
    lighting: Lighting,
}

fn refused<T>(text: String) -> Result<T> {
    Err(RelightError::Edit(text))
}

impl LightTable {
    /// Creates the lights of a file, with room for more.
    ///
    /// The capacity is at least `capacity` lights of at least `lobes` lobes.
    pub fn new(file: Option<&LightFile>, capacity: u32, lobes: u32) -> LightTable {
        let rows: Vec<(LightRow, LightParameters)> =
            file.iter().flat_map(|f| &f.lights).map(|row| (row.clone(), LightParameters::of(row))).collect();
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
            emitters: Vec::new(),
        };
        let mut all = LightTable { rows, lighting };
        all.write_all();
        all
    }

    /// Returns the number of lights.
    pub fn len(&self) -> usize {
        self.rows.len()
    }

    /// Returns the shading parameters.
    pub fn lighting(&self) -> &Lighting {
        &self.lighting
    }

    /// Sets the emitters, which replace the lights and the environment map.
    pub fn set_emitters(&mut self, emitters: Vec<FrameEmitter>) {
        self.lighting.emitters = emitters;
    }

    /// Sets the factors on the light of the environment map.
    ///
    /// # Errors
    /// If a factor is negative or not finite.
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

    /// Returns a light.
    ///
    /// # Errors
    /// If the light does not exist.
    pub fn get(&self, light: usize) -> Result<LightParameters> {
        self.known(light)?;
        Ok(self.rows[light].1)
    }

    /// Returns the color of a light, summed over its lobes; white if it emits nothing.
    ///
    /// The largest component is 1.
    ///
    /// # Errors
    /// If the light does not exist.
    pub fn color(&self, light: usize) -> Result<[f32; 3]> {
        self.known(light)?;
        let (row, light_parameters) = &self.rows[light];
        let sum = row
            .lobes
            .iter()
            .map(|l| light_parameters.amplitude(l))
            .fold([0.0; 3], |a, b| [0, 1, 2].map(|c| a[c] + b[c]));
        let most = sum.iter().copied().fold(0.0, f32::max);
        Ok(if most > 0.0 { sum.map(|v| v / most) } else { [1.0; 3] })
    }

    /// Changes a light.
    ///
    /// # Errors
    /// If the light does not exist, or the values are invalid. Nothing changes then.
    pub fn set(&mut self, light: usize, light_parameters: LightParameters) -> Result<()> {
        self.known(light)?;
        light_parameters.check(light, &self.rows[light].0)?;
        self.rows[light].1 = light_parameters;
        self.write(light);
        Ok(())
    }

    /// Adds a light, or all patches of a rectangle. Returns the index of the first.
    ///
    /// If the capacity for lights is exceeded, it at least doubles.
    ///
    /// # Errors
    /// If the light is invalid, too bright, or exceeds the maximum number of lights.
    pub fn add(&mut self, new: &NewLight) -> Result<usize> {
        new.check("The new light").map_err(|reason| RelightError::Edit(format!("{reason}.")))?;
        let rows = new_light(new, self.lighting.normalizer)?;
        if self.rows.len() + rows.len() > MOST {
            return refused(format!("There are {} lights, of at most {MOST}.", self.rows.len()));
        }
        let first = self.rows.len();
        self.rows.extend(rows.into_iter().map(|row| (row.clone(), LightParameters::of(&row))));
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

    /// Removes a light; the indices of later lights decrease by one.
    ///
    /// # Errors
    /// If the light does not exist.
    pub fn remove(&mut self, light: usize) -> Result<()> {
        self.known(light)?;
        self.rows.remove(light);
        (light..self.rows.len()).for_each(|light| self.write(light));
        let last = self.rows.len();
        self.lighting.count = last as u32;
        self.lighting.gains[last] = 0.0;
        Ok(())
    }

    /// Returns the lights as a light file; `None` without lights.
    pub fn file(&self) -> Option<LightFile> {
        let shown = |(row, light_parameters): &(LightRow, LightParameters)| {
            let lobes = row.lobes.iter().map(|l| LobeRow { amplitude: light_parameters.amplitude(l), ..*l });
            LightRow { position: light_parameters.position, gain: light_parameters.shines(), lobes: lobes.collect() }
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
        let (row, light_parameters) = &self.rows[light];
        let floats = (self.lighting.model.lobes * self.lighting.model.row()) as usize;
        self.lighting.positions[3 * light..3 * light + 3].copy_from_slice(&light_parameters.position);
        self.lighting.gains[light] = light_parameters.shines();
        let into = &mut self.lighting.lobes[light * floats..(light + 1) * floats];
        let each = self.lighting.model.row() as usize;
        for (k, place) in into.chunks_exact_mut(each).enumerate() {
            let lobe = row.lobes.get(k).map(|l| LobeRow { amplitude: light_parameters.amplitude(l), ..*l });
            place.copy_from_slice(&raw_lobe(lobe.as_ref()));
        }
    }
}

impl LightParameters {
    /// Returns the state of a light in a file. A light that is off turns on at full gain.
    fn of(row: &LightRow) -> LightParameters {
        let on = row.gain != 0.0;
        LightParameters { on, position: row.position, gain: if on { row.gain } else { 1.0 }, color: [1.0; 3] }
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
