//! Light files of a run: `lights.json`.

use crate::error::{Result, RunError};
use serde::{Deserialize, Serialize};
use sgs_passes::shade::lights::{Axes, LightModel};
use sgs_scene::Unit;
use std::ops::Range;
use std::path::Path;

/// Format identifier of the file.
pub(crate) const FORMAT: &str = "sgs-lights-1";

/// Maximum number of lights in a file.
pub const MOST: usize = 1 << 16;

/// Content of `lights.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LightFile {
    /// Format identifier: `sgs-lights-1`.
    pub format: String,
    /// Common factor of all lights.
    ///
    /// Radiance is this times the sum over the lights of `gain * sum over lobes of amplitude * exp(sharpness *
    /// (direction . axis - 1)) / max(distance^2, 0.001)`. `direction` points from the surface to the light.
    pub normalizer: f32,
    /// Lights of the file.
    pub lights: Vec<LightRow>,
    /// Number of points of each light of the file, in order; empty if each has one.
    #[serde(skip)]
    points: Vec<usize>,
}

/// Point light with directional lobes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LightRow {
    /// Position in world space.
    pub position: [f32; 3],
    /// Factor of the light's intensity; 0 is off.
    pub gain: f32,
    /// Lobes, whose sum is the emission.
    pub lobes: Vec<LobeRow>,
}

/// Spherical Gaussian lobe.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LobeRow {
    /// Unit vector. Surfaces from which the light lies in this direction receive the most.
    pub axis: [f32; 3],
    /// Sharpness, 0 or more; larger is narrower.
    pub sharpness: f32,
    /// Linear red, green, blue.
    pub amplitude: [f32; 3],
}

/// Returns a row of [`LightModel::row`] floats with a free axis. `None` gives a dark lobe.
pub fn raw_lobe(lobe: Option<&LobeRow>) -> [f32; 7] {
    let Some(LobeRow { axis: [x, y, z], sharpness, amplitude }) = lobe else {
        return [0.0, 0.0, 1.0, 0.0, -69.0, -69.0, -69.0];
    };
    let [r, g, b] = amplitude.map(|a| a.max(1e-30).ln());
    [*x, *y, *z, sharpness.max(1e-30).ln(), r, g, b]
}

impl LightFile {
    /// Creates a file of some lights.
    pub fn new(normalizer: f32, lights: Vec<LightRow>) -> LightFile {
        LightFile { format: FORMAT.to_owned(), normalizer, lights, points: Vec::new() }
    }

    /// Adds the points of a light.
    pub fn push(&mut self, mut light: Vec<LightRow>) {
        if self.points.is_empty() && light.len() != 1 {
            self.points = vec![1; self.lights.len()];
        }
        if light.len() != 1 || !self.points.is_empty() {
            self.points.push(light.len());
        }
        self.lights.append(&mut light);
    }

    /// Returns the indices of the points of each light of the file.
    pub fn groups(&self) -> Vec<Range<usize>> {
        if self.points.is_empty() {
            return (0..self.lights.len()).map(|i| i..i + 1).collect();
        }
        let ends = self.points.iter().scan(0, |end, n| {
            *end += n;
            Some(*end - n..*end)
        });
        ends.collect()
    }

    /// Converts raw parameters to a file.
    pub fn of(model: &LightModel, normalizer: f32, positions: &[f32], lobes: &[f32], gains: &[f32]) -> LightFile {
        let row = model.row() as usize;
        let light = |i: usize| LightRow {
            position: [0, 1, 2].map(|c| positions[3 * i + c]),
            gain: gains.get(i).copied().unwrap_or(1.0),
            lobes: (0..model.lobes as usize)
                .map(|k| {
                    let raw = &lobes[(i * model.lobes as usize + k) * row..][..row];
                    let axis = axis(model, k as u32, raw);
                    let at = row - 4;
                    LobeRow {
                        axis,
                        sharpness: raw[at].min(9.5).exp(),
                        amplitude: [1, 2, 3].map(|c| raw[at + c].min(15.0).exp()),
                    }
                })
                .collect(),
        };
        let lights = (0..model.lights as usize).map(light).collect();
        LightFile::new(normalizer, lights)
    }

    /// Returns the same lights with lengths in another unit.
    pub fn in_unit(&self, unit: Unit) -> LightFile {
        let mut file = self.clone();
        let dimmer = unit.length().powi(-2) as f32;
        for light in &mut file.lights {
            light.position = unit.place(light.position);
            light.gain *= dimmer;
        }
        file
    }

    /// Converts to raw parameters with free axes: model, positions, lobes, gains.
    ///
    /// Lights with fewer lobes than others are padded with dark lobes.
    pub fn raw(&self) -> (LightModel, Vec<f32>, Vec<f32>, Vec<f32>) {
        let most = self.lights.iter().map(|l| l.lobes.len()).max().unwrap_or(1).max(1);
        let model = LightModel { lights: self.lights.len().max(1) as u32, lobes: most as u32, axes: Axes::Free };
        let (mut positions, mut lobes, mut gains) = (Vec::new(), Vec::new(), Vec::new());
        let dark = LightRow { position: [0.0; 3], gain: 0.0, lobes: Vec::new() };
        let none = [dark];
        let all = if self.lights.is_empty() { &none[..] } else { &self.lights[..] };
        for light in all {
            positions.extend(light.position);
            gains.push(light.gain);
            for k in 0..most {
                lobes.extend(raw_lobe(light.lobes.get(k)));
            }
        }
        (model, positions, lobes, gains)
    }

