//! Lights of all types in a file: `lights.json` of both versions.

use crate::emitters::{EmitterFile, EmitterRow};
use crate::error::{Result, RunError};
use crate::lights::{FORMAT, LightFile, LightRow, MOST};
use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use serde_json::{Map, Value};
use sgs_passes::transport::{AreaLight, LightShape};
use std::path::Path;

/// Format identifier of files with physical lights.
const TYPED: &str = "sgs-lights-2";

/// Type of a light with lobes.
const LOBES: &str = "lobes";

/// Lights of a file.
#[derive(Clone, Debug, PartialEq)]
pub struct LightList {
    /// Factor of the lights of type `lobes`.
    pub normalizer: f32,
    /// Lights of the file.
    pub lights: Vec<ListedLight>,
}

/// Light of any type.
#[derive(Clone, Debug, PartialEq)]
pub enum ListedLight {
    /// Point light with lobes.
    Lobes(LightRow),
    /// Physical light.
    Physical(PhysicalRow),
}

/// Physical light, in the units of `emitters.json`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PhysicalRow {
    /// Name of the light.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// Shape and place.
    #[serde(flatten)]
    pub shape: LightShape,
    /// Linear RGB: radiance, radiant intensity or irradiance, as in `emitters.json`.
    pub color: [f32; 3],
    /// Factor of the color; 0 is off.
    pub gain: f32,
}

/// Content of a file of version 2.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Typed {
    format: String,
    normalizer: f32,
    lights: Vec<ListedLight>,
}

impl PhysicalRow {
    /// Returns the light. A light that is off is black.
    pub fn light(&self) -> AreaLight {
        AreaLight { shape: self.shape, color: self.color.map(|c| self.gain * c) }
    }

    /// Returns whether the light shines.
    pub fn is_on(&self) -> bool {
        self.light().color != [0.0; 3]
    }

    /// Returns the name, or that of light `i` of a list.
    pub fn name_or(&self, i: usize) -> String {
        self.name.clone().unwrap_or_else(|| format!("light {i}"))
    }

    fn check(&self) -> std::result::Result<(), String> {
        if !(self.gain.is_finite() && self.gain >= 0.0) {
            return Err(format!("gain: {} must be a finite number of at least 0", self.gain));
        }
        AreaLight { shape: self.shape, color: self.color }.check().map_err(|e| e.to_string())?;
        self.light().check().map_err(|e| e.to_string())
    }
}

impl ListedLight {
    /// Returns the factor of the light; 0 is off.
    pub fn gain(&self) -> f32 {
        match self {
            ListedLight::Lobes(row) => row.gain,
            ListedLight::Physical(row) => row.gain,
        }
    }

    /// Checks values that the types do not constrain.
    ///
    /// # Errors
    /// Description of the first invalid value.
    pub fn check(&self) -> std::result::Result<(), String> {
        match self {
            ListedLight::Lobes(row) => row.check(),
            ListedLight::Physical(row) => row.check().map_err(|e| format!("holds {e}")),
        }
    }

    /// Returns the light of an object with a `type`.
    fn of(mut fields: Map<String, Value>) -> std::result::Result<ListedLight, String> {
        let names = || format!("{LOBES}, {}", LightShape::NAMES.join(", "));
        let Some(kind) = fields.get("type").cloned() else {
            return Err(format!("a light has no \"type\"; use {}", names()));
        };
        let name = kind.as_str().unwrap_or_default();
        if name != LOBES && !LightShape::NAMES.contains(&name) {
            return Err(format!("a light has the type {kind}; use {}", names()));
        }
        let failed = |e: serde_json::Error| format!("a light of the type {kind}: {e}");
        if name == LOBES {
            fields.remove("type");
            return serde_json::from_value(Value::Object(fields)).map(ListedLight::Lobes).map_err(failed);
        }
        let color = fields.remove("color").ok_or_else(|| failed(Error::missing_field("color")))?;
        let gain = fields.remove("gain").unwrap_or(Value::from(1));
        let name = fields.remove("name").map(serde_json::from_value).transpose().map_err(failed)?;
        let row = PhysicalRow {
            name,
            color: serde_json::from_value(color).map_err(failed)?,
            gain: serde_json::from_value(gain).map_err(failed)?,
            shape: serde_json::from_value(Value::Object(fields)).map_err(failed)?,
        };
        Ok(ListedLight::Physical(row))
    }
}

