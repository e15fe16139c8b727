//! Lights of glTF files (`KHR_lights_punctual`).
//!
//! Points, spots and directional lights are the extension's own. A sphere and lights with lobes are points of their mean
//! intensity. Rectangles and disks have no counterpart. The `extras` of a light hold what its counterpart lacks.

use crate::error::{Result, RunError};
use crate::light_list::{LightList, ListedLight, PhysicalRow, has_format, read_light_list};
use crate::lights::{FORMAT, LightRow, LobeRow};
use crate::published::mean;
use glam::Vec3;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use sgs_passes::transport::LightShape;
use sgs_scene::{GltfScene, PunctualKind, PunctualLight};
use std::f64::consts::PI;
use std::path::Path;

/// SGS extension data of all lights together.
#[derive(Serialize, Deserialize)]
struct Together {
    format: String,
    normalizer: f32,
}

/// SGS extension data of a light with lobes.
#[derive(Serialize, Deserialize)]
struct Beyond {
    gain: f32,
    lobes: Vec<LobeRow>,
}

/// Returns the lights that glTF holds, and the `extras` of all together.
pub(crate) fn punctual(list: &LightList) -> (Vec<PunctualLight>, Value) {
    let lights = list.lights.iter().enumerate().filter_map(|(i, light)| match light {
        ListedLight::Lobes(row) => Some(lobes(list.normalizer, i, row)),
        ListedLight::Physical(row) if row.is_on() => physical(i, row),
        ListedLight::Physical(_) => None,
    });
    let together = Together { format: FORMAT.to_owned(), normalizer: list.normalizer };
    (lights.collect(), json!({"sgs": together}))
}

/// Names the lights that glTF does not hold: rectangles and disks, and physical lights that are off.
pub fn gltf_leaves_out(list: &LightList) -> Vec<String> {
    list.left_out(|i, row| physical(i, row).is_some())
}

/// Splits a color into its largest component and factors of 1 at most.
fn split(color: [f64; 3]) -> ([f32; 3], f32) {
    let most = color.iter().fold(0.0_f64, |a, b| a.max(*b));
    (color.map(|v| if most > 0.0 { (v / most) as f32 } else { 1.0 }), most as f32)
}

/// Converts a light with lobes to a point light of its mean intensity.
fn lobes(normalizer: f32, i: usize, light: &LightRow) -> PunctualLight {
    let factor = f64::from(normalizer) * f64::from(light.gain);
    let of = |l: &LobeRow, c: usize| f64::from(l.amplitude[c]) * mean(f64::from(l.sharpness));
    let (color, intensity) = split([0, 1, 2].map(|c| factor * light.lobes.iter().map(|l| of(l, c)).sum::<f64>()));
    let beyond = Beyond { gain: light.gain, lobes: light.lobes.clone() };
    PunctualLight {
        name: format!("light {i}"),
        kind: PunctualKind::Point,
        position: light.position,
        direction: [0.0, 0.0, -1.0],
        color,
        intensity,
        extras: Some(json!({"sgs": beyond})),
    }
}

/// Converts a physical light; `None` if it has no counterpart.
fn physical(i: usize, row: &PhysicalRow) -> Option<PunctualLight> {
    let unit = |v: [f32; 3]| Vec3::from(v).as_dvec3().normalize_or_zero().as_vec3().to_array();
    let down = [0.0, 0.0, -1.0];
    let (kind, position, direction, factor) = match row.shape {
        LightShape::Point { position } => (PunctualKind::Point, position, down, 1.0),
        LightShape::Sphere { center, radius } => (PunctualKind::Point, center, down, PI * f64::from(radius).powi(2)),
        LightShape::Lobe { position, axis, sharpness } => {
            (PunctualKind::Point, position, unit(axis), mean(f64::from(sharpness)))
        }
        LightShape::Spot { position, axis, inner_angle, outer_angle } => {
            // The extension requires an inner angle below the outer one.
            let outer_angle = outer_angle.max(1e-3);
            let inner_angle = inner_angle.min(0.999 * outer_angle);
            (PunctualKind::Spot { inner_angle, outer_angle }, position, unit(axis), 1.0)
        }
        LightShape::Directional { direction, .. } => (PunctualKind::Directional, [0.0; 3], unit(direction), 1.0),
        LightShape::Rectangle { .. } | LightShape::Disk { .. } | LightShape::Window { .. } => return None,
    };
    let (color, intensity) = split(row.light().color.map(|c| factor * f64::from(c)));
    let extras = Some(json!({"sgs": ListedLight::Physical(row.clone())}));
    Some(PunctualLight { name: row.name_or(i), kind, position, direction, color, intensity, extras })
}

