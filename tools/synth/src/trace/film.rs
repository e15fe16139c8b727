//! Film of one view: per-pixel results in rows from the top.

use glam::{Vec2, Vec3};

use crate::scene::{MAX_GROUPS, Scene};
use crate::trace::camera::Camera;
use crate::trace::scene::Hit;

/// Means over a pixel's samples.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Pixel {
    /// Diffusely reflected radiance by light group.
    pub(crate) diffuse: [Vec3; MAX_GROUPS],
    /// Specularly reflected radiance by light group.
    pub(crate) specular: [Vec3; MAX_GROUPS],
    /// Radiance of directly visible lights, by light group.
    pub(crate) emitted: [Vec3; MAX_GROUPS],
    /// Diffuse albedo over all samples, with lights as black; divisor of diffuse radiance.
    pub(crate) diffuse_albedo: Vec3,
    /// Base color over the samples that hit a surface.
    pub(crate) albedo: Vec3,
    /// Roughness over the samples that hit a surface.
    pub(crate) roughness: f32,
    /// Metallic over the samples that hit a surface.
    pub(crate) metallic: f32,
    /// Variance of the mean of the diffuse luminance, over all groups together.
    ///
    /// Luminance is that of radiance divided by the diffuse albedo.
    pub(crate) diffuse_variance: f32,
    /// Variance of the mean of the specular luminance.
    pub(crate) specular_variance: f32,
}

/// Geometry at a pixel's center.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Feature {
    /// World position; the origin where the ray hit nothing.
    pub(crate) position: Vec3,
    /// Unit world normal, towards the camera on surfaces; zero where the ray hit nothing.
    pub(crate) normal: Vec3,
    /// Depth along the viewing axis; zero where the ray hit nothing.
    pub(crate) depth: f32,
    /// Instance id; zero where the ray hit nothing.
    pub(crate) instance: u16,
    /// Class id.
    pub(crate) class: u16,
    /// True for a reflecting surface, false for a light or a miss.
    pub(crate) surface: bool,
    /// Roughness at the center.
    pub(crate) roughness: f32,
}

/// Rendered view.
pub(crate) struct Film {
    /// Width in pixels.
    pub(crate) width: usize,
    /// Height in pixels.
    pub(crate) height: usize,
    /// Radiance and reflectance.
    pub(crate) pixels: Vec<Pixel>,
    /// Geometry at pixel centers.
    pub(crate) features: Vec<Feature>,
}

/// Returns the geometry at a point of the image.
pub(crate) fn feature(scene: &Scene, camera: &Camera, pixel: Vec2) -> Feature {
    let direction = camera.direction(pixel);
    let class = |instance: u16| scene.instances[instance as usize].class;
    match scene.hit(camera.position, direction) {
        None => Feature::default(),
        Some(Hit::Light(index, distance, _)) => {
            let instance = scene.lights[index].instance;
            let position = camera.position + distance * direction;
            Feature {
                position,
                normal: scene.lights[index].normal(position),
                depth: camera.depth(direction, distance),
                instance,
                class: class(instance),
                roughness: 1.0,
                ..Feature::default()
            }
        }
        Some(Hit::Surface(hit)) => {
            let point = scene.surfaces.point(camera.position, direction, hit);
            let reflectance = scene.materials[point.material as usize].at(point.uv);
            Feature {
                position: point.position,
                normal: point.normal,
                depth: camera.depth(direction, hit.distance),
                instance: point.instance,
                class: class(point.instance),
                surface: true,
                roughness: reflectance.roughness,
            }
        }
    }
}
