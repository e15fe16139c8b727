//! Definition of a depth map: its unit, and depth along the axis or the ray.
//!
//! Data sets rarely document the definition, and a wrong one is hard to notice. Two views of the same surface determine
//! it. A point unprojected from one view with the correct definition has the depth that the other view shows at its
//! projection. The definition with the smallest disagreement is selected if it is clearly the best. Otherwise no
//! definition is selected, and depth is not evaluated.

use glam::{DVec2, DVec3};

use crate::camera::Camera;
use crate::error::Result;
use crate::image::Image;

/// Meaning of the values of a depth map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DepthDefinition {
    /// Scene units per unit of the map.
    pub unit: f64,
    /// Whether the map stores distances along rays instead of depths along the axis.
    pub along_ray: bool,
}

impl DepthDefinition {
    /// Millimeters along the axis in a scene in meters, as InteriorVerse documents.
    pub(crate) const INTERIORVERSE: Self = Self { unit: 1e-3, along_ray: false };

    /// Converts a map value at a pixel to camera z in scene units. `pixel` is in continuous coordinates.
    pub(crate) fn z(self, camera: &Camera, pixel: DVec2, value: f64) -> f64 {
        let stretch = if self.along_ray {
            DVec3::new((pixel.x - camera.cx) / camera.fx, (pixel.y - camera.cy) / camera.fy, 1.0).length()
        } else {
            1.0
        };
        value * self.unit / stretch
    }
}

/// Candidate units of a map, in scene units.
const UNITS: [f64; 4] = [1.0, 1e-3, 1e-2, 1e-1];
/// Number of tested points per row and per column.
const GRID: u32 = 24;
/// Largest number of tested view pairs.
const PAIRS: usize = 8;
/// Smallest distance of a pair's cameras, relative to the largest distance. Without parallax, every definition agrees.
const APART: f64 = 0.25;
/// Smallest number of point comparisons for a decision.
const FEWEST: usize = 200;
/// Largest accepted median disagreement, relative to depth.
const AGREES: f64 = 0.03;
/// Smallest ratio of the second-best disagreement to the best.
const CLEARLY: f64 = 1.5;

/// Result of the detection for a set of depth maps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Verdict {
    /// One definition is clearly the best.
    Clear(DepthDefinition),
    /// The views overlap too little to decide.
    Untested,
    /// No definition agrees with the cameras, or several do.
    Unclear,
}

/// Detects the definition of the depth maps of these cameras. `load` returns the stored map of a camera by index, at
/// any size, with 0 where the map has no value.
pub(crate) fn find(cameras: &[Camera], load: impl Fn(usize) -> Result<Option<Image>>) -> Result<Verdict> {
    let mut scores: Vec<(DepthDefinition, Vec<f64>)> = UNITS
        .iter()
        .flat_map(|&unit| [false, true].map(|along_ray| (DepthDefinition { unit, along_ray }, Vec::new())))
        .collect();
    let tried = cameras.len().min(PAIRS);
    for k in 0..tried {
        let from = k * cameras.len() / tried;
        let Some(to) = partner(cameras, from) else { continue };
        if let (Some(a), Some(b)) = (load(from)?, load(to)?) {
            for (definition, found) in &mut scores {
                compare(*definition, (&cameras[from], &a), (&cameras[to], &b), found);
            }
        }
    }
    if scores.iter().map(|(_, found)| found.len()).max().unwrap_or(0) < FEWEST {
        return Ok(Verdict::Untested);
    }
    let mut ranked: Vec<(DepthDefinition, f64)> = scores
        .into_iter()
        .filter(|(_, found)| found.len() >= FEWEST / 2)
        .map(|(definition, mut found)| {
            let middle = found.len() / 2;
            (definition, *found.select_nth_unstable_by(middle, f64::total_cmp).1)
        })
        .collect();
    ranked.sort_by(|a, b| a.1.total_cmp(&b.1));
    let second = ranked.get(1).map_or(f64::INFINITY, |r| r.1);
    match ranked.first() {
        Some(&(definition, best)) if best < AGREES && second > CLEARLY * best => Ok(Verdict::Clear(definition)),
        _ => Ok(Verdict::Unclear),
    }
}

/// Selects a partner for a camera among those far enough from it. Returns the one with the most similar viewing
/// direction.
fn partner(cameras: &[Camera], from: usize) -> Option<usize> {
    let here = &cameras[from];
    let farthest = cameras.iter().map(|c| c.position().distance(here.position())).fold(0.0, f64::max);
    let others = (0..cameras.len()).filter(|&i| cameras[i].position().distance(here.position()) > APART * farthest);
    others.max_by(|&a, &b| {
        let toward = |i: usize| cameras[i].forward().dot(here.forward());
        toward(a).total_cmp(&toward(b))
    })
}

