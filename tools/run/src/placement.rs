//! Insertion of splats into a scene: scaled, rotated, translated, and lit by its lights.

use crate::harmonics::{CONSTANT, Rotation};
use crate::materials::{raw, raw_metallic, raw_roughness};
use glam::{DQuat, DVec3};
use sgs_scene::{Placement, Splats, srgb_to_linear};

/// Roughness of inserted splats that have none.
const ROUGHNESS: f32 = 0.5;

/// Scales, rotates and translates splats. Emitters and light gains belong to another scene and are dropped.
pub fn placed(mut guest: Splats, how: &Placement) -> Splats {
    (guest.emitters, guest.light_gains) = (None, None);
    transformed(guest, how)
}

/// Scales, rotates and translates splats.
pub(crate) fn transformed(mut guest: Splats, how: &Placement) -> Splats {
    let [w, x, y, z] = how.rotation;
    let q = DQuat::from_xyzw(x, y, z, w).normalize();
    let (scale, to) = (how.scale, DVec3::from(how.translation));
    let turn = |v: [f32; 3]| q * DVec3::from(v.map(f64::from));
    guest.means.iter_mut().for_each(|m| *m = (turn(*m) * scale + to).as_vec3().to_array());
    guest.log_scales.iter_mut().flatten().for_each(|s| *s += (how.scale as f32).ln());
    for r in &mut guest.rotations {
        let [w, x, y, z] = r.map(f64::from);
        let turned = q * DQuat::from_xyzw(x, y, z, w);
        *r = [turned.w, turned.x, turned.y, turned.z].map(|v| v as f32);
    }
    guest.normals.iter_mut().flatten().for_each(|n| *n = turn(*n).as_vec3().to_array());
    let harmonics = Rotation::of(q);
    guest.sh.iter_mut().enumerate().skip(1).for_each(|(band, c)| harmonics.turn(band, c));
    guest
}

/// Appends the splats of a guest to a host.
///
/// Missing guest data is derived: normals are the shortest axes, albedo is the color. Guest data that the host lacks
/// is dropped, except for metallic. Guests emit nothing. The host's filter against aliasing holds for both.
pub fn join(host: &mut Splats, mut guest: Splats) {
    if host.antialiased != guest.antialiased && !guest.is_empty() {
        tracing::warn!(
            "The inserted splats were trained for another filter against aliasing; thin ones may look different."
        );
    }
    let (old, new) = (host.len(), guest.len());
    let degree = host.sh_degree().max(guest.sh_degree());
    for band in 0..=degree {
        let floats = 3 * (2 * band + 1);
        host.sh[band].resize(old * floats, 0.0);
        guest.sh[band].resize(new * floats, 0.0);
        host.sh[band].append(&mut guest.sh[band]);
    }
    if host.normals.is_some() {
        let own = guest.normals.take().unwrap_or_else(|| thinnest(&guest));
        host.normals.iter_mut().for_each(|n| n.extend(&own));
    }
    if let Some(albedo) = &mut host.albedo {
        let first = old * 3;
        let color = |i: usize| {
            let c = |k: usize| 0.5 + CONSTANT as f32 * host.sh[0][first + 3 * i + k];
            [0, 1, 2].map(|k| raw(srgb_to_linear(c(k).clamp(0.0, 1.0))))
        };
        albedo.extend(guest.albedo.take().unwrap_or_else(|| (0..new).map(color).collect()));
    }
    if let Some(roughness) = &mut host.roughness {
        roughness.extend(guest.roughness.take().unwrap_or_else(|| vec![raw_roughness(ROUGHNESS); new]));
    }
    if host.metallic.is_some() || guest.metallic.is_some() && host.albedo.is_some() {
        let metallic = host.metallic.get_or_insert_with(|| vec![raw_metallic(0.0); old]);
        metallic.extend(guest.metallic.take().unwrap_or_else(|| vec![raw_metallic(0.0); new]));
    }
    if let Some((channels, values)) = &mut host.semantic {
        match guest.semantic.take().filter(|(c, _)| c == channels) {
            Some((_, own)) => values.extend(own),
            None => values.resize((old + new) * *channels, 0.0),
        }
    }
    if let Some(emitters) = &mut host.emitters {
        emitters.resize(old + new, 0);
    }
    if let Some(gains) = &mut host.light_gains {
        gains.resize(old + new, 1.0);
    }
    host.means.append(&mut guest.means);
    host.log_scales.append(&mut guest.log_scales);
    host.rotations.append(&mut guest.rotations);
    host.opacity_logits.append(&mut guest.opacity_logits);
}

