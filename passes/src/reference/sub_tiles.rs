//! Reference of the sub-tiles of blending: slots of a tile that a splat touches.
//!
//! The kernels clip the footprint by rows. This reference minimizes the exponent over each rectangle instead.

use sgs_shaders::structs::Splat;

/// Pixels around a slot in the kernels (`include/sub_tiles.glsl`).
pub const GAP: f64 = 0.0625;

/// Returns the slots of a tile that a splat touches, one bit each, row by row.
///
/// The tile's first pixel is `corner`. A slot is the rectangle around the centers of its pixels, `gap` pixels larger on
/// each side. A splat touches it if its alpha reaches `alpha_min` somewhere in it, by `margin` of the exponent more.
pub fn touched(
    splat: &Splat,
    alpha_min: f64,
    corner: [u32; 2],
    tile: [u32; 2],
    slot: [u32; 2],
    [margin, gap]: [f64; 2],
) -> u32 {
    let limit = (f64::from(splat.opacity) / alpha_min).log2().max(0.0) + margin;
    let across = tile[0] / slot[0];
    (0..across * (tile[1] / slot[1])).fold(0, |slots, k| {
        let at = [corner[0] + k % across * slot[0], corner[1] + k / across * slot[1]];
        let low = [0, 1].map(|i| f64::from(at[i]) + 0.5 - gap - f64::from(splat.mean[i]));
        let high = [0, 1].map(|i| low[i] + f64::from(slot[i] - 1) + 2.0 * gap);
        slots | u32::from(least_exponent(splat.factor.map(f64::from), low, high) <= limit) << k
    })
}

/// Returns the least `p² + q²` in a rectangle around offsets from the mean.
fn least_exponent([u11, u12, u22]: [f64; 3], low: [f64; 2], high: [f64; 2]) -> f64 {
    if low.iter().all(|x| *x <= 0.0) && high.iter().all(|x| *x >= 0.0) {
        return 0.0;
    }
    let exponent = |x: f64, y: f64| (u11 * x + u12 * y).powi(2) + (u22 * y).powi(2);
    // A convex function is least on the border if its minimum lies outside. On an edge it is a parabola.
    let on_column = |x: f64| exponent(x, (-u11 * u12 * x / (u12 * u12 + u22 * u22)).clamp(low[1], high[1]));
    let on_row = |y: f64| exponent((-u12 * y / u11).clamp(low[0], high[0]), y);
    [on_column(low[0]), on_column(high[0]), on_row(low[1]), on_row(high[1])].into_iter().fold(f64::INFINITY, f64::min)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference::rng::Pcg;

    /// Slots with a pixel whose alpha reaches the least one.
    fn showing(s: &Splat, corner: [u32; 2], tile: [u32; 2], slot: [u32; 2]) -> u32 {
        let across = tile[0] / slot[0];
        (0..tile[0] * tile[1]).fold(0, |slots, i| {
            let (x, y) = (i % tile[0], i / tile[0]);
            let d = [x, y].map(f64::from);
            let d = [0, 1].map(|k| d[k] + f64::from(corner[k]) + 0.5 - f64::from(s.mean[k]));
            let [u11, u12, u22] = s.factor.map(f64::from);
            let alpha = f64::from(s.opacity) * (-(u11 * d[0] + u12 * d[1]).powi(2) - (u22 * d[1]).powi(2)).exp2();
            slots | u32::from(alpha >= 1.0 / 255.0) << (y / slot[1] * across + x / slot[0])
        })
    }

    #[test]
    fn slots_hold_every_pixel_that_shows() {
        let mut r = Pcg::new(3);
        let (mut left, mut all) = (0, 0);
        for case in 0..2000 {
            let (tile, slot) =
                [([8, 16], [4, 2]), ([16, 16], [4, 4]), ([16, 16], [8, 4]), ([16, 16], [8, 8])][case % 4];
            let size = r.range(-3.0, 3.0).exp();
            let splat = Splat {
                mean: [r.range(20.0, 60.0) as f32, r.range(20.0, 60.0) as f32],
                factor: [(r.range(0.1, 1.5) / size) as f32, (r.range(-3.0, 3.0) / size) as f32, (1.0 / size) as f32],
                opacity: r.range(0.004, 1.0) as f32,
            };
            let exact = touched(&splat, 1.0 / 255.0, [32, 32], tile, slot, [1e-9, 1e-9]);
            let shows = showing(&splat, [32, 32], tile, slot);
            assert_eq!(shows & !exact, 0, "{splat:?}: {shows:b} show, {exact:b} are touched");
            let kept = touched(&splat, 1.0 / 255.0, [32, 32], tile, slot, [0.05, GAP]);
            assert_eq!(exact & !kept, 0, "{splat:?}: margins lose slots");
            if shows != 0 {
                left += kept.count_ones();
                all += tile[0] * tile[1] / (slot[0] * slot[1]);
            }
        }
        assert!(all > 2000 && left < all * 9 / 10 && left > all / 10, "{left} of {all} slots are left");
    }
}