impl<'de> Deserialize<'de> for ListedLight {
    fn deserialize<D: Deserializer<'de>>(from: D) -> std::result::Result<ListedLight, D::Error> {
        ListedLight::of(Map::deserialize(from)?).map_err(D::Error::custom)
    }
}

impl Serialize for ListedLight {
    fn serialize<S: Serializer>(&self, to: S) -> std::result::Result<S::Ok, S::Error> {
        #[derive(Serialize)]
        struct Lobes<'a> {
            r#type: &'static str,
            #[serde(flatten)]
            row: &'a LightRow,
        }
        match self {
            ListedLight::Lobes(row) => Lobes { r#type: LOBES, row }.serialize(to),
            ListedLight::Physical(row) => row.serialize(to),
        }
    }
}

impl LightList {
    /// Names the physical lights that are off, and those that a format cannot hold.
    pub(crate) fn left_out(&self, holds: impl Fn(usize, &PhysicalRow) -> bool) -> Vec<String> {
        let name = |(i, light): (usize, &ListedLight)| {
            let ListedLight::Physical(row) = light else { return None };
            let name = format!("{} \"{}\"", row.shape.name(), row.name_or(i));
            match row.is_on() {
                false => Some(format!("{name}, which is off")),
                true => (!holds(i, row)).then_some(name),
            }
        };
        self.lights.iter().enumerate().filter_map(name).collect()
    }

    /// Returns the version of the file that holds the lights.
    pub fn format(&self) -> &'static str {
        let typed = self.lights.iter().any(|light| matches!(light, ListedLight::Physical(_)));
        if typed { TYPED } else { FORMAT }
    }

    /// Checks values that the types do not constrain.
    ///
    /// # Errors
    /// Description of the first invalid value.
    pub fn check(&self) -> std::result::Result<(), String> {
        if self.lights.len() > MOST {
            return Err(format!("there are {} lights, more than {MOST}", self.lights.len()));
        }
        self.with_lobes().check()?;
        self.lights.iter().enumerate().try_for_each(|(i, light)| light.check().map_err(|e| format!("light {i} {e}")))
    }

    /// Returns the lights with lobes. Physical lights have none.
    fn with_lobes(&self) -> LightFile {
        let row = |light: &ListedLight| match light {
            ListedLight::Lobes(row) => row.clone(),
            ListedLight::Physical(_) => LightRow { position: [0.0; 3], gain: 0.0, lobes: Vec::new() },
        };
        LightFile::new(self.normalizer, self.lights.iter().map(row).collect())
    }
}

impl LightList {
    /// Returns the emitters of a run as lights. Emitters that are off have a gain of 0.
    pub fn of_emitters(file: &EmitterFile) -> LightList {
        let row = |e: &EmitterRow| PhysicalRow {
            name: Some(e.name.clone()),
            shape: e.shape,
            color: e.color,
            gain: f32::from(u8::from(e.on)),
        };
        LightList { normalizer: 1.0, lights: file.emitters.iter().map(row).map(ListedLight::Physical).collect() }
    }

    /// Returns the lights as emitters: a light with lobes is one per lobe. Lights that are off are left out.
    ///
    /// Names are those of the lights, and not unique.
    pub fn emitters(&self) -> Vec<EmitterRow> {
        let mut rows = Vec::new();
        for (i, light) in self.lights.iter().enumerate() {
            match light {
                ListedLight::Physical(row) => {
                    let AreaLight { shape, color } = row.light();
                    rows.push(EmitterRow { name: row.name_or(i), on: true, color, shape });
                }
                ListedLight::Lobes(LightRow { position, gain, lobes }) => rows.extend(lobes.iter().map(|lobe| {
                    // Axes of lobes point to the light, those of emitters follow it.
                    let axis = lobe.axis.map(|x| -x);
                    let shape = LightShape::Lobe { position: *position, axis, sharpness: lobe.sharpness };
                    let color = lobe.amplitude.map(|a| self.normalizer * gain * a);
                    EmitterRow { name: format!("light {i}"), on: true, color, shape }
                })),
            }
        }
        rows.retain(|row| row.color != [0.0; 3]);
        rows
    }
}

