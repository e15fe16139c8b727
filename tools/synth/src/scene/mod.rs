//! The room: triangles with materials, lights, the environment, and what belongs to which object.
//!
//! A scene is built once through [`builder::Builder`] and then only read. It knows nothing of cameras, samples or
//! files.

pub(crate) mod builder;
pub(crate) mod classes;
pub(crate) mod furniture;
pub(crate) mod layout;
pub(crate) mod light;
pub(crate) mod material;
pub(crate) mod mesh;
pub(crate) mod painting;
pub(crate) mod room;
pub(crate) mod simple;
pub(crate) mod sky;
pub(crate) mod style;
pub(crate) mod surfaces;
pub(crate) mod texture;
pub(crate) mod theme;

use glam::Vec3;

use crate::options::SceneName;
use light::{Emission, Light};
use material::Material;
use sky::Sky;
use surfaces::Surfaces;

/// How many light groups a scene may have; films keep one set of sums for each.
pub(crate) const MAX_GROUPS: usize = 4;

/// A thing that can be pointed at: its masks carry one id in every view.
#[derive(Debug, Clone)]
pub(crate) struct Instance {
    /// A name, unique in the scene.
    pub(crate) name: String,
    /// Index into [`classes::CLASSES`].
    pub(crate) class: u16,
}

/// A light group's name and how it takes part in the relit sets.
#[derive(Debug, Clone)]
pub(crate) struct Group {
    /// The name in `gt/lights.json`.
    pub(crate) name: String,
    /// Windows are dimmed at night, lamps recolored.
    pub(crate) window: bool,
}

/// An axis-aligned box.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Bounds {
    /// Smallest corner.
    pub(crate) min: Vec3,
    /// Largest corner.
    pub(crate) max: Vec3,
}

/// Everything a ray can meet.
pub(crate) struct Scene {
    /// Triangles behind an acceleration structure.
    pub(crate) surfaces: Surfaces,
    /// Materials by index.
    pub(crate) materials: Vec<Material>,
    /// Lights by index.
    pub(crate) lights: Vec<Light>,
    /// Light groups by index, at most [`MAX_GROUPS`].
    pub(crate) groups: Vec<Group>,
    /// The environment behind windows.
    pub(crate) sky: Sky,
    /// Radiance of rays that escape; black in rooms, used by tests.
    pub(crate) background: Vec3,
    /// Instances by id; id 0 means nothing.
    pub(crate) instances: Vec<Instance>,
    /// The free space inside the walls.
    pub(crate) interior: Bounds,
    /// Boxes around furniture that a camera must stay out of.
    pub(crate) obstacles: Vec<Bounds>,
    /// The point that cameras look across.
    pub(crate) focus: Vec3,
}

impl Scene {
    /// Builds a scene by name; the seed chooses what varies.
    pub(crate) fn build(name: SceneName, seed: u64) -> Self {
        match name {
            SceneName::Box => simple::build(seed),
            room => layout::build(style::Style::of(room), seed),
        }
    }

    /// Multiplies all light by a factor.
    pub(crate) fn scale_light(&mut self, factor: f32) {
        self.sky = self.sky.scaled(factor);
        for light in &mut self.lights {
            if let Emission::Constant(radiance) = &mut light.emission {
                *radiance *= factor;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_scene_is_complete_for_several_seeds() {
        for name in SceneName::ALL {
            for seed in [0, 1, 2, 77] {
                let scene = Scene::build(name, seed);
                assert!(!scene.lights.is_empty(), "{name} {seed} has lights");
                assert!(scene.groups.len() <= MAX_GROUPS);
                assert!(scene.instances.len() > 3 && scene.instances.len() < 200);
                assert!(scene.lights.iter().all(|l| l.group < scene.groups.len()));
                let mut names: Vec<_> = scene.instances.iter().map(|i| &i.name).collect();
                names.sort();
                names.dedup();
                assert_eq!(names.len(), scene.instances.len(), "names are unique");
            }
        }
    }

    #[test]
    fn seeds_change_the_room() {
        let a = Scene::build(SceneName::LivingRoom, 1);
        let b = Scene::build(SceneName::LivingRoom, 2);
        assert_ne!(a.interior, b.interior);
        assert_ne!(a.obstacles, b.obstacles);
    }
}
