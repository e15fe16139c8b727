//! Emitters whose shapes and places a scene names: `SCENE/emitters.json`.
//!
//! The file has the form of a run's `emitters.json`, so that one can be copied and edited. Colors and the albedo of the
//! enclosure are fitted.

use crate::emitters::{EmitterRow, FORMAT, OpeningRow, check_openings, check_rows};
use serde::Deserialize;
use serde::de::IgnoredAny;
use sgs_passes::transport::LightShape;
use sgs_scene::{Scene, SceneError, read_json};
use std::path::{Path, PathBuf};

/// Maximum number of known emitters that shine.
pub const MOST_KNOWN: usize = 64;

/// Emitters of a scene whose shapes and places are known.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct KnownEmitters {
    /// Emitters that shine, at least one and at most [`MOST_KNOWN`]. Their colors are those of the file, else 1; the fit
    /// replaces them.
    pub emitters: Vec<EmitterRow>,
    /// Rectangles through which light from outside enters.
    pub openings: Vec<OpeningRow>,
}

/// Content of the file.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct KnownFile {
    format: String,
    emitters: Vec<KnownRow>,
    #[serde(default)]
    openings: Vec<OpeningRow>,
    // Values of a run. The stage finds its own.
    #[serde(default, rename = "enclosure")]
    _enclosure: IgnoredAny,
    #[serde(default, rename = "surfels")]
    _surfels: IgnoredAny,
    #[serde(default, rename = "rays")]
    _rays: IgnoredAny,
    #[serde(default, rename = "without")]
    _without: IgnoredAny,
    #[serde(default, rename = "environment")]
    _environment: IgnoredAny,
}

/// Emitter of the file.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct KnownRow {
    name: String,
    #[serde(default = "shines")]
    on: bool,
    #[serde(default = "white")]
    color: [f32; 3],
    shape: LightShape,
}

fn shines() -> bool {
    true
}

fn white() -> [f32; 3] {
    [1.0; 3]
}

impl KnownEmitters {
    /// Returns the path of the file in a scene directory.
    pub fn path(scene: &Scene) -> PathBuf {
        scene.root.join("emitters.json")
    }

    /// Reads the known emitters of a scene, if it names any.
    ///
    /// # Errors
    /// If the file cannot be read, is damaged, or names emitters that cannot be fitted.
    pub fn of_scene(scene: &Scene) -> Result<Option<KnownEmitters>, SceneError> {
        let path = KnownEmitters::path(scene);
        match std::fs::symlink_metadata(&path) {
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => Ok(None),
            _ => KnownEmitters::read(&path).map(Some),
        }
    }

    /// Reads a file of known emitters.
    ///
    /// # Errors
    /// If the file cannot be read, is damaged, or names emitters that cannot be fitted.
    pub fn read(path: &Path) -> Result<KnownEmitters, SceneError> {
        let file: KnownFile = read_json(path)?;
        file.known().map_err(|problem| SceneError::Emitters { path: path.to_owned(), problem })
    }
}

