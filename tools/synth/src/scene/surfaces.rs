//! Triangles with attributes and a bounding-volume hierarchy.

use std::time::Duration;

use glam::{Vec2, Vec3, Vec3A};
use obvhs::BvhBuildParams;
use obvhs::cwbvh::CwBvh;
use obvhs::cwbvh::builder::build_cwbvh_from_tris;
use obvhs::ray::{Ray, RayHit};
use obvhs::rt_triangle::RtTriangle;
use obvhs::triangle::Triangle;

/// Attributes of a triangle.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Attributes {
    /// Unit normals at the corners.
    pub(crate) normals: [Vec3; 3],
    /// Texture coordinates at the corners.
    pub(crate) uvs: [Vec2; 3],
    /// Index of the material.
    pub(crate) material: u16,
    /// Id of the instance.
    pub(crate) instance: u16,
}

/// Intersection of a ray with a triangle.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SurfaceHit {
    /// Distance along the ray.
    pub(crate) distance: f32,
    /// Index of the triangle.
    pub(crate) triangle: usize,
}

/// Point on a surface, oriented towards the viewer.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SurfacePoint {
    /// World position.
    pub(crate) position: Vec3,
    /// Normal of the flat triangle, on the viewer's side.
    pub(crate) geometric: Vec3,
    /// Interpolated unit normal, on the viewer's side.
    pub(crate) normal: Vec3,
    /// Texture coordinates.
    pub(crate) uv: Vec2,
    /// Index of the material.
    pub(crate) material: u16,
    /// Id of the instance.
    pub(crate) instance: u16,
}

/// All triangles, in the order in which the hierarchy stores them.
#[derive(Clone)]
pub(crate) struct Surfaces {
    bvh: CwBvh,
    corners: Vec<RtTriangle>,
    attributes: Vec<Attributes>,
}

impl Surfaces {
    /// Builds the hierarchy.
    pub(crate) fn new(triangles: &[Triangle], attributes: &[Attributes]) -> Self {
        let mut elapsed = Duration::ZERO;
        let bvh = build_cwbvh_from_tris(triangles, BvhBuildParams::slow_build(), &mut elapsed);
        // Storing triangles in the hierarchy's primitive order saves an indirection.
        let order = bvh.primitive_indices.iter().map(|i| *i as usize);
        let corners = order.clone().map(|i| RtTriangle::from(&triangles[i])).collect();
        let attributes = order.map(|i| attributes[i]).collect();
        Self { bvh, corners, attributes }
    }

    /// Returns the number of triangles.
    pub(crate) fn len(&self) -> usize {
        self.corners.len()
    }

    /// Returns the nearest intersection before `limit`.
    pub(crate) fn closest(&self, origin: Vec3, direction: Vec3, limit: f32) -> Option<SurfaceHit> {
        let ray = Ray::new(Vec3A::from(origin), Vec3A::from(direction), 0.0, limit);
        let mut hit = RayHit::none();
        self.bvh.ray_traverse(ray, &mut hit, |ray, id| self.corners[id].intersect(ray));
        (hit.t < limit).then_some(SurfaceHit { distance: hit.t, triangle: hit.primitive_id as usize })
    }

    /// Returns true if a triangle lies before `limit`.
    pub(crate) fn occluded(&self, origin: Vec3, direction: Vec3, limit: f32) -> bool {
        let ray = Ray::new(Vec3A::from(origin), Vec3A::from(direction), 0.0, limit);
        !self.bvh.ray_traverse_miss(ray, |ray, id| self.corners[id].intersect(ray))
    }

    /// Returns the surface point of an intersection.
    pub(crate) fn point(&self, origin: Vec3, direction: Vec3, hit: SurfaceHit) -> SurfacePoint {
        let corners = &self.corners[hit.triangle];
        let attributes = &self.attributes[hit.triangle];
        let ray = Ray::new_inf(Vec3A::from(origin), Vec3A::from(direction));
        let b = corners.compute_barycentric(&ray);
        let weights = Vec3::new(1.0 - b.x - b.y, b.x, b.y);
        let blend3 = |v: &[Vec3; 3]| weights.x * v[0] + weights.y * v[1] + weights.z * v[2];
        let uvs = &attributes.uvs;
        let mut geometric = Vec3::from(corners.compute_normal());
        if geometric.dot(direction) > 0.0 {
            geometric = -geometric;
        }
        let mut normal = blend3(&attributes.normals).normalize_or(geometric);
        if normal.dot(geometric) < 0.0 {
            normal = -normal;
        }
        // Interpolated normals may point away from a grazing viewer; shading needs the viewer above the surface.
        let lean = normal.dot(direction);
        if lean > -1e-3 {
            normal = (normal - direction * (lean + 2e-3)).normalize_or(geometric);
        }
        SurfacePoint {
            position: origin + hit.distance * direction,
            geometric,
            normal,
            uv: weights.x * uvs[0] + weights.y * uvs[1] + weights.z * uvs[2],
            material: attributes.material,
            instance: attributes.instance,
        }
    }
}
