//! Normals of depth maps, for priors.

use glam::DVec3;

use crate::camera::{Camera, Distortion};
use crate::error::{Result, SceneError};
use crate::image::Image;
use crate::prior_settings::DepthMeaning;
use crate::scene::Scene;

/// Largest second difference of inverse depth between neighbors.
///
/// It is relative to the inverse depth. Inverse depth is linear in the pixels of a plane, whatever its slope, so that the
/// difference is that of the surface from a plane. Depths that jump by this share are edges.
const EDGE: f64 = 0.03;

impl Scene {
    /// Returns the normals of a view's depth: unit vectors in the camera's frame (x right, y down, z forward), zero where
    /// they are unknown. Returns `None` if the view has no depth.
    ///
    /// The map has the size and the distortion of the depth map, as files in `priors/normal` have. Depth is that of
    /// [`Scene::depth_prior`]. A factor of depth leaves normals as they are. A normal is perpendicular to the differences
    /// of the points `step` pixels to both sides, and faces the camera. It is unknown where a depth is, and at edges.
    ///
    /// # Errors
    /// Fails if the file is damaged, or depths have an unknown shift, which normals depend on.
    pub fn normals_of_depth(&self, view: usize, step: usize) -> Result<Option<Image>> {
        let view = self.view(view)?;
        let Some((path, depth)) = self.stored_depth(view)? else { return Ok(None) };
        if self.depth_meaning() == DepthMeaning::InverseScaleShift {
            let problem = "inverse depths with an unknown shift have no normals; use metric depths, or depths up to a \
                           factor";
            return Err(SceneError::image(&path, problem));
        }
        let camera = view.stored_camera.scaled(depth.width, depth.height);
        Ok(Some(normals(&depth, &camera, &view.distortion, step.max(1))))
    }
}

/// Returns the normals of depths along the axis of a camera with a lens. Zero depths are unknown.
fn normals(depth: &Image, camera: &Camera, lens: &Distortion, step: usize) -> Image {
    let (width, height) = (depth.width as usize, depth.height as usize);
    let ray = |x: usize, y: usize| {
        let at = [(x as f64 + 0.5 - camera.cx) / camera.fx, (y as f64 + 0.5 - camera.cy) / camera.fy];
        lens.undistort(at[0], at[1]).map(|(x, y)| DVec3::new(x, y, 1.0))
    };
    let z = |x: usize, y: usize| f64::from(depth.data[y * width + x]);
    let known = |z: f64| z > 0.0 && z.is_finite();
    let points: Vec<Option<DVec3>> = (0..width * height)
        .map(|at| (at % width, at / width))
        .map(|(x, y)| if known(z(x, y)) { ray(x, y).map(|ray| ray * z(x, y)) } else { None })
        .collect();
    let mut out = Image::new(depth.width, depth.height, 3);
    for y in step..height.saturating_sub(step) {
        for x in step..width.saturating_sub(step) {
            let at = |x: usize, y: usize| points[y * width + x];
            let (left, right) = (at(x - step, y), at(x + step, y));
            let (above, below) = (at(x, y - step), at(x, y + step));
            let (Some(here), Some(left), Some(right), Some(above), Some(below)) = (at(x, y), left, right, above, below)
            else {
                continue;
            };
            let bend = |a: DVec3, b: DVec3| (here.z / a.z + here.z / b.z - 2.0).abs();
            if bend(left, right) > EDGE || bend(above, below) > EDGE {
                continue;
            }
            let normal = (right - left).cross(below - above).normalize_or_zero();
            let facing = if normal.dot(here) > 0.0 { -normal } else { normal };
            out.pixel_mut(x as u32, y as u32).copy_from_slice(&facing.as_vec3().to_array());
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Projection;
    use crate::camera::tests::camera;

    /// Returns the depths of two planes as a camera with this lens sees them.
    ///
    /// A plane is `n · p = -distance`. The first is in the left half.
    fn depths(camera: &Camera, lens: &Distortion, planes: [(DVec3, f64); 2]) -> Image {
        let mut depth = Image::new(camera.width, camera.height, 1);
        for y in 0..camera.height {
            for x in 0..camera.width {
                let nx = (f64::from(x) + 0.5 - camera.cx) / camera.fx;
                let ny = (f64::from(y) + 0.5 - camera.cy) / camera.fy;
                let Some((nx, ny)) = lens.undistort(nx, ny) else { continue };
                let (normal, distance) = planes[usize::from(2 * x >= camera.width)];
                depth.pixel_mut(x, y)[0] = (-distance / normal.dot(DVec3::new(nx, ny, 1.0))) as f32;
            }
        }
        depth
    }

    #[test]
    fn normals_of_planes_are_exact_up_to_their_edge() {
        let camera = camera();
        let planes = [(DVec3::new(0.3, -0.2, -0.9).normalize(), 1.0), (DVec3::new(-0.1, 0.5, -0.8).normalize(), 2.0)];
        for lens in [
            Distortion::NONE,
            Distortion { k1: 0.1, k2: -0.05, p1: 0.003, ..Distortion::NONE },
            Distortion { projection: Projection::Equidistant, ..Distortion::NONE },
        ] {
            let mut depth = depths(&camera, &lens, planes);
            *depth.pixel_mut(20, 30).first_mut().unwrap() = 0.0;
            for step in [1, 3] {
                let found = normals(&depth, &camera, &lens, step);
                for y in 0..camera.height {
                    for x in 0..camera.width {
                        let n = found.pixel(x, y);
                        let n = DVec3::new(f64::from(n[0]), f64::from(n[1]), f64::from(n[2]));
                        let s = step as u32;
                        let border = x < s || y < s || x + s >= camera.width || y + s >= camera.height;
                        let edge = (x as f64 + 0.5 - 80.0).abs() < step as f64;
                        let (dx, dy) = (x.abs_diff(20), y.abs_diff(30));
                        let hole = (dx == 0 && (dy == 0 || dy == s)) || (dy == 0 && dx == s);
                        let expected = planes[usize::from(2 * x >= camera.width)].0;
                        if border || edge || hole {
                            assert_eq!(n, DVec3::ZERO, "{lens:?} {x} {y}");
                        } else {
                            assert!(n.distance(expected) < 2e-3 / step as f64, "{lens:?} {x} {y}: {n} {expected}");
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn small_maps_have_no_normals() {
        let depth = Image::from_data(2, 1, 1, vec![1.0, f32::NAN]).unwrap();
        let found = normals(&depth, &camera().scaled(2, 1), &Distortion::NONE, 1);
        assert!(found.data.iter().all(|v| *v == 0.0));
    }
}
