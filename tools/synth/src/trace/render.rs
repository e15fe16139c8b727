//! Distribution of samples over pixels.
//!
//! Rows are rendered in parallel. Random numbers of a sample depend on (key, pixel, sample) alone, and sums have a
//! fixed order. The result is therefore the same for any number of threads.

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use crate::color::luminance;
use crate::rng;
use crate::scene::{MAX_GROUPS, Scene};
use crate::trace::camera::Camera;
use crate::trace::film::{Feature, Film, Pixel, feature};
use crate::trace::path::{PathOptions, Sight, first_hit, trace};
use crate::trace::sampler::Sampler;

/// Renders one view with `samples` paths per pixel or more.
///
/// Calls `row_done` once for every finished row.
pub(crate) fn render(
    scene: &Scene,
    camera: &Camera,
    key: u64,
    samples: usize,
    options: &PathOptions,
    row_done: &(dyn Fn() + Sync),
) -> Film {
    let rows: Vec<Vec<(Pixel, Feature)>> = (0..camera.height)
        .into_par_iter()
        .map(|y| {
            let row = (0..camera.width)
                .map(|x| {
                    let center = Vec2::new(x as f32 + 0.5, y as f32 + 0.5);
                    let pixel = pixel(scene, camera, x, y, key, samples, options);
                    (pixel, feature(scene, camera, center))
                })
                .collect();
            row_done();
            row
        })
        .collect();
    let (pixels, features) = rows.into_iter().flatten().unzip();
    Film { width: camera.width, height: camera.height, pixels, features }
}

/// Factor on the paths of a pixel that covers several surfaces.
///
/// Denoising finds no neighbors to average over there.
const EDGE: usize = 2;

/// Factor on the paths of a pixel that shows a mirror.
///
/// The denoiser cannot separate a reflected image from noise.
const POLISHED: usize = 4;

/// Number of additional primary rays of a pixel that covers several surfaces.
///
/// They measure the fraction of the pixel that each surface covers.
const COVERAGE: usize = 256;

/// First and second moments of a luminance.
#[derive(Clone, Copy, Default)]
struct Moments(f32, f32);

impl Moments {
    fn add(&mut self, value: f32) {
        self.0 += value;
        self.1 += value * value;
    }

    /// Returns the variance of the mean of `n` values.
    fn variance(self, n: f32) -> f32 {
        let mean = self.0 / n;
        (self.1 / n - mean * mean).max(0.0) / n
    }
}

/// Coverage of a pixel: sums over primary rays.
#[derive(Default)]
struct Coverage {
    rays: f32,
    surfaces: f32,
    diffuse_albedo: Vec3,
    albedo: Vec3,
    roughness: f32,
    metallic: f32,
    emitted: [Vec3; MAX_GROUPS],
}

impl Coverage {
    fn add(&mut self, sight: &Sight) {
        self.rays += 1.0;
        if let Some(surface) = sight.surface {
            self.surfaces += 1.0;
            self.diffuse_albedo += surface.diffuse();
            self.albedo += surface.albedo;
            self.roughness += surface.roughness;
            self.metallic += surface.metallic;
        }
        self.emitted[sight.group] += sight.emitted;
    }

    /// Returns the mean diffuse albedo over all rays, with lights as black.
    fn mean_albedo(&self) -> Vec3 {
        self.diffuse_albedo / self.rays.max(1.0)
    }
}

/// Renders one pixel with a box filter.
fn pixel(scene: &Scene, camera: &Camera, x: usize, y: usize, key: u64, samples: usize, options: &PathOptions) -> Pixel {
    let key = rng::key(&[key, (y * camera.width + x) as u64]);
    let corner = Vec2::new(x as f32, y as f32);
    let mut sum = Pixel::default();
    let mut coverage = Coverage::default();
    let (mut diffuse_moments, mut specular_moments) = (Moments::default(), Moments::default());
    let groups = scene.groups.len();
    let mut first = None;
    let (mut mixed, mut polished) = (false, false);
    let (mut index, mut end) = (0, samples);
    while index < end {
        let mut sampler = Sampler::new(key, index as u32);
        let direction = camera.direction(corner + sampler.pair());
        let (sight, path) = trace(scene, camera.position, direction, &mut sampler, options);
        coverage.add(&sight);
        let (mut diffuse, mut specular) = (Vec3::ZERO, Vec3::ZERO);
        for g in 0..groups {
            sum.diffuse[g] += path.diffuse[g];
            sum.specular[g] += path.specular[g];
            diffuse += path.diffuse[g];
            specular += path.specular[g];
        }
        let albedo = sight.surface.map_or(Vec3::ONE, |s| s.diffuse());
        diffuse_moments.add(luminance(diffuse / albedo.max(Vec3::splat(1e-3))));
        specular_moments.add(luminance(specular));
        let (instance, normal) = *first.get_or_insert((sight.instance, sight.normal));
        mixed |= instance != sight.instance || normal.dot(sight.normal) < 0.95;
        polished |= sight.surface.is_some_and(|s| s.metallic > 0.5 && s.roughness < 0.2);
        index += 1;
        if index == samples {
            end *= match (mixed, polished) {
                (_, true) => POLISHED,
                (true, _) => EDGE,
                _ => 1,
            };
        }
    }
    let n = end as f32;
    let by_paths = coverage.mean_albedo();
    if mixed {
        let key = rng::key(&[key, 0xc0fe]);
        for index in 0..COVERAGE {
            let mut sampler = Sampler::new(key, index as u32);
            let direction = camera.direction(corner + sampler.pair());
            coverage.add(&first_hit(scene, camera.position, direction).0);
        }
    }
    // Diffuse radiance is proportional to the albedo that its paths hit. The coverage rays estimate the pixel's albedo
    // more precisely, so the radiance is rescaled to that estimate.
    let known = coverage.mean_albedo();
    let ratio = known / by_paths.max(Vec3::splat(1e-6));
    for g in 0..groups {
        sum.diffuse[g] *= ratio / n;
        sum.specular[g] /= n;
        sum.emitted[g] = coverage.emitted[g] / coverage.rays;
    }
    let met = coverage.surfaces.max(1.0);
    sum.diffuse_albedo = known;
    sum.albedo = coverage.albedo / met;
    sum.roughness = coverage.roughness / met;
    sum.metallic = coverage.metallic / met;
    sum.diffuse_variance = diffuse_moments.variance(n);
    sum.specular_variance = specular_moments.variance(n);
    sum
}
