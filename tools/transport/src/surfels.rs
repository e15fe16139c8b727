//! Surfels of a room, clustered from the surfaces that its views show.
//!
//! A surfel is a disc with a normal and a material. Pixels with a surface are sorted into cells by position and by the
//! rounded components of their normal. A cell becomes one surfel, the mean of its pixels. Gaussians that every view hides
//! behind others leave no surfel. Surfels are one-sided: the two sides of a thin wall lie in different cells, as their
//! normals differ.
//!
//! Guarantees: the result does not depend on the number of threads, and surfels are sorted by cell.

use glam::{DVec3, Vec3};
use sgs_passes::pipeline::Shaded;
use sgs_passes::transport::Surfels;
use std::collections::BTreeMap;

/// Minimum opacity of a pixel with a reliable surface.
const LEAST_COVERAGE: f32 = 0.5;
/// Minimum cosine between normal and direction to the camera.
const LEAST_FACING: f32 = 0.05;
/// Minimum number of pixels of a surfel.
const LEAST_PIXELS: u32 = 3;
/// Initial edge of a cell, as a share of the diagonal of the seen surfaces.
const CELL_SHARE: f32 = 0.011;
/// Radius of a surfel in edges of a cell. Discs of neighboring cells overlap, so that walls have no gaps.
const RADIUS: f32 = 0.75;
/// Maximum number of pixels that are clustered; of larger sets of views, every n-th pixel is.
const MOST_PIXELS: usize = 1 << 21;

/// Options of [`RoomSurfels::cluster`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SurfelOptions {
    /// Maximum number of surfels. Cells grow until it holds.
    pub most: usize,
}

impl Default for SurfelOptions {
    fn default() -> SurfelOptions {
        SurfelOptions { most: 8192 }
    }
}

/// Surfels with materials.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RoomSurfels {
    /// Discs.
    pub discs: Surfels,
    /// Material of each surfel.
    pub materials: Vec<SurfelMaterial>,
    /// Edge of a cell.
    pub cell: f32,
    /// Corners of the box of the seen surfaces.
    ///
    /// On each side of an axis, a thousandth of the points lies outside.
    pub bounds: [[f32; 3]; 2],
}

/// Material of a surfel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SurfelMaterial {
    /// Linear albedo.
    pub albedo: [f32; 3],
    /// Roughness.
    pub roughness: f32,
    /// Metallic.
    pub metallic: f32,
}

/// Surface that a pixel shows: its point, unit normal and material.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Seen {
    pub point: Vec3,
    pub normal: Vec3,
    pub material: SurfelMaterial,
}

/// Returns the surface at a pixel, if it is reliable.
///
/// It is if it is opaque, finite and faces the camera at `from`. The point is divided by `unit`.
pub(crate) fn seen(view: &Shaded, pixel: usize, from: Vec3, unit: f32) -> Option<Seen> {
    let triple = |values: &[f32]| Vec3::from_slice(&values[3 * pixel..3 * pixel + 3]);
    let (point, normal) = (triple(&view.points), triple(&view.normals));
    let facing = normal.dot((from - point).normalize_or_zero());
    let covered = view.coverage[pixel] > LEAST_COVERAGE;
    if !(covered && point.is_finite() && normal.is_finite() && facing > LEAST_FACING) {
        return None;
    }
    let m = &view.materials[4 * pixel..4 * pixel + 4];
    let metallic = view.metallic.get(pixel).copied().unwrap_or(0.0);
    let material = SurfelMaterial { albedo: [m[0], m[1], m[2]], roughness: m[3], metallic };
    Some(Seen { point: point / unit, normal, material })
}

/// Sums of a cell.
#[derive(Clone, Copy, Default)]
struct Cell {
    count: u32,
    point: DVec3,
    normal: DVec3,
    material: [f64; 5],
}

/// Cell of a point and a normal.
type Key = [i32; 6];

