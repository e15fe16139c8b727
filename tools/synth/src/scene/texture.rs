//! Procedural albedo: a color for every texture coordinate.
//!
//! Coordinates are meters on the surface unless a pattern states otherwise. Details are a few centimeters wide, so that
//! they survive at the resolution of the rendered views. Finer detail would act as noise in training.

use std::f32::consts::TAU;

use glam::{IVec2, Vec2, Vec3};

use crate::noise::{cell, cell_bits, fractal, smoothstep, value};
use crate::scene::painting;

/// Pattern with its colors (linear) and sizes.
#[derive(Debug, Clone)]
pub(crate) enum Texture {
    /// Single color.
    Solid(Vec3),
    /// Single color with soft, slow stains, like paint on plaster.
    Plaster { color: Vec3, amount: f32, seed: u32 },
    /// Floor boards along the first coordinate.
    Planks { light: Vec3, dark: Vec3, width: f32, length: f32, seed: u32 },
    /// Square tiles in two colors with grout between them.
    Tiles { first: Vec3, second: Vec3, grout: Vec3, size: f32, seed: u32 },
    /// Grain along the first coordinate.
    Wood { light: Vec3, dark: Vec3, seed: u32 },
    /// Cloth: mottled, with a faint check.
    Weave { light: Vec3, dark: Vec3, size: f32, seed: u32 },
    /// Stripes across the first coordinate.
    Stripes { first: Vec3, second: Vec3, width: f32 },
    /// Wallpaper with a lattice of leaves.
    Wallpaper { ground: Vec3, figure: Vec3, size: f32 },
    /// Carpet with borders and a repeated pattern. The coordinates are centered.
    Rug { colors: [Vec3; 4], half: Vec2, seed: u32 },
    /// Wall picture. Coordinates cover the unit square.
    Painting { colors: [Vec3; 5], seed: u32 },
    /// Veined stone.
    Marble { ground: Vec3, vein: Vec3, size: f32, seed: u32 },
    /// Book spine: bands across the second coordinate, which is centered.
    Spine { cover: Vec3, band: Vec3, at: f32, width: f32 },
    /// Leaf with a lighter rib along its middle. First coordinate across (−1 to 1), second along.
    Leaf { color: Vec3, rib: Vec3 },
}

impl Texture {
    /// Returns the linear color at a coordinate.
    pub(crate) fn color(&self, uv: Vec2) -> Vec3 {
        match *self {
            Self::Solid(color) => color,
            Self::Plaster { color, amount, seed } => color * (1.0 + amount * (2.0 * fractal(uv * 2.2, 3, seed) - 1.0)),
            Self::Planks { light, dark, width, length, seed } => planks(uv, light, dark, width, length, seed),
            Self::Tiles { first, second, grout, size, seed } => {
                tiles(uv / size, first, second, grout, 0.012 / size, seed)
            }
            Self::Wood { light, dark, seed } => light.lerp(dark, grain(uv, seed)),
            Self::Weave { light, dark, size, seed } => {
                let mottle = fractal(uv / (0.6 * size), 3, seed);
                let q = uv / size;
                let check = 0.5 + 0.25 * ((q.x * TAU).sin() + (q.y * TAU).sin());
                light.lerp(dark, (0.55 * mottle + 0.45 * check).clamp(0.0, 1.0))
            }
            Self::Stripes { first, second, width } => {
                let phase = (uv.x / width).rem_euclid(2.0);
                let edge = smoothstep(0.94, 1.0, phase) * (1.0 - smoothstep(1.94, 2.0, phase));
                first.lerp(second, edge)
            }
            Self::Wallpaper { ground, figure, size } => ground.lerp(figure, leaves(uv / size)),
            Self::Rug { colors, half, seed } => rug(uv, &colors, half, seed),
            Self::Painting { ref colors, seed } => painting::color(uv, colors, seed),
            Self::Marble { ground, vein, size, seed } => {
                let q = uv / size;
                let warp = 3.0 * fractal(q * 1.3, 3, seed);
                let line = ((q.x + 0.6 * q.y + warp) * std::f32::consts::PI).sin().abs();
                let stain = 0.25 * fractal(q * 2.1, 2, seed ^ 77);
                ground.lerp(vein, ((1.0 - line).powi(3) + stain).clamp(0.0, 1.0))
            }
            Self::Spine { cover, band, at, width } => {
                let inside = (uv.y.abs() - at).abs() < width;
                if inside { band } else { cover }
            }
            Self::Leaf { color, rib } => {
                let middle = 1.0 - smoothstep(0.0, 0.35, uv.x.abs());
                let stripe = 0.3 * value(Vec2::new(uv.y * 9.0, uv.x * 3.0), 5);
                color.lerp(rib, (0.7 * middle + stripe).clamp(0.0, 1.0))
            }
        }
    }
}

