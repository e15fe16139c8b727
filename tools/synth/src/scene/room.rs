//! Empty room: floor, ceiling, walls with window openings, skirting, frames and panes.

use std::f32::consts::{FRAC_PI_2, PI};

use glam::{Affine3A, Quat, Vec2, Vec3};

use crate::rng::Rng;
use crate::scene::builder::Builder;
use crate::scene::light::{Emission, Shape};
use crate::scene::material::Material;
use crate::scene::style::{Style, Windows};
use crate::scene::texture::Texture;
use crate::scene::theme::Theme;

/// Half width (x), half depth (z) and height of the room. The origin is the floor's center.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Size {
    /// Half extent in x.
    pub(crate) hx: f32,
    /// Half extent in z.
    pub(crate) hz: f32,
    /// Height.
    pub(crate) height: f32,
}

/// Wall of the room.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Side {
    /// At z = −hz.
    North,
    /// At x = hx.
    East,
    /// At z = hz.
    South,
    /// At x = −hx.
    West,
}

/// Rectangle cut out of a wall, in the wall's frame.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Hole {
    /// Center along the wall.
    pub(crate) x: f32,
    /// Lower edge.
    pub(crate) sill: f32,
    /// Width.
    pub(crate) width: f32,
    /// Height.
    pub(crate) height: f32,
}

impl Size {
    /// Returns the frame of a wall.
    ///
    /// x points right as seen from inside, y up, z into the room. The origin lies at the foot of the wall.
    pub(crate) fn wall(&self, side: Side) -> Affine3A {
        let (yaw, at) = match side {
            Side::North => (0.0, Vec3::new(0.0, 0.0, -self.hz)),
            Side::West => (FRAC_PI_2, Vec3::new(-self.hx, 0.0, 0.0)),
            Side::South => (PI, Vec3::new(0.0, 0.0, self.hz)),
            Side::East => (-FRAC_PI_2, Vec3::new(self.hx, 0.0, 0.0)),
        };
        Affine3A::from_rotation_translation(Quat::from_rotation_y(yaw), at)
    }

    /// Returns half the length of a wall.
    pub(crate) fn half_length(&self, side: Side) -> f32 {
        match side {
            Side::North | Side::South => self.hx,
            Side::East | Side::West => self.hz,
        }
    }
}

/// Depth of the window reveals.
const REVEAL: f32 = 0.16;

/// Adds floor, ceiling and walls. The wall `papered` gets the pattern.
pub(crate) fn shell(
    b: &mut Builder,
    size: Size,
    theme: &Theme,
    style: &Style,
    papered: Side,
    holes: &[Hole],
    rng: &mut Rng,
) {
    floor(b, size, theme, style, rng);
    b.object("ceiling", "ceiling", Affine3A::IDENTITY);
    b.material(Material::new(Texture::Plaster { color: Vec3::splat(0.78), amount: 0.03, seed: 4 }, 0.9));
    b.quad(Vec3::new(-size.hx, size.height, -size.hz), Vec3::X * 2.0 * size.hx, Vec3::Z * 2.0 * size.hz);
    let seed = rng.next_u32();
    let plain = b.material(Material::new(Texture::Plaster { color: theme.wall, amount: 0.07, seed }, 0.75).varied(0.1));
    let figure = rng.range(0.26, 0.4);
    let paper = b.material(Material::new(
        if rng.chance(0.6) {
            Texture::Wallpaper { ground: theme.paper[0], figure: theme.paper[1], size: figure }
        } else {
            Texture::Stripes { first: theme.paper[0], second: theme.paper[1], width: 0.6 * figure }
        },
        0.6,
    ));
    let trim = b.material(Material::new(Texture::Solid(Vec3::splat(0.74)), 0.35));
    for (side, name) in
        [(Side::North, "wall_north"), (Side::East, "wall_east"), (Side::South, "wall_south"), (Side::West, "wall_west")]
    {
        b.object(name, "wall", size.wall(side));
        b.paint(if side == papered { paper } else { plain });
        let cut: &[Hole] = if side == Side::North { holes } else { &[] };
        wall(b, size.half_length(side), size.height, cut);
    }
    b.object("skirting", "trim", Affine3A::IDENTITY);
    b.paint(trim);
    for side in [Side::North, Side::East, Side::South, Side::West] {
        b.frame(size.wall(side));
        let half = size.half_length(side);
        b.block(Vec3::new(-half, 0.0, 0.0), Vec3::new(half, 0.09, 0.018));
        b.block(Vec3::new(-half, size.height - 0.06, 0.0), Vec3::new(half, size.height, 0.05));
    }
    for (i, hole) in holes.iter().enumerate() {
        window(b, size, style, hole, i, trim);
    }
}