/// Returns the lights of a glTF file.
///
/// Lights written by SGS have all that `extras` hold, unless another program changed their color or intensity.
pub(crate) fn lights_of(path: &Path, scene: &GltfScene) -> Result<Option<LightList>> {
    if scene.lights.is_empty() {
        return Ok(None);
    }
    let fail = |reason: String| RunError::file(path, reason);
    let own = |value: &Option<Value>| value.as_ref().and_then(|v| v.get("sgs")).cloned();
    let foreign = |e: serde_json::Error| fail(format!("its lights are not as SGS writes them: {e}"));
    let together: Option<Together> =
        own(&scene.light_extras).map(|v| serde_json::from_value(v).map_err(foreign)).transpose()?;
    if let Some(Together { format, .. }) = together.as_ref().filter(|t| t.format != FORMAT) {
        return Err(fail(format!("the format of its lights is \"{format}\", not \"{FORMAT}\"")));
    }
    let mut lights = Vec::new();
    for (i, light) in scene.lights.iter().enumerate() {
        let fail = |e: serde_json::Error| fail(format!("its light {i} is not as SGS writes them: {e}"));
        let row = match own(&light.extras).filter(|_| together.is_some()) {
            Some(v) if v.get("type").is_some() => {
                let row: ListedLight = serde_json::from_value(v).map_err(fail)?;
                ListedLight::Physical(restored(i, light, row))
            }
            Some(v) => {
                let Beyond { gain, lobes } = serde_json::from_value(v).map_err(fail)?;
                ListedLight::Lobes(LightRow { position: light.position, gain, lobes })
            }
            None => ListedLight::Physical(row_of(light)),
        };
        lights.push(row);
    }
    let list = LightList { normalizer: together.map_or(1.0, |t| t.normalizer), lights };
    list.check().map_err(fail)?;
    Ok(Some(list))
}

/// Reads the lights of a `lights.json` or a glTF file, recognized by its content. The glTF file needs no Gaussians.
///
/// # Errors
/// If the file is of neither kind, or damaged.
pub fn read_light_source(path: &Path) -> Result<LightList> {
    let bytes = std::fs::read(path).map_err(|e| RunError::file(path, e.to_string()))?;
    let text = std::str::from_utf8(&bytes).unwrap_or_default();
    if has_format(text) {
        return read_light_list(path);
    }
    let none = LightList { normalizer: 1.0, lights: Vec::new() };
    Ok(lights_of(path, &GltfScene::read_lights(path)?)?.unwrap_or(none))
}

/// Returns a light of another program.
fn row_of(light: &PunctualLight) -> PhysicalRow {
    let PunctualLight { position, direction, .. } = *light;
    let shape = match light.kind {
        PunctualKind::Point => LightShape::Point { position },
        PunctualKind::Spot { inner_angle, outer_angle } => {
            LightShape::Spot { position, axis: direction, inner_angle, outer_angle }
        }
        PunctualKind::Directional => LightShape::Directional { direction, angular_radius: 0.0 },
    };
    let name = Some(light.name.clone()).filter(|name| !name.is_empty());
    PhysicalRow { name, shape, color: light.color.map(|c| light.intensity * c), gain: 1.0 }
}

