//! Room with a lamp that its photographs do not have.

use std::f32::consts::PI;

use glam::Vec3;

use crate::color::luminance;
use crate::scene::classes::class_id;
use crate::scene::light::{Emission, Light, Shape};
use crate::scene::{Group, Instance, MAX_GROUPS, Scene};

/// Name of the lamp, its group and its object.
pub(crate) const NAME: &str = "lamp_added";

/// Radius of the lamp, a sphere.
///
/// Relit images do not show the surface of a new light. It must cover few pixels.
const RADIUS: f32 = 0.03;

/// Height of its center above the surface below.
const ABOVE: f32 = 0.45;

/// Color, with luminance near 1. No lamp of a room has it.
const COLOR: Vec3 = Vec3::new(0.35, 1.05, 2.3);

/// Returns the scene with the lamp, its last light.
///
/// The lamp is as bright as the brightest lamp of the scene. It is a small sphere above what stands where cameras look.
/// Returns none if the scene has no lamp, no free light group, or nothing there.
pub(crate) fn with_lamp(scene: &Scene) -> Option<Scene> {
    if scene.groups.len() == MAX_GROUPS {
        return None;
    }
    let intensity = |light: &Light| match (light.shape, light.emission) {
        (Shape::Sphere { radius, .. }, Emission::Constant(radiance)) => luminance(radiance) * PI * radius * radius,
        _ => 0.0,
    };
    let brightest = scene.lights.iter().map(intensity).fold(0.0, f32::max);
    let from = Vec3::new(scene.focus.x, 0.6 * scene.interior.max.y, scene.focus.z);
    let below = scene.surfaces.closest(from, Vec3::NEG_Y, f32::INFINITY)?;
    if brightest <= 0.0 || below.distance < ABOVE {
        return None;
    }
    let center = from - Vec3::Y * (below.distance - ABOVE);
    let mut out = scene.clone();
    out.groups.push(Group { name: NAME.to_owned(), window: false });
    out.instances.push(Instance { name: NAME.to_owned(), class: class_id("lamp") });
    out.lights.push(Light {
        name: NAME.to_owned(),
        group: out.groups.len() - 1,
        shape: Shape::Sphere { center, radius: RADIUS },
        emission: Emission::Constant(COLOR * brightest / (PI * RADIUS * RADIUS)),
        instance: (out.instances.len() - 1) as u16,
    });
    Some(out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::options::SceneName;

    #[test]
    fn lamp_is_in_free_space() {
        assert!(with_lamp(&Scene::build(SceneName::EnvOnly, 1)).is_none(), "a room without lamps gets none");
        for seed in 0..20 {
            let scene = Scene::build(SceneName::LivingRoom, seed);
            let lit = with_lamp(&scene).expect("a lamp");
            assert_eq!((lit.lights.len(), lit.groups.len()), (scene.lights.len() + 1, scene.groups.len() + 1));
            let Some(Light { shape: Shape::Sphere { center, radius }, .. }) = lit.lights.last() else { panic!() };
            for i in 0..200 {
                let (height, around) = ((i as f32 + 0.5) / 100.0 - 1.0, 2.4 * i as f32);
                let flat = (1.0 - height * height).sqrt();
                let along = Vec3::new(flat * around.cos(), height, flat * around.sin());
                let free = !scene.surfaces.occluded(*center, along, 1.2 * radius);
                assert!(free, "seed {seed}: something touches the lamp at {center}");
            }
        }
    }
}
