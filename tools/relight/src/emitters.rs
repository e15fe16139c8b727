//! Edit of the emitters of a run.

use crate::environment::EnvironmentEdit;
use crate::error::{RelightError, Result};
use serde::{Deserialize, Serialize};
use sgs_passes::transport::LightShape;
use sgs_run::{EmitterFile, EmitterRow, OpeningRow, SKY, check_openings};
use sgs_scene::MOST_EMITTERS;
use std::path::PathBuf;

/// Edit of the emitters of a run with `emitters.json`. Their light bounces.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EmitterEdit {
    /// Turns all emitters of the run off.
    pub off: bool,
    /// Turns all emitters of the run off except these.
    pub only: Option<Vec<String>>,
    /// Changes to single emitters of the run, applied after `off` and `only`.
    pub change: Vec<EmitterChange>,
    /// New emitters.
    pub add: Vec<NewEmitter>,
    /// Lights to add: a glTF file or a `lights.json`.
    ///
    /// A relative path starts at the directory of the edit file.
    pub file: Option<PathBuf>,
    /// Replaces the openings, through which light from outside enters.
    pub openings: Option<Vec<OpeningRow>>,
    /// Environment behind the openings. With one, each opening is a window onto it.
    pub environment: EnvironmentEdit,
}

/// Change of one emitter.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EmitterChange {
    /// Name of the emitter in `emitters.json`.
    pub emitter: Option<String>,
    /// Turns the emitter on or off.
    pub on: Option<bool>,
    /// Factor on its light.
    pub intensity: Option<f32>,
    /// Factors on red, green and blue.
    pub color: Option<[f32; 3]>,
    /// Translation.
    pub by: Option<[f32; 3]>,
}

/// New emitter. It has no visible surface.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NewEmitter {
    /// Name; "new 1" and so on by default.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// Shape and place, as in `emitters.json`.
    pub shape: LightShape,
    /// Linear RGB: radiance, radiant intensity or irradiance, as in `emitters.json`.
    pub color: [f32; 3],
}

impl EmitterEdit {
    /// Checks the edit without reference to a run.
    pub(super) fn check(&self) -> std::result::Result<(), String> {
        for (i, c) in self.change.iter().enumerate() {
            let name = format!("emitters.change[{i}]");
            if c.emitter.is_none() {
                return Err(format!("{name} has no \"emitter\""));
            }
            let factors = c.intensity.iter().chain(c.color.iter().flatten());
            if let Some(bad) = factors.into_iter().find(|v| !(v.is_finite() && **v >= 0.0)) {
                return Err(format!("{name} holds {bad}, but must be finite and at least 0"));
            }
            if let Some(bad) = c.by.iter().flatten().find(|v| !v.is_finite()) {
                return Err(format!("{name} holds {bad}, which is not finite"));
            }
        }
        if let Err((i, reason)) = check_openings(self.openings.as_deref().unwrap_or(&[])) {
            let name = i.map_or("emitters.openings".to_owned(), |i| format!("emitters.openings[{i}]"));
            return Err(format!("{name}: {reason}"));
        }
        self.environment.check("emitters.environment")?;
        for (i, new) in self.add.iter().enumerate() {
            let row = EmitterRow { name: "new".to_owned(), on: true, color: new.color, shape: new.shape };
            row.light().check().map_err(|e| format!("emitters.add[{i}]: {e}"))?;
        }
        Ok(())
    }
}

impl NewEmitter {
    pub(crate) fn of(row: EmitterRow) -> NewEmitter {
        NewEmitter { name: Some(row.name), shape: row.shape, color: row.color }
    }
}

/// Emitters after an edit.
pub(crate) struct EditedEmitters {
    pub file: EmitterFile,
    /// Whether each emitter is where its surface is. The surfaces of others are dark.
    pub in_place: Vec<bool>,
}

