//! Explanation of photographs by emitters and bounced light.
//!
//! 1. Emitters that photographs show are candidates ([`crate::emitters`]).
//! 2. The fit ([`crate::fit`]) finds their colors and the albedo of the enclosure.
//! 3. Spheres move to where they explain the photographs best ([`crate::placement`]).
//! 4. Hidden lights, which no photograph shows well enough, are searched on a grid. The position that explains the photographs
//!    best becomes an emitter if the PSNR rises by [`LEAST_GAIN`](crate::placement::LEAST_GAIN). Then all spheres move again.
//! 5. The fit runs again. Candidates that it leaves dark are removed.

use crate::emitters::{CLIPPED, FoundEmitter, cell_of, find_emitters, is_clipped};
use crate::error::Result;
use crate::fit::{Fitter, Samples, UnitLight};
use crate::radiosity::{FACES, Radiosity};
use crate::room::{Room, SHEEN, near, reflectance, specular};
use crate::surfels::seen;
use crate::views::SeenViews;
use glam::Vec3;
use sgs_passes::transport::{AreaLight, LightShape, nearest_surfels};
use sgs_scene::{Image, Splats};
use std::collections::BTreeMap;

/// Maximum number of pixels of a view that the fit compares.
pub(crate) const SAMPLES: usize = 3000;
/// Number of rounds of a fit. Each fits the colors, then the enclosure.
const ROUNDS: usize = 3;
/// Maximum number of emitters that photographs show; the largest ones count.
const MOST_FOUND: usize = 64;
/// Number of lights per dispatch.
pub(crate) const BATCH: usize = 32;
/// Minimum power of an emitter, as a share of that of the most powerful one.
const LEAST_POWER: f32 = 1e-4;

/// Emitters and enclosure that explain photographs.
#[derive(Clone, Debug, PartialEq)]
pub struct Explained {
    /// Emitters, in world units.
    pub emitters: Vec<AreaLight>,
    /// Emitter of each Gaussian: 0 for none, else its number plus 1.
    pub of_gaussians: Vec<u32>,
    /// Albedo of the faces of the enclosure: low x, high x, low y, high y, low z, high z.
    pub enclosure: [[f32; 3]; FACES],
    /// PSNR of the compared pixels in dB.
    pub psnr: f64,
    /// PSNR of the compared pixels under the best uniform light, in dB.
    pub uniform_psnr: f64,
}

/// Pixels that the fit compares, with the points and unit normals that they show.
///
/// Lengths are in the room's unit.
pub(crate) struct Compared {
    samples: Samples,
    points: Vec<[f32; 3]>,
    normals: Vec<[f32; 3]>,
}

impl Room {
    /// Finds emitters and fits them, and the enclosure, to photographs.
    ///
    /// Photographs hold display values, one image per view. `splats` are the Gaussians of which the room was built.
    ///
    /// # Errors
    /// If the device fails.
    pub fn explain(&self, views: &SeenViews, photographs: &[Image], splats: &Splats) -> Result<Explained> {
        let length = self.unit.length() as f32;
        let mut found = find_emitters(&views.views, photographs, &views.from, length, self.surfels.cell);
        found.retain(|e| AreaLight { shape: e.shape, color: [1.0; 3] }.check().is_ok());
        found.truncate(MOST_FOUND);
        let mut shapes: Vec<LightShape> = found.iter().map(|e| e.shape).collect();
        let compared = self.compared(&found, views, photographs);
        let targets = self.scene.targets()?;
        let surfels: Vec<[f64; 3]> = self.surfels.materials.iter().map(|m| reflectance(m).map(f64::from)).collect();
        let faces: Vec<u8> = self.enclosure.patches().iter().map(|p| p.face as u8).collect();
        let rays = self.scene.options().rays as usize;
        let radiosity = Radiosity { targets: &targets, rays, surfels: &surfels, faces: &faces, sheen: SHEEN };
        let mut fitter = Fitter::new(radiosity, &compared.samples, self.surfels.mean_albedo());
        for (i, unit) in self.units(&shapes, &compared)?.into_iter().enumerate() {
            fitter.push(unit, i as u32 + 1);
        }
        rounds(&mut fitter);
        self.place(&mut shapes, &mut fitter, &compared)?;
        rounds(&mut fitter);
        let of_gaussians = self.emitters_of(&found, &shapes, views, photographs, splats);
        Ok(self.explained(&shapes, &fitter, of_gaussians))
    }

