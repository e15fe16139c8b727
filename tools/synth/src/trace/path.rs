//! One light path: next-event estimation at every surface, combined with reflected rays by multiple importance
//! sampling.
//!
//! The result keeps the first surface's diffuse and specular reflection apart (they are denoised differently) and
//! every light group apart (so that other lightings are sums of the same paths).

use glam::Vec3;

use crate::scene::material::Reflectance;
use crate::scene::surfaces::SurfacePoint;
use crate::scene::{MAX_GROUPS, Scene};
use crate::trace::brdf::Brdf;
use crate::trace::sampler::Sampler;
use crate::trace::scene::Hit;

/// How paths are followed.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PathOptions {
    /// Surfaces visited at most.
    pub(crate) bounces: usize,
    /// Whether lights are chosen and tested directly; without it they are only run into. For tests.
    pub(crate) next_event: bool,
    /// Largest radiance that one indirect event may add; infinity keeps the estimate unbiased.
    pub(crate) clamp: f32,
}

impl Default for PathOptions {
    fn default() -> Self {
        Self { bounces: 5, next_event: true, clamp: 12.0 }
    }
}

/// What a ray from the camera sees first.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Sight {
    /// What the surface is made of; none where a light or nothing was seen.
    pub(crate) surface: Option<Reflectance>,
    /// Radiance of a light seen directly.
    pub(crate) emitted: Vec3,
    /// The light's group.
    pub(crate) group: usize,
    /// The instance; zero where nothing was seen.
    pub(crate) instance: u16,
    /// Its normal, with lights counting as flat.
    pub(crate) normal: Vec3,
}

/// What one path brought by way of reflection, for each light group.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct PathSample {
    /// Radiance by way of the first surface's diffuse lobe.
    pub(crate) diffuse: [Vec3; MAX_GROUPS],
    /// Radiance by way of the first surface's specular lobe.
    pub(crate) specular: [Vec3; MAX_GROUPS],
}

/// Distance by which new rays start off the surface.
const OFFSET: f32 = 1e-4;

/// What a ray from the camera sees, and the surface point if there is one.
pub(crate) fn look(scene: &Scene, origin: Vec3, direction: Vec3) -> (Sight, Option<SurfacePoint>) {
    let mut sight = Sight::default();
    match scene.hit(origin, direction) {
        None => {
            sight.emitted = scene.background;
            (sight, None)
        }
        Some(Hit::Light(index, _, front)) => {
            let light = &scene.lights[index];
            sight.instance = light.instance;
            sight.normal = -direction;
            sight.group = light.group;
            if front {
                sight.emitted = light.radiance(direction, &scene.sky);
            }
            (sight, None)
        }
        Some(Hit::Surface(hit)) => {
            let point = scene.surfaces.point(origin, direction, hit);
            sight.surface = Some(scene.materials[point.material as usize].at(point.uv));
            sight.instance = point.instance;
            sight.normal = point.normal;
            (sight, Some(point))
        }
    }
}

/// Follows one path from the camera.
pub(crate) fn trace(
    scene: &Scene,
    origin: Vec3,
    direction: Vec3,
    sampler: &mut Sampler,
    options: &PathOptions,
) -> (Sight, PathSample) {
    let (sight, first) = look(scene, origin, direction);
    let mut out = PathSample::default();
    let (Some(first), Some(mut reflectance)) = (first, sight.surface) else {
        return (sight, out);
    };
    let mut point = first;
    let mut view = -direction;
    // Reflectance of the first surface by lobe; what arrives there is gathered in `incoming` and multiplied at the end.
    let (mut first_diffuse, mut first_specular) = (Vec3::ZERO, Vec3::ZERO);
    let mut incoming = [Vec3::ZERO; MAX_GROUPS];
    let mut throughput = Vec3::ONE;
    for bounce in 0..options.bounces {
        if bounce > 0 {
            reflectance = scene.materials[point.material as usize].at(point.uv);
        }
        let brdf = Brdf::new(&reflectance, point.normal, view);
        let start = point.position + point.geometric * OFFSET;
        if options.next_event
            && let Some((group, radiance, lobes)) = direct(scene, &point, &brdf, start, sampler)
        {
            if bounce == 0 {
                out.diffuse[group] += lobes.0 * radiance;
                out.specular[group] += lobes.1 * radiance;
            } else {
                let add = throughput * (lobes.0 + lobes.1) * radiance;
                incoming[group] += limit(add, options.clamp);
            }
        }
        let (lobe, random) = (sampler.single(), sampler.pair());
        let Some((next, lobes)) = brdf.sample(lobe, random) else {
            break;
        };
        if next.dot(point.geometric) <= 0.0 {
            break;
        }
        if bounce == 0 {
            first_diffuse = lobes.diffuse / lobes.pdf;
            first_specular = lobes.specular / lobes.pdf;
        } else {
            throughput *= lobes.total() / lobes.pdf;
        }
        match scene.hit(start, next) {
            None => {
                incoming[0] += throughput * scene.background;
                break;
            }
            Some(Hit::Light(index, distance, front)) => {
                if front {
                    let light = &scene.lights[index];
                    let weight = if options.next_event {
                        let chosen =
                            scene.choice_probability(start, point.normal, index) * light.pdf(start, next, distance);
                        heuristic(lobes.pdf, chosen)
                    } else {
                        1.0
                    };
                    let add = throughput * light.radiance(next, &scene.sky) * weight;
                    incoming[light.group] += if bounce == 0 { add } else { limit(add, options.clamp) };
                }
                break;
            }
            Some(Hit::Surface(hit)) => point = scene.surfaces.point(start, next, hit),
        }
        view = -next;
        if bounce >= 1 {
            let survive = (throughput * (first_diffuse + first_specular)).max_element().min(0.95);
            if sampler.single() >= survive {
                break;
            }
            throughput /= survive;
        }
    }
    for group in 0..scene.groups.len() {
        out.diffuse[group] += first_diffuse * incoming[group];
        out.specular[group] += first_specular * incoming[group];
    }
    (sight, out)
}

/// The light group, the weighed radiance and the two lobes of one directly sampled light.
fn direct(
    scene: &Scene,
    point: &SurfacePoint,
    brdf: &Brdf,
    start: Vec3,
    sampler: &mut Sampler,
) -> Option<(usize, Vec3, (Vec3, Vec3))> {
    let (choice, random) = (sampler.single(), sampler.pair());
    let (index, probability) = scene.choose_light(start, point.normal, choice)?;
    let light = &scene.lights[index];
    let toward = light.sample(start, random)?;
    if toward.direction.dot(point.geometric) <= 0.0 {
        return None;
    }
    let lobes = brdf.eval(toward.direction);
    if lobes.total().max_element() <= 0.0 || !scene.sees(start, toward.direction, toward.distance, index) {
        return None;
    }
    let pdf = probability * toward.pdf;
    let weight = heuristic(pdf, lobes.pdf) / pdf;
    let radiance = light.radiance(toward.direction, &scene.sky) * weight;
    Some((light.group, radiance, (lobes.diffuse, lobes.specular)))
}

/// The weight of a technique with probability `own` when another has probability `other`.
fn heuristic(own: f32, other: f32) -> f32 {
    let ratio = other / own;
    1.0 / (1.0 + ratio * ratio)
}

/// Scales a color down so that no channel exceeds a bound.
fn limit(color: Vec3, bound: f32) -> Vec3 {
    let peak = color.max_element();
    if peak > bound { color * (bound / peak) } else { color }
}
