//! Lights after an edit, and new lights in physical units.
//!
//! One fixed normalizer multiplies all light of a run, so intensities of new lights are divided by it.

use super::edit::{LightEdit, NewLight};
use crate::error::{RelightError, Result};
use glam::DVec3;
use sgs_run::{LightFile, LightRow, LobeRow, MOST_LIGHTS};

/// Sharpness of the lobe that approximates a cosine.
const COSINE_SHARPNESS: f64 = 2.133;

/// Largest amplitude that shading supports.
pub const MOST_AMPLITUDE: f32 = 3.2e6;

/// Applies an edit to the lights of a run, if any.
///
/// # Errors
/// If the edit names a light that does not exist, or a light is too bright.
pub fn edit_lights(edit: &LightEdit, lights: Option<LightFile>) -> Result<Option<LightFile>> {
    let mut file = lights.unwrap_or_else(|| LightFile::new(1.0, Vec::new()));
    let count = file.lights.len();
    let known = |light: usize| {
        if light < count {
            return Ok(light);
        }
        let has = if count == 0 { "has no lights".to_owned() } else { format!("has lights 0 to {}", count - 1) };
        Err(RelightError::Edit(format!("The edit names light {light}, but the scene {has}.")))
    };
    if let Some(only) = &edit.only {
        let retained = only.iter().map(|l| known(*l)).collect::<Result<Vec<_>>>()?;
        file.lights.iter_mut().enumerate().filter(|(i, _)| !retained.contains(i)).for_each(|(_, l)| l.gain = 0.0);
    }
    let trained: Vec<f32> = file.lights.iter().map(|l| l.gain).collect();
    if edit.off {
        file.lights.iter_mut().for_each(|l| l.gain = 0.0);
    }
    for change in &edit.change {
        let Some(number) = change.light else { continue };
        let light = &mut file.lights[known(number)?];
        match change.on {
            Some(false) => light.gain = 0.0,
            Some(true) => light.gain = if trained[number] > 0.0 { trained[number] } else { 1.0 },
            None => {}
        }
        light.gain *= change.intensity.unwrap_or(1.0);
        let color = change.color.unwrap_or([1.0; 3]);
        for lobe in &mut light.lobes {
            lobe.amplitude = [0, 1, 2].map(|c| lobe.amplitude[c] * color[c]);
        }
        let by = change.by.unwrap_or([0.0; 3]);
        light.position = change.to.unwrap_or([0, 1, 2].map(|c| light.position[c] + by[c]));
    }
    for new in &edit.add {
        let mut rows = new_light(new, file.normalizer)?;
        file.lights.append(&mut rows);
        if file.lights.len() > MOST_LIGHTS {
            return Err(RelightError::Edit(format!("The edit leads to more lights than {MOST_LIGHTS}.")));
        }
    }
    file.check().map_err(|wrong| RelightError::Edit(format!("The edit leads to lights that cannot be: {wrong}.")))?;
    Ok(Some(file).filter(|f| !f.lights.is_empty()))
}

/// Converts a light to rows: one for a point light, one per patch of a rectangle.
///
/// # Errors
/// If the light is too bright.
pub fn new_light(new: &NewLight, normalizer: f32) -> Result<Vec<LightRow>> {
    let rows = rows(new, normalizer);
    let brightest = rows.iter().flat_map(|l| &l.lobes).flat_map(|l| l.amplitude).fold(0.0, f32::max);
    if brightest > MOST_AMPLITUDE {
        let most = MOST_AMPLITUDE * normalizer;
        return Err(RelightError::Edit(format!("A new light is too bright: intensities end at {most}.")));
    }
    Ok(rows)
}

fn rows(new: &NewLight, normalizer: f32) -> Vec<LightRow> {
    let amplitude = |v: [f32; 3]| v.map(|a| a / normalizer.max(1e-30));
    if let (Some(corners), Some(radiance)) = (new.corners, new.radiance) {
        return rectangle(corners, amplitude(radiance), new.patches.unwrap_or(4));
    }
    let Some(position) = new.position else { return Vec::new() };
    let lobes = match (&new.lobes, new.intensity) {
        (Some(lobes), _) => lobes.iter().map(|l| LobeRow { amplitude: amplitude(l.amplitude), ..*l }).collect(),
        (None, Some(i)) => vec![LobeRow { axis: [0.0, 0.0, 1.0], sharpness: 0.0, amplitude: amplitude(i) }],
        (None, None) => Vec::new(),
    };
    vec![LightRow { position, gain: 1.0, lobes }]
}

/// Splits a rectangle into patches of one lobe each.
///
/// A lobe emits the total flux of a cosine emitter.
fn rectangle(corners: [[f32; 3]; 4], radiance: [f32; 3], patches: u32) -> Vec<LightRow> {
    let [a, b, c, d] = corners.map(|p| DVec3::from(p.map(f64::from)));
    let across = (b - a).cross(d - a);
    let area = 0.5 * (across.length() + (b - c).cross(d - c).length()) / f64::from(patches * patches);
    let flux = COSINE_SHARPNESS / (2.0 * (1.0 - (-2.0 * COSINE_SHARPNESS).exp()));
    // The axis points from the lit surface to the light, opposite to the emitting side.
    let axis = (-across.normalize_or_zero()).as_vec3().to_array();
    let amplitude = radiance.map(|l| (f64::from(l) * area * flux) as f32);
    let lobe = LobeRow { axis, sharpness: COSINE_SHARPNESS as f32, amplitude };
    let middle = |i: u32| (f64::from(i) + 0.5) / f64::from(patches);
    (0..patches * patches)
        .map(|i| {
            let (s, t) = (middle(i % patches), middle(i / patches));
            let place = a.lerp(b, s).lerp(d.lerp(c, s), t);
            LightRow { position: place.as_vec3().to_array(), gain: 1.0, lobes: vec![lobe] }
        })
        .collect()
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