/// Applies an edit to the emitters of a run.
///
/// An environment turns the openings into windows: the emitter in an opening becomes one, and an opening without an emitter gets
/// one. Their color is 1.
///
/// # Errors
/// If the edit names an emitter that does not exist, or has an environment without openings.
pub(crate) fn edit_emitters(edit: &EmitterEdit, mut file: EmitterFile) -> Result<EditedEmitters> {
    let names: Vec<String> = file.emitters.iter().map(|e| e.name.clone()).collect();
    let find = |name: &str| {
        let all = || names.iter().map(|n| format!("\"{n}\"")).collect::<Vec<_>>().join(", ");
        let has = || if names.is_empty() { "no emitters".to_owned() } else { all() };
        names.iter().position(|n| n == name).ok_or_else(|| {
            RelightError::Edit(format!("The edit names the emitter \"{name}\", but the run has {}.", has()))
        })
    };
    if let Some(only) = &edit.only {
        let stay = only.iter().map(|name| find(name)).collect::<Result<Vec<_>>>()?;
        file.emitters.iter_mut().enumerate().filter(|(i, _)| !stay.contains(i)).for_each(|(_, e)| e.on = false);
    }
    if edit.off {
        file.emitters.iter_mut().for_each(|e| e.on = false);
    }
    if let Some(openings) = &edit.openings {
        file.openings.clone_from(openings);
    }
    let mut in_place = vec![true; file.emitters.len()];
    if edit.environment.off {
        file.emitters.iter_mut().filter(|e| is_window(e)).for_each(|e| e.on = false);
        file.environment = None;
    } else if edit.environment.file.is_some() {
        let had = file.environment.replace(SKY.to_owned()).is_some();
        if !had && file.openings.is_empty() {
            let message =
                "The edit has an environment, but the room has no openings; list them in \"emitters.openings\".";
            return Err(RelightError::Edit(message.to_owned()));
        }
        if !had {
            open_windows(&mut file);
        }
        in_place.resize(file.emitters.len(), false);
    }
    for change in &edit.change {
        let Some(name) = &change.emitter else { continue };
        let i = find(name)?;
        let emitter = &mut file.emitters[i];
        emitter.on = change.on.unwrap_or(emitter.on);
        let (by, color) = (change.intensity.unwrap_or(1.0), change.color.unwrap_or([1.0; 3]));
        emitter.color = [0, 1, 2].map(|c| emitter.color[c] * color[c] * by);
        if let Some(by) = change.by.filter(|by| *by != [0.0; 3]) {
            in_place[i] = false;
            emitter.shape = emitter.shape.translated(by);
        }
    }
    for (i, new) in edit.add.iter().enumerate() {
        let name = new.name.clone().unwrap_or_else(|| format!("new {}", i + 1));
        let name = free_name(name, |name| file.emitters.iter().any(|e| e.name == name));
        file.emitters.push(EmitterRow { name, on: true, color: new.color, shape: new.shape });
    }
    // An added emitter has no surface.
    in_place.resize(file.emitters.len(), false);
    if file.emitters.len() > MOST_EMITTERS as usize {
        let count = file.emitters.len();
        return Err(RelightError::Edit(format!("The edit leads to {count} emitters; use {MOST_EMITTERS} at most.")));
    }
    Ok(EditedEmitters { file, in_place })
}

/// Returns a name that no other emitter has: the name itself, or with a number.
pub(crate) fn free_name(name: String, taken: impl Fn(&str) -> bool) -> String {
    let others = (2..).map(|n| format!("{name} ({n})"));
    std::iter::once(name.clone()).chain(others).find(|name| !taken(name)).unwrap_or(name)
}

/// Returns whether an emitter shows the environment. Such an emitter has a part per channel, others have one.
pub(crate) fn is_window(row: &EmitterRow) -> bool {
    matches!(row.shape, LightShape::Window { .. })
}

