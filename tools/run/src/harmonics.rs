//! Spherical harmonics on the host: values, rotation, and small least-squares problems.

use glam::{DQuat, DVec3};

/// Value of the constant basis function.
pub const CONSTANT: f64 = 0.282_094_791_773_878_14;

/// Evaluates the 16 basis functions up to degree 3 in a unit direction.
///
/// Order and signs match 3DGS files.
pub fn basis(d: DVec3) -> [f64; 16] {
    let DVec3 { x, y, z } = d;
    let (xx, yy, zz) = (x * x, y * y, z * z);
    let (a, b, c) = (0.488_602_511_902_919_9, 1.092_548_430_592_079_2, 0.315_391_565_252_520_05);
    let (e, f, g) = (0.590_043_589_926_643_5, 2.890_611_442_640_554, 0.457_045_799_464_465_7);
    let (h, i) = (0.373_176_332_590_115_4, 1.445_305_721_320_277);
    [
        CONSTANT,
        -a * y,
        a * z,
        -a * x,
        b * x * y,
        -b * y * z,
        c * (2.0 * zz - xx - yy),
        -b * x * z,
        0.5 * b * (xx - yy),
        -e * y * (3.0 * xx - yy),
        f * x * y * z,
        -g * y * (4.0 * zz - xx - yy),
        h * z * (2.0 * zz - 3.0 * xx - 3.0 * yy),
        -g * x * (4.0 * zz - xx - yy),
        i * z * (xx - yy),
        -e * x * (xx - 3.0 * yy),
    ]
}

/// Rotation of the coefficients of bands 0 to 3: one row-major matrix per band.
pub struct Rotation([Vec<f64>; 4]);

impl Rotation {
    /// Computes the rotation of a unit quaternion.
    pub fn of(q: DQuat) -> Rotation {
        let directions = spread(48);
        let pairs: Vec<_> = directions.iter().map(|d| (basis(*d), basis(q.inverse() * *d))).collect();
        Rotation(std::array::from_fn(|band| {
            let (n, first) = (2 * band + 1, band * band);
            let mut columns = vec![0.0; n * n];
            for j in 0..n {
                let mut least = Least::new(n);
                pairs.iter().for_each(|(new, old)| least.add(&new[first..first + n], old[first + j], 1.0));
                for (i, value) in least.solve(0.0).into_iter().enumerate() {
                    columns[i * n + j] = value;
                }
            }
            columns
        }))
    }

    /// Rotates a band of all splats in place: `2 band + 1` coefficients of three channels each.
    pub fn turn(&self, band: usize, coefficients: &mut [f32]) {
        let n = 2 * band + 1;
        for splat in coefficients.chunks_exact_mut(3 * n) {
            let old: Vec<f64> = splat.iter().map(|v| f64::from(*v)).collect();
            for i in 0..n {
                for c in 0..3 {
                    splat[3 * i + c] = (0..n).map(|j| self.0[band][i * n + j] * old[3 * j + c]).sum::<f64>() as f32;
                }
            }
        }
    }
}

/// Returns evenly distributed unit vectors (Fibonacci lattice).
fn spread(count: usize) -> Vec<DVec3> {
    let golden = std::f64::consts::PI * (3.0 - 5.0_f64.sqrt());
    let at = |i: usize| {
        let z = 1.0 - (2.0 * i as f64 + 1.0) / count as f64;
        let r = (1.0 - z * z).sqrt();
        DVec3::new(r * (golden * i as f64).cos(), r * (golden * i as f64).sin(), z)
    };
    (0..count).map(at).collect()
}

/// Normal equations of a least-squares problem with few unknowns.
pub struct Least {
    n: usize,
    matrix: Vec<f64>,
    right: Vec<f64>,
}

impl Least {
    /// Creates a problem of `n` unknowns.
    pub fn new(n: usize) -> Least {
        Least { n, matrix: vec![0.0; n * n], right: vec![0.0; n] }
    }

    /// Adds a weighted equation: `row` times the unknowns equals `value`.
    pub fn add(&mut self, row: &[f64], value: f64, weight: f64) {
        for (i, a) in row.iter().enumerate() {
            row.iter().enumerate().for_each(|(j, b)| self.matrix[i * self.n + j] += weight * a * b);
            self.right[i] += weight * a * value;
        }
    }

    /// Solves for the unknowns. `ridge` is the Tikhonov weight that keeps the problem solvable.
    pub fn solve(&self, ridge: f64) -> Vec<f64> {
        let n = self.n;
        let mut l = vec![0.0; n * n];
        for i in 0..n {
            for j in 0..=i {
                let pull = if i == j { ridge } else { 0.0 };
                let sum = self.matrix[i * n + j] + pull - (0..j).map(|k| l[i * n + k] * l[j * n + k]).sum::<f64>();
                l[i * n + j] = if i == j { sum.max(1e-12).sqrt() } else { sum / l[j * n + j] };
            }
        }
        let mut x = self.right.clone();
        for i in 0..n {
            x[i] = (x[i] - (0..i).map(|k| l[i * n + k] * x[k]).sum::<f64>()) / l[i * n + i];
        }
        for i in (0..n).rev() {
            x[i] = (x[i] - (i + 1..n).map(|k| l[k * n + i] * x[k]).sum::<f64>()) / l[i * n + i];
        }
        x
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn functions_are_orthonormal_and_rotate_with_the_signal() {
        let directions = spread(20_000);
        for i in 0..16 {
            for j in 0..16 {
                let sum: f64 = directions.iter().map(|d| basis(*d)[i] * basis(*d)[j]).sum();
                let product = 4.0 * std::f64::consts::PI * sum / directions.len() as f64;
                assert!((product - f64::from(i == j)).abs() < 1e-3, "{i} {j}: {product}");
            }
        }
        let q = DQuat::from_axis_angle(DVec3::new(1.0, -2.0, 0.5).normalize(), 1.1);
        let rotation = Rotation::of(q);
        for band in 0..4_usize {
            let n = 2 * band + 1;
            let before: Vec<f32> = (0..3 * n).map(|i| ((7 * i) % 5) as f32 - 1.5).collect();
            let mut after = before.clone();
            rotation.turn(band, &mut after);
            let value = |c: &[f32], d: DVec3| -> f64 {
                (0..n).map(|k| basis(d)[band * band + k] * f64::from(c[3 * k + 1])).sum()
            };
            for d in spread(9) {
                assert!((value(&before, d) - value(&after, q * d)).abs() < 1e-5, "{band}");
                let wrong = (value(&before, d) - value(&before, q * d)).abs();
                assert!(band == 0 || wrong > 1e-3, "{band}");
            }
        }
    }
}
