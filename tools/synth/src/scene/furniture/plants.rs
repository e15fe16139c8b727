//! Potted plants and twigs. Leaves are bent strips, visible from both sides.

use std::f32::consts::TAU;

use glam::{Affine3A, Quat, Vec3};

use crate::color::hex;
use crate::rng::Rng;
use crate::scene::builder::{Builder, Vertex};
use crate::scene::material::Material;
use crate::scene::texture::Texture;

/// Adds a plant of the given height in a pot.
pub(crate) fn potted(b: &mut Builder, name: &str, frame: Affine3A, height: f32, pot: Vec3, rng: &mut Rng) {
    let s = 0.3 + 0.45 * height;
    b.object(&format!("pot_{name}"), "ornament", frame);
    b.material(Material::new(Texture::Solid(pot), 0.45));
    b.lathe(
        Vec3::ZERO,
        &[
            (0.0, 0.0),
            (0.13 * s, 0.0),
            (0.16 * s, 0.1 * s),
            (0.19 * s, 0.34 * s),
            (0.175 * s, 0.34 * s),
            (0.16 * s, 0.29 * s),
        ],
        28,
        false,
    );
    b.material(Material::new(Texture::Solid(hex(0x4a3626)), 1.0));
    b.lathe(Vec3::ZERO, &[(0.165 * s, 0.29 * s), (0.0, 0.30 * s)], 28, false);
    b.object(name, "plant", frame);
    let greens = [0x3f6b35, 0x55803f, 0x2f5a3a, 0x6b8f45];
    let green = hex(*rng.pick(&greens));
    b.material(Material::new(Texture::Leaf { color: green, rib: green * 1.5 + Vec3::splat(0.02) }, 0.45));
    let count = 26 + (20.0 * height) as usize;
    for i in 0..count {
        let turn = TAU * (i as f32 * 0.618_034 + 0.03 * rng.uniform());
        let high = (i as f32 + 0.5) / count as f32;
        let lean = 1.25 - 1.0 * high + rng.range(-0.12, 0.12);
        let length = height * rng.range(0.48, 0.72) * (0.75 + 0.35 * high);
        let root = Vec3::new(0.0, 0.30 * s + 0.18 * height * high, 0.0);
        b.frame(
            frame
                * Affine3A::from_rotation_translation(Quat::from_rotation_y(turn) * Quat::from_rotation_x(lean), root),
        );
        leaf(b, length, 0.085 * height.max(0.5), 0.35 * length);
    }
}

/// Adds a few thin branches with small leaves, rising from the origin.
pub(crate) fn twigs(b: &mut Builder, frame: Affine3A, height: f32, rng: &mut Rng) {
    b.object("twigs", "plant", frame);
    let green = hex(if rng.chance(0.5) { 0x7b8f55 } else { 0xb06a45 });
    b.material(Material::new(Texture::Leaf { color: green, rib: green * 1.4 }, 0.6));
    for i in 0..4 {
        let turn = TAU * (i as f32 / 4.0 + 0.2 * rng.uniform());
        let lean = rng.range(0.15, 0.45);
        let stem = frame * Affine3A::from_quat(Quat::from_rotation_y(turn) * Quat::from_rotation_x(lean));
        b.frame(stem);
        b.rod(Vec3::Y * -0.1, Vec3::Y * height, 0.003);
        for k in 0..9 {
            let at = Vec3::Y * height * (0.25 + 0.75 * k as f32 / 8.0);
            let around = Quat::from_rotation_y(2.4 * k as f32) * Quat::from_rotation_x(0.9);
            b.frame(stem * Affine3A::from_rotation_translation(around, at));
            leaf(b, 0.22 * height, 0.05 * height, 0.03 * height);
        }
    }
}

/// Adds a pointed leaf from the origin along +y that droops towards +z.
fn leaf(b: &mut Builder, length: f32, half_width: f32, droop: f32) {
    const STEPS: usize = 5;
    let cross = |i: usize| {
        let t = i as f32 / STEPS as f32;
        let width = half_width * (std::f32::consts::PI * (0.06 + 0.94 * t)).sin().max(0.0);
        let middle = Vec3::new(0.0, length * (t - 0.12 * t * t), droop * t * t);
        let along = Vec3::new(0.0, length * (1.0 - 0.24 * t), 2.0 * droop * t).normalize();
        let normal = Vec3::X.cross(along).normalize();
        // The blade is folded along its rib, so its edges lie a little higher.
        let fold = 0.25 * width * normal;
        let vertex = |side: f32| Vertex {
            position: middle + side * width * Vec3::X + side.abs() * fold,
            normal: (normal - 0.25 * side * Vec3::X).normalize(),
            uv: glam::Vec2::new(side, t * length),
        };
        [vertex(-1.0), vertex(0.0), vertex(1.0)]
    };
    for i in 0..STEPS {
        let (low, high) = (cross(i), cross(i + 1));
        for k in 0..2 {
            b.triangle([low[k], low[k + 1], high[k + 1]]);
            b.triangle([low[k], high[k + 1], high[k]]);
        }
    }
}