/// Compares points of the first view with the map of the second. Appends the relative disagreements in depth to
/// `found`.
fn compare(definition: DepthDefinition, a: (&Camera, &Image), b: (&Camera, &Image), found: &mut Vec<f64>) {
    let camera_of = |(camera, map): (&Camera, &Image)| camera.scaled(map.width, map.height);
    let (from, to) = (camera_of(a), camera_of(b));
    for k in 0..GRID * GRID {
        let (x, y) = (k % GRID * from.width / GRID, k / GRID * from.height / GRID);
        let value = f64::from(a.1.pixel(x, y)[0]);
        if value <= 0.0 {
            continue;
        }
        let pixel = DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
        let point = from.unproject(pixel, definition.z(&from, pixel, value));
        let Some(at) = to.project(point) else { continue };
        if at.x < 0.0 || at.y < 0.0 || at.x >= f64::from(to.width) || at.y >= f64::from(to.height) {
            continue;
        }
        if let Some(shown) = between(b.1, at) {
            let shown = definition.z(&to, at, shown);
            let expected = (to.rotation * point + to.translation).z;
            found.push(((expected - shown) / shown.max(expected)).abs());
        }
    }
}

/// Interpolates a map bilinearly at a continuous position. Returns `None` if one of the four pixels has no value.
fn between(map: &Image, at: DVec2) -> Option<f64> {
    let last = DVec2::new(f64::from(map.width - 1), f64::from(map.height - 1));
    let place = (at - 0.5).clamp(DVec2::ZERO, last);
    let (x, y) = (place.x as u32, place.y as u32);
    let t = place - DVec2::new(f64::from(x), f64::from(y));
    let value = |dx: u32, dy: u32| f64::from(map.pixel((x + dx).min(map.width - 1), (y + dy).min(map.height - 1))[0]);
    let corners = [value(0, 0), value(1, 0), value(0, 1), value(1, 1)];
    let (top, bottom) = (corners[0] + t.x * (corners[1] - corners[0]), corners[2] + t.x * (corners[3] - corners[2]));
    corners.iter().all(|&v| v > 0.0).then_some(top + t.y * (bottom - top))
}

#[cfg(test)]
mod tests {
    use glam::DMat3;

    use super::*;

    /// Returns cameras in a 4×3×5 unit room and their depth maps under a definition.
    fn room(definition: DepthDefinition) -> (Vec<Camera>, Vec<Image>) {
        let cameras: Vec<Camera> = (0..5)
            .map(|i| {
                let rotation = DMat3::from_rotation_y(0.15 * f64::from(i) - 0.3) * DMat3::from_rotation_x(0.2);
                let center = DVec3::new(0.5 * f64::from(i) - 1.0, 0.2, -1.5);
                let translation = -(rotation * center);
                Camera {
                    name: i.to_string(),
                    width: 48,
                    height: 40,
                    fx: 30.0,
                    fy: 32.0,
                    cx: 20.0,
                    cy: 23.0,
                    rotation,
                    translation,
                    near: crate::camera::NEAR,
                }
            })
            .collect();
        let maps = cameras.iter().map(|c| map(c, definition)).collect();
        (cameras, maps)
    }

    fn map(camera: &Camera, definition: DepthDefinition) -> Image {
        let mut map = Image::new(camera.width, camera.height, 1);
        let half = DVec3::new(2.0, 1.5, 2.5);
        for y in 0..camera.height {
            for x in 0..camera.width {
                let pixel = DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
                let origin = camera.position();
                let ray = camera.unproject(pixel, 1.0) - origin;
                let z = (0..3).map(|k| (half[k] * ray[k].signum() - origin[k]) / ray[k]).fold(f64::INFINITY, f64::min);
                let stretch = if definition.along_ray { ray.length() } else { 1.0 };
                map.pixel_mut(x, y)[0] = (z * stretch / definition.unit) as f32;
            }
        }
        map
    }

    #[test]
    fn every_definition_is_detected() {
        for unit in UNITS {
            for along_ray in [false, true] {
                let definition = DepthDefinition { unit, along_ray };
                let (cameras, maps) = room(definition);
                let found = find(&cameras, |i| Ok(Some(maps[i].clone()))).unwrap();
                assert_eq!(found, Verdict::Clear(definition));
            }
        }
    }

    #[test]
    fn undecidable_definitions_are_not_guessed() {
        let (cameras, maps) = room(DepthDefinition::INTERIORVERSE);
        assert_eq!(find(&cameras[..1], |i| Ok(Some(maps[i].clone()))).unwrap(), Verdict::Untested);
        assert_eq!(find(&cameras, |_| Ok(None)).unwrap(), Verdict::Untested);
        // Maps of a scene of a different size agree under no definition.
        let wrong = |i: usize| {
            let mut map = maps[i].clone();
            map.data.iter_mut().for_each(|v| *v *= 2.7);
            Ok(Some(map))
        };
        assert_eq!(find(&cameras, wrong).unwrap(), Verdict::Unclear);
    }
}
