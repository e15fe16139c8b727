//! Rugs and curtains.

use glam::{Affine3A, Vec2, Vec3};

use crate::rng::Rng;
use crate::scene::builder::Builder;
use crate::scene::material::Material;
use crate::scene::texture::Texture;
use crate::scene::theme::Theme;

/// Adds a rug around the origin.
pub(crate) fn rug(b: &mut Builder, frame: Affine3A, half: Vec2, theme: &Theme, rng: &mut Rng) {
    b.object("rug", "carpet", frame);
    let seed = rng.next_u32();
    b.material(Material::new(Texture::Rug { colors: theme.rug, half, seed }, 0.95));
    let thick = 0.014;
    b.quad_uv(Vec3::new(-half.x, thick, half.y), Vec3::X * 2.0 * half.x, Vec3::NEG_Z * 2.0 * half.y, -half, half);
    // Edge of the rug: four narrow strips.
    let corner = Vec3::new(half.x, 0.0, half.y);
    let (x, y, z) = (Vec3::X * 2.0 * half.x, Vec3::Y * thick, Vec3::Z * 2.0 * half.y);
    b.quad_uv(corner - x, x, y, Vec2::new(-half.x, half.y), half);
    b.quad_uv(corner - z, -x, y, half, Vec2::new(-half.x, half.y));
    b.quad_uv(corner, -z, y, half, Vec2::new(half.x, -half.y));
    b.quad_uv(corner - x - z, z, y, -half, Vec2::new(-half.x, half.y));
}

/// Adds a rod with a pair of curtains beside an opening.
///
/// The frame lies in the wall with its origin at the center of the opening.
pub(crate) fn curtains(
    b: &mut Builder,
    frame: Affine3A,
    opening: Vec2,
    rise: f32,
    cloth: [Vec3; 2],
    metal: u16,
    rng: &mut Rng,
) {
    let top = 0.5 * opening.y + 0.16;
    let half = 0.5 * opening.x;
    b.object("curtain_rod", "curtain", frame);
    b.paint(metal);
    b.rod(Vec3::new(-half - 0.42, top, 0.09), Vec3::new(half + 0.42, top, 0.09), 0.013);
    for x in [-half - 0.42, half + 0.42] {
        b.ball(Vec3::new(x, top, 0.09), 0.026);
    }
    b.object("curtain", "curtain", frame);
    let seed = rng.next_u32();
    b.material(Material::new(Texture::Weave { light: cloth[0], dark: cloth[1], size: 0.12, seed }, 0.9));
    let hem = -rise + 0.03;
    for side in [-1.0f32, 1.0] {
        let (inner, width) = (half - 0.02, 0.36);
        let phase = rng.range(0.0, 6.0);
        b.sheet(48, 3, Vec2::new(0.8, top - hem), |a, t| {
            let fold = 0.035 * (a * 31.0 + phase).sin() + 0.01 * (a * 73.0).sin();
            Vec3::new(
                side * (inner + width * a * (1.0 - 0.1 * t)),
                hem + (top - 0.01 - hem) * t,
                0.09 + fold * (1.0 - 0.3 * t),
            )
        });
    }
}