fn key(seen: &Seen, edge: f32) -> Key {
    let (p, n) = ((seen.point / edge).floor(), seen.normal.round());
    [p.x, p.y, p.z, n.x, n.y, n.z].map(|v| v as i32)
}

impl RoomSurfels {
    /// Clusters the surfaces of views.
    ///
    /// `from` holds the position of each view's camera. Points of views and positions are in world units. The result is in
    /// units of `unit` world units.
    pub fn cluster(views: &[Shaded], from: &[[f32; 3]], unit: f32, options: SurfelOptions) -> RoomSurfels {
        let pixels: usize = views.iter().map(|v| v.coverage.len()).sum();
        let stride = pixels.div_ceil(MOST_PIXELS).max(1);
        let of_view = |(view, from): (&Shaded, &[f32; 3])| {
            let from = Vec3::from(*from);
            (0..view.coverage.len()).step_by(stride).filter_map(|p| seen(view, p, from, unit)).collect::<Vec<_>>()
        };
        let all: Vec<Seen> = views.iter().zip(from).flat_map(of_view).collect();
        if all.is_empty() {
            return RoomSurfels::default();
        }
        let bounds = bounds(&all);
        let diagonal = Vec3::from(bounds[1]).distance(Vec3::from(bounds[0])).max(f32::MIN_POSITIVE);
        let mut cell = CELL_SHARE * diagonal;
        let mut cells = clusters(&all, cell);
        while cells.len() > options.most.max(1) {
            cell *= 1.1;
            cells = clusters(&all, cell);
        }
        let mut surfels = RoomSurfels { cell, bounds, ..Default::default() };
        for c in &cells {
            let by = 1.0 / f64::from(c.count);
            surfels.discs.points.push((c.point * by).as_vec3().to_array());
            surfels.discs.normals.push(c.normal.normalize().as_vec3().to_array());
            surfels.discs.radii.push(RADIUS * cell);
            let [red, green, blue, roughness, metallic] = c.material.map(|v| (v * by) as f32);
            surfels.materials.push(SurfelMaterial { albedo: [red, green, blue], roughness, metallic });
        }
        surfels
    }

    /// Returns the mean albedo of the surfels.
    pub fn mean_albedo(&self) -> [f32; 3] {
        let by = 1.0 / self.materials.len().max(1) as f64;
        [0, 1, 2].map(|c| (self.materials.iter().map(|m| f64::from(m.albedo[c])).sum::<f64>() * by) as f32)
    }

    /// Returns the number of surfels.
    pub fn len(&self) -> usize {
        self.discs.len()
    }

    /// Returns whether there are no surfels.
    pub fn is_empty(&self) -> bool {
        self.discs.is_empty()
    }
}

/// Returns the cells with enough pixels and a mean normal, sorted.
fn clusters(all: &[Seen], edge: f32) -> Vec<Cell> {
    let mut cells: BTreeMap<Key, Cell> = BTreeMap::new();
    for seen in all {
        let cell = cells.entry(key(seen, edge)).or_default();
        cell.count += 1;
        cell.point += seen.point.as_dvec3();
        cell.normal += seen.normal.as_dvec3();
        let SurfelMaterial { albedo: [red, green, blue], roughness, metallic } = seen.material;
        let values = [red, green, blue, roughness, metallic];
        cell.material.iter_mut().zip(values).for_each(|(sum, v)| *sum += f64::from(v));
    }
    cells.into_values().filter(|c| c.count >= LEAST_PIXELS && c.normal.length() > 1e-6).collect()
}

