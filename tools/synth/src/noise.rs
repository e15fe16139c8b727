//! Smooth pseudo-random patterns in the plane.
//!
//! Textures and the errors of simulated priors use them.

use glam::{IVec2, Vec2};

use crate::rng::{mix32, unit};

/// Returns a random value in [0, 1) for a cell of the integer grid.
pub(crate) fn cell(p: IVec2, seed: u32) -> f32 {
    unit(cell_bits(p, seed))
}

/// Returns 32 random bits for a cell of the integer grid.
pub(crate) fn cell_bits(p: IVec2, seed: u32) -> u32 {
    mix32(
        (p.x as u32).wrapping_mul(0x9e37_79b1)
            ^ mix32((p.y as u32).wrapping_mul(0x85eb_ca77) ^ seed.wrapping_mul(0xc2b2_ae3d)),
    )
}

/// Returns smooth noise in [0, 1) with features about one unit wide.
pub(crate) fn value(p: Vec2, seed: u32) -> f32 {
    let floor = p.floor();
    let base = floor.as_ivec2();
    let f = p - floor;
    let s = f * f * (Vec2::splat(3.0) - 2.0 * f);
    let corner = |dx, dy| cell(base + IVec2::new(dx, dy), seed);
    let low = corner(0, 0) + (corner(1, 0) - corner(0, 0)) * s.x;
    let high = corner(0, 1) + (corner(1, 1) - corner(0, 1)) * s.x;
    low + (high - low) * s.y
}

/// Returns a weighted mean of octaves of [`value`], in [0, 1). Each octave has half the weight of the one before.
pub(crate) fn fractal(mut p: Vec2, octaves: u32, seed: u32) -> f32 {
    let (mut sum, mut weight, mut total) = (0.0, 1.0, 0.0);
    for octave in 0..octaves {
        sum += weight * value(p, seed.wrapping_add(octave * 7919));
        total += weight;
        weight *= 0.5;
        p = p * 2.03 + Vec2::new(17.3, 9.1);
    }
    sum / total
}

/// Interpolates smoothly from 0 to 1 between two edges.
pub(crate) fn smoothstep(low: f32, high: f32, x: f32) -> f32 {
    let t = ((x - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}
