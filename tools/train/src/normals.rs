//! Initial normals of the Gaussians.
//!
//! A normal of zero has no direction: its first gradient is about a thousand times the later ones. Adam's second moment
//! would then hold the normal still for thousands of steps. So each Gaussian starts with the normal priors at the
//! pixels that it projects to. Without a prior there, the normal points to the nearest camera.

use glam::{DVec3, Vec3};
use rayon::prelude::*;
use sgs_passes::loss::octahedral_decode;
use sgs_scene::Camera;

/// Training view: its camera, and its prior as packed for the device.
pub(crate) type Prior<'a> = (&'a Camera, &'a [u32]);

/// Returns initial unit normals for positions.
/// Each normal is the direction of the summed priors of all views whose image contains the position. Occlusion is
/// ignored: views that a wall hides from the position are few, and the sum is only a start.
pub(crate) fn initial_normals(means: &[[f32; 3]], views: &[Prior<'_>]) -> Vec<[f32; 3]> {
    means.par_iter().map(|&p| initial_normal(Vec3::from(p).as_dvec3(), views).as_vec3().to_array()).collect()
}

fn initial_normal(p: DVec3, views: &[Prior<'_>]) -> DVec3 {
    let mut sum = DVec3::ZERO;
    let mut nearest = DVec3::Z;
    let mut least = f64::INFINITY;
    for (camera, prior) in views {
        let way = camera.position() - p;
        if way.length_squared() > 0.0 && way.length_squared() < least {
            (nearest, least) = (way.normalize(), way.length_squared());
        }
        let Some(at) = camera.project(p).filter(|at| at.x >= 0.0 && at.y >= 0.0) else { continue };
        let (x, y) = (at.x as usize, at.y as usize);
        if x >= camera.width as usize || y >= camera.height as usize {
            continue;
        }
        let direction = prior.get(y * camera.width as usize + x).and_then(|n| octahedral_decode(*n));
        // A prior that faces away from the camera belongs to another surface.
        sum += direction.map(DVec3::from).filter(|n| n.dot(way) > 0.0).unwrap_or(DVec3::ZERO);
    }
    sum.try_normalize().unwrap_or(nearest)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DMat3;
    use sgs_passes::loss::octahedral_encode;

    fn camera(z: f64) -> Camera {
        Camera {
            name: "000".into(),
            width: 4,
            height: 4,
            fx: 4.0,
            fy: 4.0,
            cx: 2.0,
            cy: 2.0,
            rotation: DMat3::IDENTITY,
            translation: DVec3::new(0.0, 0.0, -z),
            near: sgs_scene::NEAR,
        }
    }

    #[test]
    fn priors_determine_normals_inside_the_image() {
        let near = camera(0.0);
        let mut prior = vec![0; 16];
        prior[2 * 4 + 2] = octahedral_encode([0.6, 0.0, -0.8]);
        // Faces away from the camera, so this prior is ignored.
        prior[2 * 4 + 3] = octahedral_encode([0.0, 0.0, 1.0]);
        let views = [(&near, &prior[..])];
        let normals = initial_normals(&[[0.1, 0.1, 2.0], [0.9, 0.1, 2.0], [9.0, 0.0, 2.0], [0.0, 0.0, -1.0]], &views);
        let apart = |a: [f32; 3], b: [f64; 3]| (Vec3::from(a).as_dvec3() - DVec3::from(b)).length();
        assert!(apart(normals[0], [0.6, 0.0, -0.8]) < 1e-3, "{normals:?}");
        let way = |p: DVec3| (-p).normalize().to_array();
        assert!(apart(normals[1], way(DVec3::new(0.9, 0.1, 2.0))) < 1e-6, "nothing but the other side: {normals:?}");
        assert!(apart(normals[2], way(DVec3::new(9.0, 0.0, 2.0))) < 1e-6, "beside the image: {normals:?}");
        assert!(apart(normals[3], [0.0, 0.0, 1.0]) < 1e-6, "behind the camera: {normals:?}");
        assert!(apart(initial_normals(&[[0.0; 3]], &views)[0], [0.0, 0.0, 1.0]) < 1e-6, "in the camera");
        // Two views: the normal is the direction of the sum.
        let far = camera(-1.0);
        let mut other = vec![0; 16];
        other[2 * 4 + 2] = octahedral_encode([-0.6, 0.0, -0.8]);
        let both = initial_normals(&[[0.1, 0.1, 2.0]], &[(&near, &prior), (&far, &other)]);
        assert!(apart(both[0], [0.0, 0.0, -1.0]) < 1e-3, "{both:?}");
    }
}
