//! Emitters found in photographs: surfaces that clip in every view that shows them.
//!
//! A window or a bulb is brighter than the camera records. All channels of its pixels clip, in every view that shows it. A
//! highlight clips in few views, and only some pixels of a lit wall clip.
//!
//! Pixels are sorted into cells by position. Neighboring cells most of whose pixels clip form a group. A group that two
//! views see is a candidate. The fit to the photographs ([`crate::fit`]) decides whether a candidate shines, and its color.
//!
//! A large and flat group becomes a rectangle, which shines to the side of the cameras. Any other group becomes a sphere.

use crate::surfels::seen;
use glam::{DMat3, DVec3, Vec3};
use sgs_passes::pipeline::Shaded;
use sgs_passes::transport::LightShape;
use sgs_scene::Image;
use std::collections::BTreeMap;

/// Minimum display value of a clipped channel. A pixel clips if all channels do.
pub(crate) const CLIPPED: f32 = 0.98;
/// Share of its pixels that must clip for a cell to be bright.
const LEAST_SHARE: f64 = 0.5;
/// Minimum number of clipped pixels of a bright cell.
const LEAST_CLIPPED: u32 = 4;
/// Minimum number of clipped pixels of a group.
const LEAST_PIXELS: usize = 8;
/// Minimum number of views that see a group.
const LEAST_VIEWS: usize = 2;
/// Squared maximum distance of the centers of joined cells, in edges of a cell.
const JOINED: i32 = 3;
/// Minimum ratio of the second to the smallest spread of a flat group.
///
/// Spreads are the standard deviations of a group's points along their principal axes.
const FLAT: f64 = 2.0;
/// Minimum longest spread of a rectangle, in edges of a cell: smaller groups are bulbs.
const LARGE: f64 = 1.5;

/// Candidate for an emitter.
#[derive(Clone, Debug, PartialEq)]
pub struct FoundEmitter {
    /// Shape, in the unit of [`find_emitters`].
    pub shape: LightShape,
    /// Number of clipped pixels.
    pub pixels: usize,
    /// Number of views with clipped pixels of the emitter.
    pub views: usize,
    /// Cells of the emitter, sorted.
    ///
    /// A cell is the floor of a point divided by the edge given to [`find_emitters`].
    pub cells: Vec<[i32; 3]>,
}

/// Clipped pixel of a group.
struct Bright {
    point: DVec3,
    normal: DVec3,
    view: usize,
}

#[derive(Default)]
struct Cell {
    count: u32,
    bright: Vec<Bright>,
}

impl Cell {
    fn is_bright(&self) -> bool {
        let clipped = self.bright.len() as u32;
        clipped >= LEAST_CLIPPED && f64::from(clipped) > LEAST_SHARE * f64::from(self.count)
    }
}

/// Returns whether a pixel of a display-referred image is clipped.
pub(crate) fn is_clipped(photograph: &Image, pixel: usize) -> bool {
    photograph.data[3 * pixel..3 * pixel + 3].iter().all(|v| *v >= CLIPPED)
}

/// Returns the cell in which a point lies.
pub fn cell_of(point: [f32; 3], edge: f32) -> [i32; 3] {
    point.map(|v| (v / edge).floor() as i32)
}

/// Finds candidates for emitters in photographs.
///
/// `views`, `photographs` and `from`, the positions of the cameras, belong together. Photographs hold display values and have
/// the sizes of the views. Points of views and positions are in world units. The result and `edge`, the edge of a cell, are in
/// units of `unit` world units. The largest candidate comes first.
pub fn find_emitters(
    views: &[Shaded],
    photographs: &[Image],
    from: &[[f32; 3]],
    unit: f32,
    edge: f32,
) -> Vec<FoundEmitter> {
    let mut cells: BTreeMap<[i32; 3], Cell> = BTreeMap::new();
    for (i, ((view, photograph), from)) in views.iter().zip(photographs).zip(from).enumerate() {
        for pixel in 0..view.coverage.len() {
            let Some(s) = seen(view, pixel, Vec3::from(*from), unit) else { continue };
            let cell = cells.entry(cell_of(s.point.into(), edge)).or_default();
            cell.count += 1;
            if is_clipped(photograph, pixel) {
                cell.bright.push(Bright { point: s.point.as_dvec3(), normal: s.normal.as_dvec3(), view: i });
            }
        }
    }
    cells.retain(|_, cell| cell.is_bright());
    let mut found: Vec<FoundEmitter> = groups(&cells).iter().filter_map(|group| emitter(group, &cells, edge)).collect();
    found.sort_by_key(|e| std::cmp::Reverse(e.pixels));
    found
}

