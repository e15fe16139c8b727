//! Emitters whose light changes per frame.

use super::emitters::is_window;
use super::emitting::Emitting;
use super::light_table::LightParameters;
use crate::error::{RelightError, Result};
use glam::Vec3;
use sgs_passes::pipeline::FrameEmitter;
use sgs_passes::transport::AreaLight;
use sgs_run::EmitterRow;

/// All emitters, with what a frame shows of them.
///
/// The scene has a response per row. The row of a removed emitter stays, black, and the next emitter with as many parts takes it.
#[derive(Clone, Debug)]
pub struct EmitterTable {
    rows: Vec<Row>,
    /// Row of each emitter, by number.
    order: Vec<usize>,
    /// Position of the handles of directional light, which comes from everywhere.
    middle: Vec3,
    /// Factors on the environment that windows show.
    environment: [f32; 3],
}

#[derive(Clone, Debug)]
struct Row {
    file: EmitterRow,
    /// Radiance of the emitter's surface over its color; 0 if the surface is dark.
    surface: [f32; 3],
    /// Position in the file.
    before: [f32; 3],
    now: LightParameters,
    /// Whether the response is that of another place or shape.
    stale: bool,
    /// Whether the emitter was removed.
    removed: bool,
}

impl EmitterTable {
    /// Creates the table of the emitters of a run.
    pub fn new(emitting: &Emitting) -> EmitterTable {
        let [low, high] = [emitting.file.enclosure.low, emitting.file.enclosure.high].map(Vec3::from);
        let middle = (low + high) / 2.0;
        let row = |(row, in_place): (&EmitterRow, &bool)| {
            let surface = if *in_place { emitting.surface_of(&row.shape) } else { [0.0; 3] };
            Row { surface, ..Row::new(row.clone(), middle) }
        };
        let rows: Vec<Row> = emitting.file.emitters.iter().zip(&emitting.in_place).map(row).collect();
        EmitterTable { order: (0..rows.len()).collect(), rows, middle, environment: [1.0; 3] }
    }

    /// Returns the number of emitters.
    pub fn len(&self) -> usize {
        self.order.len()
    }

    /// Returns the row of an emitter.
    ///
    /// # Errors
    /// If the emitter does not exist.
    pub fn row_of(&self, emitter: usize) -> Result<usize> {
        let most = self.order.len();
        let known =
            if most == 0 { "there are none".to_owned() } else { format!("there are emitters 0 to {}", most - 1) };
        let row = self.order.get(emitter).copied();
        row.ok_or_else(|| RelightError::Edit(format!("Emitter {emitter} does not exist, {known}.")))
    }

    fn row(&self, emitter: usize) -> Result<&Row> {
        Ok(&self.rows[self.row_of(emitter)?])
    }

    /// Returns whether an emitter has this name.
    pub fn has(&self, name: &str) -> bool {
        self.rows.iter().any(|row| !row.removed && row.file.name == name)
    }

    /// Adds an emitter after the others and returns its row.
    ///
    /// Takes the row of a removed emitter, whose response becomes stale, or a new one, which the scene has no response for.
    pub fn add(&mut self, file: EmitterRow) -> usize {
        let free = self.rows.iter().position(|r| r.removed && is_window(&r.file) == is_window(&file));
        let row = Row { stale: free.is_some(), ..Row::new(file, self.middle) };
        let at = free.unwrap_or(self.rows.len());
        match self.rows.get_mut(at) {
            Some(place) => *place = row,
            None => self.rows.push(row),
        }
        self.order.push(at);
        at
    }

    /// Removes an emitter. The numbers of the emitters after it decrease by one.
    ///
    /// # Errors
    /// If the emitter does not exist.
    pub fn remove(&mut self, emitter: usize) -> Result<()> {
        let row = self.row_of(emitter)?;
        self.rows[row].removed = true;
        self.order.remove(emitter);
        Ok(())
    }

