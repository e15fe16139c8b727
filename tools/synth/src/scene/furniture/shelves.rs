//! Bookcase filled with books and small objects.

use glam::{Affine3A, Quat, Vec3};

use crate::rng::Rng;
use crate::scene::builder::Builder;
use crate::scene::furniture::decor;
use crate::scene::material::Material;
use crate::scene::texture::Texture;
use crate::scene::theme::Theme;

/// Adds a bookcase against a wall. Its back lies at z = 0.
pub(crate) fn bookcase(
    b: &mut Builder,
    frame: Affine3A,
    [width, height]: [f32; 2],
    theme: &Theme,
    [wood, metal]: [u16; 2],
    rng: &mut Rng,
) {
    let depth = 0.30;
    let board = 0.022;
    let half = 0.5 * width;
    b.object("bookcase", "bookcase", frame);
    b.paint(wood);
    for x in [-half, half - board] {
        b.block(Vec3::new(x, 0.0, 0.0), Vec3::new(x + board, height, depth));
    }
    b.block(Vec3::new(-half + board, 0.0, 0.0), Vec3::new(half - board, height, 0.012));
    let shelves = (height / 0.36).round() as usize;
    let step = (height - board) / shelves as f32;
    for i in 0..=shelves {
        let y = i as f32 * step;
        b.block(Vec3::new(-half + board, y, 0.012), Vec3::new(half - board, y + board, depth));
    }
    b.obstacle();
    for i in 0..shelves {
        let floor = i as f32 * step + board;
        let (from, to) = (-half + board + 0.01, half - board - 0.01);
        let split = from + (to - from) * rng.range(0.45, 0.75);
        let room = step - board - 0.02;
        let on = |x: f32| frame * Affine3A::from_translation(Vec3::new(x, floor, 0.16));
        if rng.chance(0.5) {
            books(b, frame, &Row { from, to: split, floor, room }, theme, rng);
            thing(b, on(0.5 * (split + to)), room, theme, metal, rng);
        } else {
            let split = from + to - split;
            thing(b, on(0.5 * (from + split)), room, theme, metal, rng);
            books(b, frame, &Row { from: split, to, floor, room }, theme, rng);
        }
    }
}

/// Free part of a shelf, in meters.
struct Row {
    from: f32,
    to: f32,
    floor: f32,
    /// Height above the floor.
    room: f32,
}

/// Adds upright books to a shelf.
fn books(b: &mut Builder, frame: Affine3A, row: &Row, theme: &Theme, rng: &mut Rng) {
    let &Row { from, to, floor, room } = row;
    b.object("books", "book", frame);
    let mut x = from;
    loop {
        let thick = rng.range(0.022, 0.055);
        if x + thick > to {
            break;
        }
        let tall = room * rng.range(0.68, 0.98);
        let deep = rng.range(0.17, 0.23);
        let cover = if rng.chance(0.7) { *rng.pick(&theme.inks) } else { *rng.pick(&theme.accents) };
        let shade = rng.range(0.7, 1.1);
        b.material(Material::new(
            Texture::Spine {
                cover: cover * shade,
                band: if rng.chance(0.5) { theme.accents[2] } else { theme.metal * 0.8 },
                at: rng.range(0.2, 0.36) * tall,
                width: rng.range(0.006, 0.02),
            },
            rng.range(0.3, 0.7),
        ));
        // One book in ten leans against its neighbor.
        let lean = if rng.chance(0.1) { 0.12 } else { 0.0 };
        b.frame(
            frame
                * Affine3A::from_rotation_translation(
                    Quat::from_rotation_z(lean),
                    Vec3::new(x + 0.5 * thick + lean * 0.5 * tall, floor + 0.5 * tall, 0.03),
                ),
        );
        b.block(Vec3::new(-0.5 * thick + 0.001, -0.5 * tall, 0.0), Vec3::new(0.5 * thick - 0.001, 0.5 * tall, deep));
        x += thick + lean * tall;
    }
}

/// Adds a vase, a stack of books, a ball or a box to a shelf.
fn thing(b: &mut Builder, frame: Affine3A, room: f32, theme: &Theme, metal: u16, rng: &mut Rng) {
    let color = *rng.pick(&theme.accents);
    match rng.index(4) {
        0 => decor::vase(b, "vase", frame, color, (room / 0.27).min(1.0), false, rng),
        1 => decor::book_stack(b, frame, theme, 4, rng),
        2 => {
            b.object("ball", "ornament", frame);
            b.paint(metal);
            let radius = rng.range(0.055, 0.085);
            b.ball(Vec3::Y * radius, radius);
        }
        _ => {
            b.object("ornament_box", "ornament", frame);
            b.material(Material::new(Texture::Solid(color), 0.3));
            let side = rng.range(0.06, 0.09);
            b.soft_box(Vec3::Y * side, Vec3::splat(side), 0.015);
        }
    }
}