/// Joins neighboring cells to groups.
fn groups(cells: &BTreeMap<[i32; 3], Cell>) -> Vec<Vec<[i32; 3]>> {
    let mut open: std::collections::BTreeSet<[i32; 3]> = cells.keys().copied().collect();
    let mut all = Vec::new();
    while let Some(first) = open.pop_first() {
        let (mut group, mut next) = (Vec::new(), vec![first]);
        while let Some([x, y, z]) = next.pop() {
            group.push([x, y, z]);
            for offset in 0..27 {
                let [dx, dy, dz] = [offset % 3 - 1, offset / 3 % 3 - 1, offset / 9 - 1];
                let beside = [x + dx, y + dy, z + dz];
                if dx * dx + dy * dy + dz * dz <= JOINED && open.remove(&beside) {
                    next.push(beside);
                }
            }
        }
        group.sort_unstable();
        all.push(group);
    }
    all
}

/// Returns the candidate of a group of cells, if enough pixels and views show it.
fn emitter(group: &[[i32; 3]], cells: &BTreeMap<[i32; 3], Cell>, edge: f32) -> Option<FoundEmitter> {
    let bright: Vec<&Bright> = group.iter().filter_map(|key| cells.get(key)).flat_map(|c| &c.bright).collect();
    let views: std::collections::BTreeSet<usize> = bright.iter().map(|b| b.view).collect();
    if bright.len() < LEAST_PIXELS || views.len() < LEAST_VIEWS {
        return None;
    }
    let shape = shape(&bright, f64::from(edge));
    Some(FoundEmitter { shape, pixels: bright.len(), views: views.len(), cells: group.to_vec() })
}

/// Returns the rectangle or sphere around the clipped pixels of a group.
fn shape(bright: &[&Bright], edge: f64) -> LightShape {
    let median = |axis: usize| {
        let mut values: Vec<f64> = bright.iter().map(|b| b.point[axis]).collect();
        values.sort_unstable_by(f64::total_cmp);
        values[values.len() / 2]
    };
    let center = DVec3::new(median(0), median(1), median(2));
    let mut spread = DMat3::ZERO;
    for b in bright {
        let d = b.point - center;
        spread += DMat3::from_cols(d * d.x, d * d.y, d * d.z);
    }
    let (axes, squares) = eigen(spread * (1.0 / bright.len() as f64));
    let [longest, second, smallest] = squares.map(|s| s.max(0.0).sqrt());
    if longest < LARGE * edge || second < FLAT * smallest {
        let radius = (0.5 * (longest + second)).clamp(0.25 * edge, 2.0 * edge);
        return LightShape::Sphere { center: center.as_vec3().into(), radius: radius as f32 };
    }
    // Visible normals point to the cameras' side.
    let seen_from: DVec3 = bright.iter().map(|b| b.normal).sum();
    let out = if axes[2].dot(seen_from) < 0.0 { -axes[2] } else { axes[2] };
    // The smallest of the rectangles around the points in the plane, in steps of 2 degrees. On each side a hundredth of the
    // points lies outside.
    let points: Vec<[f64; 2]> =
        bright.iter().map(|b| [axes[0].dot(b.point - center), axes[1].dot(b.point - center)]).collect();
    let mut best: Option<(f64, DVec3, [[f64; 2]; 2])> = None;
    for step in 0..45 {
        let (sin, cos) = (f64::from(step) * 2.0).to_radians().sin_cos();
        let side = |along: [f64; 2]| {
            let mut values: Vec<f64> = points.iter().map(|p| p[0] * along[0] + p[1] * along[1]).collect();
            values.sort_unstable_by(f64::total_cmp);
            let outside = values.len() / 100;
            [values[outside], values[values.len() - 1 - outside]]
        };
        let sides = [side([cos, sin]), side([-sin, cos])];
        let area = (sides[0][1] - sides[0][0]) * (sides[1][1] - sides[1][0]);
        if best.is_none_or(|b| area < b.0) {
            best = Some((area, axes[0] * cos + axes[1] * sin, sides));
        }
    }
    let (_, u, sides) = best.unwrap_or((0.0, axes[0], [[-edge, edge]; 2]));
    let v = out.cross(u);
    // `v` may be opposite to the second side's direction. Only the middle depends on the sign.
    let second = (axes[2].cross(u)).dot(v).signum();
    let [middle_u, middle_v] = sides.map(|[low, high]| 0.5 * (low + high));
    let center = center + u * middle_u + v * (second * middle_v);
    let [half_u, half_v] = sides.map(|[low, high]| 0.5 * (high - low));
    LightShape::Rectangle {
        corner: (center - u * half_u - v * half_v).as_vec3().into(),
        edge_u: (u * (2.0 * half_u)).as_vec3().into(),
        edge_v: (v * (2.0 * half_v)).as_vec3().into(),
    }
}