    /// Replaces shape and color of an emitter. Its factors become 1. The surface of an emitter of another shape is dark.
    ///
    /// # Errors
    /// If the emitter does not exist, the light is invalid, or it is a window and was none, or the other way round.
    pub fn replace(&mut self, emitter: usize, light: AreaLight) -> Result<()> {
        let at = self.row_of(emitter)?;
        let Row { file, surface, before, now, stale, .. } = &self.rows[at];
        let name = &file.name;
        light.check().map_err(|e| RelightError::Edit(format!("The emitter \"{name}\": {e}.")))?;
        let next = EmitterRow { shape: light.shape, color: light.color, on: now.on, ..file.clone() };
        if is_window(file) != is_window(&next) {
            let text = format!("The emitter \"{name}\" cannot become a {}; remove it and add one.", light.shape.name());
            return Err(RelightError::Edit(text));
        }
        let stale = *stale || light.shape != file.shape || now.position != *before;
        let surface = if light.shape == file.shape { *surface } else { [0.0; 3] };
        self.rows[at] = Row { surface, stale, ..Row::new(next, self.middle) };
        Ok(())
    }

    /// Sets the factors on the environment that windows show.
    ///
    /// # Errors
    /// If a factor is negative or not finite.
    pub fn set_environment(&mut self, gain: [f32; 3]) -> Result<()> {
        if !gain.iter().all(|v| v.is_finite() && *v >= 0.0) {
            let text = format!("The environment's gain is {gain:?}, but must be finite and at least 0.");
            return Err(RelightError::Edit(text));
        }
        self.environment = gain;
        Ok(())
    }

    /// Lets the surfaces of windows show another environment.
    pub fn show_environment(&mut self, emitting: &Emitting) {
        for row in self.rows.iter_mut().filter(|r| is_window(&r.file) && r.surface != [0.0; 3]) {
            row.surface = emitting.surface_of(&row.file.shape);
        }
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
        let (at, row) = (self.row_of(emitter)?, self.row(emitter)?);
        let name = &row.file.name;
        if now.position.iter().any(|v| !v.is_finite()) {
            return Err(RelightError::Edit(format!("The position of the emitter \"{name}\" is not finite.")));
        }
        let stale = row.stale || now.position != row.now.position;
        let next = Row { now, stale, ..row.clone() };
        let color = next.frame([1.0; 3]).light.color;
        if !now.color.iter().chain([&now.gain]).all(|v| v.is_finite() && *v >= 0.0)
            || color.iter().any(|v| !v.is_finite())
        {
            let text = format!("Gain and color of the emitter \"{name}\" must be finite and at least 0.");
            return Err(RelightError::Edit(text));
        }
        self.rows[at] = next;
        Ok(())
    }

    /// Takes the row and the light of an emitter whose response is stale.
    pub fn take_stale(&mut self) -> Option<(usize, AreaLight)> {
        let (i, row) = self.rows.iter_mut().enumerate().find(|(_, row)| row.stale && !row.removed)?;
        row.stale = false;
        Some((i, row.frame(self.environment).light))
    }

    /// Marks all responses as those of the present places.
    pub fn mark_current(&mut self) {
        self.rows.iter_mut().for_each(|row| row.stale = false);
    }

    /// Marks responses that are those of places in another table.
    pub fn mark_moved(&mut self, other: &EmitterTable) {
        for (row, other) in self.rows.iter_mut().zip(&other.rows) {
            row.stale |= other.stale || other.now.position != row.now.position;
        }
    }

    /// Returns the emitters of a frame, by row.
    pub fn frame(&self) -> Vec<FrameEmitter> {
        self.rows.iter().map(|row| row.frame(self.environment)).collect()
    }
}

impl Row {
    /// Creates the row of an emitter with a dark surface.
    fn new(file: EmitterRow, middle: Vec3) -> Row {
        let position = file.shape.center().unwrap_or(middle).to_array();
        let now = LightParameters { on: file.on, position, gain: 1.0, color: [1.0; 3] };
        Row { file, surface: [0.0; 3], before: position, now, stale: false, removed: false }
    }