/// Turns the openings into windows of color 1.
fn open_windows(file: &mut EmitterFile) {
    for (i, opening) in file.openings.iter().enumerate() {
        let shape = opening.window();
        match file.emitters.iter_mut().find(|e| OpeningRow::of(&e.shape) == Some(*opening)) {
            Some(row) => (row.shape, row.color, row.on) = (shape, [1.0; 3], true),
            None => {
                let name = (i + 1..).map(|k| format!("opening {k}"));
                let name = name.into_iter().find(|n| file.emitters.iter().all(|e| e.name != *n)).unwrap_or_default();
                file.emitters.push(EmitterRow { name, on: true, color: [1.0; 3], shape });
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sgs_config::TransportSettings;
    use sgs_run::EnclosureRow;

    fn file() -> EmitterFile {
        let enclosure = EnclosureRow { low: [0.0; 3], high: [1.0; 3], albedo: [[0.5; 3]; 6] };
        let row = |name: &str| EmitterRow {
            name: name.to_owned(),
            on: true,
            color: [1.0, 2.0, 3.0],
            shape: LightShape::Sphere { center: [0.5; 3], radius: 0.1 },
        };
        EmitterFile::new(enclosure, TransportSettings::default(), vec![row("window 1"), row("light 1")])
    }

    fn edited(text: &str) -> EditedEmitters {
        let edit: EmitterEdit = serde_json::from_str(text).unwrap();
        edit.check().unwrap();
        edit_emitters(&edit, file()).unwrap()
    }

    #[test]
    fn emitters_are_switched_dimmed_colored_moved_and_added() {
        let found = edited(
            r#"{"only": ["light 1"], "change": [{"emitter": "light 1", "intensity": 0.5, "color": [1, 0, 2], "by": [0, 1, 0]}],
                "add": [{"shape": {"type": "disk", "center": [0,0,0], "normal": [0,1,0], "radius": 1}, "color": [1,1,1]}]}"#,
        );
        let on: Vec<bool> = found.file.emitters.iter().map(|e| e.on).collect();
        assert_eq!((on, found.in_place), (vec![false, true, true], vec![true, false, false]));
        let light = &found.file.emitters[1];
        assert_eq!(light.color, [0.5, 0.0, 3.0]);
        assert_eq!(light.shape, LightShape::Sphere { center: [0.5, 1.5, 0.5], radius: 0.1 });
        assert_eq!(found.file.emitters[2].name, "new 1");
        found.file.check().unwrap();
        let off = edited(r#"{"off": true, "change": [{"emitter": "window 1", "on": true}]}"#);
        assert_eq!(off.file.emitters.iter().map(|e| e.on).collect::<Vec<_>>(), [true, false]);
    }

    #[test]
    fn environment_turns_openings_into_windows() {
        let pane = |x: f32| OpeningRow { corner: [x, 0.0, 0.0], edge_u: [1.0, 0.0, 0.0], edge_v: [0.0, 1.0, 0.0] };
        let mut file = file();
        let OpeningRow { corner, edge_u, edge_v } = pane(0.0);
        file.emitters[0].shape = LightShape::Rectangle { corner, edge_u, edge_v };
        let edit = |text: &str, file: EmitterFile| {
            let edit: EmitterEdit = serde_json::from_str(text).unwrap();
            edit.check().unwrap();
            edit_emitters(&edit, file)
        };
        let openings = serde_json::to_string(&[pane(0.0), pane(2.0)]).unwrap();
        let text = format!(
            r#"{{"off": true, "openings": {openings}, "environment": {{"file": "a.exr"}},
                "change": [{{"emitter": "window 1", "intensity": 0.5}}]}}"#
        );
        let found = edit(&text, file.clone()).unwrap();
        let rows: Vec<_> = found.file.emitters.iter().map(|e| (e.name.as_str(), e.on, e.color, is_window(e))).collect();
        let white = [1.0; 3];
        assert_eq!(
            rows,
            [
                ("window 1", true, [0.5; 3], true),
                ("light 1", false, [1.0, 2.0, 3.0], false),
                ("opening 2", true, white, true)
            ]
        );
        // A window without an emitter of the run has no surface.
        assert_eq!((found.in_place, found.file.environment.as_deref()), (vec![true, true, false], Some(SKY)));
        found.file.check().unwrap();
        // Windows of a run stay; `off` turns them off.
        let run = found.file;
        assert_eq!(edit(r#"{"environment": {"file": "b.exr"}}"#, run.clone()).unwrap().file, run);
        let off = edit(r#"{"environment": {"off": true}}"#, run).unwrap().file;
        assert_eq!(off.emitters.iter().map(|e| e.on).collect::<Vec<_>>(), [false; 3]);
        let error = edit(r#"{"environment": {"file": "a.exr"}}"#, file).err().unwrap().to_string();
        assert!(error.contains("the room has no openings"), "{error}");
    }

    #[test]
    fn impossible_edits_are_refused() {
        let check = |text: &str| serde_json::from_str::<EmitterEdit>(text).unwrap().check().unwrap_err();
        assert!(check(r#"{"change": [{"on": false}]}"#).contains("has no \"emitter\""));
        assert!(check(r#"{"change": [{"emitter": "a", "intensity": -1}]}"#).contains("holds -1"));
        let flat = r#"{"add": [{"shape": {"type": "sphere", "center": [0,0,0], "radius": 0}, "color": [1,1,1]}]}"#;
        assert!(check(flat).starts_with("emitters.add[0]: radius"), "{}", check(flat));
        let pane = r#"{"openings": [{"corner": [0,0,0], "edge_u": [1,0,0], "edge_v": [0,0,0]}]}"#;
        assert!(check(pane).starts_with("emitters.openings[0]: edge_v"), "{}", check(pane));
        assert!(check(r#"{"environment": {"scale": -1}}"#).starts_with("emitters.environment holds -1"));
        assert!(check(r#"{"environment": {"off": true, "scale": 1}}"#).contains("off and changed at once"));
        let edit = EmitterEdit { only: Some(vec!["sun".to_owned()]), ..Default::default() };
        let error = edit_emitters(&edit, file()).err().unwrap().to_string();
        assert_eq!(error, "The edit names the emitter \"sun\", but the run has \"window 1\", \"light 1\".");
    }
}
