//! Lights after an edit, and new lights in physical units.
//!
//! One fixed normalizer multiplies all light of a run, so intensities of new lights are divided by it.

use super::edit::{LightEdit, NewLight};
use crate::error::{RelightError, Result};
use glam::Vec3;
use sgs_run::{
    LightFile, LightRow, ListedLight, LobeRow, MOST_AMPLITUDE, MOST_LIGHTS, PATCHES, published_light, rectangle_patches,
};

/// Applies an edit to the lights of a run, if any.
///
/// # Errors
/// If the edit names a light that does not exist, or a light is too bright.
pub fn edit_lights(edit: &LightEdit, lights: Option<LightFile>) -> Result<Option<LightFile>> {
    let mut file = lights.unwrap_or_else(|| LightFile::new(1.0, Vec::new()));
    let groups = file.groups();
    let count = groups.len();
    // The points of a light: several for a rectangle or disk.
    let known = |light: usize| {
        if let Some(points) = groups.get(light) {
            return Ok(points.clone());
        }
        let has = if count == 0 { "has no lights".to_owned() } else { format!("has lights 0 to {}", count - 1) };
        Err(RelightError::Edit(format!("The edit names light {light}, but the scene {has}.")))
    };
    if let Some(only) = &edit.only {
        let retained = only.iter().map(|l| known(*l)).collect::<Result<Vec<_>>>()?;
        let stays = |i: usize| retained.iter().any(|points| points.contains(&i));
        file.lights.iter_mut().enumerate().filter(|(i, _)| !stays(*i)).for_each(|(_, l)| l.gain = 0.0);
    }
    let trained: Vec<f32> = file.lights.iter().map(|l| l.gain).collect();
    if edit.off {
        file.lights.iter_mut().for_each(|l| l.gain = 0.0);
    }
    for change in &edit.change {
        let Some(number) = change.light else { continue };
        let points = known(number)?;
        let center = center(&file.lights[points.clone()]);
        let by = match change.to {
            Some(to) => Vec3::from(to) - center,
            None => change.by.unwrap_or([0.0; 3]).into(),
        };
        let color = change.color.unwrap_or([1.0; 3]);
        for (light, trained) in file.lights[points.clone()].iter_mut().zip(&trained[points]) {
            match change.on {
                Some(false) => light.gain = 0.0,
                Some(true) => light.gain = if *trained > 0.0 { *trained } else { 1.0 },
                None => {}
            }
            light.gain *= change.intensity.unwrap_or(1.0);
            for lobe in &mut light.lobes {
                lobe.amplitude = [0, 1, 2].map(|c| lobe.amplitude[c] * color[c]);
            }
            light.position = (Vec3::from(light.position) + by).to_array();
        }
        if let (Some(to), [light]) = (change.to, &mut file.lights[known(number)?]) {
            light.position = to;
        }
    }
    for new in &edit.add {
        file.push(new_light(new, file.normalizer)?);
        if file.lights.len() > MOST_LIGHTS {
            return Err(RelightError::Edit(format!("The edit leads to more lights than {MOST_LIGHTS}.")));
        }
    }
    file.check().map_err(|wrong| RelightError::Edit(format!("The edit leads to lights that cannot be: {wrong}.")))?;
    Ok(Some(file).filter(|f| !f.lights.is_empty()))
}

/// Returns the mean position.
fn center(points: &[LightRow]) -> Vec3 {
    points.iter().map(|l| Vec3::from(l.position)).sum::<Vec3>() / points.len().max(1) as f32
}

/// Converts a light to rows: one for a point light, one per patch of a rectangle or disk.
///
/// # Errors
/// If the light is directional or too bright.
pub fn new_light(new: &NewLight, normalizer: f32) -> Result<Vec<LightRow>> {
    let rows = rows(new, normalizer)?;
    let brightest = rows.iter().flat_map(|l| &l.lobes).flat_map(|l| l.amplitude).fold(0.0, f32::max);
    if brightest > MOST_AMPLITUDE {
        let most = MOST_AMPLITUDE * normalizer;
        return Err(RelightError::Edit(format!("A new light is too bright: intensities end at {most}.")));
    }
    Ok(rows)
}

