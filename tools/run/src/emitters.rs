//! Emitters of a run: `emitters.json`.
//!
//! The transport stage finds surfaces that shine, and fits their radiance and the albedo of the enclosure. Lengths are in
//! the scene's unit, angles in degrees.

use crate::error::{Result, RunError};
use serde::{Deserialize, Serialize};
use sgs_config::{TransportPart, TransportSettings};
use sgs_passes::transport::{AreaLight, LightShape, Opening, Sky};
use sgs_scene::{MOST_EMITTERS, Unit};
use std::collections::BTreeSet;
use std::path::Path;

/// Maximum number of openings of a file.
pub const MOST_OPENINGS: usize = 256;
/// Usual name of the map of the environment that windows show.
pub const SKY: &str = "sky.exr";
/// Format identifier of the file.
pub(crate) const FORMAT: &str = "sgs-emitters-1";

/// Content of `emitters.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EmitterFile {
    /// Format identifier: `sgs-emitters-1`.
    pub format: String,
    /// Box around the room. It reflects light where no surface was seen.
    pub enclosure: EnclosureRow,
    /// Number of surfels at most.
    pub surfels: u32,
    /// Rays per surfel.
    pub rays: u32,
    /// Part of the model that the run leaves out, if any.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub without: Option<TransportPart>,
    /// Emitters of the file, at most [`MOST_EMITTERS`].
    pub emitters: Vec<EmitterRow>,
    /// Rectangles through which light from outside enters, at most [`MOST_OPENINGS`].
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub openings: Vec<OpeningRow>,
    /// Name of the latitude-longitude map that windows show, beside the file: [`SKY`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub environment: Option<String>,
}

/// Rectangle through which light from outside enters.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OpeningRow {
    /// Corner where both edges begin.
    pub corner: [f32; 3],
    /// First edge.
    pub edge_u: [f32; 3],
    /// Second edge, perpendicular to the first. `edge_u` x `edge_v` points into the room.
    pub edge_v: [f32; 3],
}

impl From<OpeningRow> for Opening {
    fn from(row: OpeningRow) -> Opening {
        Opening { corner: row.corner, edge_u: row.edge_u, edge_v: row.edge_v }
    }
}

impl OpeningRow {
    /// Returns the rectangle of a shape, if it is one.
    pub fn of(shape: &LightShape) -> Option<OpeningRow> {
        match *shape {
            LightShape::Rectangle { corner, edge_u, edge_v } => Some(OpeningRow { corner, edge_u, edge_v }),
            _ => None,
        }
    }

    /// Returns the window onto the environment in this opening.
    pub fn window(&self) -> LightShape {
        let OpeningRow { corner, edge_u, edge_v } = *self;
        LightShape::Window { corner, edge_u, edge_v }
    }

    /// Checks values that the types do not constrain.
    ///
    /// # Errors
    /// Description of the first invalid value.
    pub fn check(&self) -> std::result::Result<(), String> {
        Opening::from(*self).check().map_err(|e| e.to_string())
    }
}

/// Box around a room.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EnclosureRow {
    /// Corner of the smallest coordinates.
    pub low: [f32; 3],
    /// Corner of the largest coordinates.
    pub high: [f32; 3],
    /// Linear albedo of the faces: -x, +x, -y, +y, -z, +z. From 0 to 1.
    pub albedo: [[f32; 3]; 6],
}

/// Light of one shape and color.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EmitterRow {
    /// Name, unique in the file.
    pub name: String,
    /// Whether the emitter shines.
    pub on: bool,
    /// Linear RGB: radiance of spheres, rectangles and disks, radiant intensity of points, spots and lobes, irradiance at
    /// normal incidence of directional lights, factor on the environment of windows.
    pub color: [f32; 3],
    /// Shape and place.
    pub shape: LightShape,
}

impl EmitterRow {
    /// Returns the light, also if it is off.
    pub fn light(&self) -> AreaLight {
        AreaLight { shape: self.shape, color: self.color }
    }

    /// Converts lengths to another unit; irradiance is unchanged.
    fn convert(&mut self, unit: Unit) {
        let AreaLight { shape, color } = self.light().scaled((1.0 / unit.length()) as f32);
        (self.shape, self.color) = (shape, color);
    }
}

impl EmitterFile {
    /// Creates a file of some emitters, without openings.
    pub fn new(enclosure: EnclosureRow, settings: TransportSettings, emitters: Vec<EmitterRow>) -> EmitterFile {
        let TransportSettings { surfels, rays, without, .. } = settings;
        EmitterFile {
            format: FORMAT.to_owned(),
            enclosure,
            surfels,
            rays,
            without,
            emitters,
            openings: Vec::new(),
            environment: None,
        }
    }

