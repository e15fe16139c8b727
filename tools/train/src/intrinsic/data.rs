//! Packed priors of materials for the GPU, and normals for splats without normals.

use crate::data::{TrainingData, upload};
use crate::error::Result;
use glam::{DMat3, DQuat, DVec3};
use rayon::prelude::*;
use sgs_engine::{Device, DeviceBuffer};
use sgs_run::pack_image;
use sgs_scene::{Camera, Image, MaskedMap, Scene, Splats, linear_to_srgb};

/// Priors of one material, for all training views.
/// Views are stored consecutively like the photographs. Alpha is 0 where a prior is unknown.
pub(crate) struct MaterialPriors {
    /// Packed words, by training view.
    pub packed: Vec<Vec<u32>>,
}

/// Kind of material.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Material {
    /// Albedo, compared display-referred: encoded in sRGB.
    Albedo,
    Roughness,
    Metallic,
}

impl MaterialPriors {
    /// Reads the priors. Returns none if no training view has one.
    /// A view without a prior is trained without one.
    pub fn read(scene: &Scene, kind: Material) -> Result<Option<MaterialPriors>> {
        let one = |&i: &usize| -> Result<Option<Vec<u32>>> {
            let map = match kind {
                Material::Albedo => scene.albedo_prior(i)?,
                Material::Roughness => scene.roughness_prior(i)?,
                Material::Metallic => scene.metallic_prior(i)?,
            };
            let counts = scene.load_mask(i)?;
            Ok(map.map(|m| pack(&m, kind, counts.as_ref())))
        };
        let maps: Vec<Option<Vec<u32>>> = scene.split.train.par_iter().map(one).collect::<Result<_>>()?;
        if maps.iter().all(Option::is_none) {
            return Ok(None);
        }
        let blank = |i: usize| {
            let c = &scene.views[scene.split.train[i]].camera;
            vec![0; c.width as usize * c.height as usize]
        };
        let packed = maps.into_iter().enumerate().map(|(i, m)| m.unwrap_or_else(|| blank(i))).collect();
        Ok(Some(MaterialPriors { packed }))
    }

    /// Uploads the priors to the device: a buffer per part of the photographs, as large as theirs.
    pub fn upload(&self, device: &Device, name: &str, data: &TrainingData) -> Result<Vec<DeviceBuffer>> {
        upload(device, name, &self.packed, &data.part_of, data.parts[0].targets.bytes())
    }
}

/// Packs a map like the photographs.
pub(super) fn pack(map: &MaskedMap, kind: Material, counts: Option<&Image>) -> Vec<u32> {
    let channels = map.image.channels as usize;
    let rgb: Vec<f32> = map
        .image
        .data
        .chunks_exact(channels)
        .flat_map(|p| match kind {
            Material::Albedo => [p[0], p[1 % channels], p[2 % channels]].map(|v| linear_to_srgb(v.clamp(0.0, 1.0))),
            Material::Roughness | Material::Metallic => [p[0]; 3],
        })
        .collect();
    let mut valid = map.valid.clone();
    // Invalid pixels of the photograph have no material; non-finite values are unknown.
    for (i, v) in valid.data.iter_mut().enumerate() {
        let there = counts.is_none_or(|c| c.data[i] > 0.5) && rgb[3 * i..3 * i + 3].iter().all(|v| v.is_finite());
        if !there {
            *v = 0.0;
        }
    }
    let image = Image { width: map.image.width, height: map.image.height, channels: 3, data: rgb };
    pack_image(&image, Some(&valid))
}

