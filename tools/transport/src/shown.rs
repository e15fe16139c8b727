//! Emitters that pixels and Gaussians show.
//!
//! Only pixels that clip show an emitter.

use crate::emitters::{FoundEmitter, cell_of, is_clipped};
use crate::views::SeenViews;
use glam::Vec3;
use sgs_passes::transport::LightShape;
use sgs_scene::{Image, Unit};
use std::collections::BTreeMap;

/// Distance by which a ray may miss a known emitter, in edges of a cell.
const LATERAL: f32 = 1.0;
/// Distance of surfaces before a known emitter that show it, in edges of a cell.
///
/// Panes of windows are reconstructed up to a few tenths of a meter in front of the true ones.
const DEPTH: f32 = 6.0;

/// Emitters of which each pixel shows one at most. Lengths are in the room's unit.
pub(crate) enum Shown<'a> {
    /// Found emitters, with their shapes.
    Found {
        /// Emitter of each cell in which photographs clip: its number plus 1.
        cells: BTreeMap<[i32; 3], u32>,
        shapes: &'a [LightShape],
        edge: f32,
    },
    /// Emitters whose places are known.
    Known { shapes: &'a [LightShape], edge: f32 },
}

impl<'a> Shown<'a> {
    /// Returns found emitters. `edge` is that of a cell.
    pub fn found(found: &[FoundEmitter], shapes: &'a [LightShape], edge: f32) -> Shown<'a> {
        let mut cells: BTreeMap<[i32; 3], u32> = BTreeMap::new();
        for (number, emitter) in found.iter().enumerate().rev() {
            emitter.cells.iter().for_each(|cell| {
                cells.insert(*cell, number as u32 + 1);
            });
        }
        Shown::Found { cells, shapes, edge }
    }

    /// Returns the emitter that a clipped pixel shows: 0 for none, else its number plus 1.
    ///
    /// `point` is the surface that the pixel shows from the camera at `from`.
    pub fn by_pixel(&self, from: Vec3, point: Vec3) -> u32 {
        match self {
            Shown::Found { cells, edge, .. } => cells.get(&cell_of(point.into(), *edge)).copied().unwrap_or(0),
            Shown::Known { shapes, edge } => hit(shapes, from, point, *edge),
        }
    }

    /// Returns the emitter of each Gaussian: 0 for none, else its number plus 1.
    ///
    /// A Gaussian belongs to an emitter if most of the views that show the Gaussian clip there, and it lies in or beside a
    /// cell of a found emitter, or most of its views see a known emitter there. Photographs also clip in the glare around a
    /// bulb. So a Gaussian of a found sphere must lie within two radii of its center.
    ///
    /// `means` are in world units, `unit` is that of the room.
    pub fn by_gaussians(&self, seen: &SeenViews, photographs: &[Image], means: &[[f32; 3]], unit: Unit) -> Vec<u32> {
        let beside = match self {
            Shown::Found { cells, .. } => dilated(cells),
            Shown::Known { .. } => BTreeMap::new(),
        };
        means.iter().map(|mean| self.by_gaussian(&beside, seen, photographs, *mean, unit)).collect()
    }

    fn by_gaussian(
        &self,
        beside: &BTreeMap<[i32; 3], u32>,
        seen: &SeenViews,
        photographs: &[Image],
        mean: [f32; 3],
        unit: Unit,
    ) -> u32 {
        let (place, length) = (Vec3::from(unit.place(mean)), unit.length() as f32);
        let candidate = match self {
            Shown::Found { shapes, edge, .. } => {
                let Some(emitter) = beside.get(&cell_of(place.into(), *edge)) else { return 0 };
                if let LightShape::Sphere { center, radius } = shapes[*emitter as usize - 1]
                    && Vec3::from(center).distance(place) > 2.0 * radius
                {
                    return 0;
                }
                Some(*emitter)
            }
            Shown::Known { .. } => None,
        };
        let (Shown::Found { edge, .. } | Shown::Known { edge, .. }) = self;
        let tolerance = 2.0 * edge * length;
        // Number of views that show the Gaussian, and of those, by emitter, number of views whose pixel clips.
        let (mut views, mut clipped) = (0, BTreeMap::new());
        for (i, ((view, photograph), from)) in seen.views.iter().zip(photographs).zip(&seen.from).enumerate() {
            let Some(pixel) = seen.pixel(i, mean) else { continue };
            let surface = Vec3::from_slice(&view.points[3 * pixel..3 * pixel + 3]);
            let from = Vec3::from(*from);
            if (surface.distance(from) - Vec3::from(mean).distance(from)).abs() > tolerance {
                continue;
            }
            views += 1;
            if is_clipped(photograph, pixel) {
                let emitter = candidate.unwrap_or_else(|| self.by_pixel(from / length, place));
                *clipped.entry(emitter).or_insert(0) += 1;
            }
        }
        let most = clipped.into_iter().find(|(_, count)| 2 * count > views);
        most.map_or(0, |(emitter, _)| emitter)
    }
}

/// Adds the neighbors of all cells. A neighbor of several emitters belongs to the last, the smallest.
fn dilated(cells: &BTreeMap<[i32; 3], u32>) -> BTreeMap<[i32; 3], u32> {
    let mut all = cells.clone();
    for (&[x, y, z], &number) in cells {
        for offset in 0..27 {
            let beside = [x + offset % 3 - 1, y + offset / 3 % 3 - 1, z + offset / 9 - 1];
            if !cells.contains_key(&beside) {
                all.entry(beside).and_modify(|n| *n = number.max(*n)).or_insert(number);
            }
        }
    }
    all
}

/// Returns the known emitter that a camera sees before, or just behind, a surface.
///
/// 0 stands for none, else it is the number plus 1. Of several emitters, it is the one that the ray misses least.
fn hit(shapes: &[LightShape], from: Vec3, point: Vec3, edge: f32) -> u32 {
    let reach = from.distance(point) + DEPTH * edge;
    let direction = (point - from).normalize_or_zero();
    let missed =
        shapes.iter().enumerate().filter_map(|(i, shape)| Some((i, missed_by(shape, from, direction, reach)?)));
    let nearest = missed.filter(|(_, by)| *by <= LATERAL * edge).min_by(|a, b| a.1.total_cmp(&b.1));
    nearest.map_or(0, |(i, _)| i as u32 + 1)
}

/// Returns the distance by which a ray misses the surface of a shape: 0 if it meets the surface.
///
/// None for shapes without a surface, for the backs of surfaces, and beyond `reach`.
fn missed_by(shape: &LightShape, from: Vec3, direction: Vec3, reach: f32) -> Option<f32> {
    // Where a ray meets the front of a plane.
    let on_plane = |point: Vec3, normal: Vec3| {
        let facing = direction.dot(normal);
        let t = (point - from).dot(normal) / facing;
        (facing < 0.0 && t >= 0.0 && t <= reach).then(|| from + t * direction)
    };
    match *shape {
        LightShape::Sphere { center, radius } => {
            let center = Vec3::from(center);
            let t = (center - from).dot(direction).clamp(0.0, reach);
            Some(((from + t * direction).distance(center) - radius).max(0.0))
        }
        LightShape::Disk { center, normal, radius } => {
            let center = Vec3::from(center);
            let at = on_plane(center, Vec3::from(normal).normalize_or_zero())?;
            Some((at.distance(center) - radius).max(0.0))
        }
        LightShape::Rectangle { corner, edge_u, edge_v } => {
            let (corner, u, v) = (Vec3::from(corner), Vec3::from(edge_u), Vec3::from(edge_v));
            let at = on_plane(corner, u.cross(v).normalize_or_zero())? - corner;
            let along = |edge: Vec3| (at.dot(edge) / edge.length_squared()).clamp(0.0, 1.0) * edge;
            Some((at - along(u) - along(v)).length())
        }
        LightShape::Point { .. }
        | LightShape::Spot { .. }
        | LightShape::Directional { .. }
        | LightShape::Lobe { .. }
        | LightShape::Window { .. } => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PANEL: LightShape =
        LightShape::Rectangle { corner: [-1.0, -1.0, 5.0], edge_u: [0.0, 2.0, 0.0], edge_v: [2.0, 0.0, 0.0] };
    const BULB: LightShape = LightShape::Sphere { center: [3.0, 0.0, 5.0], radius: 0.5 };
    const DISK: LightShape = LightShape::Disk { center: [0.0, 4.0, 5.0], normal: [0.0, 0.0, -2.0], radius: 1.0 };

    #[test]
    fn ray_meets_the_known_emitter_before_the_surface() {
        let shapes = [PANEL, BULB, DISK, LightShape::Point { position: [0.0; 3] }];
        let hit = |point: [f32; 3]| hit(&shapes, Vec3::ZERO, point.into(), 0.1);
        assert_eq!([hit([0.0, 0.0, 5.0]), hit([3.0, 0.0, 5.0]), hit([0.0, 4.0, 5.0])], [1, 2, 3]);
        // A surface far behind the window shows it; one in front of it hides it, unless the depth may be wrong.
        assert_eq!([hit([0.0, 0.0, 50.0]), hit([0.0, 0.0, 4.0]), hit([0.0, 0.0, 4.5])], [1, 0, 1]);
        // A cell beside an edge still counts.
        assert_eq!([hit([1.09, 0.0, 5.0]), hit([1.11, 0.0, 5.0])], [1, 0]);
        assert_eq!([hit([3.0, 0.55, 5.0]), hit([3.0, 0.75, 5.0])], [2, 0]);
        assert_eq!([hit([0.0, 5.09, 5.0]), hit([0.0, 5.2, 5.0])], [3, 0]);
        // Backs do not shine.
        assert_eq!(super::hit(&shapes, Vec3::new(0.0, 0.0, 10.0), Vec3::new(0.0, 0.0, 5.0), 0.1), 0);
        assert_eq!(super::hit(&shapes, Vec3::ZERO, Vec3::ZERO, 0.1), 0);
    }

    #[test]
    fn cells_grow_by_their_neighbors() {
        let cells = BTreeMap::from([([0, 0, 0], 2), ([1, 0, 0], 1), ([5, 5, 5], 3)]);
        let all = dilated(&cells);
        assert_eq!(all.len(), 36 + 27);
        assert_eq!([all[&[0, 0, 0]], all[&[1, 0, 0]], all[&[-1, 0, 0]], all[&[0, 1, 0]]], [2, 1, 2, 2]);
        assert!(!all.contains_key(&[5, 5, 7]) && all[&[4, 4, 6]] == 3);
    }
}