    /// Returns the same emitters and enclosure with lengths in another unit.
    #[must_use]
    pub fn in_unit(&self, unit: Unit) -> EmitterFile {
        let mut file = self.clone();
        file.enclosure.low = unit.place(file.enclosure.low);
        file.enclosure.high = unit.place(file.enclosure.high);
        file.emitters.iter_mut().for_each(|emitter| emitter.convert(unit));
        for opening in &mut file.openings {
            let to = |v| unit.place(v);
            *opening =
                OpeningRow { corner: to(opening.corner), edge_u: to(opening.edge_u), edge_v: to(opening.edge_v) };
        }
        file
    }

    /// Returns the light of each emitter. Emitters that are off are black.
    pub fn lights(&self) -> Vec<AreaLight> {
        let light = |e: &EmitterRow| match e.on {
            true => e.light(),
            false => AreaLight { color: [0.0; 3], ..e.light() },
        };
        self.emitters.iter().map(light).collect()
    }

    /// Checks values that the types do not constrain.
    ///
    /// # Errors
    /// Description of the first invalid value.
    pub fn check(&self) -> std::result::Result<(), String> {
        if self.format != FORMAT {
            return Err(format!("its format is \"{}\", not \"{FORMAT}\"", self.format));
        }
        self.enclosure.check()?;
        let settings = TransportSettings { surfels: self.surfels, rays: self.rays, ..TransportSettings::default() };
        settings.check().map_err(|e| e.to_string().trim_end_matches('.').to_owned())?;
        if !settings.enabled() {
            return Err("the number of surfels is 0; use 64 at least".to_owned());
        }
        if self.emitters.len() > MOST_EMITTERS as usize {
            return Err(format!("there are {} emitters; use {MOST_EMITTERS} at most", self.emitters.len()));
        }
        check_openings(&self.openings).map_err(|(i, reason)| match i {
            Some(i) => format!("opening {i}: {reason}"),
            None => reason,
        })?;
        if let Some(name) = &self.environment
            && (name.is_empty() || name.contains(['/', '\\', ':', '\0']) || name == "." || name == "..")
        {
            return Err(format!("the environment \"{name}\" is no file beside it; use a file name, such as \"{SKY}\""));
        }
        check_rows(&self.emitters)
    }
}

/// Checks names and lights of emitters.
///
/// # Errors
/// Description of the first invalid value.
pub(crate) fn check_rows(emitters: &[EmitterRow]) -> std::result::Result<(), String> {
    let mut names = BTreeSet::new();
    for (i, emitter) in emitters.iter().enumerate() {
        let name = &emitter.name;
        if name.trim().is_empty() {
            return Err(format!("emitter {i} has no name"));
        }
        if !names.insert(name) {
            return Err(format!("two emitters have the name \"{name}\"; use different names"));
        }
        emitter.light().check().map_err(|e| format!("emitter {i}, \"{name}\": {e}"))?;
    }
    Ok(())
}

/// Checks a list of openings.
///
/// # Errors
/// Description of the first invalid value, and the index of its opening.
pub fn check_openings(openings: &[OpeningRow]) -> std::result::Result<(), (Option<usize>, String)> {
    if openings.len() > MOST_OPENINGS {
        return Err((None, format!("there are {} openings; use {MOST_OPENINGS} at most", openings.len())));
    }
    openings.iter().enumerate().try_for_each(|(i, o)| o.check().map_err(|e| (Some(i), e)))
}

/// Reads the environment outside of a room: a linear latitude-longitude image.
///
/// # Errors
/// If the file cannot be read or is not an environment map.
pub fn read_sky(path: &Path) -> Result<Sky> {
    let image = sgs_scene::read_environment(path)?;
    Sky::new(&image.data, [image.width, image.height])
        .ok_or_else(|| RunError::file(path, "an environment needs finite radiances of at least 0".to_owned()))
}

impl EnclosureRow {
    fn check(&self) -> std::result::Result<(), String> {
        for (axis, (low, high)) in ["x", "y", "z"].into_iter().zip(self.low.into_iter().zip(self.high)) {
            if !(low < high && (high - low).is_finite()) {
                return Err(format!(
                    "the enclosure spans {low} to {high} along {axis}; use finite numbers, low below high"
                ));
            }
        }
        match self.albedo.as_flattened().iter().find(|a| !(0.0..=1.0).contains(*a)) {
            Some(bad) => Err(format!("the enclosure has the albedo {bad}; use 0 to 1")),
            None => Ok(()),
        }
    }
}

