//! Procedural wall pictures: a landscape, circles, or a grid of blocks, by seed.

use glam::{IVec2, Vec2, Vec3};

use crate::noise::{cell, fractal, smoothstep};

/// Returns the color of a picture over the unit square (second coordinate up).
pub(crate) fn color(uv: Vec2, colors: &[Vec3; 5], seed: u32) -> Vec3 {
    match seed % 3 {
        0 => landscape(uv, colors, seed),
        1 => circles(uv, colors, seed),
        _ => blocks(uv, colors, seed),
    }
}

fn landscape(uv: Vec2, colors: &[Vec3; 5], seed: u32) -> Vec3 {
    let sun = Vec2::new(0.25 + 0.5 * cell(IVec2::new(1, 1), seed), 0.72);
    let mut color = colors[0].lerp(colors[1], smoothstep(0.35, 1.0, uv.y));
    color = color.lerp(colors[4], 1.0 - smoothstep(0.10, 0.12, (uv - sun).length()));
    for layer in 0..3u32 {
        let base = 0.55 - 0.17 * layer as f32;
        let ridge =
            base + 0.22 * (fractal(Vec2::new(uv.x * (2.0 + layer as f32), layer as f32), 3, seed ^ layer) - 0.4);
        let tone = colors[2].lerp(colors[3], layer as f32 / 2.0);
        color = color.lerp(tone, 1.0 - smoothstep(ridge - 0.01, ridge + 0.01, uv.y));
    }
    color
}

fn circles(uv: Vec2, colors: &[Vec3; 5], seed: u32) -> Vec3 {
    let mut color = colors[0];
    for i in 0..9 {
        let r = |salt| cell(IVec2::new(i, salt), seed);
        let center = Vec2::new(r(1), r(2));
        let radius = 0.08 + 0.24 * r(3);
        let distance = (uv - center).length();
        let ink = colors[1 + (r(4) * 4.0) as usize % 4];
        let disc = 1.0 - smoothstep(radius - 0.012, radius + 0.012, distance);
        let hole = if r(5) > 0.5 { smoothstep(0.5 * radius, 0.5 * radius + 0.02, distance) } else { 1.0 };
        color = color.lerp(ink, disc * hole);
    }
    color
}

fn blocks(uv: Vec2, colors: &[Vec3; 5], seed: u32) -> Vec3 {
    let columns = 3.0 + (seed / 3 % 3) as f32;
    let x = uv.x * columns;
    let column = x.floor() as i32;
    let rows = 2.0 + (4.0 * cell(IVec2::new(column, 40), seed)).floor();
    let y = uv.y * rows;
    let id = IVec2::new(column, y.floor() as i32);
    let edge = (x.fract() - 0.5).abs().max((y.fract() - 0.5).abs() * 1.0);
    let ink = colors[(cell(id, seed ^ 21) * 5.0) as usize % 5];
    ink.lerp(Vec3::splat(0.02), smoothstep(0.455, 0.475, edge))
}
