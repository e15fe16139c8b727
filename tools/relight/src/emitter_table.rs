//! Emitters whose light changes per frame.

use super::emitting::Emitting;
use super::light_table::LightParameters;
use crate::error::{RelightError, Result};
use glam::Vec3;
use sgs_passes::pipeline::FrameEmitter;
use sgs_passes::transport::AreaLight;
use sgs_run::EmitterRow;

/// All emitters, with what a frame shows of them.
#[derive(Clone, Debug)]
pub struct EmitterTable {
    rows: Vec<Row>,
}

#[derive(Clone, Debug)]
struct Row {
    file: EmitterRow,
    /// Radiance of the emitter's surface over its color; 0 if the surface is dark.
    surface: [f32; 3],
    /// Position in the file.
    before: [f32; 3],
    now: LightParameters,
    /// Whether the response is that of another place.
    stale: bool,
}

impl EmitterTable {
    /// Creates the table of the emitters of a run.
    pub fn new(emitting: &Emitting) -> EmitterTable {
        let [low, high] = [emitting.file.enclosure.low, emitting.file.enclosure.high].map(Vec3::from);
        let row = |(row, in_place): (&EmitterRow, &bool)| {
            // Directional light comes from everywhere. Its handle lies in the middle of the room.
            let position = row.shape.center().unwrap_or((low + high) / 2.0).to_array();
            let now = LightParameters { on: row.on, position, gain: 1.0, color: [1.0; 3] };
            let surface = if *in_place { emitting.surface_of(&row.light().shape) } else { [0.0; 3] };
            Row { file: row.clone(), surface, before: position, now, stale: false }
        };
        EmitterTable { rows: emitting.file.emitters.iter().zip(&emitting.in_place).map(row).collect() }
    }

    /// Returns the number of emitters.
    pub fn len(&self) -> usize {
        self.rows.len()
    }

    fn row(&self, emitter: usize) -> Result<&Row> {
        let most = self.rows.len();
        let known =
            if most == 0 { "there are none".to_owned() } else { format!("there are emitters 0 to {}", most - 1) };
        self.rows.get(emitter).ok_or_else(|| RelightError::Edit(format!("Emitter {emitter} does not exist, {known}.")))
    }

    /// Returns an emitter as in `emitters.json`, or as an edit left it.
    ///
    /// # Errors
    /// If the emitter does not exist.
    pub fn file(&self, emitter: usize) -> Result<&EmitterRow> {
        Ok(&self.row(emitter)?.file)
    }

    /// Returns the state of an emitter.
    ///
    /// # Errors
    /// If the emitter does not exist.
    pub fn get(&self, emitter: usize) -> Result<LightParameters> {
        Ok(self.row(emitter)?.now)
    }

    /// Returns the color of an emitter. Its largest component is 1. White if the emitter is black.
    ///
    /// # Errors
    /// If the emitter does not exist.
    pub fn color(&self, emitter: usize) -> Result<[f32; 3]> {
        let Row { file, now, .. } = self.row(emitter)?;
        let color = [0, 1, 2].map(|c| file.color[c] * now.color[c]);
        let most = color.iter().copied().fold(0.0, f32::max);
        Ok(if most > 0.0 { color.map(|v| v / most) } else { [1.0; 3] })
    }

    /// Changes an emitter.
    ///
    /// # Errors
    /// If the emitter does not exist, or the values are invalid. Nothing changes then.
    pub fn set(&mut self, emitter: usize, now: LightParameters) -> Result<()> {
        let row = self.row(emitter)?;
        let name = &row.file.name;
        if now.position.iter().any(|v| !v.is_finite()) {
            return Err(RelightError::Edit(format!("The position of the emitter \"{name}\" is not finite.")));
        }
        let stale = row.stale || now.position != row.now.position;
        let next = Row { now, stale, ..row.clone() };
        let color = next.frame().light.color;
        if !now.color.iter().chain([&now.gain]).all(|v| v.is_finite() && *v >= 0.0)
            || color.iter().any(|v| !v.is_finite())
        {
            let text = format!("Gain and color of the emitter \"{name}\" must be finite and at least 0.");
            return Err(RelightError::Edit(text));
        }
        self.rows[emitter] = next;
        Ok(())
    }

    /// Takes an emitter whose response is that of another place, with its light.
    pub fn take_stale(&mut self) -> Option<(usize, AreaLight)> {
        let (i, row) = self.rows.iter_mut().enumerate().find(|(_, row)| row.stale)?;
        row.stale = false;
        Some((i, row.frame().light))
    }

