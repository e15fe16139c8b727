//! Builder that collects triangles, materials, lights and objects into a [`Scene`].
//!
//! Shapes are given in the frame of the open object; [`Builder::object`] opens one. [`super::mesh`] turns shapes into
//! triangles.

use glam::{Affine3A, Vec2, Vec3};
use obvhs::triangle::Triangle;

use crate::scene::classes::class_id;
use crate::scene::light::{Emission, Light, Shape};
use crate::scene::material::Material;
use crate::scene::sky::Sky;
use crate::scene::surfaces::{Attributes, Surfaces};
use crate::scene::{Bounds, Group, Instance, MAX_GROUPS, Scene};

/// Vertex of a triangle in the object's frame.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Vertex {
    /// Position.
    pub(crate) position: Vec3,
    /// Unit normal.
    pub(crate) normal: Vec3,
    /// Texture coordinates.
    pub(crate) uv: Vec2,
}

/// Scene under construction.
pub(crate) struct Builder {
    triangles: Vec<Triangle>,
    attributes: Vec<Attributes>,
    materials: Vec<Material>,
    lights: Vec<Light>,
    groups: Vec<Group>,
    instances: Vec<Instance>,
    obstacles: Vec<Bounds>,
    frame: Affine3A,
    material: u16,
    instance: u16,
    opened_at: usize,
}

impl Builder {
    /// Creates an empty scene.
    pub(crate) fn new() -> Self {
        Self {
            triangles: Vec::new(),
            attributes: Vec::new(),
            materials: Vec::new(),
            lights: Vec::new(),
            groups: Vec::new(),
            instances: vec![Instance { name: "nothing".to_owned(), class: 0 }],
            obstacles: Vec::new(),
            frame: Affine3A::IDENTITY,
            material: 0,
            instance: 0,
            opened_at: 0,
        }
    }

    /// Adds a material and makes it current.
    pub(crate) fn material(&mut self, material: Material) -> u16 {
        self.materials.push(material);
        self.material = (self.materials.len() - 1) as u16;
        self.material
    }

    /// Makes a material current.
    pub(crate) fn paint(&mut self, material: u16) {
        self.material = material;
    }

    /// Opens an object, which owns the following shapes; `frame` places them. A number makes a repeated name unique.
    pub(crate) fn object(&mut self, name: &str, class: &str, frame: Affine3A) -> u16 {
        let taken = |candidate: &str| self.instances.iter().any(|i| i.name == candidate);
        let mut unique = name.to_owned();
        let mut number = 2;
        while taken(&unique) {
            unique = format!("{name}_{number}");
            number += 1;
        }
        self.instances.push(Instance { name: unique, class: class_id(class) });
        self.instance = (self.instances.len() - 1) as u16;
        self.frame = frame;
        self.opened_at = self.triangles.len();
        self.instance
    }

    /// Makes every material purely diffuse.
    pub(crate) fn without_specular(&mut self) {
        for material in &mut self.materials {
            material.specular = 0.0;
            material.metallic = 0.0;
        }
    }

    /// Sets the frame of the open object.
    pub(crate) fn frame(&mut self, frame: Affine3A) {
        self.frame = frame;
    }

    /// Adds the bounds of the open object to the obstacles of cameras.
    pub(crate) fn obstacle(&mut self) {
        let (mut min, mut max) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
        for t in &self.triangles[self.opened_at..] {
            for corner in [t.v0, t.v1, t.v2] {
                min = min.min(corner.into());
                max = max.max(corner.into());
            }
        }
        if min.is_finite() && max.is_finite() {
            self.obstacles.push(Bounds { min, max });
        }
    }

    /// Adds a triangle in the open object's frame. Skips degenerate triangles.
    pub(crate) fn triangle(&mut self, corners: [Vertex; 3]) {
        let [a, b, c] = corners.map(|v| self.frame.transform_point3(v.position));
        if (b - a).cross(c - a).length_squared() < 1e-18 {
            return;
        }
        self.triangles.push(Triangle { v0: a.into(), v1: b.into(), v2: c.into() });
        self.attributes.push(Attributes {
            normals: corners.map(|v| self.frame.transform_vector3(v.normal).normalize()),
            uvs: corners.map(|v| v.uv),
            material: self.material,
            instance: self.instance,
        });
    }

    /// Returns the index of a light group and creates a missing one.
    ///
    /// Once [`MAX_GROUPS`] exist, further names share the last one.
    pub(crate) fn group(&mut self, name: &str, window: bool) -> usize {
        if let Some(found) = self.groups.iter().position(|g| g.name == name) {
            return found;
        }
        if self.groups.len() < MAX_GROUPS {
            self.groups.push(Group { name: name.to_owned(), window });
        }
        self.groups.len() - 1
    }

    /// Adds a light in the open object's frame. The light belongs to that object.
    pub(crate) fn light(&mut self, name: &str, group: usize, shape: Shape, emission: Emission) {
        let shape = match shape {
            Shape::Sphere { center, radius } => Shape::Sphere { center: self.frame.transform_point3(center), radius },
            Shape::Rect { corner, u, v } => Shape::Rect {
                corner: self.frame.transform_point3(corner),
                u: self.frame.transform_vector3(u),
                v: self.frame.transform_vector3(v),
            },
        };
        self.lights.push(Light { name: name.to_owned(), group, shape, emission, instance: self.instance });
    }

    /// Finishes the scene.
    pub(crate) fn finish(mut self, interior: Bounds, focus: Vec3, sky: Sky) -> Scene {
        if self.groups.is_empty() {
            self.group("lights", false);
        }
        Scene {
            surfaces: Surfaces::new(&self.triangles, &self.attributes),
            materials: self.materials,
            lights: self.lights,
            groups: self.groups,
            sky,
            sun: None,
            background: Vec3::ZERO,
            instances: self.instances,
            interior,
            obstacles: self.obstacles,
            focus,
        }
    }
}
