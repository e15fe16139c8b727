//! Sofas, armchairs and chairs.

use glam::{Affine3A, Quat, Vec3};

use crate::rng::Rng;
use crate::scene::builder::Builder;
use crate::scene::material::Material;
use crate::scene::texture::Texture;

/// Size and materials of an upholstered seat.
pub(crate) struct Upholstery<'a> {
    /// Number of people.
    pub places: usize,
    /// Light and dark color of the cloth.
    pub cloth: [Vec3; 2],
    /// Material of the feet.
    pub wood: u16,
    /// Colors of the cushions.
    pub cushions: &'a [Vec3],
}

/// Adds an upholstered seat with cushions.
pub(crate) fn sofa(b: &mut Builder, name: &str, frame: Affine3A, upholstery: &Upholstery<'_>, rng: &mut Rng) {
    let &Upholstery { places, cloth, wood, cushions } = upholstery;
    let seat = if places > 1 { 0.66 } else { 0.62 };
    let width = seat * places as f32 + 0.36;
    let (depth, arm) = (0.88, 0.18);
    b.object(name, "sofa", frame);
    let seed = rng.next_u32();
    b.material(Material::new(
        Texture::Weave { light: cloth[0], dark: cloth[1], size: rng.range(0.07, 0.11), seed },
        0.85,
    ));
    let half = 0.5 * width;
    b.soft_box(Vec3::new(0.0, 0.22, 0.0), Vec3::new(half - 0.02, 0.10, 0.5 * depth - 0.02), 0.04);
    let recline = Quat::from_rotation_x(-0.12);
    b.frame(frame * Affine3A::from_rotation_translation(recline, Vec3::new(0.0, 0.52, -0.33)));
    b.soft_box(Vec3::ZERO, Vec3::new(half - 0.04, 0.32, 0.11), 0.08);
    b.frame(frame);
    for side in [-1.0, 1.0] {
        b.soft_box(Vec3::new(side * (half - 0.5 * arm), 0.37, 0.0), Vec3::new(0.5 * arm, 0.24, 0.5 * depth), 0.08);
    }
    let inner = width - 2.0 * arm;
    let each = inner / places as f32;
    for i in 0..places {
        let x = -0.5 * inner + (i as f32 + 0.5) * each;
        b.soft_box(Vec3::new(x, 0.39, 0.08), Vec3::new(0.5 * each - 0.006, 0.085, 0.36), 0.06);
    }
    b.paint(wood);
    for (x, z) in [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)] {
        let foot = Vec3::new(x * (half - 0.1), 0.0, z * (0.5 * depth - 0.1));
        b.rod(foot, foot + Vec3::Y * 0.14, 0.022);
    }
    b.obstacle();
    for (i, color) in cushions.iter().enumerate() {
        let last = cushions.len().max(2) - 1;
        let spread = 0.5 * inner - 0.22;
        let x = -spread + 2.0 * spread * i as f32 / last as f32 + rng.range(-0.05, 0.05);
        let turn = Quat::from_rotation_y(rng.range(-0.25, 0.25))
            * Quat::from_rotation_x(-0.42)
            * Quat::from_rotation_z(rng.range(-0.15, 0.15));
        let at = Vec3::new(x, 0.66, -0.10);
        b.object(&format!("cushion_{name}"), "cushion", frame * Affine3A::from_rotation_translation(turn, at));
        let seed = rng.next_u32();
        let other = color.lerp(Vec3::splat(0.75), 0.55);
        b.material(Material::new(
            if rng.chance(0.5) {
                Texture::Stripes { first: *color, second: other, width: rng.range(0.04, 0.07) }
            } else {
                Texture::Rug { colors: [*color, other, color * 0.6, other], half: glam::Vec2::splat(0.6), seed }
            },
            0.8,
        ));
        b.soft_box(Vec3::ZERO, Vec3::new(0.21, 0.20, 0.075), 0.07);
    }
}

/// Adds a dining chair with wooden or metal legs.
pub(crate) fn chair(b: &mut Builder, frame: Affine3A, wood: u16, legs: u16, pad: u16) {
    b.object("chair", "chair", frame);
    b.paint(wood);
    b.soft_box(Vec3::new(0.0, 0.44, 0.0), Vec3::new(0.21, 0.018, 0.20), 0.015);
    b.soft_box(Vec3::new(0.0, 0.80, -0.215), Vec3::new(0.20, 0.07, 0.014), 0.012);
    b.soft_box(Vec3::new(0.0, 0.62, -0.205), Vec3::new(0.20, 0.03, 0.012), 0.01);
    b.paint(pad);
    b.soft_box(Vec3::new(0.0, 0.475, 0.01), Vec3::new(0.19, 0.025, 0.18), 0.022);
    b.paint(legs);
    for x in [-0.18, 0.18] {
        b.rod(Vec3::new(1.1 * x, 0.0, 0.19), Vec3::new(x, 0.43, 0.17), 0.016);
        b.rod(Vec3::new(1.1 * x, 0.0, -0.22), Vec3::new(x, 0.45, -0.18), 0.016);
        b.rod(Vec3::new(x, 0.43, -0.18), Vec3::new(x, 0.86, -0.225), 0.014);
    }
    b.obstacle();
}