impl From<LightFile> for LightList {
    fn from(file: LightFile) -> LightList {
        LightList { normalizer: file.normalizer, lights: file.lights.into_iter().map(ListedLight::Lobes).collect() }
    }
}

/// Reads the lights of `lights.json`, of version 1 or 2.
///
/// # Errors
/// If the file is missing, damaged or of another version.
pub fn read_light_list(path: &Path) -> Result<LightList> {
    let fail = |reason: String| RunError::file(path, reason);
    let text = std::fs::read_to_string(path).map_err(|e| fail(e.to_string()))?;
    let list = parsed(&text).map_err(fail)?;
    list.check().map_err(fail)?;
    Ok(list)
}

/// Returns whether a text is that of `lights.json`, of any version.
pub(crate) fn has_format(text: &str) -> bool {
    serde_json::from_str::<Head>(text).is_ok()
}

/// First field of a file of lights.
#[derive(Deserialize)]
struct Head {
    format: String,
}

fn parsed(text: &str) -> std::result::Result<LightList, String> {
    let fail = |e: serde_json::Error| format!("not lights: {e}");
    let Head { format } = serde_json::from_str(text).map_err(fail)?;
    match format.as_str() {
        FORMAT => serde_json::from_str::<LightFile>(text).map(LightList::from).map_err(fail),
        TYPED => {
            let Typed { normalizer, lights, .. } = serde_json::from_str(text).map_err(fail)?;
            Ok(LightList { normalizer, lights })
        }
        _ => Err(format!("its format is \"{format}\", which is neither \"{FORMAT}\" nor \"{TYPED}\"")),
    }
}