/// Returns normals for splats without normals: the shortest axis of each.
/// The axis points to the side of the nearest training camera.
pub(crate) fn shortest_axes(splats: &Splats, cameras: &[&Camera]) -> Vec<[f32; 3]> {
    let eyes: Vec<DVec3> = cameras.iter().map(|c| c.position()).collect();
    (0..splats.len())
        .into_par_iter()
        .map(|i| {
            let [w, x, y, z] = splats.rotations[i].map(f64::from);
            let q = DQuat::from_xyzw(x, y, z, w);
            let q = if q.length_squared() > 0.0 && q.is_finite() { q.normalize() } else { DQuat::IDENTITY };
            let s = splats.log_scales[i];
            let shortest = (0..3).min_by(|a, b| s[*a].total_cmp(&s[*b])).unwrap_or(2);
            let axis = DMat3::from_quat(q).col(shortest);
            let at = DVec3::from_array(splats.means[i].map(f64::from));
            let away = |eye: &&DVec3| eye.distance_squared(at);
            let nearest = eyes.iter().min_by(|a, b| away(a).total_cmp(&away(b)));
            let toward = nearest.map_or(axis, |eye| *eye - at);
            let axis = if axis.dot(toward) < 0.0 { -axis } else { axis };
            axis.as_vec3().to_array()
        })
        .collect()
}

/// Returns the box of the scene that the training views see.
/// The box contains all cameras and the means of sufficiently opaque splats. The outermost hundredth of the splats at
/// each end of each axis does not count. A margin of 2 % of the longest side leaves space for lights.
pub(crate) fn scene_box(splats: &Splats, cameras: &[&Camera]) -> [[f32; 3]; 2] {
    let mut low = DVec3::INFINITY;
    let mut high = DVec3::NEG_INFINITY;
    for axis in 0..3 {
        let mut along: Vec<f64> = (0..splats.len())
            .filter(|&i| splats.opacity_logits[i] > -2.0)
            .map(|i| f64::from(splats.means[i][axis]))
            .filter(|v| v.is_finite())
            .collect();
        along.sort_by(f64::total_cmp);
        let cut = along.len() / 100;
        for value in along.iter().skip(cut).take(along.len() - 2 * cut) {
            low[axis] = low[axis].min(*value);
            high[axis] = high[axis].max(*value);
        }
    }
    for c in cameras {
        low = low.min(c.position());
        high = high.max(c.position());
    }
    if !(low.is_finite() && high.is_finite()) {
        return [[-1.0; 3], [1.0; 3]];
    }
    let room = 0.02 * (high - low).max_element().max(1e-6);
    [(low - room).as_vec3().to_array(), (high + room).as_vec3().to_array()]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flat() -> Splats {
        Splats {
            means: vec![[0.0, 0.0, 2.0], [0.0, 0.0, -2.0]],
            log_scales: vec![[0.0, 0.0, -5.0], [-5.0, 0.0, 0.0]],
            rotations: vec![[1.0, 0.0, 0.0, 0.0], [0.0; 4]],
            opacity_logits: vec![1.0; 2],
            sh: [vec![0.0; 6], vec![], vec![], vec![]],
            ..Default::default()
        }
    }

    fn camera(x: f64) -> Camera {
        Camera {
            name: "000".into(),
            width: 4,
            height: 4,
            fx: 4.0,
            fy: 4.0,
            cx: 2.0,
            cy: 2.0,
            rotation: DMat3::IDENTITY,
            translation: DVec3::new(-x, 0.0, 0.0),
            near: sgs_scene::NEAR,
        }
    }

    #[test]
    fn shortest_axes_face_the_nearest_camera() {
        let camera = camera(1.0);
        let normals = shortest_axes(&flat(), &[&camera]);
        assert_eq!(camera.position(), DVec3::X);
        assert_eq!(normals, [[0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]);
    }

    #[test]
    fn scene_box_contains_splats_and_cameras() {
        let camera = camera(9.0);
        let [low, high] = scene_box(&flat(), &[&camera]);
        assert!(low[2] < -2.0 && high[2] > 2.0 && high[0] > 9.0 && high[0] < 10.0, "{low:?} {high:?}");
        assert_eq!(scene_box(&Splats::default(), &[]), [[-1.0; 3], [1.0; 3]]);
    }
}
