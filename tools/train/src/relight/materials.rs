//! Materials of chosen Gaussians after an edit.

use super::edit::MaterialEdit;
use sgs_scene::{ALBEDO_RANGE as ALBEDO, ROUGHNESS_RANGE as ROUGHNESS, Splats};

/// Nearer to the ends no value comes: beyond, what is before activation would be infinite.
const MARGIN: f32 = 1e-4;

/// The lowest albedo, and how far above it the highest lies, of a range of two ends.
pub fn span([low, high]: [f32; 2]) -> [f32; 2] {
    // The range of files is known to the bit.
    if [low, high] == [0.01, 0.99] { ALBEDO } else { [low, high - low] }
}

/// Albedo before activation in another range: the same values, or the nearest.
pub fn in_range(raw: Vec<f32>, from: [f32; 2], to: [f32; 2]) -> Vec<f32> {
    if from == to {
        return raw;
    }
    raw.into_iter().map(|raw| logit((from[0] + from[1] * sigmoid(raw) - to[0]) / to[1])).collect()
}

/// Albedo before activation; values beyond what there is become the nearest.
pub fn raw(value: f32) -> f32 {
    logit((value - ALBEDO[0]) / ALBEDO[1])
}

/// Roughness before activation.
pub fn raw_roughness(value: f32) -> f32 {
    logit((value - ROUGHNESS[0]) / ROUGHNESS[1])
}

/// Metallic before activation.
pub fn raw_metallic(value: f32) -> f32 {
    logit(value)
}

/// Albedo from before activation.
pub fn value(raw: f32) -> f32 {
    ALBEDO[0] + ALBEDO[1] * sigmoid(raw)
}

/// Roughness from before activation.
pub fn roughness_value(raw: f32) -> f32 {
    ROUGHNESS[0] + ROUGHNESS[1] * sigmoid(raw)
}

fn logit(share: f32) -> f32 {
    let p = share.clamp(MARGIN, 1.0 - MARGIN);
    (p / (1.0 - p)).ln()
}

fn sigmoid(raw: f32) -> f32 {
    1.0 / (1.0 + (-raw).exp())
}

/// Applies an edit to the Gaussians that are chosen. What it does not name keeps its bits.
pub fn edit_materials(edit: &MaterialEdit, chosen: &[bool], splats: &mut Splats) {
    let (set, scale) = (&edit.set, &edit.scale);
    let picked: Vec<usize> = (0..splats.len()).filter(|i| chosen.get(*i) == Some(&true)).collect();
    if let (Some(albedo), true) = (&mut splats.albedo, set.albedo.is_some() || scale.albedo.is_some()) {
        let factor = scale.albedo.unwrap_or([1.0; 3]);
        for &i in &picked {
            let old = albedo[i];
            albedo[i] = [0, 1, 2].map(|c| raw(factor[c] * set.albedo.map_or_else(|| value(old[c]), |new| new[c])));
        }
    }
    if let (Some(roughness), true) = (&mut splats.roughness, set.roughness.is_some() || scale.roughness.is_some()) {
        for &i in &picked {
            let old = set.roughness.unwrap_or_else(|| roughness_value(roughness[i]));
            roughness[i] = raw_roughness(scale.roughness.unwrap_or(1.0) * old);
        }
    }
    if set.metallic.is_some() || scale.metallic.is_some() {
        let count = splats.means.len();
        let metallic = splats.metallic.get_or_insert_with(|| vec![raw_metallic(0.0); count]);
        for &i in &picked {
            let old = set.metallic.unwrap_or_else(|| sigmoid(metallic[i]));
            metallic[i] = raw_metallic(scale.metallic.unwrap_or(1.0) * old);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::relight::edit::{MaterialValues, Where};

    #[test]
    fn albedo_keeps_its_values_in_another_range() {
        let published = span([0.09, 0.99]);
        let of = |raw: f32, [low, range]: [f32; 2]| low + range * sigmoid(raw);
        for raw in [-3.0, -1.0, 0.0, 0.5, 4.0] {
            let there = in_range(vec![raw], published, ALBEDO)[0];
            assert!((of(raw, published) - of(there, ALBEDO)).abs() < 1e-6, "{raw}");
            let back = in_range(vec![there], ALBEDO, published)[0];
            assert!((back - raw).abs() < 1e-3, "{raw} {back}");
        }
        // What is darker than the range becomes its darkest.
        let dark = in_range(vec![-9.0], ALBEDO, published)[0];
        assert!(dark.is_finite() && of(dark, published) < 0.0902);
        assert_eq!(in_range(vec![-9.0], ALBEDO, span([0.01, 0.99])), [-9.0]);
    }

    #[test]
    fn the_chosen_change_and_others_do_not() {
        let mut splats = Splats {
            means: vec![[0.0; 3]; 3],
            albedo: Some(vec![[0.1, -0.2, 0.3]; 3]),
            roughness: Some(vec![0.5; 3]),
            ..Default::default()
        };
        let edit = MaterialEdit {
            place: Where::default(),
            set: MaterialValues { albedo: Some([0.2, 0.0, 1.0]), metallic: Some(0.75), ..Default::default() },
            scale: MaterialValues { roughness: Some(0.5), ..Default::default() },
        };
        edit_materials(&edit, &[false, true, false], &mut splats);
        let (albedo, roughness) = (splats.albedo.unwrap(), splats.roughness.unwrap());
        assert_eq!((albedo[0], albedo[2], roughness[0]), ([0.1, -0.2, 0.3], [0.1, -0.2, 0.3], 0.5));
        let is = albedo[1].map(value);
        assert!((is[0] - 0.2).abs() < 1e-5 && (is[1] - 0.0101).abs() < 1e-4 && (is[2] - 0.9899).abs() < 1e-4, "{is:?}");
        assert!((roughness_value(roughness[1]) - 0.5 * roughness_value(0.5)).abs() < 1e-5);
        let metallic = splats.metallic.unwrap().map_sigmoid();
        assert!(metallic[0] < 2e-4 && (metallic[1] - 0.75).abs() < 1e-5);
    }

    trait Shares {
        fn map_sigmoid(&self) -> Vec<f32>;
    }

    impl Shares for Vec<f32> {
        fn map_sigmoid(&self) -> Vec<f32> {
            self.iter().map(|v| sigmoid(*v)).collect()
        }
    }
}
