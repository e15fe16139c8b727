//! Cube map geometry in double precision. Used to build tables and to convert files.
//!
//! Faces are +x -x +y -y +z -z with u to the right and v downwards in [-1, 1]: (1,-v,-u) (-1,-v,u) (u,1,v) (u,-1,-v)
//! (u,-v,1) (-u,-v,-1). Texel (x, y) of face f has index `(f size + y) size + x`.
//!
//! Guarantees: bilinear lookups have no seams. At a corner of the cube, the weight of the missing fourth texel is split
//! among the three texels that meet there. Filters are implemented elsewhere.

/// Returns the vector with coordinates u, v and n along a face's axes and normal.
pub fn from_face(face: usize, u: f64, v: f64, n: f64) -> [f64; 3] {
    match face {
        0 => [n, -v, -u],
        1 => [-n, -v, u],
        2 => [u, n, v],
        3 => [u, -n, -v],
        4 => [u, -v, n],
        _ => [-u, -v, -n],
    }
}

/// Returns the face that a direction intersects, and its u and v in [-1, 1].
pub fn to_face(d: [f64; 3]) -> (usize, f64, f64) {
    let a = d.map(f64::abs);
    let axis = if a[0] >= a[1] && a[0] >= a[2] {
        0
    } else if a[1] >= a[2] {
        1
    } else {
        2
    };
    let (m, s) = (a[axis].max(1e-300), d[axis].signum());
    match axis {
        0 => (usize::from(s < 0.0), -s * d[2] / m, -d[1] / m),
        1 => (2 + usize::from(s < 0.0), d[0] / m, s * d[2] / m),
        _ => (4 + usize::from(s < 0.0), s * d[0] / m, -d[1] / m),
    }
}

/// Returns the unit vector through the center of a texel.
pub fn texel_direction(size: u32, texel: u32) -> [f64; 3] {
    let (x, row) = (texel % size, texel / size);
    let at = |i: u32| f64::from(2 * i + 1) / f64::from(size) - 1.0;
    let d = from_face((row / size) as usize, at(x), at(row % size), 1.0);
    let length = d.iter().map(|c| c * c).sum::<f64>().sqrt();
    d.map(|c| c / length)
}

/// Returns the exact solid angle of texel (x, y) of any face. The solid angles of all texels of the cube add up to 4
/// pi.
pub fn solid_angle(size: u32, x: u32, y: u32) -> f64 {
    let edge = |i: u32| 2.0 * f64::from(i) / f64::from(size) - 1.0;
    let to = |x: f64, y: f64| (x * y).atan2((x * x + y * y + 1.0).sqrt());
    let (x0, x1, y0, y1) = (edge(x), edge(x + 1), edge(y), edge(y + 1));
    to(x1, y1) - to(x0, y1) - to(x1, y0) + to(x0, y0)
}

/// Four texels around a direction and their weights, which add up to 1.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Footprint {
    /// Indices of the texels. At a corner of the cube, the entry of the missing texel is arbitrary and has weight 0.
    pub texels: [u32; 4],
    /// Weights of the texels.
    pub weights: [f64; 4],
}

impl Footprint {
    /// Returns the footprint of a direction of any length.
    pub fn of(d: [f64; 3], size: u32) -> Footprint {
        let (face, u, v) = to_face(d);
        let n = f64::from(size);
        let place = |u: f64| (0.5 * u.clamp(-1.0, 1.0) + 0.5) * n - 0.5;
        let (x, y) = (place(u), place(v));
        let (tx, ty) = (x - x.floor(), y - y.floor());
        let (ix, iy) = (x.floor() as i32, y.floor() as i32);
        let mut f = Footprint::default();
        let mut lost = 0.0;
        let last = size as i32 - 1;
        for c in 0..4 {
            let (dx, dy) = (c & 1, c >> 1);
            let (px, py) = (ix + dx, iy + dy);
            let weight = if dx != 0 { tx } else { 1.0 - tx } * if dy != 0 { ty } else { 1.0 - ty };
            if !(0..=last).contains(&px) && !(0..=last).contains(&py) {
                lost = weight;
            } else {
                f.weights[c as usize] = weight;
                f.texels[c as usize] = across(face, px, py, size);
            }
        }
        if lost > 0.0 {
            let there = |w: &&mut f64| **w > 0.0;
            f.weights.iter_mut().filter(there).for_each(|w| *w += lost / 3.0);
        }
        f
    }