    /// Returns the result, without emitters that are dark.
    fn explained(&self, shapes: &[LightShape], fitter: &Fitter<'_>, of_gaussians: Vec<u32>) -> Explained {
        let lights = shapes.iter().zip(fitter.colors()).map(|(shape, color)| AreaLight { shape: *shape, color });
        let lights: Vec<AreaLight> = lights.collect();
        let power = |light: &AreaLight| light.power().map_or(0.0, |p| p[0] + p[1] + p[2]);
        let most = lights.iter().map(power).fold(0.0, f32::max);
        let (mut emitters, mut numbers) = (Vec::new(), vec![0]);
        for light in &lights {
            let shines = power(light) > LEAST_POWER * most;
            if shines {
                emitters.push(light.scaled(self.unit.length() as f32));
            }
            numbers.push(if shines { emitters.len() as u32 } else { 0 });
        }
        let of_gaussians = of_gaussians.into_iter().map(|e| numbers[e as usize]).collect();
        let (psnr, uniform_psnr) = (fitter.psnr(), fitter.uniform_psnr());
        Explained { emitters, of_gaussians, enclosure: fitter.enclosure(), psnr, uniform_psnr }
    }

    /// Returns the direct light of shapes of color 1.
    ///
    /// Spheres count as points, whose shadows need one ray per receiver.
    pub(crate) fn units(&self, shapes: &[LightShape], compared: &Compared) -> Result<Vec<UnitLight>> {
        let mut all = Vec::new();
        for batch in shapes.chunks(BATCH) {
            let light = |shape: &LightShape| match shape {
                LightShape::Sphere { center, .. } => LightShape::Point { position: *center },
                other => *other,
            };
            let lights: Vec<AreaLight> =
                batch.iter().map(|shape| AreaLight { shape: light(shape), color: [1.0; 3] }).collect();
            let of_receivers = self.scene.unit_light(&lights)?;
            let of_samples = self.scene.unit_light_at(&lights, &compared.points, &compared.normals)?;
            let receivers = of_receivers.chunks_exact(self.scene.receivers() as usize);
            let samples = of_samples.chunks_exact(compared.points.len().max(1));
            for ((shape, of_receivers), of_samples) in batch.iter().zip(receivers).zip(samples) {
                // The intensity of a sphere of radiance 1.
                let by = match shape {
                    LightShape::Sphere { radius, .. } => std::f32::consts::PI * radius * radius,
                    _ => 1.0,
                };
                let scaled = |values: &[f32]| values.iter().map(|v| by * v).collect();
                all.push(UnitLight { receivers: scaled(of_receivers), samples: scaled(of_samples) });
            }
        }
        Ok(all)
    }

