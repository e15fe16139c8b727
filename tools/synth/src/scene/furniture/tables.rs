//! Coffee table, dining table and sideboard, and the objects on the tables.

use glam::{Affine3A, Vec3};

use crate::rng::Rng;
use crate::scene::builder::Builder;
use crate::scene::furniture::decor;
use crate::scene::material::Material;
use crate::scene::texture::Texture;
use crate::scene::theme::Theme;

/// Adds a low table with a bowl of fruit, books, a metal ball and a cup.
pub(crate) fn coffee_table(b: &mut Builder, frame: Affine3A, theme: &Theme, wood: u16, metal: u16, rng: &mut Rng) {
    let half = Vec3::new(rng.range(0.46, 0.58), 0.022, rng.range(0.27, 0.33));
    let top = 0.40;
    b.object("coffee_table", "table", frame);
    if rng.chance(0.45) {
        let seed = rng.next_u32();
        b.material(Material::new(
            Texture::Marble { ground: Vec3::splat(0.72), vein: Vec3::new(0.22, 0.23, 0.25), size: 0.35, seed },
            0.15,
        ));
    } else {
        b.paint(wood);
    }
    b.soft_box(Vec3::new(0.0, top - half.y, 0.0), half, 0.012);
    let metal_legs = rng.chance(0.5);
    b.paint(if metal_legs { metal } else { wood });
    for (x, z) in [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)] {
        let head = Vec3::new(x * (half.x - 0.07), top - 2.0 * half.y, z * (half.z - 0.06));
        let foot = Vec3::new(x * (half.x - 0.03), 0.0, z * (half.z - 0.03));
        b.rod(foot, head, if metal_legs { 0.012 } else { 0.02 });
    }
    if !metal_legs {
        b.paint(wood);
        b.cuboid(Vec3::new(0.0, 0.14, 0.0), Vec3::new(half.x - 0.07, 0.01, half.z - 0.06));
    }
    b.obstacle();
    let on = |x: f32, z: f32| frame * Affine3A::from_translation(Vec3::new(x, top, z));
    let side = if rng.chance(0.5) { 1.0 } else { -1.0 };
    decor::fruit_bowl(b, on(-0.2 * side, 0.02), theme, rng);
    decor::book_stack(b, on(0.27 * side, -0.06), theme, 3, rng);
    b.object("metal_ball", "ornament", on(0.12 * side, 0.17));
    b.paint(metal);
    b.ball(Vec3::Y * 0.055, 0.055);
    decor::cup(b, on(0.33 * side, 0.16), theme.accents[1]);
}

/// Adds a round table with a vase and two cups.
pub(crate) fn dining_table(b: &mut Builder, frame: Affine3A, theme: &Theme, wood: u16, metal: u16, rng: &mut Rng) {
    let radius = rng.range(0.46, 0.54);
    b.object("dining_table", "table", frame);
    b.paint(wood);
    b.lathe(
        Vec3::Y * 0.70,
        &[(0.0, 0.0), (radius - 0.02, 0.0), (radius, 0.012), (radius, 0.03), (0.0, 0.03)],
        40,
        false,
    );
    if rng.chance(0.5) {
        b.paint(metal);
    }
    b.lathe(
        Vec3::ZERO,
        &[(0.27, 0.0), (0.26, 0.02), (0.06, 0.06), (0.045, 0.35), (0.06, 0.66), (0.16, 0.70)],
        24,
        true,
    );
    b.obstacle();
    let top = |x: f32, z: f32| frame * Affine3A::from_translation(Vec3::new(x, 0.73, z));
    decor::vase(b, "vase_table", top(0.02, -0.04), theme.accents[0], 1.0, true, rng);
    decor::cup(b, top(0.2, 0.16), theme.accents[3]);
    decor::cup(b, top(-0.22, 0.12), theme.accents[2]);
}

/// Adds a long cabinet with doors. Returns the height of its top.
pub(crate) fn sideboard(
    b: &mut Builder,
    frame: Affine3A,
    width: f32,
    theme: &Theme,
    wood: u16,
    metal: u16,
    rng: &mut Rng,
) -> f32 {
    let (height, depth) = (0.68, 0.42);
    b.object("sideboard", "cabinet", frame);
    b.paint(wood);
    let half = 0.5 * width;
    b.soft_box(Vec3::new(0.0, 0.5 * (height + 0.14), 0.0), Vec3::new(half, 0.5 * (height - 0.14), 0.5 * depth), 0.012);
    for (x, z) in [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)] {
        let foot = Vec3::new(x * (half - 0.08), 0.0, z * (0.5 * depth - 0.06));
        b.rod(foot, foot + Vec3::Y * 0.15, 0.02);
    }
    let doors = if rng.chance(0.5) { 3 } else { 4 };
    let each = (width - 0.06) / doors as f32;
    let painted = b.material(Material::new(Texture::Solid(theme.accents[2] * 0.9), 0.32));
    for i in 0..doors {
        let x = -half + 0.03 + (i as f32 + 0.5) * each;
        b.paint(if i % 2 == 0 { wood } else { painted });
        b.soft_box(
            Vec3::new(x, 0.5 * (height + 0.14), 0.5 * depth + 0.006),
            Vec3::new(0.5 * each - 0.01, 0.5 * (height - 0.14) - 0.025, 0.01),
            0.006,
        );
        b.paint(metal);
        let side = if i % 2 == 0 { 1.0 } else { -1.0 };
        b.ball(Vec3::new(x + side * (0.5 * each - 0.05), 0.45, 0.5 * depth + 0.03), 0.016);
    }
    b.obstacle();
    height
}