    /// Returns the weighted mean of three channels.
    pub fn apply(&self, texels: &[f32]) -> [f64; 3] {
        let mut sum = [0.0; 3];
        for (&t, &w) in self.texels.iter().zip(&self.weights) {
            for (c, s) in sum.iter_mut().enumerate() {
                *s += w * f64::from(texels[3 * t as usize + c]);
            }
        }
        sum
    }
}

/// Returns the texel at (x, y) of a face, or its neighbor on the next face. At most one coordinate may lie one step
/// past an edge. In units of half texels all coordinates are integers.
fn across(face: usize, x: i32, y: i32, size: u32) -> u32 {
    let n = size as i32;
    let place = |i: i32| 2 * i + 1 - n;
    let (cx, cy) = (place(x), place(y));
    let past = cx.abs().max(cy.abs()) > n;
    let depth = if past { n - 1 } else { n };
    let p = from_face(face, f64::from(cx.clamp(-n, n)), f64::from(cy.clamp(-n, n)), f64::from(depth));
    let (g, u, v) = to_face(p);
    let index = |u: f64| (((u * f64::from(n)).round() as i32 + n - 1) / 2) as u32;
    (g as u32 * size + index(v)) * size + index(u)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::Pcg;

    #[test]
    fn face_coordinates_and_directions_are_inverse() {
        let mut rng = Pcg::new(1);
        for face in 0..6 {
            for _ in 0..50 {
                let (u, v) = (rng.range(-0.99, 0.99), rng.range(-0.99, 0.99));
                let (f, u2, v2) = to_face(from_face(face, u, v, 1.0).map(|c| 3.0 * c));
                assert!(f == face && (u - u2).abs() < 1e-12 && (v - v2).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn solid_angles_add_up_to_the_sphere() {
        for size in [1, 2, 16, 64] {
            let sum: f64 = (0..size).flat_map(|y| (0..size).map(move |x| solid_angle(size, x, y))).sum();
            assert!((6.0 * sum - 4.0 * std::f64::consts::PI).abs() < 1e-10, "{size}: {sum}");
        }
    }

    #[test]
    fn texel_past_an_edge_is_the_adjacent_one() {
        let size = 8;
        for face in 0..6 {
            for i in 0..8 {
                for (x, y) in [(-1, i), (8, i), (i, -1), (i, 8)] {
                    let inside = texel_direction(size, across(face, x.clamp(0, 7), y.clamp(0, 7), size));
                    let outside = texel_direction(size, across(face, x, y, size));
                    let cos: f64 = (0..3).map(|k| inside[k] * outside[k]).sum();
                    // Two texels that share an edge are less than a texel and a half apart.
                    assert!(cos > (0.3_f64).cos() && cos < 0.9999, "face {face} {x} {y}: {cos}");
                    assert_ne!(to_face(inside).0, to_face(outside).0);
                }
            }
        }
    }

    #[test]
    fn lookups_are_continuous_and_preserve_constants() {
        let size = 4;
        let mut rng = Pcg::new(2);
        let texels: Vec<f32> = (0..6 * size * size * 3).map(|_| rng.uniform() as f32).collect();
        for _ in 0..2000 {
            // Half of the samples lie near an edge, some near a corner.
            let mut d = [rng.normal(), rng.normal(), rng.normal()];
            if rng.uniform() < 0.5 {
                d[1] = d[0] * if rng.uniform() < 0.5 { 1.0 } else { -1.0 };
            }
            if rng.uniform() < 0.3 {
                d[2] = d[0];
            }
            let step = [1e-7 * rng.normal(), 1e-7 * rng.normal(), 1e-7 * rng.normal()];
            let (a, b) = (Footprint::of(d, size), Footprint::of(std::array::from_fn(|k| d[k] + step[k]), size));
            assert!((a.weights.iter().sum::<f64>() - 1.0).abs() < 1e-12);
            let (x, y) = (a.apply(&texels), b.apply(&texels));
            assert!((0..3).all(|c| (x[c] - y[c]).abs() < 1e-4), "{d:?}: {x:?} {y:?}");
        }
    }
}