fn rows(new: &NewLight, normalizer: f32) -> Result<Vec<LightRow>> {
    let amplitude = |v: [f32; 3]| v.map(|a| a / normalizer.max(1e-30));
    let lobes_of =
        |lobes: &[LobeRow]| lobes.iter().map(|l| LobeRow { amplitude: amplitude(l.amplitude), ..*l }).collect();
    match &new.light {
        Some(ListedLight::Lobes(row)) => return Ok(vec![LightRow { lobes: lobes_of(&row.lobes), ..row.clone() }]),
        Some(ListedLight::Physical(row)) => {
            return published_light(row, normalizer).map_err(|e| RelightError::Edit(format!("A new light is {e}.")));
        }
        None => {}
    }
    if let (Some(corners), Some(radiance)) = (new.corners, new.radiance) {
        return Ok(rectangle_patches(corners, amplitude(radiance), new.patches.unwrap_or(PATCHES)));
    }
    let Some(position) = new.position else { return Ok(Vec::new()) };
    let lobes = match (&new.lobes, new.intensity) {
        (Some(lobes), _) => lobes_of(lobes),
        (None, Some(i)) => vec![LobeRow { axis: [0.0, 0.0, 1.0], sharpness: 0.0, amplitude: amplitude(i) }],
        (None, None) => Vec::new(),
    };
    Ok(vec![LightRow { position, gain: 1.0, lobes }])
}

