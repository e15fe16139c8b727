//! Positions of spheres: those that photographs show, and hidden ones.
//!
//! A missing light draws the others towards its place. So spheres that photographs show first move by [`NEAR`] at most, then
//! hidden lights are added, and then all move again, those that are shown by [`FAR`] at most.

use crate::error::Result;
use crate::explain::{BATCH, Compared};
use crate::fit::Fitter;
use crate::room::Room;
use glam::Vec3;
use sgs_passes::transport::LightShape;

/// First and smallest step by which spheres move, in edges of a cell.
const STEPS: [f32; 2] = [2.0, 0.25];
/// Reach of shown spheres before hidden lights are added, in edges of a cell.
const NEAR: f32 = 2.0;
/// Reach of shown spheres after that, in edges of a cell.
const FAR: f32 = 4.0;
/// Minimum distance of hidden lights from shown spheres, in edges of a cell.
///
/// A nearer one would only share the light of that sphere.
const APART: f32 = 4.0;
/// Maximum spacing of the grid of hidden lights, as a share of the room's diagonal.
const GRID: f32 = 0.1;
/// Maximum number of hidden lights.
const HIDDEN: usize = 2;
/// Minimum gain of PSNR by a hidden light, in dB.
pub(crate) const LEAST_GAIN: f64 = 0.1;

/// Region in which a sphere is placed.
#[derive(Clone, Copy)]
enum Region<'a> {
    /// Around the place where photographs show the sphere.
    Around { center: [f32; 3], reach: f32 },
    /// Apart from the shapes that photographs show.
    Apart { shown: &'a [LightShape], distance: f32 },
}

impl Region<'_> {
    fn contains(&self, place: [f32; 3]) -> bool {
        let from = |center: [f32; 3]| Vec3::from(center).distance(place.into());
        let is_near = |shape: &LightShape, distance: f32| match shape {
            LightShape::Sphere { center, .. } => from(*center) < distance,
            _ => false,
        };
        match self {
            Region::Around { center, reach } => from(*center) <= *reach,
            Region::Apart { shown, distance } => !shown.iter().any(|shape| is_near(shape, *distance)),
        }
    }
}

impl Room {
    /// Places the spheres, and adds hidden lights.
    ///
    /// `shapes` are those that photographs show.
    pub(crate) fn place(
        &self,
        shapes: &mut Vec<LightShape>,
        fitter: &mut Fitter<'_>,
        compared: &Compared,
    ) -> Result<()> {
        let edge = self.surfels.cell;
        let shown = shapes.clone();
        let apart = Region::Apart { shown: &shown, distance: APART * edge };
        let around = |i: usize, reach: f32| match shown.get(i) {
            Some(LightShape::Sphere { center, .. }) => Region::Around { center: *center, reach: reach * edge },
            _ => apart,
        };
        for i in 0..shapes.len() {
            self.refine(i, shapes, fitter, compared, around(i, NEAR))?;
        }
        for _ in 0..HIDDEN {
            if !self.add_hidden(shapes, fitter, compared, apart)? {
                break;
            }
        }
        for i in 0..shapes.len() {
            self.refine(i, shapes, fitter, compared, around(i, FAR))?;
        }
        Ok(())
    }

    /// Returns whether a place lies in the enclosure.
    fn contains(&self, place: [f32; 3]) -> bool {
        let (low, high) = (self.enclosure.low(), self.enclosure.high());
        (0..3).all(|k| place[k] > low[k] && place[k] < high[k])
    }