/// Returns the shortest axis of each splat, oriented away from the mean position.
fn thinnest(s: &Splats) -> Vec<[f32; 3]> {
    let center = |m: &[f32; 3]| DVec3::from(m.map(f64::from));
    let middle = s.means.iter().map(center).sum::<DVec3>() / s.len().max(1) as f64;
    let normal = |i: usize| {
        let scales = s.log_scales[i];
        let axis = (0..3).fold(0, |least, k| if scales[k] < scales[least] { k } else { least });
        let [w, x, y, z] = s.rotations[i].map(f64::from);
        let n = (DQuat::from_xyzw(x, y, z, w).normalize() * DVec3::AXES[axis]).normalize_or_zero();
        let outward = n.dot(center(&s.means[i]) - middle) >= 0.0;
        (if outward { n } else { -n }).as_vec3().to_array()
    };
    (0..s.len()).map(normal).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::materials::{roughness_value, value};

    fn one() -> Splats {
        Splats {
            means: vec![[1.0, 0.0, 0.0]],
            log_scales: vec![[0.0, -1.0, 1.0]],
            rotations: vec![[1.0, 0.0, 0.0, 0.0]],
            opacity_logits: vec![2.0],
            sh: [vec![1.0, 0.0, -1.0], vec![1.0; 9], Vec::new(), Vec::new()],
            normals: Some(vec![[1.0, 0.0, 0.0]]),
            ..Default::default()
        }
    }

    #[test]
    fn guests_are_scaled_rotated_and_translated() {
        // A rotation of 90° about z, scale 2, translation 1 along z.
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let how = Placement { scale: 2.0, rotation: [half, 0.0, 0.0, half], translation: [0.0, 0.0, 1.0] };
        let guest = placed(one(), &how);
        let near = |a: &[f32], b: &[f32]| assert!(a.iter().zip(b).all(|(x, y)| (x - y).abs() < 1e-6), "{a:?} {b:?}");
        near(&guest.means[0], &[0.0, 2.0, 1.0]);
        near(&guest.log_scales[0], &[2f32.ln(), 2f32.ln() - 1.0, 2f32.ln() + 1.0]);
        near(&guest.rotations[0], &[half as f32, 0.0, 0.0, half as f32]);
        near(&guest.normals.unwrap()[0], &[0.0, 1.0, 0.0]);
        // The basis is -y, z, -x. Coefficients 1 are the vector (-1, -1, 1). Rotated, it is (1, -1, 1): coefficients
        // (1, 1, -1).
        near(&guest.sh[1][..9], &[1.0, 1.0, 1.0, 1.0, 1.0, 1.0, -1.0, -1.0, -1.0]);
    }

    #[test]
    fn missing_guest_data_is_derived() {
        let mut host = Splats {
            albedo: Some(vec![[0.0; 3]]),
            roughness: Some(vec![0.0]),
            semantic: Some((2, vec![1.0, 2.0])),
            emitters: Some(vec![3]),
            ..one()
        };
        let guest = Splats {
            normals: None,
            metallic: Some(vec![3.0]),
            sh: [vec![0.0; 3], vec![], vec![], vec![]],
            emitters: Some(vec![1]),
            ..one()
        };
        join(&mut host, guest);
        assert!(host.check().is_ok());
        assert_eq!((host.len(), host.sh[1].len()), (2, 18));
        assert_eq!(host.emitters, Some(vec![3, 0]), "guests emit nothing");
        assert_eq!(host.normals.unwrap()[1], [0.0, 1.0, 0.0]);
        assert!((value(host.albedo.unwrap()[1][0]) - srgb_to_linear(0.5)).abs() < 1e-5);
        assert!((roughness_value(host.roughness.unwrap()[1]) - 0.5).abs() < 1e-5);
        assert_eq!((host.metallic.unwrap()[1], host.semantic.unwrap().1), (3.0, vec![1.0, 2.0, 0.0, 0.0]));
    }
}