/// Returns the eigenvectors and eigenvalues of a symmetric matrix, largest first.
///
/// By Jacobi rotations. The eigenvectors are a right-handed frame.
fn eigen(mut m: DMat3) -> ([DVec3; 3], [f64; 3]) {
    let mut turn = DMat3::IDENTITY;
    for _ in 0..32 {
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            let off = m.col(q)[p];
            if off.abs() < 1e-300 {
                continue;
            }
            let theta = 0.5 * (2.0 * off).atan2(m.col(q)[q] - m.col(p)[p]);
            let (sin, cos) = theta.sin_cos();
            let mut rotation = DMat3::IDENTITY;
            rotation.col_mut(p)[p] = cos;
            rotation.col_mut(q)[q] = cos;
            rotation.col_mut(q)[p] = sin;
            rotation.col_mut(p)[q] = -sin;
            m = rotation.transpose() * m * rotation;
            turn *= rotation;
        }
    }
    let mut order = [0, 1, 2];
    order.sort_by(|a, b| m.col(*b)[*b].total_cmp(&m.col(*a)[*a]));
    let [a, b, _] = order.map(|i| turn.col(i).normalize());
    ([a, b, a.cross(b)], order.map(|i| m.col(i)[i]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surfels::tests::wall;

    /// Returns photographs of a wall whose pixels clip where `bright` says so.
    fn photograph(size: u32, bright: impl Fn(u32, u32) -> bool) -> Image {
        let value = |i: u32| if bright(i % size, i / size) { 1.0 } else { 0.5 };
        Image { width: size, height: size, channels: 3, data: (0..size * size).flat_map(|i| [value(i); 3]).collect() }
    }

    #[test]
    fn eigenvectors_of_a_symmetric_matrix() {
        let m = DMat3::from_cols(DVec3::new(4.0, 1.0, 0.5), DVec3::new(1.0, 3.0, -0.2), DVec3::new(0.5, -0.2, 1.0));
        let (axes, values) = eigen(m);
        for (axis, value) in axes.iter().zip(values) {
            assert!((m * *axis - *axis * value).length() < 1e-12, "{axis} {value}");
        }
        assert!(values[0] > values[1] && values[1] > values[2]);
    }

    #[test]
    fn window_in_a_wall_is_a_rectangle_toward_the_views() {
        let views = [wall(64, 1.0, 80.0, [0.5; 3]), wall(64, 1.0, 80.0, [0.5; 3])];
        let window = |x: u32, y: u32| (10..40).contains(&x) && (20..32).contains(&y);
        let photographs = [photograph(64, window), photograph(64, window)];
        let found = find_emitters(&views, &photographs, &[[0.0; 3]; 2], 1.0, 3.0);
        assert_eq!(found.len(), 1);
        // Cells on the border are left out if most of their pixels do not clip.
        assert!((600..=720).contains(&found[0].pixels) && found[0].views == 2, "{:?}", found[0]);
        let LightShape::Rectangle { corner, edge_u, edge_v } = found[0].shape else { panic!("{:?}", found[0].shape) };
        let (u, v) = (Vec3::from(edge_u), Vec3::from(edge_v));
        let center = Vec3::from(corner) + 0.5 * (u + v);
        assert!(center.distance(Vec3::new(25.0 - 32.0, 26.0 - 32.0, 80.0)) < 1.0, "{center:?}");
        assert!((u.length() - 30.0).abs() < 3.0 && (v.length() - 12.0).abs() < 3.0, "{u} {v}");
        assert!(u.cross(v).normalize().z < -0.99, "it shines toward the camera");
    }

    #[test]
    fn small_group_is_a_sphere() {
        let views = [wall(64, 1.0, 80.0, [0.5; 3]), wall(64, 1.0, 80.0, [0.5; 3])];
        let bulb = |x: u32, y: u32| (30..36).contains(&x) && (30..36).contains(&y);
        let photographs = [photograph(64, bulb), photograph(64, bulb)];
        let found = find_emitters(&views, &photographs, &[[0.0; 3]; 2], 1.0, 3.0);
        assert!(matches!(found[..], [FoundEmitter { shape: LightShape::Sphere { .. }, pixels: 8.., .. }]), "{found:?}");
    }

    #[test]
    fn highlight_in_one_view_is_no_emitter() {
        let views = [wall(64, 1.0, 80.0, [0.5; 3]), wall(64, 1.0, 80.0, [0.5; 3])];
        let bright = |x: u32, y: u32| (30..40).contains(&x) && (30..40).contains(&y);
        let photographs = [photograph(64, bright), photograph(64, |_, _| false)];
        assert!(find_emitters(&views, &photographs, &[[0.0; 3]; 2], 1.0, 3.0).is_empty());
    }
}
