//! Small box with two blocks and a ball under one ceiling light. Few triangles; quick to render.

use glam::{Affine3A, Quat, Vec3};

use crate::rng::Rng;
use crate::scene::builder::Builder;
use crate::scene::light::{Emission, Shape};
use crate::scene::material::Material;
use crate::scene::sky::Sky;
use crate::scene::texture::Texture;
use crate::scene::theme::Theme;
use crate::scene::{Bounds, Scene};

/// Builds the box. The seed chooses colors and the rotation of the blocks.
pub(crate) fn build(seed: u64) -> Scene {
    let mut rng = Rng::new(&[seed, 0x0b0c]);
    let theme = Theme::choose(&mut rng);
    let mut b = Builder::new();
    let (half, height) = (1.5, 2.2);
    let (x, z) = (Vec3::X * 2.0 * half, Vec3::Z * 2.0 * half);
    let low = Vec3::new(-half, 0.0, -half);
    b.object("floor", "floor", Affine3A::IDENTITY);
    b.material(Material::new(
        Texture::Tiles {
            first: theme.floor[0],
            second: theme.wall,
            grout: Vec3::splat(0.15),
            size: 0.5,
            seed: seed as u32,
        },
        0.4,
    ));
    b.quad(low + z, x, -z);
    b.object("ceiling", "ceiling", Affine3A::IDENTITY);
    b.material(Material::new(Texture::Solid(Vec3::splat(0.75)), 0.9));
    b.quad(low + Vec3::Y * height, x, z);
    let y = Vec3::Y * height;
    for (name, corner, along, color) in [
        ("wall_north", low, x, theme.wall),
        ("wall_west", low + z, -z, theme.accents[1]),
        ("wall_south", low + x + z, -x, theme.wall),
        ("wall_east", low + x, z, theme.accents[3]),
    ] {
        b.object(name, "wall", Affine3A::IDENTITY);
        b.material(Material::new(Texture::Wallpaper { ground: color, figure: color * 0.7, size: 0.45 }, 0.7));
        b.quad(corner, along, y);
    }
    let turn = |x: f32, z: f32, yaw: f32| {
        Affine3A::from_rotation_translation(Quat::from_rotation_y(yaw), Vec3::new(x, 0.0, z))
    };
    let yaw = rng.range(0.1, 0.5);
    b.object("tall_block", "cabinet", turn(-0.45, -0.55, yaw));
    b.material(Material::new(Texture::Wood { light: theme.wood[0], dark: theme.wood[1], seed: 3 }, 0.35));
    b.soft_box(Vec3::Y * 0.6, Vec3::new(0.3, 0.6, 0.3), 0.03);
    b.obstacle();
    b.object("low_block", "table", turn(0.5, -0.1, -yaw));
    b.material(Material::new(Texture::Weave { light: theme.sofa[0], dark: theme.sofa[1], size: 0.12, seed: 5 }, 0.8));
    b.soft_box(Vec3::Y * 0.25, Vec3::new(0.32, 0.25, 0.32), 0.03);
    b.object("ball", "ornament", turn(0.5, -0.1, 0.0));
    b.material(Material::metal(theme.metal, 0.25));
    b.ball(Vec3::Y * 0.7, 0.2);
    b.object("lamp", "lamp", Affine3A::IDENTITY);
    let group = b.group("lamp_ceiling", false);
    b.light(
        "panel",
        group,
        Shape::Rect { corner: Vec3::new(-0.4, height - 0.01, -0.4), u: Vec3::X * 0.8, v: Vec3::Z * 0.8 },
        Emission::Constant(Vec3::new(6.0, 5.6, 5.0)),
    );
    let interior = Bounds { min: low, max: low + x + y + z };
    b.finish(interior, Vec3::new(0.0, 0.6, -0.2), Sky::DARK)
}
