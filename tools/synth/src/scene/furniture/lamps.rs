//! Lamps with luminous globes: floor lamp, pendant, table lamp.
//!
//! A lit globe is an exact sphere light, which the light sampler can choose. An unlit globe is a glossy white ball.

use glam::{Affine3A, Vec3};

use crate::scene::builder::Builder;
use crate::scene::light::{Emission, Shape};
use crate::scene::material::Material;
use crate::scene::texture::Texture;

/// Adds a globe with an intensity (radiance × projected area).
fn globe(b: &mut Builder, name: &str, group: &str, center: Vec3, radius: f32, intensity: Vec3) {
    if intensity.max_element() > 0.0 {
        let group = b.group(group, false);
        let radiance = intensity / (std::f32::consts::PI * radius * radius);
        b.light(name, group, Shape::Sphere { center, radius }, Emission::Constant(radiance));
    } else {
        b.material(Material::new(Texture::Solid(Vec3::splat(0.8)), 0.2));
        b.ball(center, radius);
    }
}

/// Adds a globe on a tall stem.
pub(crate) fn floor_lamp(b: &mut Builder, frame: Affine3A, metal: u16, intensity: Vec3) {
    b.object("floor_lamp", "lamp", frame);
    b.paint(metal);
    b.lathe(
        Vec3::ZERO,
        &[
            (0.0, 0.0),
            (0.15, 0.0),
            (0.15, 0.015),
            (0.03, 0.035),
            (0.012, 0.06),
            (0.012, 1.38),
            (0.05, 1.40),
            (0.055, 1.43),
            (0.0, 1.43),
        ],
        24,
        false,
    );
    b.obstacle();
    globe(b, "globe_floor", "lamp_floor", Vec3::Y * 1.555, 0.135, intensity);
}

/// Adds a globe on a cord. The frame's origin lies at the ceiling.
pub(crate) fn pendant(b: &mut Builder, frame: Affine3A, drop: f32, metal: u16, intensity: Vec3) {
    b.object("pendant", "lamp", frame);
    b.paint(metal);
    b.lathe(Vec3::Y * -0.03, &[(0.0, 0.0), (0.055, 0.0), (0.06, 0.03)], 20, false);
    b.rod(Vec3::ZERO, Vec3::Y * (0.04 - drop), 0.006);
    b.lathe(Vec3::Y * -drop, &[(0.065, -0.02), (0.055, 0.02), (0.02, 0.05), (0.0, 0.05)], 20, true);
    globe(b, "globe_ceiling", "lamp_ceiling", Vec3::Y * (-drop - 0.135), 0.14, intensity);
}

/// Adds a small globe on a ceramic foot.
pub(crate) fn table_lamp(b: &mut Builder, frame: Affine3A, glaze: Vec3, metal: u16, intensity: Vec3) {
    b.object("table_lamp", "lamp", frame);
    b.material(Material::new(Texture::Solid(glaze), 0.2));
    b.lathe(
        Vec3::ZERO,
        &[(0.0, 0.0), (0.07, 0.0), (0.085, 0.02), (0.09, 0.07), (0.07, 0.13), (0.03, 0.17), (0.022, 0.19)],
        28,
        true,
    );
    b.paint(metal);
    b.lathe(Vec3::Y * 0.19, &[(0.022, 0.0), (0.05, 0.012), (0.05, 0.02), (0.0, 0.02)], 20, false);
    globe(b, "globe_table", "lamp_table", Vec3::Y * 0.315, 0.11, intensity);
}