    /// Checks values that the types do not constrain.
    ///
    /// # Errors
    /// Description of the first invalid value.
    pub fn check(&self) -> std::result::Result<(), String> {
        if self.format != FORMAT {
            return Err(format!("its format is \"{}\", not \"{FORMAT}\"", self.format));
        }
        if !(self.normalizer.is_finite() && self.normalizer >= 0.0) {
            return Err(format!("the normalizer is {}, but must be a finite number of at least 0", self.normalizer));
        }
        let lobes: usize = self.lights.iter().map(|l| l.lobes.len()).max().unwrap_or(0);
        if lobes > 32 || self.lights.len() > MOST {
            return Err(format!(
                "there are {} lights of up to {lobes} lobes, more than {MOST} of 32",
                self.lights.len()
            ));
        }
        for (i, light) in self.lights.iter().enumerate() {
            light.check().map_err(|e| format!("light {i} {e}"))?;
        }
        Ok(())
    }
}

impl LightRow {
    /// Checks values that the types do not constrain.
    pub(crate) fn check(&self) -> std::result::Result<(), String> {
        let lobes = self.lobes.iter().flat_map(|l| l.axis.iter().chain([&l.sharpness]).chain(&l.amplitude));
        let mut numbers = self.position.iter().chain([&self.gain]).chain(lobes);
        if let Some(bad) = numbers.find(|v| !v.is_finite()) {
            return Err(format!("holds {bad}"));
        }
        if self.gain < 0.0 || self.lobes.iter().any(|l| l.sharpness < 0.0 || l.amplitude.iter().any(|a| *a < 0.0)) {
            return Err("has a negative gain, sharpness or amplitude".to_owned());
        }
        Ok(())
    }
}

/// Returns the axis of a lobe as a unit vector.
fn axis(model: &LightModel, lobe: u32, raw: &[f32]) -> [f32; 3] {
    if model.axes == Axes::Free {
        let [x, y, z] = [raw[0], raw[1], raw[2]].map(f64::from);
        let length = (x * x + y * y + z * z).sqrt();
        let unit = if length > 0.0 { [x / length, y / length, z / length] } else { [0.0, 0.0, 1.0] };
        return unit.map(|v| v as f32);
    }
    let rows = if model.lobes.is_multiple_of(2) { 2 } else { 1 };
    let columns = model.lobes / rows;
    let (row, column) = (f64::from(lobe / columns), f64::from(lobe % columns));
    let pi = std::f64::consts::PI;
    let polar = (row + 0.5) * 0.5 * pi / f64::from(rows) + 0.375 * pi * f64::from(raw[0]).tanh();
    let azimuth = ((column + 0.5) / f64::from(columns) - 0.5) * 2.0 * pi + 0.5 * pi * f64::from(raw[1]).tanh();
    [polar.sin() * azimuth.cos(), polar.sin() * azimuth.sin(), polar.cos()].map(|v| v as f32)
}

/// Writes `lights.json`.
///
/// # Errors
/// If the file cannot be written.
pub fn write_lights(path: &Path, lights: &LightFile) -> Result<()> {
    let text = serde_json::to_string_pretty(lights).map_err(|e| file(path, e.to_string()))?;
    sgs_scene::atomic_write(path, |f| std::io::Write::write_all(f, text.as_bytes()))?;
    Ok(())
}

fn file(path: &Path, reason: String) -> RunError {
    RunError::File { path: path.to_owned(), reason }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lights_roundtrip_through_raw_parameters() {
        for axes in [Axes::Free, Axes::Grid] {
            let model = LightModel { lights: 8, lobes: 12, axes };
            let positions = model.start_positions([-1.0, -2.0, 0.0], [1.0, 2.0, 3.0]);
            let mut lobes = model.start_lobes();
            lobes.iter_mut().enumerate().for_each(|(i, v)| *v += 0.01 * (i % 7) as f32);
            let gains: Vec<f32> = (0..8).map(|i| i as f32 * 0.25).collect();
            let first = LightFile::of(&model, 1.0 / 64.0, positions.as_flattened(), &lobes, &gains);
            assert!(first.check().is_ok());
            let (free, p, l, g) = first.raw();
            assert_eq!((free.axes, p.as_slice(), &g), (Axes::Free, positions.as_flattened(), &gains));
            let second = LightFile::of(&free, 1.0 / 64.0, &p, &l, &g);
            for (a, b) in first.lights.iter().zip(&second.lights) {
                for (a, b) in a.lobes.iter().zip(&b.lobes) {
                    let near = |x: f32, y: f32| (x - y).abs() <= 1e-5 * x.abs().max(1.0);
                    assert!((0..3).all(|c| near(a.axis[c], b.axis[c]) && near(a.amplitude[c], b.amplitude[c])));
                    assert!(near(a.sharpness, b.sharpness));
                    assert!((a.axis.iter().map(|v| v * v).sum::<f32>() - 1.0).abs() < 1e-5);
                }
            }
        }
    }

    #[test]
    fn invalid_values_are_named() {
        let lobe = LobeRow { axis: [0.0, 0.0, 1.0], sharpness: 1.0, amplitude: [1.0; 3] };
        let light = LightRow { position: [0.0; 3], gain: 1.0, lobes: vec![lobe] };
        let good = LightFile::new(1.0, vec![light.clone(); 2]);
        assert_eq!(good.check(), Ok(()));
        let mut bad = good.clone();
        bad.lights[1].position[2] = f32::NAN;
        assert_eq!(bad.check(), Err("light 1 holds NaN".into()));
        let mut bad = good.clone();
        bad.lights[0].lobes[0].sharpness = -1.0;
        assert!(bad.check().unwrap_err().contains("light 0 has a negative"));
        let bad = LightFile { format: "other".into(), ..good.clone() };
        assert!(bad.check().unwrap_err().contains("format"));
        let empty = LightFile { lights: vec![], ..good };
        assert_eq!((empty.check(), empty.raw().0.lights), (Ok(()), 1));
    }
}