    /// Moves a sphere to where it explains the photographs best, within a region.
    ///
    /// Of six steps along the axes, the best is taken. If none lowers the error, steps become half as long.
    /// Other shapes stay as they are.
    fn refine(
        &self,
        emitter: usize,
        shapes: &mut [LightShape],
        fitter: &mut Fitter<'_>,
        compared: &Compared,
        region: Region<'_>,
    ) -> Result<()> {
        let LightShape::Sphere { mut center, radius } = shapes[emitter] else { return Ok(()) };
        let mut step = STEPS[0] * self.surfels.cell;
        let mut error = fitter.error();
        while step >= STEPS[1] * self.surfels.cell {
            let moved = (0..6).map(|k| {
                let mut place = center;
                place[k / 2] += if k % 2 == 0 { step } else { -step };
                place
            });
            let places: Vec<[f32; 3]> =
                moved.filter(|place| self.contains(*place) && region.contains(*place)).collect();
            let candidates: Vec<LightShape> =
                places.iter().map(|place| LightShape::Sphere { center: *place, radius }).collect();
            let mut best: Option<(f64, [f32; 3], Fitter<'_>)> = None;
            for (place, unit) in places.iter().zip(self.units(&candidates, compared)?) {
                let mut tried = fitter.clone();
                tried.replace(emitter, unit);
                tried.fit_colors();
                let found = tried.error();
                if found < best.as_ref().map_or(error, |b| b.0) {
                    best = Some((found, *place, tried));
                }
            }
            match best {
                Some((found, place, tried)) => (error, center, *fitter) = (found, place, tried),
                None => step *= 0.5,
            }
        }
        shapes[emitter] = LightShape::Sphere { center, radius };
        Ok(())
    }

    /// Adds the hidden light that explains the photographs best.
    ///
    /// Returns false, and adds none, if none gains [`LEAST_GAIN`].
    fn add_hidden<'a>(
        &self,
        shapes: &mut Vec<LightShape>,
        fitter: &mut Fitter<'a>,
        compared: &Compared,
        region: Region<'_>,
    ) -> Result<bool> {
        let (low, high) = (Vec3::from(self.enclosure.low()), Vec3::from(self.enclosure.high()));
        let edge = GRID * low.distance(high);
        let counts = ((high - low) / edge).ceil().as_uvec3();
        let radius = 0.5 * self.surfels.cell;
        let at = |i: u32| {
            let cell =
                Vec3::new((i % counts.x) as f32, (i / counts.x % counts.y) as f32, (i / counts.x / counts.y) as f32);
            let place = low + (cell + 0.5) / counts.as_vec3() * (high - low);
            place.to_array()
        };
        let places = (0..counts.x * counts.y * counts.z).map(at).filter(|place| region.contains(*place));
        let grid: Vec<LightShape> = places.map(|center| LightShape::Sphere { center, radius }).collect();
        let before = fitter.psnr();
        let mut best: Option<(f64, LightShape, Fitter<'a>)> = None;
        for batch in grid.chunks(BATCH) {
            for (shape, unit) in batch.iter().zip(self.units(batch, compared)?) {
                let mut tried = fitter.clone();
                tried.push(unit, 0);
                tried.fit_colors();
                let found = tried.psnr();
                if found > best.as_ref().map_or(before, |b| b.0) {
                    best = Some((found, *shape, tried));
                }
            }
        }
        let Some((_, shape, tried)) = best else { return Ok(false) };
        let mut with = tried;
        shapes.push(shape);
        self.refine(shapes.len() - 1, shapes, &mut with, compared, region)?;
        if with.psnr() < before + LEAST_GAIN {
            shapes.pop();
            return Ok(false);
        }
        *fitter = with;
        Ok(true)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn regions_bound_the_places_of_spheres() {
        let around = Region::Around { center: [1.0, 0.0, 0.0], reach: 0.5 };
        assert!(around.contains([1.5, 0.0, 0.0]) && !around.contains([1.0, 0.4, 0.4]));
        let panel = LightShape::Rectangle { corner: [0.0; 3], edge_u: [1.0, 0.0, 0.0], edge_v: [0.0, 1.0, 0.0] };
        let shown = [panel, LightShape::Sphere { center: [2.0, 0.0, 0.0], radius: 0.1 }];
        let apart = Region::Apart { shown: &shown, distance: 0.5 };
        assert!(apart.contains([0.0; 3]) && apart.contains([2.5, 0.0, 0.0]) && !apart.contains([2.0, 0.3, 0.3]));
    }
}
