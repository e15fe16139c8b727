//! Path tracing with next-event estimation at every surface.
//!
//! Multiple importance sampling combines light samples with BRDF samples. The result separates the first surface's
//! diffuse and specular reflection, because they are denoised differently. It also separates light groups, so that
//! other lightings are weighted sums of the same paths.

use glam::Vec3;

use crate::scene::light::Emission;
use crate::scene::material::Reflectance;
use crate::scene::surfaces::SurfacePoint;
use crate::scene::{MAX_GROUPS, Scene};
use crate::trace::brdf::Brdf;
use crate::trace::sampler::Sampler;
use crate::trace::scene::Hit;

/// Options of path tracing.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PathOptions {
    /// Largest number of surfaces on a path.
    pub(crate) bounces: usize,
    /// Enables light sampling. Without it only BRDF samples find lights; for tests.
    pub(crate) next_event: bool,
    /// Largest radiance of one indirect contribution. Infinity keeps the estimate unbiased.
    pub(crate) clamp: f32,
}

impl Default for PathOptions {
    fn default() -> Self {
        Self { bounces: 5, next_event: true, clamp: 12.0 }
    }
}

/// First intersection of a camera ray.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Sight {
    /// Reflectance of the surface; none for a light or a miss.
    pub(crate) surface: Option<Reflectance>,
    /// Radiance of a directly visible light, or of the background.
    pub(crate) emitted: Vec3,
    /// Group of the light.
    pub(crate) group: usize,
    /// Instance id; zero for a miss.
    pub(crate) instance: u16,
    /// Surface normal; the reversed ray direction for a light.
    pub(crate) normal: Vec3,
}

/// Reflected radiance of one path, for each light group.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct PathSample {
    /// Radiance through the first surface's diffuse lobe.
    pub(crate) diffuse: [Vec3; MAX_GROUPS],
    /// Radiance through the first surface's specular lobe.
    pub(crate) specular: [Vec3; MAX_GROUPS],
}

/// Distance of new ray origins from the surface.
const OFFSET: f32 = 1e-4;

/// Returns the first intersection of a camera ray, and its surface point if any.
pub(crate) fn first_hit(scene: &Scene, origin: Vec3, direction: Vec3) -> (Sight, Option<SurfacePoint>) {
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

/// Traces one path from the camera.
pub(crate) fn trace(
    scene: &Scene,
    origin: Vec3,
    direction: Vec3,
    sampler: &mut Sampler,
    options: &PathOptions,
) -> (Sight, PathSample) {
    let (sight, first) = first_hit(scene, origin, direction);
    let mut out = PathSample::default();
    let (Some(first), Some(mut reflectance)) = (first, sight.surface) else {
        return (sight, out);
    };
    let mut point = first;
    let mut view = -direction;
    // Reflectance of the first surface by lobe. `incoming` sums its incident radiance; the product is taken at the end.
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
        if let Some((group, lobes)) = sunlight(scene, &point, &brdf, start) {
            if bounce == 0 {
                out.diffuse[group] += lobes.0;
                out.specular[group] += lobes.1;
            } else {
                incoming[group] += limit(throughput * (lobes.0 + lobes.1), options.clamp);
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

/// Samples one light. Returns its group, the weighted radiance and the two lobes.
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

/// Returns the reflected radiance of the sun by lobe, and its light group.
///
/// The group is that of the window through which it shines.
fn sunlight(scene: &Scene, point: &SurfacePoint, brdf: &Brdf, start: Vec3) -> Option<(usize, (Vec3, Vec3))> {
    let sun = scene.sun?;
    if sun.toward.dot(point.geometric) <= 0.0 {
        return None;
    }
    let Some(Hit::Light(index, _, true)) = scene.hit(start, sun.toward) else { return None };
    let window = &scene.lights[index];
    let lobes = brdf.eval(sun.toward);
    let shines = matches!(window.emission, Emission::Sky);
    shines.then(|| (window.group, (lobes.diffuse * sun.irradiance, lobes.specular * sun.irradiance)))
}

/// Returns the power-heuristic weight of density `own` against density `other`.
fn heuristic(own: f32, other: f32) -> f32 {
    let ratio = other / own;
    1.0 / (1.0 + ratio * ratio)
}

/// Scales a color down so that no channel exceeds a bound.
fn limit(color: Vec3, bound: f32) -> Vec3 {
    let peak = color.max_element();
    if peak > bound { color * (bound / peak) } else { color }
}
