//! Objects on walls: framed pictures and mirrors.

use glam::{Affine3A, Vec2, Vec3};

use crate::rng::Rng;
use crate::scene::builder::Builder;
use crate::scene::material::Material;
use crate::scene::texture::Texture;
use crate::scene::theme::Theme;

/// Adds four bars around a rectangle.
fn bars(b: &mut Builder, half: Vec2, width: f32, depth: f32) {
    let (w, h) = (half.x, half.y);
    b.block(Vec3::new(-w, -h, 0.0), Vec3::new(w, -h + width, depth));
    b.block(Vec3::new(-w, h - width, 0.0), Vec3::new(w, h, depth));
    b.block(Vec3::new(-w, -h + width, 0.0), Vec3::new(-w + width, h - width, depth));
    b.block(Vec3::new(w - width, -h + width, 0.0), Vec3::new(w, h - width, depth));
}

/// Adds a framed picture.
///
/// The frame lies in the wall with its origin at the center of the picture.
pub(crate) fn picture(b: &mut Builder, frame: Affine3A, half: Vec2, theme: &Theme, border: u16, rng: &mut Rng) {
    b.object("picture", "picture", frame);
    b.paint(border);
    bars(b, half, 0.028, 0.03);
    let mat = half - Vec2::splat(0.028);
    b.material(Material::new(Texture::Solid(Vec3::splat(0.76)), 0.6));
    let flat = |b: &mut Builder, half: Vec2, z: f32| {
        b.quad_uv(
            Vec3::new(-half.x, -half.y, z),
            Vec3::X * 2.0 * half.x,
            Vec3::Y * 2.0 * half.y,
            Vec2::ZERO,
            Vec2::ONE,
        );
    };
    flat(b, mat, 0.012);
    let seed = rng.next_u32();
    b.material(Material::new(Texture::Painting { colors: theme.inks, seed }, 0.5));
    let passe = if rng.chance(0.6) { 0.055 } else { 0.0 };
    flat(b, mat - Vec2::splat(passe), 0.014);
}

/// Adds a framed mirror.
pub(crate) fn mirror(b: &mut Builder, frame: Affine3A, half: Vec2, border: u16) {
    b.object("mirror", "mirror", frame);
    b.paint(border);
    bars(b, half, 0.04, 0.035);
    b.material(Material::metal(Vec3::splat(0.88), 0.06));
    let h = half - Vec2::splat(0.04);
    b.quad(Vec3::new(-h.x, -h.y, 0.015), Vec3::X * 2.0 * h.x, Vec3::Y * 2.0 * h.y);
}