    /// Marks responses that are those of places in another table.
    pub fn mark_moved(&mut self, other: &EmitterTable) {
        for (row, other) in self.rows.iter_mut().zip(&other.rows) {
            row.stale |= other.stale || other.now.position != row.now.position;
        }
    }

    /// Returns the emitters of a frame.
    pub fn frame(&self) -> Vec<FrameEmitter> {
        self.rows.iter().map(Row::frame).collect()
    }
}

impl Row {
    fn frame(&self) -> FrameEmitter {
        let Row { file, now, surface, before, .. } = self;
        let color = if now.on { [0, 1, 2].map(|c| file.color[c] * now.color[c] * now.gain) } else { [0.0; 3] };
        let by = [0, 1, 2].map(|k| now.position[k] - before[k]);
        let shape = if by == [0.0; 3] { file.shape } else { file.shape.translated(by) };
        let light = AreaLight { color, shape };
        // The surface of a moved emitter is dark.
        let surface = if by == [0.0; 3] { [0, 1, 2].map(|c| surface[c] * color[c]) } else { [0.0; 3] };
        FrameEmitter { light, surface }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sgs_passes::transport::LightShape;

    fn table() -> EmitterTable {
        let row = |name: &str, on| {
            let shape = LightShape::Sphere { center: [1.0, 2.0, 3.0], radius: 0.1 };
            let file = EmitterRow { name: name.to_owned(), on, color: [1.0, 2.0, 4.0], shape };
            let now = LightParameters { on, position: [1.0, 2.0, 3.0], gain: 1.0, color: [1.0; 3] };
            Row {
                file,
                surface: if name == "moved" { [0.0; 3] } else { [1.0; 3] },
                before: now.position,
                now,
                stale: false,
            }
        };
        EmitterTable { rows: vec![row("a", true), row("b", false), row("moved", true)] }
    }

    #[test]
    fn colors_follow_switch_gain_and_color() {
        let mut all = table();
        let colors = |all: &EmitterTable| all.frame().iter().map(|e| (e.light.color, e.surface)).collect::<Vec<_>>();
        let (full, off) = ([1.0, 2.0, 4.0], [0.0; 3]);
        assert_eq!(colors(&all), [(full, full), (off, off), (full, off)]);
        let now = all.get(1).unwrap();
        all.set(1, LightParameters { on: true, gain: 0.5, color: [1.0, 0.0, 1.0], ..now }).unwrap();
        assert_eq!(colors(&all)[1].0, [0.5, 0.0, 2.0]);
        assert_eq!(all.color(1).unwrap(), [0.25, 0.0, 1.0]);
        assert_eq!((all.file(1).unwrap().on, all.len()), (false, 3));
    }

    #[test]
    fn moved_emitters_are_dark_and_stale() {
        let mut all = table();
        let now = all.get(0).unwrap();
        let away = LightParameters { position: [1.5, 2.0, 3.0], ..now };
        all.set(0, away).unwrap();
        let frame = all.frame()[0];
        let there = LightShape::Sphere { center: [1.5, 2.0, 3.0], radius: 0.1 };
        assert_eq!((frame.light.shape, frame.surface), (there, [0.0; 3]));
        assert_eq!(all.take_stale(), Some((0, frame.light)));
        assert_eq!(all.take_stale(), None);
        // A reset makes the response stale again.
        let mut reset = table();
        reset.mark_moved(&all);
        assert_eq!(reset.take_stale().map(|(i, _)| i), Some(0));
        assert_eq!(reset.take_stale(), None);
    }

    #[test]
    fn invalid_states_are_refused() {
        let mut all = table();
        let now = all.get(0).unwrap();
        let text = |r: Result<()>| r.unwrap_err().to_string();
        assert_eq!(text(all.set(3, now)), "Emitter 3 does not exist, there are emitters 0 to 2.");
        assert!(
            text(all.set(0, LightParameters { gain: -1.0, ..now })).contains("\"a\" must be finite and at least 0")
        );
        assert!(text(all.set(0, LightParameters { gain: f32::MAX, ..now })).contains("must be finite"));
        let nowhere = LightParameters { position: [f32::NAN; 3], ..now };
        assert!(text(all.set(0, nowhere)).contains("\"a\" is not finite"));
        assert_eq!((all.get(0).unwrap(), all.take_stale()), (now, None));
    }
}