/// Writes `lights.json`: version 1 if all lights have lobes, else version 2.
///
/// # Errors
/// If the file cannot be written.
pub fn write_light_list(path: &Path, list: &LightList) -> Result<()> {
    if list.format() == FORMAT {
        return crate::lights::write_lights(path, &list.with_lobes());
    }
    let LightList { normalizer, lights } = list.clone();
    let text = serde_json::to_string_pretty(&Typed { format: TYPED.to_owned(), normalizer, lights })
        .map_err(|e| RunError::file(path, e.to_string()))?;
    sgs_scene::atomic_write(path, |f| std::io::Write::write_all(f, text.as_bytes()))?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lights::LobeRow;

    fn lobes() -> ListedLight {
        let lobe = LobeRow { axis: [0.0, 0.0, 1.0], sharpness: 2.5, amplitude: [1.0, 0.5, 0.25] };
        ListedLight::Lobes(LightRow { position: [1.0, 2.0, 3.0], gain: 0.5, lobes: vec![lobe; 2] })
    }

    fn physical(shape: LightShape) -> ListedLight {
        ListedLight::Physical(PhysicalRow { name: None, shape, color: [3.0, 2.0, 1.0], gain: 0.5 })
    }

    fn all() -> LightList {
        let (position, axis, center) = ([0.5; 3], [0.0, -1.0, 0.0], [1.0, 2.0, 3.0]);
        let lights = vec![
            lobes(),
            physical(LightShape::Point { position }),
            physical(LightShape::Sphere { center, radius: 0.1 }),
            physical(LightShape::Rectangle { corner: center, edge_u: [1.0, 0.0, 0.0], edge_v: [0.0, 1.0, 0.0] }),
            physical(LightShape::Disk { center, normal: axis, radius: 0.1 }),
            physical(LightShape::Spot { position, axis, inner_angle: 0.2, outer_angle: 0.5 }),
            physical(LightShape::Directional { direction: axis, angular_radius: 0.005 }),
            physical(LightShape::Lobe { position, axis, sharpness: 4.0 }),
        ];
        LightList { normalizer: 0.25, lights }
    }

    #[test]
    fn lists_come_back_in_the_version_that_holds_them() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("lights.json");
        for (list, format) in [
            (all(), TYPED),
            (LightList { normalizer: 0.25, lights: vec![lobes(); 3] }, FORMAT),
            (LightList { normalizer: 1.0, lights: Vec::new() }, FORMAT),
        ] {
            write_light_list(&path, &list).unwrap();
            assert_eq!(read_light_list(&path).unwrap(), list);
            let text = std::fs::read_to_string(&path).unwrap();
            assert!(text.contains(&format!("\"format\": \"{format}\"")), "{text}");
            assert_eq!(text.contains("\"type\""), format == TYPED);
        }
    }

    #[test]
    fn lights_become_emitters_with_turned_axes() {
        let emitters = all().emitters();
        assert_eq!(emitters.len(), 9);
        // Normalizer 0.25, gain 0.5.
        let lobe = LightShape::Lobe { position: [1.0, 2.0, 3.0], axis: [-0.0, -0.0, -1.0], sharpness: 2.5 };
        assert_eq!((emitters[1].shape, emitters[1].color), (lobe, [0.125, 0.0625, 0.03125]));
        assert_eq!((emitters[3].shape.name(), emitters[3].color), ("sphere", [1.5, 1.0, 0.5]));
        let dark = LightList { normalizer: 0.0, ..all() };
        assert_eq!(dark.emitters().len(), 7);
    }

    #[test]
    fn errors_name_version_type_and_field() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("lights.json");
        let error = |lights: &str, format: &str| {
            std::fs::write(&path, format!(r#"{{"format": "{format}", "normalizer": 1, "lights": [{lights}]}}"#))
                .unwrap();
            read_light_list(&path).unwrap_err().to_string()
        };
        let neither = error("", "sgs-lights-3");
        assert!(
            neither.contains(r#"its format is "sgs-lights-3", which is neither "sgs-lights-1" nor "sgs-lights-2""#),
            "{neither}"
        );
        let typed = |light: &str| error(light, TYPED);
        let cube = typed(r#"{"type": "cube", "color": [1, 1, 1]}"#);
        let names = "use lobes, point, sphere, rectangle, disk, spot, directional, lobe";
        assert!(cube.contains(&format!("a light has the type \"cube\"; {names}")), "{cube}");
        assert!(
            typed(r#"{"position": [0, 0, 0], "gain": 1, "lobes": []}"#).contains("has no \"type\"; use lobes, point")
        );
        let point = r#""type": "point", "position": [0, 0, 0]"#;
        for (light, words) in [
            (format!("{{{point}}}"), "a light of the type \"point\": missing field `color`"),
            (format!(r#"{{{point}, "color": [1, 1, 1], "glow": 1}}"#), "unknown field `glow`"),
            (format!(r#"{{{point}, "color": [1, 1, 1], "gain": -1}}"#), "light 0 holds gain: -1"),
            (format!(r#"{{{point}, "color": [1, -1, 1]}}"#), "light 0 holds color: -1 is negative"),
            (format!(r#"{{{point}, "color": [1e30, 1, 1], "gain": 1e30}}"#), "light 0 holds color: inf is not finite"),
            (
                r#"{"type": "sphere", "center": [0, 0, 0], "radius": 0, "color": [1, 1, 1]}"#.into(),
                "light 0 holds radius",
            ),
            (r#"{"type": "lobes", "position": [0, 0, 0], "lobes": []}"#.into(), "missing field `gain`"),
            (
                r#"{"type": "lobes", "position": [0, 0, 0], "gain": 1, "color": [1, 1, 1], "lobes": []}"#.into(),
                "unknown field `color`",
            ),
        ] {
            let found = typed(&light);
            assert!(found.contains(words), "{light}: {found}");
        }
        assert!(
            error(r#"{"type": "lobes", "position": [0, 0, 0], "gain": 1, "lobes": []}"#, FORMAT).contains("`type`")
        );
    }
}