/// Returns what `extras` hold of a light, where its node places it.
///
/// If another program changed its kind, color, intensity or cone, the light is what it made of it.
fn restored(i: usize, light: &PunctualLight, extras: ListedLight) -> PhysicalRow {
    let ListedLight::Physical(mut row) = extras else { return row_of(light) };
    let Some(written) = physical(i, &row) else { return row_of(light) };
    let near = |a: f32, b: f32| (a - b).abs() <= 1e-5 * a.abs().max(b.abs());
    let same = match (written.kind, light.kind) {
        (PunctualKind::Spot { inner_angle: a, outer_angle: b }, PunctualKind::Spot { inner_angle, outer_angle }) => {
            near(a, inner_angle) && near(b, outer_angle)
        }
        (a, b) => a == b,
    };
    let same = same
        && near(written.intensity, light.intensity)
        && written.color.iter().zip(&light.color).all(|(a, b)| (a - b).abs() < 1e-5);
    if !same {
        return row_of(light);
    }
    let by = Vec3::from(light.position) - Vec3::from(written.position);
    if by != Vec3::ZERO {
        row.shape = row.shape.translated(by.to_array());
    }
    let direction = Vec3::from(light.direction);
    if direction != Vec3::ZERO
        && direction.distance(Vec3::from(written.direction)) > 1e-5
        && let LightShape::Spot { axis, .. }
        | LightShape::Lobe { axis, .. }
        | LightShape::Directional { direction: axis, .. } = &mut row.shape
    {
        *axis = light.direction;
    }
    row
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(shape: LightShape) -> PhysicalRow {
        PhysicalRow { name: Some(shape.name().to_owned()), shape, color: [3.0, 1.5, 0.0], gain: 0.5 }
    }

    fn shapes() -> [LightShape; 6] {
        let (position, axis) = ([1.0, 2.0, 3.0], [0.0, -3.0, 4.0]);
        [
            LightShape::Point { position },
            LightShape::Sphere { center: position, radius: 0.1 },
            LightShape::Spot { position, axis, inner_angle: 0.0, outer_angle: 0.5 },
            LightShape::Spot { position, axis, inner_angle: 0.5, outer_angle: 0.5 },
            LightShape::Directional { direction: axis, angular_radius: 0.005 },
            LightShape::Lobe { position, axis, sharpness: 4.0 },
        ]
    }

    fn read(light: &PunctualLight, extras: &Value) -> ListedLight {
        let scene =
            GltfScene { lights: vec![light.clone()], light_extras: Some(extras.clone()), ..GltfScene::default() };
        lights_of(Path::new("a.glb"), &scene).unwrap().unwrap().lights.remove(0)
    }

    #[test]
    fn punctual_lights_have_the_units_of_the_extension() {
        let list = LightList { normalizer: 1.0, lights: shapes().map(row).map(ListedLight::Physical).to_vec() };
        let (lights, _) = punctual(&list);
        let means = [1.0, PI * 0.01, 1.0, 1.0, 1.0, (1.0 - (-8.0_f64).exp()) / 8.0];
        for (light, mean) in lights.iter().zip(means) {
            assert!((f64::from(light.intensity) / (1.5 * mean) - 1.0).abs() < 1e-6, "{light:?}");
            assert_eq!(light.color, [1.0, 0.5, 0.0]);
        }
        assert_eq!(lights[2].direction, [0.0, -0.6, 0.8]);
        let PunctualKind::Spot { inner_angle, outer_angle } = lights[3].kind else { panic!("a spot") };
        assert!(inner_angle < outer_angle);
    }

    #[test]
    fn lights_come_back_with_changes_of_other_programs() {
        let list = LightList { normalizer: 1.0, lights: shapes().map(row).map(ListedLight::Physical).to_vec() };
        let (lights, extras) = punctual(&list);
        for (light, right) in lights.iter().zip(&list.lights) {
            assert_eq!(read(light, &extras), *right);
            let ListedLight::Physical(right) = right else { continue };
            // Moved by another program.
            let moved = PunctualLight { position: [1.0, 2.5, 3.0], ..light.clone() };
            let ListedLight::Physical(found) = read(&moved, &extras) else { panic!("a physical light") };
            let by = if light.kind == PunctualKind::Directional { [0.0; 3] } else { [0.0, 0.5, 0.0] };
            assert_eq!(found.shape, right.shape.translated(by));
            // Recolored: what the extension says, without extent.
            let dimmed = PunctualLight { intensity: 0.5 * light.intensity, ..light.clone() };
            let ListedLight::Physical(found) = read(&dimmed, &extras) else { panic!("a physical light") };
            assert_eq!((found.color[0], found.gain), (0.5 * light.intensity, 1.0));
            assert!(!matches!(found.shape, LightShape::Sphere { .. } | LightShape::Lobe { .. }));
        }
        let turned = PunctualLight { direction: [1.0, 0.0, 0.0], ..lights[2].clone() };
        let ListedLight::Physical(found) = read(&turned, &extras) else { panic!("a physical light") };
        assert!(matches!(found.shape, LightShape::Spot { axis: [1.0, 0.0, 0.0], .. }), "{found:?}");
    }

    #[test]
    fn rectangles_disks_and_dark_lights_are_left_out() {
        let pane = LightShape::Rectangle { corner: [0.0; 3], edge_u: [0.0, 0.4, 0.0], edge_v: [0.7, 0.0, 0.0] };
        let disk = LightShape::Disk { center: [0.0; 3], normal: [0.0, 1.0, 0.0], radius: 1.0 };
        let point = LightShape::Point { position: [0.0; 3] };
        let rows = vec![
            row(pane),
            PhysicalRow { name: None, ..row(disk) },
            PhysicalRow { gain: 0.0, ..row(point) },
            row(point),
        ];
        let list = LightList { normalizer: 1.0, lights: rows.into_iter().map(ListedLight::Physical).collect() };
        assert_eq!(punctual(&list).0.len(), 1);
        let left_out = ["rectangle \"rectangle\"", "disk \"light 1\"", "point \"point\", which is off"];
        assert_eq!(gltf_leaves_out(&list), left_out);
    }
}