    /// Returns the emitter of each Gaussian: 0 for none, else its number plus 1.
    ///
    /// A Gaussian belongs to an emitter if it lies in one of its cells or beside one, and most of the views that show the
    /// Gaussian clip there. Photographs also clip in the glare around a bulb. So a Gaussian of a sphere must lie within two
    /// radii of its center.
    fn emitters_of(
        &self,
        found: &[FoundEmitter],
        shapes: &[LightShape],
        seen: &SeenViews,
        photographs: &[Image],
        splats: &Splats,
    ) -> Vec<u32> {
        let mut cells: BTreeMap<[i32; 3], u32> = BTreeMap::new();
        for (number, emitter) in found.iter().enumerate().rev() {
            for [x, y, z] in &emitter.cells {
                for offset in 0..27 {
                    let beside = [x + offset % 3 - 1, y + offset / 3 % 3 - 1, z + offset / 9 - 1];
                    cells.entry(beside).or_insert(number as u32 + 1);
                }
                cells.insert([*x, *y, *z], number as u32 + 1);
            }
        }
        let edge = self.surfels.cell;
        let tolerance = 2.0 * edge * self.unit.length() as f32;
        let of = |mean: &[f32; 3]| {
            let place = self.unit.place(*mean);
            let Some(emitter) = cells.get(&cell_of(place, edge)) else { return 0 };
            if let LightShape::Sphere { center, radius } = shapes[*emitter as usize - 1]
                && Vec3::from(center).distance(place.into()) > 2.0 * radius
            {
                return 0;
            }
            // Of the views that show the Gaussian, the number of those whose pixel clips.
            let (mut shown, mut clipped) = (0, 0);
            for (i, ((view, photograph), from)) in seen.views.iter().zip(photographs).zip(&seen.from).enumerate() {
                let Some(pixel) = seen.pixel(i, *mean) else { continue };
                let surface = Vec3::from_slice(&view.points[3 * pixel..3 * pixel + 3]);
                let from = Vec3::from(*from);
                if (surface.distance(from) - Vec3::from(*mean).distance(from)).abs() > tolerance {
                    continue;
                }
                shown += 1;
                clipped += usize::from(is_clipped(photograph, pixel));
            }
            if 2 * clipped > shown { *emitter } else { 0 }
        };
        splats.means.iter().map(of).collect()
    }

    /// Returns the pixels that the fit compares.
    fn compared(&self, found: &[FoundEmitter], views: &SeenViews, photographs: &[Image]) -> Compared {
        let mut cells: BTreeMap<[i32; 3], u32> = BTreeMap::new();
        for (number, emitter) in found.iter().enumerate().rev() {
            emitter.cells.iter().for_each(|cell| {
                cells.insert(*cell, number as u32 + 1);
            });
        }
        let unit = self.unit.length() as f32;
        let (mut samples, mut points, mut normals) = (Samples::default(), Vec::new(), Vec::new());
        for ((view, photograph), from) in views.views.iter().zip(photographs).zip(&views.from) {
            let pixels = view.coverage.len();
            for pixel in (0..pixels).step_by(pixels.div_ceil(SAMPLES).max(1)) {
                let Some(s) = seen(view, pixel, Vec3::from(*from), unit) else { continue };
                let target: [f32; 3] = [0, 1, 2].map(|c| photograph.data[3 * pixel + c]);
                let to = (Vec3::from(*from) / unit - s.point).normalize_or_zero();
                let m = &s.material;
                samples.targets.push(target);
                samples.clipped.push(target.map(|v| v >= CLIPPED));
                samples.diffuse.push(m.albedo.map(|a| f64::from(a * (1.0 - m.metallic))));
                samples.specular.push(specular(m, s.normal.dot(to).clamp(0.0, 1.0)).map(f64::from));
                let emitter = cells.get(&cell_of(s.point.into(), self.surfels.cell)).copied().unwrap_or(0);
                samples.emitters.push(if is_clipped(photograph, pixel) { emitter } else { 0 });
                points.push(s.point.to_array());
                normals.push(s.normal.to_array());
            }
        }
        let diagonal = Vec3::from(self.enclosure.low()).distance(self.enclosure.high().into());
        let nearest = nearest_surfels(&points, &normals, &self.surfels.discs, &near(diagonal, self.surfels.cell));
        (samples.neighbors, samples.weights) = (nearest.neighbors, nearest.weights);
        Compared { samples, points, normals }
    }
}

/// Fits colors and enclosure in turn.
fn rounds(fitter: &mut Fitter<'_>) {
    for _ in 0..ROUNDS {
        fitter.fit_colors();
        fitter.refine_enclosure();
    }
    fitter.fit_colors();
}
