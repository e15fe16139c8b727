//! Scene: triangles with materials, lights, the environment map, and object instances.
//!
//! [`builder::Builder`] builds a scene once; after that the scene is read-only. It does not depend on cameras, samples
//! or files.

pub(crate) mod added;
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
use sky::{Sky, Sun};
use surfaces::Surfaces;

/// Largest number of light groups in a scene. Films store one set of sums per group.
///
/// Furnished rooms have four. A lamp that is added to them ([`added`]) has the fifth.
pub(crate) const MAX_GROUPS: usize = 5;

/// Object instance. Its masks have the same id in every view.
#[derive(Debug, Clone)]
pub(crate) struct Instance {
    /// Name, unique in the scene.
    pub(crate) name: String,
    /// Index into [`classes::CLASSES`].
    pub(crate) class: u16,
}

/// Light group.
#[derive(Debug, Clone)]
pub(crate) struct Group {
    /// Name in `gt/lights.json`.
    pub(crate) name: String,
    /// True for windows. The night relighting dims windows and recolors lamps.
    pub(crate) window: bool,
}

/// Axis-aligned box.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Bounds {
    /// Smallest corner.
    pub(crate) min: Vec3,
    /// Largest corner.
    pub(crate) max: Vec3,
}

/// Scene that rays intersect.
#[derive(Clone)]
pub(crate) struct Scene {
    /// Triangles with an acceleration structure.
    pub(crate) surfaces: Surfaces,
    /// Materials by index.
    pub(crate) materials: Vec<Material>,
    /// Lights by index.
    pub(crate) lights: Vec<Light>,
    /// Light groups by index, at most [`MAX_GROUPS`].
    pub(crate) groups: Vec<Group>,
    /// Environment map behind windows.
    pub(crate) sky: Sky,
    /// Sun behind windows, beside that of the environment map.
    pub(crate) sun: Option<Sun>,
    /// Radiance of rays that escape. Black in rooms; tests set other values.
    pub(crate) background: Vec3,
    /// Instances by id. Id 0 means no instance.
    pub(crate) instances: Vec<Instance>,
    /// Free space inside the walls.
    pub(crate) interior: Bounds,
    /// Boxes around furniture that cameras must not enter.
    pub(crate) obstacles: Vec<Bounds>,
    /// Point that cameras look across.
    pub(crate) focus: Vec3,
}

impl Scene {
    /// Builds a scene by name. The seed chooses its variation.
    pub(crate) fn build(name: SceneName, seed: u64) -> Self {
        match name {
            SceneName::Box => simple::build(seed),
            room => layout::build(style::Style::of(room), seed),
        }
    }

    /// Multiplies all emitted light by a factor.
    pub(crate) fn scale_light(&mut self, factor: f32) {
        self.sky = self.sky.scaled(factor);
        self.sun = self.sun.map(|sun| Sun { irradiance: sun.irradiance * factor, ..sun });
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
    fn scenes_are_complete_for_several_seeds() {
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
    fn seed_changes_room_and_obstacles() {
        let a = Scene::build(SceneName::LivingRoom, 1);
        let b = Scene::build(SceneName::LivingRoom, 2);
        assert_ne!(a.interior, b.interior);
        assert_ne!(a.obstacles, b.obstacles);
    }
}
