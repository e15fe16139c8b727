//! Explanation of photographs by emitters and bounced light.
//!
//! 1. Emitters that photographs show are candidates ([`crate::emitters`]).
//! 2. The fit ([`crate::fit`]) finds their colors and the albedo of the enclosure.
//! 3. Spheres move to where they explain the photographs best ([`crate::placement`]).
//! 4. Hidden lights, which no photograph shows well enough, are searched on a grid. The position that explains the photographs
//!    best becomes an emitter if the PSNR rises by [`LEAST_GAIN`](crate::placement::LEAST_GAIN). Then all spheres move again.
//! 5. The fit runs again. Candidates that it leaves dark are removed.
//!
//! Emitters whose shapes and places are known are only fitted (step 2).

use crate::emitters::{CLIPPED, find_emitters, is_clipped};
use crate::error::Result;
use crate::fit::{Fitter, Samples, UnitLight};
use crate::radiosity::{FACES, Radiosity};
use crate::room::{Room, SHEEN, near, reflectance, specular};
use crate::shown::Shown;
use crate::surfels::seen;
use crate::views::SeenViews;
use glam::Vec3;
use sgs_passes::transport::{AreaLight, LightShape, nearest_surfels};
use sgs_scene::{Image, Splats};

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
    /// Photographs hold display values, one image per view. Their invalid pixels were left out
    /// ([`SeenViews::exclude`]). `splats` are the Gaussians of which the room was built. `known`
    /// are the emitters in world units, if their shapes and places are known: none is searched, moved or dropped then.
    ///
    /// # Errors
    /// If a known emitter is invalid, or the device fails.
    pub fn explain(
        &self,
        views: &SeenViews,
        photographs: &[Image],
        splats: &Splats,
        known: Option<&[LightShape]>,
    ) -> Result<Explained> {
        let length = self.unit.length() as f32;
        let edge = self.surfels.cell;
        let mut found = Vec::new();
        let mut shapes: Vec<LightShape> = match known {
            Some(known) => {
                let lights: Vec<_> = known.iter().map(|shape| AreaLight { shape: *shape, color: [1.0; 3] }).collect();
                self.scaled(&lights)?.iter().map(|light| light.shape).collect()
            }
            None => {
                found = find_emitters(&views.views, photographs, &views.from, length, edge);
                found.retain(|e| AreaLight { shape: e.shape, color: [1.0; 3] }.check().is_ok());
                found.truncate(MOST_FOUND);
                found.iter().map(|e| e.shape).collect()
            }
        };
        let at_first = shapes.clone();
        let shown = |shapes| match known {
            Some(_) => Shown::Known { shapes, edge },
            None => Shown::found(&found, shapes, edge),
        };
        let compared = self.compared(&shown(&at_first), views, photographs);
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
        if known.is_none() {
            self.place(&mut shapes, &mut fitter, &compared)?;
            rounds(&mut fitter);
        }
        let of_gaussians = shown(&shapes).by_gaussians(views, photographs, &splats.means, self.unit);
        let least_power = if known.is_some() { None } else { Some(LEAST_POWER) };
        Ok(self.explained(&shapes, &fitter, of_gaussians, least_power))
    }

    /// Returns the result, without emitters that are too dark.
    ///
    /// `least`: minimum power as a share of that of the most powerful emitter; none keeps all.
    fn explained(
        &self,
        shapes: &[LightShape],
        fitter: &Fitter<'_>,
        of_gaussians: Vec<u32>,
        least: Option<f32>,
    ) -> Explained {
        let lights = shapes.iter().zip(fitter.colors()).map(|(shape, color)| AreaLight { shape: *shape, color });
        let lights: Vec<AreaLight> = lights.collect();
        let power = |light: &AreaLight| light.power().map_or(0.0, |p| p[0] + p[1] + p[2]);
        let most = lights.iter().map(power).fold(0.0, f32::max);
        let (mut emitters, mut numbers) = (Vec::new(), vec![0]);
        for light in &lights {
            let shines = least.is_none_or(|least| power(light) > least * most);
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

    /// Returns the pixels that the fit compares.
    fn compared(&self, shown: &Shown<'_>, views: &SeenViews, photographs: &[Image]) -> Compared {
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
                let clips = is_clipped(photograph, pixel);
                samples.emitters.push(if clips { shown.by_pixel(Vec3::from(*from) / unit, s.point) } else { 0 });
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
