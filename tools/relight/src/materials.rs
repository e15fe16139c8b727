//! Material edit of selected Gaussians.

use super::edit::MaterialEdit;
use sgs_run::materials::{raw, raw_metallic, raw_roughness, roughness_value, sigmoid, value};
use sgs_scene::Splats;

/// Applies an edit to the selected Gaussians. Values that it does not name stay bitwise equal.
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
    use crate::edit::{MaterialValues, Where};

    #[test]
    fn edit_changes_only_selected_gaussians() {
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
