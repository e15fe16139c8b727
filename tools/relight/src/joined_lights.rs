//! Lights of files that join the emitters of a run.

use super::edit::{Edit, Insert};
use super::emitters::{EmitterEdit, NewEmitter};
use crate::error::{RelightError, Result};
use glam::{DQuat, DVec3, Vec3};
use sgs_passes::transport::AreaLight;
use sgs_run::{EmitterRow, ListedLight, is_gltf, read_light_source};

impl Edit {
    /// Returns the edit of the emitters with the lights of all files.
    ///
    /// The lights of its `file` and of inserted glTF files are among the new emitters. Inserted lights are scaled, turned and
    /// moved with their scene. Learned lights with lobes stay behind: they are the light of another room.
    ///
    /// # Errors
    /// If a file cannot be read.
    pub fn all_emitters(&self) -> Result<EmitterEdit> {
        let mut all = EmitterEdit { file: None, ..self.emitters.clone() };
        if let Some(file) = &self.emitters.file {
            all.add.extend(read_light_source(file)?.emitters().into_iter().map(NewEmitter::of));
        }
        for insert in &self.insert {
            if insert.source.is_dir() || !is_gltf(&insert.source)? {
                continue;
            }
            let mut list = read_light_source(&insert.source)?;
            list.lights.retain(|light| matches!(light, ListedLight::Physical(_)));
            all.add.extend(list.emitters().into_iter().map(|row| NewEmitter::of(inserted(row, insert))));
        }
        let wrong = |reason| RelightError::Edit(format!("The edit cannot be applied: {reason}."));
        all.check().map_err(wrong)?;
        Ok(all)
    }
}

/// Places an emitter of an inserted scene. Surfaces around it receive what they received before.
fn inserted(row: EmitterRow, insert: &Insert) -> EmitterRow {
    let [w, x, y, z] = insert.rotation;
    let turn = DQuat::from_xyzw(x, y, z, w).normalize();
    let (scale, to) = (f64::from(insert.scale), DVec3::from(insert.translation.map(f64::from)));
    let turned = |v: Vec3| (turn * v.as_dvec3()).as_vec3();
    let placed = |v: Vec3| (turn * v.as_dvec3() * scale + to).as_vec3();
    let AreaLight { color, .. } = row.light().scaled(insert.scale);
    EmitterRow { shape: row.shape.transformed(insert.scale, turned, placed), color, ..row }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::emitters::edit_emitters;
    use sgs_config::TransportSettings;
    use sgs_passes::transport::LightShape;
    use sgs_run::{EmitterFile, EnclosureRow};

    #[test]
    fn lights_of_files_and_insertions_are_added() {
        let folder = tempfile::tempdir().unwrap();
        let lights = r#"{"format": "sgs-lights-2", "normalizer": 0.5, "lights": [
            {"type": "point", "name": "bulb", "position": [1,2,3], "color": [4,2,0], "gain": 0.5},
            {"type": "lobes", "position": [0,0,0], "gain": 1, "lobes": [{"axis": [0,1,0], "sharpness": 2, "amplitude": [1,1,1]}]}]}"#;
        std::fs::write(folder.path().join("lights.json"), lights).unwrap();
        let half = 0.5_f64.sqrt();
        let gltf = serde_json::json!({
            "asset": {"version": "2.0"},
            "scene": 0, "scenes": [{"nodes": [0, 1]}],
            "nodes": [
                // Turned by a quarter about x: -Z becomes +Y.
                {"name": "spot", "translation": [1, 0, 0], "rotation": [half, 0, 0, half], "extensions": {"KHR_lights_punctual": {"light": 0}}},
                {"name": "bulb", "extensions": {"KHR_lights_punctual": {"light": 1}}},
            ],
            "extensions": {"KHR_lights_punctual": {"lights": [
                {"type": "spot", "intensity": 8, "color": [1, 0.5, 0], "spot": {"outerConeAngle": 0.5}},
                {"type": "point"}
            ]}},
        });
        std::fs::write(folder.path().join("chair.gltf"), gltf.to_string()).unwrap();
        let text = format!(
            r#"{{"emitters": {{"file": "lights.json"}},
                "insert": [{{"source": "chair.gltf", "scale": 2, "rotation": [{half}, 0, 0, {half}], "translation": [0, 0, 1]}}]}}"#
        );
        let edit = Edit::parse(&text, folder.path()).unwrap();
        let all = edit.all_emitters().unwrap();
        let enclosure = EnclosureRow { low: [0.0; 3], high: [1.0; 3], albedo: [[0.5; 3]; 6] };
        let shape = LightShape::Sphere { center: [0.5; 3], radius: 0.1 };
        let row = |name: &str| EmitterRow { name: name.to_owned(), on: true, color: [1.0, 2.0, 3.0], shape };
        let file = EmitterFile::new(enclosure, TransportSettings::default(), vec![row("window 1"), row("light 1")]);
        let found = edit_emitters(&all, file).unwrap().file;
        found.check().unwrap();
        let names: Vec<&str> = found.emitters.iter().map(|e| e.name.as_str()).collect();
        assert_eq!(names, ["window 1", "light 1", "bulb", "light 1 (2)", "spot", "bulb (2)"]);
        assert_eq!(found.emitters[2].color, [2.0, 1.0, 0.0]);
        assert!(matches!(found.emitters[3].shape, LightShape::Lobe { axis: [_, -1.0, _], .. }));
        // A quarter turn about z, twice as large.
        let LightShape::Spot { position, axis, inner_angle, outer_angle } = found.emitters[4].shape else { panic!() };
        let near = |a: [f32; 3], b: [f32; 3]| Vec3::from(a).distance(Vec3::from(b)) < 1e-6;
        assert!(near(position, [0.0, 2.0, 1.0]) && near(axis, [-1.0, 0.0, 0.0]), "{position:?} {axis:?}");
        assert_eq!((inner_angle, outer_angle, found.emitters[4].color), (0.0, 0.5, [32.0, 16.0, 0.0]));
        let missing = EmitterEdit { file: Some("none.glb".into()), ..Default::default() };
        assert!(Edit { emitters: missing, ..Default::default() }.all_emitters().is_err());
    }
}