/// Returns whether a light of the run is still on at its original position.
///
/// Also true if the scene has no lights before or after the edit, or if all lights are off.
pub(super) fn any_left(before: Option<&LightFile>, after: Option<&LightFile>) -> bool {
    let (Some(before), Some(after)) = (before, after) else { return true };
    let own = |l: &LightRow| before.lights.iter().any(|b| b.position == l.position);
    after.lights.iter().all(|l| l.gain == 0.0) || after.lights.iter().any(|l| l.gain > 0.0 && own(l))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::edit::LightChange;
    use glam::DVec3;
    use sgs_run::LightList;

    fn two() -> LightFile {
        let lobe = LobeRow { axis: [0.0, 0.0, 1.0], sharpness: 1.0, amplitude: [1.0, 2.0, 3.0] };
        let light = |gain| LightRow { position: [1.0, 0.0, 0.0], gain, lobes: vec![lobe] };
        LightFile::new(0.5, vec![light(0.7), light(0.0)])
    }

    fn change(light: usize) -> LightChange {
        LightChange { light: Some(light), ..Default::default() }
    }

    #[test]
    fn light_changes_apply_to_single_lights() {
        let moved = LightChange { by: Some([0.0, 1.0, 0.0]), color: Some([2.0, 1.0, 0.0]), ..change(0) };
        let on = LightChange { on: Some(true), intensity: Some(3.0), to: Some([9.0; 3]), ..change(1) };
        let edit = LightEdit { change: vec![moved, on], ..Default::default() };
        let f = edit_lights(&edit, Some(two())).unwrap().unwrap();
        assert_eq!((f.lights[0].position, f.lights[0].gain), ([1.0, 1.0, 0.0], 0.7));
        assert_eq!(f.lights[0].lobes[0].amplitude, [2.0, 2.0, 0.0]);
        assert_eq!((f.lights[1].position, f.lights[1].gain), ([9.0; 3], 3.0));
        let off =
            LightEdit { off: true, change: vec![LightChange { on: Some(true), ..change(0) }], ..Default::default() };
        let gains = |f: LightFile| f.lights.iter().map(|l| l.gain).collect::<Vec<_>>();
        assert_eq!(gains(edit_lights(&off, Some(two())).unwrap().unwrap()), [0.7, 0.0]);
        let only = LightEdit { only: Some(vec![1]), ..Default::default() };
        assert_eq!(gains(edit_lights(&only, Some(two())).unwrap().unwrap()), [0.0, 0.0]);
        let missing = LightEdit { only: Some(vec![2]), ..Default::default() };
        let error = edit_lights(&missing, Some(two())).unwrap_err().to_string();
        assert!(error.contains("light 2") && error.contains("0 to 1"), "{error}");
        assert!(edit_lights(&LightEdit::default(), None).unwrap().is_none());
    }

    #[test]
    fn patches_of_a_light_change_together() {
        let listed = |text: &str| serde_json::from_str::<ListedLight>(text).unwrap();
        let pane = r#"{"type": "rectangle", "corner": [0,0,0], "edge_u": [1,0,0], "edge_v": [0,1,0], "color": [1,1,1], "gain": 0.5}"#;
        let point = r#"{"type": "point", "position": [1,2,3], "color": [1,1,1]}"#;
        let file = || LightList { normalizer: 0.5, lights: vec![listed(pane), listed(point)] }.published().unwrap();
        let darker = LightChange { intensity: Some(0.5), color: Some([1.0, 0.0, 0.0]), ..change(0) };
        let edit =
            LightEdit { change: vec![LightChange { to: Some([4.0, 5.0, 6.0]), ..darker }], ..Default::default() };
        let f = edit_lights(&edit, Some(file())).unwrap().unwrap();
        let (panes, last) = f.lights.split_at(16);
        assert!((center(panes) - Vec3::new(4.0, 5.0, 6.0)).length() < 1e-5);
        assert!(panes.iter().all(|l| l.gain == 0.25 && l.lobes[0].amplitude[1] == 0.0 && l.position[2] == 6.0));
        assert_eq!(last, &file().lights[16..]);
        let only = LightEdit { only: Some(vec![1]), ..Default::default() };
        let f = edit_lights(&only, Some(file())).unwrap().unwrap();
        assert_eq!(f.lights.iter().filter(|l| l.gain > 0.0).count(), 1);
        let missing = LightEdit { only: Some(vec![2]), ..Default::default() };
        assert!(edit_lights(&missing, Some(file())).unwrap_err().to_string().contains("lights 0 to 1"));
    }

    #[test]
    fn lights_of_all_types_are_added() {
        let edit = |text: &str| {
            let add = serde_json::from_str::<LightEdit>(&format!("{{\"add\": [{text}]}}")).unwrap();
            add.add[0].check("lights.add[0]").unwrap();
            edit_lights(&add, Some(two()))
        };
        let f = edit(r#"{"type": "disk", "center": [0,0,2], "normal": [0,0,-1], "radius": 1, "color": [1,1,1]}"#);
        assert_eq!(f.unwrap().unwrap().lights.len(), 18);
        let lobes = r#"{"type": "lobes", "position": [1,2,3], "gain": 0.5,
            "lobes": [{"axis": [0,1,0], "sharpness": 2, "amplitude": [1,2,3]}]}"#;
        let f = edit(lobes).unwrap().unwrap();
        assert_eq!((f.lights[2].gain, f.lights[2].lobes[0].amplitude), (0.5, [2.0, 4.0, 6.0]));
        let sun = edit(r#"{"type": "directional", "direction": [0,-1,0], "angular_radius": 0.27, "color": [1,1,1]}"#);
        let error = sun.unwrap_err().to_string();
        assert!(error.contains("A new light is directional") && error.contains("transport stage"), "{error}");
    }

    #[test]
    fn new_lights_are_in_physical_units() {
        let point = NewLight { position: Some([0.0; 3]), intensity: Some([4.0; 3]), ..Default::default() };
        let edit = LightEdit { off: true, add: vec![point], ..Default::default() };
        let f = edit_lights(&edit, Some(two())).unwrap().unwrap();
        assert_eq!((f.lights.len(), f.lights[2].lobes[0].amplitude), (3, [8.0; 3]));
        let bright = NewLight { position: Some([0.0; 3]), intensity: Some([1e9; 3]), ..Default::default() };
        let edit = LightEdit { add: vec![bright], ..Default::default() };
        assert!(edit_lights(&edit, None).unwrap_err().to_string().contains("too bright"));
    }

    #[test]
    fn rectangle_light_emits_to_its_front() {
        // 2 × 2, in the plane z = 0, counterclockwise from above. From afar, equals a disk of the same area.
        let corners = [[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]];
        let new = NewLight { corners: Some(corners), radiance: Some([1.0; 3]), ..Default::default() };
        let rows = new_light(&new, 0.25).unwrap();
        assert_eq!(rows.len(), 16);
        let arriving = |p: [f32; 3]| -> f64 {
            let at = |l: &LightRow| {
                let d = DVec3::from(l.position.map(f64::from)) - DVec3::from(p.map(f64::from));
                let lobe = l.lobes[0];
                let cosine = d.normalize().dot(DVec3::from(lobe.axis.map(f64::from)));
                0.25 * f64::from(lobe.amplitude[0]) * (f64::from(lobe.sharpness) * (cosine - 1.0)).exp()
                    / d.length_squared()
            };
            rows.iter().map(at).sum()
        };
        let far = arriving([0.0, 0.0, 20.0]);
        assert!((far / (4.0 / 400.0) - 1.0).abs() < 0.1, "{far}");
        assert!(arriving([0.0, 0.0, -20.0]) < 0.03 * far);
    }
}
