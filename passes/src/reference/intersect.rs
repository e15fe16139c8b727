//! Reference of `intersect`: tiles with a pixel where a splat's alpha reaches 1/255.

use super::project::Projected;
use glam::DVec2;
use std::collections::BTreeSet;

/// Returns the tiles that a splat touches, as `y * tiles_x + x`. `factor` scales alpha to widen or narrow the
/// threshold; 1 is exact.
pub fn tiles(s: &Projected, size: [u32; 2], tile: [u32; 2], factor: f64) -> BTreeSet<u32> {
    let reach = s.reach() + 1.0;
    let low = (s.mean - reach).floor().max(DVec2::ZERO);
    let high = (s.mean + reach).ceil().min(DVec2::new(f64::from(size[0]), f64::from(size[1])) - 1.0);
    let across = size[0].div_ceil(tile[0]);
    let mut touched = BTreeSet::new();
    if low.x > high.x || low.y > high.y {
        return touched;
    }
    for y in low.y as u32..=high.y as u32 {
        for x in low.x as u32..=high.x as u32 {
            if s.alpha(DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5)) * factor >= 1.0 / 255.0 {
                touched.insert(y / tile[1] * across + x / tile[0]);
            }
        }
    }
    touched
}
