//! Radiosity as a dense system of equations.

use super::V3;
use std::f64::consts::PI;

/// Transport matrix: the receivers that the rays of each receiver meet.
#[derive(Clone, Debug)]
pub struct Matrix {
    /// Number of receivers.
    pub receivers: usize,
    /// Targets, `[receivers][rays]`; numbers beyond the receivers meet nothing.
    pub targets: Vec<u32>,
}

impl Matrix {
    /// Returns the number of rays of a receiver.
    fn rays(&self) -> usize {
        self.targets.len() / self.receivers.max(1)
    }

    /// Returns pairs of receiver and target.
    fn pairs(&self) -> impl Iterator<Item = (usize, usize)> + '_ {
        let all = self.targets.iter().enumerate().map(|(at, &met)| (at / self.rays(), met as usize));
        all.filter(|(_, met)| *met < self.receivers)
    }

    /// Returns the matrix times values.
    pub fn times(&self, values: &[V3]) -> Vec<V3> {
        let mut sums = vec![[0.0; 3]; self.receivers];
        let weight = 1.0 / self.rays() as f64;
        self.pairs().for_each(|(i, met)| (0..3).for_each(|c| sums[i][c] += weight * values[met][c]));
        sums
    }

    /// Returns the transposed matrix times values.
    pub fn transposed_times(&self, values: &[V3]) -> Vec<V3> {
        let mut sums = vec![[0.0; 3]; self.receivers];
        let weight = 1.0 / self.rays() as f64;
        self.pairs().for_each(|(i, met)| (0..3).for_each(|c| sums[met][c] += weight * values[i][c]));
        sums
    }

    /// Returns radiosity and irradiance after one bounce.
    pub fn bounce(&self, reflectance: &[V3], source: &[V3], radiosity: &[V3]) -> (Vec<V3>, Vec<V3>) {
        let sums = self.times(radiosity);
        let next = |i: usize| std::array::from_fn(|c| source[i][c] + reflectance[i][c] * sums[i][c]);
        ((0..self.receivers).map(next).collect(), sums.iter().map(|s| s.map(|x| PI * x)).collect())
    }

    /// Returns radiosity and irradiance of all bounces, by elimination.
    pub fn solve(&self, reflectance: &[V3], source: &[V3]) -> (Vec<V3>, Vec<V3>) {
        let radiosity = self.eliminate(reflectance, source, false);
        let irradiance = self.times(&radiosity).into_iter().map(|s| s.map(|x| PI * x)).collect();
        (radiosity, irradiance)
    }

    /// Returns the gradients of source and reflectance.
    ///
    /// Takes those of radiosity and irradiance, and the irradiance of the solution.
    pub fn solve_bwd(
        &self,
        reflectance: &[V3],
        irradiance: &[V3],
        radiosity_gradient: &[V3],
        irradiance_gradient: &[V3],
    ) -> (Vec<V3>, Vec<V3>) {
        // With the gradient y of all uses of T B: y = reflectance z + pi h, where z = g + Tᵗ y is the gradient of B.
        let lit = |i: usize| -> V3 {
            std::array::from_fn(|c| reflectance[i][c] * radiosity_gradient[i][c] + PI * irradiance_gradient[i][c])
        };
        let source: Vec<V3> = (0..self.receivers).map(lit).collect();
        let gathered = self.transposed_times(&self.eliminate(reflectance, &source, true));
        let total = |i: usize| -> V3 { std::array::from_fn(|c| radiosity_gradient[i][c] + gathered[i][c]) };
        let by_source: Vec<V3> = (0..self.receivers).map(total).collect();
        let by_reflectance =
            by_source.iter().zip(irradiance).map(|(z, e)| std::array::from_fn(|c| z[c] * e[c] / PI)).collect();
        (by_source, by_reflectance)
    }

    /// Solves x = source + reflectance M x by elimination with pivots.
    ///
    /// M is the matrix, or its transpose.
    fn eliminate(&self, reflectance: &[V3], source: &[V3], transposed: bool) -> Vec<V3> {
        let n = self.receivers;
        let mut solved = vec![[0.0; 3]; n];
        for c in 0..3 {
            let mut rows = vec![vec![0.0; n + 1]; n];
            for (i, met) in self.pairs() {
                let (row, column) = if transposed { (met, i) } else { (i, met) };
                rows[row][column] -= reflectance[row][c] / self.rays() as f64;
            }
            for i in 0..n {
                rows[i][i] += 1.0;
                rows[i][n] = source[i][c];
            }
            for k in 0..n {
                let pivot = (k..n).max_by(|&a, &b| rows[a][k].abs().total_cmp(&rows[b][k].abs())).unwrap_or(k);
                rows.swap(k, pivot);
                let (upper, lower) = rows.split_at_mut(k + 1);
                for row in lower.iter_mut().filter(|row| row[k] != 0.0) {
                    let factor = row[k] / upper[k][k];
                    (k..=n).for_each(|j| row[j] -= factor * upper[k][j]);
                }
            }
            for k in (0..n).rev() {
                let known: f64 = (k + 1..n).map(|j| rows[k][j] * solved[j][c]).sum();
                solved[k][c] = (rows[k][n] - known) / rows[k][k];
            }
        }
        solved
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference::difference;
    use crate::rng::Pcg;

    fn drawn(receivers: usize, rays: usize, seed: u32) -> (Matrix, Vec<V3>, Vec<V3>) {
        let mut rng = Pcg::new(seed);
        let targets = (0..receivers * rays).map(|_| rng.next_u32() % (receivers as u32 + 1)).collect();
        let mut triples = |high: f64| (0..receivers).map(|_| [0; 3].map(|_| rng.range(0.0, high))).collect();
        (Matrix { receivers, targets }, triples(0.9), triples(2.0))
    }

    #[test]
    fn solution_is_the_limit_of_bounces() {
        let (matrix, reflectance, source) = drawn(12, 5, 1);
        let (radiosity, irradiance) = matrix.solve(&reflectance, &source);
        let mut bounced = (source.clone(), Vec::new());
        for _ in 0..300 {
            bounced = matrix.bounce(&reflectance, &source, &bounced.0);
        }
        for (a, b) in [(&radiosity, &bounced.0), (&irradiance, &bounced.1)] {
            assert!(a.iter().zip(b.iter()).all(|(a, b)| (0..3).all(|c| (a[c] - b[c]).abs() < 1e-10)));
        }
    }

    #[test]
    fn gradients_match_finite_differences() {
        let n = 6;
        let (matrix, reflectance, source) = drawn(n, 4, 2);
        let (_, g, h) = drawn(n, 1, 3);
        let dot = |a: &[V3], b: &[V3]| a.iter().zip(b).map(|(a, b)| super::super::dot(*a, *b)).sum::<f64>();
        let flat = |v: &[V3]| v.iter().flatten().copied().collect::<Vec<f64>>();
        let mut x = [flat(&reflectance), flat(&source)].concat();
        let loss = |x: &[f64]| {
            let all: Vec<V3> = x.chunks(3).map(|c| [c[0], c[1], c[2]]).collect();
            let (radiosity, irradiance) = matrix.solve(&all[..n], &all[n..]);
            dot(&radiosity, &g) + dot(&irradiance, &h)
        };
        let (_, irradiance) = matrix.solve(&reflectance, &source);
        let (by_source, by_reflectance) = matrix.solve_bwd(&reflectance, &irradiance, &g, &h);
        let gradients = [flat(&by_reflectance), flat(&by_source)].concat();
        for (i, gradient) in gradients.iter().enumerate() {
            let d = difference(&mut x, i, loss);
            assert!((d - gradient).abs() < 1e-6 * (1.0 + d.abs()), "{i}: {gradient} is {d}");
        }
    }
}