impl KnownFile {
    /// Checks the file, and returns the emitters that shine.
    fn known(self) -> Result<KnownEmitters, String> {
        if self.format != FORMAT {
            return Err(format!("its format is \"{}\", not \"{FORMAT}\"", self.format));
        }
        let row = |KnownRow { name, on, color, shape }| EmitterRow { name, on, color, shape };
        let mut emitters: Vec<EmitterRow> = self.emitters.into_iter().map(row).collect();
        check_rows(&emitters)?;
        check_openings(&self.openings).map_err(|(i, reason)| match i {
            Some(i) => format!("opening {i}: {reason}"),
            None => reason,
        })?;
        emitters.retain(|e| e.on);
        if emitters.is_empty() {
            return Err("no emitter is on; name those that lit the photographs, or remove the file".to_owned());
        }
        if emitters.len() > MOST_KNOWN {
            return Err(format!("{} emitters are on; use {MOST_KNOWN} at most", emitters.len()));
        }
        for EmitterRow { name, shape, .. } in &emitters {
            match shape {
                LightShape::Window { .. } => {
                    return Err(format!(
                        "emitter \"{name}\" is a window, whose map cannot be fitted; use a rectangle instead"
                    ));
                }
                LightShape::Directional { .. } if self.openings.is_empty() => {
                    return Err(format!(
                        "emitter \"{name}\" is directional, but its light can enter nowhere; name the windows as \"openings\""
                    ));
                }
                _ => {}
            }
        }
        Ok(KnownEmitters { emitters, openings: self.openings })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PANE: &str = r#"{"corner": [0, 0, 0], "edge_u": [1, 0, 0], "edge_v": [0, 1, 0]}"#;

    fn read(emitters: &str, more: &str) -> Result<KnownEmitters, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("emitters.json");
        std::fs::write(&path, format!(r#"{{"format": "{FORMAT}", "emitters": [{emitters}]{more}}}"#)).unwrap();
        KnownEmitters::read(&path).map_err(|e| e.to_string())
    }

    fn row(name: &str, more: &str, shape: &str) -> String {
        format!(r#"{{"name": "{name}", {more} "shape": {shape}}}"#)
    }

    #[test]
    fn colors_and_values_of_a_run_are_optional() {
        let bulb = r#"{"type": "sphere", "center": [1, 2, 3], "radius": 0.1}"#;
        let rows =
            [row("bulb", "", bulb), row("off", r#""on": false,"#, bulb), row("red", r#""color": [9, 0, 0],"#, bulb)];
        let short = read(&rows.join(","), "").unwrap();
        let colors: Vec<_> = short.emitters.iter().map(|e| (e.name.as_str(), e.color)).collect();
        assert_eq!(colors, [("bulb", [1.0; 3]), ("red", [9.0, 0.0, 0.0])], "an emitter that is off is left out");
        let of_run = r#", "enclosure": {"low": [0, 0, 0]}, "surfels": 8192, "rays": 64, "without": "bounces", "environment": "sky.exr""#;
        assert_eq!(read(&rows.join(","), of_run).unwrap(), short);
        assert_eq!(read(&rows.join(","), &format!(r#", "openings": [{PANE}]"#)).unwrap().openings.len(), 1);
    }

    #[test]
    fn wrong_files_are_refused_with_a_reason() {
        let point = r#"{"type": "point", "position": [0, 0, 0]}"#;
        let refused = |emitters: &str, more: &str, reason: &str| {
            let error = read(emitters, more).unwrap_err();
            assert!(error.contains(reason) && error.contains("emitters.json"), "{error}");
        };
        let window = format!(r#"{{"type": "window", {}"#, &PANE[1..]);
        let sun = r#"{"type": "directional", "direction": [0, -1, 0], "angular_radius": 0.27}"#;
        refused("", "", "no emitter is on");
        refused(&row("a", r#""on": false,"#, point), "", "no emitter is on");
        refused(&row("pane", "", &window), "", "\"pane\" is a window");
        refused(&row("sun", "", sun), "", "\"openings\"");
        assert!(read(&row("sun", "", sun), &format!(r#", "openings": [{PANE}]"#)).is_ok());
        refused(&[row("a", "", point), row("a", "", point)].join(","), "", "different names");
        refused(&row("a", r#""color": [-1, 0, 0],"#, point), "", "\"a\"");
        refused(&row("a", r#""colour": 1,"#, point), "", "colour");
        refused(&row("a", "", point), r#", "panels": 1"#, "panels");
        refused(
            &row("a", "", point),
            r#", "openings": [{"corner": [0, 0, 0], "edge_u": [0, 0, 0], "edge_v": [0, 1, 0]}]"#,
            "opening 0",
        );
        let many: Vec<String> = (0..=MOST_KNOWN).map(|i| row(&i.to_string(), "", point)).collect();
        refused(&many.join(","), "", "65 emitters are on; use 64");
        assert!(read(&many[1..].join(","), "").is_ok());
    }
}