fn floor(b: &mut Builder, size: Size, theme: &Theme, style: &Style, rng: &mut Rng) {
    b.object("floor", "floor", Affine3A::IDENTITY);
    let seed = rng.next_u32();
    let (width, length) = (rng.range(0.13, 0.19), rng.range(1.1, 1.6));
    let boards = Texture::Planks { light: theme.floor[0], dark: theme.floor[1], width, length, seed };
    let stone = Texture::Tiles {
        first: theme.floor[0].lerp(Vec3::splat(0.6), 0.55),
        second: theme.wall * 0.9,
        grout: Vec3::splat(0.18),
        size: rng.range(0.4, 0.55),
        seed,
    };
    let tiled = rng.chance(0.25);
    b.material(if style.polished {
        Material::new(stone, 0.12)
    } else if tiled {
        Material::new(stone, 0.3).varied(0.06)
    } else {
        Material::new(boards, 0.42).varied(0.12)
    });
    let corner = Vec3::new(-size.hx, 0.0, size.hz);
    let (u, v) = (Vec3::X * 2.0 * size.hx, Vec3::NEG_Z * 2.0 * size.hz);
    b.quad(corner, u, v);
}

/// Adds a wall in its frame, with holes left open.
fn wall(b: &mut Builder, half: f32, height: f32, holes: &[Hole]) {
    let mut piece = |x0: f32, x1: f32, y0: f32, y1: f32| {
        if x1 - x0 > 1e-4 && y1 - y0 > 1e-4 {
            b.quad_uv(
                Vec3::new(x0, y0, 0.0),
                Vec3::X * (x1 - x0),
                Vec3::Y * (y1 - y0),
                Vec2::new(x0, y0),
                Vec2::new(x1, y1),
            );
        }
    };
    let mut from = -half;
    for hole in holes {
        let (x0, x1) = (hole.x - 0.5 * hole.width, hole.x + 0.5 * hole.width);
        piece(from, x0, 0.0, height);
        piece(x0, x1, 0.0, hole.sill);
        piece(x0, x1, hole.sill + hole.height, height);
        from = x1;
    }
    piece(from, half, 0.0, height);
}

/// Adds reveal, frame, bars and pane of one window.
fn window(b: &mut Builder, size: Size, style: &Style, hole: &Hole, index: usize, trim: u16) {
    let frame =
        size.wall(Side::North) * Affine3A::from_translation(Vec3::new(hole.x, hole.sill + 0.5 * hole.height, 0.0));
    b.object(&format!("window_{}", index + 1), "window", frame);
    b.paint(trim);
    let (w, h) = (0.5 * hole.width, 0.5 * hole.height);
    let (back, depth) = (Vec3::NEG_Z * REVEAL, Vec3::Z * REVEAL);
    let p = |x: f32, y: f32| Vec3::new(x, y, 0.0) + back;
    b.quad(p(-w, -h), depth, Vec3::X * 2.0 * w);
    b.quad(p(-w, h), Vec3::X * 2.0 * w, depth);
    b.quad(p(-w, -h), Vec3::Y * 2.0 * h, depth);
    b.quad(p(w, -h), depth, Vec3::Y * 2.0 * h);
    let bar = |b: &mut Builder, x0: f32, x1: f32, y0: f32, y1: f32| {
        b.block(Vec3::new(x0, y0, -REVEAL + 0.01), Vec3::new(x1, y1, -REVEAL + 0.05));
    };
    let t = 0.045;
    bar(b, -w, w, -h, -h + t);
    bar(b, -w, w, h - t, h);
    bar(b, -w, -w + t, -h, h);
    bar(b, w - t, w, -h, h);
    bar(b, -0.02, 0.02, -h, h);
    bar(b, -w, w, 0.25 * h - 0.015, 0.25 * h + 0.015);
    b.block(Vec3::new(-w - 0.05, -h - 0.03, -0.02), Vec3::new(w + 0.05, -h, 0.06));
    // Casing around the opening on the room's side.
    for x in [-w - 0.07, w] {
        b.block(Vec3::new(x, -h, 0.0), Vec3::new(x + 0.07, h, 0.02));
    }
    b.block(Vec3::new(-w - 0.07, h, 0.0), Vec3::new(w + 0.07, h + 0.08, 0.025));
    let group = b.group("windows", true);
    let emission = match style.windows {
        Windows::Open => Emission::Sky,
        Windows::Panes | Windows::None => Emission::Constant(style.daylight),
    };
    b.light(
        &format!("window_{}", index + 1),
        group,
        Shape::Rect { corner: p(-w, -h), u: Vec3::X * 2.0 * w, v: Vec3::Y * 2.0 * h },
        emission,
    );
}