/// Returns the darkness of wood grain, in [0, 1].
fn grain(uv: Vec2, seed: u32) -> f32 {
    let stretched = Vec2::new(uv.x * 1.6, uv.y * 14.0);
    let wave = fractal(stretched, 3, seed);
    let ring = 0.5 + 0.5 * ((uv.y * 38.0 + 7.0 * fractal(uv * 2.0, 2, seed ^ 31)).sin());
    (0.65 * wave + 0.35 * ring).clamp(0.0, 1.0)
}

fn planks(uv: Vec2, light: Vec3, dark: Vec3, width: f32, length: f32, seed: u32) -> Vec3 {
    let row = (uv.y / width).floor();
    // Each row gets its own offset, so that the ends of boards do not align.
    let along = uv.x / length + cell(IVec2::new(row as i32, 11), seed);
    let board = along.floor();
    let id = IVec2::new(board as i32, row as i32);
    let tone = cell(id, seed ^ 3);
    let offset = Vec2::new(cell(id, seed ^ 5), cell(id, seed ^ 7)) * 40.0;
    let shade = (0.62 * tone + 0.38 * grain(uv + offset, seed ^ 9)).clamp(0.0, 1.0);
    let across = (uv.y / width - row - 0.5).abs() * width;
    let end = (along - board - 0.5).abs() * length;
    let gap = smoothstep(width * 0.5 - 0.006, width * 0.5 - 0.001, across).max(smoothstep(
        length * 0.5 - 0.006,
        length * 0.5 - 0.001,
        end,
    ));
    light.lerp(dark, shade) * (1.0 - 0.6 * gap)
}

fn tiles(q: Vec2, first: Vec3, second: Vec3, grout: Vec3, gap: f32, seed: u32) -> Vec3 {
    let base = q.floor();
    let id = base.as_ivec2();
    let f = (q - base - Vec2::splat(0.5)).abs();
    let edge = smoothstep(0.5 - 1.6 * gap, 0.5 - 0.6 * gap, f.x.max(f.y));
    let checker = if (id.x + id.y).rem_euclid(2) == 0 { first } else { second };
    let cloud = fractal(q * 3.0 + Vec2::splat((cell_bits(id, seed) & 255) as f32), 3, seed);
    (checker * (0.88 + 0.24 * cloud)).lerp(grout, edge)
}

/// Returns the coverage of a lattice of four-leaved figures.
fn leaves(q: Vec2) -> f32 {
    let shift = if (q.y.floor() as i32).rem_euclid(2) == 0 { 0.0 } else { 0.5 };
    let f = Vec2::new((q.x + shift).rem_euclid(1.0), q.y.rem_euclid(1.0)) - Vec2::splat(0.5);
    let radius = f.length();
    let angle = f.y.atan2(f.x);
    let petal = 0.30 + 0.13 * (4.0 * angle).cos();
    let leaf = 1.0 - smoothstep(petal - 0.04, petal + 0.04, radius);
    let eye = 1.0 - smoothstep(0.07, 0.11, radius);
    leaf * (1.0 - 0.8 * eye)
}

fn rug(uv: Vec2, colors: &[Vec3; 4], half: Vec2, seed: u32) -> Vec3 {
    let inset = (half - uv.abs()).min_element();
    let pile = 0.9 + 0.2 * fractal(uv * 26.0, 2, seed);
    let color = if inset < 0.05 {
        colors[1]
    } else if inset < 0.20 {
        // A band of triangles surrounds the field.
        let along = if half.x - uv.x.abs() < half.y - uv.y.abs() { uv.y } else { uv.x };
        let tooth = ((along / 0.15).rem_euclid(1.0) - 0.5).abs() * 2.0;
        if (inset - 0.05) / 0.15 > tooth { colors[0] } else { colors[2] }
    } else if inset < 0.25 {
        colors[1]
    } else {
        field(uv, colors, seed)
    };
    color * pile
}

/// Returns the color of a rug's field: one of three repeats.
fn field(uv: Vec2, colors: &[Vec3; 4], seed: u32) -> Vec3 {
    match seed % 3 {
        0 => {
            let q = uv / 0.36;
            let f = (q - q.round()).abs();
            let diamond = f.x + f.y;
            if diamond < 0.16 {
                colors[3]
            } else if diamond < 0.3 {
                colors[1]
            } else if diamond < 0.44 {
                colors[2]
            } else {
                colors[0]
            }
        }
        1 => {
            let q = uv / 0.42;
            let radius = (q - q.round()).length();
            let ring = (radius * 6.0) as usize;
            colors[[3, 1, 0, 2][ring.min(3)]]
        }
        _ => {
            let zigzag = ((uv.x / 0.28).rem_euclid(1.0) - 0.5).abs() * 0.3;
            let band = ((uv.y + zigzag) / 0.12).floor() as i32;
            colors[[0, 1, 0, 2, 3, 2][band.rem_euclid(6) as usize]]
        }
    }
}
