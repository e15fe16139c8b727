//! Small objects: bowls, cups, vases, stacks of books, balls.

use std::f32::consts::TAU;

use glam::{Affine3A, Quat, Vec3};

use crate::color::hex;
use crate::rng::Rng;
use crate::scene::builder::Builder;
use crate::scene::furniture::plants;
use crate::scene::material::Material;
use crate::scene::texture::Texture;
use crate::scene::theme::Theme;

/// Adds a bowl with round fruit.
pub(crate) fn fruit_bowl(b: &mut Builder, frame: Affine3A, theme: &Theme, rng: &mut Rng) {
    b.object("bowl", "tableware", frame);
    b.material(Material::new(Texture::Solid(theme.accents[2]), 0.2));
    b.lathe(
        Vec3::ZERO,
        &[
            (0.0, 0.004),
            (0.055, 0.0),
            (0.06, 0.012),
            (0.115, 0.05),
            (0.145, 0.095),
            (0.138, 0.095),
            (0.105, 0.055),
            (0.05, 0.022),
            (0.0, 0.02),
        ],
        28,
        true,
    );
    b.object("fruit", "fruit", frame);
    let skins = [0xc8402f, 0xe08a2e, 0xb5b23a, 0xd8b13a];
    for i in 0..5 {
        let angle = TAU * i as f32 / 4.0 + rng.range(-0.2, 0.2);
        let ring = if i == 4 { 0.0 } else { 0.06 };
        let color = hex(*rng.pick(&skins));
        let seed = rng.next_u32();
        b.material(Material::new(Texture::Plaster { color, amount: 0.3, seed }, 0.35));
        let radius = rng.range(0.036, 0.043);
        let height = if i == 4 { 0.115 } else { 0.075 };
        b.ball(Vec3::new(ring * angle.cos(), height, ring * angle.sin()), radius);
    }
}

/// Adds a cup without a handle.
pub(crate) fn cup(b: &mut Builder, frame: Affine3A, color: Vec3) {
    b.object("cup", "tableware", frame);
    b.material(Material::new(Texture::Solid(color), 0.18));
    b.lathe(
        Vec3::ZERO,
        &[(0.0, 0.0), (0.026, 0.0), (0.038, 0.03), (0.04, 0.085), (0.036, 0.085), (0.034, 0.03), (0.0, 0.012)],
        20,
        true,
    );
}

/// Adds a glazed vase; `filled` adds branches.
pub(crate) fn vase(b: &mut Builder, name: &str, frame: Affine3A, color: Vec3, scale: f32, filled: bool, rng: &mut Rng) {
    b.object(name, "ornament", frame);
    let width = rng.range(0.8, 1.25);
    b.material(Material::new(
        if rng.chance(0.5) {
            Texture::Solid(color)
        } else {
            let seed = rng.next_u32();
            Texture::Marble { ground: color, vein: color.lerp(Vec3::splat(0.8), 0.6), size: 0.1, seed }
        },
        rng.range(0.12, 0.4),
    ));
    let shape = [
        (0.0, 0.0),
        (0.045, 0.0),
        (0.075, 0.05),
        (0.085, 0.10),
        (0.07, 0.16),
        (0.035, 0.21),
        (0.03, 0.24),
        (0.042, 0.265),
        (0.036, 0.262),
        (0.0, 0.2),
    ];
    b.lathe(Vec3::ZERO, &shape.map(|(r, y)| (r * scale * width, y * scale)), 28, true);
    if filled {
        let mouth = frame * Affine3A::from_translation(Vec3::Y * 0.25 * scale);
        plants::twigs(b, mouth, 0.32 * scale, rng);
    }
}

/// Adds a stack of lying books.
pub(crate) fn book_stack(b: &mut Builder, frame: Affine3A, theme: &Theme, count: usize, rng: &mut Rng) {
    b.object("books_lying", "book", frame);
    let mut y = 0.0;
    let paper = b.material(Material::new(Texture::Solid(Vec3::splat(0.7)), 0.9));
    for _ in 0..count {
        let thick = rng.range(0.018, 0.035);
        let half = Vec3::new(rng.range(0.10, 0.135), 0.5 * thick, rng.range(0.075, 0.095));
        let turn = Quat::from_rotation_y(rng.range(-0.35, 0.35));
        b.frame(frame * Affine3A::from_rotation_translation(turn, Vec3::Y * (y + half.y)));
        let cover = *rng.pick(&theme.inks);
        b.material(Material::new(
            Texture::Spine { cover, band: *rng.pick(&theme.accents), at: 0.04, width: 0.012 },
            0.4,
        ));
        b.cuboid(Vec3::Y * (half.y - 0.002), Vec3::new(half.x, 0.002, half.z));
        b.cuboid(Vec3::Y * (0.002 - half.y), Vec3::new(half.x, 0.002, half.z));
        b.paint(paper);
        b.cuboid(Vec3::ZERO, Vec3::new(half.x - 0.006, half.y - 0.003, half.z - 0.006));
        y += thick;
    }
}