/// Writes `emitters.json`.
///
/// # Errors
/// If the file cannot be written.
pub fn write_emitters(path: &Path, emitters: &EmitterFile) -> Result<()> {
    let text = serde_json::to_string_pretty(emitters).map_err(|e| RunError::file(path, e.to_string()))?;
    sgs_scene::atomic_write(path, |f| std::io::Write::write_all(f, text.as_bytes()))?;
    Ok(())
}

/// Reads `emitters.json`.
///
/// # Errors
/// If the file is missing or damaged.
pub fn read_emitters(path: &Path) -> Result<EmitterFile> {
    let text = std::fs::read_to_string(path).map_err(|e| RunError::file(path, e.to_string()))?;
    let emitters: EmitterFile =
        serde_json::from_str(&text).map_err(|e| RunError::file(path, format!("not emitters: {e}")))?;
    emitters.check().map_err(|reason| RunError::file(path, reason))?;
    Ok(emitters)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f32::consts::{FRAC_PI_2, FRAC_PI_6};

    const PANE: OpeningRow = OpeningRow { corner: [4.0; 3], edge_u: [2.0, 0.0, 0.0], edge_v: [0.0, 4.0, 0.0] };

    fn file() -> EmitterFile {
        let shapes = [
            LightShape::Point { position: [1.0, 2.0, 3.0] },
            LightShape::Sphere { center: [1.0, 2.0, 3.0], radius: 0.5 },
            LightShape::Rectangle { corner: [0.0; 3], edge_u: [2.0, 0.0, 0.0], edge_v: [0.0, 1.0, 0.0] },
            LightShape::Disk { center: [0.0; 3], normal: [0.0, 0.0, 2.0], radius: 1.0 },
            LightShape::Spot {
                position: [0.0; 3],
                axis: [0.0, 0.0, -1.0],
                inner_angle: FRAC_PI_6,
                outer_angle: FRAC_PI_2,
            },
            LightShape::Directional { direction: [0.0, -1.0, 0.0], angular_radius: 0.0047 },
            LightShape::Lobe { position: [1.0, 2.0, 3.0], axis: [0.0, 0.0, -2.0], sharpness: 9.5 },
            PANE.window(),
        ];
        let row = |(i, shape)| EmitterRow { name: format!("e{i}"), on: i != 1, color: [1.0, 2.0, 0.5], shape };
        let enclosure = EnclosureRow { low: [-1.0, -2.0, -3.0], high: [4.0, 5.0, 6.0], albedo: [[0.5; 3]; 6] };
        let rows = shapes.into_iter().enumerate().map(row).collect();
        let file = EmitterFile::new(enclosure, TransportSettings::default(), rows);
        EmitterFile { openings: vec![PANE], environment: Some(SKY.to_owned()), ..file }
    }

    #[test]
    fn every_shape_comes_back_from_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("emitters.json");
        write_emitters(&path, &file()).unwrap();
        assert_eq!(read_emitters(&path).unwrap(), file());
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(text.contains("\"type\": \"rectangle\"") && text.contains("\"outer_angle\": 90.0"), "{text}");
        let refused = |from: &str, to: &str| {
            assert!(text.contains(from), "{from}");
            std::fs::write(&path, text.replacen(from, to, 1)).unwrap();
            read_emitters(&path).unwrap_err().to_string()
        };
        assert!(refused("\"radius\"", "\"glow\": 1, \"radius\"").contains("glow"), "fields of shapes are checked");
        assert!(refused("\"on\"", "\"off\"").contains("off"));
        assert!(refused("\"point\"", "\"cube\"").contains("cube"));
        let mut plain = serde_json::to_value(file()).unwrap();
        plain.as_object_mut().unwrap().retain(|key, _| key != "openings" && key != "environment");
        std::fs::write(&path, plain.to_string()).unwrap();
        assert_eq!(read_emitters(&path).unwrap(), EmitterFile { openings: vec![], environment: None, ..file() });
        assert!(refused("sgs-emitters-1", "sgs-emitters-2").contains("not \"sgs-emitters-1\""));
    }

    #[test]
    fn angles_have_short_degrees_and_come_back() {
        let sun = |angular_radius| LightShape::Directional { direction: [0.0, -1.0, 0.0], angular_radius };
        for (radians, text) in
            [(FRAC_PI_6, "30.0"), (FRAC_PI_2, "90.0"), (0.27_f64.to_radians() as f32, "0.27"), (0.0, "0.0")]
        {
            let json = serde_json::to_string(&sun(radians)).unwrap();
            assert!(json.ends_with(&format!("\"angular_radius\":{text}}}")), "{json}");
        }
        for i in 0..2000 {
            let angle = 1.57 * (i as f32 / 2000.0).powi(3);
            let json = serde_json::to_string(&sun(angle)).unwrap();
            assert_eq!(serde_json::from_str::<LightShape>(&json).unwrap(), sun(angle));
        }
    }

    #[test]
    fn shapes_have_their_names_in_files() {
        for row in file().emitters {
            assert_eq!(serde_json::to_value(row.shape).unwrap()["type"], row.shape.name());
        }
    }

    #[test]
    fn lights_are_black_when_off() {
        let lights = file().lights();
        assert_eq!((lights.len(), lights[0].color, lights[1].color), (8, [1.0, 2.0, 0.5], [0.0; 3]));
        for (light, row) in lights.iter().zip(file().emitters) {
            assert_eq!(light.check(), Ok(()));
            assert_eq!(light.shape, row.shape);
        }
    }

    #[test]
    fn units_convert_as_lights_do() {
        let unit = Unit::of_length(4.0);
        let converted = file().in_unit(unit);
        assert_eq!((converted.enclosure.low, converted.enclosure.high), ([-0.25, -0.5, -0.75], [1.0, 1.25, 1.5]));
        assert_eq!(
            converted.openings[0],
            OpeningRow { corner: [1.0; 3], edge_u: [0.5, 0.0, 0.0], edge_v: [0.0, 1.0, 0.0] }
        );
        for (a, b) in converted.lights().iter().zip(file().lights()) {
            assert_eq!(*a, b.scaled(0.25));
        }
        assert_eq!(converted.in_unit(unit.inverse()), file());
    }

    #[test]
    fn invalid_values_are_named() {
        let refused = |change: &dyn Fn(&mut EmitterFile)| {
            let mut file = file();
            change(&mut file);
            file.check().unwrap_err()
        };
        assert_eq!(file().check(), Ok(()));
        assert_eq!(EmitterFile { emitters: Vec::new(), ..file() }.check(), Ok(()));
        assert!(refused(&|f| f.enclosure.low[1] = 5.0).contains("spans 5 to 5 along y"));
        assert!(refused(&|f| f.enclosure.high[2] = f32::NAN).contains("along z"));
        let wide = refused(&|f| (f.enclosure.low[0], f.enclosure.high[0]) = (-3e38, 3e38));
        assert!(wide.contains("along x"), "{wide}");
        assert!(refused(&|f| f.enclosure.albedo[3][1] = 1.5).contains("albedo 1.5; use 0 to 1"));
        assert!(refused(&|f| f.enclosure.albedo[0][0] = f32::NAN).contains("albedo NaN"));
        assert_eq!(refused(&|f| f.surfels = 1), "transport.surfels is 1, but must be 0 or 64 to 65536");
        assert!(refused(&|f| f.rays = 0).contains("transport.rays is 0"));
        assert_eq!(refused(&|f| f.emitters[2].name = " ".into()), "emitter 2 has no name");
        assert!(refused(&|f| f.emitters[2].name = "e0".into()).contains("two emitters have the name \"e0\""));
        let error = refused(&|f| f.emitters[1].shape = LightShape::Sphere { center: [0.0; 3], radius: -1.0 });
        assert!(error.starts_with("emitter 1, \"e1\": radius: length -1"), "{error}");
        assert!(refused(&|f| f.emitters[0].color[0] = -1.0).contains("emitter 0, \"e0\": color"));
        assert_eq!(refused(&|f| f.openings = vec![PANE; 257]), "there are 257 openings; use 256 at most");
        assert!(refused(&|f| f.openings[0].edge_v = [0.0; 3]).starts_with("opening 0: edge_v: length 0 is"));
        assert!(refused(&|f| f.environment = Some("../sky.exr".into())).contains("is no file beside it"));
        let many = |f: &mut EmitterFile| {
            let row = f.emitters[0].clone();
            f.emitters = (0..4097).map(|i| EmitterRow { name: i.to_string(), ..row.clone() }).collect();
        };
        assert_eq!(refused(&many), "there are 4097 emitters; use 4096 at most");
    }
}