/// Returns the box of the points, without the outermost ones.
///
/// A thousandth of the points lies outside on each side of an axis.
fn bounds(all: &[Seen]) -> [[f32; 3]; 2] {
    let mut corners = [[0.0; 3]; 2];
    let outside = all.len() / 1000;
    for axis in 0..3 {
        let mut values: Vec<f32> = all.iter().map(|s| s.point[axis]).collect();
        values.sort_unstable_by(f32::total_cmp);
        corners[0][axis] = values[outside];
        corners[1][axis] = values[values.len() - 1 - outside];
    }
    corners
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// Returns a view of a wall that faces the origin.
    ///
    /// The camera looks along z; the wall is at depth `z`. The view has `size` pixels on a side, `step` apart on the wall.
    pub(crate) fn wall(size: u32, step: f32, z: f32, albedo: [f32; 3]) -> Shaded {
        let pixels = (size * size) as usize;
        let half = size as f32 / 2.0;
        let at = |i: usize| {
            let [x, y] = [i as u32 % size, i as u32 / size].map(|v| step * (v as f32 + 0.5 - half));
            [x, y, z]
        };
        Shaded {
            size: [size; 2],
            points: (0..pixels).flat_map(at).collect(),
            normals: [0.0, 0.0, -1.0].repeat(pixels),
            coverage: vec![1.0; pixels],
            materials: [albedo[0], albedo[1], albedo[2], 0.5].repeat(pixels),
            ..Default::default()
        }
    }

    #[test]
    fn wall_becomes_a_grid_of_discs_that_overlap() {
        let room = RoomSurfels::cluster(
            &[wall(256, 0.25, 20.0, [0.2, 0.4, 0.6])],
            &[[0.0; 3]],
            2.0,
            SurfelOptions { most: 200 },
        );
        assert!(room.len() > 50 && room.len() <= 200, "{}", room.len());
        assert!(room.discs.points.iter().all(|p| p[2] == 10.0), "lengths are divided by the unit");
        assert!(room.discs.normals.iter().all(|n| *n == [0.0, 0.0, -1.0]));
        let albedo = room.materials[0].albedo;
        assert!((albedo[1] - 0.4).abs() < 1e-6 && room.materials[0].metallic == 0.0);
        // Every seen point lies in a disc.
        let inside =
            |p: Vec3| room.discs.points.iter().zip(&room.discs.radii).any(|(c, r)| Vec3::from(*c).distance(p) <= *r);
        let all = wall(256, 0.25, 20.0, [0.0; 3]).points;
        let missed = all.chunks_exact(3).filter(|p| !inside(Vec3::from_slice(p) / 2.0)).count();
        assert!(missed < 256 * 256 / 100, "{missed}");
    }

    #[test]
    fn unreliable_pixels_leave_no_surfel() {
        let mut view = wall(8, 1.0, 20.0, [0.5; 3]);
        view.coverage[..32].fill(0.4);
        view.points[3 * 40] = f32::NAN;
        view.normals[3 * 41 + 2] = 1.0;
        let seen: Vec<usize> = (0..64).filter(|p| seen(&view, *p, Vec3::ZERO, 1.0).is_some()).collect();
        assert_eq!(seen.len(), 30);
        assert!(!seen.contains(&40) && !seen.contains(&41) && seen[0] == 32);
        assert_eq!(RoomSurfels::cluster(&[], &[], 1.0, SurfelOptions::default()), RoomSurfels::default());
    }

    #[test]
    fn sides_of_a_thin_wall_are_different_surfels() {
        let front = wall(256, 0.0625, 20.0, [1.0, 0.0, 0.0]);
        let mut back = wall(256, 0.0625, 20.0, [0.0, 0.0, 1.0]);
        back.normals = [0.0, 0.0, 1.0].repeat(256 * 256);
        let from = [[0.0; 3], [0.0, 0.0, 40.0]];
        let room = RoomSurfels::cluster(&[front, back], &from, 1.0, SurfelOptions::default());
        let of = |z: f32| room.discs.normals.iter().filter(|n| n[2] == z).count();
        assert!(of(1.0) == of(-1.0) && of(1.0) + of(-1.0) == room.len() && !room.is_empty());
        let pure = |m: &SurfelMaterial| m.albedo[0] == 0.0 || m.albedo[2] == 0.0;
        assert!(room.materials.iter().all(pure));
    }
}
