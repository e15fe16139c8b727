//! What the numbers of a depth map mean: their unit, and whether they measure along the optical axis or along the ray.
//!
//! Data sets seldom say, and a mistake is hard to see. But two views of the same surface decide it: a point of one view,
//! placed with the right definition, has the depth that the other view shows where it falls. The definition under which
//! most points agree is taken, if it is clearly the best; otherwise there is none, and depth is not measured.

use glam::{DVec2, DVec3};

use crate::camera::Camera;
use crate::error::Result;
use crate::image::Image;

/// What the numbers of a depth map mean.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DepthDefinition {
    /// The scene's units in one unit of the map.
    pub unit: f64,
    /// Whether the map holds distances from the camera instead of depths along its axis.
    pub along_ray: bool,
}

impl DepthDefinition {
    /// Millimeters along the axis in a scene of meters, as InteriorVerse documents.
    pub(crate) const INTERIORVERSE: Self = Self { unit: 1e-3, along_ray: false };

    /// Camera z in the scene's unit of a value at a pixel (continuous coordinates).
    pub(crate) fn z(self, camera: &Camera, pixel: DVec2, value: f64) -> f64 {
        let stretch = if self.along_ray {
            DVec3::new((pixel.x - camera.cx) / camera.fx, (pixel.y - camera.cy) / camera.fy, 1.0).length()
        } else {
            1.0
        };
        value * self.unit / stretch
    }
}

/// Units that data sets use, in the scene's.
const UNITS: [f64; 4] = [1.0, 1e-3, 1e-2, 1e-1];
/// Points of a row and of a column that are tried.
const GRID: u32 = 24;
/// Pairs of views that are tried.
const PAIRS: usize = 8;
/// How far apart the views of a pair must stand at least, of the largest distance. Without parallax everything agrees.
const APART: f64 = 0.25;
/// Fewer points than this decide nothing.
const FEWEST: usize = 200;
/// The largest disagreement of a definition that is believed, relative to depth.
const AGREES: f64 = 0.03;
/// How much worse all others must be.
const CLEARLY: f64 = 1.5;

/// What was found out about a set of depth maps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Verdict {
    /// This is what they mean.
    Clear(DepthDefinition),
    /// They share too little to tell.
    Untested,
    /// They disagree with the cameras under every definition, or agree under several.
    Unclear,
}

/// Finds out what the maps of these cameras mean. `load` gives the map of a camera as stored, of any size, zero where it
/// has no value.
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

/// Of the cameras that stand well apart from this one, the one that looks most nearly in its direction.
fn partner(cameras: &[Camera], from: usize) -> Option<usize> {
    let here = &cameras[from];
    let farthest = cameras.iter().map(|c| c.position().distance(here.position())).fold(0.0, f64::max);
    let others = (0..cameras.len()).filter(|&i| cameras[i].position().distance(here.position()) > APART * farthest);
    others.max_by(|&a, &b| {
        let toward = |i: usize| cameras[i].forward().dot(here.forward());
        toward(a).total_cmp(&toward(b))
    })
}

/// The relative disagreement of points of the first view with the second.
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

/// The value of a map between the centers of its pixels; `None` where one of the four has none.
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

    /// Cameras in a room of 4×3×5 units, and their maps under a definition.
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
    fn every_definition_is_told_from_every_other() {
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
    fn what_cannot_be_told_is_not_guessed() {
        let (cameras, maps) = room(DepthDefinition::INTERIORVERSE);
        assert_eq!(find(&cameras[..1], |i| Ok(Some(maps[i].clone()))).unwrap(), Verdict::Untested);
        assert_eq!(find(&cameras, |_| Ok(None)).unwrap(), Verdict::Untested);
        // Maps of a scene of another size agree under no definition.
        let wrong = |i: usize| {
            let mut map = maps[i].clone();
            map.data.iter_mut().for_each(|v| *v *= 2.7);
            Ok(Some(map))
        };
        assert_eq!(find(&cameras, wrong).unwrap(), Verdict::Unclear);
    }
}