    /// `environment`: factors on the light of windows.
    fn frame(&self, environment: [f32; 3]) -> FrameEmitter {
        let Row { file, now, surface, before, .. } = self;
        let on = now.on && !self.removed;
        let mut color = if on { [0, 1, 2].map(|c| file.color[c] * now.color[c] * now.gain) } else { [0.0; 3] };
        if is_window(file) {
            (0..3).for_each(|c| color[c] = (color[c] * environment[c]).min(f32::MAX));
        }
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
            let surface = if name == "moved" { [0.0; 3] } else { [1.0; 3] };
            Row { surface, ..Row::new(file, Vec3::ZERO) }
        };
        let rows = vec![row("a", true), row("b", false), row("moved", true)];
        EmitterTable { rows, order: vec![0, 1, 2], middle: Vec3::ZERO, environment: [1.0; 3] }
    }

    fn emitter(name: &str, shape: LightShape) -> EmitterRow {
        EmitterRow { name: name.to_owned(), on: true, color: [1.0; 3], shape }
    }

    fn window() -> LightShape {
        LightShape::Window { corner: [0.0; 3], edge_u: [1.0, 0.0, 0.0], edge_v: [0.0, 1.0, 0.0] }
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

    #[test]
    fn removed_emitters_are_black_and_their_rows_are_taken_again() {
        let mut all = table();
        all.remove(0).unwrap();
        assert_eq!((all.len(), all.has("a"), all.has("b"), all.rows.len()), (2, false, true, 3));
        assert_eq!((all.frame()[0].light.color, all.frame()[0].surface), ([0.0; 3], [0.0; 3]));
        assert_eq!((&*all.file(0).unwrap().name, &*all.file(1).unwrap().name), ("b", "moved"));
        // A window has three parts, so that it cannot take the row of a sphere.
        assert_eq!(all.add(emitter("window", window())), 3);
        let sun = LightShape::Directional { direction: [0.0, -1.0, 0.0], angular_radius: 0.0 };
        assert_eq!(all.add(emitter("sun", sun)), 0);
        let names: Vec<&str> = (0..all.len()).map(|i| &*all.file(i).unwrap().name).collect();
        assert_eq!(names, ["b", "moved", "window", "sun"]);
        // The surface of the removed emitter stays dark.
        assert_eq!((all.frame()[0].light.color, all.frame()[0].surface), ([1.0; 3], [0.0; 3]));
        assert_eq!(all.take_stale().map(|(row, light)| (row, light.shape)), Some((0, sun)));
        assert_eq!(all.take_stale(), None);
        all.remove(3).unwrap();
        assert!(all.remove(3).is_err() && all.row_of(3).is_err());
    }

    #[test]
    fn replaced_shapes_are_stale_and_windows_follow_the_environment() {
        let mut all = table();
        all.add(emitter("window", window()));
        all.set_environment([2.0, 0.5, 0.0]).unwrap();
        let colors: Vec<_> = all.frame().iter().map(|e| e.light.color).collect();
        assert_eq!((colors[0], colors[3]), ([1.0, 2.0, 4.0], [2.0, 0.5, 0.0]));
        assert!(all.set_environment([1.0, f32::NAN, 1.0]).is_err() && all.set_environment([-1.0; 3]).is_err());
        let same = LightShape::Sphere { center: [1.0, 2.0, 3.0], radius: 0.1 };
        all.replace(0, AreaLight { shape: same, color: [5.0; 3] }).unwrap();
        assert_eq!((all.frame()[0].surface, all.take_stale()), ([5.0; 3], None));
        let larger = LightShape::Sphere { center: [1.0, 2.0, 3.0], radius: 0.2 };
        all.replace(1, AreaLight { shape: larger, color: [5.0; 3] }).unwrap();
        // It was off, and stays off.
        assert_eq!((all.frame()[1].surface, all.frame()[1].light.color), ([0.0; 3], [0.0; 3]));
        assert_eq!(all.take_stale().map(|(row, light)| (row, light.shape)), Some((1, larger)));
        let text = |r: Result<()>| r.unwrap_err().to_string();
        let pane = AreaLight { shape: window(), color: [1.0; 3] };
        assert!(text(all.replace(0, pane)).contains("\"a\" cannot become a window; remove it"));
        let flat = LightShape::Sphere { center: [0.0; 3], radius: -1.0 };
        assert!(text(all.replace(0, AreaLight { shape: flat, color: [1.0; 3] })).contains("\"a\": radius: length -1"));
        assert_eq!(all.file(0).unwrap().shape, same);
    }
}
