//! Latitude-longitude maps: the layout of files, and the domain of the smoothness term.
//!
//! Row i of h is theta = pi (i + 1/2) / h from +y. Column j of w is phi = 2 pi (j + 1/2) / w - pi. The direction is
//! (sin theta sin phi, cos theta, -sin theta cos phi). Maps have three linear channels. All functions run on the host
//! in double precision.

use super::cube::{Footprint, texel_direction};
use std::f64::consts::{PI, TAU};

/// Columns and rows of files and of the map that the smoothness term uses.
pub const SIZE: [u32; 2] = [1024, 512];

/// Returns the direction of a pixel.
pub fn direction(size: [u32; 2], column: u32, row: u32) -> [f64; 3] {
    let theta = PI * (f64::from(row) + 0.5) / f64::from(size[1]);
    let phi = TAU * (f64::from(column) + 0.5) / f64::from(size[0]) - PI;
    [theta.sin() * phi.sin(), theta.cos(), -theta.sin() * phi.cos()]
}

/// Resamples a cube to a map by seamless bilinear lookup.
pub fn from_cube(texels: &[f32], cube: u32, size: [u32; 2]) -> Vec<f32> {
    let pixels = (0..size[1]).flat_map(|row| (0..size[0]).map(move |column| (column, row)));
    pixels.flat_map(|(x, y)| Footprint::of(direction(size, x, y), cube).apply(texels).map(|v| v as f32)).collect()
}

/// Resamples a map to a cube. Each texel is the mean of as many samples as the map's resolution requires.
pub fn to_cube(map: &[f32], size: [u32; 2], cube: u32) -> Vec<f32> {
    // Samples along a texel's side: map columns per texel on the equator, which has 4 `cube` texels.
    let samples = size[0].div_ceil(4 * cube).clamp(1, 16);
    let fine = cube * samples;
    let mut texels = vec![0.0; 18 * (cube * cube) as usize];
    for texel in 0..6 * cube * cube {
        let (x, row) = (texel % cube, texel / cube);
        let mut sum = [0.0; 3];
        for s in 0..samples * samples {
            let at = (row * samples + s / samples) * fine + x * samples + s % samples;
            let value = sample(map, size, texel_direction(fine, at));
            (0..3).for_each(|c| sum[c] += value[c]);
        }
        for c in 0..3 {
            texels[3 * texel as usize + c] = (sum[c] / f64::from(samples * samples)) as f32;
        }
    }
    texels
}

/// Looks up a map bilinearly. The map wraps around horizontally, and its first and last rows extend to the poles.
fn sample(map: &[f32], size: [u32; 2], d: [f64; 3]) -> [f64; 3] {
    let [w, h] = size.map(f64::from);
    let theta = d[0].hypot(d[2]).atan2(d[1]);
    let phi = d[0].atan2(-d[2]);
    let x = (phi + PI) / TAU * w - 0.5;
    let y = (theta / PI * h - 0.5).clamp(0.0, h - 1.0);
    let (x0, y0) = (x.floor(), y.floor().min(h - 2.0).max(0.0));
    let (tx, ty) = (x - x0, y - y0);
    let columns = [0, 1].map(|k| (x0 as i64 + k).rem_euclid(i64::from(size[0])) as usize);
    let rows = [y0 as usize, (y0 as usize + 1).min(size[1] as usize - 1)];
    std::array::from_fn(|c| {
        let at = |k: usize, l: usize| f64::from(map[3 * (rows[l] * size[0] as usize + columns[k]) + c]);
        (1.0 - ty) * ((1.0 - tx) * at(0, 0) + tx * at(1, 0)) + ty * ((1.0 - tx) * at(0, 1) + tx * at(1, 1))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn smooth_environment_survives_cube_map_round_trip() {
        let cube = 32;
        let color = |d: [f64; 3]| [1.0 + 0.5 * d[0], 1.0 + 0.5 * d[1], 1.0 + 0.3 * d[2] * d[0]];
        let texels: Vec<f32> =
            (0..6 * cube * cube).flat_map(|t| color(texel_direction(cube, t)).map(|v| v as f32)).collect();
        let map = from_cube(&texels, cube, [256, 128]);
        for (x, y) in [(0, 0), (255, 64), (17, 127), (100, 30)] {
            let expected = color(direction([256, 128], x, y));
            let at = 3 * (y * 256 + x) as usize;
            assert!((0..3).all(|c| (f64::from(map[at + c]) - expected[c]).abs() < 2e-3), "{x} {y}");
        }
        let back = to_cube(&map, [256, 128], cube);
        let worst = back.iter().zip(&texels).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(worst < 5e-3, "{worst}");
    }

    #[test]
    fn map_center_faces_minus_z() {
        let d = direction([1024, 512], 512, 256);
        assert!(d[2] < -0.9999);
        // A quarter of the map further right is +x.
        assert!(direction([1024, 512], 768, 256)[0] > 0.9999);
    }
}
