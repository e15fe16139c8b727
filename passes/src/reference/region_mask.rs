//! References of `region_mask` and `carry_mask`.

use super::project::Camera;
use glam::DVec2;

/// Valid range of depths. Within this range, single precision neither overflows nor underflows.
pub const DEPTHS: std::ops::RangeInclusive<f64> = 1e-15..=1e15;

/// View with blended depths, before division by opacity.
#[derive(Clone, Debug)]
pub struct View {
    /// Camera of the view.
    pub camera: Camera,
    /// Sum of weights times z, per pixel.
    pub depth: Vec<f64>,
    /// Transmittance, per pixel.
    pub transmittance: Vec<f64>,
}

/// Membership of a pseudo-view's pixel in the region, and its margin. The margin is the distance to the next value at
/// which the membership changes. Borders of pixels count in pixels of the training view, depth and opacity as a
/// relative or absolute difference.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Carried {
    /// Whether the pixel is in the region.
    pub inside: bool,
    /// Distance to the nearest decision threshold.
    pub margin: f64,
}

impl View {
    /// Returns a pixel's depth, if any, and its opacity's distance from the threshold.
    fn depth_of(&self, pixel: usize, least_opacity: f64) -> (Option<f64>, f64) {
        let (blended, left) = (self.depth[pixel], self.transmittance[pixel]);
        if !blended.is_finite() || !left.is_finite() {
            return (None, f64::INFINITY);
        }
        let opacity = 1.0 - left;
        let depth = blended / opacity;
        let there = opacity >= least_opacity && DEPTHS.contains(&depth);
        (there.then_some(depth), (opacity - least_opacity).abs())
    }
}

/// Returns the pixels that have the region's id.
pub fn region_mask(ids: &[u16], region: u32) -> Vec<bool> {
    ids.iter().map(|&id| id != 0 && u32::from(id) == region).collect()
}

/// Returns the pseudo-view's pixels that show the surface marked by `mask`. `mask` belongs to the training view.
pub fn carry_mask(trained: &View, mask: &[bool], pseudo: &View, least_opacity: f64, tolerance: f64) -> Vec<Carried> {
    let (from, to) = (&pseudo.camera, &trained.camera);
    let size = to.size.map(f64::from);
    let mut carried = Vec::new();
    for pixel in 0..pseudo.depth.len() {
        let (depth, mut margin) = pseudo.depth_of(pixel, least_opacity);
        let mut one = |inside: bool, margin: f64| carried.push(Carried { inside, margin });
        let Some(depth) = depth else {
            one(false, margin);
            continue;
        };
        let [x, y] = [pixel as u32 % from.size[0], pixel as u32 / from.size[0]].map(|i| f64::from(i) + 0.5);
        let ray = from.slope(DVec2::new(x, y)).extend(1.0);
        let world = from.rotation.inverse() * (ray * depth - from.translation);
        let p = to.rotation * world + to.translation;
        if !p.is_finite() || p.z < to.near.max(*DEPTHS.start()) {
            one(false, margin.min((p.z - to.near).abs()));
            continue;
        }
        margin = margin.min(p.z - to.near);
        let at = (to.distorted(to.focal * p.truncate() / p.z).0 + to.center).to_array();
        // Every border between pixels is a threshold, including those of the image.
        margin = at.iter().fold(margin, |m, a| m.min((a - a.round()).abs()));
        if !(0..2).all(|k| at[k] >= 0.0 && at[k] < size[k]) {
            one(false, margin);
            continue;
        }
        let there = at[1] as usize * to.size[0] as usize + at[0] as usize;
        if !mask[there] {
            one(false, margin);
            continue;
        }
        let (other, sure) = trained.depth_of(there, least_opacity);
        margin = margin.min(sure);
        let Some(other) = other else {
            one(false, margin);
            continue;
        };
        let apart = (p.z - other).abs() / other;
        one(apart <= tolerance, margin.min((apart - tolerance).abs()));
    }
    carried
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DMat3, DVec2, DVec3};

    /// Returns a camera at (x, 0, 0) that looks along z at a wall at depth 2.
    fn before_a_wall(x: f64) -> View {
        let camera = Camera {
            rotation: DMat3::IDENTITY,
            translation: DVec3::new(-x, 0.0, 0.0),
            focal: DVec2::splat(4.0),
            center: DVec2::new(4.0, 1.0),
            size: [8, 2],
            near: 0.1,
            radial: 0.0,
        };
        View { camera, depth: vec![2.0; 16], transmittance: vec![0.0; 16] }
    }

    #[test]
    fn sideways_camera_motion_moves_the_region_by_the_disparity() {
        let mut mask = vec![false; 16];
        mask[3] = true;
        mask[4] = true;
        // 0.5 to the right at depth 2 with focal length 4 is one pixel to the left.
        let moved = carry_mask(&before_a_wall(0.0), &mask, &before_a_wall(0.5), 0.5, 0.03);
        let inside: Vec<usize> = (0..16).filter(|&p| moved[p].inside).collect();
        assert_eq!(inside, [2, 3]);
        assert!((moved[2].margin - 0.03).abs() < 1e-12);
    }

    #[test]
    fn hidden_pixels_and_pixels_without_depth_are_outside() {
        let (mut trained, mut pseudo) = (before_a_wall(0.0), before_a_wall(0.0));
        trained.depth[1] = 1.9;
        trained.depth[2] = 2.05;
        pseudo.transmittance[3] = 0.6;
        pseudo.depth[4] = f64::NAN;
        trained.depth[5] = f64::INFINITY;
        trained.transmittance[6] = 0.9;
        let carried = carry_mask(&trained, &[true; 16], &pseudo, 0.5, 0.03);
        let outside: Vec<usize> = (0..16).filter(|&p| !carried[p].inside).collect();
        assert_eq!(outside, [1, 3, 4, 5, 6]);
    }

    #[test]
    fn id_zero_is_no_region() {
        assert_eq!(region_mask(&[0, 1, 2, 1], 1), [false, true, false, true]);
        assert_eq!(region_mask(&[0, 1], 0), [false; 2]);
    }
}
